"""Which law do the data prefer? Akaike's criterion for few points."""

import math
from collections.abc import Mapping, Sequence

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


def unbeaten(criteria: Mapping[str, Sequence[float]]) -> tuple[str, ...]:
    """Names of the laws that no other beats, in the order given: by 4 or more in every one of its criteria (AICc,
    deviance). A criterion that is NaN beats nothing and is not beaten.

    Raises ValueError for no laws. All must have been fitted to the same data.
    """
    if not criteria:
        raise ValueError("no law to choose from")
    return tuple(
        name for name, ours in criteria.items() if not any(_beats(theirs, ours) for theirs in criteria.values())
    )


def _beats(one: Sequence[float], other: Sequence[float]) -> bool:
    return all(b - a >= DECISIVE for a, b in zip(one, other, strict=True))
