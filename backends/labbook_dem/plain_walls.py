"""Contacts with walls in plain Python: of a member of the reference backend, and of a packing at rest."""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Table, Traction
from labbook.scene import Bodies, Scene, TriangleMesh
from labbook.scene.orientation import axes
from labbook.scene.packing import Packing
from labbook_dem import rods, rotation, spheres
from labbook_dem.chosen import choose
from labbook_dem.coefficients import MU
from labbook_dem.contact import rolling_rate
from labbook_dem.dispatch import PlainWall
from labbook_dem.features import features, is_oriented
from labbook_dem.laws import LAWS
from labbook_dem.mesh import PlainMesh
from labbook_dem.mesh_rods import PlainRodMesh
from labbook_dem.traction import SUMS, BinTable, Touch, add_touch
from labbook_dem.words import cross, vec3, wide3

NONE = vec3(0.0, 0.0, 0.0)
NEW = -1
"""Part of no contact."""
PARTS = 4
"""Points at which a rod may touch a wall (`labbook_dem.walls`)."""
Key = tuple[int, ...]
"""Of a spring: ids of both grains, or id of the grain, place of the wall, and part."""


class GrainState(NamedTuple):
    """One grain. x [m]; axis: of a rod; velocities [m/s] v half a step before and u predicted; spins [rad/s] likewise,
    `spin` and `soon`; inertia [kg m^2]: about the axis of a rod."""

    name: int
    x: vec3
    axis: vec3
    u: vec3
    v: vec3
    spin: vec3
    soon: vec3
    radius: float
    mass: float
    inertia: float
    kind: int


class WallContact(NamedTuple):
    """Contact of a part of a grain with a wall, with a mesh that of a feature: force [N], torque [N m], branch from its
    centre [m], unit normal from the wall, and the springs of friction [m] and of rolling resistance [N m] as they are
    now, with a part that moves in its frame."""

    part: int
    overlap: float
    force: vec3
    torque: vec3
    branch: vec3
    normal: vec3
    spring: vec3
    rolling: vec3 | None


class PartFrame:
    """The frame of a part that moves, at one time: where it is and how fast.

    Args:
        numbers: A row of `Poses.table`.
        before: That of the last step; None at the opening.
        dt: Time between the two [s].
    """

    def __init__(self, numbers: np.ndarray, before: np.ndarray | None, dt: float):
        turn, self._shift = numbers[:9].reshape(3, 3), vec3(*numbers[9:12].tolist())
        self._before, self._dt = None if before is None else PartFrame(before, None, dt), dt
        self._rows = tuple(vec3(*row.tolist()) for row in turn)
        self._columns = tuple(vec3(*column.tolist()) for column in turn.T)
        self.velocity, self.spin = vec3(*numbers[12:15].tolist()), vec3(*numbers[15:18].tolist())

    def outwards(self, v: vec3) -> vec3:
        """A direction of the part, in space."""
        x, y, z = self._columns
        return x * v.x + y * v.y + z * v.z

    def inwards(self, v: vec3) -> vec3:
        """A direction in space, in the frame of the part."""
        x, y, z = self._rows
        return x * v.x + y * v.y + z * v.z

    def place(self, x: wide3) -> wide3:
        """A point in space, in the frame of the part."""
        return self.inwards(x - self._shift)

    def speed(self, x: wide3) -> vec3:
        """Velocity [m/s] of the part at a point in space."""
        return self.velocity + cross(self.spin, x)

    def speed_before(self, x: wide3) -> vec3:
        """The same half a step before, of the point of the part that is at x now: springs are advanced by the way that
        grain and wall went since the last step. At the opening velocities are of that time."""
        if self._before is None:
            return self.speed(x)
        there = self._before.outwards(self.place(x)) + self._before._shift
        return (x - there) * (1.0 / self._dt)


