"""Avalanches of runs made by hand: what is counted, and what is censored."""

import math

import numpy as np
import pytest

from labbook.backend.numerics import Numerics
from labbook.measure import MEASURES, MeasureError, RunData
from labbook.measure.clogging import Avalanches, transient
from labbook.scene import Box, CylinderSilo, Feed, HertzMindlin, Scene, Spheres, WedgeHopper
from labbook.scene.container import Container
from labbook.scene.packing import Packing
from labbook.study.schema import Window

D, N = 3e-3, 1000
MEASURE = MEASURES["clogging"]
WINDOW = Window(start=0.15, end=0.6)
HOPPER = WedgeHopper(width=0.1, height=0.4, thickness=1.01 * D, orifice=4 * D)
MASS = 2500 * math.pi / 6 * D**3


def scene_of(container: Container = HOPPER, feed=None):
    grains = Spheres(diameter=D, density=2500, count=N)
    return Scene(
        grains=grains, contact=HertzMindlin(shear_modulus=1e7, poisson_ratio=0.25), container=container, feed=feed
    )


def run_of(left, outcome="clogged", feed=None, restarts=(), rate=100.0):
    """`left` grains leave evenly, the first at once, at half a metre per second."""
    times = np.arange(left) / rate
    table = {"id": np.arange(left) % N, "time": times, "vz": np.full(left, -0.5)}
    tables = {"crossing": table} | ({"restart": {"time": np.asarray(restarts)}} if len(restarts) else {})
    start = Packing(*np.zeros((3, N, 3)))
    return RunData(scene_of(feed=feed), Numerics(dt=1e-5), 1, start, outcome, 20.0, tables)


def measured(run, window=WINDOW):
    evaluation = MEASURE.evaluate(run, window)
    found = Avalanches.of(evaluation.arrays)
    assert found is not None
    return {one.quantity: one for one in evaluation.numbers}, found


def test_grains_in_the_half_disc_or_half_ball_of_the_outlet_are_transient():
    """0.3 (D/d)^2 in a layer, as deep as the slot is, and 0.3 (D/d)^3 over a hole; twice as many after an opening."""
    assert transient(scene_of()) == 5
    assert transient(scene_of(), opening=True) == 10
    assert transient(scene_of(CylinderSilo(diameter=0.05, height=0.4, orifice=4 * D))) == 20
    deep = WedgeHopper(width=0.1, height=0.4, thickness=3 * D, orifice=4 * D)
    assert transient(scene_of(deep)) == 15


def test_a_run_that_clogs_has_one_stop():
    numbers, found = measured(run_of(110))
    q = numbers["clogging_probability"]
    assert (q.value, q.n_effective, numbers["clogging_stops"].value) == (0.01, 100, 1)
    assert (found.grains.tolist(), found.stopped.tolist(), found.counted.tolist()) == ([110], [True], [100])
    assert found.mass[0] == pytest.approx(100 * MASS)
    assert found.time[0] == pytest.approx(1.0), "the wait after the last grain does not count"
    assert numbers["outlet_exchange"].value == pytest.approx(100 * D / 0.5)


@pytest.mark.parametrize("outcome", ["finished", "time-limit", "emptied"])
def test_a_run_that_ends_otherwise_is_censored(outcome):
    numbers, found = measured(run_of(110, outcome))
    assert (numbers["clogging_probability"].value, numbers["clogging_probability"].n_effective) == (0.0, 100)
    assert not found.stopped.any()


def test_the_end_of_the_window_censors_a_bed_that_runs_out():
    """A heap that is left in a corner is no arch."""
    numbers, found = measured(run_of(700))
    assert (numbers["clogging_probability"].value, numbers["clogging_probability"].n_effective) == (0.0, 590)
    assert found.grains.tolist() == [600]
    fed, _ = measured(run_of(700, feed=Feed(kind="reinject")), Window().endless())
    assert (fed["clogging_stops"].value, fed["clogging_probability"].n_effective) == (1, 690)


def test_restarts_divide_a_run_into_avalanches():
    """Restarts after 100, 150 and 153 grains; the last avalanche is censored, or ends in vain."""
    fed, restarts = Feed(kind="reinject"), [0.995, 1.495, 1.525]
    numbers, found = measured(run_of(200, "time-limit", fed, restarts), Window().endless())
    assert found.grains.tolist() == [100, 50, 3, 47]
    assert found.stopped.tolist() == [True, True, True, False]
    assert found.counted.tolist() == [90, 45, 0, 42]
    assert numbers["clogging_stops"].value == 2, "one stopped within its transient"
    assert numbers["clogging_probability"].n_effective == 177
    assert found.time.sum() == pytest.approx(1.77)
    _, vain = measured(run_of(153, "clogged", fed, restarts), Window().endless())
    assert vain.grains.tolist() == [100, 50, 3]


def test_a_run_without_a_grain_is_a_stop_within_the_transient():
    numbers, found = measured(run_of(0))
    assert math.isnan(numbers["clogging_probability"].value)
    assert "longer than the transient" in numbers["clogging_probability"].note
    assert (found.grains.tolist(), found.stopped.tolist()) == ([0], [True])


def test_a_container_without_an_outlet_is_refused():
    with pytest.raises(MeasureError, match="needs outlets of a known width, and the container \\(box\\) has none"):
        MEASURE.check(scene_of(Box(width=0.1, depth=0.1, height=0.1)))
