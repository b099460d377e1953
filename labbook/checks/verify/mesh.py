"""Walls of triangles: faces, edges and vertices are contacts like others, and triangles leave no trace of their edges.

The sheets and roofs here have no flaw, whatever they are divided into, so a plane, conservation laws and statics tell
what is right.
"""

import math
from collections.abc import Mapping

import numpy as np

from labbook.backend.probes import Contacts, Sample
from labbook.checks.verify.case import Case, limited
from labbook.checks.verify.materials import D, G, floor, linear, scene
from labbook.checks.verify.platform import MemberStart, Platform, Trajectory, grains_at, require
from labbook.scene import Primitives, Scene, TriangleMesh, Wall
from labbook.scene.triangles import Triangles, turn

R = D / 2
DT = 2.5e-6
STEPS = 100
FREE_DT, SPEED = 1e-6, 0.25
"""Time step [s] and speed [m/s] of grains in free flight."""
MOTION = Sample(fields=("x", "v", "omega"))
CONTACTS = Contacts(every=1)
NAMES = ("x", "y", "z", "vx", "vy", "vz", "wx", "wy", "wz")
SEED = 5


def of_triangles(vertices: np.ndarray, triangles: np.ndarray, smooth: float = 0.0) -> Wall:
    """The wall `floor` of triangles."""
    surface, _ = Triangles.welded(np.asarray(vertices, float), np.asarray(triangles))
    return Wall(name="floor", shape=TriangleMesh.of_surface(surface, smooth))


