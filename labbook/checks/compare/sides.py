"""The two sides of a comparison: each a backend on a device, in a precision."""

from dataclasses import dataclass, replace
from typing import get_args

from labbook.backend import Backend, Capabilities, load
from labbook.backend.numerics import Numerics, Precision
from labbook.checks.compare.verdict import Entrant, called
from labbook.plan.demand import PackingsOf, PointDemand
from labbook.study import Point, Study


class CannotCompare(ValueError):
    """What is asked cannot be compared; the message says why and what to do."""


@dataclass(frozen=True)
class Side:
    """A backend on a device. `precision`: the one that it works in; None: that of the study."""

    backend: Backend
    device: str
    precision: Precision | None = None

    @property
    def can(self) -> Capabilities:
        """What the backend says of itself."""
        return self.backend.capabilities

    @property
    def entrant(self) -> Entrant:
        """As a verdict names it."""
        can = self.can
        return Entrant(name=can.name, cache_version=can.cache_version, device=self.device, precision=self.precision)

    def numerics(self, given: Numerics) -> Numerics:
        """`given` in the precision of this side."""
        return given if self.precision is None else given.model_copy(update={"precision": self.precision})

    def of(self, study: Study) -> Study:
        """The study as this side computes it."""
        points = (replace(point, numerics=self.numerics(point.numerics)) for point in study.points)
        return replace(study, points=tuple(points))

    def packings(self, study: Study) -> PackingsOf:
        """The packings that this side makes for `study`. Raises CannotCompare if they are of several precisions."""
        found: set[Precision] = {point.numerics.precision for point in self.of(study).points}
        if len(found) > 1:
            raise CannotCompare("the study sweeps numerics.precision; say which to compare: --precisions double,mixed")
        return PackingsOf(self.can, found.pop())


Pair = tuple[Side, Side]
"""The side that makes the shared packings, and the one that is compared with it."""


def from_shared(study: Study, point: Point, pair: Pair) -> tuple[PointDemand, PointDemand]:
    """The runs of a point on both sides, from the first side's packings."""
    packings = pair[0].packings(study)
    first, second = (replace(point, numerics=one.numerics(point.numerics)) for one in pair)
    return PointDemand(study, first, packings), PointDemand(study, second, packings)


def parse(backends: str, devices: str, precisions: str | None = None) -> Pair:
    """From `numba,warp`, `cpu,cuda:0` and `double,mixed`. Raises CannotCompare or BackendMissing."""
    names, (here, there) = _two(backends, "--backends", "numba,warp"), _two(devices, "--devices", "cpu,cuda:0")
    one, other = _precisions(precisions)
    _differ((names[0], one), (names[1], other))
    return Side(load(names[0]), here, one), Side(load(names[1]), there, other)


def names_of(backends: str, precisions: str | None = None) -> tuple[str, str]:
    """What both sides are called, without loading a backend. Raises CannotCompare."""
    one, other = zip(_two(backends, "--backends", "numba,warp"), _precisions(precisions), strict=True)
    _differ(one, other)
    return called(*one), called(*other)


def _differ(one: tuple[str, Precision | None], other: tuple[str, Precision | None]) -> None:
    if one == other:
        remedy = "name two backends, such as numba,warp, or --precisions double,mixed"
        raise CannotCompare(f"--backends: {one[0]} is compared with itself; {remedy}")


def _precisions(text: str | None) -> tuple[Precision | None, Precision | None]:
    if text is None:
        return None, None
    known: dict[str, Precision] = {word: word for word in get_args(Precision)}
    words = _two(text, "--precisions", "double,mixed")
    if unknown := [word for word in words if word not in known]:
        raise CannotCompare(f"--precisions: no precision is called {unknown[0]}; use two of {', '.join(known)}")
    return known[words[0]], known[words[1]]


def _two(text: str, option: str, example: str) -> tuple[str, str]:
    words = [word.strip() for word in text.split(",")]
    if len(words) != 2 or not all(words):
        wanted = f"two names separated by a comma are needed, such as {example}"
        raise CannotCompare(f"{option}: {wanted}, not {text!r}")
    return words[0], words[1]
