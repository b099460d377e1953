"""Precision that one run tells of itself: looked at now and then until it is met, its intervals keep their coverage."""

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from labbook.measure.steady import steady_flow
from labbook.stats.stopping import FIRST_LOOK, GROWTH, looks
from labbook.study import Window

WINDOW = Window(start=0.1).endless()
MEAN = 1e-3
TOTAL, MOST = 1000, 40_000


def waits(rng, rho: float, spread: float) -> np.ndarray:
    """Times between grains of mean MEAN and relative `spread`, an AR(1) series of correlation `rho`."""
    noise = lfilter([math.sqrt(1 - rho**2)], [1, -rho], rng.normal(size=MOST + 200))[200:]
    return MEAN * (1 + spread * np.clip(noise, -4, 4))


def stopped(rng, rho: float, spread: float, tolerance: float) -> tuple[bool, int]:
    """Whether the interval of a series that is looked at until it is precise holds the mean, and how long that took."""
    times, start = np.cumsum(waits(rng, rho, spread)), int(WINDOW.start * TOTAL)
    n = FIRST_LOOK
    while True:
        flow = steady_flow(times[: start + n], TOTAL, WINDOW)
        assert flow is not None
        if flow.precision <= tolerance or start + n >= MOST:
            return abs(flow.rate * MEAN - 1) <= flow.precision, n
        n = min(math.ceil(n * GROWTH), MOST - start)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rho", "spread", "tolerance"),
    [
        (-0.4, 0.25, 0.005),
        (0.0, 0.25, 0.008),
        (0.9, 0.2, 0.02),
        (0.98, 0.2, 0.04),
    ],
)
def test_intervals_of_series_that_are_stopped_when_precise_hold_the_mean(rho, spread, tolerance):
    """Nominal: 95 %. Of 500 series the share scatters by 1 %, so that 92 to 98 % allow for a bias of a percent."""
    rng = np.random.default_rng(7)
    found = [stopped(rng, rho, spread, tolerance) for _ in range(500)]
    held, lengths = np.mean([hit for hit, _ in found]), np.array([n for _, n in found])
    assert 0.92 <= held <= 0.98
    assert len(set(lengths)) > 2, "else no look decided anything"


def test_looks_are_half_as_many_samples_again_apart():
    assert looks(FIRST_LOOK - 1) == looks(-5) == 0
    at = [n for n in range(1, 4000) if looks(n) > looks(n - 1)]
    assert at[0] == FIRST_LOOK
    assert np.diff([looks(n) for n in at]).max() == 1
    assert np.allclose(np.array(at[1:]) / at[:-1], GROWTH, rtol=2e-3)


def test_the_larger_of_both_errors_counts():
    """Of independent times between grains both agree; half width and error belong together."""
    rng = np.random.default_rng(3)
    flow = steady_flow(np.cumsum(waits(rng, 0.0, 0.25)), TOTAL, WINDOW)
    assert flow is not None
    assert flow.larger_error >= flow.error
    assert flow.error * flow.rate**-1 == pytest.approx(0.25 / math.sqrt(flow.grains), rel=0.8)
    assert flow.precision == pytest.approx(2.201 * flow.larger_error / flow.rate, rel=1e-4)
