"""Regression of ln W on numerics, from runs of many settings and seeds of one scene at once.

ln W = (bed) + c_flow * overlap + c_step * step^2 is fitted within every bed from which several settings flowed: the
scatter between beds drops out. Where runs of both precisions share beds there is a term for `mixed`. Where ln W is not
linear in the overlap there is a term q * overlap^2: firm beds then have another slope than soft ones. The residual mean
of each bed is then fitted against the overlap of its filling, and against its precision where beds were filled in both.
Overlap and step are those of `Groups`. One regression over all runs needs several times fewer runs than a test of
equivalence at every setting.
"""

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

_MIN_RUNS = 20
_LINEAR = np.array([True, True, True, False])
"""Mask of the factors of a run, without the squared overlap."""


@dataclass(frozen=True)
class Observation:
    """Flow rate of one run, with its numerics.

    Args:
        bed: Label of the packing that it started from; runs that share one differ in the numerics of the flow only.
        filled: Overlap of `Groups` while the bed was filled.
        overlap: Overlap of `Groups` in the flow.
        step: Step of `Groups` in the flow.
        rate: W, in any unit.
        mixed: The flow was in mixed precision.
        filled_mixed: The filling was in mixed precision.
    """

    bed: str
    filled: float
    overlap: float
    step: float
    rate: float
    mixed: bool = False
    filled_mixed: bool = False

    @property
    def factors(self) -> list[float]:
        """Overlap, step^2, mixed (0 or 1) and overlap^2 of the flow: factors that may differ between runs of a bed."""
        return [self.overlap, self.step**2, float(self.mixed), self.overlap**2]

    @property
    def filling(self) -> list[float]:
        """Overlap and mixed (0 or 1) of the filling: factors that may differ between beds."""
        return [self.filled, float(self.filled_mixed)]