class PlainWalls:
    """The walls of a scene, with their contact law. Contacts are computed within `choose(LAW)`. Parts that move are at
    their places at the opening until `move_to`."""

    def __init__(self, scene: Scene, numerics: Numerics):
        self.scene, self.numerics = scene, numerics
        self.walls, self.rods = scene.container.walls(), is_oriented(scene)
        of_triangles = PlainRodMesh if self.rods else PlainMesh
        self.plain = [
            of_triangles(wall.shape) if isinstance(wall.shape, TriangleMesh) else PlainWall(wall.shape)
            for wall in self.walls
        ]
        self.frames: dict[int, PartFrame] = {}
        self.move_to(0)
        self._rolling = bool(features(scene, numerics, ())["ROLLING_SPRING"])
        law, scale = LAWS[scene.contact.law], numerics.stiffness_scale
        self._c = {
            (w, a): law.coefficients(scene.law(wall, a), scene.surface(wall, a), scale, True)
            for w, wall in enumerate(self.walls)
            for a in range(len(scene.grains.species))
        }

    def move_to(self, step: int) -> None:
        """Bring parts that move to where they are at a step."""
        dt = self.numerics.dt
        for w, wall in enumerate(self.walls):
            if wall.is_posed:
                before, now = wall.poses(dt * np.arange(step - 1, step + 1)).table()
                self.frames[w] = PartFrame(now, before if step > 0 else None, dt)

    def contacts(
        self, w: int, grain: GrainState, springs: Mapping[Key, vec3], rolling: Mapping[Key, vec3]
    ) -> Iterator[WallContact]:
        """Contacts of a grain with wall w, one for each part that touches; springs and rolling: as they were."""
        plain = self.plain[w]
        if isinstance(plain, PlainMesh):
            features = sorted(key[2] for key in springs if len(key) == 3 and key[:2] == (grain.name, w))
            met, heirs = {}, {}
            frame = self.frames.get(w)
            for feature, distance, normal, s, older in self._at_mesh(plain, grain, features, frame):
                normal = frame.outwards(normal) if frame is not None else normal
                met[feature], heirs[feature] = (distance, normal, s), NEW if older is None else older
        else:
            met = self._met(plain, grain)
            was = sum(1 << part for part in range(PARTS) if (grain.name, w, part) in springs)
            now = sum(1 << part for part in met)
            heirs = {part: rods.heir(part, was, now) for part in met}
        yield from self._acting(w, grain, met, heirs, springs, rolling)

    def _at_mesh(
        self, plain: PlainMesh, grain: GrainState, features: list[int], frame: PartFrame | None
    ) -> Iterator[tuple[int, float, vec3, float, int | None]]:
        """Contacts of a grain with a mesh, as `PlainRodMesh.rod_contacts` gives them, in the frame of the mesh."""
        x, axis = grain.x, grain.axis
        if frame is not None:
            x, axis = frame.place(x), frame.inwards(axis)
        if isinstance(plain, PlainRodMesh):
            yield from plain.rod_contacts(x, axis, self.scene.grains.half_length, grain.radius, features)
        else:
            for feature, distance, normal, older in plain.contacts(x, grain.radius, features):
                yield feature, distance, normal, 0.0, older

    def _met(self, plain: PlainWall, grain: GrainState) -> dict[int, tuple[float, vec3, float]]:
        """Of each part of a grain that touches a wall: distance [m], unit normal, and where on the segment [m]."""
        radius, half = grain.radius, self.scene.grains.half_length
        met = {}
        for part in range(PARTS if self.rods else 1):
            x = grain.x
            distance, normal, s = (
                plain.part(x, grain.axis, half, radius, part) if self.rods else (*plain.distance(x), 0.0)
            )
            if distance < radius:
                met[part] = distance, normal, s
        return met

    def _acting(
        self, w: int, grain: GrainState, met: Mapping[int, tuple[float, vec3, float]], heirs: Mapping[int, int],
        springs: Mapping[Key, vec3], rolling: Mapping[Key, vec3],
    ) -> Iterator[WallContact]:  # fmt: skip
        """Contacts of a grain with wall w at the parts `met`; heirs: of each, the part whose spring it goes on with."""
        if not met:
            return
        wall, radius = self.walls[w], grain.radius
        name, c = grain.name, self._c[w, grain.kind]
        turning, pushed = vec3(0.0, 0.0, wall.motion.spin), vec3(*wall.motion.velocity)
        frame = self.frames.get(w)
        rate, dt = rolling_rate(grain.inertia, self.numerics.dt), self.numerics.dt
        for part, (distance, normal, s) in met.items():
            key = name, w, heirs[part]
            last, advance = (springs[key], dt) if key in springs else (NONE, 0.5 * dt)  # a new one began in the step
            lever = grain.axis * s
            branch = lever - normal * distance
            at = grain.x + branch
            surface = pushed + vec3(-turning.z * at.y, turning.z * at.x, 0.0)
            about = turning
            if frame is not None:
                about, last = turning + frame.spin, frame.outwards(last)
            u, v = grain.u - surface, grain.v - surface
            if frame is not None:
                u, v = u - frame.speed(at), v - frame.speed_before(at)
            overlap, mass, turned = radius - distance, grain.mass, None
            if self.rods:
                force, torque, spring = rods.rod_on_wall(
                    c, radius, mass, overlap, normal, lever, u, v, grain.soon, grain.spin, about, last, advance, rate
                )
            else:
                force, torque, spring = spheres.sphere_on_wall(
                    c, radius, mass, overlap, normal, u, v, grain.spin, about, last, advance, rate
                )
            if self._rolling:
                before = rolling.get(key, NONE)
                roll, turned = spheres.rolling_on_wall(
                    c, radius, mass, overlap, normal, force, grain.spin, about,
                    frame.outwards(before) if frame is not None else before,
                    advance, *self.scene.contact.rolling_spring,
                )  # fmt: skip
                torque = torque + roll
            if frame is not None:
                spring, turned = frame.inwards(spring), None if turned is None else frame.inwards(turned)
            yield WallContact(part, overlap, force, torque, branch, normal, spring, turned)

    def touch(self, w: int, grain: GrainState, contact: WallContact) -> Touch:
        """The contact, as it is added up in bins."""
        return Touch(contact.force, contact.normal, grain.x + contact.branch, self._c[w, grain.kind][MU])


