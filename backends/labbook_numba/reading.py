"""A member, as probes see it."""

from collections.abc import Mapping, Sequence

import numpy as np
from labbook_dem.ledger import totals
from labbook_dem.reading import Grains

from labbook.backend.probes import Probe
from labbook_numba import state as S
from labbook_numba.member import Run


class Seen:
    """See `labbook_dem.reading.Readable`."""

    def __init__(self, run: Run):
        self._run = run
        self.probes: Sequence[Probe] = run.probes

    def clock(self) -> tuple[int, float]:
        """Step, and time [s]."""
        return self._run.step, self._run.time

    def crossings(self) -> np.ndarray:
        """First passages since the last call."""
        st = self._run.state
        rows = st.cross[: st.count[S.CROSSED]].copy()
        st.count[S.CROSSED] = 0
        return rows

    def grains(self, moving: bool) -> Grains:
        """Its grains; v and w are always those of the whole step."""
        v, w = self._run.whole_step()
        st, n = self._run.state, len(v)
        return Grains(st.ids[:n].copy(), st.x[:n], v, w, self._run.q)

    def contacts(self) -> np.ndarray:
        """Its touching contacts."""
        return self._run.contacts()

    def totals(self) -> Mapping[str, float]:
        """Energies, momenta, and what the kernels counted."""
        run = self._run
        v, w = run.whole_step()
        st, n = run.state, len(v)
        since_half, work = 0.5 * run.numerics.dt if run.step > 0 else 0.0, float(st.sums[S.WORK])
        m_half = st.m[:n] if run.rods else st.w[:n]
        return {
            "grains": n,
            **totals(run.scene, st.x[:n], v, run.momenta(w), st.v[:n], m_half, since_half, work, run.q, run.bodies()),
            "max_overlap": float(st.sums[S.MAX_OVERLAP]),
            "touching": int(st.count[S.TOUCHING]),
            "rebuilds": int(st.count[S.REBUILDS]),
        }
