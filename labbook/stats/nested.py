"""Nested replicates: several discharges of each of several beds.

The value of a run is mean + bed + flow, where the contribution of the bed is common to all its discharges. Beds are
independent of one another, but discharges of one bed are not. So beds are the units of all statistics: each counts by
the mean over its discharges. If all beds have equally many discharges, these means are independent and identically
distributed. Student's interval with one degree of freedom less than there are beds is then exact (Snedecor & Cochran,
Statistical Methods, 8th ed., section 13.2). If some lack a value, because a discharge clogged, it is an approximation.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from labbook.stats.stopping import StoppingRule
from labbook.stats.tolerance import Tolerance

LARGEST = 8
"""Largest number of discharges of a bed that is considered: beyond it the beds determine the error of a mean."""

Beds = Mapping[int, Sequence[float]]
"""Values of the discharges of each bed, by its seed; beds without values are left out."""

_PRIOR = 1.4, 6.6
"""Parameters of the beta distribution of the share of the bed, the prior for a new scene. Mean and variance are those
of twelve scenes: 0.00, 0.05, 0.07, 0.08, 0.10, 0.13, 0.17, 0.19, 0.19, 0.24, 0.41, 0.46, each with a standard error of
0.06 (correlation of W between two runs from one bed, benchmarks/results)."""
_GRID = np.linspace(0.0, 0.98, 197)
_LIKELIEST = 1e9
"""Ratio of mean squares above which the contribution of the flow cannot be resolved."""


def by_bed(values: Iterable[tuple[int, float]]) -> dict[int, list[float]]:
    """Group values of runs by the seed of their bed."""
    beds: dict[int, list[float]] = {}
    for seed, value in values:
        beds.setdefault(seed, []).append(value)
    return beds


def of_beds(beds: Beds) -> list[float]:
    """Compute one value for each bed, the mean over its discharges, in the order of the beds."""
    return [sum(values) / len(values) for values in beds.values()]


@dataclass(frozen=True)
class Shares:
    """Shares of bed and flow in the variance of a number between the runs of one point.

    Attributes:
        bed: Part of the variance that all discharges of a bed have in common, from 0 to 1.
        scatter: Standard deviation between single runs; NaN where one bed alone has a value.
        measured: True if discharges of one bed were compared; else `bed` is that of other scenes.
    """

    bed: float
    scatter: float
    measured: bool

    @property
    def flow(self) -> float:
        """Part of the variance that differs between discharges of a bed."""
        return 1 - self.bed

    def of_means(self, discharges: int) -> float:
        """Variance of the mean over a number of discharges of a bed, over that of a single run."""
        return self.bed + self.flow / discharges


TYPICAL = Shares(_PRIOR[0] / sum(_PRIOR), math.nan, measured=False)
"""Shares in other scenes, by the prior."""


def shares(beds: Beds) -> Shares:
    """Split the variance of runs into that of beds and that of flows.

    The share of the bed is its posterior mean. The likelihood is the F distribution of the ratio of mean squares
    between and within beds (one-way analysis of variance of normal numbers). The prior is that of other scenes, which
    matters while beds are few. The scatter is the most likely one for that share.

    Args:
        beds: Values of the discharges of each bed.

    Returns:
        The shares. They are those of other scenes where no bed has two values, or one bed alone has any.
    """
    sizes = np.array([len(values) for values in beds.values()])
    k, n = len(sizes), int(sizes.sum())
    if k < 2:
        return TYPICAL
    means = np.array(of_beds(beds))
    if n == k:
        return Shares(TYPICAL.bed, float(means.std(ddof=1)), measured=False)
    size = (n - float((sizes**2).sum()) / n) / (k - 1)  # effective discharges a bed in the expected mean squares
    middle = float(sizes @ means) / n
    between = float(sizes @ (means - middle) ** 2)
    apart = [np.asarray(values) - mean for values, mean in zip(beds.values(), means, strict=True)]
    within = sum(float(deviations @ deviations) for deviations in apart)
    if between == 0 and within == 0:
        return Shares(TYPICAL.bed, 0.0, measured=False)
    a, b = k - 1, n - k  # degrees of freedom between and within beds
    ratio = min(between / a * b / within, _LIKELIEST) if within > 0 else _LIKELIEST
    spread = 1 + size * _GRID / (1 - _GRID)  # expected ratio of the mean squares
    scaled = max(ratio, 1 / _LIKELIEST) / spread
    log = (a / 2 - 1) * np.log(scaled) - (a + b) / 2 * np.log1p(a / b * scaled) - np.log(spread)
    weights = np.exp(log - log.max()) * _prior()
    bed = float(weights @ _GRID / weights.sum())
    square = between / (1 + (size - 1) * bed) + within / (1 - bed)
    return Shares(bed, math.sqrt(square / (n - 1)), measured=True)


@lru_cache(maxsize=1)
def _prior() -> np.ndarray:
    # the middle of cells: the density of the prior is infinite or zero at a share of 0
    return bed_prior(_GRID + (_GRID[1] - _GRID[0]) / 2)


def bed_prior(share: np.ndarray) -> np.ndarray:
    """Prior density of the share of the bed, at shares of any shape; not normalised."""
    return share ** (_PRIOR[0] - 1) * (1 - share) ** (_PRIOR[1] - 1)


@dataclass(frozen=True)
class Design:
    """Beds of a point, and discharges of each of them."""

    beds: int
    discharges: int


def cheapest(
    rule: StoppingRule, mean: float, shares: Shares, filling: float, there: Design = Design(0, 1)
) -> tuple[Design, bool]:
    """Find the cheapest design, beyond the existing runs, that gives a mean the error of a rule.

    All beds get equally many discharges. Few beds leave few degrees of freedom and so a wider interval, which counts.

    Args:
        rule: The rule: error, least number of beds and cap.
        mean: Present estimate of the number.
        shares: Shares of its variance; `scatter` in the unit of `mean`.
        filling: Cost of a filling, in discharges.
        there: Existing beds, and discharges of each; the design has no fewer.

    Returns:
        The design, and True if it reaches the error. If none does, it has as many beds as the cap allows, and the
        number of discharges with the least variance for its cost.
    """
    assert rule.tolerance is not None
    beds = np.arange(max(there.beds, rule.first), rule.cap + 1)
    numbers = np.arange(there.discharges, max(there.discharges, LARGEST) + 1)
    variance = np.array([shares.of_means(int(number)) for number in numbers])
    relative = np.outer(rule.widths(beds), np.sqrt(variance)) * shares.scatter / abs(mean)
    cost = filling * (beds[:, None] - there.beds) + np.outer(beds, numbers) - there.beds * there.discharges
    costs = np.where(Tolerance(rule.tolerance).within(relative), cost, math.inf)
    row, column = np.unravel_index(np.argmin(costs), costs.shape)
    reached = math.isfinite(costs[row, column])
    if not reached:
        row, column = -1, np.argmin(variance * (filling + numbers))
    return Design(int(beds[row]), int(numbers[column])), reached
