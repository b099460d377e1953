"""Rows of the probes, read from a member between two beats."""

from collections.abc import Mapping

import numpy as np
from labbook_dem.features import within
from labbook_dem.ledger import totals

from labbook.backend import Contacts, Crossing, Ledger, Probe, Sample, Slab, Table
from labbook_numba import state as S
from labbook_numba.member import Run


def read(run: Run, beat: int) -> Mapping[Probe, Table]:
    """Rows of every probe of `run` that is due on this beat."""
    due = [probe for probe in run.probes if isinstance(probe, Crossing) or beat % probe.every == 0]
    return {probe: _rows(run, probe) for probe in due}


def _rows(run: Run, probe: Probe) -> Table:
    match probe:
        case Crossing():
            return _crossed(run)
        case Sample():
            return _sampled(run, probe)
        case Slab():
            return within(probe, _sampled(run, Sample(fields=("x", "v"))))
        case Contacts():
            return _touching(run)
        case Ledger():
            return _totals(run)


def _crossed(run: Run) -> Table:
    st = run.state
    rows = st.cross[: st.count[S.CROSSED]].copy()
    st.count[S.CROSSED] = 0
    table = dict(zip(S.CROSS_COLUMNS, rows.T, strict=True))
    return {**table, "id": table["id"].astype(np.int64), "step": table["step"].astype(np.int64)}


def _sampled(run: Run, probe: Sample) -> Table:
    v, w = run.whole_step()
    parts = {"x": ("", run.state.x), "v": ("v", v), "omega": ("w", w)}
    table = {"id": run.state.ids[: len(v)].copy()}
    for name in probe.fields:
        prefix, array = parts[name]
        table |= {prefix + axis: array[: len(v), c].copy() for c, axis in enumerate("xyz")}
    return _stamped(run, table, len(v))


def _touching(run: Run) -> Table:
    rows = run.contacts()
    names = ("i", "j", "wall", "fx", "fy", "fz", "bx", "by", "bz")
    table = dict(zip(names, rows.T.copy(), strict=True))
    return _stamped(run, {**table, **{k: table[k].astype(np.int64) for k in ("i", "j", "wall")}}, len(rows))


def _totals(run: Run) -> Table:
    v, w = run.whole_step()
    st, n = run.state, len(v)
    part = 0.5 * run.numerics.dt if run.step > 0 else 0.0
    sums = totals(run.scene, st.x[:n], v, w, st.v[:n], st.w[:n], part, float(st.sums[S.WORK]))
    row = {
        "grains": n,
        **sums,
        "max_overlap": float(st.sums[S.MAX_OVERLAP]),
        "touching": int(st.count[S.TOUCHING]),
        "rebuilds": int(st.count[S.REBUILDS]),
    }
    return _stamped(run, {name: np.array([value]) for name, value in row.items()}, 1)


def _stamped(run: Run, table: dict[str, np.ndarray], n: int) -> Table:
    return {"step": np.full(n, run.step), "time": np.full(n, run.step * run.params.dt), **table}
