"""End of the start-up of outflows made from W(t) = W_inf (1 - exp(-t/tau)) with noise.

Noise is of the kind that discharges have: times between grains scatter by 80 % of their mean (a run of 1800 grains then
has W to 2 %, as hoppers of Fan et al. do), without or with waves of density that last for some 15 grains, and each bed
has a W_inf of its own, 1 % from the mean. Times are in units of the duration of the window at W_inf.

    python tests/unit/measure/test_startup.py

prints bias and coverage for more cases than the tests have.
"""

import math

import numpy as np
import pytest

from labbook.measure.startup import end_of_start_up, start_up_time
from labbook.measure.steady import SteadyFlow, steady_flow
from labbook.stats import pool

TOTAL, END = 3000, 0.6
GRAINS = round(TOTAL * END)


class Auto:
    start, end, timed, auto = 0.0, END, False, True


class Fixed:
    start, end, timed = 0.0, END, False


def outflow(rng: np.random.Generator, tau: float, grains: int = GRAINS, waves: float = 0.0, bed: float = 0.01):
    """Times of crossings; the mean of W_inf over beds is `grains` in a unit of time."""
    waits = rng.gamma(0.8**-2, 0.8**2, grains + 1)
    if waves:
        keep, wave = math.exp(-1 / 15), rng.standard_normal(grains + 1)
        for place in range(1, grains + 1):
            wave[place] = keep * wave[place - 1] + math.sqrt(1 - keep**2) * wave[place]
        waits *= np.exp(waves * wave - waves**2 / 2)
    mass = np.cumsum(waits) / (grains * (1 + bed * rng.standard_normal()))
    if not tau:
        return mass
    time = np.linspace(0, mass[-1] + tau, 20_000)
    return np.interp(mass, time + tau * np.expm1(-time / tau), time)


def flow_of(times: np.ndarray, window: type = Auto) -> SteadyFlow:
    flow = steady_flow(times, round(len(times) / END), window())
    assert flow is not None
    return flow


def flows(tau: float, runs: int, window: type = Auto, waves: float = 0.0, grains: int = GRAINS) -> list[SteadyFlow]:
    rng = np.random.default_rng(7)
    return [flow_of(outflow(rng, tau, grains, waves), window) for _ in range(runs)]


def covered(rates: np.ndarray, replicates: int) -> float:
    """Part of the 95 % intervals of the mean over so many replicates that hold W_inf = 1."""
    pooled = [pool(group) for group in rates[: len(rates) // replicates * replicates].reshape(-1, replicates)]
    return float(np.mean([one.low <= 1 <= one.high for one in pooled]))


@pytest.mark.slow
@pytest.mark.parametrize(("tau", "waves"), [(0.02, 0.0), (0.05, 0.2), (0.1, 0.0)])
def test_w_is_that_of_the_plateau_and_its_interval_covers_it(tau, waves):
    """What W lacks of W_inf after the start-up, 1 % and falling, leaves a bias of 0.01 tau over the rest of the window,
    and 3 standard errors are chance. 200 intervals of 95 % cover within 3 x 1.5 %."""
    found = flows(tau, 1000, waves=waves)
    rates = np.array([one.rate for one in found]) / GRAINS
    left = 1 - math.log(100) * tau
    assert rates.mean() == pytest.approx(1, abs=0.01 * tau / left + 3 * rates.std() / math.sqrt(len(rates)))
    assert covered(rates, 5) > 0.95 - 3 * 0.0154
    assert sum(not one.plateau for one in found) < 10
    whole = np.mean([one.rate for one in flows(tau, 50, Fixed)]) / GRAINS
    assert whole < 1 - 0.6 * tau  # of the whole outflow some tau is missing


@pytest.mark.slow
def test_an_outflow_without_start_up_loses_little():
    found, whole = flows(0, 400), flows(0, 400, Fixed)
    assert np.mean([one.fraction[0] for one in found]) < 0.02
    assert np.std([one.rate for one in found]) < 1.05 * np.std([one.rate for one in whole])
    assert np.mean([one.rate for one in found]) == pytest.approx(np.mean([one.rate for one in whole]), rel=0.002)


def test_a_start_up_of_the_whole_window_leaves_no_steady_part():
    """For tau = 0.25, 99 % of W_inf are reached after the window has ended. The window is the second half then."""
    found = flows(0.25, 40)
    assert not any(one.plateau for one in found)
    assert all(one.fraction[0] == pytest.approx(END / 2, abs=1e-3) for one in found)


def test_its_time_is_found_exactly_without_noise():
    """Grains that leave like a clock that starts up: within the spacing of the times that are tried, 9 %."""
    mass = np.arange(1, GRAINS + 1) / GRAINS
    for tau in (0.02, 0.05, 0.1):
        time = np.linspace(0, 1 + tau, 200_000)
        times = np.interp(mass, time + tau * np.expm1(-time / tau), time)
        assert start_up_time(times, mass) == pytest.approx(tau, rel=0.05)
        row = end_of_start_up(times, mass)
        assert row is not None
        assert times[row] == pytest.approx(math.log(100) * tau, rel=0.05)


def test_units_of_time_and_mass_change_nothing():
    times = outflow(np.random.default_rng(1), 0.05)
    passed = np.arange(1.0, len(times) + 1)
    row = end_of_start_up(times, passed)
    assert row is not None
    assert 0.03 * GRAINS < row < 0.3 * GRAINS
    assert end_of_start_up(8 * times, 0.5 * passed) == row


def test_a_gap_without_flow_is_no_start_up():
    """A gap early in a steady outflow: as time it would look like a slow start."""
    times = np.linspace(0.001, 1, GRAINS)
    late = times + np.where(np.arange(GRAINS) > 20, 0.1, 0.0)
    passed = np.arange(1.0, GRAINS + 1)
    assert end_of_start_up(late, passed, gap=0.01) == 0
    assert end_of_start_up(late, passed) != 0


def test_few_grains_are_enough_to_say_that_there_is_none():
    assert end_of_start_up(np.linspace(0.01, 1, 61), np.arange(61.0) + 1) == 0


if __name__ == "__main__":
    print("grains  waves   tau  bias [%]       start  sd of W [%]  no steady part  covered by 3, 5, 10 replicates")
    for grains, waves in ((360, 0.0), (GRAINS, 0.0), (GRAINS, 0.2), (6000, 0.0)):
        for tau in (0, 0.02, 0.05, 0.1, 0.15, 0.25):
            found = flows(tau, 1500, waves=waves, grains=grains)
            rates = np.array([one.rate for one in found]) / grains
            bias, error = 100 * (rates.mean() - 1), 100 * rates.std() / math.sqrt(len(rates))
            start, lost = (np.mean([one.fraction[0] for one in found]), np.mean([not one.plateau for one in found]))
            cover = ", ".join(f"{covered(rates, n):.3f}" for n in (3, 5, 10))
            print(f"{grains:6}  {waves:5}  {tau:4}  {bias:5.2f} ± {error:.2f}  {start / END:8.3f}  "
                  f"{100 * rates.std():11.2f}  {lost:14.2f}  {cover}", flush=True)  # fmt: skip
