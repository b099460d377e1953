"""A silo of rods, and one member of the GPU engine that steps it."""

from labbook_warp import Backend

from labbook.numerics import Numerics
from labbook.scene import CylinderSilo, LinearSpringDashpot, Scene, Spherocylinders

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


def numerics(precision: str, **further) -> Numerics:
    return Numerics.model_validate({"dt": 5e-6, "precision": precision, "steps_per_beat": 250, **further})


def run(scene, how, start, beats, probes=(), lanes=None, device="cpu"):
    """One member, advanced: its packing and rows."""
    engine = Backend(lanes=lanes)
    ensemble = engine.open(engine.specialise(scene, how, probes), 1, device)
    member = ensemble.admit(scene, how, start)
    events = ensemble.advance(beats)
    assert not events, events
    state, tables = ensemble.packing(member), ensemble.drain()
    ensemble.close()
    return state, tables
