"""Probability of a stop in a real layer over a slot, against what must not change it, and a clog that lasts.

The layer of studies/clogging-layer.yaml with fewer grains. Numbers of longer runs are in docs/verification.md.
"""

import math

import numpy as np
import pytest

pytest.importorskip("numba")

from labbook_numba import Backend
from scipy.stats import binomtest
from toy_results import analyse

from labbook.lab import Catalogue, LabFolder
from labbook.measure.clogging import PROBABILITY
from labbook.plan.coverage import finished
from labbook.run.runner import Runner
from labbook.stats.rates import PooledRate
from labbook.study import define

pytestmark = [pytest.mark.compiles, pytest.mark.ring]
GRAINS = {"shape": "sphere", "diameter": "3 mm", "density": "2500 kg/m^3", "count": 150}
LAW = {"law": "hertz-mindlin", "shear_modulus": "2 MPa", "poisson_ratio": 0.25, "friction": 0.5} | {
    "restitution": 0.5,
    "rolling_friction": 0.01,
}
HOPPER = {"kind": "wedge-hopper", "width": "30 mm", "height": "160 mm", "thickness": "1.01 d", "orifice": "2.5 d"}
WAIT = 20 * math.sqrt(3e-3 / 9.81)
"""Time without a grain after which the flow counts as stopped [s]."""
CHANGES = {
    "twice the wait": {"restart": {"kind": "break", "wait": f"{2 * WAIT} s"}},
    "half as high again": {"grains": GRAINS | {"count": 225}},
    "walls of half the friction": {"walls": {"all": {"friction": 0.25}}},
    "twice as stiff": {"contact": LAW | {"shear_modulus": "4 MPa"}},
}
"""What must not change q by much: the wait for a stop, the height of the bed, friction of walls, and stiffness."""


def probability(folder, beds: int, seconds: float, **changes) -> PooledRate:
    """Stops over grains in a fed layer whose arches are broken."""
    keys = {"grains": GRAINS, "contact": LAW, "container": HOPPER, "restart": {"kind": "break"}} | changes
    asked = define(
        name="layer", replicates=beds, feed={"kind": "reinject"}, stop={"max_time": f"{seconds} s"},
        measure=["flow_rate", "clogging"], **keys,
    )  # fmt: skip
    summary = Runner(asked, LabFolder(folder), Backend(wide=True)).run()
    assert summary.done == beds, summary
    (point,) = analyse(asked, finished(Catalogue(folder), asked, "numba")).points
    q = point.pooled[PROBABILITY]
    assert isinstance(q, PooledRate)
    return q


@pytest.fixture(scope="module")
def plain(tmp_path_factory) -> PooledRate:
    return probability(tmp_path_factory.mktemp("plain"), beds=2, seconds=10)


@pytest.mark.parametrize("change", CHANGES)
def test_the_probability_of_a_stop_does_not_depend_on(change, plain, tmp_path):
    """With twenty stops each only a factor of two is seen: that of two counts, given their sum (binomial, p > 0.01)."""
    changed = probability(tmp_path, beds=2, seconds=10 if change != "twice the wait" else 20, **CHANGES[change])
    assert min(plain.events, changed.events) >= 10
    share = plain.exposure / (plain.exposure + changed.exposure)
    both = plain.events + changed.events
    assert binomtest(int(plain.events), int(both), share).pvalue > 0.01, (plain, changed)


def test_a_clogged_bed_stays_clogged_at_half_the_step(tmp_path):
    """Arches that the springs of a law let creep would break by themselves: nothing leaves for 10 s."""
    asked = define(
        name="clog", grains=GRAINS, contact=LAW, container=HOPPER | {"orifice": "3 d"}, replicates=1,
        numerics={"dt": "9 us"}, stop={"max_time": "14 s", "stall": "10 s"}, measure=["flow_rate", "clogging"],
    )  # fmt: skip
    summary = Runner(asked, LabFolder(tmp_path), Backend(wide=True)).run()
    assert summary.done == 1
    (point,) = analyse(asked, finished(Catalogue(tmp_path), asked, "numba")).points
    (run,) = point.runs
    assert run.outcome == "clogged"
    times = np.sort(run.run.data().tables["crossing"]["time"])
    assert len(times) > 0
    assert np.diff(times, prepend=0.0).max() < 2 * WAIT, "no arch broke"
