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
_ADDERS, _ADDED = 64, 1024
"""Threads a member that add up energies, at least, and energies that a thread adds up, at most."""


class Beat:
    """All launches over one set of arrays."""

    def __init__(self, arrays: Arrays, steps: int):
        self.arrays, self.steps = arrays, steps
        self.kernels, self.device, self.lanes = arrays.module, arrays.device, arrays.module.LANES
        sizes = arrays.sizes
        self._rows, self._cells, self._slots = sizes.rows, sizes.slots * sizes.cells, sizes.slots
        self._apart = self.kernels.APART
        self.told = wp.zeros(1 + REPORTED * self._slots, dtype=wp.int64, device=self.device)
        """What the last beat left behind; see `labbook_warp.report`."""
        self._arrived = wp.zeros(1, dtype=wp.uint32, device=self.device)
        compiling.wait_for(self.kernels)
        fit = self.fit_at_once()
        # programs take turns on a GPU, each with all of it, unless they share it through the Multi-Process Service
        self._several = fit and self.kernels.SHARED and not self.kernels.POSES and not shared_with_others()
        groups = _GROUPS if self.device.is_cuda and self._slots > 1 and not fit else 0
        self._streams = [wp.Stream(self.device) for _ in range(groups)]
        self._graphs: dict[tuple[int, ...], Any] = {}
        """Of a beat by how often displacements are checked; of its parts also by their first check and their steps."""
        self._looked: Any = None

    def renew(self) -> None:
        """Forget captured graphs: they hold the material that all members share as it was."""
        self._graphs = {}

    def fit_at_once(self) -> bool:
        """Whether all threads of a step are on the device at the same time, if nothing else runs meanwhile."""
        if not self.device.is_cuda:
            return False
        size, blocks = wp.get_suggested_block_size(self.kernels.step, self.device)
        return self._rows * self.lanes <= size * blocks

    def _launch(self, kernel: Any, dim: int, *inputs: Any) -> None:
        wp.launch(kernel, dim, [self.arrays.system, *inputs], device=self.device, block_dim=THREADS)

    def run(self, every: int) -> None:
        """Take the beat's steps with every member whose `rows` are not zero. Displacements are checked `every` so many
        steps."""
        self._captured((every,), lambda: self._whole(every))

    def _whole(self, every: int) -> None:
        self.begin()
        done = 0
        while done < self.steps:
            some = min(every, self.steps - done)
            self._check(some)
            self._take_some(done, some)
            done += some
        self.end(self.steps)

    def begin(self) -> None:
        """Begin a beat."""
        self.arrays.back_up()
        self._line_up()

    def end(self, steps: int) -> None:
        """End a beat, and count these steps."""
        self._launch(self.kernels.end, self._slots, steps, self.told)

    def part(self, done: int, stop: int, every: int) -> int:
        """Take some steps of a beat from `done` on, up to `stop` at most; how many. They are not counted yet.

        Displacements are checked after the same steps as in `run`. Some are 1, 2, 4, 8, ... steps, or intervals between
        checks: so few graphs do for stops after any steps.
        """
        ahead = min(every, self.steps - done) if done % every == 0 else 0
        many = (stop - done) // every if ahead == every else 0
        steps = every * _power_of_two(many) if many else _power_of_two(min(stop - done, every - done % every))
        self._captured((every, ahead, steps), lambda: self._piece(ahead, steps, every))
        return steps

    def _piece(self, ahead: int, steps: int, every: int) -> None:
        for first in range(0, steps, every):
            if ahead:
                self._check(ahead)
            self._take_some(first, min(every, steps - first))

    def _captured(self, key: tuple[int, ...], launches: Callable[[], None]) -> None:
        """What these `launches` do, on a GPU as one graph."""
        if not self.device.is_cuda:
            launches()
            return
        if key not in self._graphs:
            wp.load_module(self.kernels, device=self.device, block_dim=THREADS)
            with wp.ScopedCapture(device=self.device, force_module_load=False) as capture:
                launches()
            self._graphs[key] = capture.graph
        wp.capture_launch(self._graphs[key])

    def _check(self, ahead: int) -> None:
        """Rebuild the lists that may not do for so many steps more."""
        self._launch(self.kernels.check, self._rows, self.arrays.p, ahead)
        self._if_asked(self.rebuild)

    def _take_some(self, first: int, some: int) -> None:
        self._move(first, some)
        if some % 2:
            self._launch(self.kernels.bring, self._rows, self.arrays.q, self.arrays.p)

    def _move(self, first: int, some: int) -> None:
        """Take `some` steps from `first` on: with all members, or with two groups of them side by side. As the last
        blocks of one group's step end, there is still work of the other's."""
        if not self._streams:
            self._take(first, some, 0, self._slots)
            return
        main = self.device.stream
        begin = main.record_event()
        for k, stream in enumerate(self._streams):
            slot, end = (n * self._slots // len(self._streams) for n in (k, k + 1))
            stream.wait_event(begin)
            with wp.ScopedStream(stream, sync_enter=False):
                self._take(first, some, slot, end - slot)
            main.wait_event(stream.record_event())

    def _take(self, first: int, some: int, slot: int, slots: int) -> None:
        """Take these steps with the members in `slots` slots from `slot` on."""
        here, there = self.arrays.p, self.arrays.q
        at_once = some if self._several else 1
        threads = slots * self.arrays.sizes.cap * self.lanes
        for sub in range(first, first + some, at_once):
            self._meet_walls(here, True, slot, slots)
            self._launch(self.kernels.step, threads, here, there, slot, sub, at_once, self._arrived)
            if self.kernels.POSES:
                self._launch(self.kernels.tick, slots, slot)
            here, there = there, here

    def _if_asked(self, what: Callable[[], None]) -> None:
        asked = self.arrays.system.any_flag
        if self.device.is_cuda:
            wp.capture_if(asked, on_true=what)
        elif asked.numpy()[0]:
            what()

    def rebuild(self) -> None:
        """Rebuild the lists of all members whose flag is set."""
        k = self.kernels
        self._launch(k.clear, self._cells)
        self._launch(k.fill, self._rows, self.arrays.p)
        if self.lanes > 1:
            self._launch(k.gather, self._rows * self.lanes, self.arrays.p)
        self._launch(k.build, self._rows, self.arrays.p)
        if k.MESHES:
            self.list_features()
        self._launch(k.finish, self._slots)
        self._line_up()

    def list_features(self) -> None:
        """List the features of meshes that are near the grains of all members whose flag is set."""
        self._launch(self.kernels.list_features, self._rows)

    def _line_up(self) -> None:
        if self._apart:
            self.arrays.system.beside_count.zero_()
            self._launch(self.kernels.line_up, self._rows)

    def _meet_walls(self, state: Any, keep: bool, slot: int, slots: int) -> None:
        if self._apart:
            # those by edges and the others are rounded up to 32 each
            self._launch(self.kernels.meet_walls, slots * (self.arrays.sizes.cap + 32), state, slot, slots, keep)

    def look(self) -> tuple[Any, Any]:
        """Velocities and reduced angular momenta at the whole step, on the device; changes nothing."""
        if self._looked is None:
            double3 = self.kernels.wide3
            self._looked = [wp.zeros(self._rows, dtype=double3, device=self.device) for _ in range(2)]
        self._line_up()
        self._meet_walls(self.arrays.p, False, 0, self._slots)
        self._launch(self.kernels.look, self._rows * self.lanes, self.arrays.p, *self._looked)
        return self._looked[0], self._looked[1]

    def kinetic(self, v: Any, w: Any):
        """Kinetic energy [J] of every slot from what `look` gave, shape [slots]."""
        adders = max(_ADDERS, self.arrays.sizes.cap // _ADDED)
        out = wp.zeros(2 * self._slots * adders, dtype=wp.float64, device=self.device)
        self._launch(self.kernels.kinetic, self._slots * adders, self.arrays.p, v, w, adders, out)
        return fetch(out).reshape(self._slots, adders, 2).sum(axis=1).sum(axis=1)

    def contacts(self) -> np.ndarray:
        """Rows slot, i, j, wall, force, branch of all touching contacts, in any order."""
        return self._collected(self.kernels.contacts, 10, self.arrays.sizes.contacts)

    def layer(self, v: Any, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Rows slot, id, position, velocity of the grains between the heights `low` and `high` [m] of their slots, in
        any order. v: what `look` gave; low, high: shape [slots]."""
        heights = (wp.array(bound, dtype=wp.float64, device=self.device) for bound in (low, high))
        return self._collected(self.kernels.layer, 8, self._rows, v, *heights)

    def wall_sums(self, bins: np.ndarray, units: np.ndarray, total: int) -> np.ndarray:
        """Sums over contacts with walls, whole numbers of shape [total, SUMS]; see `kernels.traction`."""
        numbers = (wp.array(array.ravel(), dtype=wp.float64, device=self.device) for array in (bins, units))
        sums = wp.zeros(SUMS * total, dtype=wp.int64, device=self.device)
        self._launch(self.kernels.wall_sums, self._rows, self.arrays.p, *numbers, SLIDING, sums)
        return fetch(sums).reshape(total, SUMS)

    def _collected(self, kernel: Any, width: int, most: int, *inputs: Any) -> np.ndarray:
        """The rows of `width` numbers, at most so many, that a kernel writes wherever there is room."""
        counter = wp.zeros(1, dtype=wp.int32, device=self.device)
        out = wp.zeros(width * most, dtype=wp.float64, device=self.device)
        self._launch(kernel, self._rows, self.arrays.p, *inputs, counter, out)
        found = int(fetch(counter)[0])
        return fetch(out, 0, width * found).reshape(-1, width)


def _power_of_two(most: int) -> int:
    """The largest power of two that is not more."""
    return 1 << most.bit_length() - 1
