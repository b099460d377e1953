"""Tables in Python: how many runs a number rests on, and what is not known of it."""

import json
import math
from functools import partial
from pathlib import Path

import pandas as pd
import pytest
from toy_results import analyse

import labbook
from labbook.lab import LabFolder
from labbook.results.frames import frames, known_interval, to_json

ENDS = ["flow_rate_error", "flow_rate_low", "flow_rate_high"]


@pytest.fixture
def survivor(synthetic):
    """Results of two points with three runs each; at the first, two of them clogged."""
    points = [synthetic.point(k, D) for k, D in enumerate((0.018, 0.03))]
    clogged = {(0, 2), (0, 3)}
    runs = [
        synthetic.FinishedDouble(one, seed, outcome="clogged" if (one.index, seed) in clogged else "emptied")
        for one in points
        for seed in (1, 2, 3)
    ]
    kind = partial(labbook.Results, lab_folder=LabFolder(Path("nowhere")), backend="numba")
    return analyse(synthetic.study_of(points, replicates=3, reference=None, fit=()), runs, kind=kind)


def test_a_mean_says_of_how_many_runs_it_is(survivor):
    frame = survivor.frame()
    assert frame["flow_rate_n"].tolist() == [1, 3]
    assert frame["replicates"].tolist() == [1, 3], "the n of the flow rate, from which a t quantile is taken"
    assert frame["runs"].tolist() == [3, 3]
    points = survivor.frames()["points"].query("quantity == 'flow_rate'")
    assert points["replicates"].tolist() == [1, 3]


def test_an_interval_that_is_not_known_is_nan_at_both_ends(survivor):
    frame = survivor.frame()
    assert frame.loc[0, ENDS].isna().all()
    assert frame.loc[1, ENDS].notna().all()
    assert math.isfinite(frame["flow_rate_low"].mean())
    for table in survivor.frames().values():
        ends = [name for name in ("error", "low", "high") if name in table]
        assert not table[ends].astype(float).isin([math.inf, -math.inf]).to_numpy().any()
    (point,) = [row for row in json.loads(to_json(survivor))["points"]
                if row["point"] == 1 and row["quantity"] == "flow_rate"]  # fmt: skip
    assert (point["error"], point["low"], point["high"]) == (None, None, None)


def test_an_interval_that_is_open_at_one_end_keeps_the_other():
    assert known_interval(0.5, math.inf) == (0.5, math.inf)
    assert all(map(math.isnan, known_interval(-math.inf, math.inf)))


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_exported_tables_have_their_units(survivor, tmp_path, kind):
    pytest.importorskip("pyarrow")
    survivor.export(tmp_path, kind=kind)
    units = json.loads((tmp_path / "units.json").read_text())
    assert units["points"]["container.orifice"] == "m"
    assert units["flow"] == {"container.orifice": "m", "time": "s", "flow_rate": "kg/s"}
    if kind == "parquet":
        assert pd.read_parquet(tmp_path / "points.parquet").attrs["units"] == frames(survivor)["points"].attrs["units"]
