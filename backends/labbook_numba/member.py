"""A member: its arrays and kernels, its start, beats and readings."""

from collections.abc import Mapping
from types import ModuleType

import numpy as np
from labbook_dem.ensemble import NOT_RECORDED, Failure, MemberState, check_checkpoint, explain, indices
from labbook_dem.features import has_meshes, is_oriented, pose_table, rolling_springs
from labbook_dem.mesh import SPRING_KEY, spring_places
from labbook_dem.mesh_grid import first_features, shapes_of
from labbook_dem.reading import Grains, Inside
from labbook_dem.rotation import axes, momenta
from labbook_dem.traction import SUMS

from labbook.backend import Capabilities, Checkpoint, Status
from labbook.backend.numerics import Numerics
from labbook.backend.probes import SLIDING, Crossing, Traction
from labbook.scene import Bodies, Packing, Scene
from labbook_numba import state as S
from labbook_numba.domains import advance, in_layers
from labbook_numba.parameters import parameters
from labbook_numba.state import Params
from labbook_numba.stored import array_names, check_state, layout_of

PAIRS_PER_GRAIN, WALLS_PER_GRAIN = 6, 3  # initial capacities; arrays grow after an overflow
GUARDS = {2: "state", 3: "speed", 4: "overlap"}


class Run(MemberState):
    """Scene that compiled kernels step."""

    def __init__(self, can: Capabilities, kernels: ModuleType, scene: Scene, numerics: Numerics, probes):
        self._can, self.kernels = can, kernels
        self.scene, self.numerics, self.probes = scene, numerics, tuple(probes)
        self.params: Params = parameters(scene, numerics, probes, kernels.WALL_NUMBERS)
        self.names = [wall.name for wall in scene.container.walls()]
        self.rods = is_oriented(scene)
        self.layout = layout_of(scene)
        self.failure: Failure | None = None
        self._varied, self._rolling = scene.grains.varied, rolling_springs(scene)
        self._array_names = array_names(scene)
        self._first_feature = first_features(shapes_of(scene.container.walls()), self.rods)
        self._posed = has_meshes(scene) and bool(kernels.POSES)

    # start

    def start(self, packing: Packing) -> None:
        """Start from a packing at step 0."""
        packing = in_layers(packing, self.scene.grains.diameter)
        n = len(packing)
        near, walls = PAIRS_PER_GRAIN * n + 64, WALLS_PER_GRAIN * n + 64
        sizes = n, near, len(self.names), walls, self._crossings(n)
        self.state = st = S.allocate(*sizes, self.numerics.precision, self.layout)
        st.count[S.GRAINS] = n
        st.x[:], st.v[:], st.w[:], st.ids[:] = packing.x, packing.v, packing.omega, packing.ids
        st.u[:] = packing.v
        st.gone[:] = packing.x[:, 2] < self.params.plane
        self._make(packing, slice(n))
        self._rebuild()
        self._set_springs(packing)

    def _orient(self, packing: Packing, rows: slice) -> None:
        if packing.q is None:
            raise ValueError("rods cannot start from a packing without orientations q: it is one of spheres")
        st = self.state
        st.q[rows] = packing.q / np.linalg.norm(packing.q, axis=1)[:, None]
        st.grains[rows, S.A : S.A + 3] = axes(st.q[rows])
        st.grains[rows, S.P : S.P + 3] = packing.omega
        st.m[rows] = momenta(self.scene.grains, packing.omega, st.q[rows])

    def _crossings(self, n: int) -> int:
        return n if any(isinstance(probe, Crossing) for probe in self.probes) else 0

    def _set_springs(self, packing: Packing) -> None:
        st, pairs = self.state, int(self.state.count[S.PAIRS])
        index = indices(_keys(st.pair_i[:pairs], st.pair_j[:pairs]), _keys(*packing.pairs.T))
        listed = index >= 0
        st.spring[index[listed], :3] = packing.pair_spring[listed]
        pair_rolling, wall_rolling = packing.rolling
        if self._rolling:
            st.spring[index[listed], S.ROLL : S.ROLL + 3] = pair_rolling[listed]
        st.held[index[listed]] = 1
        for w, name in enumerate(self.names):
            first, last = st.wall_first[w], st.wall_first[w + 1]
            of_wall = packing.wall_name == name
            index = indices(st.wall_grain[first:last], packing.wall_grain[of_wall])
            listed = index >= 0
            entry, part = first + index[listed], packing.wall_part[of_wall][listed]
            first_feature, next_feature = self._first_feature[w : w + 2]
            if part.max(initial=0) >= (next_feature - first_feature or self.layout.WALL_PARTS):
                raise ValueError(f"the packing has a spring at part {part.max()} of the wall {name}")
            if next_feature > first_feature:
                feature, part = part + first_feature, spring_places(entry)
                st.wall_spring[entry * self.layout.WALL_PARTS + part, SPRING_KEY] = feature
            row = entry * self.layout.WALL_PARTS + part
            st.wall_spring[row, :3] = packing.wall_spring[of_wall][listed]
            if self._rolling:
                st.wall_spring[row, S.ROLL : S.ROLL + 3] = wall_rolling[of_wall][listed]
            np.bitwise_or.at(st.wall_held, entry, (1 << part).astype(np.uint8))

    def restore(self, checkpoint: Checkpoint) -> None:
        """Continue from a checkpoint.

        Raises:
            ValueError: it is not of this backend and version, or no member of this scene can have left it.
        """
        check_checkpoint(self._can, self._array_names, checkpoint)
        # Copies in C order: kernels are compiled for it, and for another order Numba would compile them again.
        stored = {name: np.array(array, order="C") for name, array in checkpoint.arrays.items()}
        if stored["sums"].shape == (S.OLDER_SUMS,):
            stored["sums"] = np.append(stored["sums"], [NOT_RECORDED, NOT_RECORDED])
        check_state(stored, self.scene, self.numerics, crossings=bool(self._crossings(1)))
        self._put_back(stored)

    def _put_back(self, stored: dict[str, np.ndarray]) -> None:
        empty = S.allocate(len(stored["ids"]), 0, 0, 0, 0, self.numerics.precision, self.layout)
        self.state = empty._replace(**stored)
        self._list_features()

    def checkpoint(self) -> Checkpoint:
        """The exact state, copied."""
        arrays = {name: a.copy() for name, a in self.state._asdict().items() if name in self._array_names}
        return Checkpoint(self._can.name, self._can.cache_version, arrays)

    # beats

    @property
    def step(self) -> int:
        """Steps taken."""
        return int(self.state.count[S.STEP])

    @property
    def grains(self) -> int:
        """Number of grains that have not left."""
        return int(self.state.count[S.GRAINS])

    def beat(self, threads: int = 1) -> None:
        """Take one beat of steps; after a failure, set `failure` and restore the state before the beat.

        The number of threads decides no bit. An exception of a thread is raised here, with the state before the beat.
        """
        # Kernels write in place: a failed beat, or one that an exception ends, is undone by these copies.
        before = {name: a.copy() for name, a in self.state._asdict().items() if name in self._array_names}
        target = (self.step // self.numerics.steps_per_beat + 1) * self.numerics.steps_per_beat
        self._drop_leavers()
        self.frames.clear()
        try:
            code = self.kernels.DONE
            for step in self.frame_steps():
                if (code := self._advance_to(step, threads)) != self.kernels.DONE:
                    break
                self._take_frames_of_copy()
            if code == self.kernels.DONE:
                code = self._advance_to(target, threads)
        except BaseException:
            self._put_back(before)
            raise
        st = self.state
        if code != self.kernels.DONE:
            grain = int(st.count[S.FAIL_GRAIN])
            self._fail(GUARDS[code], grain, float(st.sums[S.FAIL_VALUE]), before)
            return
        # speeds are checked at every step; a spin moves nothing until its grain touches another: once a beat is enough
        lost = ~np.isfinite(st.w[: st.count[S.GRAINS]]).all(axis=1)
        if lost.any():
            self._fail("spin", int(st.ids[np.argmax(lost)]), np.nan, before)

    def _advance_to(self, step: int, threads: int) -> int:
        if self.step == step:  # the kernel would take the call as a reading, which advances springs
            return self.kernels.DONE
        while (code := self._advance(step, threads)) == self.kernels.REBUILD:
            self._rebuild()
        return code

    def _take_frames_of_copy(self) -> None:
        """Read the frames that are due, from a copy: reading may rebuild lists, and rebuilds are counted."""
        state = self.state
        self.state = state._replace(**{name: getattr(state, name).copy() for name in self._array_names})
        try:
            self.take_frames()
        finally:
            self.state = state

    def _advance(self, target: int, threads: int) -> int:
        self._bring_poses(target)
        return advance(self.kernels, self.state, self.params, target, self.layout, threads)

    def _drop_leavers(self) -> None:
        """Drop grains far below the outlet, even if nothing else moves."""
        if self.state.count[S.LEAVING] > 0:
            self._rebuild()

    def _fail(self, guard: str, grain: int, value: float, before: dict[str, np.ndarray]) -> None:
        message = explain(guard, grain, self.step, value, self.scene, self.numerics)
        self.failure = Failure("state" if guard == "spin" else guard, self.step, grain, message)
        self._put_back(before)

    def _bring_poses(self, last: int) -> None:
        """Work out the poses of parts from the last step to `last`, unless they are at hand."""
        st, before = self.state, self.step - 1
        if not self._posed or (st.pose_first[0] <= before and last < st.pose_first[0] + len(st.pose)):
            return
        pose = pose_table(self.scene, before, max(last, self.step), self.numerics.dt)
        self.state = st._replace(pose=pose, pose_first=np.array([before]))

    def _rebuild(self) -> None:
        self._bring_poses(self.step)
        st = self.state
        pairs, walls = len(st.pair_j), len(st.wall_grain)
        while not self.kernels.rebuild(
            st, self.params, new := S.lists(pairs, len(self.names), walls, self.layout), S.grid(len(st.ids))
        ):
            # The kernel has counted what it had no room for. With spare room the next rebuilds need no second attempt.
            pairs = max(pairs, int(1.3 * st.count[S.WANT_PAIRS]) + 64)
            walls = max(walls, int(1.3 * st.count[S.WANT_WALLS]) + 64)
        self.state = st._replace(**new._asdict())
        self._list_features()

    def _list_features(self) -> None:
        """List the features of meshes near each entry of the lists; lists and positions determine them."""
        if not self._first_feature[-1]:
            return
        self._bring_poses(self.step)
        first, near = np.zeros(len(self.state.wall_grain) + 1, np.int64), self.state.mesh_near
        while (length := self.kernels.list_features(self.state, self.params, first, near)) > len(near):
            near = np.zeros(int(1.3 * length) + 64, np.int32)
        self.state = self.state._replace(mesh_first=first, mesh_near=near)

    # readings

    def look(self, moving: bool = True, inside: Inside | None = None) -> Grains:
        """Return its grains at the whole step; views, except v, w and m."""
        v, w = self.whole_step()
        st, n, m = self.state, len(v), momenta(self.scene.grains, w, self.q)
        half = st.m if self.rods else st.w
        grains = Grains(st.ids[:n], st.x[:n], v, w, m, st.v[:n], half[:n], self.q, self.bodies())
        return grains.within(inside)

    def progress(self) -> Status:
        """Status without the kinetic energy; lists are rebuilt as before reading it, since rebuilds are counted."""
        now = super().progress()
        if self.step:
            self._fresh_lists()
        return now

    def accumulated(self) -> Mapping[str, float]:
        """See `labbook_dem.reading.Readable`."""
        sums, count = self.state.sums, self.state.count
        counters = {"touching": int(count[S.TOUCHING]), "rebuilds": int(count[S.REBUILDS])}
        return {"work": float(sums[S.WORK]), "max_overlap": float(sums[S.MAX_OVERLAP]), **counters}

    def extremes(self) -> tuple[float, float]:
        """Largest overlap [m] and speed [m/s] so far."""
        return float(self.state.sums[S.DEEPEST]), float(np.sqrt(self.state.sums[S.FASTEST2]))

    def crossings(self) -> np.ndarray:
        """Return the first passages since the last call."""
        rows = self.state.cross[: self.state.count[S.CROSSED]].copy()
        self.state.count[S.CROSSED] = 0
        return rows

    def bodies(self) -> Bodies | None:
        """Return the properties of each grain; None if all are the same."""
        if not self._varied:
            return None
        radius, mass, inertia, kind = self.state.body[: self.grains].T
        return Bodies(radius, mass, inertia, kind.astype(np.int64))

    def packing(self) -> Packing:
        """Return the portable state, without grains far below the outlet.

        Reading leaves no trace: a run that is read at other times, as after a kill, ends in the same bits.
        """
        before = {name: a.copy() for name, a in self.state._asdict().items() if name in self._array_names}
        self._drop_leavers()
        try:
            return self._packing()
        finally:
            self._put_back(before)

    def _packing(self) -> Packing:
        st, n, pairs = self.state, int(self.state.count[S.GRAINS]), int(self.state.count[S.PAIRS])
        walls = int(st.wall_first[-1])
        wall = np.repeat(np.arange(len(self.names)), np.diff(st.wall_first))
        entry, part = np.nonzero(st.wall_held[:walls, None] >> np.arange(self.layout.WALL_PARTS) & 1)
        touching = st.held[:pairs] == 1
        v, w = self.whole_step()
        varied, row = self.bodies(), entry * self.layout.WALL_PARTS + part
        roll = slice(S.ROLL, S.ROLL + 3)
        first_feature, next_feature = self._first_feature[wall[entry]], self._first_feature[wall[entry] + 1]
        feature = st.wall_spring[row, SPRING_KEY].astype(np.int64) - first_feature
        return Packing(
            x=st.x[:n].copy(),
            v=v,
            omega=w,
            q=None if self.q is None else self.q.copy(),
            ids=st.ids[:n].copy(),
            pairs=np.column_stack([st.pair_i[:pairs], st.pair_j[:pairs]])[touching].astype(np.int64),
            pair_spring=st.spring[:pairs, :3][touching],
            wall_grain=st.wall_grain[:walls][entry].astype(np.int64),
            wall_name=np.array([*self.names, ""], "U40")[wall[entry]],
            wall_spring=st.wall_spring[row, :3],
            wall_part=np.where(next_feature > first_feature, feature, part),
            pair_rolling=st.spring[:pairs, roll][touching] if self._rolling else None,
            wall_rolling=st.wall_spring[row, roll] if self._rolling else None,
            **(varied.carried(self.scene.grains) if varied else {}),
        )

    def present(self) -> np.ndarray:
        """Ids of the grains that have not left."""
        self._drop_leavers()
        return self.state.ids[: self.grains]

    def put_back(self, grains: Packing, half_v: np.ndarray) -> None:
        """Insert grains in rows behind the others; see `MemberState`."""
        self._drop_leavers()  # first: it frees their rows, and moves other grains
        first, last = self.grains, self.grains + len(grains)
        if last > len(self.state.ids):
            self._grow(self.scene.grains.count)
        st, new = self.state, slice(first, last)
        st.grains[new], st.loads[new] = 0.0, 0.0
        st.x[new], st.v[new], st.u[new], st.w[new] = grains.x, half_v, grains.v, grains.omega
        st.ids[new], st.gone[new] = grains.ids, grains.x[:, 2] < self.params.plane
        self._make(grains, new)
        st.count[S.GRAINS] = last
        self._rebuild()

    def _grow(self, rows: int) -> None:
        """Enlarge the arrays for `rows` grains: those of a stream were not present at the start."""
        old, n = self.state, self.grains
        sizes = rows, PAIRS_PER_GRAIN * rows + 64, len(self.names), WALLS_PER_GRAIN * rows + 64, self._crossings(rows)
        new = S.allocate(*sizes, self.numerics.precision, self.layout)
        for name in ("grains", "loads", "body", "ids", "gone"):
            getattr(new, name)[:n] = getattr(old, name)[:n]
        new.cross[: len(old.cross)] = old.cross
        shared = {name: getattr(old, name) for name in (*S.Lists._fields, "count", "sums")}
        self.state = new._replace(**shared)

    def set_velocities(self, ids: np.ndarray, v: np.ndarray) -> None:
        """See `MemberState`."""
        st, present = self.state, self.state.ids[: self.grains]
        order = np.argsort(present)
        rows = order[np.searchsorted(present, ids, sorter=order)]
        st.v[rows], st.u[rows] = v, v

    def _make(self, packing: Packing, rows: slice) -> None:
        """Set the weights, bodies and orientations of the grains in `rows`."""
        st = self.state
        st.f[rows, 2] = -self.params.mass * self.params.gravity
        if self._varied:
            varied = Bodies.of(self.scene.grains, packing)
            st.body[: len(st.ids)][rows] = np.column_stack([varied.radius, varied.mass, varied.inertia, varied.kind])
            st.f[rows, 2] = -varied.mass * self.params.gravity
        if self.rods:
            self._orient(packing, rows)

    @property
    def q(self) -> np.ndarray | None:
        """Orientations, shape [n, 4], a view; None for spheres."""
        return self.state.q[: self.grains] if self.rods else None

    def whole_step(self) -> tuple[np.ndarray, np.ndarray]:
        """Return velocities [m/s] and spins [rad/s], shape [n, 3], at the time of the positions."""
        if self.step == 0:  # those of the start: coincident grains would have forces of 0/0
            return self.state.v[: self.grains].copy(), self.state.w[: self.grains].copy()
        self._fresh_lists()  # may drop grains far below the outlet, and so their rows
        n = self.grains
        v, w = np.empty((n, 3)), np.empty((n, 3))
        # A reading computes the forces of this step again, which advances springs and sums: on copies of these.
        changed = ("loads", "held", "spring", "wall_held", "wall_spring", "sums", "count")
        copy = self.state._replace(**{name: getattr(self.state, name).copy() for name in changed})
        if n:
            assert advance(self.kernels, copy, self.params, self.step, self.layout) == self.kernels.DONE
        self.kernels.whole_step(copy.grains, copy.loads, copy.body, self.since_half, self.params, v, w)
        return v, w

    def contacts(self) -> np.ndarray:
        """Return touching contacts: i, j, wall, force on i [N] and branch vector [m], as the probe `Contacts` has
        them."""
        self._fresh_lists()
        out = np.zeros((int(self.state.count[S.PAIRS] + self.state.wall_first[-1] * self.layout.WALL_PARTS), 9))
        return out[: self.kernels.contact_rows(self.state, self.params, out)]

    def wall_sums(self, probe: Traction) -> np.ndarray:
        """See `labbook_dem.reading.Readable`."""
        self._fresh_lists()
        table = self.bins[probe]
        sums, rows = np.zeros((table.total, SUMS), np.int64), np.zeros((self.layout.WALL_PARTS, 9))
        self.kernels.wall_sums(self.state, self.params, table.numbers, SLIDING, table.force, table.torque, rows, sums)
        return sums

    def _fresh_lists(self) -> None:
        self._bring_poses(self.step)
        if self.state.sums[S.MOVED] >= 0.5 * self.params.skin:
            self._rebuild()  # a rebuild decides no bit of the motion


def _keys(i: np.ndarray, j: np.ndarray) -> np.ndarray:
    return i.astype(np.int64) << 32 | j.astype(np.int64)
