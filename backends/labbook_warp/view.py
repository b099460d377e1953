"""Readings of members: states, energies, contacts. Expensive ones are made for all members at once."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from labbook_dem.reading import Readable
from labbook_dem.traction import WALL_COLUMNS

from labbook.backend import Checkpoint
from labbook.backend.probes import Slab, Traction
from labbook.scene import BedTop
from labbook.scene.packing import Packing
from labbook_warp import transfer
from labbook_warp.ended import SlotEnd
from labbook_warp.returning import Tops, read_tops
from labbook_warp.run import Run
from labbook_warp.stage import Stage


class DeviceView:
    """Cache of readings of the members on a device.

    Reading changes nothing, except that waiting members get their slots. A reading is valid until its member changes:
    if grains were put back into a thousand members, one after another, each would else be read a thousand times.
    """

    def __init__(self, stage: Stage):
        self.stage = stage
        self._state_version = -1  # `Stage.changes` when velocities and energies were read
        self._velocities: tuple[Any, Any] | None = None
        self._energies = np.zeros(0)
        self._extremes = np.zeros((0, 2))
        self._tops_version = -1  # `Stage.changes` when tops were read
        self._tops: Tops | None = None
        self._contacts_version = -1  # `Stage.changes` when contacts were read
        self._contacts: dict[int, np.ndarray] = {}
        self._sums: dict[Traction, tuple[int, dict[int, np.ndarray]]] = {}
        """By probe: `Stage.changes` at the reading, and sums over contacts with walls by slot."""
        self._layers: dict[int, tuple[int, dict[int, np.ndarray]]] = {}
        """By number of a member's slab: `Stage.changes` at the reading, and rows by slot."""

    def _look(self, run: Run) -> tuple[Any, Any]:
        stage = self.stage
        stage.seat()
        if self._velocities is None or stage.changed_since(self._state_version, run.slot):
            stage.show_all()
            self._velocities = stage.beats.whole_step()
            self._energies = stage.beats.kinetic(*self._velocities)
            self._extremes = stage.extremes()
            self._state_version = stage.changes
        return self._velocities

    def whole_step(self, run: Run) -> tuple[np.ndarray, np.ndarray]:
        """Velocities [m/s] and reduced angular momenta [rad/s] of a member at the whole step, by row."""
        velocities, arrays = self._look(run), self.stage.arrays
        v, m = (arrays.fetched(array, run.slot, arrays.sizes.cap, run.rows) for array in velocities)
        return v, m

    def deepest(self, run: Run) -> float:
        """The largest overlap [m] of a member at the last step."""
        return float(np.max(self.stage.arrays.read("deep", run.slot, run.rows), initial=0.0))

    def contacts(self, run: Run) -> np.ndarray:
        """Rows i, j, wall, force, branch of a member's touching contacts, in the order of i, j, wall."""
        stage = self.stage
        if stage.changed_since(self._contacts_version, run.slot):
            stage.show_all()
            self._contacts = _by_slot(stage.beats.contacts(), keys=3)
            self._contacts_version = stage.changes
        return self._contacts.get(run.slot, np.zeros((0, 9)))

    def layer(self, run: Run, slab: Slab) -> np.ndarray:
        """Return rows id, position, velocity of a member's grains in one of its slabs, by id.

        The corresponding slabs of all members are read at once: copying all grains to the host would take longer than a
        beat.
        """
        stage, index = self.stage, _slabs(run).index(slab)
        version, rows = self._layers.get(index, (-1, {}))
        if stage.changed_since(version, run.slot):
            velocities, _ = self._look(run)
            low, high = np.full((2, stage.arrays.sizes.slots), np.inf)
            for member in stage.runs:
                if index < len(_slabs(member)):
                    low[member.slot], high[member.slot] = _slabs(member)[index].low, _slabs(member)[index].high
            rows = _by_slot(stage.beats.slab(velocities, low, high), keys=1)
            self._layers[index] = stage.changes, rows
        return rows.get(run.slot, np.zeros((0, 7)))

    def wall_sums(self, run: Run, probe: Traction) -> np.ndarray:
        """Return sums of a member over its contacts with walls, by bin; those of all members are computed at once."""
        stage = self.stage
        version, sums = self._sums.get(probe, (-1, {}))
        if stage.changed_since(version, run.slot):
            stage.show_all()
            sums = self._all_wall_sums(probe)
            self._sums[probe] = stage.changes, sums
        return sums[run.slot]

    def _all_wall_sums(self, probe: Traction) -> dict[int, np.ndarray]:
        """Sums of every member with a slot, by slot."""
        stage, sizes = self.stage, self.stage.arrays.sizes
        bins, units = np.zeros((sizes.slots, max(sizes.walls, 1), WALL_COLUMNS)), np.ones((sizes.slots, 2))
        first = 0
        slices: dict[int, slice] = {}
        for run in stage.runs:
            table = run.bins.get(probe) if isinstance(run, Readable) else None
            if table is None:
                continue
            bins[run.slot, : len(table.numbers)] = table.numbers
            bins[run.slot, : len(table.numbers), -1] += first
            units[run.slot] = table.force, table.torque
            slices[run.slot] = slice(first, first + table.total)
            first += table.total
        sums = stage.beats.wall_sums(bins, units, max(first, 1))
        return {slot: sums[own_slice] for slot, own_slice in slices.items()}

    def energy(self, run: Run) -> float:
        """Kinetic energy [J] of a member at the whole step."""
        if run.slot < 0 and isinstance(run.begin, Packing):
            return run.first_energy()
        self._look(run)
        return float(self._energies[run.slot])

    def extremes(self, run: Run) -> tuple[float, float]:
        """Largest overlap [m] and speed [m/s] of a member so far."""
        if run.slot < 0:
            deep, speed2 = run.start_extremes
        else:
            self._look(run)
            deep, speed2 = self._extremes[run.slot]
        return float(deep), math.sqrt(speed2)

    def packing(self, run: Run) -> Packing:
        """The portable state of a member."""
        v, m = self.whole_step(run)
        return transfer.packing(self.stage.arrays.of_slot(run.slot, run.rows), run.scene, v, m)

    def end_state(self, run: Run) -> SlotEnd:
        """Return the state of a member that ends here; packing and checkpoint are derived on access."""
        v, m = self.whole_step(run)
        state, numbers = self.stage.state_of(run)
        return SlotEnd(self.stage.maker, state.stored(), numbers, run.past_work, run.scene, v, m)

    def checkpoint(self, run: Run) -> Checkpoint:
        """The exact state of a member."""
        self.stage.seat()
        return self.stage.stored(run)

    def tops(self, heights: Mapping[Run, float]) -> list[BedTop]:
        """Return the top of each bed above its height z [m]; all are read at once."""
        if not heights:
            return []
        tops = self._read_tops(heights)
        slices = [slice(*tops.first[run.slot : run.slot + 2]) for run in heights]
        cap, oriented = self.stage.arrays.sizes.cap, self.stage.arrays.module.ORIENTED
        return [
            BedTop(
                self.present(run),
                run.ids[tops.rows[own_slice] - run.slot * cap],
                tops.x[own_slice],
                tops.q[own_slice] if oriented else None,
            )
            for run, own_slice in zip(heights, slices, strict=True)
        ]

    def present(self, run: Run) -> np.ndarray:
        """Ids of the grains of a member that have not left."""
        self.stage.seat()
        if self._tops is None or self.stage.changed_since(self._tops_version, run.slot):
            self._tops = self._read_tops({})
        empty = self._tops.left[run.slot, : run.rows]
        run.note_empty(empty)
        return run.ids[~empty]

    def _read_tops(self, heights: Mapping[Run, float]) -> Tops:
        stage = self.stage
        stage.seat()
        stage.show_all()
        stage.read_ids()
        self._tops = read_tops(stage.arrays, {run.slot: height for run, height in heights.items()})
        self._tops_version = stage.changes
        return self._tops

    def put_back(self, returning: Sequence[tuple[Run, Packing, np.ndarray]]) -> None:
        """Insert grains that left members again; see `Stage.put_back`."""
        self.stage.put_back(returning)

    def set_velocities(self, run: Run, ids: np.ndarray, v: np.ndarray) -> None:
        """Set velocities of grains of a member; see `Stage.set_velocities`."""
        self.stage.set_velocities(run, ids, v)

    def close(self) -> None:
        """Free the device's memory."""
        self._velocities = self._tops = None
        self._contacts, self._layers, self._sums = {}, {}, {}


def _slabs(run: Run) -> list[Slab]:
    return [probe for probe in run.probes if isinstance(probe, Slab)]


def _by_slot(rows: np.ndarray, keys: int) -> dict[int, np.ndarray]:
    """Split rows by their first column, the slot, and drop it; sort by the first `keys` further columns."""
    rows = rows[np.lexsort(rows[:, keys::-1].T)]
    slots, first = np.unique(rows[:, 0], return_index=True)
    rows_of_slots = np.split(rows[:, 1:], first[1:]) if len(slots) else []
    return {int(slot): own_rows for slot, own_rows in zip(slots, rows_of_slots, strict=True)}
