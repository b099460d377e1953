"""Which law do the data prefer? Akaike's criterion for few points."""

import math
from collections.abc import Mapping

UNDECIDED = "undecided"
DECISIVE = 4.0
"""A difference in AICc below this does not choose (Burnham & Anderson, Model Selection, 2002, section 2.6).
"""


def deviance(chi2: float, points: int) -> float:
    """-2 ln(likelihood) of a least-squares fit whose errors are known but for their size: n ln(chi2/n)."""
    if chi2 < 0:
        raise ValueError("a sum of squares cannot be negative")
    return points * math.log(chi2 / points) if chi2 > 0 else -math.inf


def aicc(chi2: float, points: int, parameters: int) -> float:
    """AICc of a least-squares fit: deviance + 2K + 2K(K+1)/(n-K-1), with K = parameters + 1.

    The K-th parameter is the overall size of the errors, which is left free: replicates give the weights of
    the points relative to each other, but too few of them to be sure of the size. Hurvich & Tsai, Biometrika
    76 (1989) 297. NaN unless there are more points than parameters + 2.
    """
    k = parameters + 1
    if points <= parameters + 2:
        return math.nan
    return deviance(chi2, points) + 2 * k + 2 * k * (k + 1) / (points - k - 1)


def prefer(criteria: Mapping[str, float]) -> str:
    """Name of the law with the lowest AICc (or deviance); `undecided` if another is within 4 or any has none (NaN).

    Raises ValueError for no laws. All must have been fitted to the same data.
    """
    if not criteria:
        raise ValueError("no law to choose from")
    if any(math.isnan(value) for value in criteria.values()):
        return UNDECIDED
    ranked = sorted(criteria, key=lambda name: criteria[name])
    if len(ranked) > 1 and not criteria[ranked[1]] - criteria[ranked[0]] >= DECISIVE:
        return UNDECIDED
    return ranked[0]
