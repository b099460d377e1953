"""Tables of runs on a terminal of 80 columns."""

import json
import re

import pytest
from toy_lab import carry_out, labbook, study


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """A lab whose four runs are evaluated."""
    folder = tmp_path_factory.mktemp("listing")
    assert carry_out(study(folder), folder / "lab").tally.ran
    labbook("fit", folder / "toy.yaml", "--lab", folder / "lab", "--backend", "toy")
    return folder / "lab"


def test_runs_have_their_flow_rate_and_say_once_what_all_share(lab):
    text = labbook("runs", "--lab", lab, COLUMNS="80").stdout
    assert re.search(r"study toy-study, backend toy \d+", text)
    assert "left" not in text
    assert max(map(len, text.splitlines())) <= 80
    rows = [line.split() for line in text.splitlines() if "finished" in line]
    records = json.loads(labbook("runs", "--lab", lab, "--json").stdout)
    assert len(rows) == len(records) == 4
    for row, record in zip(rows, records, strict=True):
        whole = json.loads(labbook("show", record["run_key"], "--lab", lab, "--json").stdout)
        (rate,) = [one["value"] for one in whole["measurements"] if one["quantity"] == "flow_rate"]
        assert float(row[-4]) == pytest.approx(1e3 * rate, rel=1e-3)
        assert row[-3:-1] == [f"{100 * record['discharged']:.0f}", "%"]


def test_a_run_cuts_no_name_and_has_the_units_of_other_tables(lab):
    key = json.loads(labbook("runs", "--lab", lab, "--json").stdout)[0]["run_key"]
    text = labbook("show", key, "--lab", lab, COLUMNS="80").stdout
    assert "…" not in text
    assert re.search(r"^ flow_rate +[\d.]+ +[\d.]+ +g/s", text, re.MULTILINE)
    assert re.search(r"^window: .*discharged", text, re.MULTILINE)
