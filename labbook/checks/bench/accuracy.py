"""Measurement of a backend's error by time step: single contacts against SciPy, and dense beds before chaos."""

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
from labbook.checks.verify.platform import Platform

QUICK = (10, 20, 40, 80)
"""Steps of a collision, in a quick measurement."""


@dataclass(frozen=True)
class AccuracyReport:
    """Errors of one backend on this machine.

    Args:
        backend: Name of the backend.
        device: Device that it ran on.
        hardware: Processor and memory, as `labbook.backend.machine.hardware` gives them.
        contacts: Errors of single contacts, one for each situation, law and precision.
        beds: Errors of dense beds, one for each bed and precision.
    """

    backend: str
    device: str
    hardware: dict[str, object]
    contacts: tuple[Convergence, ...]
    beds: tuple[BedConvergence, ...]

    def as_dict(self) -> dict[str, object]:
        """Return plain values for JSON; NaN and infinities become None."""
        return _plain(asdict(self))


def run(
    name: str = "numba",
    precision: str | None = None,
    device: str = "cpu",
    quick: bool = False,
    say: Callable[[str], None] = lambda _: None,
) -> AccuracyReport:
    """Measure the error of a backend against its time step.

    Args:
        name: Name of the backend.
        precision: Precision to measure; None: each one that the backend has.
        device: Device to run on.
        quick: Measure only impacts of spheres, by two laws, with at most 80 steps a collision; no beds.
        say: Receives one line of progress at a time.

    Raises:
        BackendMissing: The backend is not installed.
    """
    backend = shared(load(name))
    can = backend.capabilities
    precisions = (precision,) if precision else tuple(sorted(can.precisions))
    laws, steps = (tuple(LAWS), QUICK) if quick else (tuple(EVERY_LAW), contacts.STEPS)
    rods = "spherocylinder" in can.shapes and not quick
    errors: list[Convergence] = []
    for precision_name in precisions:
        platform = Platform(backend, precision_name, device)
        for law in laws:
            for situation in contacts.SITUATIONS:
                if (situation.rods and not rods) or (law, situation.name) in contacts.UNSETTLED:
                    continue
                say(f"{law}, {precision_name}: {situation.name}")
                errors.append(contacts.converge(platform, situation, law, steps))
    beds: list[BedConvergence] = []
    for name_of_bed, scene in () if quick else bed.beds(rods):
        say(f"settling {name_of_bed}")
        resting = bed.settle(backend, scene, device)
        beds += [bed.converge(Platform(backend, p, device), name_of_bed, scene, resting, say) for p in precisions]
    return AccuracyReport(name, device, hardware(), tuple(errors), tuple(beds))


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def shared(backend: Backend) -> Backend:
    """Return the same backend, with kernels shared between scenes if it has them: compiling takes most of the time."""
    maker: Any = type(backend)
    return maker(wide=True) if "wide" in inspect.signature(maker).parameters else backend
