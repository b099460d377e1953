"""How the shape of profiles approaches that in the middle of a hopper: tilts and exponents of each point against s*."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

from labbook.fit import FitError, Parameter
from labbook.fit.outlet import Approach, ProfileFit, fit_approach, fit_profiles
from labbook.report.points import PointResult
from labbook.report.ratios import Ratio
from labbook.report.series import context

SHAPE = ("delta1", "sigma1", "delta2", "sigma2")
"""What is followed: tilts and exponents of eqs 16 and 17."""
FEWEST = 4
"""Different s* without which an approach, of three parameters, is not fitted."""


@dataclass(frozen=True, eq=False)
class Approached:
    """One of SHAPE: `parameters` of the points `of`, at s* `places`; and how they approach, None for few places."""

    of: tuple[PointResult, ...]
    places: tuple[float, ...]
    parameters: tuple[Parameter, ...]
    approach: Approach | None


def approaches(ratios: Sequence[Ratio], definition: str) -> Mapping[str, Approached]:
    """The parameters of SHAPE against s*, by name, of those points that have profiles along their outlet.

    Every point counts alike, whatever its outlet and the width of its hopper: s* is what they are said to depend on.
    """
    shown = [one for one in ratios if one.result.outlets(definition) and _fitted(one.result, definition)]
    found = {}
    for name in SHAPE:
        parameters = tuple(_own(one.result, definition).parameters[name] for one in shown)
        places = tuple(one.at for one in shown)
        several = len(set(places)) >= FEWEST
        law = fit_approach(places, [one.value for one in parameters]) if several else None
        found[name] = Approached(tuple(one.result for one in shown), places, parameters, law)
    return found


def _fitted(result: PointResult, definition: str) -> bool:
    """Whether its profiles can be fitted: some grains must have moved across the outlet."""
    try:
        _own(result, definition)
    except FitError:
        return False
    return True


@lru_cache(maxsize=4096)
def _own(result: PointResult, definition: str) -> ProfileFit:
    """The fit to one point alone; its bootstrap is worth keeping: page and comparison both want it."""
    return fit_profiles([result.outlets(definition)], context([result]))
