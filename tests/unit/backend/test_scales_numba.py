"""A discharge in low gravity and one of boulders, from the study to its numbers: those of the usual one, scaled.

Round-off and the smallest speed that kernels tell from zero differ, so that after some collisions grains take other
paths. Flow rates of windows of 90 grains then scatter by some 10 %; tolerances are three times that.
"""

from typing import Any

import numpy as np
import pytest

pytest.importorskip("numba")

from labbook_numba import Backend
from toy_results import analyse
from toy_similar import Similar, asked

from labbook.lab import Catalogue, LabFolder
from labbook.measure.recorded import FlowPattern
from labbook.plan.coverage import finished
from labbook.run.runner import Runner
from labbook.stats import Measured

pytestmark = [pytest.mark.compiles, pytest.mark.slow, pytest.mark.ring]
MEASURES = ["flow_rate", "packing", "outlet_profiles", "ledger"]


def discharged(folder, by: Similar) -> tuple[Any, dict[str, Measured]]:
    study = asked(by, measure=MEASURES, record={}, fill={"friction": 0.01})
    lab = folder / f"{by.L}-{by.gravity}"
    summary = Runner(study, LabFolder(lab), Backend(wide=True)).run()
    assert list(summary.tally.ran.values()) == ["finished"], summary.tally.failed
    (point,) = analyse(study, finished(Catalogue(lab), study, "numba")).points
    (run,) = point.runs
    assert not run.suspect
    pattern = {one.quantity: one for one in run.evaluation(FlowPattern()).numbers}
    assert pattern
    return run, {**run.measured, **pattern}


@pytest.fixture(scope="module")
def usual(tmp_path_factory):
    return discharged(tmp_path_factory.mktemp("usual"), Similar(1.0, 1.0))


@pytest.mark.parametrize("by", [Similar(1.0, 2.0**-20), Similar(2.0**12, 1.0)], ids=["low gravity", "large"])
def test_a_similar_discharge_gives_the_scaled_numbers(usual, tmp_path, by):
    (run, expected), (other, found) = usual, discharged(tmp_path, by)
    for name in ("flow_rate", "grain_rate", "outlet_velocity", "orifice.v_z"):
        one = expected[name]
        assert found[name].value == pytest.approx(one.value * by.of(one.unit), rel=0.3), name
        assert "gap" not in found[name].note + one.note
    assert found["packing_fraction"].value == pytest.approx(expected["packing_fraction"].value, abs=0.02)
    assert found["outlet_closure"].value == pytest.approx(1, abs=0.2)
    every = [float(np.diff(np.unique(one.frames()["time"])).min()) for one in (run, other)]
    assert every[1] == pytest.approx(every[0] * by.T, rel=1e-6), "frames lie as many beats apart"
