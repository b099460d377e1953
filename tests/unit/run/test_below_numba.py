"""A cone with a pipe and a bin below it, from a study to its numbers, on the CPU backend."""

import pytest

pytest.importorskip("numba")

from labbook_numba import Backend
from toy_results import analyse

from labbook.lab import Catalogue, LabFolder
from labbook.plan.coverage import finished
from labbook.run.runner import Runner
from labbook.study import define

pytestmark = [pytest.mark.compiles, pytest.mark.slow]
COUNT = 300
GRAINS = {"shape": "sphere", "diameter": "3 mm", "density": "2500 kg/m^3", "count": COUNT}
LAW = {"law": "hertz-mindlin", "shear_modulus": "1 MPa", "poisson_ratio": 0.25, "friction": 0.5} | {
    "restitution": 0.2,
    "rolling_friction": 0.0,
}
PIPE = {"name": "pipe", "shape": {"kind": "frustum", "lower": ["8 mm", "-30 mm"], "upper": ["8 mm", "0 mm"]}}
SIDE = {"name": "bin", "shape": {"kind": "frustum", "lower": ["30 mm", "-80 mm"], "upper": ["30 mm", "-40 mm"]}}
FLOOR = {"name": "floor", "shape": {"kind": "frustum", "lower": ["0 mm", "-80 mm"], "upper": ["30 mm", "-80 mm"]}}
PLANES = [{"name": "within", "z": "-20 mm"}, {"name": "under", "z": "-81 mm"}]
SILO = {"kind": "conical-silo", "diameter": "36 mm", "height": "120 mm", "angle": "40 deg", "orifice": "16 mm"}


def check_flow_rate(asked, lab, rate: float) -> None:
    """Run a study of one run and compare its flow rate with `rate` [kg/s], to four standard errors."""
    summary = Runner(asked, LabFolder(lab), Backend(wide=True)).run()
    assert summary.done == 1, summary.tally.failed
    (point,) = analyse(asked, finished(Catalogue(lab), asked, "numba")).points
    flow = point.runs[0].measured["flow_rate"]
    assert flow.error < 0.05 * rate, "so that this is a test"
    assert flow.value == pytest.approx(rate, abs=4 * flow.error)


def test_grains_flow_through_a_pipe_and_stay_in_a_bin(tmp_path):
    """What flows through the pipe is what flows out, and all of it lies in the bin in the end: none left the scene."""
    below = {"parts": [PIPE, SIDE, FLOOR], "sink": "below-parts", "planes": PLANES}
    asked = define(
        name="below", grains=GRAINS, contact=LAW, numerics={"dt": "20 us", "steps_per_beat": 100}, replicates=1,
        container=SILO | below, fill={"kind": "dense"}, measure=["flow_rate", "planes"],
        window={"start": 0.1, "end": 0.8}, stop={"discharged": 1},
    )  # fmt: skip
    summary = Runner(asked, LabFolder(tmp_path), Backend(wide=True)).run()
    assert summary.done == 1, summary.tally.failed
    (point,) = analyse(asked, finished(Catalogue(tmp_path), asked, "numba")).points
    (run,) = point.runs
    flow, pipe = run.measured["flow_rate"], run.measured["flow_rate_within"]
    assert run.outcome == "finished"
    assert pipe.value == pytest.approx(flow.value, abs=4 * (flow.error + pipe.error))
    assert flow.error < 0.1 * flow.value, "so that this is a test"
    record = run.run.record
    assert record.ledger is not None
    assert (record.ledger.left, record.ledger.lost, record.ledger.outside) == (COUNT, 0, 0)
    within, under = run.run.data().tables["above"]["grains"].reshape(-1, 2).T
    assert within[0] == COUNT
    assert within[-1] < 0.2 * COUNT
    assert (under == COUNT).all()
    assert run.measured["mass_below_under"].value == pytest.approx(0, abs=1e-12)


@pytest.mark.ring
def test_a_silo_that_starves_lets_out_what_enters(tmp_path):
    """The outlet is wide: the bed is gone soon, and the flow rate is that of the inflow, to its error."""
    rate = 0.02
    stream = {"rate": f"{rate} kg/s", "low": ["-12 mm", "-12 mm", "80 mm"], "high": ["12 mm", "12 mm", "110 mm"]}
    asked = define(
        name="starved", grains=GRAINS | {"count": 200}, contact=LAW, replicates=1, fill={"kind": "dense"},
        numerics={"dt": "20 us", "steps_per_beat": 100}, container=SILO | {"orifice": "20 mm"},
        feed={"kind": "rate", "stream": stream}, window={"start": 1}, stop={"max_time": "2 s"},
    )  # fmt: skip
    check_flow_rate(asked, tmp_path, rate)


@pytest.mark.ring
def test_an_empty_silo_lets_out_what_a_stream_brings(tmp_path):
    """The outlet is wide, so that nothing is held back: the flow rate is that of the stream, to its error."""
    rate = 0.02
    stream = {"rate": f"{rate} kg/s", "low": ["-12 mm", "-12 mm", "40 mm"], "high": ["12 mm", "12 mm", "70 mm"]}
    asked = define(
        name="fed-empty", grains=GRAINS | {"count": 600}, contact=LAW, replicates=1,
        numerics={"dt": "20 us", "steps_per_beat": 100}, container=SILO | {"orifice": "24 mm"},
        fill={"kind": "stream", "until": "placed", "stream": stream}, window={"start": 0.2, "end": 0.9},
        stop={"discharged": 0.95, "max_time": "3 s"},
    )  # fmt: skip
    check_flow_rate(asked, tmp_path, rate)
