"""A small silo that stays full, on the CPU backend, from its study to its flow rate."""

import numpy as np
import pytest

pytest.importorskip("numba")

from labbook_numba import Backend
from toy_results import analyse

from labbook.lab import Catalogue, LabFolder
from labbook.measure import MEASURES
from labbook.measure.steady import TimeWindow
from labbook.plan.coverage import finished
from labbook.report.residence import residence_sections
from labbook.report.tables import Table
from labbook.results.residence import marks_of
from labbook.run.runner import Runner
from labbook.study import define

pytestmark = [pytest.mark.compiles, pytest.mark.slow]
D = 3e-3


def test_a_fed_silo_stays_full_and_its_run_ends_when_it_is_precise(tmp_path):
    asked = define(
        name="full",
        grains={"shape": "sphere", "diameter": "3 mm", "density": "2500 kg/m^3", "count": 200},
        contact={"law": "hertz-mindlin", "shear_modulus": "1 MPa", "poisson_ratio": 0.25, "friction": 0.5}
        | {"restitution": 0.2, "rolling_friction": 0.01},
        container={"kind": "wedge-hopper", "width": "40 mm", "height": "120 mm", "thickness": "1.01 d"}
        | {"orifice": "20 mm", "planes": [{"name": "low", "z": "10 mm"}, {"name": "high", "z": "20 mm"}]},
        feed={"kind": "reinject"},
        numerics={"dt": "25 us", "steps_per_beat": 500},
        accuracy={"flow_rate": "12 %"},
        record={"every": "20 ms"},
        measure=["flow_rate", "residence"],
    )
    summary = Runner(asked, LabFolder(tmp_path), Backend(wide=True)).run()
    assert list(summary.tally.ran.values()) == ["precise"], summary.tally.failed
    results = analyse(asked, finished(Catalogue(tmp_path), asked, "numba"))
    (point,) = results.points
    (run,) = point.runs
    data, frames = run.run.data(), run.frames()
    assert frames is not None
    left = data.tables["crossing"]
    assert len(left["id"]) > 6 * 200
    assert np.unique(left["id"], return_counts=True)[1].max() > 3
    times = np.unique(frames["time"])
    inside = np.array([(frames["time"] == t).sum() for t in times])
    assert (inside > 0.8 * 200).all(), "but for the few that fall below the outlet"

    def height(t: float) -> float:
        """Of the middle grain: those that fall above the bed stand for those of the bed that they were."""
        return float(np.median(frames["z"][(frames["time"] == t) & (frames["z"] > 0)]))

    steady = [height(t) for t in times if t > times[-1] / 4]
    assert np.std(steady) < D
    first, last = np.array_split(steady, 2)
    assert abs(first.mean() - last.mean()) < D / 2, "it neither falls nor rises"
    assert abs(np.mean(steady) - np.median(data.start.x[:, 2])) < 2 * D
    assert point.flow_rate is not None
    assert point.flow_rate.relative < 0.12
    marks = marks_of(point)
    low, high = (marks[f"marks.{name}.median"].value for name in ("low", "high"))
    assert 0 < low < high < point.pooled["holdup_time"].value, "the way from a higher plane takes longer"
    (section,) = residence_sections(results, tmp_path)
    table = section.blocks[-1]
    assert isinstance(table, Table)
    assert [row[1:3] for row in table.rows] == [("low", "10"), ("high", "20")]


@pytest.mark.ring
def test_the_mean_residence_time_is_holdup_over_throughput(tmp_path):
    """F2, of a cone in which all grains move; test_measure_residence has it of made-up passages. The window
    begins after the start-up, and has some 16 passages of each grain."""
    asked = define(
        name="cone",
        grains={"shape": "sphere", "diameter": "3 mm", "density": "2500 kg/m^3", "count": 250},
        contact={"law": "hertz-mindlin", "shear_modulus": "1 MPa", "poisson_ratio": 0.25, "friction": 0.3}
        | {"restitution": 0.4, "rolling_friction": 0.01},
        container={"kind": "conical-silo", "diameter": "30 mm", "height": "70 mm", "angle": "20 deg"}
        | {"orifice": "16 mm"},
        feed={"kind": "reinject"},
        numerics={"dt": "20 us", "steps_per_beat": 500},
        stop={"max_time": "2 s"},
        replicates=1,
        measure=["flow_rate", "residence"],
    )
    Runner(asked, LabFolder(tmp_path), Backend(wide=True)).run()
    (point,) = analyse(asked, finished(Catalogue(tmp_path), asked, "numba")).points
    evaluation = MEASURES["residence"].evaluate(point.runs[0].run.data(), TimeWindow(0.4, 2.0))
    found = {number.quantity: number.value for number in evaluation.numbers}
    assert found["residence_mean"] == pytest.approx(found["holdup_time"], rel=5e-3)
    assert found["peclet"] > 20, "nearly plug flow"
