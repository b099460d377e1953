"""A member, stepped without optimisation: all pairs that may touch, all walls, one contact at a time."""

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from labbook_dem import clumps, motion, rods, rotation, segments, spheres
from labbook_dem.chosen import choose
from labbook_dem.contact import rolling_rate
from labbook_dem.dispatch import PlainWall
from labbook_dem.ensemble import LONGEST, NOT_RECORDED, Failure, MemberState, explain
from labbook_dem.ensemble import check_checkpoint as check_names
from labbook_dem.features import features, is_oriented, planes, rolling_springs
from labbook_dem.mesh import MESH_CONTACTS, PlainMesh, TooManyContacts, mesh_table
from labbook_dem.mesh_rods import rod_table
from labbook_dem.plain_walls import NONE, PARTS, GrainState, Key, PlainGrains, PlainWalls, axes_of
from labbook_dem.reading import CONTACT_COLUMNS, Grains, Inside, crossing_columns
from labbook_dem.traction import SUMS, add_touch
from labbook_dem.words import coefs, dot, vec3
from scipy.spatial import KDTree

from labbook.backend import Capabilities, Checkpoint
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Crossing, Probe, Traction
from labbook.scene import Bodies, Clumps, Scene, Spherocylinders, TriangleMesh
from labbook.scene.grains import MOST_SPHERES
from labbook.scene.hulls import overlapping
from labbook.scene.orientation import axes
from labbook.scene.packing import Packing

LOST = vec3(np.nan, np.nan, np.nan)
NEWER = ("deepest", "fastest")
"""Numbers of a checkpoint that older ones lack."""

# annotated for one component, but NumPy arrays work too
kick: Any = motion.kick
drift: Any = motion.drift
predict: Any = motion.predict


@dataclass
class TouchingPair:
    """Contact of two grains, or of a grain and a wall.

    Attributes:
        i: row of the grain.
        j: row of the second grain, -1 at a wall.
        wall: number of the wall, -1 for two grains.
        overlap: overlap [m].
        force: force on i [N].
        branch: vector from the centre of i to that of j, or to the point of the wall [m].
    """

    i: int
    j: int
    wall: int
    overlap: float
    force: vec3
    branch: vec3


@dataclass
class Forces:
    """Forces on n grains.

    Attributes:
        f: forces of contacts and weight [N], shape [n, 3].
        t: torques [N m], shape [n, 3].
        springs: friction springs now [m].
        rolling: torques of rolling springs now [N m].
        contacts: touching contacts.
    """

    f: np.ndarray
    t: np.ndarray
    springs: dict[Key, vec3] = field(default_factory=dict)
    rolling: dict[Key, vec3] = field(default_factory=dict)
    contacts: list[TouchingPair] = field(default_factory=list)

    def add(self, i: int, force: vec3, torque: vec3) -> None:
        """Add a force and a torque to grain i."""
        self.f[i] += (force.x, force.y, force.z)
        self.t[i] += (torque.x, torque.y, torque.z)


