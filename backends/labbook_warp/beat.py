"""A beat: many steps with their checks and rebuilds, captured once as a graph and launched as one."""

from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp
from labbook_dem.traction import SUMS

from labbook.backend.probes import SLIDING
from labbook_warp import compiling
from labbook_warp.arrays import Arrays, fetch
from labbook_warp.devices import shared_with_others
from labbook_warp.dialect import THREADS
from labbook_warp.kernels.words import REPORTED

_GROUPS = 2  # of members whose steps are launched side by side; three or four are no faster
_MIN_ADDERS, _MAX_ADDED = 64, 1024
"""Least number of threads a member that add up energies, and largest number of energies a thread adds up."""


class Beat:
    """Launches of kernels over one set of arrays.

    Args:
        arrays: arrays of an ensemble.
        steps: steps of a beat.
    """

    def __init__(self, arrays: Arrays, steps: int):
        self.arrays, self.steps = arrays, steps
        self.kernels, self.device, self.lanes = arrays.module, arrays.device, arrays.module.LANES
        sizes = arrays.sizes
        self._rows, self._cells, self._slots = sizes.rows, sizes.slots * sizes.cells, sizes.slots
        self._apart = self.kernels.APART
        self.report = wp.zeros(1 + REPORTED * self._slots, dtype=wp.int64, device=self.device)
        """Events of the last beat on the device; see `labbook_warp.report`."""
        self._arrived = wp.zeros(1, dtype=wp.uint32, device=self.device)
        compiling.wait_for(self.kernels)
        all_resident = self.all_resident()
        # programs take turns on a GPU, each with all of it, unless they share it through the Multi-Process Service
        self._several = all_resident and self.kernels.SHARED and not self.kernels.POSES and not shared_with_others()
        groups = _GROUPS if self.device.is_cuda and self._slots > 1 and not all_resident else 0
        self._streams = [wp.Stream(self.device) for _ in range(groups)]
        self._graphs: dict[tuple[int, ...], Any] = {}
        """Graphs of beats, by interval of checks; of parts, also by steps until the first check and number of steps."""
        self._whole_step_arrays: Any = None

    def renew(self) -> None:
        """Drop captured graphs: they contain the material that all members share as a constant."""
        self._graphs = {}

    def all_resident(self) -> bool:
        """True if all threads of a step are resident on the device at once, given an idle device."""
        if not self.device.is_cuda:
            return False
        size, blocks = wp.get_suggested_block_size(self.kernels.step, self.device)
        return self._rows * self.lanes <= size * blocks

    def _launch(self, kernel: Any, dim: int, *inputs: Any) -> None:
        wp.launch(kernel, dim, [self.arrays.system, *inputs], device=self.device, block_dim=THREADS)

    def run(self, every: int) -> None:
        """Take the beat's steps with every member whose `rows` is not zero; check displacements every `every` steps."""
        self._run_captured((every,), lambda: self._beat_launches(every))

    def _beat_launches(self, every: int) -> None:
        """Launch a whole beat, with a check of displacements every `every` steps."""
        self.begin()
        done = 0
        while done < self.steps:
            some = min(every, self.steps - done)
            self._check_displacements(some)
            self._take_steps(done, some)
            done += some
        self.end(self.steps)

    def begin(self) -> None:
        """Back up the state and list the rows near walls."""
        self.arrays.back_up()
        self._list_rows_near_walls()

    def end(self, steps: int) -> None:
        """End a beat and add `steps` to the step counters."""
        self._launch(self.kernels.finish_beat, self._slots, steps, self.report)

    def run_some(self, first: int, stop: int, every: int) -> int:
        """Take some steps of a beat from step `first` on, up to `stop` at most, without counting them.

        Displacements are checked at the same steps as in `run`. The number of steps is a power of two, of steps or
        of intervals between checks, so that few graphs serve stops at any step.

        Returns:
            The number of steps taken.
        """
        until_check = min(every, self.steps - first) if first % every == 0 else 0
        intervals = (stop - first) // every if until_check == every else 0
        if intervals:
            steps = every * _power_of_two(intervals)
        else:
            steps = _power_of_two(min(stop - first, every - first % every))
        self._run_captured((every, until_check, steps), lambda: self._some_launches(until_check, steps, every))
        return steps

    def _some_launches(self, ahead: int, steps: int, every: int) -> None:
        """Launch a part of a beat; ahead: steps to the next check, 0 without a check at its start."""
        for first in range(0, steps, every):
            if ahead:
                self._check_displacements(ahead)
            self._take_steps(first, min(every, steps - first))

    def _run_captured(self, key: tuple[int, ...], launches: Callable[[], None]) -> None:
        """Carry out `launches`; on a GPU as one graph, captured at its first use."""
        if not self.device.is_cuda:
            launches()
            return
        if key not in self._graphs:
            # Loaded before: a module that is loaded during a capture ends it, since that allocates memory.
            wp.load_module(self.kernels, device=self.device, block_dim=THREADS)
            with wp.ScopedCapture(device=self.device, force_module_load=False) as capture:
                launches()
            self._graphs[key] = capture.graph
        wp.capture_launch(self._graphs[key])

    def _check_displacements(self, ahead: int) -> None:
        """Rebuild the lists that may become too old within the next `ahead` steps."""
        self._launch(self.kernels.check_displacements, self._rows, self.arrays.p, ahead)
        self._if_flagged(self.rebuild)

    def _take_steps(self, first: int, some: int) -> None:
        """Take `some` steps; the state ends in `arrays.p`, by a copy if their number is odd."""
        self._move(first, some)
        if some % 2:
            self._launch(self.kernels.copy_states, self._rows, self.arrays.q, self.arrays.p)

    def _move(self, first: int, some: int) -> None:
        """Take `some` steps from `first` on, with all members or with two groups of them on two streams.

        While the last blocks of one group's step finish, those of the other keep the device busy.
        """
        if not self._streams:
            self._launch_steps(first, some, 0, self._slots)
            return
        main = self.device.stream
        # Both streams begin after what was launched before, and the main one goes on after both. Events order them on
        # the device, in a captured graph too.
        begin = main.record_event()
        for k, stream in enumerate(self._streams):
            slot, end = (n * self._slots // len(self._streams) for n in (k, k + 1))
            stream.wait_event(begin)
            with wp.ScopedStream(stream, sync_enter=False):
                self._launch_steps(first, some, slot, end - slot)
            main.wait_event(stream.record_event())

    def _launch_steps(self, first: int, some: int, slot: int, slots: int) -> None:
        """Take these steps with the members in `slots` slots from `slot` on."""
        here, there = self.arrays.p, self.arrays.q
        # Several steps in one launch need all of its threads on the device at once: then they wait for each other.
        steps_per_launch = some if self._several else 1
        threads = slots * self.arrays.sizes.cap * self.lanes
        for sub in range(first, first + some, steps_per_launch):
            self._meet_walls(here, True, slot, slots)
            self._launch(self.kernels.step, threads, here, there, slot, sub, steps_per_launch, self._arrived)
            if self.kernels.POSES:
                self._launch(self.kernels.tick, slots, slot)
            here, there = there, here

    def _if_flagged(self, launch: Callable[[], None]) -> None:
        flag = self.arrays.system.any_flag
        if self.device.is_cuda:
            # A conditional node of the graph: the device reads the flag, and the host need not wait for it.
            wp.capture_if(flag, on_true=launch)
        elif flag.numpy()[0]:
            launch()

    def rebuild(self) -> None:
        """Rebuild the lists of all flagged members."""
        k = self.kernels
        self._launch(k.clear_cells, self._cells)
        self._launch(k.fill_cells, self._rows, self.arrays.p)
        if self.lanes > 1:
            self._launch(k.collect_shared, self._rows * self.lanes, self.arrays.p)
        self._launch(k.build_lists, self._rows, self.arrays.p)
        if k.MESHES:
            self.list_features()
        self._launch(k.finish_rebuild, self._slots)
        self._list_rows_near_walls()

    def list_features(self) -> None:
        """List the features of meshes near the grains of all flagged members."""
        self._launch(self.kernels.list_features, self._rows)

    def _list_rows_near_walls(self) -> None:
        if self._apart:
            self.arrays.system.beside_count.zero_()
            self._launch(self.kernels.list_rows_near_walls, self._rows)

    def _meet_walls(self, state: Any, keep: bool, slot: int, slots: int) -> None:
        if self._apart:
            # rows near edges and the others are rounded up to 32 each
            self._launch(self.kernels.meet_walls, slots * (self.arrays.sizes.cap + 32), state, slot, slots, keep)

    def whole_step(self) -> tuple[Any, Any]:
        """Return velocities [m/s] and reduced angular momenta [rad/s] at the whole step, on the device.

        The state does not change. The next call writes into the same arrays.
        """
        if self._whole_step_arrays is None:
            double3 = self.kernels.wide3
            self._whole_step_arrays = [wp.zeros(self._rows, dtype=double3, device=self.device) for _ in range(2)]
        self._list_rows_near_walls()
        self._meet_walls(self.arrays.p, False, 0, self._slots)
        self._launch(self.kernels.whole_step, self._rows * self.lanes, self.arrays.p, *self._whole_step_arrays)
        return self._whole_step_arrays[0], self._whole_step_arrays[1]

    def kinetic(self, v: Any, w: Any):
        """Return the kinetic energy [J] of every slot, shape [slots]. v, w: from `whole_step`."""
        adders = max(_MIN_ADDERS, self.arrays.sizes.cap // _MAX_ADDED)
        out = wp.zeros(2 * self._slots * adders, dtype=wp.float64, device=self.device)
        self._launch(self.kernels.kinetic, self._slots * adders, self.arrays.p, v, w, adders, out)
        return fetch(out).reshape(self._slots, adders, 2).sum(axis=1).sum(axis=1)

    def contacts(self) -> np.ndarray:
        """Return rows slot, i, j, wall, force, branch of all touching contacts, in any order."""
        return self._collect_rows(self.kernels.contacts, 10, self.arrays.sizes.contacts)

    def slab(self, v: Any, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Return rows slot, id, position, velocity of the grains in a slab, in any order.

        Args:
            v: velocities of `whole_step`.
            low: lower height [m] by slot, shape [slots].
            high: upper height [m] by slot.
        """
        heights = (wp.array(bound, dtype=wp.float64, device=self.device) for bound in (low, high))
        return self._collect_rows(self.kernels.slab, 8, self._rows, v, *heights)

    def wall_sums(self, bins: np.ndarray, units: np.ndarray, total: int) -> np.ndarray:
        """Return sums over contacts with walls, integers of shape [total, SUMS]; see `kernels.traction`."""
        numbers = (wp.array(array.ravel(), dtype=wp.float64, device=self.device) for array in (bins, units))
        sums = wp.zeros(SUMS * total, dtype=wp.int64, device=self.device)
        self._launch(self.kernels.wall_sums, self._rows, self.arrays.p, *numbers, SLIDING, sums)
        return fetch(sums).reshape(total, SUMS)

    def _collect_rows(self, kernel: Any, width: int, capacity: int, *inputs: Any) -> np.ndarray:
        """Return the rows of `width` numbers, at most `capacity`, that a kernel appends by an atomic counter."""
        counter = wp.zeros(1, dtype=wp.int32, device=self.device)
        out = wp.zeros(width * capacity, dtype=wp.float64, device=self.device)
        self._launch(kernel, self._rows, self.arrays.p, *inputs, counter, out)
        # Only appended rows come to the host: the array has room for the largest number.
        count = int(fetch(counter)[0])
        return fetch(out, 0, width * count).reshape(-1, width)


def _power_of_two(limit: int) -> int:
    """Largest power of two up to `limit`."""
    return 1 << limit.bit_length() - 1
