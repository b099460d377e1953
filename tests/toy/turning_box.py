"""Grains in a box of triangles that turns, sinks and vibrates: its scenes, and where they start."""

from dataclasses import replace

import numpy as np

from labbook.checks.verify.materials import D, G, linear, spheres
from labbook.checks.verify.mesh import of_triangles
from labbook.checks.verify.moving import box
from labbook.checks.verify.platform import grains_at
from labbook.scene import PartMotion, PartRotation, Primitives, Scene, Spherocylinders, Vibration
from labbook.scene.packing import Packing

R = D / 2
SPHERES = spheres(8)
RODS = Spherocylinders(diameter=1.4 * R, length=2.2 * R, density=2500, count=8)
MOTION = PartMotion(
    velocity=(0.02, 0.0, -0.05),
    rotation=PartRotation(axis=(0.2, 1.0, 0.1), origin=(0.0, 0.0, R), rate=15.0),
    vibration=Vibration(direction=(1.0, 0.0, 0.0), amplitude=0.02 * R, frequency=60.0, phase=0.4),
)


def turning_box(grains, moves: PartMotion | None = MOTION) -> Scene:
    """Grains in a box of triangles that turns about an axis aside, sinks and vibrates."""
    wall = of_triangles(*box(2.21 * R)).model_copy(update={"moves": moves})
    law = linear(friction=0.4, restitution=0.6)
    return Scene(grains=grains, contact=law, container=Primitives(parts=(wall,)), gravity=G)


def in_the_box(of: Scene) -> Packing:
    """Grains with velocities, some of which touch the box."""
    x = np.array([(a, b, c) for a in (-1.2, 1.2) for b in (-1.2, 1.2) for c in (-1.2, 1.2)]) * R
    packing = grains_at(x, np.random.default_rng(4).uniform(-0.5, 0.5, (8, 3)))
    if isinstance(of.grains, Spherocylinders):
        q = np.random.default_rng(5).normal(0, 1, (8, 4))
        packing = replace(packing, q=q / np.linalg.norm(q, axis=1)[:, None])
    return packing
