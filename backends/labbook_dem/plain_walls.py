"""Contacts with walls in plain Python: of a member of the reference backend, and of a packing at rest."""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Table, Traction
from labbook.scene import Bodies, Clumps, Grains, Scene, Spherocylinders, TriangleMesh
from labbook.scene.grains import MOST_SPHERES
from labbook.scene.orientation import axes
from labbook.scene.packing import Packing
from labbook_dem import rods, rotation, spheres
from labbook_dem.chosen import choose
from labbook_dem.clumps import from_body
from labbook_dem.coefficients import MU
from labbook_dem.contact import rolling_rate
from labbook_dem.dispatch import PlainWall
from labbook_dem.features import features
from labbook_dem.laws import LAWS
from labbook_dem.mesh import PlainMesh
from labbook_dem.mesh_rods import PlainRodMesh
from labbook_dem.traction import SUMS, BinTable, Touch, add_touch
from labbook_dem.words import coefs, cross, vec3, wide3

NONE = vec3(0.0, 0.0, 0.0)
NEW = -1
"""Part of no contact."""
PARTS = 4
"""Points at which a rod may touch a wall (`labbook_dem.walls`)."""
Key = tuple[int, ...]
"""Of a spring: ids of both grains, and of clumps the places of both spheres; or id of the grain, place of the wall, and
part."""


class Lever(NamedTuple):
    """Sphere of a clump: branch to its centre from the centre of mass [m], and its radius [m]."""

    branch: vec3
    radius: float


class GrainState(NamedTuple):
    """One grain. x [m]; axis: of a rod; velocities [m/s] v half a step before and u predicted; spins [rad/s] likewise,
    `spin` and `predicted_spin`; inertia [kg m^2]: the smallest moment; spheres: of a clump."""

    name: int
    x: vec3
    axis: vec3
    u: vec3
    v: vec3
    spin: vec3
    predicted_spin: vec3
    radius: float
    mass: float
    inertia: float
    kind: int
    spheres: tuple[Lever, ...] = ()


class PlainGrains(NamedTuple):
    """Grains of a scene, n of them, at one time.

    Attributes:
        grains: grains of the scene.
        bodies: properties of each grain.
        ids: ids, shape [n].
        x: positions [m], shape [n, 3].
        q: orientations, shape [n, 4]; None for spheres.
        axis: axes of rods, zero for other grains, shape [n, 3].
        u: predicted velocities [m/s], shape [n, 3].
        v: velocities half a step before [m/s], shape [n, 3].
        spin: angular velocities half a step before [rad/s], shape [n, 3].
        predicted_spin: predicted ones [rad/s], shape [n, 3].
    """

    grains: Grains
    bodies: Bodies
    ids: np.ndarray
    x: np.ndarray
    q: np.ndarray | None
    axis: np.ndarray
    u: np.ndarray
    v: np.ndarray
    spin: np.ndarray
    predicted_spin: np.ndarray

    @classmethod
    def steady(
        cls, grains: Grains, packing: Packing, q: np.ndarray | None, v: np.ndarray, omega: np.ndarray
    ) -> "PlainGrains":
        """Grains of a packing with orientations q [n, 4], whose velocities v [m/s] and omega [rad/s], each of shape
        [n, 3], do not change."""
        assert packing.ids is not None
        axis, bodies = axes_of(grains, packing.x, q), Bodies.of(grains, packing)
        return cls(grains, bodies, packing.ids, packing.x, q, axis, v, v, omega, omega)

    def state(self, i: int) -> GrainState:
        """Grain in row i."""
        bodies, grains = self.bodies, self.grains
        vectors = (self.x, self.axis, self.u, self.v, self.spin, self.predicted_spin)
        x, axis, u, v, w, y = (vec3(*array[i].tolist()) for array in vectors)
        inertia = grains.inertia_axis if grains.oriented else float(bodies.inertia[i])
        properties = float(bodies.radius[i]), float(bodies.mass[i]), inertia, int(bodies.kind[i])
        return GrainState(int(self.ids[i]), x, axis, u, v, w, y, *properties, self.levers(i))

    def levers(self, i: int) -> tuple[Lever, ...]:
        """Spheres of the clump in row i; none of another grain."""
        if not isinstance(self.grains, Clumps) or self.q is None:
            return ()
        w, x, y, z = self.q[i].tolist()
        return tuple(Lever(from_body(w, x, y, z, vec3(*part.centre)), part.radius) for part in self.grains.spheres)


