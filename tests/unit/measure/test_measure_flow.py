import math
from dataclasses import replace

import numpy as np
import pytest

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Crossing
from labbook.measure import MEASURES, MeasureError, RunData
from labbook.measure.flow import merge_notes
from labbook.measure.series import discharged, flow_series, smooth_flow
from labbook.measure.steady import steady_flow
from labbook.scene import Box, Feed, HertzMindlin, Scene, Spheres, WedgeHopper
from labbook.scene.packing import Packing

D = 3e-3
SCENE = Scene(
    grains=Spheres(diameter=D, density=2500, count=1000),
    contact=HertzMindlin(shear_modulus=1e8, poisson_ratio=0.25),
    container=WedgeHopper(width=0.1, height=0.4, thickness=1.01 * D, orifice=0.03),
)
MASS = 2500 * math.pi / 6 * D**3


class Window:
    def __init__(self, start=0.15, end=0.6, timed=False):
        self.start, self.end, self.timed = start, end, timed


def run_of(times, total=1000, outcome="finished", duration=None):
    times = np.asarray(times, float)
    order = np.random.default_rng(0).permutation(len(times))  # rows may come in any order
    table = {"id": np.arange(len(times))[order], "time": times[order]}
    start = Packing(*np.zeros((3, total, 3)))
    end = duration if duration is not None else (times.max(initial=0.0) + 0.01)
    return RunData(SCENE, Numerics(dt=1e-6), 1, start, outcome, end, {"crossing": table})


def numbers(run, window=None):
    return {m.quantity: m for m in MEASURES["flow_rate"].evaluate(run, window or Window()).numbers}


def steady_times(rng, n=900, rate=500.0):
    return 0.1 + np.cumsum(rng.exponential(1 / rate, n))


def test_a_clock_gives_its_rate_exactly():
    found = numbers(run_of(0.2 + np.arange(900) / 400))
    assert found["grain_rate"].value == pytest.approx(400, rel=1e-12)
    assert found["flow_rate"].value == pytest.approx(400 * MASS, rel=1e-12)
    assert found["flow_rate"].unit == "kg/s"
    assert found["flow_rate"].note == ""
    assert found["flow_rate"].error < 1e-9 * found["flow_rate"].value


def test_start_up_and_emptying_are_left_out():
    slow_start = np.linspace(0, 5, 140)
    steady = 5 + np.arange(1, 501) / 100
    trickle = steady[-1] + np.arange(1, 300) * 0.5
    found = numbers(run_of(np.concatenate([slow_start, steady, trickle])))
    assert found["grain_rate"].value == pytest.approx(100, rel=1e-12)


def test_the_window_runs_from_crossing_to_crossing():
    times = np.sort(np.random.default_rng(1).uniform(0, 2, 1000))
    flow = steady_flow(times, 1000, Window(0.2, 0.5))
    assert flow is not None
    assert (flow.begin, flow.end) == (times[199], times[499])
    assert flow.fraction == (0.2, 0.5)
    assert flow.rate == pytest.approx(300 / (times[499] - times[199]), rel=1e-12)


def test_a_window_may_be_one_in_time():
    """Between two times, whatever has left before; a run that ends before the second says so, and one that is empty."""
    times = np.concatenate([np.linspace(0, 0.5, 40), 0.5 + np.arange(1, 601) / 200, 3.5 + np.arange(1, 40) / 7])
    window = Window(0.5, 3.5, timed=True)
    flow = steady_flow(times, 1000, window)
    assert flow is not None
    assert (flow.begin, flow.end) == (0.5, 3.5)
    assert flow.rate == pytest.approx(200, rel=1e-12)
    found = numbers(run_of(times), window)
    assert found["grain_rate"].value == pytest.approx(200, rel=1e-12)
    assert found["grain_rate"].note == ""
    cut = numbers(run_of(times[times < 3], duration=3.0, outcome="time-limit"), window)
    assert cut["grain_rate"].note == "the run ended within the window (time-limit)"
    nothing = numbers(run_of(times[:30], duration=4.0), window)
    assert nothing["flow_rate"].window == "0.5 s to 3.5 s"
    assert math.isnan(nothing["flow_rate"].value)