def sheet(cells: int, half: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a square in z = 0 with sides of 2 `half` [m], divided unevenly into 2 cells^2."""
    rng = np.random.default_rng(SEED)
    ticks = np.linspace(-half, half, cells + 1)
    x, y = np.meshgrid(ticks, ticks, indexing="ij")
    inner = np.zeros_like(x)
    inner[1:-1, 1:-1] = 0.6 * half / cells
    x, y = x + inner * rng.uniform(-1, 1, x.shape), y + inner * rng.uniform(-1, 1, x.shape)
    k = np.arange((cells + 1) ** 2).reshape(x.shape)
    a, b, c, d = (corner.ravel() for corner in (k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]))
    first = rng.random(cells**2) < 0.5  # along which diagonal
    lower = np.where(first, [a, b, c], [a, b, d]).T
    upper = np.where(first, [a, c, d], [b, c, d]).T
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]), np.concatenate([lower, upper])


def on(wall: Wall, count: int, friction: float = 0.0, restitution: float = 1.0, gravity: float = G) -> Scene:
    """Grains over a wall."""
    return scene(count, linear(friction=friction, restitution=restitution), Primitives(parts=(wall,)), gravity)


def _soft(wall: Wall) -> Scene:
    """A grain that is soft enough for the step to be small against its impacts on the wall."""
    law = linear(friction=0.0, restitution=1.0)
    soft = law.model_copy(update={"normal_stiffness": law.normal_stiffness / 25})
    return scene(1, soft, Primitives(parts=(wall,)))


def _followed(platform: Platform, of: Scene, start, beats: int) -> np.ndarray:
    """Follow grains; columns NAMES of each at each beat, shape [beats, grains, 9]."""
    return platform.run(MemberStart(of, DT, start), beats, STEPS, [MOTION, CONTACTS]).by_beat(MOTION, NAMES)


def _over_vertices(vertices: np.ndarray, count: int, overlap: float, speed: float):
    """Grains that rest on the sheet and slide towards vertices of it."""
    rng = np.random.default_rng(SEED)
    inner = vertices[np.abs(vertices[:, :2]).max(axis=1) < np.abs(vertices).max() / 2]
    target = rng.permutation(inner)[:count]
    side = math.ceil(math.sqrt(count))
    positions = 14 * R * (np.array([divmod(k, side) for k in range(count)]) - side / 2)  # so that none meet
    v = np.zeros((count, 3))
    v[:, :2] = target[:, :2] - positions
    v *= speed / np.linalg.norm(v, axis=1)[:, None]
    return grains_at(np.column_stack([positions, np.full(count, R - overlap)]), v)


def _plane(platform: Platform) -> Mapping[str, float]:
    vertices, triangles = sheet(16, 24 * R)
    level = on(floor(), 4, 0.3, 0.5)
    law = level.contact
    overlap = level.grains.mass * G / law.model_dump()["normal_stiffness"]
    start = _over_vertices(vertices, 4, overlap, 0.5)
    plane = _followed(platform, level, start, 60)
    mesh = _followed(platform, on(of_triangles(vertices, triangles), 4, 0.3, 0.5), start, 60)
    away = np.abs(mesh - plane).max(axis=(0, 1))
    return {
        "|x - x on a plane|/R": float(away[:3].max()) / R,
        "spin, relative to v/R": float(away[6:].max()) * R / 0.5,
        "largest |v_z|": float(np.abs(mesh[..., 5]).max()),
    }


def _order(platform: Platform) -> Mapping[str, float]:
    vertices, triangles = sheet(6, 24 * R)
    rng = np.random.default_rng(SEED)
    order, names = rng.permutation(len(triangles)), rng.permutation(len(vertices))
    shuffled = np.argsort(names)[np.roll(triangles[order], 1, axis=1)[:, ::-1]]
    start = _over_vertices(vertices, 4, 0.0, 0.5)
    sorted_ = _followed(platform, on(of_triangles(vertices, triangles), 4, 0.3, 0.5), start, 10)
    again = _followed(platform, on(of_triangles(vertices[names], shuffled), 4, 0.3, 0.5), start, 10)
    return {"largest difference": float(np.abs(sorted_ - again).max())}


def _valley(platform: Platform) -> Mapping[str, float]:
    """A grain at rest in a valley, whose sides are at an angle b from the vertical: N = m g/(2 sin b) at each."""
    errors, contacts = [], []
    for angle in (0.4, 0.7, 1.1):
        far, high = 20 * R * math.sin(angle), 20 * R * math.cos(angle)
        ends = [(x, y, z) for x, z in ((-far, high), (0.0, 0.0), (far, high)) for y in (-20 * R, 0.0, 20 * R)]
        wall = of_triangles(np.array(ends), _strips(3))
        of = on(wall, 1, restitution=0.3)
        mass, stiffness = of.grains.mass, of.contact.model_dump()["normal_stiffness"]
        force = mass * G / (2 * math.sin(angle))
        start = grains_at([0.0, 0.3 * R, (R - force / stiffness) / math.sin(angle)])
        trajectory = platform.run(MemberStart(of, DT, start), 10, STEPS, [MOTION, CONTACTS])
        forces, several = _forces(trajectory)
        errors.append(np.abs(forces / force - 1).max())
        contacts.append(several)
    return {"N/(m g/(2 sin b)) - 1": float(max(errors)), "|contacts - 2|": float(np.abs(np.array(contacts) - 2).max())}


def _strips(rows: int) -> np.ndarray:
    """Triangles between `rows` lines of three vertices each."""
    cells = [3 * k + n for k in range(rows - 1) for n in range(2)]
    return np.array([t for c in cells for t in ((c, c + 3, c + 4), (c, c + 4, c + 1))])


def _forces(trajectory: Trajectory) -> tuple[np.ndarray, int]:
    """Sizes of the forces [N] of the contacts at the last beat, and how many these are."""
    table = trajectory.rows(CONTACTS)
    last = table["step"] == table["step"].max()
    force = np.column_stack([table[name][last] for name in ("fx", "fy", "fz")])
    return np.linalg.norm(force, axis=1), len(force)


def _peak(platform: Platform) -> Mapping[str, float]:
    """Grains fall on all places of a pyramid, and bounce off its tip, its ridges and its faces without friction and
    loss. Of each the energy is that of the start once it is free again, and none is ever within the pyramid."""
    a, high = 6 * R, 3 * R
    corners = np.array([[-a, -a, 0], [a, -a, 0], [a, a, 0], [-a, a, 0], [0, 0, high]], float)
    wall = of_triangles(corners, np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]))
    offsets = [(0, 0), (1e-3, 0), (0.2, 0.2), (0.3, 0.1), (1, 1), (1.5, 1.49), (2, 0.5), (3, 3)]
    count = len(offsets)
    errors, hits = [], 0
    starts = []
    for x, y in offsets:
        ground = high * (1 - max(x, y) * R / a)
        top = (x * R, y * R, ground + 3 * R)
        starts.append(MemberStart(_soft(wall), FREE_DT, grains_at(top, [0.0, 0.0, -SPEED])))
    for trajectory in platform.run_all(starts, 200, STEPS, [MOTION, CONTACTS]):
        vx, vy, vz = np.moveaxis(trajectory.by_beat(MOTION, ("vx", "vy", "vz"))[:, 0], -1, 0)
        speed = math.sqrt(vx[-1] ** 2 + vy[-1] ** 2 + vz[-1] ** 2)
        errors.append(abs((speed / SPEED) ** 2 - 1))
        hits += int(vz[-1] > -0.999 * SPEED)
    require(hits == count, f"{hits} of {count} grains were turned aside")
    return {"energy after/before - 1": float(max(errors))}


def _free_edge(platform: Platform) -> Mapping[str, float]:
    """Grains fly past the free edge of a thin plate, at distances b of their path from it: of the centre the energy
    and the angular momentum about the edge stay, and beyond R nothing happens."""
    far = 30 * R
    ends = np.array([[0, -far, 0], [0, far, 0], [-far, -far, 0], [-far, far, 0]], float)
    wall = of_triangles(ends, np.array([[0, 1, 2], [1, 2, 3]]))
    starts, offsets = [], (0.05, 0.3, 0.6, 0.9, 0.999, 1.001)
    for b in offsets:
        start = grains_at([b * R, 0.1 * R, 3 * R], [0.0, 0.0, -SPEED])
        starts.append(MemberStart(_soft(wall), FREE_DT, start))
    energy, momentum, beyond = [], [], math.nan
    for b, trajectory in zip(offsets, platform.run_all(starts, 200, STEPS, [MOTION, CONTACTS]), strict=True):
        x, z, vx, vz = np.moveaxis(trajectory.by_beat(MOTION, ("x", "z", "vx", "vz"))[:, 0], -1, 0)
        if b > 1:
            beyond = float(np.abs(vx).max() + np.abs(vz + SPEED).max())
            continue
        require(abs(vx[-1]) > 1e-6, "a grain was not turned aside")
        energy.append(abs((vx[-1] ** 2 + vz[-1] ** 2) / SPEED**2 - 1))
        momentum.append(abs((x[-1] * vz[-1] - z[-1] * vx[-1]) / (-SPEED * b * R) - 1))
    return {
        "energy after/before - 1": float(max(energy)),
        "angular momentum about the edge - 1": float(max(momentum)),
        "change of v beyond R": beyond,
    }


def _round(platform: Platform) -> Mapping[str, float]:
    """A grain at rest in a trough with 48 sides a turn that `smooth` makes one surface: one contact carries its weight,
    on a side and over an edge alike."""
    sides, radius = 48, 19 * R
    angles = 2 * math.pi * (np.arange(sides // 4 + 1) - sides / 8) / sides - math.pi / 2
    ends = [(radius * math.cos(t), y, radius * math.sin(t)) for t in angles for y in (-9 * R, 0.0, 9 * R)]
    wall = of_triangles(np.array(ends), _strips(len(angles)), smooth=math.radians(15))
    apothem, errors, counts = radius * math.cos(math.pi / sides), [], []
    for shift in (0.0, 0.5):  # the lowest place is an edge, or the middle of a side
        turned = turn((0.0, shift * 2 * math.pi / sides, 0.0))
        shape = wall.shape
        assert isinstance(shape, TriangleMesh)
        moved = shape.surface.moved(lambda places, by=turned: places @ by.T)
        of = on(Wall(name="floor", shape=TriangleMesh.of_surface(moved, shape.smooth)), 1, restitution=0.3)
        overlap = of.grains.mass * G / of.contact.model_dump()["normal_stiffness"]
        low = -apothem / (math.cos(math.pi / sides) if shift == 0 else 1.0)
        gap = R if shift else R / math.cos(math.pi / sides)
        start = grains_at([0.0, 0.1 * R, low + gap - overlap / (1.0 if shift else math.cos(math.pi / sides))])
        forces, several = _forces(platform.run(MemberStart(of, DT, start), 10, STEPS, [MOTION, CONTACTS]))
        errors.append(abs(float(forces.sum()) / (of.grains.mass * G) - 1))
        counts.append(several)
    return {"N/(m g) - 1": max(errors), "|contacts - 1|": float(np.abs(np.array(counts) - 1).max())}


CASES = [
    Case(
        name="mesh-plane",
        statement="grains slide and roll over a sheet of triangles, across edges and vertices, as on a plane",
        source="the same on a plane",
        measures={
            "|x - x on a plane|/R": limited(1e-9, steps=6e3),
            "spin, relative to v/R": limited(1e-9, roundings=100, steps=6e3),
            "largest |v_z|": limited(1e-7, "m/s", roundings=100),
        },
        run=_plane,
    ),
    Case(
        name="mesh-order",
        statement="the order, first corners and sense of rotation of triangles change no bit",
        source="order of numbers alone",
        measures={"largest difference": limited(0.0)},
        run=_order,
    ),
    Case(
        name="mesh-valley",
        statement="a grain at rest in a valley of triangles touches each side with N = m g/(2 sin b)",
        source="statics",
        measures={"N/(m g/(2 sin b)) - 1": limited(1e-5, roundings=1000), "|contacts - 2|": limited(0.0)},
        run=_valley,
    ),
    Case(
        name="mesh-peak",
        statement="grains bounce off faces, ridges and tip of a pyramid without loss",
        source="conservation of energy",
        measures={"energy after/before - 1": limited(1e-5, roundings=2000, steps=2e4)},
        run=_peak,
    ),
    Case(
        name="mesh-free-edge",
        statement="the free edge of a plate of triangles acts along the line from its nearest point to the centre",
        source="conservation of energy and of angular momentum",
        measures={
            "energy after/before - 1": limited(1e-5, roundings=2000, steps=2e4),
            "angular momentum about the edge - 1": limited(1e-9, roundings=2000, steps=2e4),
            "change of v beyond R": limited(0.0, "m/s"),
        },
        run=_free_edge,
    ),
    Case(
        name="mesh-round",
        statement="on a smooth surface of flat sides a grain has one contact, also over an edge",
        source="statics",
        measures={"N/(m g) - 1": limited(1e-5, roundings=1000), "|contacts - 1|": limited(0.0)},
        run=_round,
    ),
]