def axes_of(grains: Grains, x: np.ndarray, q: np.ndarray | None) -> np.ndarray:
    """Axes of rods, and zero for other grains, shape [n, 3], at positions x [n, 3] and orientations q [n, 4]."""
    return axes(q) if q is not None and isinstance(grains, Spherocylinders) else np.zeros_like(x)


class PartAtWall(NamedTuple):
    """Part of a grain that touches a wall: distance of its centre [m], unit normal from the wall, branch to the centre
    of the part from that of the grain [m], and radius of the part [m]."""

    distance: float
    normal: vec3
    lever: vec3
    radius: float


class WallContact(NamedTuple):
    """Contact of a part of a grain with a wall, with a mesh that of a feature: its radius and overlap [m], force [N],
    torque [N m], branch from the centre of the grain [m], unit normal from the wall, and the springs of friction [m]
    and of rolling resistance [N m] as they are now, with a part that moves in its frame."""

    part: int
    radius: float
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

    def point_inwards(self, x: wide3) -> wide3:
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
        there = self._before.outwards(self.point_inwards(x)) + self._before._shift
        return (x - there) * (1.0 / self._dt)


class PlainWalls:
    """The walls of a scene, with their contact law. Contacts are computed within `choose(LAW)`. Parts that move are at
    their places at the opening until `move_to`."""

    def __init__(self, scene: Scene, numerics: Numerics):
        self.scene, self.numerics = scene, numerics
        self.walls, self.grains = scene.container.walls(), scene.grains
        of_triangles = PlainRodMesh if isinstance(self.grains, Spherocylinders) else PlainMesh
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
            touched = sorted(key[2] for key in springs if len(key) == 3 and key[:2] == (grain.name, w))
            met, sources = {}, {}
            for part, touching, older in self._at_mesh(plain, grain, touched, self.frames.get(w)):
                met[part], sources[part] = touching, NEW if older is None else older
        elif grain.spheres:
            met = dict(self._met(plain, grain))
            sources = {part: part for part in met}
        else:
            met = dict(self._met(plain, grain))
            was = sum(1 << part for part in range(PARTS) if (grain.name, w, part) in springs)
            now = sum(1 << part for part in met)
            sources = {part: rods.spring_source(part, was, now) for part in met}
        yield from self._acting(w, grain, met, sources, springs, rolling)

    def _at_mesh(
        self, plain: PlainMesh, grain: GrainState, touched: list[int], frame: PartFrame | None
    ) -> Iterator[tuple[int, PartAtWall, int | None]]:
        """Contacts of a grain with a mesh: part, where it is, and the part whose spring it has, of those in `touched`.

        The part of a clump is MOST_SPHERES times the feature plus the place of its sphere; of other grains the feature.
        """

        def inwards(x: vec3) -> vec3:
            return x if frame is None else frame.point_inwards(x)

        def outwards(normal: vec3) -> vec3:
            return normal if frame is None else frame.outwards(normal)

        grains = self.grains
        if isinstance(plain, PlainRodMesh) and isinstance(grains, Spherocylinders):
            axis = grain.axis if frame is None else frame.inwards(grain.axis)
            contacts = plain.rod_contacts(inwards(grain.x), axis, grains.half_length, grain.radius, touched)
            for feature, distance, normal, s, older in contacts:
                yield feature, PartAtWall(distance, outwards(normal), grain.axis * s, grain.radius), older
        for index, (lever, radius) in enumerate(grain.spheres):
            own = [part // MOST_SPHERES for part in touched if part % MOST_SPHERES == index]
            for feature, distance, normal, older in plain.contacts(inwards(grain.x + lever), radius, own):
                touching = PartAtWall(distance, outwards(normal), lever, radius)
                older_part = None if older is None else MOST_SPHERES * older + index
                yield MOST_SPHERES * feature + index, touching, older_part
        if not grains.oriented:
            for feature, distance, normal, older in plain.contacts(inwards(grain.x), grain.radius, touched):
                yield feature, PartAtWall(distance, outwards(normal), NONE, grain.radius), older

    def _met(self, plain: PlainWall, grain: GrainState) -> Iterator[tuple[int, PartAtWall]]:
        """Parts of a grain that touch a wall: ends and edges of a rod, spheres of a clump by their place, 0 of a
        sphere."""
        grains = self.grains
        if isinstance(grains, Spherocylinders):
            for part in range(PARTS):
                distance, normal, s = plain.part(grain.x, grain.axis, grains.half_length, grain.radius, part)
                if distance < grain.radius:
                    yield part, PartAtWall(distance, normal, grain.axis * s, grain.radius)
            return
        for part, (lever, radius) in enumerate(grain.spheres or (Lever(NONE, grain.radius),)):
            distance, normal = plain.distance(grain.x + lever if grain.spheres else grain.x)
            if distance < radius:
                yield part, PartAtWall(distance, normal, lever, radius)

    def _acting(
        self, w: int, grain: GrainState, met: Mapping[int, PartAtWall], sources: Mapping[int, int],
        springs: Mapping[Key, vec3], rolling: Mapping[Key, vec3],
    ) -> Iterator[WallContact]:  # fmt: skip
        """Contacts of a grain with wall w at the parts `met`; sources: of each, the part whose spring it inherits."""
        if not met:
            return
        wall = self.walls[w]
        name, c = grain.name, self._c[w, grain.kind]
        turning, pushed = vec3(0.0, 0.0, wall.motion.spin), vec3(*wall.motion.velocity)
        frame = self.frames.get(w)
        rate, dt = rolling_rate(grain.inertia, self.numerics.dt), self.numerics.dt
        for part, (distance, normal, lever, radius) in met.items():
            key = name, w, sources[part]
            last, advance = (springs[key], dt) if key in springs else (NONE, 0.5 * dt)  # a new one began in the step
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
            if self.grains.oriented:  # an end of a rod and a sphere of a clump are spheres on levers
                force, torque, spring = rods.rod_on_wall(
                    c, radius, mass, overlap, normal, lever, u, v, grain.predicted_spin, grain.spin, about, last,
                    advance, rate,
                )  # fmt: skip
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
            yield WallContact(part, radius, overlap, force, torque, branch, normal, spring, turned)

    def coefficients(self, w: int, kind: int) -> coefs:
        """Coefficients of contacts of wall w with grains of a kind."""
        return self._c[w, kind]

    def touch(self, w: int, grain: GrainState, contact: WallContact) -> Touch:
        """The contact, as it is added up in bins."""
        return Touch(contact.force, contact.normal, grain.x + contact.branch, self._c[w, grain.kind][MU])


def at_rest(scene: Scene, numerics: Numerics, packing: Packing, probe: Traction) -> Table:
    """Rows of `probe` for a packing in `scene`, before any step; `member`, `step` and `time` are 0."""
    plain, table = PlainWalls(scene, numerics), BinTable.of(scene, probe)
    sums = np.zeros((table.total, SUMS), np.int64)
    index_of_wall = {wall.name: w for w, wall in enumerate(plain.walls)}
    q = None if packing.q is None else packing.q / np.linalg.norm(packing.q, axis=1)[:, None]
    spin = rotation.spins(scene.grains, rotation.momenta(scene.grains, packing.omega, q), q)
    grains = PlainGrains.steady(scene.grains, packing, q, packing.v, spin)
    reach = grains.bodies.radius + scene.grains.overhang
    assert packing.ids is not None
    of_walls = packing.rolling[1]
    springs: dict[Key, vec3] = {}
    rolling: dict[Key, vec3] = {}
    for row, (i, name, part) in enumerate(zip(packing.wall_grain, packing.wall_name, packing.wall_part, strict=True)):
        if str(name) in index_of_wall:
            key = int(packing.ids[i]), index_of_wall[str(name)], int(part)
            springs[key] = vec3(*packing.wall_spring[row].tolist())
            rolling[key] = vec3(*of_walls[row].tolist())
    law = scene.contact
    with choose(law.law, twist=law.rolling == "full", springs=law.rolling_model == "epsd"):
        for w, wall in enumerate(plain.walls):
            for i in np.flatnonzero(wall.shape.distance(packing.x) < reach).tolist():
                grain = grains.state(i)
                for contact in plain.contacts(w, grain, springs, rolling):
                    add_touch(table, w, plain.touch(w, grain, contact), sums)
    rows = table.rows(sums)
    count = len(rows["wall"])
    zero = {"member": np.zeros(count, np.int64), "step": np.zeros(count, np.int64), "time": np.zeros(count)}
    return {**zero, **rows}
