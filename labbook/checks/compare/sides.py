"""The two sides of a comparison: each a backend on a device, in a precision."""

from dataclasses import dataclass, replace

from labbook.backend import Backend, Capabilities, load
from labbook.backend.numerics import Numerics, Precision
from labbook.checks.compare.verdict import Entrant
from labbook.plan.demand import PackingsOf, PointDemand
from labbook.study import Point, Study


class CannotCompare(ValueError):
    """The comparison is impossible; the message gives the reason and the remedy."""


@dataclass(frozen=True)
class Side:
    """A backend on a device.

    Args:
        backend: The backend.
        device: One of its devices.
        precision: Precision of its runs; None: that of the study.
    """

    backend: Backend
    device: str
    precision: Precision | None = None

    @property
    def can(self) -> Capabilities:
        """Capabilities of the backend."""
        return self.backend.capabilities

    @property
    def entrant(self) -> Entrant:
        """Name, version, device and precision for a verdict."""
        can = self.can
        return Entrant(name=can.name, cache_version=can.cache_version, device=self.device, precision=self.precision)

    def numerics(self, numerics: Numerics) -> Numerics:
        """Return `numerics` in the precision of this side."""
        return numerics if self.precision is None else numerics.model_copy(update={"precision": self.precision})

    def of(self, study: Study) -> Study:
        """Return the study in the precision of this side."""
        points = (replace(point, numerics=self.numerics(point.numerics)) for point in study.points)
        return replace(study, points=tuple(points))

    def packings(self, study: Study) -> PackingsOf:
        """Return the packings that this side makes for `study`. Raises CannotCompare if their precisions differ."""
        precisions: set[Precision] = {point.numerics.precision for point in self.of(study).points}
        if len(precisions) > 1:
            raise CannotCompare("the study sweeps numerics.precision; say which to compare: --precisions double,mixed")
        return PackingsOf(self.can, precisions.pop())


Pair = tuple[Side, Side]
"""The side that makes the shared packings, and the one that is compared with it."""


def from_shared(study: Study, point: Point, pair: Pair) -> tuple[PointDemand, PointDemand]:
    """Return the runs of a point on both sides, from the first side's packings."""
    packings = pair[0].packings(study)
    first, second = (replace(point, numerics=side.numerics(point.numerics)) for side in pair)
    return PointDemand(study, first, packings), PointDemand(study, second, packings)


Precisions = tuple[Precision | None, Precision | None]
"""Of both sides; None: that of the study."""


def pair_of(names: tuple[str, str], devices: tuple[str, str], precisions: Precisions = (None, None)) -> Pair:
    """Load both sides of a comparison.

    Args:
        names: Names of the backends; the first one makes the shared packings.
        devices: Device of each backend.
        precisions: Precision of each backend; None: that of the study.

    Returns:
        Both sides.

    Raises:
        CannotCompare: Both sides are the same.
        BackendMissing: A backend is not installed.
    """
    refuse_same(names, precisions)
    first, second = map(load, names)
    return Side(first, devices[0], precisions[0]), Side(second, devices[1], precisions[1])


def refuse_same(names: tuple[str, str], precisions: Precisions) -> None:
    """Raise CannotCompare for two sides that are the same."""
    if (names[0], precisions[0]) == (names[1], precisions[1]):
        raise CannotCompare(f"{names[0]} is compared with itself; compare two backends, or two precisions of one")