class Run(MemberState):
    """Member in plain Python.

    Arrays of n grains: x [m]; v [m/s] half a step before, u predicted for the whole step; m, y: reduced angular momenta
    [rad/s] likewise (of spheres: angular velocities); q: orientations.
    """

    x: np.ndarray
    v: np.ndarray
    u: np.ndarray
    m: np.ndarray
    y: np.ndarray
    q: np.ndarray | None
    ids: np.ndarray
    gone: np.ndarray
    """True for grains that have passed the plane of crossings."""
    bodies: Bodies
    springs: dict[Key, vec3]
    rolling: dict[Key, vec3]
    """Torques of rolling springs [N m] of the same contacts, if the law has them."""
    work: float
    """Work of contacts in all kicks so far [J]."""
    clear: np.ndarray
    """Distance [m] that each grain can still move before it may touch each wall, shape [W, n]."""
    max_overlap: float
    touching: int
    """Number of contacts of the last step."""
    deepest: float
    """Largest overlap [m] and largest speed [m/s] of all steps so far."""
    fastest: float

    def __init__(self, can: Capabilities, scene: Scene, numerics: Numerics, probes: Sequence[Probe]):
        self._can, self.scene, self.numerics, self.probes = can, scene, numerics, tuple(probes)
        self.walls = scene.container.walls()
        self._at_walls = PlainWalls(scene, numerics)
        self.slender, self.flat = rotation.slenderness(scene.grains), rotation.flatness(scene.grains)
        self.failure: Failure | None = None
        self.frames = []
        features_by_name = features(scene, numerics, probes)
        self._friction, self._rolling = bool(features_by_name["FRICTION"]), bool(features_by_name["ROLLING_SPRING"])
        crossed = any(isinstance(probe, Crossing) for probe in probes)
        plane, self._drop = planes(scene, probes)
        self._plane = plane if crossed else -np.inf
        self._crossed: list[tuple[float, ...]] = []
        with self._law() as law:
            scale, sorts = numerics.stiffness_scale, range(len(scene.grains.species))
            self._pair_c = {
                (a, b): law.coefficients(scene.law_between(a, b), scene.surface_between(a, b), scale)
                for a in sorts
                for b in sorts
            }

    def _law(self):
        """Return the context in which the formulas are those of the scene's contact law."""
        contact = self.scene.contact
        return choose(contact.law, twist=contact.rolling == "full", springs=contact.rolling_model == "epsd")

    @classmethod
    def started(
        cls, can: Capabilities, scene: Scene, numerics: Numerics, probes: Sequence[Probe], packing: Packing
    ) -> "Run":
        """Return a member at step 0 of a packing."""
        run = cls(can, scene, numerics, probes)
        grains = scene.grains
        if grains.oriented and packing.q is None:
            raise ValueError(f"{grains.noun}s cannot start from a packing without orientations q: it is one of spheres")
        if isinstance(grains, Clumps) and len(packing.pairs) and packing.pair_parts is None:
            raise ValueError("clumps cannot start from a packing without pair_parts: it is not one of clumps")
        assert packing.ids is not None
        run.bodies, run.ids = Bodies.of(scene.grains, packing), packing.ids.copy()
        run.x, run.v, run.u = packing.x.copy(), packing.v.copy(), packing.v.copy()
        run.q = None
        if grains.oriented and packing.q is not None:
            run.q = packing.q / np.linalg.norm(packing.q, axis=1)[:, None]
        run.m = rotation.momenta(scene.grains, packing.omega.copy(), run.q)
        run.y = run.m.copy()
        run.gone = packing.x[:, 2] < run._plane
        run.step, run.work, run.max_overlap, run.touching = 0, 0.0, 0.0, 0
        run.deepest = run.fastest = 0.0
        run.springs = run._springs_of(packing, packing.pair_spring, packing.wall_spring) if run._friction else {}
        run.rolling = run._springs_of(packing, *packing.rolling) if run._rolling else {}
        run.clear = np.zeros((len(run.walls), run.grains))
        return run

    def _springs_of(self, packing: Packing, pair_springs: np.ndarray, wall_springs: np.ndarray) -> dict[Key, vec3]:
        ids, names = self.ids.tolist(), [wall.name for wall in self.walls]
        springs: dict[Key, vec3] = {}
        parts = [()] * len(packing.pairs) if packing.pair_parts is None else packing.pair_parts.tolist()
        for (i, j), pair_parts, vector in zip(packing.pairs.tolist(), parts, pair_springs.tolist(), strict=True):
            springs[ids[i], ids[j], *pair_parts] = vec3(*vector)
        at_walls = zip(packing.wall_grain, packing.wall_name, packing.wall_part, wall_springs, strict=True)
        for i, name, part, vector in at_walls:
            if name in names:
                springs[ids[i], names.index(str(name)), int(part)] = vec3(*vector.tolist())
        return springs

    @classmethod
    def restored(
        cls, can: Capabilities, scene: Scene, numerics: Numerics, probes: Sequence[Probe], stored: Checkpoint
    ) -> "Run":
        """Return a member at the step of a checkpoint.

        Raises:
            ValueError: no member of this scene can have left it.
        """
        check_checkpoint(can, scene, stored)
        run = cls(can, scene, numerics, probes)
        arrays = {name: np.array(array) for name, array in stored.arrays.items()}
        for name in ("x", "v", "u", "m", "y", "ids", "gone"):
            setattr(run, name, arrays[name])
        run.q = arrays.get("q")
        run.bodies = Bodies(*(arrays[name] for name in ("radius", "mass", "inertia", "kind")))
        run.step, run.touching = int(arrays["step"]), int(arrays["touching"])
        run.clear = np.zeros((len(run.walls), run.grains))
        run.work, run.max_overlap = float(arrays["work"]), float(arrays["max_overlap"])
        run.deepest, run.fastest = (float(arrays.get(name, NOT_RECORDED)) for name in NEWER)

        def springs_of(name: str) -> dict[Key, vec3]:
            return {
                tuple(key): vec3(*vector)
                for of in ("pair", "wall")
                for key, vector in zip(arrays[f"{of}_key"].tolist(), arrays[f"{of}_{name}"].tolist(), strict=True)
            }

        run.springs, run.rolling = springs_of("spring"), springs_of("rolling") if run._rolling else {}
        return run

    def checkpoint(self) -> Checkpoint:
        """The exact state, copied."""
        arrays = {name: getattr(self, name).copy() for name in ("x", "v", "u", "m", "y", "ids", "gone")}
        arrays |= {name: array.copy() for name, array in vars(self.bodies).items()}
        arrays |= {name: np.array(getattr(self, name)) for name in ("step", "touching", "work", "max_overlap", *NEWER)}
        if self.q is not None:
            arrays["q"] = self.q.copy()
        for of, size in (("pair", pair_key_length(self.scene)), ("wall", 3)):
            springs = {key: spring for key, spring in self.springs.items() if len(key) == size}
            arrays[f"{of}_key"] = np.array(list(springs), np.int64).reshape(-1, size)
            arrays[f"{of}_spring"] = np.array([_three(s) for s in springs.values()], float).reshape(-1, 3)
            if self._rolling:
                arrays[f"{of}_rolling"] = np.array([_three(self.rolling[key]) for key in springs], float).reshape(-1, 3)
        return Checkpoint(self._can.name, self._can.cache_version, arrays)

    def present(self) -> np.ndarray:
        """Ids of the grains that have not left."""
        return self.ids

    def put_back(self, grains: Packing, half_v: np.ndarray) -> None:
        """See `MemberState`."""
        new = Run.started(self._can, self.scene, self.numerics, self.probes, grains)
        new.v = half_v
        for name in ("x", "v", "u", "m", "y", "ids", "gone"):
            setattr(self, name, np.concatenate([getattr(self, name), getattr(new, name)]))
        if self.q is not None and new.q is not None:
            self.q = np.concatenate([self.q, new.q])
        both = zip(vars(self.bodies).values(), vars(new.bodies).values(), strict=True)
        self.bodies = Bodies(*map(np.concatenate, both))
        self.clear = np.concatenate([self.clear, new.clear], axis=1)

    def set_velocities(self, ids: np.ndarray, v: np.ndarray) -> None:
        """See `MemberState`."""
        order = np.argsort(self.ids)
        rows = order[np.searchsorted(self.ids, ids, sorter=order)]
        self.v[rows], self.u[rows] = v, v

    @property
    def grains(self) -> int:
        """Number of grains that have not left."""
        return len(self.x)

    def beat(self) -> None:
        """Take one beat of steps; after a failure, set `failure` and restore the state before the beat."""
        before, crossed = self.checkpoint(), list(self._crossed)
        target = (self.step // self.numerics.steps_per_beat + 1) * self.numerics.steps_per_beat
        self.frames.clear()
        frame_steps = self.frame_steps()
        while self.step < target and self.grains:
            if self.step in frame_steps:
                self.take_frames()
            if (failure := self._step()) is not None:
                restored = Run.restored(self._can, self.scene, self.numerics, self.probes, before)
                vars(self).update(vars(restored), failure=failure, _crossed=crossed)
                return

    def _step(self) -> Failure | None:
        """Take one step; return the failure that prevents it, or None."""
        forces, dt = self.forces(), self.numerics.dt
        deepest = max(forces.contacts, key=lambda contact: contact.overlap, default=None)
        self.max_overlap, self.touching = deepest.overlap if deepest else 0.0, len(forces.contacts)
        if deepest and not deepest.overlap <= self.numerics.overlap_limit * self.scene.grains.finest:
            return self._failed("overlap", deepest.i, deepest.overlap)
        self.deepest = max(self.deepest, self.max_overlap)
        kick_dt = dt if self.step else 0.5 * dt  # the first brings velocities from a whole to a half step
        a, turns = forces.f / self.bodies.mass[:, None], forces.t / self.bodies.inertia[:, None]
        v, m = self.v, self.m
        self.v, self.m = kick(v, a, kick_dt), kick(m, turns, kick_dt)
        self.work += self._work(forces, (v + self.v) / 2, (m + self.m) / 2, kick_dt)
        self.x, self.u, self.y = drift(self.x, self.v, dt), predict(self.v, a, dt), predict(self.m, turns, dt)
        self.springs, self.rolling = forces.springs, forces.rolling
        self.clear -= np.linalg.norm(self.v, axis=1) * dt
        if self.q is not None:
            states = zip(self.q.tolist(), self.m.tolist(), strict=True)
            self.q = np.array([self._turned(w, x, y, z, vec3(*m_i)) for (w, x, y, z), m_i in states])
        self.step += 1
        return self._guard() or self._leave()

    def _turned(self, w: float, x: float, y: float, z: float, m: vec3) -> tuple[float, float, float, float]:
        """Orientation after a step of free motion."""
        if isinstance(self.scene.grains, Clumps):
            return clumps.turn_clump(w, x, y, z, m, self.flat, self.slender, self.numerics.dt)
        return rotation.turn(w, x, y, z, m, self.slender, self.numerics.dt)

    def _work(self, forces: Forces, v: np.ndarray, m: np.ndarray, dt: float) -> float:
        """Work [J] of contacts while grains are kicked, at their mean velocities."""
        weight = np.zeros_like(forces.f)
        weight[:, 2] = -self.bodies.mass * self.scene.gravity
        return float(np.sum((forces.f - weight) * v) + np.sum(forces.t * self._spins(m))) * dt

    def _guard(self) -> Failure | None:
        """Return a failure if a grain, the end of a rod or a sphere of a clump is too fast or not finite."""
        speed, grains = np.linalg.norm(self.v, axis=1), self.scene.grains
        if self.q is not None and isinstance(grains, Spherocylinders):
            speed = speed + grains.half_length * np.linalg.norm(np.cross(self.m, axes(self.q)), axis=1)
        elif isinstance(grains, Clumps):
            farthest = max(float(np.linalg.norm(sphere.centre)) for sphere in grains.spheres)
            speed = speed + farthest * np.linalg.norm(self._spins(self.m), axis=1)
        wrong = ~(speed <= self.numerics.speed_limit)
        if wrong.any():
            worst = int(np.argmax(wrong))
            finite = np.isfinite(speed[worst])
            return self._failed("speed" if finite else "state", worst, float(speed[worst]))
        self.fastest = max(self.fastest, float(speed.max(initial=0.0)))
        lost = ~np.isfinite(self.m).all(axis=1)
        return self._failed("spin", int(np.argmax(lost)), np.nan) if lost.any() else None

    def _failed(self, guard: str, row: int, value: float) -> Failure:
        grain = int(self.ids[row])
        message = explain(guard, grain, self.step, value, self.scene, self.numerics)
        return Failure("state" if guard == "spin" else guard, self.step, grain, message)

    def _leave(self) -> None:
        """Record first passages through the plane, and drop grains that are far below the outlet."""
        dt, z = self.numerics.dt, self.x[:, 2]
        for i in np.flatnonzero((z < self._plane) & ~self.gone).tolist():
            before = z[i] - self.v[i, 2] * dt
            fraction = (before - self._plane) / (before - z[i]) if before > z[i] else 0.0
            time = (self.step - 1 + min(max(fraction, 0.0), 1.0)) * dt
            of_rod = () if self.q is None else tuple(self.q[i].tolist())
            spin = self._spins(self.m)[i]
            self._crossed.append((self.ids[i], self.step, time, *self.x[i], *self.v[i], *spin, *of_rod))
            self.gone[i] = True
        stays = z >= self._drop
        if not stays.all():
            for name in ("x", "v", "u", "m", "y", "ids", "gone"):
                setattr(self, name, getattr(self, name)[stays])
            self.q = None if self.q is None else self.q[stays]
            self.clear = self.clear[:, stays]
            self.bodies = Bodies(*(array[stays] for array in vars(self.bodies).values()))
            there = set(self.ids.tolist())
            self.springs, self.rolling = (
                {key: s for key, s in springs.items() if key[0] in there and (is_wall(key) or key[1] in there)}
                for springs in (self.springs, self.rolling)
            )

    def forces(self) -> Forces:
        """Return the forces at the present positions; the motion is not changed."""
        total = Forces(np.zeros_like(self.x), np.zeros_like(self.x))
        total.f[:, 2] = -self.bodies.mass * self.scene.gravity
        if not self.grains:
            return total
        self._move_parts()
        with self._law():
            now = self._now()
            for i, j in self._pairs_in_reach():
                try:
                    self._pair(total, i, j, now)
                except ArithmeticError:  # Python raises where processors give NaN: two grains in the same place
                    total.add(i, LOST, LOST)
                    total.add(j, LOST, LOST)
            for w, wall in enumerate(self._at_walls.plain):
                for i in self._near(w, wall):
                    self._wall(total, i, w, now.state(i))
        return total

    def _move_parts(self) -> None:
        """Move parts to their poses of now; distances of grains from them are then computed again."""
        self._at_walls.move_to(self.step)
        self.clear[list(self._at_walls.frames)] = 0.0

    def _now(self) -> PlainGrains:
        """Collect what contacts read of the grains."""
        spins = self._spins(self.m), self._spins(self.y)
        axis = axes_of(self.scene.grains, self.x, self.q)
        return PlainGrains(self.scene.grains, self.bodies, self.ids, self.x, self.q, axis, self.u, self.v, *spins)

    def _pairs_in_reach(self) -> list[tuple[int, int]]:
        """Pairs of grains that may touch: within reach, and for rods and clumps with close segments or spheres."""
        radius, grains, q = float(self.bodies.radius.max()), self.scene.grains, self.q
        pairs = sorted(KDTree(self.x).query_pairs(2 * (radius + grains.overhang)))
        if q is None or not pairs:
            return pairs
        i, j = np.array(pairs).T
        # the margin far exceeds the differences from the distances of `segments.closest`, which decide
        near = overlapping(grains, self.x[i] - self.x[j], q[i], q[j], 2.001 * radius)
        return [pair for pair, meets in zip(pairs, near.tolist(), strict=True) if meets]

    def _near(self, w: int, wall: PlainWall | PlainMesh) -> list[int]:
        """Grains that may touch a wall; the others were farther away than they have moved since."""
        overhang, near = self.scene.grains.overhang, []
        for i in np.flatnonzero(self.clear[w] <= 0).tolist():
            x, radius = vec3(*self.x[i].tolist()), float(self.bodies.radius[i])
            frame = self._at_walls.frames.get(w)
            distance, _normal = wall.distance(x if frame is None else frame.point_inwards(x))
            self.clear[w, i] = distance - radius - overhang
            if self.clear[w, i] <= 0:
                near.append(i)
        return near

    def _pair(self, total: Forces, i: int, j: int, now: PlainGrains) -> None:
        """Add the forces of grains i and j on each other, if they touch."""
        bodies, branch = self.bodies, vec3(*(self.x[i] - self.x[j]).tolist())
        u, v = vec3(*(self.u[i] - self.u[j]).tolist()), vec3(*(self.v[i] - self.v[j]).tolist())
        key = int(self.ids[i]), int(self.ids[j])
        c: coefs = self._pair_c[int(bodies.kind[i]), int(bodies.kind[j])]
        wi, wj, pi, pj = (vec3(*array[row].tolist()) for array in (now.spin, now.predicted_spin) for row in (i, j))
        grains, mi, mj = self.scene.grains, float(bodies.mass[i]), float(bodies.mass[j])
        if isinstance(grains, Clumps):
            levers = [*enumerate(now.levers(i))], [*enumerate(now.levers(j))]
            for (place_i, (lever_i, ri)), (place_j, (lever_j, rj)) in itertools.product(*levers):
                away = branch + lever_i - lever_j
                overlap2 = (ri + rj) * (ri + rj) - dot(away, away)
                if overlap2 > 0:
                    of_spheres = *key, place_i, place_j
                    force, on_i, on_j, spring, overlap = clumps.clump_on_clump(
                        c, ri, rj, mi, mj, away, overlap2, lever_i, lever_j, u, v, pi, pj, wi, wj,
                        *self._spring(of_spheres), self._rate(i), self._rate(j),
                    )  # fmt: skip
                    self._touch(total, i, j, of_spheres, (force, on_i, on_j, spring, overlap), branch)
        elif isinstance(grains, Spherocylinders):
            ai, aj = vec3(*now.axis[i].tolist()), vec3(*now.axis[j].tolist())
            s, t, nearest = segments.closest(branch, ai, aj, grains.half_length)
            overlap2 = 4 * grains.radius * grains.radius - dot(nearest, nearest)
            if overlap2 > 0:
                contact = rods.rod_on_rod(
                    c, grains.radius, grains.mass, nearest, overlap2, ai * s, aj * t, u, v, pi, pj, wi, wj,
                    *self._spring(key), self._rate(i),
                )  # fmt: skip
                self._touch(total, i, j, key, contact, branch)
        else:
            ri, rj = float(bodies.radius[i]), float(bodies.radius[j])
            overlap2 = (ri + rj) * (ri + rj) - dot(branch, branch)
            if not overlap2 > 0:
                return
            last, advance = self._spring(key)
            force, on_i, on_j, spring, overlap = spheres.sphere_on_sphere(
                c, ri, rj, mi, mj, branch, overlap2, u, v, wi, wj, last, advance, self._rate(i), self._rate(j)
            )
            if self._rolling:
                roll, total.rolling[key] = spheres.rolling_on_sphere(
                    c, ri, rj, mi, mj, branch, overlap, force, wi, wj, self.rolling.get(key, NONE), advance,
                    *self.scene.contact.rolling_spring,
                )  # fmt: skip
                on_i, on_j = on_i + roll, on_j - roll
            self._touch(total, i, j, key, (force, on_i, on_j, spring, overlap), branch)

    def _touch(
        self, total: Forces, i: int, j: int, key: Key, contact: tuple[vec3, vec3, vec3, vec3, float], branch: vec3
    ) -> None:
        """Add a contact of grains i and j: force and torque on i, torque on j, spring and overlap."""
        force, on_i, on_j, spring, overlap = contact
        total.add(i, force, on_i)
        total.add(j, -force, on_j)
        total.contacts.append(TouchingPair(i, j, -1, overlap, force, -branch))
        if self._friction:
            total.springs[key] = spring

    def _wall(self, total: Forces, i: int, w: int, grain: GrainState) -> None:
        """Add the forces of wall w on grain i, at each part that touches."""
        try:
            contacts = list(self._at_walls.contacts(w, grain, self.springs, self.rolling))
        except TooManyContacts:
            total.add(i, LOST, LOST)
            total.contacts.append(TouchingPair(i, -1, w, np.inf, LOST, NONE))
            return
        for contact in contacts:
            key = grain.name, w, contact.part
            if contact.rolling is not None:
                total.rolling[key] = contact.rolling
            total.add(i, contact.force, contact.torque)
            total.contacts.append(TouchingPair(i, -1, w, contact.overlap, contact.force, contact.branch))
            if self._friction:
                total.springs[key] = contact.spring

    def wall_sums(self, probe: Traction) -> np.ndarray:
        """See `labbook_dem.reading.Readable`."""
        table = self.bins[probe]
        sums = np.zeros((table.total, SUMS), np.int64)
        now = self._now()
        self._move_parts()
        with self._law():
            for w, wall in enumerate(self._at_walls.plain):
                for i in self._near(w, wall):
                    grain = now.state(i)
                    for contact in self._at_walls.contacts(w, grain, self.springs, self.rolling):
                        add_touch(table, w, self._at_walls.touch(w, grain, contact), sums)
        return sums

    def _spring(self, key: Key) -> tuple[vec3, float]:
        """Spring of a contact, and the time [s] to advance it by: half a step if it is new."""
        dt = self.numerics.dt
        return (self.springs[key], dt) if key in self.springs else (NONE, 0.5 * dt)

    def _rate(self, i: int) -> float:
        inertia = self.scene.grains.inertia_axis if self.scene.grains.oriented else float(self.bodies.inertia[i])
        return rolling_rate(inertia, self.numerics.dt)

    def _spins(self, m: np.ndarray) -> np.ndarray:
        return rotation.spins(self.scene.grains, m, self.q)

    def whole_step(self) -> tuple[np.ndarray, np.ndarray]:
        """Velocities [m/s] and angular velocities [rad/s], shape [n, 3], at the time of the positions."""
        if self.step == 0:  # those of the start: coincident grains would have forces of 0/0
            return self.v.copy(), self._spins(self.m)
        forces = self.forces()
        v = kick(self.v, forces.f / self.bodies.mass[:, None], self.since_half)
        return v, self._spins(kick(self.m, forces.t / self.bodies.inertia[:, None], self.since_half))

    def look(self, moving: bool = True, inside: Inside | None = None) -> Grains:
        """Return its grains at the whole step."""
        v, w = self.whole_step()
        m, bodies = rotation.momenta(self.scene.grains, w, self.q), self.bodies if self.scene.grains.varied else None
        return Grains(self.ids, self.x, v, w, m, self.v, self.m, self.q, bodies).within(inside)

    def accumulated(self) -> Mapping[str, float]:
        """See `labbook_dem.reading.Readable`; there are no lists to rebuild."""
        return {"work": self.work, "max_overlap": self.max_overlap, "touching": self.touching, "rebuilds": 0}

    def extremes(self) -> tuple[float, float]:
        """Largest overlap [m] and speed [m/s] so far."""
        return self.deepest, self.fastest

    def contacts(self) -> np.ndarray:
        """Return touching contacts in the columns of the probe `Contacts`."""
        rows = [
            (self.ids[c.i], self.ids[c.j] if c.j >= 0 else -1, c.wall, *_three(c.force), *_three(c.branch))
            for c in self.forces().contacts
        ]
        return np.array(rows, float).reshape(-1, len(CONTACT_COLUMNS))

    def crossings(self) -> np.ndarray:
        """Return the first passages since the last call."""
        rows, self._crossed = self._crossed, []
        return np.array(rows, float).reshape(-1, len(crossing_columns(self.scene.grains.oriented)))

    def packing(self) -> Packing:
        """The portable state."""
        v, w = self.whole_step()
        row = {name: k for k, name in enumerate(self.ids.tolist())}
        pairs = {key: s for key, s in self.springs.items() if not is_wall(key)}
        walls = {key: s for key, s in self.springs.items() if is_wall(key)}
        return Packing(
            x=self.x.copy(),
            v=v,
            omega=w,
            q=None if self.q is None else self.q.copy(),
            ids=self.ids.copy(),
            pairs=np.array([[row[i], row[j]] for i, j, *_ in pairs], np.int64).reshape(-1, 2),
            pair_parts=self._parts_of(pairs),
            pair_spring=np.array([_three(s) for s in pairs.values()], float).reshape(-1, 3),
            wall_grain=np.array([row[key[0]] for key in walls], np.int64),
            wall_name=np.array([self.walls[key[1]].name for key in walls], "U40"),
            wall_spring=np.array([_three(s) for s in walls.values()], float).reshape(-1, 3),
            wall_part=np.array([key[2] for key in walls], np.int64),
            pair_rolling=self._rolling_of(pairs),
            wall_rolling=self._rolling_of(walls),
            **(self.bodies.carried(self.scene.grains) if self.scene.grains.varied else {}),
        )

    def _parts_of(self, pairs: Iterable[Key]) -> np.ndarray | None:
        """Places of both spheres of contacts of clumps, shape [m, 2]; None for other grains."""
        if not isinstance(self.scene.grains, Clumps):
            return None
        return np.array([key[2:] for key in pairs], np.int64).reshape(-1, 2)

    def _rolling_of(self, contacts: Iterable[Key]) -> np.ndarray | None:
        """Torques [N m] of the rolling springs of these contacts, shape [m, 3]; None without rolling springs."""
        if not self._rolling:
            return None
        return np.array([_three(self.rolling[key]) for key in contacts], float).reshape(-1, 3)


def is_wall(key: Key) -> bool:
    """True for the key of a spring at a wall."""
    return len(key) == 3


def pair_key_length(scene: Scene) -> int:
    """Length of the keys of springs of pairs: two ids, and of clumps the places of two spheres."""
    return 4 if isinstance(scene.grains, Clumps) else 2


def check_checkpoint(can: Capabilities, scene: Scene, stored: Checkpoint) -> None:
    """Validate a checkpoint. Raises ValueError if no member of this scene can have left it; the message names the
    array."""
    names = {"x", "v", "u", "m", "y", "ids", "gone", "radius", "mass", "inertia", "kind", "step", "touching", "work"}
    names |= {"max_overlap", "pair_key", "pair_spring", "wall_key", "wall_spring"}
    names |= {"q"} if is_oriented(scene) else set()
    names |= {"pair_rolling", "wall_rolling"} if rolling_springs(scene) else set()
    check_names(can, names | {*NEWER}, stored, frozenset(NEWER))
    arrays: Mapping[str, np.ndarray] = stored.arrays
    n = arrays["ids"].shape[0] if arrays["ids"].ndim == 1 else -1
    pairs, walls = (len(arrays[f"{of}_key"]) if arrays[f"{of}_key"].ndim else -1 for of in ("pair", "wall"))
    shapes: dict[str, tuple[tuple[int, ...], type]] = dict.fromkeys(("x", "v", "u", "m", "y"), ((n, 3), np.float64))
    shapes |= dict.fromkeys(("radius", "mass", "inertia"), ((n,), np.float64)) | {"gone": ((n,), np.bool_)}
    shapes |= dict.fromkeys(("ids", "kind"), ((n,), np.int64)) | {"q": ((n, 4), np.float64)}
    shapes |= dict.fromkeys(("step", "touching"), ((), np.int64)) | dict.fromkeys(("work", "max_overlap"), ((), float))
    shapes |= {"pair_key": ((pairs, pair_key_length(scene)), np.int64), "pair_spring": ((pairs, 3), np.float64)}
    shapes |= {"wall_key": ((walls, 3), np.int64), "wall_spring": ((walls, 3), np.float64)}
    shapes |= dict.fromkeys(NEWER, ((), float))
    shapes |= {"pair_rolling": ((pairs, 3), np.float64), "wall_rolling": ((walls, 3), np.float64)}
    for name, array in arrays.items():
        shape, kind = shapes[name]
        if array.shape != shape or array.dtype != kind:
            raise ValueError(f"{name} has shape {array.shape} of {array.dtype}, not {shape} of {np.dtype(kind)}")
        if name in NEWER:
            if not array >= 0:
                raise ValueError(f"{name} is negative or NaN")
        elif array.dtype == np.float64 and not np.isfinite(array).all():
            raise ValueError(f"{name} is not finite")
    ids, kinds = arrays["ids"], len(scene.grains.species)
    if not (0 < n <= scene.grains.count and len(np.unique(ids)) == n and ids.min() >= 0):
        raise ValueError(f"it has {n} grains of {scene.grains.count}, or some of them twice")
    if ids.max() >= scene.grains.count:
        raise ValueError(f"ids are not those of {scene.grains.count} grains")
    if not 0 <= int(arrays["step"]) < LONGEST:
        raise ValueError(f"it was saved at step {int(arrays['step'])}")
    meshes = [wall.shape for wall in scene.container.walls() if isinstance(wall.shape, TriangleMesh)]
    spheres_of_grain = len(scene.grains.spheres) if isinstance(scene.grains, Clumps) else 1
    at_walls = max(PARTS, MESH_CONTACTS) * len(scene.container.walls())
    most_contacts = n * (n * spheres_of_grain**2 + spheres_of_grain * at_walls)
    if not 0 <= int(arrays["touching"]) <= most_contacts:
        raise ValueError(f"{int(arrays['touching'])} contacts are more than {n} grains can have")
    radius, kind = arrays["radius"], arrays["kind"]
    if not ((radius > 0) & (radius <= scene.grains.radius) & (arrays["mass"] > 0) & (arrays["inertia"] > 0)).all():
        raise ValueError("it holds grains that the scene does not have")
    if not ((kind >= 0) & (kind < kinds)).all():
        raise ValueError(f"kinds of grains are not from 0 to {kinds - 1}")
    wall, part = arrays["wall_key"][:, 1], arrays["wall_key"][:, 2]
    of_pairs, pair_parts = arrays["pair_key"][:, :2], arrays["pair_key"][:, 2:]
    if not ((pair_parts >= 0) & (pair_parts < spheres_of_grain)).all():
        raise ValueError("springs belong to spheres that clumps do not have")
    if not (np.isin(of_pairs, ids).all() and np.isin(arrays["wall_key"][:, 0], ids).all()):
        raise ValueError("springs belong to grains that do not exist")
    table = rod_table if isinstance(scene.grains, Spherocylinders) else mesh_table
    most_parts = max([PARTS, *(len(table(shape).features) for shape in meshes)])
    most_parts *= MOST_SPHERES if isinstance(scene.grains, Clumps) else 1
    if not ((wall >= 0) & (wall < len(scene.container.walls())) & (part >= 0) & (part < most_parts)).all():
        raise ValueError("springs are at walls that do not exist")


def _three(v: vec3) -> tuple[float, float, float]:
    return v.x, v.y, v.z
