"""How the error of a backend depends on the time step: single contacts against SciPy, and dense beds before chaos."""

import inspect
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from labbook.backend import Backend, load
from labbook.backend.machine import hardware
from labbook.checks.bench import bed, contacts
from labbook.checks.bench.bed import BedConvergence
from labbook.checks.bench.contacts import Convergence
from labbook.checks.verify.materials import EVERY_LAW, LAWS
from labbook.checks.verify.stand import Stand

QUICK = (10, 20, 40, 80)
"""Steps of a collision, in a quick measurement."""


@dataclass(frozen=True)
class AccuracyReport:
    """What one backend computes on this machine: errors of contacts and beds."""

    backend: str
    device: str
    hardware: dict[str, object]
    contacts: tuple[Convergence, ...]
    beds: tuple[BedConvergence, ...]

    def as_dict(self) -> dict[str, object]:
        """For JSON; numbers that are not there are None."""
        return _plain(asdict(self))


def run(
    name: str = "numba",
    precision: str | None = None,
    device: str = "cpu",
    quick: bool = False,
    say: Callable[[str], None] = lambda _: None,
) -> AccuracyReport:
    """Measure the backend called `name`.

    precision: None for every one that it has. quick: impacts of spheres only, by two laws, to 80 steps of a collision,
    and no bed.
    """
    backend = shared(load(name))
    can = backend.capabilities
    precisions = (precision,) if precision else tuple(sorted(can.precisions))
    laws, steps = (tuple(LAWS), QUICK) if quick else (tuple(EVERY_LAW), contacts.STEPS)
    rods = "spherocylinder" in can.shapes and not quick
    found: list[Convergence] = []
    for each in precisions:
        stand = Stand(backend, each, device)
        for law in laws:
            for situation in contacts.SITUATIONS:
                if (situation.rods and not rods) or (law, situation.name) in contacts.UNSETTLED:
                    continue
                say(f"{law}, {each}: {situation.name}")
                found.append(contacts.converge(stand, situation, law, steps))
    beds: list[BedConvergence] = []
    for called, scene in () if quick else bed.beds(rods):
        say(f"settling {called}")
        resting = bed.settled(backend, scene, device)
        beds += [bed.converge(Stand(backend, p, device), called, scene, resting, say) for p in precisions]
    return AccuracyReport(name, device, hardware(), tuple(found), tuple(beds))


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def shared(backend: Backend) -> Backend:
    """The same backend, with kernels that many scenes share where it has such: most of the time goes into compiling."""
    maker: Any = type(backend)
    return maker(wide=True) if "wide" in inspect.signature(maker).parameters else backend
