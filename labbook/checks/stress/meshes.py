"""Walls of triangles where codes count contacts twice or lose them: many triangles at a vertex, several at an edge,
slivers, repeated and flat triangles, and a grain that comes fast."""

import math
from collections.abc import Iterator

import numpy as np

from labbook.checks.stress.case import Ending, StressCase, within
from labbook.checks.stress.geometry import DT, SOFT, rests
from labbook.checks.stress.watch import follow, guard_error, sound
from labbook.checks.verify.case import limited
from labbook.checks.verify.materials import D, G, linear, scene
from labbook.checks.verify.mesh import of_triangles
from labbook.checks.verify.stand import MemberStart, Stand, grains_at
from labbook.scene import Primitives, Wall

R = D / 2
FAR = 10 * D


def fan(sides: int, rise: float) -> tuple[np.ndarray, np.ndarray]:
    """Triangles round a vertex in the origin, whose rim lies at z = -rise [m]."""
    angles = 2 * math.pi * np.arange(sides) / sides
    rim = np.column_stack([FAR * np.cos(angles), FAR * np.sin(angles), np.full(sides, -rise)])
    return np.array([[0.0, 0.0, 0.0], *rim]), np.array([[0, 1 + k, 1 + (k + 1) % sides] for k in range(sides)])


def places() -> dict[str, Wall]:
    """Walls that a sphere rests on with its centre over the origin."""
    plane, corners = fan(50, 0.0)
    cone, sides = fan(50, FAR)
    soup = np.concatenate([corners, corners[:9, ::-1], [[0, 1, 1], [3, 3, 3]]])
    a = FAR
    tee = np.array([[0, -a, 0], [0, a, 0], [a, 0, 0], [-a, 0, 0], [0, 0, -a]])
    ticks = np.linspace(-a, a, 4001)
    slivers = np.array([(x, y, 0.0) for x in ticks[1980:2021] for y in (-a, a)])
    strips = [t for k in range(0, 80, 2) for t in ((k, k + 1, k + 2), (k + 1, k + 3, k + 2))]
    return {
        "vertex of 50 triangles in a plane": of_triangles(plane, corners),
        "repeated triangles and flat ones": of_triangles(plane, soup),
        "tip of a cone of 50 triangles": of_triangles(cone, sides),
        "edge of three triangles": of_triangles(tee, np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]])),
        "slivers of a 4000th of their length": of_triangles(slivers, np.array(strips)),
    }


def _meshes(stand: Stand) -> Iterator[Ending]:
    """Dropped from a tenth of a diameter, a sphere stays where it is, gains no energy and rests."""
    for name, wall in places().items():
        here = scene(1, linear(**SOFT["linear"]), Primitives(parts=(wall,)), G)
        motion = yield from rests(stand, name, MemberStart(here, DT["linear"], grains_at([0.0, 0.0, R + 0.1 * D])))
        yield within(stand, name, "aside", float(np.abs(motion.end.x[0, :2]).max()) / D, limited(1e-9, "d"))
    yield from _fast(stand)


def _fast(stand: Stand) -> Iterator[Ending]:
    """A grain comes from ten diameters away and is thrown back by a thin sheet; one for which the step is too long is
    stopped by a guard, and never on the other side."""
    vertices, triangles = fan(7, 0.0)
    wall = of_triangles(vertices, triangles)
    elastic = {"restitution": 1.0, "friction": 0.0, "rolling_friction": 0.0}
    for speed, stiffness in ((10.0, 1e6), (50.0, 1e6), (50.0, 1e3)):
        here = scene(1, linear(**elastic, normal_stiffness=stiffness), Primitives(parts=(wall,)))
        dt = math.pi * math.sqrt(here.grains.mass / stiffness) / 100
        start = grains_at([0.3 * D, 0.2 * D, 10 * D], [0.0, 0.0, -speed])
        course = follow(stand, MemberStart(here, dt, start), math.ceil(20 * D / speed / dt / 10), 10)
        part = f"{speed:g} m/s, k_n = {stiffness:g} N/m"
        if stiffness < 1e4:
            yield guard_error(part, course, ("overlap",))
            continue
        off = abs(float(sound(course).end.v[0, 2]) / speed - 1)
        yield within(stand, part, "thrown back", off, limited(1e-3, roundings=16, steps=2000))


CASES = [
    StressCase(
        name="meshes",
        attempt="a sphere dropped onto a vertex of 50 triangles, an edge of three, slivers; a fast one at a sheet",
        oracle="symmetry; energy does not grow; static balance; elastic bounce; the overlap guard",
        run=_meshes,
    ),
]