def at_rest(scene: Scene, numerics: Numerics, packing: Packing, probe: Traction) -> Table:
    """Rows of `probe` for a packing in `scene`, before any step; `member`, `step` and `time` are 0."""
    plain, table = PlainWalls(scene, numerics), BinTable.of(scene, probe)
    sums = np.zeros((table.total, SUMS), np.int64)
    bodies, places = Bodies.of(scene.grains, packing), {wall.name: w for w, wall in enumerate(plain.walls)}
    reach = bodies.radius + scene.grains.half_length
    q = None if packing.q is None else packing.q / np.linalg.norm(packing.q, axis=1)[:, None]
    axis = axes(q) if plain.rods and q is not None else np.zeros_like(packing.x)
    spin = rotation.spins(scene.grains, rotation.momenta(scene.grains, packing.omega, q), q)
    assert packing.ids is not None
    of_walls = packing.rolling[1]
    springs: dict[Key, vec3] = {}
    rolling: dict[Key, vec3] = {}
    for row, (i, name, part) in enumerate(zip(packing.wall_grain, packing.wall_name, packing.wall_part, strict=True)):
        if str(name) in places:
            key = int(packing.ids[i]), places[str(name)], int(part)
            springs[key] = vec3(*packing.wall_spring[row].tolist())
            rolling[key] = vec3(*of_walls[row].tolist())
    law = scene.contact
    with choose(law.law, twist=law.rolling == "full", springs=law.rolling_model == "epsd"):
        for w, wall in enumerate(plain.walls):
            for i in np.flatnonzero(wall.shape.distance(packing.x) < reach).tolist():
                x, a, v, turns = (vec3(*array[i].tolist()) for array in (packing.x, axis, packing.v, spin))
                inertia = scene.grains.inertia_axis if plain.rods else float(bodies.inertia[i])
                own = float(bodies.radius[i]), float(bodies.mass[i]), inertia, int(bodies.kind[i])
                grain = GrainState(int(packing.ids[i]), x, a, v, v, turns, turns, *own)
                for contact in plain.contacts(w, grain, springs, rolling):
                    add_touch(table, w, plain.touch(w, grain, contact), sums)
    rows = table.rows(sums)
    count = len(rows["wall"])
    zero = {"member": np.zeros(count, np.int64), "step": np.zeros(count, np.int64), "time": np.zeros(count)}
    return {**zero, **rows}
