"""Are two means the same within a margin? Two one-sided tests.

Schuirmann, J. Pharmacokinet. Biopharm. 15 (1987) 657.
A t test that finds no difference proves nothing; this one has to reject "they differ by the margin or more".
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np

from labbook.stats.pooling import welch

_MOST = 1001


@dataclass(frozen=True)
class Equivalence:
    """Outcome of two one-sided tests.

    `difference`: mean of b minus mean of a, and `error`, its standard error; `margin`: how large a difference
    counts as none, in the same unit; `p`: the larger of the two one-sided probabilities; `power`: probability
    that the test shows equivalence if the true difference is zero and the scatter as measured. `low`, `high`:
    the interval of the difference at confidence 1 - 2 alpha, which lies within the margin exactly when
    `equivalent`.
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
        """Whether equivalence within the margin is shown at level alpha."""
        return self.p < self.alpha

    @property
    def finding(self) -> Literal["equivalent", "different", "undecided"]:
        """What the test shows: equivalence, a difference beyond the margin, or neither."""
        if self.equivalent:
            return "equivalent"
        beyond = self.low > self.margin or self.high < -self.margin
        return "different" if beyond else "undecided"

    def over(self, scale: float) -> "Equivalence":
        """The same, with difference, error, margin and interval as parts of `scale`, which is positive."""
        parts = {name: getattr(self, name) / scale for name in ("difference", "error", "margin", "low", "high")}
        return replace(self, **parts)


def tost(
    a: Sequence[float] | np.ndarray,
    b: Sequence[float] | np.ndarray,
    margin: float,
    alpha: float = 0.05,
    *,
    paired: bool = False,
) -> Equivalence:
    """Equivalence of two samples within +-`margin` (absolute).

    Independent samples: Welch's error and degrees of freedom. `paired`: a[i] and b[i] share a seed (a
    packing), and their differences are tested. Raises ValueError for fewer than 2 values in a sample, samples
    of unequal length when paired, or a margin that is not positive.
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

    if error == 0:
        p = 0.0 if abs(difference) < margin else 1.0
        return Equivalence(difference, 0.0, freedom, margin, p, 1.0, difference, difference, alpha)
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
    """Power of two one-sided tests where there is no true difference; `margin` in units of the standard error.

    Exact: both tests reject if |z| <= margin - t q with z normal and q^2 = chi2/nu, which is
    integrated over q. (The usual sum of two noncentral t probabilities is a bound that fails for few degrees
    of freedom.) Phillips, J. Pharmacokinet. Biopharm. 18 (1990) 137.
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
    log_density = math.log(2) + nu / 2 * math.log(nu / 2) - gammaln(nu / 2) + xlogy(nu - 1, q) - nu * q**2 / 2
    reach = margin - t * q
    accepted = ndtr(reach) - ndtr(-reach)
    return float(np.sum(weights * accepted * np.exp(log_density)) * (high - low) / 2)


def replicates_needed(found: Equivalence, replicates: int, power: float = 0.9) -> int | None:
    """Replicates of each sample at which the test would have `power`, if the true difference is zero and the scatter
    as `found` from `replicates` of each; None if more than 1000 are needed.
    """
    if found.error == 0:
        return replicates
    scatter = found.error * math.sqrt(replicates)
    for n in range(2, _MOST):
        freedom = found.degrees_of_freedom * (n - 1) / (replicates - 1)
        if tost_power(found.margin * math.sqrt(n) / scatter, freedom, found.alpha) >= power:
            return n
    return None
