"""Residence times: of silos with residence times drawn from known laws, and of beds that leave in a known order."""

import math
from dataclasses import replace

import numpy as np
import pytest

from labbook.backend.numerics import Numerics
from labbook.measure import MEASURES, MeasureError, RunData
from labbook.measure.marks import Marks
from labbook.measure.regime import FlowRegime
from labbook.measure.residence import ResidenceCurve, ResidenceMap, durations, layers_of, peclet
from labbook.measure.steady import TimeWindow
from labbook.scene import Box, ConicalSilo, HertzMindlin, Packing, Scene, Spheres, WedgeHopper
from labbook.scene.container_shape import CountingPlane
from labbook.scene.feed import Feed

MEASURE = MEASURES["residence"]
D, N = 3e-3, 1000
CONE = ConicalSilo(diameter=0.06, height=0.3, angle=0.5, orifice=0.02)
FED = TimeWindow(0.5, math.inf)
RNG = np.random.default_rng(8)


def scene(container=CONE, fed=True, n=N) -> Scene:
    return Scene(
        grains=Spheres(diameter=D, density=2500, count=n),
        contact=HertzMindlin(shear_modulus=1e7, poisson_ratio=0.25),
        container=container,
        feed=Feed(kind="reinject") if fed else None,
    )


def fed_run(times: np.ndarray, end: float, still: int = 0) -> RunData:
    """Grain k of N, of which `still` do not move, passes at the sums of times[k] that come before `end` [s]."""
    passages = np.cumsum(times, axis=1)
    grain = np.repeat(np.arange(len(times)), times.shape[1])
    seen = passages.ravel() < end
    n = len(times) + still
    start = Packing(x=RNG.uniform(0, 0.05, (n, 3)), v=np.zeros((n, 3)), omega=np.zeros((n, 3)))
    table = {"time": passages.ravel()[seen], "id": grain[seen]}
    return RunData(scene(n=n), Numerics(dt=1e-5), 1, start, "finished", end, {"crossing": table})


def numbers(run: RunData, window=FED) -> dict[str, float]:
    return {one.quantity: one.value for one in MEASURE.evaluate(run, window).numbers}


def stationary(draw, end: float, n: int = N) -> np.ndarray:
    """Times between passages, the first of which began at any time before the opening, as in a steady state."""
    times = draw((n, int(3 * end)))
    times[:, 0] = RNG.uniform(0, 1, n) * times[np.arange(n), RNG.integers(0, 100, n)]
    return times


def test_plug_flow_has_one_residence_time():
    """All grains stay 2.5 s: mean and hold-up over throughput are equal, and F is a step."""
    times = np.full((N, 40), 2.5)
    times[:, 0] = 2.5 * (np.arange(N) + 0.5) / N
    run = fed_run(times, 60.0)
    found = numbers(run)
    assert found["residence_mean"] == pytest.approx(2.5, rel=1e-9)
    assert found["holdup_time"] == pytest.approx(2.5, rel=1e-3)
    assert found["dead_fraction"] == pytest.approx(0, abs=1e-3)
    assert found["residence_variance"] == pytest.approx(0, abs=1e-9)
    curve = ResidenceCurve.of(MEASURE.evaluate(run, FED))
    assert curve is not None
    assert curve.part[curve.age < 2.49].max() == 0
    assert curve.part[-1] == 1


def test_the_mean_is_holdup_over_throughput():
    """F2, of a spread like that of 5 mixed tanks: to 1e-3. The window has 200 passages of each grain; passages and
    times are of the same grains, and differ at its ends only."""
    found = numbers(fed_run(stationary(lambda shape: RNG.gamma(5.0, 0.2, shape), 205.0, 2000), 205.0))
    assert found["residence_mean"] == pytest.approx(found["holdup_time"], rel=1e-3)
    assert found["residence_mean"] == pytest.approx(1.0, rel=3e-3)
    assert found["residence_variance"] == pytest.approx(0.2, rel=0.02)
    assert found["peclet"] == pytest.approx(peclet(0.2), rel=0.03)


def test_short_windows_do_not_favour_short_times():
    """The window is 4 times as long as the mean: the mean of the times that had ended would be a quarter too small."""
    drawn = np.random.default_rng(3).gamma(2.0, 0.5, (4000, 60))
    run = fed_run(drawn, 5.0)
    table = run.tables["crossing"]
    lengths, ended = durations(table["id"], table["time"], 1.0, 5.0)
    assert lengths[ended].mean() < 0.85
    # four standard errors of 16 000 times with a spread of 0.7
    assert numbers(run, TimeWindow(1.0, 5.0))["residence_mean"] == pytest.approx(1.0, abs=4 * 0.7 / 126)


def test_grains_that_stand_still_are_dead():
    run = fed_run(stationary(lambda shape: RNG.gamma(5.0, 0.2, shape), 60.0), 60.0, still=250)
    assert numbers(run)["dead_fraction"] == pytest.approx(0.2, abs=5e-3)


