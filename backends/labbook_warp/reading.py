"""A member, as probes see it."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from labbook_dem.ledger import totals
from labbook_dem.reading import Grains
from labbook_dem.rotation import spins

from labbook.backend.probes import Probe
from labbook_warp import transfer
from labbook_warp.arrays import fetch
from labbook_warp.run import Run
from labbook_warp.view import View


class Seen:
    """See `labbook_dem.reading.Readable`."""

    def __init__(self, view: View, run: Run):
        self._view, self._run, self._arrays = view, run, view.stage.arrays
        self.probes: Sequence[Probe] = run.probes

    def clock(self) -> tuple[int, float]:
        """Step, and time [s]."""
        return self._run.step, self._run.time

    def crossings(self) -> np.ndarray:
        """First passages of the last beat."""
        return self._run.crossed

    def grains(self, moving: bool) -> Grains:
        """Its grains; v and w are half a step old unless `moving`."""
        run, arrays = self._run, self._arrays
        x, v, m, q = arrays.states(run.slot, run.rows)
        ids = arrays.read("ids", run.slot, run.rows).astype(np.int64)
        order = transfer.here(x, ids)
        if moving:
            v, m = self._view.whole_step(run)
        if q is None:
            return Grains(ids[order], x[order], v[order], m[order])
        q = q[order]
        return Grains(ids[order], x[order], v[order], spins(run.scene.grains, m[order], q), q)

    def contacts(self) -> np.ndarray:
        """Its touching contacts."""
        return self._view.contacts(self._run)

    def totals(self) -> Mapping[str, float]:
        """Energies, momenta, and what the kernels counted."""
        run, arrays, slot, n = self._run, self._arrays, self._run.slot, self._run.rows
        x, v_half, m_half, q = arrays.states(slot, n)
        order = transfer.here(x, arrays.read("ids", slot, n))
        v, m = self._view.whole_step(run)
        work = math.fsum([*arrays.read("work", slot, n), *run.past_work])  # exact, so that no order matters
        bodies = transfer.bodies(arrays, slot, n, run.scene, order)
        since_half = 0.5 * run.numerics.dt if run.step > 0 else 0.0
        pairs, walls = (int(np.bitwise_count(arrays.read(name, slot, n)).sum()) for name in ("held", "wall_held"))
        now = None if q is None else q[order]
        return {
            "grains": len(order),
            **totals(
                run.scene, x[order], v[order], m[order], v_half[order], m_half[order], since_half, work, now, bodies
            ),
            "max_overlap": self._view.deepest(run),
            "touching": pairs // 2 + walls,
            "rebuilds": int(fetch(arrays.system.rebuilds)[slot]),
        }
