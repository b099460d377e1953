"""What numerics do to the flow rate of a scene, from runs of many settings and seeds at once.

ln W = (bed) + c_flow * overlap + c_step * step^2 is fitted within every bed that several settings flowed
from, so that the scatter between beds drops out; where runs of both precisions share beds, with a term for `mixed`.
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
        return [self.overlap, self.step**2, float(self.mixed)]

    @property
    def filling(self) -> list[float]:
        """What may differ between beds."""
        return [self.filled, float(self.filled_mixed)]


@dataclass(frozen=True)
class Slopes:
    """d ln W by overlap of the flow, by squared step, and by overlap of the filling, shape [3], with their covariance,
    shape [3, 3].

    `mixed_flow`: what a flow in mixed precision does to ln W, with the variance of that; None where no bed flowed in
    both. `mixed`: the same of flow and filling in mixed precision; None where beds were filled in one only.
    `within`: standard deviation of ln W between settings in one bed that the slopes do not explain; `between`: from
    bed to bed, runs of one setting. `freedom`: degrees of freedom of the fit within beds; `runs`, `beds`: how many
    there were. The slope by an overlap or a step that all runs share, or by an overlap that all beds were filled
    with, is 0 with an infinite variance.
    """

    values: np.ndarray
    covariance: np.ndarray
    mixed_flow: tuple[float, float] | None
    mixed: tuple[float, float] | None
    within: float
    between: float
    freedom: int
    runs: int
    beds: int


def regress(observed: Sequence[Observed]) -> Slopes:
    """Fit all runs at once. Raises ValueError for too few of them."""
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
    freedom = len(Y) - len(beds) - int(varied.sum())
    Z = X[:, varied]
    if freedom < 10 or not varied[1:].any() or np.linalg.matrix_rank(Z / np.abs(Z).max(axis=0)) < varied.sum():
        raise ValueError("too few runs: the step or the precision, and overlap apart from it, must vary within beds")
    known = np.ix_(varied, varied)
    slopes, inverse = np.zeros(3), np.linalg.inv(Z.T @ Z)
    slopes[varied] = inverse @ Z.T @ Y
    within = math.sqrt(float(np.sum((Y - X @ slopes) ** 2)) / freedom)
    inside = np.zeros((3, 3))
    inside[known] = within**2 * inverse
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
    mixed_flow = mixed = None
    if varied[2]:
        mixed_flow = float(slopes[2]), float(inside[2, 2])
        if math.isfinite(outside[1, 1]):
            mixed = float(slopes[2] + filling[1]), float(inside[2, 2] + outside[1, 1] + 2 * along[2, 1])
    return Slopes(
        values=np.array([slopes[0], slopes[1], filling[0]]),
        covariance=covariance,
        mixed_flow=mixed_flow,
        mixed=mixed,
        within=within,
        between=between,
        freedom=freedom,
        runs=len(observed),
        beds=len(beds),
    )


def _left(runs: Sequence[Observed], slopes: np.ndarray) -> float:
    """Mean of ln W of a bed, without what the slopes explain."""
    return float(np.mean([math.log(run.rate) - slopes @ run.factors for run in runs]))


def _filled(
    beds: dict[str, list[Observed]], left: dict[str, float], within: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Slopes of what is left of each bed by what differs between their fillings, shape [2], their covariance were the
    slopes within beds exact, shape [2, 2], their derivatives by these, shape [2, 3], and the standard deviation from
    bed to bed of one run each. The slope by what does not differ is 0 with an infinite variance."""
    y = np.array(list(left.values()))
    x = np.array([runs[0].filling for runs in beds.values()])
    factors = np.array([np.mean([run.factors for run in runs], axis=0) for runs in beds.values()])
    x, y = x - x.mean(axis=0), y - y.mean()
    varied = (x**2).sum(axis=0) > 1e-20
    slopes, by_slopes, covariance = np.zeros(2), np.zeros((2, 3)), np.diag(np.where(varied, 0.0, math.inf))
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