def test_runs_that_are_too_short_give_no_number():
    found = MEASURE.evaluate(fed_run(RNG.gamma(5.0, 0.2, (N, 60)), 1.4), TimeWindow(0.2, 1.4)).numbers
    assert {one.quantity for one in found} == {one.name for one in MEASURE.declared}
    assert math.isfinite(found[0].value)
    assert all(math.isnan(one.value) and "let the run last longer" in one.note for one in found[1:])
    few = MEASURE.evaluate(fed_run(np.full((10, 40), 2.5), 5.0), FED).numbers
    assert all(math.isnan(one.value) for one in few)


@pytest.mark.parametrize(("pe", "expected"), [(1.0, 2 - 2 * (1 - math.exp(-1))), (100.0, 0.02 - 2e-4)])
def test_peclet_inverts_the_closed_vessel(pe, expected):
    assert peclet(expected) == pytest.approx(pe, rel=1e-6)
    assert math.isnan(peclet(1.2))


def batch(container, left: np.ndarray, x: np.ndarray) -> RunData:
    """Grains in the rows `left` leave one after another, 1000 a second."""
    n = len(x)
    start = Packing(x=x, v=np.zeros_like(x), omega=np.zeros_like(x), ids=np.arange(n)[::-1])
    table = {"time": np.arange(1, len(left) + 1) / 1000, "id": n - 1 - left}
    return RunData(scene(container, fed=False, n=n), Numerics(dt=1e-5), 1, start, "finished", 9.0, {"crossing": table})


@pytest.mark.parametrize("planar", [False, True])
def test_a_bed_that_sinks_as_a_whole_leaves_layer_by_layer(planar):
    """First in, first out: the time to leave grows with the height, and each layer fills its fifth of the outflow."""
    n = 5000
    x = np.random.default_rng(1).uniform([-0.03, -0.0015, 0], [0.03, 0.0015, 0.1], (n, 3))
    hopper = WedgeHopper(width=0.06, height=0.3, thickness=1.01 * D, orifice=0.02)
    run = batch(hopper if planar else CONE, np.argsort(x[:, 2]), x)
    found = MEASURE.evaluate(run, FED)
    assert found.numbers == ()
    field, layers = ResidenceMap.of(found), layers_of(found)
    assert field is not None
    assert layers is not None
    assert field.grains.sum() == n
    assert (field.across[0] < 0) == planar
    middle = (field.z[1:] + field.z[:-1]) / 2
    full = (middle > field.z[0]) & (field.z[1:] <= 0.1)
    # a cell is 9 mm high, of which half is 0.45 s; its median is that of some 80 grains
    expected = np.broadcast_to(middle[full, None] / 0.1 * n / 1000, field.median[full].shape)
    enough = field.grains[full] > 20
    assert field.median[full][enough] == pytest.approx(expected[enough], abs=0.2)
    edges = layers.fraction * 5
    overlap = np.clip(
        np.minimum(edges[1:], np.arange(1, 6)[:, None]) - np.maximum(edges[:-1], np.arange(5)[:, None]), 0, 1
    )
    assert layers.share == pytest.approx(overlap / np.diff(edges), abs=1e-6)


def test_cells_that_have_not_left_are_infinite():
    x = np.random.default_rng(2).uniform([-0.03, -0.03, 0], [0.03, 0.03, 0.09], (4000, 3))
    still = np.hypot(x[:, 0], x[:, 1]) > 0.018
    left = np.flatnonzero(~still)
    field = ResidenceMap.of(MEASURE.evaluate(batch(CONE, left, x), FED))
    assert field is not None
    assert np.isinf(field.median[:, field.across[:-1] >= 0.018 - 1e-9][field.grains[:, 2:] > 0]).all()
    assert np.isfinite(field.median[:, :2][field.grains[:, :2] > 0]).all()


def test_scenes_and_runs_without_residence_times():
    box = Scene(
        grains=Spheres(diameter=D, density=2500, count=N),
        contact=HertzMindlin(shear_modulus=1e7, poisson_ratio=0.25),
        container=Box(width=0.05, depth=0.05, height=0.1),
    )
    with pytest.raises(MeasureError, match="outlet"):
        MEASURE.check(box)
    run = fed_run(np.full((N, 4), 2.5), 6.0)
    with pytest.raises(MeasureError, match="no crossings"):
        MEASURE.evaluate(replace(run, tables={}), FED)
    assert MEASURE.quantities(scene(fed=False)) == ()


