"""Grains where walls are sharp: on an edge, a ridge, in a corner, over a hole; and rods in line with one another."""

import math
from collections.abc import Generator, Iterator

import numpy as np

from labbook.backend.probes import Contacts, Ledger, Traction
from labbook.checks.stress.case import Ending, StressCase, within
from labbook.checks.stress.watch import follow, sound
from labbook.checks.verify.bed import wall_force_error
from labbook.checks.verify.case import limited
from labbook.checks.verify.materials import LAWS, D, G, floor, scene
from labbook.checks.verify.platform import MemberStart, Platform, Trajectory, grains_at
from labbook.checks.verify.rods import rods_at, towards
from labbook.checks.verify.rolling import static_overlap
from labbook.scene import Box, Frustum, LinearSpringDashpot, Primitives, Scene, Spherocylinders, Strip, Wall
from labbook.scene.container import Container
from labbook.scene.packing import Packing

R = D / 2
FORCES = Contacts(every=20)
SOFT = {"hertz-mindlin": {"shear_modulus": 1e7}, "linear": {"normal_stiffness": 2e3}}
DT = {"hertz-mindlin": 8e-6, "linear": 2e-5}
"""A small part of a collision, under the weight of a few grains [s]."""


def _strips(*ends: tuple[tuple[float, float], tuple[float, float]]) -> Primitives:
    """Plates from edge to edge, x and z [m]."""
    return Primitives(
        parts=tuple(Wall(name=f"plate-{k}", shape=Strip(start=a, end=b)) for k, (a, b) in enumerate(ends))
    )


def _hole(radius: float) -> Primitives:
    return Primitives(parts=(Wall(name="plate", shape=Frustum(lower=(radius, 0.0), upper=(20 * D, 0.0))),))


def scenes_by_name() -> dict[str, tuple[Primitives, float]]:
    """Walls with an edge, ridge, corner or hole below x = 0, and the height [m] at which a sphere just touches them."""
    root = math.sqrt(0.5)
    reach = 10 * D
    height = R * math.sin(math.acos(0.4 / 0.5))
    return {
        "edge of a plate": (_strips(((0.0, 0.0), (reach, 0.0))), R),
        "edge of a steep plate": (_strips(((0.0, 0.0), (reach, -3 * reach))), R),
        "ridge of two plates": (_strips(((0.0, 0.0), (reach, -reach)), ((0.0, 0.0), (-reach, -reach))), R),
        "joint of a flat floor": (_strips(((0.0, 0.0), (reach, 0.0)), ((-reach, 0.0), (0.0, 0.0))), R),
        "corner of two plates": (
            _strips(((0.0, 0.0), (reach, reach)), ((0.0, 0.0), (-reach, reach))),
            R / root,
        ),
        "gap of 0.8 d between plates": (
            _strips(((0.4 * D, 0.0), (reach, 0.0)), ((-reach, 0.0), (-0.4 * D, 0.0))),
            height,
        ),
        "round hole of 0.8 d": (_hole(0.4 * D), height),
        "tip of a cone": (
            Primitives(parts=(Wall(name="cone", shape=Frustum(lower=(0.0, 0.0), upper=(reach, reach))),)),
            R / root,
        ),
    }


def _on_edges(platform: Platform) -> Iterator[Ending]:
    """Dropped from a tenth of a diameter exactly above, a sphere stays there, gains no energy and rests."""
    for law in LAWS:
        for name, (walls, height) in scenes_by_name().items():
            here = scene(1, LAWS[law](**SOFT[law]), walls, G)
            start = grains_at([[0.0, 0.0, height + 0.1 * D]])
            part = f"{law}, {name}"
            trajectory = yield from rest_at_end(platform, part, MemberStart(here, DT[law], start))
            yield within(platform, part, "aside", float(np.abs(trajectory.end.x[0, :2]).max()) / D, limited(1e-12, "d"))


BIN_WIDTHS = {"bins of 2 d": 2 * D, "bins of a micrometre": 1e-6, "one bin of a kilometre": 1e3}
"""Widths of bins [m]; the second gives more bins than a probe holds, so that its last bin takes the rest."""


