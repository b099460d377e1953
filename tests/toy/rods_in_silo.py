"""Rods in a silo whose bottom turns, and in a trough: scenes for tests of a backend, and one member that it steps."""

from labbook.backend.numerics import Numerics
from labbook.scene import Box, CylinderSilo, LinearSpringDashpot, Primitives, Scene, Spherocylinders, Strip, Wall

D, DENSITY = 6e-3, 620.0
PRECISIONS = ["double", "mixed"]
ROUNDING = {"double": 1e-9, "mixed": 1e-3}


def law(grains) -> LinearSpringDashpot:
    stiffness = 2e5 * grains.mass * 9.81 / D
    return LinearSpringDashpot(normal_stiffness=stiffness, friction=0.5, rolling_friction=0.01, restitution=0.5)


def silo(grains: int) -> Scene:
    rods = Spherocylinders(diameter=D, length=3.3 * D, density=DENSITY, count=grains)
    flat = CylinderSilo(diameter=0.08, height=0.3, orifice=0.05, rotation=2.0)
    return Scene(grains=rods, contact=law(rods), container=flat)


def trough() -> Scene:
    """Planes, and strips with a slot between them: the other walls."""
    half, edge = 0.04, 0.012
    sides = Box(width=2 * half, depth=2 * half, height=1.0).walls()[:4]
    plates = (
        Wall(name="bottom-left", shape=Strip(start=(-half, 0), end=(-edge, 0))),
        Wall(name="bottom-right", shape=Strip(start=(edge, 0), end=(half, 0))),
    )
    return silo(40).model_copy(update={"container": Primitives(parts=(*sides, *plates), outlet_plane=0.0)})


def numerics(precision: str, **further) -> Numerics:
    return Numerics.model_validate({"dt": 5e-6, "precision": precision, "steps_per_beat": 250, **further})


def advanced(backend, scene: Scene, how: Numerics, start, beats: int, probes=(), device: str = "cpu"):
    """One member of `backend` after so many beats, without an event: its packing and rows."""
    ensemble = backend.open(backend.specialise(scene, how, probes), 1, device)
    member = ensemble.admit(scene, how, start)
    events = ensemble.advance(beats)
    assert not events, events
    state, tables = ensemble.packing(member), ensemble.drain()
    ensemble.close()
    return state, tables
