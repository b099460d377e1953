"""Choice between laws: Akaike's criterion for few points."""

import math
from collections.abc import Mapping, Sequence

DECISIVE = 4.0
"""Difference in AICc from which on a law is beaten (Burnham & Anderson, Model Selection, 2002, section 2.6)."""


def deviance(chi2: float, points: int) -> float:
    """-2 ln(likelihood) of a least-squares fit whose errors are known up to a common factor: n ln(chi2/n)."""
    if chi2 < 0:
        raise ValueError("a sum of squares cannot be negative")
    return points * math.log(chi2 / points) if chi2 > 0 else -math.inf


def aicc(chi2: float, points: int, parameters: int) -> float:
    """AICc of a least-squares fit: deviance + 2K + 2K(K+1)/(n-K-1), with K = parameters + 1.

    The K-th parameter is the common size of the errors, which is fitted: replicates give the relative weights of
    points, but are too few to determine the size. Hurvich & Tsai, Biometrika 76 (1989) 297.

    Args:
        chi2: Sum of squares.
        points: Number of points n.
        parameters: Number of parameters of the law.

    Returns:
        The criterion; NaN unless there are more points than parameters + 2.
    """
    k = parameters + 1
    if points <= parameters + 2:
        return math.nan
    return deviance(chi2, points) + 2 * k + 2 * k * (k + 1) / (points - k - 1)


def best_laws(criteria: Mapping[str, Sequence[float]]) -> tuple[str, ...]:
    """Names of the laws that no other law beats, in the order given.

    A law beats another if it is smaller by DECISIVE or more in every criterion. A NaN beats nothing and is not beaten.

    Args:
        criteria: Criteria (AICc, deviance) of each law by name, all fitted to the same data.

    Raises:
        ValueError: There are no laws.
    """
    if not criteria:
        raise ValueError("no law to choose from")
    return tuple(
        name for name, ours in criteria.items() if not any(_beats(theirs, ours) for theirs in criteria.values())
    )


def _beats(winner: Sequence[float], loser: Sequence[float]) -> bool:
    return all(b - a >= DECISIVE for a, b in zip(winner, loser, strict=True))
