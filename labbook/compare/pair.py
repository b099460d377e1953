"""The two backends of a comparison, each on its device and in its precision."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import get_args

from labbook.backend import Backend, Capabilities, load
from labbook.backend.numerics import Numerics, Precision
from labbook.backend.probes import Probe
from labbook.run.demand import PackingsOf, PointDemand
from labbook.study import Point, Study


class WrongPair(ValueError):
    """What was given does not name two backends, devices or precisions; the message says what would."""


@dataclass(frozen=True)
class Contestant:
    """A backend on a device. `precision`: the one that it works in; None: that of the study."""

    backend: Backend
    device: str
    precision: Precision | None = None

    @property
    def can(self) -> Capabilities:
        """What the backend says of itself."""
        return self.backend.capabilities

    @property
    def name(self) -> str:
        """The backend's name, with its precision where that is not the study's."""
        return called(self.can.name, self.precision)

    def numerics(self, given: Numerics) -> Numerics:
        """`given` in the precision of this side."""
        return given if self.precision is None else given.model_copy(update={"precision": self.precision})

    def at(self, point: Point) -> Point:
        """A point of the study as this side computes it."""
        return replace(point, numerics=self.numerics(point.numerics))

    def of(self, study: Study) -> Study:
        """The study as this side computes it."""
        return replace(study, points=tuple(map(self.at, study.points)))

    def packings(self, study: Study) -> PackingsOf:
        """What `study`'s points say of the packings that this side makes. Raises WrongPair if that is not one thing."""
        found: set[Precision] = {self.numerics(point.numerics).precision for point in study.points}
        if len(found) > 1:
            raise WrongPair("the study sweeps numerics.precision; say which to compare: --precisions double,mixed")
        return PackingsOf(self.can, found.pop())

    def try_out(self, shared: PointDemand, probes: Sequence[Probe]) -> None:
        """Open the scene of a point, and close it again.

        Raises Unsupported if the backend lacks something, or the device is not there.
        """
        spec = self.backend.specialise(shared.scene, shared.numerics, tuple(probes))
        self.backend.open(spec, 1, self.device).close()


Pair = tuple[Contestant, Contestant]
"""The backend that makes the shared packings, and the one that is compared with it."""


def pair(backends: str, devices: str, precisions: str | None = None) -> Pair:
    """From `numba,warp`, `cpu,cuda:0` and `double,mixed`. Raises WrongPair or BackendMissing."""
    names, places = two(backends, "--backends", "numba,warp"), two(devices, "--devices", "cpu,cuda:0")
    how = precisions_of(precisions)
    if (names[0], how[0]) == (names[1], how[1]):
        raise WrongPair(f"--backends: {names[0]} is compared with itself; name two backends, such as numba,warp")
    first, second = (Contestant(load(name), place, p) for name, place, p in zip(names, places, how, strict=True))
    return first, second


def names_of(backends: str, precisions: str | None = None) -> tuple[str, str]:
    """The names of both sides, without loading a backend. Raises WrongPair."""
    names, how = two(backends, "--backends", "numba,warp"), precisions_of(precisions)
    return called(names[0], how[0]), called(names[1], how[1])


def called(backend: str, precision: Precision | None) -> str:
    """What a side is called."""
    return f"{backend}-{precision}" if precision else backend


def precisions_of(text: str | None) -> tuple[Precision | None, Precision | None]:
    """Both precisions; None where the study's is meant. Raises WrongPair."""
    if text is None:
        return None, None
    known: dict[str, Precision] = {word: word for word in get_args(Precision)}
    words = two(text, "--precisions", "double,mixed")
    unknown = [word for word in words if word not in known]
    if unknown:
        raise WrongPair(f"--precisions: there is no {unknown[0]}; there are {', '.join(known)}")
    return known[words[0]], known[words[1]]


def two(text: str, option: str, example: str) -> tuple[str, str]:
    """Two words with a comma between them. Raises WrongPair."""
    words = [word.strip() for word in text.split(",")]
    if len(words) != 2 or not all(words):
        raise WrongPair(f"{option}: two words with a comma between them are needed, such as {example}, not {text!r}")
    return words[0], words[1]
