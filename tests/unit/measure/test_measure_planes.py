"""Mass flow rates through planes, of masses above them made by hand."""

import math

import numpy as np
import pytest

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Above, Crossing
from labbook.measure import MEASURES, MeasureError, RunData
from labbook.scene import ConicalSilo, Feed, HertzMindlin, Packing, Scene, Spheres
from labbook.scene.container_shape import CountingPlane
from labbook.study.schema import Window

MEASURE = MEASURES["planes"]
N, RATE, WINDOW = 1200, 600.0, Window(start=0.1, end=0.5)
D = 3e-3
MASS = 2500 * math.pi / 6 * D**3
PLANES = CountingPlane(name="middle", z=0.1), CountingPlane(name="pipe", z=-0.05)


def silo(**more) -> Scene:
    return Scene(
        grains=Spheres(diameter=D, density=2500, count=N),
        contact=HertzMindlin(shear_modulus=1e7, poisson_ratio=0.25),
        container=ConicalSilo(diameter=0.1, height=0.4, angle=0.6, orifice=0.03, sink=-0.1, planes=PLANES),
        **more,
    )


def by_hand(outcome="finished", every=0.02, left=900) -> RunData:
    """Grains leave evenly, RATE a second; half of them through the upper plane, and all 0.1 s later through the lower
    one, above which 200 grains stay for ever."""
    start = Packing(x=np.zeros((N, 3)), v=np.zeros((N, 3)), omega=np.zeros((N, 3)))
    ids = np.arange(left)
    zero = np.zeros(left)
    crossing = {"time": (1 + ids) / RATE, "id": ids, "x": zero, "y": zero, "z": zero}
    time = np.arange(every, 2.0, every)
    upper = N / 2 - np.minimum(RATE / 2 * time, N / 2)
    lower = N - np.minimum(RATE * np.maximum(time - 0.1, 0.0), N - 200)
    mass = np.column_stack([upper, lower]).ravel() * MASS
    above = {"time": np.repeat(time, 2), "plane": np.tile([0, 1], len(time)), "mass": mass}
    tables = {"crossing": crossing, "above": above}
    return RunData(silo(), Numerics(dt=1e-5), 1, start, outcome, 2.0, tables)


def test_each_plane_has_its_flow_rate_and_the_mass_below():
    found = {one.quantity: one for one in MEASURE.evaluate(by_hand(), WINDOW).numbers}
    assert found.keys() == {"flow_rate_middle", "mass_below_middle", "flow_rate_pipe", "mass_below_pipe"}
    assert found["flow_rate_middle"].value == pytest.approx(RATE / 2 * MASS, rel=1e-9)
    assert found["flow_rate_pipe"].value == pytest.approx(RATE * MASS, rel=1e-9)
    assert found["mass_below_middle"].value == pytest.approx((N / 2 + RATE / 2 * 1.98) * MASS, rel=1e-9)
    assert found["mass_below_pipe"].value == pytest.approx((N - 200) * MASS, rel=1e-9)
    assert found["flow_rate_pipe"].error < 1e-9


def test_the_error_is_that_of_the_scatter_over_the_window():
    run, rng = by_hand(), np.random.default_rng(1)
    run.tables["above"]["mass"][:] += rng.normal(0, 3 * MASS, len(run.tables["above"]["mass"]))
    found = {one.quantity: one for one in MEASURE.evaluate(run, WINDOW).numbers}
    rate = found["flow_rate_pipe"]
    assert rate.value == pytest.approx(RATE * MASS, abs=4 * 3 * MASS * math.sqrt(2) / 0.8)
    assert 0 < rate.error < 0.05 * RATE * MASS


def test_a_clogged_run_has_rates_of_its_own_and_few_samples_none():
    clogged = {one.quantity for one in MEASURE.evaluate(by_hand("clogged"), WINDOW).numbers}
    assert clogged >= {"flow_rate_middle_flowing", "mass_below_pipe"}
    assert clogged <= {one.name for one in MEASURE.quantities(silo())}
    few = {one.quantity: one for one in MEASURE.evaluate(by_hand(every=0.3), WINDOW).numbers}
    assert math.isnan(few["flow_rate_pipe"].value)
    assert "lower numerics.steps_per_beat" in few["flow_rate_pipe"].note


def test_it_asks_for_planes_that_nothing_is_fed_above():
    with pytest.raises(MeasureError, match=r"container\.planes has none"):
        MEASURE.check(
            silo().model_copy(update={"container": ConicalSilo(diameter=0.1, height=0.4, angle=0.6, orifice=0.03)})
        )
    with pytest.raises(MeasureError, match="leave feed out"):
        MEASURE.check(silo(feed=Feed(kind="reinject")))
    crossing, above = MEASURE.probes(silo(), Numerics(dt=1e-5))
    assert crossing == Crossing(0.0)
    assert isinstance(above, Above)
    assert above.planes == (0.1, -0.05)
