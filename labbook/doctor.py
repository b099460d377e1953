"""What is installed, and whether the engines work: each lets a grain bounce once on each of its devices."""

import time
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version

import numpy as np

from labbook import __version__, backend
from labbook.bench.hardware import hardware
from labbook.numerics import Numerics
from labbook.protocol.packing import Packing
from labbook.scene import LinearSpringDashpot, Plane, Primitives, Scene, Spheres, Wall

PACKAGES = {
    "numpy": "everything",
    "scipy": "damping, fits, statistics",
    "pandas": "tables",
    "sqlalchemy": "the catalogue",
    "matplotlib": "figures",
    "numba": "the CPU engine",
    "warp-lang": "the GPU engine",
    "rerun-sdk": "recordings",
}


@dataclass(frozen=True)
class Package:
    """A package and its installed version, if any."""

    name: str
    version: str | None
    purpose: str


@dataclass(frozen=True)
class EngineHealth:
    """Whether an engine works on one of its devices, and what it can do. `device` is empty if it cannot be
    loaded."""

    name: str
    device: str
    works: bool
    note: str
    precisions: tuple[str, ...] = ()
    laws: tuple[str, ...] = ()


@dataclass(frozen=True)
class Examination:
    """All that was found."""

    version: str
    hardware: dict[str, object]
    packages: tuple[Package, ...]
    engines: tuple[EngineHealth, ...]

    def as_dict(self) -> dict[str, object]:
        """For JSON."""
        return asdict(self)


def examine() -> Examination:
    """Look at packages and engines; an engine that fails is reported with its reason, never raised."""
    packages = tuple(Package(name, _version(name), purpose) for name, purpose in PACKAGES.items())
    engines = tuple(found for name in sorted(backend.installed()) for found in _try(name))
    return Examination(__version__, hardware(), packages, engines)


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _try(name: str) -> list[EngineHealth]:
    try:
        engine = backend.load(name)
    except backend.BackendMissing as error:
        return [EngineHealth(name, "", False, str(error))]
    return [_try_on(engine, device) for device in engine.capabilities.devices]


def _try_on(engine: backend.Backend, device: str) -> EngineHealth:
    can = engine.capabilities
    abilities = (tuple(sorted(can.precisions)), tuple(sorted(can.laws)))
    try:
        began = time.perf_counter()
        restitution = bounce(engine, device)
        spent = time.perf_counter() - began
    except Exception as error:  # whatever an engine does wrong is what a doctor is for
        return EngineHealth(can.name, device, False, f"{type(error).__name__}: {error}", *abilities)
    works = abs(restitution - ASKED) < 0.01
    note = f"self-test: a bounce gave back e = {restitution:.3f} (asked {ASKED}), in {spent:.1f} s"
    return EngineHealth(can.name, device, works, note, *abilities)


ASKED = 0.8


def bounce(engine: backend.Backend, device: str) -> float:
    """Restitution of a grain that hits a plane at 0.1 m/s, on one device. Raises what the engine raises."""
    floor = Wall(name="floor", shape=Plane(point=(0, 0, 0), normal=(0, 0, 1)))
    scene = Scene(
        grains=Spheres(diameter=1e-2, density=1000, count=1),
        contact=LinearSpringDashpot(normal_stiffness=1e4, restitution=ASKED),
        container=Primitives(parts=(floor,)),
        gravity=0.0,
    )
    numerics = Numerics(dt=2e-6, steps_per_beat=1000)
    ensemble = engine.open(engine.specialise(scene, numerics), 1, device)
    try:
        start = Packing(x=np.array([[0, 0, 5.01e-3]]), v=np.array([[0, 0, -0.1]]), omega=np.zeros((1, 3)))
        member = ensemble.admit(scene, numerics, start)
        ensemble.advance(2)
        return float(ensemble.packing(member).v[0, 2]) / 0.1
    finally:
        ensemble.close()
