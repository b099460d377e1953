"""Windows by time and from the end of the start-up, from the study to tables, beside one by mass of the same runs; and
N(t)."""

import json

import numpy as np
import pandas as pd
import pytest
from toy_lab import labbook, study_file

BY_TIME = ("window: {after: 20 ms, until: 120 ms}",)


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """A lab with two runs that are emptied, and what both windows say of them."""
    folder = tmp_path_factory.mktemp("window")
    stop = "stop: {discharged: 1, max_time: 5 s}"
    by_mass = study_file(folder, stop, orifices="[24]")
    labbook("run", by_mass, "--lab", folder / "lab", "--backend", "toy")
    return folder, stop


def test_both_windows_of_the_same_runs_are_kept_apart(lab):
    folder, stop = lab
    labbook("run", study_file(folder, stop, orifices="[24]"), "--lab", folder / "lab", "--backend", "toy")
    plain = _points(folder)
    asked = study_file(folder, stop, *BY_TIME, orifices="[24]")
    assert "2 of 2 runs done" in labbook("run", asked, "--lab", folder / "lab", "--backend", "toy").output
    timed = _points(folder)
    assert plain["window_end"] == 0.6
    assert "window_unit" not in plain
    assert (timed["window_start"], timed["window_end"], timed["window_unit"]) == (0.02, 0.12, "s")
    runs = json.loads(labbook("runs", "--lab", folder / "lab", "--json").stdout)
    assert len(runs) == 2
    study_file(folder, stop, orifices="[24]")
    assert _points(folder)["value"] == plain["value"] != timed["value"]


def test_a_window_from_the_end_of_the_start_up_needs_no_new_run(lab):
    """Each run has its own start, which tables name; the start that a study states is kept apart from it."""
    folder, stop = lab
    auto = "window: {start: auto, end: 0.6}"
    asked = study_file(folder, stop, auto, orifices="[24]")
    assert "2 of 2 runs done" in labbook("run", asked, "--lab", folder / "lab", "--backend", "toy").output
    out = folder / "auto"
    labbook("export", asked, "--lab", folder / "lab", "--backend", "toy", "--out", out)
    runs = pd.read_csv(out / "runs.csv")
    starts = runs[runs["quantity"] == "window_start"]
    assert len(starts) == 2
    assert all(0 <= start <= 0.3 for start in starts["value"])
    rates = runs[runs["quantity"] == "flow_rate"]
    for start, window in zip(starts["value"], rates["window"], strict=True):
        assert window.startswith(f"{start:.3g} to 0.6 of the ")
    point = pd.read_csv(out / "points.csv").query("quantity == 'flow_rate'").iloc[0]
    assert point["window_start"] == pytest.approx(starts["value"].mean())
    said = " ".join(labbook("plan", asked, "--lab", folder / "lab", "--backend", "toy").output.split())
    assert "Flow rates from the end of the start-up to 0.6 of the mass discharged" in said
    study_file(folder, stop, "window: {start: 0, end: 0.6}", orifices="[24]")
    assert _points(folder)["window_start"] == 0


def test_the_rate_within_a_window_by_time_is_that_of_n_of_t(lab):
    """Grains that leave between the two times, over the time between the first and the last of them."""
    folder, stop = lab
    asked = study_file(folder, stop, *BY_TIME, orifices="[24]")
    out = folder / "tables"
    labbook("export", asked, "--lab", folder / "lab", "--backend", "toy", "--out", out, "--inside", "10 ms")
    table = pd.read_csv(out / "inside.csv")
    assert list(table.columns[-3:]) == ["time", "grains", "mass"]
    numbers = pd.read_csv(out / "runs.csv").query("quantity == 'grain_rate'").set_index("run_key")
    for key, rows in table.groupby("run_key"):
        assert np.allclose(rows["time"], 0.01 * np.arange(len(rows)))
        assert rows["grains"].iloc[0] == 200
        assert np.all(np.diff(rows["grains"]) <= 0)
        assert np.allclose(rows["mass"], rows["grains"] * rows["mass"].iloc[0] / 200)
        at = dict(zip(np.round(rows["time"], 6).tolist(), rows["grains"].tolist(), strict=True))
        left = at[0.02] - at[0.12]
        assert left > 60
        assert numbers.loc[key, "value"] == pytest.approx(left / 0.1, rel=3 / left)
        assert numbers.loc[key, "window"].endswith("s)")


def test_a_grid_in_time_is_a_time(lab):
    folder, stop = lab
    asked = study_file(folder, stop, orifices="[24]")
    for text, why in (("10", "the unit is missing"), ("0 s", "above 0"), ("1 kg", "in s is needed")):
        ended = labbook("export", asked, "--lab", folder / "lab", "--backend", "toy", "--inside", text, check=False)
        assert ended.exit_code == 2
        assert why in " ".join(ended.output.replace("\u2502", " ").split())


def _points(folder) -> dict:
    """What the exported table says of the flow rate."""
    out = folder / "points"
    labbook("export", folder / "toy.yaml", "--lab", folder / "lab", "--backend", "toy", "--out", out)
    table = pd.read_csv(out / "points.csv")
    return table[table["quantity"] == "flow_rate"].dropna(axis=1).iloc[0].to_dict()
