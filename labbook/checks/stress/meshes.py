"""Walls of triangles where codes count contacts twice or lose them: many triangles at a vertex, several at an edge,
slivers, repeated and flat triangles, vertices that are not quite one, sheets close together, free edges, edges within
a plane, and a grain that comes fast."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from labbook.checks.stress.case import Ending, StressCase, within
from labbook.checks.stress.geometry import DT, SOFT, rest_at_end
from labbook.checks.stress.watch import follow, guard_error, sound
from labbook.checks.verify.case import limited
from labbook.checks.verify.materials import D, G, linear, scene
from labbook.checks.verify.mesh import of_triangles
from labbook.checks.verify.platform import MemberStart, Platform, grains_at
from labbook.scene import Box, Primitives, Wall

R = D / 2
FAR = 10 * D


def fan(sides: int, rise: float) -> tuple[np.ndarray, np.ndarray]:
    """Triangles round a vertex in the origin, whose rim lies at z = -rise [m]."""
    angles = 2 * math.pi * np.arange(sides) / sides
    rim = np.column_stack([FAR * np.cos(angles), FAR * np.sin(angles), np.full(sides, -rise)])
    return np.array([[0.0, 0.0, 0.0], *rim]), np.array([[0, 1 + k, 1 + (k + 1) % sides] for k in range(sides)])


def separated(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Give each triangle vertices of its own, which differ within the plane by a millionth of a diameter."""
    own = vertices[triangles].reshape(-1, 3)
    aside = np.random.default_rng(1).uniform(-1e-6 * D, 1e-6 * D, own.shape)
    return own + aside * (1, 1, 0), np.arange(len(own)).reshape(-1, 3)


def walls_under_origin() -> dict[str, Wall]:
    """Walls that a sphere rests on with its centre over the origin."""
    plane, corners = fan(50, 0.0)
    cone, sides = fan(50, FAR)
    soup = np.concatenate([corners, corners[:9, ::-1], [[0, 1, 1], [3, 3, 3]]])
    a = FAR
    tee = np.array([[0, -a, 0], [0, a, 0], [a, 0, 0], [-a, 0, 0], [0, 0, -a]])
    ticks = np.linspace(-a, a, 4001)
    slivers = np.array([(x, y, 0.0) for x in ticks[1980:2021] for y in (-a, a)])
    strips = [t for k in range(0, 80, 2) for t in ((k, k + 1, k + 2), (k + 1, k + 3, k + 2))]
    double = np.concatenate([plane, plane - [0.0, 0.0, 0.05 * D]]), np.concatenate([corners, corners + len(plane)])
    return {
        "vertex of 50 triangles in a plane": of_triangles(plane, corners),
        "repeated triangles and flat ones": of_triangles(plane, soup),
        "vertices that differ by a millionth of d": of_triangles(*separated(plane, corners)),
        "sheet close behind another": of_triangles(*double),
        "tip of a cone of 50 triangles": of_triangles(cone, sides),
        "edge of three triangles": of_triangles(tee, np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]])),
        "slivers of a 4000th of their length": of_triangles(slivers, np.array(strips)),
    }


def _meshes(platform: Platform) -> Iterator[Ending]:
    """Dropped from a tenth of a diameter, a sphere stays where it is, gains no energy and rests."""
    for name, wall in walls_under_origin().items():
        here = scene(1, linear(**SOFT["linear"]), Primitives(parts=(wall,)), G)
        trajectory = yield from rest_at_end(
            platform, name, MemberStart(here, DT["linear"], grains_at([0.0, 0.0, R + 0.1 * D]))
        )
        yield within(platform, name, "aside", float(np.abs(trajectory.end.x[0, :2]).max()) / D, limited(1e-9, "d"))
    yield from _fast(platform)
    yield from _beside(platform)
    yield from _rolling(platform)
    yield _in_a_box(platform)
    yield from _crowded(platform)


def _beside(platform: Platform) -> Iterator[Ending]:
    """Past the free edge or a corner of a sheet, or a needle, a grain falls freely: triangles end at their edges."""
    sheet = of_triangles(
        np.array([[-FAR, -FAR, 0], [0, -FAR, 0], [0, FAR, 0], [-FAR, FAR, 0]]), np.array([[0, 1, 2], [0, 2, 3]])
    )
    thin = 1e-4 * D
    needle = of_triangles(np.array([[0, 0, 0], [-FAR, thin, 0], [-FAR, -thin, 0]]), np.array([[0, 1, 2]]))
    for part, wall, x, y in (
        ("past an edge", sheet, 1.001 * R, 0.3 * R),
        ("past a corner", sheet, 0.8 * R, FAR + 0.8 * R),
        ("past the tip of a needle", needle, 1.001 * R, 0.0),
    ):
        here = scene(1, linear(**SOFT["linear"]), Primitives(parts=(wall,)), G)
        trajectory = sound(follow(platform, MemberStart(here, DT["linear"], grains_at([x, y, R])), 10, 1000))
        time = trajectory.status.step * DT["linear"]
        off = np.abs(trajectory.end.x[0] - [x, y, R - G * time**2 / 2]).max() / D
        yield within(platform, part, "off free fall", float(off), limited(1e-9, "d", roundings=16, steps=10_000))


