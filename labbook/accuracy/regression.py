"""What numerics do to the flow rate of a scene, from runs of many settings and seeds at once.

ln W = (bed) + c_flow * overlap + c_step * step^2 is fitted within every bed that several settings flowed
from, so that the scatter between beds drops out; where runs of both precisions share beds, with a term for `mixed`.
Where ln W is not linear in the overlap, with a term q * overlap^2: firm beds then have another slope than soft ones.
What is left of each bed is then fitted against the overlap of its filling, and against its precision where beds were
filled in both. Overlap and step are those of `Groups`. One regression over all runs needs several times fewer of them
than a test of equivalence at every setting.
"""

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

_FEWEST = 20
_LINEAR = np.array([True, True, True, False])
"""Factors of a run without the squared overlap."""


@dataclass(frozen=True)
class Observed:
    """One run. `bed`: what it shares with others that started from the same packing. `filled`: the overlap while it was
    filled. `rate`: W. `mixed`, `filled_mixed`: whether it flowed and was filled in mixed precision."""

    bed: str
    filled: float
    overlap: float
    step: float
    rate: float
    mixed: bool = False
    filled_mixed: bool = False

    @property
    def factors(self) -> list[float]:
        """What may differ between runs from one bed."""
        return [self.overlap, self.step**2, float(self.mixed), self.overlap**2]

    @property
    def filling(self) -> list[float]:
        """What may differ between beds."""
        return [self.filled, float(self.filled_mixed)]


@dataclass(frozen=True)
class Slopes:
    """d ln W by overlap of the flow, by squared step, and by overlap of the filling, shape [3], with their covariance,
    shape [3, 3].

    `curvature`: d ln W by squared overlap of the flow, with its covariances with the three slopes and its variance;
    None where ln W was fitted linearly. `curvature_p`: probability of a curvature as large in a scene that has none;
    NaN with fewer than three overlaps.
    `mixed_flow`: what a flow in mixed precision does to ln W, with the variance of that; None where no bed flowed in
    both. `mixed`: the same of flow and filling in mixed precision; None where beds were filled in one only.
    `within`: standard deviation of ln W between settings in one bed that the slopes do not explain; `between`: from
    bed to bed, runs of one setting. `freedom`: degrees of freedom of the fit within beds; `runs`, `beds`: how many
    there were. The slope by an overlap or a step that all runs share, or by an overlap that all beds were filled
    with, is 0 with an infinite variance.
    """

    values: np.ndarray
    covariance: np.ndarray
    curvature: tuple[float, tuple[float, float, float, float]] | None
    curvature_p: float
    mixed_flow: tuple[float, float] | None
    mixed: tuple[float, float] | None
    within: float
    between: float
    freedom: int
    runs: int
    beds: int


def regress(observed: Sequence[Observed], curved: bool = False) -> Slopes:
    """Fit all runs at once, with a term in the squared overlap if `curved`. Raises ValueError for too few of them."""
    if len(observed) < _FEWEST:
        raise ValueError(f"too few runs: {len(observed)} flowed, and {_FEWEST} are needed")
    beds: dict[str, list[Observed]] = defaultdict(list)
    for one in observed:
        beds[one.bed].append(one)
    y, x = [], []
    for runs in beds.values():
        rates, factors = np.log([run.rate for run in runs]), np.array([run.factors for run in runs])
        y.append(rates - rates.mean())
        x.append(factors - factors.mean(axis=0))
    Y, X = np.concatenate(y), np.concatenate(x)
    varied = np.abs(X).max(axis=0) > 1e-12 * np.array([run.factors for run in observed]).max(axis=0)
    linear = varied & _LINEAR
    if len(Y) - len(beds) - linear.sum() < 10 or not linear[1:].any() or not _independent(X, linear):
        raise ValueError("too few runs: the step or the precision, and overlap apart from it, must vary within beds")
    bends = bool(varied[3]) and _independent(X, varied)
    p = _curvature_p(*_fitted(X, Y, varied, len(beds))) if bends else math.nan
    varied = varied if curved and bends else linear
    slopes, inside, freedom = _fitted(X, Y, varied, len(beds))
    within = math.sqrt(float(np.sum((Y - X @ slopes) ** 2)) / freedom)
    left = {bed: _left(runs, slopes) for bed, runs in beds.items()}
    filling, outside, by_slopes, between = _filled(beds, left, within)
    along = (
        inside @ by_slopes.T
    )  # covariances of slopes within beds, which enter what is left of beds, with those between
    outside += by_slopes @ along
    covariance = np.zeros((3, 3))
    covariance[:2, :2] = inside[:2, :2] + np.diag(np.where(varied[:2], 0.0, math.inf))
    covariance[:2, 2] = covariance[2, :2] = along[:2, 0]
    covariance[2, 2] = outside[0, 0]
    mixed_flow = mixed = curvature = None
    if varied[3]:
        beside = float(inside[3, 0]), float(inside[3, 1]), float(along[3, 0])
        curvature = float(slopes[3]), (*beside, float(inside[3, 3]))
    if varied[2]:
        mixed_flow = float(slopes[2]), float(inside[2, 2])
        if math.isfinite(outside[1, 1]):
            mixed = float(slopes[2] + filling[1]), float(inside[2, 2] + outside[1, 1] + 2 * along[2, 1])
    return Slopes(
        values=np.array([slopes[0], slopes[1], filling[0]]),
        covariance=covariance,
        curvature=curvature,
        curvature_p=p,
        mixed_flow=mixed_flow,
        mixed=mixed,
        within=within,
        between=between,
        freedom=freedom,
        runs=len(observed),
        beds=len(beds),
    )