@pytest.mark.parametrize(("planar", "slow"), [(False, 0.2), (True, 0.2), (False, 1.0)])
def test_the_mass_flow_index_of_a_known_field(planar, slow):
    """v_z falls linearly from 1 in the middle to `slow` at the wall, R. Means over the outermost d of grains that are
    even in the disc (or over the width), and over the innermost 1.5 d, follow by integration."""
    n, R = 20_000, 0.03
    rng = np.random.default_rng(5)
    x = rng.uniform([-R, -R, 0], [R, R, 0.1], (n, 3))
    if not planar:
        x = x[np.hypot(x[:, 0], x[:, 1]) < R]
    hopper = WedgeHopper(width=2 * R, height=0.3, thickness=2 * R, orifice=0.02)
    run = batch(hopper if planar else CONE, np.arange(len(x)), x)
    off = np.abs(x[:, 0]) if planar else np.hypot(x[:, 0], x[:, 1])
    speed = -0.01 * (1 - (1 - slow) * off / R)
    ids, one = np.arange(len(x))[::-1], np.ones(len(x))
    times = np.linspace(2, 4, 5)  # so that there are 50 grains in the middle of a band
    frames = [{"id": ids, "time": t * one, "x": x[:, 0], "y": x[:, 1], "z": x[:, 2], "vz": speed} for t in times]
    recorded = {name: np.concatenate([frame[name] for frame in frames]) for name in frames[0]}
    found = FlowRegime().evaluate(replace(run, recorded=lambda: recorded), FED)
    weight = 0 if planar else 1

    def mean(a: float, b: float) -> float:
        """Of 1 - (1 - slow) r/R from r = a to b, where r^weight dr grains are."""
        r = np.linspace(a, b, 2001)
        return float(np.average(1 - (1 - slow) * r / R, weights=r**weight))

    expected = mean(R - D, R) / mean(0, 1.5 * D)
    (index,) = [one.value for one in found.numbers if one.quantity == "regime.mass_flow_index"]
    assert index == pytest.approx(expected, rel=0.02), "the outermost grain is within 2 % of the wall"
    middle = (found.arrays["height"] > 0.006) & (found.arrays["height"] < 0.094)
    assert found.arrays["index"][middle] == pytest.approx(np.full(middle.sum(), expected), rel=0.03)


def test_material_that_has_not_moved_when_half_has_left():
    """Half of the grains leave within 2 s; of the others a quarter has moved by 0.05 d, three quarters by 0.2 d."""
    x = np.random.default_rng(6).uniform([-0.02, -0.02, 0], [0.02, 0.02, 0.09], (4000, 3))
    run = batch(CONE, np.arange(3000), x)
    ids = np.arange(4000)[::-1]
    rows, rest = np.arange(4000), np.arange(2000, 4000)
    moved = x - [0, 0, 1] * np.where(rows % 4 == 0, 0.05 * D, 0.2 * D)[:, None]
    parts = [(0.5, rows), (2.0, rest), (2.5, rest[500:])]
    recorded = {"time": np.concatenate([np.full(len(part), t) for t, part in parts])}
    recorded["id"] = np.concatenate([ids[part] for _, part in parts])
    recorded |= {a: np.concatenate([moved[part, k] for _, part in parts]) for k, a in enumerate("xyz")}
    recorded["vz"] = np.full(len(recorded["id"]), -0.1)
    found = FlowRegime().evaluate(replace(run, recorded=lambda: recorded), FED)
    (still,) = [one for one in found.numbers if one.quantity == "regime.still"]
    assert still.value == pytest.approx(0.125)
    assert "2 s" in still.window


def test_marks_at_a_plane_measure_the_time_to_the_outlet():
    """Every grain sinks at 20 mm/s from 90 mm, returns at once to the top, and shakes by 1 mm about its way.

    From the plane at 50 mm it takes 2.5 s; the first passage may be earlier by 0.05 s."""
    planes = (CountingPlane(name="middle", z=0.05), CountingPlane(name="pipe", z=-0.05))
    speed, period, end = 0.02, 4.5, 40.0
    phase = RNG.uniform(0, period, N)
    passages = (np.arange(9)[:, None] + 1) * period - phase
    frames = np.arange(0, end, 0.05)
    height = 0.09 - speed * ((frames[:, None] + phase) % period) + 0.001 * RNG.uniform(-1, 1, (len(frames), N))
    recorded = {"time": np.repeat(frames, N), "id": np.tile(np.arange(N), len(frames)), "z": height.ravel()}
    seen = passages < end
    table = {"time": passages[seen], "id": np.broadcast_to(np.arange(N), passages.shape)[seen]}
    silo = CONE.model_copy(update={"planes": planes})
    start = Packing(x=RNG.uniform(0, 0.05, (N, 3)), v=np.zeros((N, 3)), omega=np.zeros((N, 3)))
    run = RunData(scene(silo), Numerics(dt=1e-5), 1, start, "finished", end, {"crossing": table}, lambda: recorded)
    found = {one.quantity: one for one in Marks().evaluate(run, FED).numbers}
    names = {"marks.middle", "marks.middle.median", "marks.middle.variance"}
    assert set(found) == names, "a plane below the outlet marks nothing"
    assert found["marks.middle.median"].value == pytest.approx(2.525, abs=0.025)
    assert found["marks.middle"].value == pytest.approx(2.525, abs=0.025)
    assert found["marks.middle.variance"].value < 1e-3
    short = Marks().evaluate(run, TimeWindow(4.0, 6.0)).numbers
    assert all(math.isnan(one.value) and "fewer than 60 grains" in one.note for one in short)
    assert Marks().evaluate(replace(run, recorded=lambda: None), FED).numbers == ()
