"""Reading members: states, energies, contacts. What is costly is read for all members at once."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from labbook_dem.reading import Readable
from labbook_dem.traction import WALL_COLUMNS

from labbook.backend import Checkpoint
from labbook.backend.probes import Slab, Traction
from labbook.scene.packing import Packing
from labbook_warp import transfer
from labbook_warp.ended import SlotEnd
from labbook_warp.run import Run
from labbook_warp.stage import Stage


class DeviceView:
    """See above. Reading changes nothing, but members that wait for their slots get them.

    What was read stands until its member changes: where grains are put back into a thousand members, one after another,
    each would else be read a thousand times.
    """

    def __init__(self, stage: Stage):
        self.stage = stage
        self._at = -1  # the stage's `changes` at which velocities and energies were read
        self._velocities: tuple[Any, Any] | None = None
        self._energies = np.zeros(0)
        self._extremes = np.zeros((0, 2))
        self._touched_at = -1  # the same, of contacts
        self._touching: dict[int, np.ndarray] = {}
        self._sums: dict[Traction, tuple[int, dict[int, np.ndarray]]] = {}
        """The same, and sums over contacts with walls by slot."""
        self._layers: dict[int, tuple[int, dict[int, np.ndarray]]] = {}
        """The same, and rows by slot, of the first slab of every member, the second ..."""

    def _look(self, run: Run) -> tuple[Any, Any]:
        stage = self.stage
        stage.seat()
        if self._velocities is None or stage.changed_since(self._at, run.slot):
            stage.show_all()
            self._velocities = stage.beats.look()
            self._energies = stage.beats.kinetic(*self._velocities)
            self._extremes = stage.extremes()
            self._at = stage.changes
        return self._velocities

    def whole_step(self, run: Run) -> tuple[np.ndarray, np.ndarray]:
        """Velocities [m/s] and reduced angular momenta [rad/s] of a member at the whole step, by row."""
        velocities, arrays = self._look(run), self.stage.arrays
        v, m = (arrays.part(array, run.slot, arrays.sizes.cap, run.rows) for array in velocities)
        return v, m

    def deepest(self, run: Run) -> float:
        """The largest overlap [m] of a member at the last step."""
        return float(np.max(self.stage.arrays.read("deep", run.slot, run.rows), initial=0.0))

    def contacts(self, run: Run) -> np.ndarray:
        """Rows i, j, wall, force, branch of a member's touching contacts, in the order of i, j, wall."""
        stage = self.stage
        if stage.changed_since(self._touched_at, run.slot):
            stage.show_all()
            self._touching = _by_slot(stage.beats.contacts(), keys=3)
            self._touched_at = stage.changes
        return self._touching.get(run.slot, np.zeros((0, 9)))

    def layer(self, run: Run, slab: Slab) -> np.ndarray:
        """Rows id, position, velocity of a member's grains in one of its slabs, by id. The same of all members is read
        at once: a slab has few grains, and to copy all of them to the host would take longer than a beat."""
        stage, which = self.stage, _slabs(run).index(slab)
        at, found = self._layers.get(which, (-1, {}))
        if stage.changed_since(at, run.slot):
            velocities, _ = self._look(run)
            low, high = np.full((2, stage.arrays.sizes.slots), np.inf)
            for one in stage.runs:
                if which < len(_slabs(one)):
                    low[one.slot], high[one.slot] = _slabs(one)[which].low, _slabs(one)[which].high
            found = _by_slot(stage.beats.layer(velocities, low, high), keys=1)
            self._layers[which] = stage.changes, found
        return found.get(run.slot, np.zeros((0, 7)))

    def wall_sums(self, run: Run, probe: Traction) -> np.ndarray:
        """Sums of a member over its contacts with walls by bin; those of all members are made at once."""
        stage = self.stage
        at, sums = self._sums.get(probe, (-1, {}))
        if stage.changed_since(at, run.slot):
            stage.show_all()
            sums = self._all_wall_sums(probe)
            self._sums[probe] = stage.changes, sums
        return sums[run.slot]

    def _all_wall_sums(self, probe: Traction) -> dict[int, np.ndarray]:
        """Sums of every member with a slot, by slot."""
        stage, sizes = self.stage, self.stage.arrays.sizes
        bins, units = np.zeros((sizes.slots, max(sizes.walls, 1), WALL_COLUMNS)), np.ones((sizes.slots, 2))
        first = 0
        places: dict[int, slice] = {}
        for run in stage.runs:
            table = run.bins.get(probe) if isinstance(run, Readable) else None
            if table is None:
                continue
            bins[run.slot, : len(table.numbers)] = table.numbers
            bins[run.slot, : len(table.numbers), -1] += first
            units[run.slot] = table.force, table.torque
            places[run.slot] = slice(first, first + table.total)
            first += table.total
        sums = stage.beats.wall_sums(bins, units, max(first, 1))
        return {slot: sums[place] for slot, place in places.items()}

    def energy(self, run: Run) -> float:
        """Kinetic energy [J] of a member at the whole step."""
        if run.slot < 0 and isinstance(run.begin, Packing):
            return run.first_energy()
        self._look(run)
        return float(self._energies[run.slot])

    def extremes(self, run: Run) -> tuple[float, float]:
        """Largest overlap [m] and speed [m/s] of a member so far."""
        if run.slot < 0:
            deep, speed2 = run.most
        else:
            self._look(run)
            deep, speed2 = self._extremes[run.slot]
        return float(deep), math.sqrt(speed2)

    def packing(self, run: Run) -> Packing:
        """The portable state of a member."""
        v, m = self.whole_step(run)
        return transfer.packing(self.stage.arrays.of_slot(run.slot, run.rows), run.scene, v, m)

    def end_state(self, run: Run) -> SlotEnd:
        """The state of a member that ends here; packing and checkpoint follow from it when they are asked for."""
        v, m = self.whole_step(run)
        state, numbers = self.stage.state_of(run)
        return SlotEnd(self.stage.maker, state.stored(), numbers, run.past_work, run.scene, v, m)

    def checkpoint(self, run: Run) -> Checkpoint:
        """The exact state of a member."""
        self.stage.seat()
        return self.stage.stored(run)

    def present(self, run: Run) -> np.ndarray:
        """Ids of the grains of a member that have not left."""
        self.stage.seat()
        arrays = self.stage.arrays
        ids = arrays.read("ids", run.slot, run.rows).astype(np.int64)
        return ids[transfer.here(arrays.of_slot(run.slot, run.rows).states().x, ids)]

    def put_back(self, returning: Sequence[tuple[Run, Packing, np.ndarray]]) -> None:
        """Give members grains that left again."""
        self.stage.put_back(returning)

    def set_velocities(self, run: Run, ids: np.ndarray, v: np.ndarray) -> None:
        """Give grains of a member other velocities."""
        self.stage.set_velocities(run, ids, v)

    def close(self) -> None:
        """Free the device's memory."""
        self._velocities = None
        self._touching, self._layers, self._sums = {}, {}, {}


def _slabs(run: Run) -> list[Slab]:
    return [probe for probe in run.probes if isinstance(probe, Slab)]


def _by_slot(rows: np.ndarray, keys: int) -> dict[int, np.ndarray]:
    """Rows that begin with their slot, without it, by slot: those of each in the order of the first `keys` columns."""
    rows = rows[np.lexsort(rows[:, keys::-1].T)]
    slots, first = np.unique(rows[:, 0], return_index=True)
    parts = np.split(rows[:, 1:], first[1:]) if len(slots) else []
    return {int(slot): part for slot, part in zip(slots, parts, strict=True)}
