"""Equivalence of two means within a margin: two one-sided tests (TOST).

Schuirmann, J. Pharmacokinet. Biopharm. 15 (1987) 657. A t test that finds no difference proves nothing; this one has to
reject the hypothesis that the means differ by the margin or more.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np

from labbook.stats.pooling import welch

_MAX_REPLICATES = 1000


@dataclass(frozen=True)
class Equivalence:
    """Outcome of two one-sided tests.

    Attributes:
        difference: Mean of b less mean of a.
        error: Its standard error.
        degrees_of_freedom: Of the error.
        margin: Largest difference that counts as none, in the same unit.
        p: The larger of the two one-sided probabilities.
        power: Probability of a finding of equivalence if the true difference is zero and the scatter as measured.
        low: Lower end of the interval of the difference at confidence 1 - 2 alpha. The interval lies within the margin
            exactly when `equivalent`.
        high: Upper end.
        alpha: Level of the test.
    """

    difference: float
    error: float
    degrees_of_freedom: float
    margin: float
    p: float
    power: float
    low: float
    high: float
    alpha: float

    @property
    def equivalent(self) -> bool:
        """True if equivalence within the margin is significant at level alpha."""
        return self.p < self.alpha

    @property
    def finding(self) -> Literal["equivalent", "different", "undecided"]:
        """Finding of the test: equivalence, a difference beyond the margin, or neither."""
        if self.equivalent:
            return "equivalent"
        beyond = self.low > self.margin or self.high < -self.margin
        return "different" if beyond else "undecided"

    def relative_to(self, scale: float) -> "Equivalence":
        """Express difference, error, margin and interval as parts of `scale`, which is positive."""
        scaled = {name: getattr(self, name) / scale for name in ("difference", "error", "margin", "low", "high")}
        return replace(self, **scaled)


def tost(
    a: Sequence[float] | np.ndarray,
    b: Sequence[float] | np.ndarray,
    margin: float,
    alpha: float = 0.05,
    *,
    paired: bool = False,
) -> Equivalence:
    """Test the equivalence of two samples.

    Args:
        a: First sample.
        b: Second sample.
        margin: Largest difference that counts as none, absolute.
        alpha: Level of each one-sided test.
        paired: a[i] and b[i] share a seed (a packing), and their differences are tested; otherwise samples are
            independent, with Welch's error and degrees of freedom.

    Returns:
        The outcome.

    Raises:
        ValueError: A sample has fewer than 2 values, paired samples have unequal lengths, or the margin is not
            positive.
    """
    x, y = np.asarray(a, float), np.asarray(b, float)
    if not margin > 0:
        raise ValueError("the margin of an equivalence test must be positive")
    if min(len(x), len(y)) < 2:
        raise ValueError("an equivalence test needs at least 2 replicates of each")
    if paired:
        if len(x) != len(y):
            raise ValueError(f"paired samples have equal lengths, not {len(x)} and {len(y)}")
        change = y - x
        difference, n = float(change.mean()), len(change)
        error, freedom = float(change.std(ddof=1)) / math.sqrt(n), float(n - 1)
    else:
        difference = float(y.mean() - x.mean())
        va, vb = float(x.var(ddof=1)) / len(x), float(y.var(ddof=1)) / len(y)
        error = math.sqrt(va + vb)
        freedom = welch(va, len(x), vb, len(y))
    return _decide(difference, error, freedom, margin, alpha)


def _decide(difference: float, error: float, freedom: float, margin: float, alpha: float) -> Equivalence:
    from scipy.special import stdtr, stdtrit

    if error == 0:  # identical values: t is undefined, and the decision certain
        p = 0.0 if abs(difference) < margin else 1.0
        return Equivalence(difference, 0.0, freedom, margin, p, 1.0, difference, difference, alpha)
    # both hypotheses have to be rejected, so that the larger probability decides, without a correction for two tests
    p = max(
        float(stdtr(freedom, (difference - margin) / error)),
        float(stdtr(freedom, -(difference + margin) / error)),
    )
    reach = float(stdtrit(freedom, 1 - alpha)) * error
    power = tost_power(margin / error, freedom, alpha)
    return Equivalence(difference, error, freedom, margin, p, power, difference - reach, difference + reach, alpha)


@lru_cache(maxsize=1)
def _gauss_legendre(order: int) -> tuple[np.ndarray, np.ndarray]:
    return np.polynomial.legendre.leggauss(order)


def tost_power(margin: float, degrees_of_freedom: float, alpha: float = 0.05) -> float:
    """Compute the power of two one-sided tests if there is no true difference.

    Exact: both tests reject if |z| <= margin - t q with z normal and q^2 = chi2/nu, integrated over q. The usual sum of
    two noncentral t probabilities is a bound that fails for few degrees of freedom. Phillips, J. Pharmacokinet.
    Biopharm. 18 (1990) 137.

    Args:
        margin: Margin in units of the standard error of the difference.
        degrees_of_freedom: Of that error.
        alpha: Level of each test.
    """
    from scipy.special import gammaln, ndtr, stdtrit, xlogy

    nu = degrees_of_freedom
    t = float(stdtrit(nu, 1 - alpha))
    spread = 12 / math.sqrt(2 * nu)  # q scatters by 1/sqrt(2 nu) about 1
    low, high = max(0.0, 1 - spread), min(margin / t, 1 + spread)
    if high <= low:
        return 0.0
    nodes, weights = _gauss_legendre(200)
    q = low + (nodes + 1) / 2 * (high - low)
    # in logarithms: the gamma function overflows from nu = 344 on
    log_density = math.log(2) + nu / 2 * math.log(nu / 2) - gammaln(nu / 2) + xlogy(nu - 1, q) - nu * q**2 / 2
    reach = margin - t * q
    accepted = ndtr(reach) - ndtr(-reach)
    return float(np.sum(weights * accepted * np.exp(log_density)) * (high - low) / 2)


def replicates_needed(outcome: Equivalence, replicates: int, power: float = 0.9) -> int | None:
    """Find the replicates of each sample for which the test would have a power, if the true difference is zero.

    Args:
        outcome: Test of samples with `replicates` each, whose scatter is assumed.
        replicates: Replicates of each sample in that test.
        power: The power.

    Returns:
        Number of replicates; None if it is above 1000.
    """
    if outcome.error == 0:
        return replicates
    scatter = outcome.error * math.sqrt(replicates)
    for n in range(2, _MAX_REPLICATES + 1):  # no bisection: for few replicates power does not always rise with n
        freedom = outcome.degrees_of_freedom * (n - 1) / (replicates - 1)
        if tost_power(outcome.margin * math.sqrt(n) / scatter, freedom, outcome.alpha) >= power:
            return n
    return None