def test_random_outflow_has_the_poisson_error():
    rng = np.random.default_rng(2)
    errors = [numbers(run_of(steady_times(rng)))["grain_rate"].error for _ in range(200)]
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(500 / math.sqrt(450), rel=0.1)


def test_regular_outflow_has_more_effective_samples_than_grains():
    jitter = 0.3 * np.random.default_rng(3).standard_normal(900)
    found = numbers(run_of((np.arange(900) + jitter) / 500))
    assert found["grain_rate"].n_effective > 450 * 5


def independent(values, relative):
    """How many values with this scatter have a mean with this relative error."""
    return (np.std(values, ddof=1) / np.mean(values) / relative) ** 2


def test_effective_samples_are_those_of_the_error_that_is_told():
    """Of a fed bed it may be that of the autocorrelation: here the pace changes every 25 grains."""
    waits = np.repeat(np.random.default_rng(6).uniform(0.5, 1.5, 80), 25) / 400
    run, window = run_of(np.cumsum(waits), total=2000), Window(0.15, 0.95)
    found = numbers(run, window)["grain_rate"]
    inside = waits[300:1900]
    assert found.n_effective == pytest.approx(independent(inside, found.error / found.value), rel=0.01)
    fed_scene = SCENE.model_copy(update={"feed": Feed(kind="reinject")})
    fed = numbers(replace(run, scene=fed_scene), window)["grain_rate"]
    assert fed.error > found.error
    assert fed.n_effective == pytest.approx(independent(inside, fed.error / fed.value), rel=0.01)


def test_effective_samples_of_grains_are_no_others_if_masses_scatter():
    rng = np.random.default_rng(7)
    times, mass = steady_times(rng), rng.uniform(0.5, 1.5, 900)
    timed = Window(times[100], times[800], timed=True)
    equal, varied = steady_flow(times, 900, timed), steady_flow(times, 900, timed, mass)
    assert equal is not None
    assert varied is not None
    assert varied.grain_n_effective == equal.grain_n_effective == equal.n_effective
    assert varied.n_effective != equal.n_effective


def test_a_flow_that_dies_away_is_trending():
    times = -0.5 * np.log(1 - np.arange(950) / 1000)
    found = numbers(run_of(times))
    assert found["flow_rate"].notes == ("trending",)
    assert found["flow_rate_drift"].value < -0.3


def test_steady_flow_is_not_trending():
    rng = np.random.default_rng(4)
    notes = [numbers(run_of(steady_times(rng)))["flow_rate"].note for _ in range(200)]
    assert sum(note == "trending" for note in notes) <= 8


def test_gaps_are_left_out_and_reported():
    times = np.arange(900) / 400.0
    times[300:] += 2.5
    times[450:] += 1.5
    found = numbers(run_of(times))
    assert found["grain_rate"].value == pytest.approx(400, rel=1e-9)
    assert found["gap_time"].value == pytest.approx(4.0 + 2 / 400, rel=1e-12)
    assert "2 gaps without flow left out" in found["flow_rate"].note


def test_gaps_of_many_runs_are_one_note_with_ranges():
    notes = {"3 gaps without flow left out, 1.54 s together": 2, "1 gap without flow left out, 0.46 s together": 1}
    assert merge_notes({**notes, "trending": 4}) == {
        "1 to 3 gaps without flow left out, 0.46 to 1.54 s together": 3,
        "trending": 4,
    }
    alone = {"1 gap without flow left out, 0.46 s together": 5}
    assert merge_notes(alone) == alone


def test_a_pause_of_up_to_a_second_counts_as_flow():
    times = np.arange(900) / 400.0
    times[300:] += 0.9
    found = numbers(run_of(times))
    assert "gap_time" not in found
    assert found["grain_rate"].value < 250


