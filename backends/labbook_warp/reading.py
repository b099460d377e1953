"""Members as probes read them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from labbook_dem.ensemble import MemberState
from labbook_dem.reading import Grains, Inside, SlabGrains
from labbook_dem.rotation import spins

from labbook.backend import Checkpoint, EndState
from labbook.backend.probes import Slab, Traction
from labbook.scene.packing import Packing
from labbook_warp import transfer
from labbook_warp.arrays import fetch
from labbook_warp.run import Run
from labbook_warp.view import DeviceView


@dataclass(eq=False)
class ReadableRun(Run, MemberState):
    """Run with the view that reads it; see `labbook_dem.reading.Readable`."""

    view: DeviceView = field(kw_only=True)

    def energy(self) -> float:
        """Kinetic energy [J] at the time of positions."""
        return self.view.energy(self)

    def extremes(self) -> tuple[float, float]:
        """Largest overlap [m] and speed [m/s] so far."""
        return self.view.extremes(self)

    def checkpoint(self) -> Checkpoint:
        """The exact state, copied."""
        return self.view.checkpoint(self)

    def packing(self) -> Packing:
        """The portable state."""
        return self.view.packing(self)

    def end_state(self) -> EndState:
        """State at the end of the member."""
        return self.view.end_state(self)

    def present(self) -> np.ndarray:
        """Ids of the grains that have not left."""
        return self.view.present(self)

    def put_back(self, grains: Packing, half_v: np.ndarray) -> None:
        """See `MemberState`."""
        self.view.put_back([(self, grains, half_v)])

    def set_velocities(self, ids: np.ndarray, v: np.ndarray) -> None:
        """See `MemberState`."""
        self.view.set_velocities(self, ids, v)

    def crossings(self) -> np.ndarray:
        """First passages of the last beat."""
        return self.crossed

    def look(self, moving: bool = True, inside: Inside | None = None) -> Grains:
        """Return the grains of the member; v, w and m are half a step old unless `moving`."""
        arrays, slot, n = self.view.stage.arrays, self.slot, self.rows
        state = arrays.of_slot(slot, n, self.per_grain)
        x, v_half, m_half, q = state.states()
        v, m = self.view.whole_step(self) if moving else (v_half, m_half)
        ids = arrays.read("ids", slot, n).astype(np.int64)
        order = transfer.present_rows(x, ids, inside)[:: self.per_grain]
        m, now = m[order], None if q is None else q[order]
        bodies = transfer.bodies(state, self.scene, order)
        w = spins(self.scene.grains, m, now)
        return Grains(ids[order] // self.per_grain, x[order], v[order], w, m, v_half[order], m_half[order], now, bodies)

    def layer(self, slab: Slab) -> SlabGrains:
        """Return its grains in a slab."""
        rows = self.view.layer(self, slab)
        return SlabGrains(rows[:, 0].astype(np.int64) // self.per_grain, rows[:, 1:4], rows[:, 4:])

    def contacts(self) -> np.ndarray:
        """Return its touching contacts."""
        return self.view.contacts(self)

    def wall_sums(self, probe: Traction) -> np.ndarray:
        """See `labbook_dem.reading.Readable`."""
        return self.view.wall_sums(self, probe)

    def accumulated(self) -> Mapping[str, float]:
        """Return the totals that the kernels counted; see `labbook_dem.reading.Readable`."""
        arrays, slot, n = self.view.stage.arrays, self.slot, self.rows
        pairs, walls = (int(np.bitwise_count(arrays.read(name, slot, n)).sum()) for name in ("held", "wall_held"))
        return {
            "work": math.fsum([*arrays.read("work", slot, n), *self.past_work]),  # exact, so that no order matters
            "max_overlap": self.view.deepest(self),
            "touching": pairs // 2 + walls,
            "rebuilds": int(fetch(arrays.system.rebuilds, slot, 1)[0]),
        }