def _sums(platform: Platform) -> Iterator[Ending]:
    """Compare sums over contacts with walls with the rows of contacts, wherever contacts and bins lie."""
    for name, (walls, height) in scenes_by_name().items():
        here = scene(1, LAWS["linear"](**SOFT["linear"]), walls, G)
        start = grains_at([[0.0, 0.0, height - 1e-4 * D]], v=[0.05, 0.02, -0.1], omega=[3.0, 20.0, 1.0])
        for words, size in BIN_WIDTHS.items():
            probe = Traction(size=size)
            trajectory = sound(follow(platform, MemberStart(here, DT["linear"], start), 8, 50, [Contacts(), probe]))
            rows, sums = trajectory.rows(Contacts()), trajectory.rows(probe)
            part = f"{name}, {words}"
            missed = abs(int(sums["contacts"].sum()) - len(rows["wall"]))
            yield within(platform, part, "contacts missed", missed, limited(0.0))
            if not len(rows["wall"]):
                continue
            weight = here.grains.mass * G * 2.0**-24  # to which each force is rounded
            scale = float(np.abs([rows[axis] for axis in ("fx", "fy", "fz")]).max())
            off = max(abs(sums[axis].sum() - rows[axis].sum()) for axis in ("fx", "fy", "fz"))
            beyond = max(0.0, off - len(rows["wall"]) * weight) / scale
            yield within(platform, part, "force apart", beyond, limited(1e-12, roundings=4))


def rest_at_end(platform: Platform, part: str, start: MemberStart) -> Generator[Ending, None, Trajectory]:
    """Check that a bed comes to rest, that walls bear its weight, and that it gains no energy on the way.

    Yields:
        Endings of the three checks.

    Returns:
        The motion.
    """
    trajectory = sound(follow(platform, start, 40, 1000, [Ledger(), FORCES]))
    table, grains = trajectory.rows(Ledger()), trajectory.scene.grains
    energy = (table["kinetic"] + table["potential"]) / (grains.mass * G * grains.diameter)
    at_first = float(start.packing.x[:, 2].sum()) / grains.diameter
    yield within(platform, part, "energy gained", float(energy.max()) - at_first, limited(1e-9, "m g d", roundings=1e3))
    yield within(platform, part, "kinetic energy", trajectory.status.kinetic, limited(1e-9, "m g d"))
    yield within(platform, part, "|wall force - weight|", wall_force_error(trajectory, FORCES), limited(1e-6))
    return trajectory


LONG = Spherocylinders(diameter=2e-3, length=20e-3, density=1000, count=2)
"""A rod of L/d = 10."""
ALONG_X, UPRIGHT = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
STIFFNESS = 2e3
ROD_DT = 5e-6


def rods(count: int, container: Container, gravity: float = 0.0, **law) -> Scene:
    """Rods of L/d = 10 and linear springs."""
    contact = LinearSpringDashpot.model_validate({"normal_stiffness": STIFFNESS, "rolling_friction": 0.01, **law})
    grains = LONG.model_copy(update={"count": count})
    return Scene(grains=grains, contact=contact, container=container, gravity=gravity)


def _meet(axes: np.ndarray, line: np.ndarray, distance: float, speed: float) -> Packing:
    """Two rods at `distance` [m] along `line`, the second at rest."""
    first = np.array([0.1, 0.1, 0.1])
    v = [speed * line, np.zeros(3)]
    return rods_at([first, first + distance * line], [towards(axis) for axis in axes], v)


