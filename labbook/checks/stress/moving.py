"""Parts that move where codes let grains through or heat them: a plate that comes fast, one that squeezes a grain, a
box that turns and shakes."""

import math
from collections.abc import Iterator

import numpy as np

from labbook.checks.stress.case import Ending, StressCase, within
from labbook.checks.stress.watch import follow, guard_error, sound
from labbook.checks.verify.case import limited
from labbook.checks.verify.materials import D, G, linear, scene
from labbook.checks.verify.mesh import R, of_triangles, sheet
from labbook.checks.verify.moving import box, moving, plate, wall_frame
from labbook.checks.verify.platform import MemberStart, Platform, grains_at
from labbook.scene import PartRotation, Primitives, Vibration

SOFT = 1e4
LOSSLESS = {"restitution": 1.0, "friction": 0.0, "rolling_friction": 0.0}


def _moving(platform: Platform) -> Iterator[Ending]:
    yield from _fast(platform)
    yield _squeezed(platform)
    yield from _shaken(platform)


def _fast(platform: Platform) -> Iterator[Ending]:
    """A plate comes from ten diameters away at a grain at rest, and throws it ahead at twice its speed; the grain is
    never behind it."""
    for speed in (1.0, 20.0):
        far = np.array([0.0, 0.0, -10 * D])
        vertices, triangles = np.array([[-12, -12, 0], [12, -12, 0], [0, 16, 0]]) * R + far, np.array([[0, 1, 2]])
        wall = moving(of_triangles(vertices, triangles), velocity=(0.0, 0.0, speed))
        here = scene(1, linear(**LOSSLESS, normal_stiffness=1e6), Primitives(parts=(wall,)))
        dt = math.pi * math.sqrt(here.grains.mass / 1e6) / 100
        outcome = follow(platform, MemberStart(here, dt, grains_at([0, 0, R])), math.ceil(15 * D / speed / dt / 10), 10)
        off = abs(float(sound(outcome).end.v[0, 2]) / (2 * speed) - 1)
        yield within(platform, f"plate at {speed:g} m/s", "thrown ahead", off, limited(1e-3, roundings=64, steps=4000))


def _squeezed(platform: Platform) -> Ending:
    """A plate that sinks onto a grain on another one: the overlap guard stops it, and it does not slip through."""
    vertices, triangles = sheet(2, 3 * D)
    lid = moving(of_triangles(vertices + np.array([0.0, 0.0, 2.1 * R]), triangles), velocity=(0.0, 0.0, -0.5))
    floor, lid = plate(half=3 * D), lid.model_copy(update={"name": "lid"})
    here = scene(1, linear(**LOSSLESS, normal_stiffness=SOFT), Primitives(parts=(floor, lid)))
    outcome = follow(platform, MemberStart(here, 5e-6, grains_at([0.1 * R, 0.0, R])), 200, 20)
    return guard_error("squeezed between plates", outcome, ("overlap",))


def _shaken(platform: Platform) -> Iterator[Ending]:
    """Grains in a box that turns and shakes stay in it, with no more energy than its walls can give."""
    motion = {
        "rotation": PartRotation(axis=(1.0, 0.3, 0.0), rate=30.0),
        "vibration": Vibration(direction=(0.0, 0.3, 1.0), amplitude=0.3 * R, frequency=50.0),
    }
    half = 3 * R
    wall = moving(of_triangles(*box(half)), **motion)
    here = scene(8, linear(friction=0.5, restitution=0.5, normal_stiffness=SOFT), Primitives(parts=(wall,)), G)
    x = np.array([(a, b, c) for a in (-1.2, 1.2) for b in (-1.2, 1.2) for c in (-1.2, 1.2)]) * R
    beats, steps, dt = 100, 500, 5e-6
    end = sound(follow(platform, MemberStart(here, dt, grains_at(x)), beats, steps)).end
    inside = float(np.abs(wall_frame(wall, end.x, beats * steps * dt)).max()) / R - 2
    yield within(platform, "shaken box", "beyond its walls", max(inside, 0.0), limited(0.05, "R"))
    fastest = 30.0 * math.sqrt(3) * half + 2 * math.pi * 50 * 0.3 * R
    speed = float(np.linalg.norm(end.v, axis=1).max())
    yield within(platform, "shaken box", "speed over that of its walls", speed / fastest, limited(1.5))


CASES = [
    StressCase(
        name="moving-parts",
        attempt="a plate that comes at 1 and 20 m/s; one that squeezes a grain; a turning, shaking box of eight grains",
        oracle="elastic impact in the frame of the plate; the overlap guard; grains stay in the box, at most 1.5 times "
        "as fast as its walls",
        run=_moving,
    ),
]
