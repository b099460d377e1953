"""Symmetries of a round silo of rods whose bottom turns: turned about its axis, and seen in a mirror."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from labbook.checks.verify.case import Case, limited
from labbook.checks.verify.platform import MemberStart, Platform, require
from labbook.checks.verify.rods import ROD
from labbook.checks.verify.symmetry import mirrored
from labbook.filling.opening import start_of_discharge
from labbook.filling.placing import place
from labbook.scene import CylinderSilo, LinearSpringDashpot, Scene
from labbook.scene.packing import Packing

DT = 1e-5
LATER = {"after 2 ms": 200, "after 10 ms": 1000}


def silo() -> Scene:
    """40 rods in a cylinder of 60 mm over a hole of 30 mm whose edge turns once a second."""
    container = CylinderSilo(diameter=60e-3, height=1.0, orifice=30e-3, rotation=1.0)
    law = LinearSpringDashpot(normal_stiffness=200, friction=0.5, rolling_friction=0.01, restitution=0.5)
    grains = ROD.model_copy(update={"count": 40})
    return Scene(grains=grains, contact=law, container=container)


def turned(packing: Packing, angle: float) -> Packing:
    """Turn a packing by `angle` [rad] about the z axis."""
    c, s = math.cos(angle), math.sin(angle)
    rotation = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])  # of rows
    assert packing.q is not None
    w, x, y, z = packing.q.T
    c, s = math.cos(angle / 2), math.sin(angle / 2)
    q = np.column_stack([c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w])
    vectors = {name: getattr(packing, name) @ rotation for name in ("x", "v", "omega", "pair_spring", "wall_spring")}
    return replace(packing, q=q, **vectors)


def _compare(platform: Platform, transform, scene: Scene, inverse) -> Mapping[str, float]:
    """Largest differences in position [d] between a discharge and its transformed image, by time."""
    closed = silo().close()
    fallen = platform.run(MemberStart(closed, DT, place(closed, "gas", 1)), 30).end
    start, errors = start_of_discharge(fallen, closed, silo()), {}
    for name, steps in LATER.items():
        original = platform.run(MemberStart(silo(), DT, start), 1, steps).end
        image = platform.run(MemberStart(scene, DT, transform(start)), 1, steps).end
        require(len(original) == len(image) == len(start), "a rod has left")
        require(len(original.pairs) > 20, "the rods do not touch")
        require(float(np.linalg.norm(original.v, axis=1).max()) > 0.01, "the rods do not move")
        errors[name] = float(np.abs(original.x - inverse(image).x).max()) / ROD.diameter
    return errors


def _turns(platform: Platform) -> Mapping[str, float]:
    return _compare(platform, lambda p: turned(p, 1.0), silo(), lambda p: turned(p, -1.0))


def _mirrors(platform: Platform) -> Mapping[str, float]:
    return _compare(platform, Packing.mirrored, mirrored(silo()), Packing.mirrored)


CASES = [
    Case(
        name=name,
        statement=f"rods in a round silo with a rotating bottom move equally {how}, except for round-off that grows",
        source="symmetry",
        # roundings of forces over a path of half a diameter, and a growth in collisions, as of `renumbering`
        measures={
            "after 2 ms": limited(1e-12, "d", roundings=0.5 * 16),
            "after 10 ms": limited(1e-9, "d", roundings=0.5 * 16 * 10),
        },
        run=run,
    )
    for name, how, run in (
        ("rods-turned", "turned about its axis by 1 rad", _turns),
        ("rods-mirrored", "in the mirror, where it turns the other way", _mirrors),
    )
]