def test_a_clogged_run_keeps_its_rate_apart():
    found = numbers(run_of(np.arange(400) / 400, outcome="clogged", duration=4.0))
    assert set(found) == {"flow_rate_flowing", "grain_rate_flowing", "flow_rate_drift_flowing", "waiting_time"}
    assert found["grain_rate_flowing"].value == pytest.approx(400, rel=1e-12)
    assert "ended within the window (clogged)" in found["grain_rate_flowing"].note
    assert found["waiting_time"].value == pytest.approx(4 - 399 / 400)
    assert "censored" in found["waiting_time"].notes


def test_a_run_that_clogs_at_once_has_a_waiting_time_only():
    found = numbers(run_of([], outcome="clogged", duration=3.0))
    assert found["waiting_time"].value == 3
    assert math.isnan(found["flow_rate_flowing"].value)


def test_too_few_grains_say_so():
    found = numbers(run_of(np.arange(180) / 400))
    assert math.isnan(found["flow_rate"].value)
    assert "too few grains: 180 of 1000 left" in found["flow_rate"].note


def test_without_crossings_the_remedy_is_named():
    run = RunData(SCENE, Numerics(dt=1e-6), 1, Packing(*np.zeros((3, 5, 3))), "finished", 1.0)
    with pytest.raises(MeasureError, match="run it again"):
        numbers(run)


def test_probes_are_at_the_outlet():
    assert MEASURES["flow_rate"].probes(SCENE, Numerics(dt=1e-6)) == (Crossing(0.0),)
    closed = SCENE.model_copy(update={"container": Box(width=0.1, depth=0.1, height=0.1)})
    with pytest.raises(MeasureError, match="needs an outlet"):
        MEASURES["flow_rate"].probes(closed, Numerics(dt=1e-6))


def test_series_holds_every_grain_once():
    run = run_of(np.sort(np.random.default_rng(5).uniform(0, 1.999, 700)), duration=2.0)
    time, flow = flow_series(run, 0.1)
    np.testing.assert_allclose(time, np.arange(20) * 0.1 + 0.05)
    assert flow.sum() * 0.1 == pytest.approx(700 * MASS, rel=1e-12)


def test_an_incomplete_last_bin_is_left_out():
    time, flow = flow_series(run_of((np.arange(100) + 0.5) / 100, duration=1.05), 0.1)
    assert len(time) == 10
    assert flow[3] == pytest.approx(100 * MASS)


@pytest.mark.parametrize("width", [0.0, -1.0, 5.0])
def test_impossible_bins_are_refused(width):
    with pytest.raises(ValueError, match="bin"):
        flow_series(run_of(np.arange(100) / 100), width)


def test_smoothing_keeps_a_constant_rate_up_to_the_ends():
    run = run_of((np.arange(800) + 0.5) / 400, duration=2.0)
    at = np.array([0.0, 0.03, 1.0, 1.97, 2.0])
    np.testing.assert_allclose(smooth_flow(run, at, 0.05), 400 * MASS, rtol=1e-3)


def test_smoothing_follows_a_slow_change():
    t = np.linspace(0, 2, 200_001)
    cumulated = 400 * t + 60 * t**2
    times = np.interp(np.arange(1000) + 0.5, cumulated, t)
    run = run_of(times, duration=2.0)
    at = np.array([0.5, 1.0, 1.5])
    np.testing.assert_allclose(smooth_flow(run, at, 0.05), (400 + 120 * at) * MASS, rtol=2e-3)


def test_smoothing_needs_a_width():
    with pytest.raises(ValueError, match="width"):
        smooth_flow(run_of(np.arange(100) / 100), np.array([0.5]), 0)


def test_discharged_mass_counts_up():
    times, mass = discharged(run_of(np.arange(10) / 10))
    assert mass[-1] == pytest.approx(10 * MASS)
    assert (np.diff(times) > 0).all()