def _aligned(platform: Platform) -> Iterator[Ending]:
    """By symmetry nothing turns: the moving rod stops, and the rod at rest takes over its velocity, as spheres do."""
    speed, d = 0.1, LONG.diameter
    elastic = rods(2, Primitives(parts=(floor(),)), friction=0.5, restitution=1, tangential_damping=0.0)
    dt = math.pi * math.sqrt(LONG.mass / 2 / STIFFNESS) / 500
    askew = np.array([0.6, 0.0, 0.8])
    ways = {
        "side by side": (ALONG_X, ALONG_X, np.array([0.0, 1.0, 0.0]), d),
        "side by side, askew": (askew, askew, np.array([-0.8, 0.0, 0.6]), d),
        "side by side, opposite axes": (ALONG_X, -ALONG_X, np.array([0.0, 0.0, -1.0]), d),
        "end to end": (ALONG_X, ALONG_X, ALONG_X, LONG.length),
        "end to end, askew": (askew, askew, askew, LONG.length),
        "in a T": (ALONG_X, np.array([0.0, 1.0, 0.0]), ALONG_X, LONG.half_length + d),
        "crossed": (ALONG_X, np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0]), d),
    }
    for name, (axis_first, axis_second, line, touch) in ways.items():
        start = _meet(np.array([axis_first, axis_second]), line, touch + 2.5 * speed * dt, speed)
        end = sound(follow(platform, MemberStart(elastic, dt, start), 4, 250)).end
        wrong = np.abs(end.v - np.array([np.zeros(3), speed * line])).max() / speed
        part = f"impact {name}"
        yield within(platform, part, "velocities exchanged", float(wrong), limited(1e-5, roundings=100, steps=1000))
        spin = float(np.abs(end.omega).max()) * LONG.length / speed
        # a point of contact off the middle by a rounding turns rods by its lever
        yield within(platform, part, "spin", spin, limited(1e-8, roundings=1000, steps=1000))


def _stacked(platform: Platform) -> Iterator[Ending]:
    """Rods exactly on top of one another, and in a box just wide enough for three abreast."""
    d = LONG.diameter
    wall = Primitives(parts=(floor(),))
    for count in (2, 3):
        here = rods(count, wall, G, friction=0.5, restitution=0.2)
        sunk = static_overlap(here, count * LONG.mass * G / 2)  # the lowest lies on both its ends
        x = [[0.0, 0.0, R_ROD - sunk + k * d] for k in range(count)]
        part = f"{count} rods along x on one another"
        trajectory = yield from rest_at_end(
            platform, part, MemberStart(here, ROD_DT, rods_at(x, [towards(ALONG_X)] * count))
        )
        aside = float(np.abs(trajectory.end.x[:, :2]).max()) / d
        yield within(platform, part, "aside", aside, limited(1e-6, "d", roundings=1000))
        between = np.diff(trajectory.end.x[trajectory.end.rows(np.arange(count)), 2])
        above = LONG.mass * G * np.arange(count - 1, 0, -1)
        wrong = float(np.abs((d - between) / (above / STIFFNESS) - 1).max())
        yield within(platform, part, "overlaps", wrong, limited(1e-6, roundings=1e4))
    box = Box(width=LONG.length * 1.001, depth=3.001 * d, height=1.0)
    here = rods(15, box, G, friction=0.5, restitution=0.2)
    x = [[0.0, (k - 1) * 1.0003 * d, R_ROD + layer * d] for layer in range(5) for k in range(3)]
    start = MemberStart(here, ROD_DT, rods_at(x, [towards(ALONG_X)] * 15))
    yield from rest_at_end(platform, "15 parallel rods in a narrow box", start)
    upright = Box(width=1.001 * d, depth=1.001 * d, height=1.0)
    here = rods(3, upright, G, friction=0.5, restitution=0.2)
    x = [[0.0, 0.0, LONG.length * (0.5 + k)] for k in range(3)]
    start = MemberStart(here, ROD_DT, rods_at(x, [towards(UPRIGHT)] * 3))
    yield from rest_at_end(platform, "3 upright rods end to end in a tube", start)


R_ROD = LONG.radius

CASES = [
    StressCase(
        name="edges",
        attempt="a sphere dropped exactly onto an edge, a ridge, into a corner, a cone's tip, a hole less than d",
        oracle="symmetry; energy does not grow; static balance",
        run=_on_edges,
    ),
    StressCase(
        name="wall-sums",
        attempt="a sphere on the same edges and in the same corners; bins of walls that are too narrow, or too wide",
        oracle="sums over walls are those of the rows of contacts",
        run=_sums,
    ),
    StressCase(
        name="rods-aligned",
        attempt="rods of L/d = 10 meet side by side, end to end, in a T and crossed, exactly",
        oracle="elastic exchange of velocities; no spin, by symmetry",
        run=_aligned,
    ),
    StressCase(
        name="rods-stacked",
        attempt="rods exactly on top of one another, a bed of parallel rods, upright rods end to end",
        oracle="static balance; overlaps that carry the weight above",
        run=_stacked,
    ),
]