@dataclass(frozen=True)
class Slopes:
    """Slopes of ln W by overlap of the flow, by squared step, and by overlap of the filling.

    A slope by an overlap or a step that all runs share, or by an overlap that all beds were filled with, is 0 with an
    infinite variance.

    Args:
        values: Slopes, shape [3].
        covariance: Their covariance, shape [3, 3].
        curvature: Slope by squared overlap of the flow, with its covariances with the three slopes and its variance;
            None where ln W was fitted linearly.
        curvature_p: Probability of a curvature as large in a scene that has none; NaN with fewer than three overlaps.
        mixed_flow: Effect of a flow in mixed precision on ln W, and its variance; None if no bed flowed in both.
        mixed: The same for flow and filling in mixed precision; None unless beds were filled in both precisions, and
            some bed flowed in both.
        within: Standard deviation of ln W between settings in one bed that the slopes do not explain.
        between: Standard deviation of ln W between runs of one setting from different beds; `within` is part of it.
        freedom: Degrees of freedom of the fit within beds.
        runs: Number of runs.
        beds: Number of beds.
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


def regress(observed: Sequence[Observation], curved: bool = False) -> Slopes:
    """Fit all runs at once.

    Args:
        observed: The runs.
        curved: Fit a term in the squared overlap too.

    Raises:
        ValueError: There are too few runs, or their numerics do not vary enough.
    """
    if len(observed) < _MIN_RUNS:
        raise ValueError(f"too few runs: {len(observed)} flowed, and {_MIN_RUNS} are needed")
    beds: dict[str, list[Observation]] = defaultdict(list)
    for observation in observed:
        beds[observation.bed].append(observation)
    y, x = [], []
    for runs in beds.values():
        rates, factors = np.log([run.rate for run in runs]), np.array([run.factors for run in runs])
        # deviations from the means of the bed: its own ln W drops out, at the cost of one degree of freedom
        y.append(rates - rates.mean())
        x.append(factors - factors.mean(axis=0))
    Y, X = np.concatenate(y), np.concatenate(x)
    varied = np.abs(X).max(axis=0) > 1e-12 * np.array([run.factors for run in observed]).max(axis=0)
    linear = varied & _LINEAR
    if len(Y) - len(beds) - linear.sum() < 10 or not linear[1:].any() or not _independent(X, linear):
        raise ValueError("too few runs: the step or the precision, and overlap apart from it, must vary within beds")
    bends = bool(varied[3]) and _independent(X, varied)
    p = _curvature_p(*_fit_within(X, Y, varied, len(beds))) if bends else math.nan
    varied = varied if curved and bends else linear
    slopes, inside, freedom = _fit_within(X, Y, varied, len(beds))
    within = math.sqrt(float(np.sum((Y - X @ slopes) ** 2)) / freedom)
    residuals = {bed: _residual_mean(runs, slopes) for bed, runs in beds.items()}
    filling, outside, by_slopes, between = _fit_fillings(beds, residuals, within)
    # the residual means depend on the slopes within beds, whose errors thereby enter those of the fillings
    along = inside @ by_slopes.T
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


def _fit_within(X: np.ndarray, Y: np.ndarray, varied: np.ndarray, beds: int) -> tuple[np.ndarray, np.ndarray, int]:
    """Fit the slopes within beds.

    Args:
        X: Factors less their means in each bed, shape [n, 4].
        Y: ln W less its mean in each bed, shape [n].
        varied: Factors that vary, shape [4].
        beds: Number of beds; the mean of each takes a degree of freedom.

    Returns:
        Slopes by the factors that vary, shape [4], their covariance, shape [4, 4], and the degrees of freedom.
    """
    Z, freedom = X[:, varied], len(Y) - beds - int(varied.sum())
    slopes, covariance, inverse = np.zeros(4), np.zeros((4, 4)), np.linalg.inv(Z.T @ Z)
    slopes[varied] = inverse @ Z.T @ Y
    covariance[np.ix_(varied, varied)] = float(np.sum((Y - X @ slopes) ** 2)) / freedom * inverse
    return slopes, covariance, freedom


def _curvature_p(slopes: np.ndarray, covariance: np.ndarray, freedom: int) -> float:
    from scipy.special import stdtr

    return float(2 * stdtr(freedom, -abs(slopes[3]) / math.sqrt(covariance[3, 3])))


def curved(p: Sequence[float], level: float = 0.05) -> list[bool]:
    """Decide in which of several scenes ln W is not linear in the overlap.

    If all scenes are linear, all are decided correctly with a probability of 1 - level, however many there are
    (Holm, Scand. J. Statist. 6 (1979) 65).

    Args:
        p: `curvature_p` of each scene; NaN counts as linear.
        level: Familywise error rate.
    """
    tested = sorted((value, index) for index, value in enumerate(p) if not math.isnan(value))
    decisions = [False] * len(p)
    for rank, (value, index) in enumerate(tested):
        if value * (len(tested) - rank) >= level:
            break
        decisions[index] = True
    return decisions


def _residual_mean(runs: Sequence[Observation], slopes: np.ndarray) -> float:
    """Mean of ln W of a bed, less the effect of the slopes."""
    return float(np.mean([math.log(run.rate) - slopes @ run.factors for run in runs]))


def _fit_fillings(
    beds: dict[str, list[Observation]], residuals: dict[str, float], within: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Fit the residual mean of each bed against the factors of its filling.

    A slope by a factor that does not vary is 0 with an infinite variance.

    Returns:
        Slopes, shape [2]; their covariance if the slopes within beds were exact, shape [2, 2]; their derivatives by the
        slopes within beds, shape [2, 4]; and the standard deviation from bed to bed of one run each.
    """
    y = np.array(list(residuals.values()))
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
    residual = float(np.sum((y - x @ slopes) ** 2)) / freedom
    covariance[np.ix_(varied, varied)] = residual * inverse
    # a residual mean over n runs keeps 1/n of the variance within beds
    share = float(np.mean([1 / len(runs) for runs in beds.values()]))
    between = math.sqrt(max(0.0, residual - share * within**2) + within**2)
    return slopes, covariance, by_slopes, between
