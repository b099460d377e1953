"""The slots of an ensemble: seating members, making room, taking beats, and reading what stands there."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import warp as wp
from labbook_dem import features

from labbook.backend import Capabilities, Checkpoint, Overflow, Spec, Status
from labbook.protocol.packing import Packing
from labbook_warp import transfer
from labbook_warp.arrays import STATE, Arrays, Sizes, fetch
from labbook_warp.beat import Beat
from labbook_warp.build import SWITCHES, kernels
from labbook_warp.kernels.words import NO_FAILURE
from labbook_warp.parameters import cell_size, lattice, material, place, same_material
from labbook_warp.run import Run
from labbook_warp.specialise import LONGEST_CHECK, OFTENEST, check_interval

NEAR, DEPTH = 16, 8  # first guesses of neighbours a grain and grains a cell; both grow when they are too few
MOST_NEAR = 32  # bits of a mask
SATURATED = 80_000  # threads that fill a large GPU
MOST_LANES = 8
REGISTERS = {"mixed": 80, "double": 128}
"""A thread of the step, where grains are many; where they are few, as many as the compiler likes."""


@dataclass(frozen=True)
class Tuning:
    """How kernels are launched; decides no bit of a result."""

    lanes: int = 0
    """Threads a grain, a power of two; 0: as many as keep the device busy."""
    registers: int = 0
    """Registers a thread of the step may use; 0: the best that was measured."""
    block: int = 128


@dataclass(frozen=True)
class Said:
    """What a beat left behind in a slot."""

    fail: int
    late: bool
    near: int
    depth: int
    left: int

    @property
    def crowded(self) -> bool:
        """Whether lists or cells were too short."""
        return self.near > 0 or self.depth > 0


@dataclass(frozen=True)
class Report:
    """What a beat left behind. crossings: rows slot, id, step, time, x, y, z, vx, ..., wz."""

    slots: Sequence[Said]
    crossings: np.ndarray

    def __getitem__(self, slot: int) -> Said:
        return self.slots[slot]


class Stage:
    """See above. `slots`: how many to make at least."""

    def __init__(self, can: Capabilities, spec: Spec, device: wp.Device, slots: int, crossings: bool, tuning: Tuning):
        self._can, self._spec, self.device, self._crossings, self._tuning = can, spec, device, crossings, tuning
        self._sizes = Sizes(slots, 0, NEAR, 0, 0, DEPTH)
        self._seated: dict[int, Run] = {}
        self._waiting: list[Run] = []
        self._every, self._uniform = LONGEST_CHECK, True
        self._arrays: Arrays | None = None
        self._beat: Beat | None = None
        self._energies: np.ndarray | None = None

    @property
    def arrays(self) -> Arrays:
        """The arrays, once someone is seated."""
        assert self._arrays is not None
        return self._arrays

    # who is there

    def check(self, stored: Checkpoint) -> None:
        """Raises ValueError if a checkpoint is not of this engine, version and precision."""
        if (stored.engine, stored.cache_version) != (self._can.name, self._can.cache_version):
            raise ValueError(
                f"the checkpoint is of {stored.engine} version {stored.cache_version}, "
                f"not of {self._can.name} version {self._can.cache_version}"
            )
        missing = {"p", *STATE, "step", "rebuilds", "past_work"} ^ set(stored.arrays)
        if missing:
            raise ValueError(f"the checkpoint has other arrays than this engine's state: {', '.join(sorted(missing))}")

    def wait(self, run: Run) -> None:
        """Let a member wait for its slot."""
        self._waiting.append(run)

    def leave(self, run: Run) -> None:
        """Free a member's slot."""
        if run in self._waiting:
            self._waiting.remove(run)
        self._seated.pop(run.slot, None)

    def close(self) -> None:
        """Free the device's memory."""
        self._seated.clear()
        self._arrays = self._beat = self._energies = None

    def seat(self) -> None:
        """Give every waiting member a slot, in larger arrays if need be."""
        new, self._waiting = self._waiting, []
        if not new:
            return
        starts = {run: self._positions(run) for run in new}
        lattices = {run: lattice(x, cell_size(run.scene, run.numerics)) for run, x in starts.items()}
        needed = replace(
            self._sizes,
            slots=max(self._sizes.slots, len(self._seated) + len(new)),
            cap=max(self._sizes.cap, *(-(-run.rows // 32) * 32 for run in new), 32),
            walls=max(self._sizes.walls, *(len(run.names) for run in new)),
            cells=max(self._sizes.cells, *(int(np.prod(cells)) for cells in lattices.values())),
        )
        every = min(self._every, *(check_interval(run.scene, run.numerics) for run in new), LONGEST_CHECK)
        uniform = same_material((run.scene, run.numerics) for run in (*self._seated.values(), *new))
        if self._arrays is None or (needed, uniform) != (self._sizes, self._uniform):
            self._every, self._uniform = every, uniform
            self._resize(needed)
        elif every != self._every:
            self._every = every
            self._new_beat()
        elif uniform:
            self._new_beat()  # a captured graph holds the material that all share, and new members may bring another
        free = iter(slot for slot in range(needed.slots) if slot not in self._seated)
        fresh = []
        for run in new:
            run.slot = next(free)
            self._seated[run.slot] = run
            self._parameters(run, lattices[run])
            if isinstance(run.begin, Packing):
                plane, _ = features.planes(run.scene, run.probes)
                transfer.start(self.arrays, run.slot, run.begin, plane, cell_size(run.scene, run.numerics))
                fresh.append(run)
            else:
                assert run.begin is not None
                transfer.restore(self.arrays, run.slot, run.begin)
        self._counters()
        self._build_lists(fresh)
        for run in fresh:
            assert isinstance(run.begin, Packing)
            if self._spec.feature("FRICTION"):
                cell = cell_size(run.scene, run.numerics)
                transfer.set_springs(self.arrays, run.slot, run.begin, run.names, cell)
        for run in new:
            run.begin = None
        self._stale()

    @staticmethod
    def _positions(run: Run) -> np.ndarray:
        if isinstance(run.begin, Packing):
            return run.begin.x
        assert run.begin is not None
        return run.begin.arrays["origin"]

    def _parameters(self, run: Run, cells: Sequence[int]) -> None:
        arrays = self.arrays
        record = material(arrays.module, run.scene, run.numerics)
        arrays.system.common = record
        arrays.put_record("material", run.slot, record)
        arrays.put_record("place", run.slot, place(arrays.module, run.scene, run.numerics, run.probes, cells))
        run.lattice = tuple(cells)
        if run.names:
            tables = features.wall_tables(run.scene, run.numerics)
            for name, table in zip(("wall_c", "wall_shape", "wall_kind", "wall_motion"), tables, strict=True):
                arrays.put(name, run.slot, table)

    def _counters(self) -> None:
        """Bring the arrays of slots in line with what is known of the members."""
        system, n = self.arrays.system, self._sizes.slots
        step, left, rebuilds = (np.zeros(n, np.int64), np.zeros(n, np.int32), np.zeros(n, np.int32))
        for slot, run in self._seated.items():
            step[slot], left[slot] = run.step, run.left
            rebuilds[slot] = run.rebuilds
        system.step.assign(step)
        system.left.assign(left)
        system.rebuilds.assign(rebuilds)

    def _build_lists(self, runs: Sequence[Run]) -> None:
        """Build the lists of members that have none, in larger arrays if they are crowded."""
        if not runs:
            return
        flags = np.zeros(self._sizes.slots, np.int32)
        flags[[run.slot for run in runs]] = 1
        before = fetch(self.arrays.system.rebuilds)
        self._set_rows(runs)
        self.arrays.system.flag.assign(flags)
        self.arrays.system.any_flag.fill_(1)
        assert self._beat is not None
        self._beat.rebuild()
        crowded = fetch(self.arrays.system.overflow).reshape(-1, 2)
        self.arrays.system.overflow.zero_()
        self.arrays.system.rebuilds.assign(before)  # a start is not a rebuild
        if crowded.any():
            self._grow(int(crowded[:, 0].max()), int(crowded[:, 1].max()))
            self._build_lists(runs)

    # room

    def _resize(self, sizes: Sizes) -> None:
        stored = {slot: self._checkpoint(run) for slot, run in self._seated.items()}
        for slot, run in self._seated.items():
            run.takes_up(stored[slot])
        features_of = self._spec.feature
        lanes = self._lanes(sizes)
        registers = self._tuning.registers or (0 if lanes > 1 else REGISTERS[features_of("precision")])
        switches = tuple((name, bool(features_of(name))) for name in SWITCHES)
        module = kernels(features_of("law"), features_of("precision"), switches, self._uniform, lanes, registers)
        self._arrays, self._beat = None, None  # freed before more is asked for
        self._sizes = sizes
        self._arrays = Arrays(module, features_of("precision"), sizes, self.device, self._crossings)
        self._new_beat()
        for slot, checkpoint in stored.items():
            run = self._seated[slot]
            self._parameters(run, run.lattice)
            transfer.restore(self._arrays, slot, checkpoint)
        self._counters()
        self._stale()

    def _new_beat(self) -> None:
        lanes, steps = self.arrays.module.LANES, self._spec.steps_per_beat
        self._beat = Beat(self.arrays, lanes, steps, self._every, self._tuning.block)

    def check_oftener(self) -> None:
        """Halve the steps between two checks of displacements, down to one."""
        self._every = max(OFTENEST, 2 * (self._every // 4))
        self._new_beat()

    def _lanes(self, sizes: Sizes) -> int:
        """Threads a grain: as many as keep the device busy, a power of two. They decide no bit of a result."""
        if not self.device.is_cuda:
            return 1
        if self._tuning.lanes:
            return self._tuning.lanes
        wanted = min(MOST_LANES, max(1, SATURATED // max(1, sizes.slots * sizes.cap)))
        return 1 << (wanted.bit_length() - 1)

    def _grow(self, near: int, depth: int) -> None:
        if near > MOST_NEAR:
            raise Overflow(f"a grain has {near} near neighbours, more than {MOST_NEAR}; use a thinner numerics.skin")
        wider = min(MOST_NEAR, near + 4) if near else self._sizes.near
        self._resize(replace(self._sizes, near=wider, depth=max(self._sizes.depth, depth + 4 if depth else 0)))

    def make_room(self, report: Report, runs: Iterable[Run]) -> None:
        """Make arrays large enough for members that were crowded."""
        said = [report[run.slot] for run in runs]
        if any(one.crowded for one in said):
            self._grow(max(one.near for one in said), max(one.depth for one in said))

    # a beat

    def beat(self, runs: Sequence[Run]) -> Report:
        """Let these members take a beat."""
        assert self._beat is not None
        system, n = self.arrays.system, self._sizes.slots
        self._set_rows(runs)
        self._beat.run()
        self._stale()
        fail, late, left = fetch(system.fail), fetch(system.late), fetch(system.left)
        crowded = fetch(system.overflow).reshape(n, 2)
        crossed = int(fetch(system.crossed)[0])
        rows = fetch(system.cross[: 13 * crossed]).reshape(-1, 13) if crossed else np.zeros((0, 13))
        system.late.zero_()
        system.overflow.zero_()
        system.crossed.zero_()
        system.fail.fill_(NO_FAILURE)
        slots = [
            Said(int(fail[s]), bool(late[s]), int(crowded[s, 0]), int(crowded[s, 1]), int(left[s])) for s in range(n)
        ]
        return Report(slots, rows[np.lexsort((rows[:, 1], rows[:, 2]))])

    def _set_rows(self, runs: Iterable[Run]) -> None:
        rows = np.zeros(self._sizes.slots, np.int32)
        for run in runs:
            rows[run.slot] = run.rows
        self.arrays.system.rows.assign(rows)

    def restore(self, run: Run) -> None:
        """Put a member back to the beginning of the beat."""
        self.arrays.restore(run.slot)
        step = fetch(self.arrays.system.step)
        step[run.slot] = run.step
        self.arrays.system.step.assign(step)
        self._stale()

    def bad_value(self, run: Run, grain: int) -> float:
        """Overlap [m] or speed [m/s] with which a grain failed a guard."""
        row = int(np.flatnonzero(self.arrays.read("ids", run.slot, run.rows) == grain)[0])
        return float(fetch(self.arrays.system.bad)[run.slot * self._sizes.cap + row])

    # reading

    @property
    def runs(self) -> Sequence[Run]:
        """Members that have a slot."""
        return tuple(self._seated.values())

    def _stale(self) -> None:
        self._energies = None

    def _look(self) -> None:
        if self._energies is None:
            assert self._beat is not None
            self._set_rows(self._seated.values())
            v, w = self._beat.look()
            self._energies = self._beat.kinetic(v, w)
            self._looked = v, w

    def whole_step(self, run: Run) -> tuple[np.ndarray, np.ndarray]:
        """Velocities [m/s] and spins [rad/s] of a member at the whole step, by row."""
        self._look()
        first = run.slot * self._sizes.cap
        v, w = (fetch(array[first : first + run.rows]) for array in self._looked)
        return v, w

    def deepest(self, run: Run) -> float:
        """The largest overlap [m] of a member at the last step."""
        return float(np.max(self.arrays.read("deep", run.slot, run.rows), initial=0.0))

    def contacts(self, run: Run) -> np.ndarray:
        """Rows i, j, wall, force, branch of a member's touching contacts, in the order of i, j, wall."""
        assert self._beat is not None
        self._set_rows(self._seated.values())
        rows = self._beat.contacts()
        rows = rows[rows[:, 0] == run.slot, 1:]
        return rows[np.lexsort((rows[:, 2], rows[:, 1], rows[:, 0]))]

    def status(self, run: Run) -> Status:
        """Where a member stands."""
        if run in self._waiting and isinstance(run.begin, Packing):
            return run.status(run.first_energy())
        self.seat()
        self._look()
        assert self._energies is not None
        return run.status(float(self._energies[run.slot]))

    def packing(self, run: Run) -> Packing:
        """The portable state of a member."""
        self.seat()
        v, w = self.whole_step(run)
        return transfer.packing(self.arrays, run.slot, run.rows, run.names, v, w)

    def checkpoint(self, run: Run) -> Checkpoint:
        """The exact state of a member."""
        self.seat()
        return self._checkpoint(run)

    def _checkpoint(self, run: Run) -> Checkpoint:
        run.rebuilds = int(fetch(self.arrays.system.rebuilds)[run.slot])
        numbers = {"step": np.array(run.step), "rebuilds": np.array(run.rebuilds)}
        state = transfer.checkpoint(self.arrays, run.slot, run.rows, run.past_work)
        return Checkpoint(self._can.name, self._can.cache_version, state | numbers)
