"""Slots of an ensemble: members get their slots, in larger arrays if necessary, and take beats."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import MappingProxyType
from typing import Any

import numpy as np
import warp as wp
from labbook_dem import features
from labbook_dem.mesh_grid import mesh_reach

from labbook.backend import Capabilities, Checkpoint, Spec
from labbook.backend.numerics import Numerics
from labbook.scene import Scene
from labbook.scene.packing import Packing
from labbook_warp import room, transfer
from labbook_warp.arrays import Arrays, SlotState, fetch
from labbook_warp.beat import Beat
from labbook_warp.compiling import mixed
from labbook_warp.layout import EXTREMES, Sizes
from labbook_warp.meshes import MeshTables
from labbook_warp.parameters import cell_size, material, member_domain, same_material
from labbook_warp.poses import PoseTables
from labbook_warp.report import Report, collect
from labbook_warp.returning import read_rows, write_rows
from labbook_warp.run import Run

MAX_INTERVAL, MIN_INTERVAL = 50, 1
"""Largest and smallest number of steps between two checks of displacements. A check costs about a step and decides no
bit of the motion."""
CALM = 100
"""Beats without a late list after which checks become half as frequent. A late list costs one beat."""


class Stage:
    """Members of an ensemble in the slots of device arrays.

    Args:
        can: capabilities of the backend.
        spec: features of the kernels.
        device: Warp device.
        slots: least number of slots.
        lanes: threads a grain, or None for the fastest number.
    """

    def __init__(self, can: Capabilities, spec: Spec, device: wp.Device, slots: int, lanes: int | None):
        self._can, self._spec, self.device, self._lanes = can, spec, device, lanes
        self._sizes = room.empty(spec, slots)
        self._seated: dict[int, Run] = {}
        self._waiting: list[Run] = []
        self._interval, self._beats_without_late = MAX_INTERVAL, 0
        """Steps between two checks of displacements, and beats without a late list since this interval changed."""
        self._uniform = True
        self._in_beat = False
        """True within a beat that is taken in parts."""
        self._arrays: Arrays | None = None
        self._beats: Beat | None = None
        self._meshes = MeshTables(device)
        self._poses = PoseTables(device, spec.steps_per_beat)
        self.changes = 0
        """Counter of changes of the state of members."""
        self._of_all, self._of_one = 0, dict[int, int]()  # `changes` at the last change of all slots, or of one

    @property
    def arrays(self) -> Arrays:
        """Device arrays, once a member has a slot."""
        assert self._arrays is not None
        return self._arrays

    @property
    def beats(self) -> Beat:
        """Launches of kernels over the arrays."""
        assert self._beats is not None
        return self._beats

    def changed_since(self, then: int, slot: int) -> bool:
        """True if the state of the member in a slot may have changed since `changes` had the value `then`."""
        return max(self._of_all, self._of_one.get(slot, 0)) > then

    def _has_changed(self, run: Run | None = None) -> None:
        """Count a change of the state of a member; None: of all members."""
        self.changes += 1
        if run is None:
            self._of_all = self.changes
        else:
            self._of_one[run.slot] = self.changes

    # members and slots

    @property
    def runs(self) -> Sequence[Run]:
        """Members with a slot."""
        return tuple(self._seated.values())

    def wait(self, run: Run) -> None:
        """Queue a member for a slot."""
        self._waiting.append(run)

    def leave(self, run: Run) -> None:
        """Free the slot of a member."""
        if run in self._waiting:
            self._waiting.remove(run)
        self._seated.pop(run.slot, None)

    def close(self) -> None:
        """Free the device's memory."""
        self._seated.clear()
        self._arrays = self._beats = None

    def seat(self) -> None:
        """Give every waiting member a slot, in larger arrays if necessary. Raises MemoryError."""
        new, self._waiting = self._waiting, []
        if not new:
            return
        self._interval = min(self._interval, usual_check(new))
        uniform = same_material((run.scene, run.numerics) for run in (*self.runs, *new)) and not mixed(self._spec)
        needed = room.with_members(self._sizes, len(self._seated), new)
        if self._arrays is None or (needed, uniform) != (self._sizes, self._uniform):
            self._uniform = uniform
            self._resize(needed)
        elif uniform and not self._seated:  # these all share a material, perhaps another than those that have left
            self.beats.renew()
        free = iter(slot for slot in range(needed.slots) if slot not in self._seated)
        for run in new:
            run.slot = next(free)
            self._seated[run.slot] = run
        with self.arrays.written_together([run.slot for run in new]):
            self._parameters(new)
            for run in new:
                self._put(run)
        self._counters()
        self._take_meshes(new)
        fresh = {run: run.begin for run in new if isinstance(run.begin, Packing)}
        self._build_lists(list(fresh))
        if self._spec.feature("FRICTION"):
            slots = [run.slot for run in fresh]
            with self.arrays.reading(slots), self.arrays.written_together(slots):
                for run, start in fresh.items():
                    transfer.set_springs(self.arrays, run.slot, run.scene, start, run.names)
        for run in new:
            run.begin = None
        self._has_changed()

    def put_back(self, returning: Sequence[tuple[Run, Packing, np.ndarray]]) -> None:
        """Insert grains that left a member again, in rows of others that have left or behind all rows.

        If too few rows are free, those of grains that left are closed up, and some are added, so that this is not
        necessary after each beat: it moves all of a member's state to the host and back.

        Args:
            returning: members, their grains, and velocities [m/s] half a step before, shape [grains, 3].

        Raises:
            MemoryError, Overflow.
        """
        self.seat()
        self.read_ids()
        fits = [
            (run, grains, half_v)
            for run, grains, half_v in returning
            if run.rows + len(grains) - len(run.free) <= self._sizes.cap
        ]
        if fits and not self._append(fits):
            fits = []
        appended = {run for run, _, _ in fits}
        if crowded := [back for back in returning if back[0] not in appended]:
            self._close_up_with(crowded)

    def read_ids(self) -> None:
        """Read the ids of the rows of members that have got rows since they were read."""
        if runs := [run for run in self.runs if len(run.ids) != run.rows]:
            with self.arrays.reading([run.slot for run in runs]):
                for run in runs:
                    run.ids = self.arrays.read("ids", run.slot, run.rows).astype(np.int64)

    def _append(self, returning: Sequence[tuple[Run, Packing, np.ndarray]]) -> bool:
        """Put grains into free rows of members. Returns False, without a change, if their lists have no room."""
        arrays, runs, cap = self.arrays, [run for run, _, _ in returning], self._sizes.cap
        arrays.back_up()
        tables, rows = list[dict[str, np.ndarray]](), list[np.ndarray]()
        before = {run: (run.rows, run.left, run.ids, run.past_work) for run in runs}
        reused = dict[Run, np.ndarray]()
        for run, grains, half_v in returning:
            assert grains.ids is not None
            plane, _ = features.planes(run.scene, run.probes)
            tables.append(transfer.entering(arrays, run.scene, grains, half_v, plane))
            own, reused[run] = run.takes(grains.ids)
            rows.append(run.slot * cap + own)
        self._count_work(reused)
        together = {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
        write_rows(arrays, np.concatenate(rows), together)
        self._send_left()
        if any(self._lists(runs)):
            for run, (run.rows, run.left, run.ids, run.past_work) in before.items():
                run.free = run.free[:0]
                arrays.restore(run.slot)
            return False
        for run in runs:
            self._has_changed(run)
        return True

    def _count_work(self, reused: Mapping[Run, np.ndarray]) -> None:
        """Add the work on grains that had the rows `reused` to that on grains without a row."""
        if self.arrays.module.LEDGER:
            cap, sizes = self._sizes.cap, [len(rows) for rows in reused.values()]
            work = read_rows(self.arrays.system.work, np.concatenate([run.slot * cap + reused[run] for run in reused]))
            for run, own in zip(reused, np.split(work, np.cumsum(sizes)[:-1]), strict=True):
                run.past_work = np.concatenate([run.past_work, own[own != 0]])

    def _send_left(self) -> None:
        """Write the numbers of grains that have left, of all members, to the device."""
        left = np.zeros(self._sizes.slots, np.int32)
        for slot, run in self._seated.items():
            left[slot] = run.left
        self.arrays.system.left.assign(left)

    def _close_up_with(self, returning: Sequence[tuple[Run, Packing, np.ndarray]]) -> None:
        """Insert grains into members and close up the rows of grains that left, with one copy of each array for all
        members."""
        states = dict[Run, Checkpoint]()
        with self.arrays.reading([run.slot for run, _, _ in returning]):
            for run, grains, half_v in returning:
                plane, _ = features.planes(run.scene, run.probes)
                states[run] = transfer.joined(self.arrays, run.scene, self.stored(run), grains, half_v, plane)
        for run, state in states.items():
            run.takes_up(state)
        sizes = room.with_spare_rows(
            room.with_members(self._sizes, len(self._seated) - len(states), list(states)), states
        )
        if sizes == self._sizes:
            with self.arrays.written_together([run.slot for run in states]):
                for run, state in states.items():
                    transfer.restore(self.arrays, run.slot, state)
            self._counters()
        else:
            self._resize(sizes, states)
        while any(needed := self._lists(list(states))):  # springs that found no room are in `states` alone
            self._resize(room.grown(self._sizes, *needed), states)
        for run in states:
            self._has_changed(run)

    def set_velocities(self, run: Run, ids: np.ndarray, v: np.ndarray) -> None:
        """Set velocities [m/s] of grains of a member: half a step before, and the predicted ones."""
        self.seat()
        transfer.set_velocities(self.arrays, run.slot, run.rows, ids, v)
        self._has_changed(run)

    def _put(self, run: Run) -> None:
        if isinstance(run.begin, Packing):
            plane, _ = features.planes(run.scene, run.probes)
            transfer.start(self.arrays, run.slot, run.scene, run.begin, plane, cell_size(run.scene, run.numerics))
        else:
            assert run.begin is not None
            transfer.restore(self.arrays, run.slot, run.begin)

    def _parameters(self, runs: Sequence[Run]) -> None:
        """Write the parameters of members into their slots.

        Replicates share a scene, whose tables are computed once.
        """
        arrays, module = self.arrays, self.arrays.module
        of_scenes: dict[tuple[int, int], tuple[Any, dict[str, np.ndarray]]] = {}
        materials, domains = dict[int, Any](), dict[int, Any]()
        for run in runs:
            scene = id(run.scene), id(run.numerics)
            if scene not in of_scenes:
                of_scenes[scene] = material(module, run.scene, run.numerics), self._tables(run)
            materials[run.slot], tables = of_scenes[scene]
            domains[run.slot] = member_domain(module, run.scene, run.numerics, run.probes, run.lattice)
            for name, table in tables.items():
                arrays.put(name, run.slot, table)
            for name, value in zip(EXTREMES, run.start_extremes, strict=True):
                arrays.put(name, run.slot, np.array([value]))
        arrays.put_records("material", materials)
        arrays.put_records("domain", domains)
        if runs:
            arrays.system.common = materials[runs[-1].slot]

    def _tables(self, run: Run) -> dict[str, np.ndarray]:
        """Coefficients of pairs of kinds, and tables of walls, by the names of their arrays."""
        tables: dict[str, np.ndarray] = {}
        if run.scene.grains.varied:
            tables["pair_c"] = features.pair_table(run.scene, run.numerics)
        if run.names:
            walls, width = features.wall_tables(run.scene, run.numerics), self.arrays.module.WALL_NUMBERS
            numbers = np.pad(walls.numbers, ((0, 0), (0, width - walls.numbers.shape[1])))
            tables |= {"wall_c": walls.c, "wall_numbers": numbers.ravel(), "wall_kind": walls.kind}
            tables["wall_motion"] = walls.motion
        return tables

    def _take_meshes(self, runs: Sequence[Run]) -> None:
        """Let kernels know of the meshes of these members, whose grains may be near some."""
        if not self.arrays.module.MESHES:
            return
        if self._meshes.cover(self.runs):
            self.beats.renew()
            runs = self.runs
        self._meshes.put(self.arrays.system)
        for run in runs:
            self.arrays.put("mesh_of", run.slot, self._meshes.of(run))
        self._take_poses()
        self._list_features(runs)

    def _take_poses(self) -> None:
        """Let kernels know where the parts of all members are that move."""
        if not self.arrays.module.POSES:
            return
        if self._poses.cover(self.runs, self._sizes.slots):
            self.beats.renew()
        self._poses.put(self.arrays.system)
        for run in self.runs:
            self.arrays.put("pose_of", run.slot, self._poses.of(run))
        self._poses.bring(self.runs, ())

    def _list_features(self, runs: Sequence[Run]) -> None:
        """List the features near the grains of members that were not stepped to where they are."""
        if runs and self.arrays.module.MESHES:
            self._flag(runs)
            self.beats.list_features()
            self.arrays.system.flag.zero_()

    def _flag(self, runs: Sequence[Run]) -> None:
        """Flag these members for a rebuild of their lists, and let kernels work on them alone."""
        flags = np.zeros(self._sizes.slots, np.int32)
        flags[[run.slot for run in runs]] = 1
        self.wake(runs)
        self.arrays.system.flag.assign(flags)

    def _counters(self) -> None:
        """Write steps, grains that left, and rebuilds of all members to the device."""
        system, n = self.arrays.system, self._sizes.slots
        step, left, rebuilds = (np.zeros(n, np.int64), np.zeros(n, np.int32), np.zeros(n, np.int32))
        for slot, run in self._seated.items():
            step[slot], left[slot] = run.step, run.left
            rebuilds[slot] = run.rebuilds
        system.step.assign(step)
        system.left.assign(left)
        system.rebuilds.assign(rebuilds)

    def _build_lists(self, runs: Sequence[Run]) -> None:
        """Build the lists of new members, in larger arrays if they overflow."""
        if runs and any(needed := self._lists(runs)):
            self._resize(room.grown(self._sizes, *needed))
            self._build_lists(runs)

    def _lists(self, runs: Sequence[Run]) -> tuple[int, int, int]:
        """Build the lists of members; return the needed sizes as `room.grown` takes them, 0 where lists fitted."""
        system = self.arrays.system
        before = wp.clone(system.rebuilds)
        self._flag(runs)
        system.any_flag.fill_(1)
        self.beats.rebuild()
        self.arrays.forget_rows()
        wp.copy(system.rebuilds, before)  # a start is not a rebuild
        near, depth, walls = fetch(system.overflow).reshape(-1, 3).max(axis=0).tolist()
        system.overflow.zero_()
        return near, depth, walls

    def _resize(self, sizes: Sizes, checkpoints: Mapping[Run, Checkpoint] = MappingProxyType({})) -> None:
        """Move all members to new arrays, in their states of `checkpoints`, else as they are. Raises MemoryError."""
        all_slots, stored = dict[str, np.ndarray](), dict[Run, Checkpoint]()
        if self.runs and not checkpoints and sizes.holds(self._sizes):
            all_slots = self._taken_up_as_a_whole()
        elif self.runs:
            with self.arrays.reading([run.slot for run in self.runs]):
                stored = {run: checkpoints.get(run) or self.stored(run) for run in self.runs}
        for run, checkpoint in stored.items():
            run.takes_up(checkpoint)
        spec = self._spec
        lanes = room.lanes(sizes, self.device, self._lanes)
        module = room.suitable(spec, sizes, self._uniform, lanes)
        self._arrays, self._beats = None, None  # freed before the new ones are allocated
        self._sizes = sizes
        self._arrays = Arrays(module, sizes, self.device, room.records_crossings(spec))
        self._beats = Beat(self._arrays, spec.steps_per_beat)
        with self._arrays.written_together([run.slot for run in self.runs]):
            self._parameters(self.runs)
            for run, checkpoint in stored.items():
                transfer.restore(self._arrays, run.slot, checkpoint)
        if all_slots:
            self._arrays.take_up(all_slots)
        self._counters()
        self._take_meshes(self.runs)
        self._has_changed()

    def _taken_up_as_a_whole(self) -> dict[str, np.ndarray]:
        """Return the state of all slots, and update the members' counters to it: rows without a grain stay."""
        rebuilds, extremes = fetch(self.arrays.system.rebuilds), self.extremes()
        for run in self.runs:
            run.rebuilds = int(rebuilds[run.slot])
            run.start_extremes = float(extremes[run.slot, 0]), float(extremes[run.slot, 1])
        return self.arrays.state_of_all()

    @contextmanager
    def within_memory(self) -> Iterator[None]:
        """Return a context that turns Warp's allocation errors into MemoryError."""
        members = len(self._seated) + len(self._waiting)
        try:
            yield
        except RuntimeError as error:
            if "allocate" not in str(error):
                raise
            raise MemoryError(
                f"{self.device.alias} has no memory for {members} members: {error}; use fewer grains"
            ) from error

    def close_up(self) -> None:
        """Close up rows of grains that have left, if that saves time. Raises MemoryError."""
        smaller = room.closed_up(self._sizes, self.runs)
        if smaller != self._sizes:
            self._resize(smaller)

    # beats

    def wake(self, runs: Iterable[Run]) -> None:
        """Let kernels work on these members only."""
        self.arrays.set_rows({run.slot: run.rows for run in runs})

    def show_all(self) -> None:
        """Let reading kernels work on all members; within a beat, on those that take it."""
        if not self._in_beat:
            self.wake(self.runs)

    def beat(self, runs: Sequence[Run], stops: Sequence[int] = (), look: Callable[[], None] = lambda: None) -> Report:
        """Take a beat with these members.

        Args:
            runs: members.
            stops: steps of the beat, ascending, after which `look` is called.
            look: reads members as they are then.

        Returns:
            The report of the beat.

        Raises:
            RuntimeError: the device failed.
        """
        self.wake(runs)
        if self.arrays.module.POSES:
            self._poses.bring(self.runs, runs)
        if stops:
            self._take_parts(runs, stops, look)
        else:
            self.beats.run(self._interval)
        self._has_changed()
        try:
            report = collect(self.arrays, self.beats.report)
        except RuntimeError as error:
            raise RuntimeError(
                f"{self.device.alias} has failed in a beat ({error}); if NVIDIA's Multi-Process Service was started "
                "meanwhile, start labbook again: steps that wait for one another need the device to themselves"
            ) from error
        if not all(slot.valid for slot in report.slots):
            self.arrays.forget_rows()
        return report

    def _take_parts(self, runs: Sequence[Run], stops: Sequence[int], look: Callable[[], None]) -> None:
        begun, done = {run: run.step for run in runs}, 0
        self.beats.begin()
        self._in_beat = True
        try:
            for stop in (*stops, self._spec.steps_per_beat):
                while done < stop:
                    steps = self.beats.run_some(done, stop, self._interval)
                    done += steps
                    for run in runs:
                        run.step += steps
                    self._send_steps()
                if stop < self._spec.steps_per_beat:
                    self._has_changed()
                    look()
        finally:
            self._in_beat = False
            for run, step in begun.items():
                run.step = step
        self.beats.end(0)

    def _send_steps(self) -> None:
        step = np.zeros(self._sizes.slots, np.int64)
        for slot, run in self._seated.items():
            step[slot] = run.step
        self.arrays.system.step.assign(step)

    def make_room(self, report: Report, runs: Sequence[Run]) -> None:
        """Enlarge the arrays for those of these members whose lists or cells overflowed.

        Raises:
            Overflow, MemoryError.
        """
        needed = report.needed(run.slot for run in runs)
        if any(needed):
            self._resize(room.grown(self._sizes, *needed))

    def check_more_often(self) -> None:
        """Halve the steps between two checks of displacements, down to one."""
        self._check(max(MIN_INTERVAL, 2 * (self._interval // 4)))

    def was_calm(self) -> None:
        """Count a beat without a late list; after CALM of them, double the steps between two checks."""
        self._beats_without_late += 1
        if self._beats_without_late >= CALM:
            self._check(min(2 * self._interval, usual_check(self.runs)))

    @contextmanager
    def checking_every_step(self) -> Iterator[None]:
        """Return a context in which displacements are checked at every step, so that no list is late."""
        every = self._interval
        self._check(MIN_INTERVAL)
        try:
            yield
        finally:
            self._check(every)

    def _check(self, every: int) -> None:
        self._interval, self._beats_without_late = every, 0

    def restore(self, run: Run) -> None:
        """Restore a member to the beginning of the beat."""
        self.arrays.restore(run.slot)
        step = fetch(self.arrays.system.step)
        step[run.slot] = run.step
        self.arrays.system.step.assign(step)
        if self.arrays.module.POSES:
            self._poses.bring(self.runs, ())
        self._list_features([run])
        self._has_changed(run)

    def bad_value(self, run: Run, grain: int) -> float:
        """Return the overlap [m] or speed [m/s] with which a grain failed."""
        rows = np.flatnonzero(self.arrays.read("ids", run.slot, run.rows) == grain)
        x = self.arrays.of_slot(run.slot, run.rows).states().x[rows]
        row = int(rows[np.argmax(x[:, 2])])  # other rows with its id are of when it left
        return float(fetch(self.arrays.system.bad, run.slot * self._sizes.cap + row, 1)[0])

    def extremes(self) -> np.ndarray:
        """Return largest overlap [m] and square of the largest speed so far, of all slots, shape [slots, 2]."""
        return np.stack([fetch(getattr(self.arrays.system, name)) for name in EXTREMES], axis=1).astype(np.float64)

    def stored(self, run: Run) -> Checkpoint:
        """Return the exact state of a member with a slot."""
        state, numbers = self.state_of(run)
        return Checkpoint(*self.maker, transfer.checkpoint(state, run.past_work) | numbers)

    @property
    def maker(self) -> tuple[str, int]:
        """Name and version of the backend, as in checkpoints."""
        return self._can.name, self._can.cache_version

    def state_of(self, run: Run) -> tuple[SlotState, dict[str, np.ndarray]]:
        """Return the arrays of a member with a slot, and the numbers of its checkpoint."""
        arrays, system = self.arrays, self.arrays.system
        run.rebuilds = int(arrays.fetched(system.rebuilds, run.slot, 1, 1)[0])
        numbers = {"step": np.array(run.step), "rebuilds": np.array(run.rebuilds)}
        extremes = [arrays.fetched(getattr(system, name), run.slot, 1, 1)[0] for name in EXTREMES]
        numbers["most"] = np.array(extremes, np.float64)
        return arrays.of_slot(run.slot, run.rows), numbers


def usual_check(runs: Sequence[Run]) -> int:
    """Steps between two checks as long as no list was late: the smallest interval of all members, an even number."""
    return min(check_interval(run.scene, run.numerics) for run in runs)


def check_interval(scene: Scene, numerics: Numerics) -> int:
    """Steps between two checks, even: a grain that falls through three diameters moves by a tenth of the skin."""
    d = scene.grains.diameter
    speed = math.sqrt(6 * scene.gravity * d) or d / (1000 * numerics.dt)
    if features.has_moving_parts(scene):  # parts too
        reach = mesh_reach(scene.grains.reach, features.mesh_moves(scene, numerics))
        speed = max(speed, features.part_speed(scene, reach))
    steps = int(0.1 * numerics.skin * d / (speed * numerics.dt))
    return max(MIN_INTERVAL, min(MAX_INTERVAL, 2 * (steps // 2)))
