"""A verification case, which `labbook verify viscous-restitution` runs on any backend."""

from collections.abc import Mapping

from labbook.checks.verify.case import Case, limited
from labbook.checks.verify.platform import MemberStart, Platform, grains_at
from labbook.scene import Plane, Primitives, Scene, Spheres, Wall

from .viscous import Viscous

SPEED, RESTITUTION_ASKED = 0.1, 0.5
"""Speed before the impact [m/s], and the coefficient of restitution of the law."""
STEPS = 1000
"""Time steps of a collision."""


def _restitution(platform: Platform) -> Mapping[str, float]:
    """Drop a grain on a plane; the error of its rebound."""
    grains = Spheres(diameter=3e-3, density=2500, count=1)
    law = Viscous(normal_stiffness=2e3, restitution=RESTITUTION_ASKED)
    floor = Wall(name="floor", shape=Plane(point=(0, 0, 0), normal=(0, 0, 1)))
    scene = Scene(grains=grains, contact=law, container=Primitives(parts=(floor,)), gravity=0.0)
    dt = law.collision_time(grains.mass, grains.radius, SPEED) / STEPS
    above = [[0.0, 0.0, grains.radius + 10 * SPEED * dt]]
    trajectory = platform.run(
        MemberStart(scene, dt, grains_at(above, [[0.0, 0.0, -SPEED]])), beats=3, steps_per_beat=STEPS
    )
    return {"restitution": abs(trajectory.end.v[0, 2] / SPEED - RESTITUTION_ASKED)}


RESTITUTION = Case(
    name="viscous-restitution",
    statement="a grain leaves a plane with the coefficient of restitution that the law states",
    source="damped oscillator until the force vanishes",
    # the force ends within a step, of which a collision has 1000
    measures={"restitution": limited(2e-3, roundings=16, steps=1e3)},
    run=_restitution,
)
