"""Report of the installation, a self-test of each backend on each of its devices, and the kernels of a study.

The self-test lets a grain bounce once.
"""

import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace

import numpy as np

from labbook.backend import (
    Backend,
    BackendMissing,
    Device,
    Unsupported,
    installed,
    load,
    machine,
)
from labbook.backend.numerics import Numerics
from labbook.plan.demand import PointDemand
from labbook.plugins import installed as extensions
from labbook.scene import ContactLaw, LinearSpringDashpot, Plane, Primitives, Scene, Spheres, Wall
from labbook.scene.packing import Packing
from labbook.scene.walls import WallShape
from labbook.study import Study
from labbook.version import __version__

PACKAGES = {
    "numpy": "everything",
    "scipy": "damping, fits, statistics",
    "pandas": "tables",
    "sqlalchemy": "the catalogue",
    "matplotlib": "figures",
    "numba": "the CPU backend",
    "warp-lang": "the GPU backend",
    "rerun-sdk": "recordings",
}


@dataclass(frozen=True)
class Package:
    """A package and its version; None if it is not installed."""

    name: str
    version: str | None
    purpose: str


@dataclass(frozen=True)
class BackendHealth:
    """Outcome of the self-test of a backend on a device. `device` is empty if the backend cannot be loaded."""

    name: str
    device: str
    works: bool
    note: str
    what: str = ""
    """Name and memory of the device, if the backend reports them."""
    precisions: tuple[str, ...] = ()
    laws: tuple[str, ...] = ()


@dataclass(frozen=True)
class Examination:
    """Report on packages, backends and hardware."""

    version: str
    hardware: dict[str, object]
    packages: tuple[Package, ...]
    backends: tuple[BackendHealth, ...]
    versions: dict[str, dict[str, str]]
    """Versions of the libraries below each backend, by name of the backend."""

    def as_dict(self) -> dict[str, object]:
        """Return plain values for JSON."""
        return asdict(self)


def examine(say: Callable[[str], None] = lambda _: None) -> Examination:
    """Examine packages and backends; a backend that fails is reported with its reason, never raised.

    `say` receives one line of progress at a time.
    """
    packages = tuple(Package(name, version, PACKAGES[name]) for name, version in machine.versions(PACKAGES).items())
    packages += _extending()
    backends: list[BackendHealth] = []
    versions: dict[str, dict[str, str]] = {}
    for name in sorted(installed()):
        try:
            say(f"loading {name}")
            backend = load(name)
            survey = backend.survey()
        except Exception as error:  # whatever is wrong with a backend is what a doctor is for
            backends.append(BackendHealth(name, "", False, _reason(error)))
            continue
        if survey.versions:
            versions[name] = dict(survey.versions)
        backends += _test(backend, {device.alias: _describe(device) for device in survey.devices}, say)
    return Examination(__version__, machine.hardware(), packages, tuple(backends), versions)


def _extending() -> tuple[Package, ...]:
    """List the packages that extend labbook, each with the names of its additions."""
    added: dict[tuple[str, str], list[str]] = {}
    for extension in extensions():
        added.setdefault((extension.package, extension.version), []).append(extension.use)
    return tuple(Package(name, version, f"adds {', '.join(uses)}") for (name, version), uses in added.items())


def _reason(error: Exception) -> str:
    return str(error) if isinstance(error, BackendMissing | Unsupported) else f"{type(error).__name__}: {error}"


def _describe(device: Device) -> str:
    return f"{device.name}, {device.memory / 2**30:.0f} GiB" if device.memory else device.name


def _test(backend: Backend, here: dict[str, str], say: Callable[[str], None]) -> list[BackendHealth]:
    """Test each device that the backend is made for, and each further device of this machine."""
    devices = dict.fromkeys((*backend.capabilities.devices, *here))
    results = []
    for device in devices:
        say(f"letting a grain bounce with {backend.capabilities.name} on {device} (compiles the first time)")
        results.append(replace(_test_on(backend, device), what=here.get(device, "")))
    return results