def _rolling(platform: Platform) -> Iterator[Ending]:
    """A sphere that rolls over edges of one plane keeps its height and speed: no edge counts beside a face."""
    vertices, triangles = fan(50, 0.0)
    law = linear(**SOFT["linear"], friction=0.5, rolling_friction=0.0)
    here = scene(1, law, Primitives(parts=(of_triangles(vertices, triangles),)), G)
    sunk = here.grains.mass * G / here.contact.normal_stiffness  # pyright: ignore[reportAttributeAccessIssue]
    speed, height = 0.1, R - sunk
    start = grains_at([-1.5 * D, 0.11 * D, height], [speed, 0.0, 0.0])
    start = replace(start, omega=np.array([[0.0, speed / height, 0.0]]))
    beats = math.ceil(3 * D / speed / DT["linear"] / 1000)
    trajectory = sound(follow(platform, MemberStart(here, DT["linear"], start), beats, 1000))
    end = trajectory.end
    yield within(
        platform,
        "rolling over 50 edges",
        "height",
        abs(float(end.x[0, 2]) - height) / D,
        limited(1e-9, "d", roundings=64),
    )
    slower = abs(float(end.v[0, 0]) / speed - 1)
    yield within(platform, "rolling over 50 edges", "speed", slower, limited(1e-6, roundings=64))


def _in_a_box(platform: Platform) -> Ending:
    """A sphere bounces in a box of planes, and in the same box of triangles: its path is the same."""
    half = 1.5 * D
    box = Box(width=2 * half, depth=2 * half, height=2 * half, lid=True)
    corners = np.array([(x, y, z) for x in (-half, half) for y in (-half, half) for z in (0.0, 2 * half)])
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))])
    start = grains_at([0.2 * D, -0.1 * D, half], [0.31, 0.23, 0.17])
    ends = []
    for container in (box, Primitives(parts=(of_triangles(corners, faces),))):
        here = scene(1, linear(**SOFT["linear"], friction=0.5), container)
        ends.append(sound(follow(platform, MemberStart(here, DT["linear"], start), 10, 1000)).end)
    off = max(float(np.abs(ends[0].x - ends[1].x).max()) / D, float(np.abs(ends[0].v - ends[1].v).max()) / 0.31)
    return within(platform, "box of planes and of triangles", "off", off, limited(1e-9, roundings=64, steps=10_000))


def _crowded(platform: Platform) -> Iterator[Ending]:
    """A grain over 2000 slivers, more than lists hold: it rests there, or an error names the lists."""
    ticks = np.linspace(-D, D, 1001)
    vertices = np.array([(x, y, 0.0) for x in ticks for y in (-FAR, FAR)])
    triangles = [t for k in range(0, 2000, 2) for t in ((k, k + 1, k + 2), (k + 1, k + 3, k + 2))]
    wall = of_triangles(vertices, np.array(triangles))
    here = scene(1, linear(**SOFT["linear"]), Primitives(parts=(wall,)), G)
    start, part = MemberStart(here, DT["linear"], grains_at([0.0, 0.0, R + 0.1 * D])), "2000 slivers under a grain"
    outcome = follow(platform, start, 1, 1000)
    if outcome.guard:
        yield guard_error(part, outcome, ("room", "lists"))
        return
    yield from rest_at_end(platform, part, start)


def _fast(platform: Platform) -> Iterator[Ending]:
    """A grain comes from ten diameters away and is thrown back by a thin sheet; one for which the step is too long is
    stopped by a guard, and never on the other side."""
    vertices, triangles = fan(7, 0.0)
    wall = of_triangles(vertices, triangles)
    elastic = {"restitution": 1.0, "friction": 0.0, "rolling_friction": 0.0}
    for speed, stiffness in ((10.0, 1e6), (50.0, 1e6), (50.0, 1e3)):
        here = scene(1, linear(**elastic, normal_stiffness=stiffness), Primitives(parts=(wall,)))
        dt = math.pi * math.sqrt(here.grains.mass / stiffness) / 100
        start = grains_at([0.3 * D, 0.2 * D, 10 * D], [0.0, 0.0, -speed])
        outcome = follow(platform, MemberStart(here, dt, start), math.ceil(20 * D / speed / dt / 10), 10)
        part = f"{speed:g} m/s, k_n = {stiffness:g} N/m"
        if stiffness < 1e4:
            yield guard_error(part, outcome, ("overlap",))
            continue
        off = abs(float(sound(outcome).end.v[0, 2]) / speed - 1)
        yield within(platform, part, "thrown back", off, limited(1e-3, roundings=16, steps=2000))


CASES = [
    StressCase(
        name="meshes",
        attempt="a sphere dropped onto a vertex of 50 triangles, an edge of three, slivers, repeated and torn "
        "triangles, sheets close together; a fast one at a sheet; one past a free edge; one that rolls over edges; "
        "one in a box",
        oracle="symmetry; energy does not grow; static balance; elastic bounce; the overlap guard; free fall; the same "
        "box of planes",
        run=_meshes,
    ),
]
