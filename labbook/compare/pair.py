"""The two engines of a comparison, each on its device."""

from collections.abc import Sequence
from dataclasses import dataclass

from labbook.backend import Backend, Capabilities, Probe, load
from labbook.plan.demand import PointDemand


class WrongPair(ValueError):
    """What was given does not name two engines and their devices; the message says what would."""


@dataclass(frozen=True)
class Contestant:
    """An engine on a device."""

    backend: Backend
    device: str

    @property
    def can(self) -> Capabilities:
        """What the engine says of itself."""
        return self.backend.capabilities

    @property
    def name(self) -> str:
        """The engine's name."""
        return self.can.name

    def try_out(self, shared: PointDemand, probes: Sequence[Probe]) -> None:
        """Open the scene of a point, and close it again.

        Raises Unsupported if the engine lacks something, or the device is not there.
        """
        spec = self.backend.specialise(shared.scene, shared.numerics, tuple(probes))
        self.backend.open(spec, 1, self.device).close()


Pair = tuple[Contestant, Contestant]
"""The engine that makes the shared packings, and the one that is compared with it."""


def pair(backends: str, devices: str) -> Pair:
    """From `numba,warp` and `cpu,cuda:0`. Raises WrongPair or BackendMissing."""
    names, places = _two(backends, "--backends", "numba,warp"), _two(devices, "--devices", "cpu,cuda:0")
    if names[0] == names[1]:
        raise WrongPair(f"--backends: {names[0]} is compared with itself; name two engines, such as numba,warp")
    first, second = (Contestant(load(name), place) for name, place in zip(names, places, strict=True))
    return first, second


def _two(text: str, option: str, example: str) -> list[str]:
    words = [word.strip() for word in text.split(",")]
    if len(words) != 2 or not all(words):
        raise WrongPair(f"{option}: two words with a comma between them are needed, such as {example}, not {text!r}")
    return words