def _test_on(backend: Backend, device: str) -> BackendHealth:
    can = backend.capabilities
    precisions, laws = tuple(sorted(can.precisions)), tuple(sorted(can.laws))
    try:
        began = time.perf_counter()
        restitution = bounce(backend, device)
        spent = time.perf_counter() - began
    except Exception as error:  # whatever a backend does wrong is what a doctor is for
        return BackendHealth(can.name, device, False, _reason(error), precisions=precisions, laws=laws)
    works = abs(restitution - TARGET) < 0.01
    note = f"self-test: a bounce had e = {restitution:.3f} (expected {TARGET}), in {spent:.1f} s"
    return BackendHealth(can.name, device, works, note, precisions=precisions, laws=laws)


TARGET, SPEED, RADIUS = 0.8, 0.1, 5e-3
"""Restitution of the linear law in the self-test, speed of an impact [m/s] and radius of the grain [m]."""
_RESOLVED = 400
"""Steps of a collision by another law."""


def bounce(
    backend: Backend,
    device: str = "cpu",
    contact: ContactLaw | None = None,
    wall: WallShape | None = None,
    above: tuple[float, float, float] = (0.0, 0.0, 0.1),
) -> float:
    """Let a grain of 10 mm and 1000 kg/m^3 come down on a wall at 0.1 m/s, without gravity and spin.

    Args:
        backend: The backend that computes it.
        device: One of its devices.
        contact: The contact law; None: a linear spring of 10 kN/m with a restitution of 0.8.
        wall: The shape of the wall; None: the plane z = 0.
        above: A point above the wall [m]; the grain touches the wall straight below.

    Returns:
        Upward velocity after the impact over the speed before: the restitution, if the wall is level where it is hit.

    Raises:
        ValueError: There is no wall straight below `above`.
        Exception: Whatever the backend raises.
    """
    grains = Spheres(diameter=2 * RADIUS, density=1000, count=1)
    dt, gap = 2e-6, 1e-5
    if contact is not None:
        duration = contact.collision_time(grains.mass, RADIUS, SPEED)
        dt, gap = duration / _RESOLVED, 0.1 * duration * SPEED
    floor = Wall(name="floor", shape=wall or Plane(point=(0, 0, 0), normal=(0, 0, 1)))
    scene = Scene(
        grains=grains,
        contact=contact or LinearSpringDashpot(normal_stiffness=1e4, restitution=TARGET),
        container=Primitives(parts=(floor,)),
        gravity=0.0,
    )
    x = np.array([[0, 0, RADIUS + gap]]) if wall is None else _just_above(wall, np.array([above]), RADIUS + gap)
    numerics = Numerics(dt=dt, steps_per_beat=1000)
    ensemble = backend.open(backend.specialise(scene, numerics), 1, device)
    try:
        start = Packing(x=x, v=np.array([[0, 0, -SPEED]]), omega=np.zeros((1, 3)))
        member = ensemble.admit(scene, numerics, start)
        ensemble.advance(2)
        return float(ensemble.packing(member).v[0, 2]) / SPEED
    finally:
        ensemble.close()


def _just_above(wall: WallShape, x: np.ndarray, distance: float) -> np.ndarray:
    """Find the point straight below x [m], shape [1, 3], at a distance [m] from a wall.

    Each step is as long as the remaining distance, so that it never passes the wall.
    """
    before = math.inf
    while (excess := float(wall.distance(x)[0]) - distance) < before:
        if abs(excess) < 1e-6 * distance:
            return x
        x, before = x - np.array([0.0, 0.0, excess]), excess
    raise ValueError("there is no wall straight below `above`; choose another point")


class NoKernel(Exception):
    """There is no module of kernels to show; the message gives the reason and an alternative."""


def kernel(backend: Backend, study: Study, point: int) -> str:
    """Return the module that `backend` compiles for the discharges of a point of a study.

    Args:
        backend: The backend.
        study: The study.
        point: Number of the point, from 1.

    Raises:
        NoKernel: The point does not exist, or the backend has no such module.
        Unsupported, Conflict: The backend cannot run the point.
    """
    if point > len(study.points):
        raise NoKernel(f"--point: {study.name} has {len(study.points)} points, not a point {point}")
    shared = PointDemand(study, study.points[point - 1])
    text = backend.generated(backend.specialise(shared.scene, shared.numerics, shared.probes))
    if text is None:
        reason = f"the backend {backend.capabilities.name} has no module of kernels to print"
        raise NoKernel(f"--backend: {reason}; docs/kernels.md says how a debugger steps through it")
    return text