def _independent(X: np.ndarray, varied: np.ndarray) -> bool:
    """Decide if the columns that vary are linearly independent."""
    Z = X[:, varied]
    return bool(np.linalg.matrix_rank(Z / np.abs(Z).max(axis=0), tol=1e-6) == varied.sum())


def _fitted(X: np.ndarray, Y: np.ndarray, varied: np.ndarray, beds: int) -> tuple[np.ndarray, np.ndarray, int]:
    """Slopes within beds by the factors that vary, shape [4], their covariance, shape [4, 4], degrees of freedom."""
    Z, freedom = X[:, varied], len(Y) - beds - int(varied.sum())
    slopes, covariance, inverse = np.zeros(4), np.zeros((4, 4)), np.linalg.inv(Z.T @ Z)
    slopes[varied] = inverse @ Z.T @ Y
    covariance[np.ix_(varied, varied)] = float(np.sum((Y - X @ slopes) ** 2)) / freedom * inverse
    return slopes, covariance, freedom


def _curvature_p(slopes: np.ndarray, covariance: np.ndarray, freedom: int) -> float:
    from scipy.special import stdtr

    return float(2 * stdtr(freedom, -abs(slopes[3]) / math.sqrt(covariance[3, 3])))


def curved(p: Sequence[float], level: float = 0.05) -> list[bool]:
    """Decide in which of several scenes ln W is not linear in the overlap, by the `curvature_p` of each.

    All of them are decided correctly with a probability of 1 - level where all are linear, however many there are
    (Holm, Scand. J. Statist. 6 (1979) 65). A NaN is linear.
    """
    tested = sorted((value, place) for place, value in enumerate(p) if not math.isnan(value))
    decisions = [False] * len(p)
    for rank, (value, place) in enumerate(tested):
        if value * (len(tested) - rank) >= level:
            break
        decisions[place] = True
    return decisions


def _left(runs: Sequence[Observed], slopes: np.ndarray) -> float:
    """Mean of ln W of a bed, without what the slopes explain."""
    return float(np.mean([math.log(run.rate) - slopes @ run.factors for run in runs]))


def _filled(
    beds: dict[str, list[Observed]], left: dict[str, float], within: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Slopes of what is left of each bed by what differs between their fillings, shape [2], their covariance were the
    slopes within beds exact, shape [2, 2], their derivatives by these, shape [2, 4], and the standard deviation from
    bed to bed of one run each. The slope by what does not differ is 0 with an infinite variance."""
    y = np.array(list(left.values()))
    x = np.array([runs[0].filling for runs in beds.values()])
    factors = np.array([np.mean([run.factors for run in runs], axis=0) for runs in beds.values()])
    x, y = x - x.mean(axis=0), y - y.mean()
    varied = (x**2).sum(axis=0) > 1e-20
    slopes, by_slopes, covariance = np.zeros(2), np.zeros((2, 4)), np.diag(np.where(varied, 0.0, math.inf))
    if np.linalg.matrix_rank(x[:, varied] / np.abs(x[:, varied]).max(axis=0)) < varied.sum():
        raise ValueError("too few runs: stiffness and precision of the fillings must vary apart from each other")
    inverse = np.linalg.inv(x[:, varied].T @ x[:, varied])
    slopes[varied] = inverse @ x[:, varied].T @ y
    by_slopes[varied] = -inverse @ x[:, varied].T @ factors
    freedom = len(beds) - 1 - int(varied.sum())
    if freedom < 1:
        raise ValueError("too few beds: several seeds of each setting are needed")
    rest = float(np.sum((y - x @ slopes) ** 2)) / freedom
    covariance[np.ix_(varied, varied)] = rest * inverse
    share = float(np.mean([1 / len(runs) for runs in beds.values()]))  # of the variance within, in the mean of a bed
    between = math.sqrt(max(0.0, rest - share * within**2) + within**2)
    return slopes, covariance, by_slopes, between
