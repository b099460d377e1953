"""Inside round walls: a sphere that rolls round a cylinder, and beds in cylinders and cones."""

import math
from collections.abc import Mapping

import numpy as np

from labbook.backend.probes import Sample
from labbook.checks.verify.bed import at_rest, borne, in_each
from labbook.checks.verify.case import Case, limited
from labbook.checks.verify.materials import D, G, linear, scene, spheres
from labbook.checks.verify.platform import MemberStart, Platform, grains_at
from labbook.scene import (
    ConicalSilo,
    CylinderSilo,
    Frustum,
    Grains,
    Primitives,
    Scene,
    Spherocylinders,
    SurfaceChange,
    Wall,
)

R = D / 2
BORE, SPEED = 50e-3, 1.5
"""Radius of the cylinder [m]; speed of the sphere round it [m/s]."""
STEPS, BEATS = 4000, 100
"""Steps of 1 us between two looks, and looks. Each may round the velocity once (docs/verification.md)."""
MOTION = Sample(fields=("x", "v"))
SOFT = {"normal_stiffness": 200.0, "restitution": 0.3}


def _rolls_round(platform: Platform) -> Mapping[str, float]:
    """Rolling round a vertical cylinder, a sphere does not fall: it swings up and down.

    z'' = -(2/7) W^2 z - (5/7) g with W = V/(Rc - R), for a sphere that at z = 0 has no spin across the wall (Neimark &
    Fufaev, Dynamics of Nonholonomic Systems, chapter 3; 2/7 = I/(I + m R^2)).
    """
    wall = Wall(name="side", shape=Frustum(lower=(BORE, -1.0), upper=(BORE, 1.0)))
    rough = SurfaceChange(friction=5.0, rolling_friction=0.0)
    law = linear(normal_stiffness=2e5, rolling_friction=0.0)
    rolls = scene(1, law, Primitives(parts=(wall,)), G, side=rough)
    mass = rolls.grains.mass
    overlap = mass * SPEED**2 / (BORE - R) / law.normal_stiffness
    circle, lever_arm = BORE - R + overlap, R - overlap
    start = grains_at([circle, 0, 0], [0, SPEED, 0], [0, 0, -SPEED / lever_arm])
    trajectory = platform.run(MemberStart(rolls, 1e-6, start), BEATS, STEPS, [MOTION])
    p, times = trajectory.by_beat(MOTION, ("x", "y", "z"))[:, 0], trajectory.times(MOTION)
    inertia = 0.4 * R**2 / (0.4 * R**2 + lever_arm**2)
    rate = SPEED / circle
    swing = (1 - inertia) * G / (inertia * rate**2)
    expected = -swing * (1 - np.cos(math.sqrt(inertia) * rate * times))
    return {
        "height, of the swing": float(np.abs(p[:, 2] - expected).max()) / swing,
        "distance from the wall": float(np.abs(np.hypot(p[:, 0], p[:, 1]) - circle).max()) / R,
    }


def _scene(grains: Grains, container) -> Scene:
    return Scene(grains=grains, contact=linear(**SOFT), container=container, gravity=G).close()


def _carries(platform: Platform) -> Mapping[str, float]:
    rods = Spherocylinders(diameter=2 * D, length=6 * D, density=620, count=60)
    beds = {
        "spheres in a cylinder": _scene(spheres(200), CylinderSilo(diameter=8 * D, height=60 * D, orifice=4 * D)),
        "spheres in a cone": _scene(
            spheres(200), ConicalSilo(diameter=10 * D, height=60 * D, angle=math.radians(35), orifice=4 * D)
        ),
        "rods in a cylinder": _scene(rods, CylinderSilo(diameter=16 * D, height=90 * D, orifice=8 * D)),
        "rods in a cone": _scene(
            rods, ConicalSilo(diameter=16 * D, height=90 * D, angle=math.radians(35), orifice=8 * D)
        ),
    }
    return in_each({name: borne(platform, bed, 1e-5, 300) for name, bed in beds.items()})


CASES = [
    Case(
        name="rolling-round-a-cylinder",
        statement="a sphere that rolls round the inside of a vertical cylinder swings up and down, and does not fall",
        source="rigid body, Neimark & Fufaev 1972",
        measures={
            "height, of the swing": limited(1e-3, steps=BEATS * STEPS),
            "distance from the wall": limited(1e-3, steps=BEATS * STEPS),
        },
        run=_rolls_round,
    ),
    Case(
        name="resting-bed-round",
        statement="beds of spheres and rods come to rest, and the forces of round walls add up to their weight",
        source="equilibrium",
        measures=at_rest("spheres in a cylinder", "spheres in a cone", "rods in a cylinder", "rods in a cone"),
        run=_carries,
        slow=True,
    ),
]
