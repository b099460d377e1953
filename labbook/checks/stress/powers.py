"""Powers of contacts in extremes: impacts that dissipate all or nothing, unlike spheres, a spinning floor, far away."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from labbook.backend.probes import Dissipation, Ledger
from labbook.checks.stress.case import Ending, StressCase, within
from labbook.checks.stress.watch import follow, sound
from labbook.checks.verify.case import limited
from labbook.checks.verify.energy import dissipated
from labbook.checks.verify.materials import D, G, linear
from labbook.checks.verify.platform import MemberStart, Platform
from labbook.scene import Kind, Packing, Plane, Primitives, Scene, Spheres, SurfaceMotion, Wall

SPEED = 1.0
"""Initial speeds [m/s] of each component."""
DURATION = 2e-3
"""Time [s] in which eight spheres in a narrow box meet several times."""
STEPS = 50
"""Of an elastic collision of the lightest grains."""


@dataclass(frozen=True)
class Tumble:
    """Spheres in a narrow box.

    `law`: parameters of the material; `ratio`: of the diameters; `spin`: of the floor [rad/s]; `far`: coordinate of the
    box along each axis [m].
    """

    name: str
    law: Mapping[str, Any] = field(default_factory=dict)
    ratio: float = 1.0
    spin: float = 0.0
    far: float = 0.0


TUMBLES = (
    Tumble("elastic, no friction", {"restitution": 1.0, "friction": 0.0}),
    Tumble("e = 0.05, friction 5", {"restitution": 0.05, "friction": 5.0}),
    Tumble("diameters 2 to 1", ratio=0.5),
    Tumble("spinning floor", spin=1000.0),
    Tumble("100 m from the origin", far=100.0),
)


def _box(width: float, spin: float, far: float) -> Primitives:
    """Build six planes around (far, far, far + width/2); the floor turns about the axis x = y = 0."""
    walls = []
    for axis, name in enumerate("xyz"):
        for side in (-1, 1):
            point, normal = [far, far, far + width / 2], [0.0, 0.0, 0.0]
            point[axis] += side * width / 2
            normal[axis] = -side
            motion = SurfaceMotion(spin=spin if axis == 2 and side < 0 else 0.0)
            plane = Plane.model_validate({"point": point, "normal": normal})
            walls.append(Wall(name=f"{name}-{'low' if side < 0 else 'high'}", shape=plane, motion=motion))
    return Primitives(parts=tuple(walls))


def _start(tumble: Tumble) -> tuple[Scene, Packing]:
    grains, kind = Spheres(diameter=D, density=2500, count=8), np.arange(8) % 2
    unlike: dict[str, np.ndarray] = {}
    if tumble.ratio < 1:
        small = tumble.ratio * D
        kinds = (Kind(name="large", share=0.5), Kind(name="small", share=0.5, diameter=small))
        grains = grains.model_copy(update={"kinds": kinds})
        unlike = {"kind": kind, "diameter": np.where(kind == 0, D, small)}
    width = 2.6 * D
    law = linear(**{"restitution": 0.5, "rolling_friction": 0.0, **tumble.law})
    corner = np.stack(np.meshgrid(*[[-1, 1]] * 3), axis=-1).reshape(-1, 3)
    x = corner * 0.6 * D + [0, 0, width / 2] + tumble.far
    v = np.random.default_rng(4).normal(0, SPEED, (8, 3))
    scene = Scene(grains=grains, contact=law, container=_box(width, tumble.spin, tumble.far), gravity=G)
    return scene, Packing(x=x, v=v, omega=np.zeros_like(x), **unlike)


def _balance(platform: Platform) -> Iterator[Ending]:
    for tumble in TUMBLES:
        scene, start = _start(tumble)
        lightest = scene.grains.smallest()[-1]
        dt = linear(restitution=1.0).collision_time(lightest.mass, lightest.radius, SPEED) / STEPS
        probes = (Ledger(), Dissipation())
        trajectory = sound(follow(platform, MemberStart(scene, dt, start), round(DURATION / dt), 1, probes))
        work = trajectory.rows(probes[0])["contact_work"]
        lost = dissipated(trajectory, "normal_power", "tangential_power") - dissipated(trajectory, "wall_power")
        balance = work + lost
        moved = float(np.abs(work).max())
        # order dt, where a dashpot's force begins within a step, else dt^2: collisions of 50 steps
        error = float(np.abs(balance - balance[0]).max()) / moved
        yield within(platform, tumble.name, "work of contacts and powers", error, limited(0.05))


CASES = [
    StressCase(
        name="powers",
        attempt="spheres in a narrow box: elastic and inelastic, unlike, on a spinning floor, 100 m from the origin",
        oracle="normal and tangential powers = work of contacts, which kernels add up at each step",
        run=_balance,
    ),
]
