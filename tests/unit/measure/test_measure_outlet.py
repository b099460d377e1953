"""Profiles along an outlet, of grains whose motion is known."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Crossing, Slab
from labbook.measure import MEASURES, MeasureError, RunData
from labbook.measure.outlet import BINS, outlet_profile
from labbook.measure.starts import STARTS, WindowStarts
from labbook.measure.steady import outflow
from labbook.scene import Box, HertzMindlin, Scene, Spheres, WedgeHopper
from labbook.scene.packing import Packing

D, ORIFICE, G = 3e-3, 0.03, 9.81
R, RADIUS = ORIFICE / 2, D / 2
NUMERICS = Numerics(dt=1e-6, steps_per_beat=1000)
MEASURE = MEASURES["outlet_profiles"]


class Window:
    start, end, timed = 0.15, 0.6, False


def scene_of(count, gap=None):
    hopper = WedgeHopper(width=0.1, height=0.4, thickness=1.01 * D, orifice=ORIFICE, gap=gap)
    grains = Spheres(diameter=D, density=2500, count=count)
    return Scene(grains=grains, contact=HertzMindlin(shear_modulus=1e8, poisson_ratio=0.25), container=hopper)


def run_of(times, x, speed, gap=None, gravity=G, beat=1e-3):
    """Grains that fall freely past x with `speed` at z = 0, each at its own time; frames every beat [s]."""
    numerics = Numerics(dt=1e-6, steps_per_beat=round(beat * 1e6))
    scene = scene_of(len(times), gap)
    rows = []
    reach = (speed - np.sqrt(np.maximum(speed**2 - 2 * gravity * RADIUS, 0))) / gravity if gravity else RADIUS / speed
    first = np.ceil((times - reach) / beat).astype(int)
    for k in range(40):
        frame = first + k
        since = frame * beat - times
        z = -(speed * since + gravity * since**2 / 2)
        seen = (np.abs(z) <= RADIUS) & (speed + gravity * since > 0)
        row = [np.arange(len(x)), frame * numerics.steps_per_beat, frame * beat, x, z, -(speed + gravity * since)]
        rows.append(np.column_stack(row)[seen])
    assert not seen.any(), "frames enough to see every grain leave"
    rows = np.concatenate(rows)
    names = ("id", "step", "time", "x", "z", "vz")
    slab = dict(zip(names, rows[np.random.default_rng(0).permutation(len(rows))].T, strict=True))
    slab["step"] = slab["step"].astype(np.int64)
    crossing = {"id": np.arange(len(times)), "time": times, "x": x, "vz": -speed}
    start = Packing(*np.zeros((3, len(times), 3)))
    tables = {"crossing": crossing, "slab": slab}
    return RunData(scene, numerics, 1, start, "emptied", float(times.max()) + 0.1, tables)


def profile_of(run):
    found = outlet_profile(run, Window())
    assert found is not None
    return found


def passing(n, seed, centre=0.0):
    """Random places between the edges, at a steady pace, slower towards the edges."""
    rng = np.random.default_rng(seed)
    times = 0.05 + (np.arange(n) + rng.uniform(0, 1, n)) / 2000
    x = rng.uniform(-(R - RADIUS), R - RADIUS, n)
    return times, x + centre, 0.2 + 0.4 * (1 - (x / R) ** 2)


def dwell(h, speed):
    """Time that a falling grain takes from z = h to z = -h, at `speed` halfway."""
    up, down = (math.sqrt(speed**2 + 2 * sign * G * h) for sign in (-1, 1))
    return (down - up) / G


def test_profiles_are_those_of_the_motion():
    run = run_of(*passing(40_000, 1))
    found = profile_of(run)
    per_length = 2000 / (2 * (R - RADIUS))

    def of_all(what, at):
        low, high = max(-(R - RADIUS), at - RADIUS), min(R - RADIUS, at + RADIUS)
        value, _ = quad(what, low, high, args=(at,), epsrel=1e-8, points=[at] if low < at < high else None)
        return per_length * value

    def covers(c, at):
        return dwell(math.sqrt(max(RADIUS**2 - (at - c) ** 2, 0)), 0.2 + 0.4 * (1 - (c / R) ** 2))

    def sweeps(c, at):
        return 2 * math.sqrt(max(RADIUS**2 - (at - c) ** 2, 0))

    centres = (found.edges[1:] + found.edges[:-1]) / 2 * R
    inner = slice(3, BINS - 3)  # farther out phi bends within a bin
    phi = [of_all(covers, at) for at in centres[inner]]
    flux = [of_all(sweeps, at) for at in centres[inner]]
    # 18000 grains in the window, of which each bin sees some 3000 in two frames or more each
    np.testing.assert_allclose(found.area_fraction[inner], phi, rtol=0.03)
    np.testing.assert_allclose(found.flux[inner], flux, rtol=0.03)
    assert np.mean(found.area_fraction[inner] / phi) == pytest.approx(1, abs=0.006)
    np.testing.assert_allclose(found.velocity[inner], np.array(flux) / phi, rtol=0.03)


def test_the_speed_at_the_line_alone_would_give_another_area_fraction():
    """What frames see and passages do not: a slow grain gathers speed while its body passes."""
    n, speed = 20_000, 0.18
    times, x, _ = passing(n, 2)
    found = profile_of(run_of(times, x, np.full(n, speed)))
    middle = slice(BINS // 2 - 4, BINS // 2 + 4)
    per_length = 2000 / (2 * (R - RADIUS))
    held, _ = quad(lambda c: 2 * math.sqrt(RADIUS**2 - c**2) / speed, -RADIUS, RADIUS)
    true, _ = quad(lambda c: dwell(math.sqrt(RADIUS**2 - c**2), speed), -RADIUS, RADIUS)
    assert true / held > 1.05
    assert found.area_fraction[middle].mean() == pytest.approx(per_length * true, rel=0.02)


@pytest.mark.parametrize("beat", [1e-3, 2.5e-3])
def test_the_flow_of_the_profiles_is_the_flow_counted_within_its_error(beat):
    pulls = []
    for seed in range(100):
        _, x, speed = passing(1200, seed)
        times = np.cumsum(np.random.default_rng(seed).exponential(1 / 2000, len(x))) + 0.05
        found = profile_of(run_of(times, x, speed, beat=beat))
        assert found.closure_error < 0.03
        pulls.append((found.closure - 1) / found.closure_error)
    assert abs(np.mean(pulls)) < 4 / math.sqrt(100)
    assert 0.7 < np.std(pulls) < 1.4


def test_uniform_motion_seen_often_closes_to_a_part_in_a_thousand():
    n = 30_000
    times, x, _ = passing(n, 3)
    found = profile_of(run_of(times, x, np.full(n, 0.5), gravity=0.0))
    assert found.closure == pytest.approx(1, abs=max(1e-3, 3 * found.closure_error))
    np.testing.assert_allclose(found.velocity, 0.5, rtol=1e-12)
    np.testing.assert_allclose(found.crossing_velocity[3:-3], 0.5, rtol=1e-12)


def test_the_mean_over_passages_weighs_fast_grains_more():
    n = 20_000
    times, x, _ = passing(n, 4)
    speed = np.where(np.arange(n) % 2, 0.3, 0.9)
    found = profile_of(run_of(times, x, speed, gravity=0.0))
    inner = slice(4, BINS - 4)
    assert found.crossing_velocity[inner].mean() == pytest.approx(0.6, rel=0.01)
    assert found.velocity[inner].mean() == pytest.approx(2 / (1 / 0.3 + 1 / 0.9), rel=0.01)
    # the flow is one, so that the area fraction is less where the mean speed is more
    assert found.crossing_flux[inner].mean() == pytest.approx(found.flux[inner].mean(), rel=0.02)
    less = found.crossing_fraction[inner].mean() / found.area_fraction[inner].mean()
    assert less == pytest.approx(0.45 / 0.6, rel=0.02)


def test_what_crosses_a_bin_is_counted_in_the_window():
    """A grain each 1/2000 s, evenly over the width that centres reach, and none at the edges."""
    n = 20_000
    times, x, _ = passing(n, 4)
    found = profile_of(run_of(times, x, np.full(n, 0.5), gravity=0.0))
    per_length = 2000 / (2 * (R - RADIUS))
    assert found.crossing_flux[4:-4].mean() == pytest.approx(per_length * math.pi * RADIUS**2, rel=0.02)
    assert (found.crossing_flux[[0, -1]] == 0).all()
    assert (found.crossing_fraction[[0, -1]] == 0).all()
    assert np.isnan(found.crossing_velocity[[0, -1]]).all()


def test_an_eccentric_outlet_has_its_own_centre():
    centred = profile_of(run_of(*passing(2000, 5)))
    gap = 6e-3
    aside = profile_of(run_of(*passing(2000, 5, centre=gap + R - 0.05), gap=gap))
    np.testing.assert_allclose(aside.area_fraction, centred.area_fraction, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(aside.flux, centred.flux, rtol=1e-6, atol=1e-9)


def test_gaps_without_flow_are_left_out():
    times, x, speed = passing(2000, 6)
    whole = profile_of(run_of(times, x, speed))
    late = times + np.where(np.arange(2000) >= 700, 3.0, 0.0)
    paused = profile_of(run_of(late, x, speed))
    assert paused.frames == pytest.approx(whole.frames, abs=12)
    assert paused.counted == pytest.approx(whole.counted, rel=1e-3)
    assert paused.area_fraction.mean() == pytest.approx(whole.area_fraction.mean(), rel=0.03)


def test_as_many_cross_the_bins_as_are_counted_also_with_gaps():
    """A grain that ends a gap counts in neither: else there would be 45 more of 900."""
    times, x, speed = passing(2000, 9)
    run = run_of(times + 1.5 * (np.arange(2000) // 20), x, speed)
    flow, _ = outflow(run, Window())
    assert flow is not None
    assert flow.gaps == 45
    passed = profile_of(run).crossing_flux.sum() * ORIFICE / BINS / (math.pi * RADIUS**2)
    assert passed == pytest.approx(flow.grain_rate, rel=1e-9)


def test_quantities_of_a_run():
    run = run_of(*passing(2000, 7))
    found = {m.quantity: m for m in MEASURE.evaluate(run, Window()).numbers}
    profile = profile_of(run)
    assert set(found) == {"outlet_closure", "outlet_area_fraction", "outlet_velocity"}
    assert found["outlet_closure"].error == profile.closure_error
    product = 2 / 3 * D * 2500 * found["outlet_area_fraction"].value * found["outlet_velocity"].value * 2 * R
    assert product == pytest.approx(profile.flow, rel=1e-12)


def test_numbers_of_a_run_that_clogged_are_kept_apart():
    run = replace(run_of(*passing(2000, 7)), outcome="clogged")
    found = {m.quantity for m in MEASURE.evaluate(run, Window()).numbers}
    assert found == {"outlet_closure_flowing", "outlet_area_fraction_flowing", "outlet_velocity_flowing"}
    assert found <= {one.name for one in MEASURE.declared}
    few = replace(run_of(*passing(100, 8)), outcome="clogged")
    assert [m.quantity for m in MEASURE.evaluate(few, Window()).numbers] == ["outlet_closure_flowing"]


def test_profiles_for_several_starts_are_those_of_windows_that_state_them():
    """Grains speed up with time, so that windows differ; each is stored with all of its arrays."""
    times, x, speed = passing(900, 5)
    run = run_of(times, x, speed * (1 + times / times.max()))
    evaluation = WindowStarts().evaluate(run, Window())
    starts = list(WindowStarts.of(evaluation, Window()))
    assert [one.window.start for one in starts] == [*STARTS, 0.0]
    speeds = []
    for one in starts:
        expected = outlet_profile(run, one.window)
        assert one.profile is not None
        assert expected is not None
        assert np.array_equal(one.profile.flux, expected.flux)
        assert np.array_equal(one.profile.crossing_velocity, expected.crossing_velocity, equal_nan=True)
        speeds.append(one.profile.flux.sum() / one.profile.area_fraction.sum())
    assert np.all(np.diff(speeds[:-1]) > 0)


def test_too_few_grains_give_no_profile():
    (nothing,) = MEASURE.evaluate(run_of(*passing(100, 8)), Window()).numbers
    assert math.isnan(nothing.value)
    assert "too few grains" in nothing.note


def test_what_must_be_observed():
    assert MEASURE.probes(scene_of(10), Numerics(dt=1e-6)) == (Crossing(0.0), Slab(low=-RADIUS, high=RADIUS, every=1))
    boxed = scene_of(10).model_copy(update={"container": Box(width=0.1, depth=0.1, height=0.1)})
    with pytest.raises(MeasureError, match="wedge-hopper"):
        MEASURE.probes(boxed, Numerics(dt=1e-6))
    run = run_of(*passing(200, 9))
    unobserved = RunData(run.scene, NUMERICS, 1, run.start, "emptied", 1.0, {"crossing": run.tables["crossing"]})
    with pytest.raises(MeasureError, match="run it again"):
        outlet_profile(unobserved, Window())
