"""What is installed, and whether the backends work: each lets a grain bounce once on each of its devices; and what a
backend compiles for a study."""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace

import numpy as np

from labbook.backend import (
    Backend,
    BackendMissing,
    Device,
    Generates,
    Survey,
    Surveys,
    Unsupported,
    installed,
    load,
    machine,
)
from labbook.backend.numerics import Numerics
from labbook.plan.demand import PointDemand
from labbook.plugins import extensions
from labbook.scene import LinearSpringDashpot, Plane, Primitives, Scene, Spheres, Wall
from labbook.scene.packing import Packing
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
    """A package and its installed version, if any."""

    name: str
    version: str | None
    purpose: str


@dataclass(frozen=True)
class BackendHealth:
    """Whether a backend works on one of its devices, and what it can do. `device` is empty if it cannot be
    loaded."""

    name: str
    device: str
    works: bool
    note: str
    what: str = ""
    """Name and memory of the device, where the backend tells them."""
    precisions: tuple[str, ...] = ()
    laws: tuple[str, ...] = ()


@dataclass(frozen=True)
class Examination:
    """All that was found."""

    version: str
    hardware: dict[str, object]
    packages: tuple[Package, ...]
    backends: tuple[BackendHealth, ...]
    versions: dict[str, dict[str, str]]
    """By backend, of what it stands on."""

    def as_dict(self) -> dict[str, object]:
        """For JSON."""
        return asdict(self)


def examine(say: Callable[[str], None] = lambda _: None) -> Examination:
    """Look at packages and backends; a backend that fails is reported with its reason, never raised.

    say: called with what is going on.
    """
    packages = tuple(Package(name, found, PACKAGES[name]) for name, found in machine.versions(PACKAGES).items())
    packages += tuple(Package(name, version, "extends labbook") for name, version in extensions().items())
    backends: list[BackendHealth] = []
    versions: dict[str, dict[str, str]] = {}
    for name in sorted(installed()):
        try:
            say(f"loading {name}")
            backend = load(name)
            found = backend.survey() if isinstance(backend, Surveys) else Survey({}, ())
        except Exception as error:  # whatever is wrong with a backend is what a doctor is for
            backends.append(BackendHealth(name, "", False, _reason(error)))
            continue
        if found.versions:
            versions[name] = dict(found.versions)
        backends += _try(backend, {device.alias: _what(device) for device in found.devices}, say)
    return Examination(__version__, machine.hardware(), packages, tuple(backends), versions)


def _reason(error: Exception) -> str:
    return str(error) if isinstance(error, BackendMissing | Unsupported) else f"{type(error).__name__}: {error}"


def _what(device: Device) -> str:
    return f"{device.name}, {device.memory / 2**30:.0f} GiB" if device.memory else device.name


def _try(backend: Backend, here: dict[str, str], say: Callable[[str], None]) -> list[BackendHealth]:
    """One line for each device that the backend is made for, and for each further one that is here."""
    devices = dict.fromkeys((*backend.capabilities.devices, *here))
    tried = []
    for device in devices:
        say(f"letting a grain bounce with {backend.capabilities.name} on {device} (compiles the first time)")
        tried.append(replace(_try_on(backend, device), what=here.get(device, "")))
    return tried


def _try_on(backend: Backend, device: str) -> BackendHealth:
    can = backend.capabilities
    precisions, laws = tuple(sorted(can.precisions)), tuple(sorted(can.laws))
    try:
        began = time.perf_counter()
        restitution = bounce(backend, device)
        spent = time.perf_counter() - began
    except Exception as error:  # whatever a backend does wrong is what a doctor is for
        return BackendHealth(can.name, device, False, _reason(error), precisions=precisions, laws=laws)
    works = abs(restitution - ASKED) < 0.01
    note = f"self-test: a bounce gave back e = {restitution:.3f} (asked {ASKED}), in {spent:.1f} s"
    return BackendHealth(can.name, device, works, note, precisions=precisions, laws=laws)


ASKED = 0.8


def bounce(backend: Backend, device: str) -> float:
    """Restitution of a grain that hits a plane at 0.1 m/s, on one device. Raises what the backend raises."""
    floor = Wall(name="floor", shape=Plane(point=(0, 0, 0), normal=(0, 0, 1)))
    scene = Scene(
        grains=Spheres(diameter=1e-2, density=1000, count=1),
        contact=LinearSpringDashpot(normal_stiffness=1e4, restitution=ASKED),
        container=Primitives(parts=(floor,)),
        gravity=0.0,
    )
    numerics = Numerics(dt=2e-6, steps_per_beat=1000)
    ensemble = backend.open(backend.specialise(scene, numerics), 1, device)
    try:
        start = Packing(x=np.array([[0, 0, 5.01e-3]]), v=np.array([[0, 0, -0.1]]), omega=np.zeros((1, 3)))
        member = ensemble.admit(scene, numerics, start)
        ensemble.advance(2)
        return float(ensemble.packing(member).v[0, 2]) / 0.1
    finally:
        ensemble.close()


class NoKernel(Exception):
    """There is no module of kernels to show; the message says why, and what to look at."""


def kernel(backend: Backend, study: Study, point: int) -> str:
    """The module that `backend` compiles for the discharges of a point of a study, counted from 1.

    Raises NoKernel, Unsupported and Conflict.
    """
    if not isinstance(backend, Generates):
        told = f"the backend {backend.capabilities.name} has no module of kernels to print"
        raise NoKernel(f"--backend: {told}; docs/kernels.md says how a debugger steps through it")
    if point > len(study.points):
        raise NoKernel(f"--point: {study.name} has {len(study.points)} points, not a point {point}")
    shared = PointDemand(study, study.points[point - 1])
    return backend.generated(backend.specialise(shared.scene, shared.numerics, shared.probes))
