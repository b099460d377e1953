"""Rows of the probes, read from a member between two beats."""

import math
from collections.abc import Mapping

import numpy as np
from labbook_dem.features import within
from labbook_dem.ledger import totals

from labbook.backend import Contacts, Crossing, Ledger, Probe, Sample, Slab, Table
from labbook_warp import transfer
from labbook_warp.arrays import fetch
from labbook_warp.run import Run
from labbook_warp.stage import Stage

CROSS_COLUMNS = ("id", "step", "time", "x", "y", "z", "vx", "vy", "vz", "wx", "wy", "wz")


def read(stage: Stage, run: Run, beat: int, crossings: np.ndarray) -> Mapping[Probe, Table]:
    """Rows of every probe of `run` that is due on this beat."""
    due = [probe for probe in run.probes if isinstance(probe, Crossing) or beat % probe.every == 0]
    return {probe: _rows(stage, run, probe, crossings) for probe in due}


def _rows(stage: Stage, run: Run, probe: Probe, crossings: np.ndarray) -> Table:
    match probe:
        case Crossing():
            table = dict(zip(CROSS_COLUMNS, crossings.T.copy(), strict=True))
            return {**table, "id": table["id"].astype(np.int64), "step": table["step"].astype(np.int64)}
        case Sample():
            return _sampled(stage, run, probe)
        case Slab():
            return within(probe, _sampled(stage, run, Sample(fields=("x", "v"))))
        case Contacts():
            return _touching(stage, run)
        case Ledger():
            return _totals(stage, run)


def _sampled(stage: Stage, run: Run, probe: Sample) -> Table:
    x, _, _ = stage.arrays.decode(stage.arrays.read("p", run.slot, run.rows))
    ids = stage.arrays.read("ids", run.slot, run.rows).astype(np.int64)
    order = transfer.here(x, ids)
    v, w = stage.whole_step(run) if {"v", "omega"} & set(probe.fields) else (x, x)
    parts = {"x": ("", x), "v": ("v", v), "omega": ("w", w)}
    table = {"id": ids[order]}
    for name in probe.fields:
        prefix, array = parts[name]
        table |= {prefix + axis: array[order, c] for c, axis in enumerate("xyz")}
    return _stamped(run, table, len(order))


def _touching(stage: Stage, run: Run) -> Table:
    rows = stage.contacts(run)
    names = ("i", "j", "wall", "fx", "fy", "fz", "bx", "by", "bz")
    table = dict(zip(names, rows.T.copy(), strict=True))
    return _stamped(run, {**table, **{k: table[k].astype(np.int64) for k in ("i", "j", "wall")}}, len(rows))


def _totals(stage: Stage, run: Run) -> Table:
    arrays, slot, n = stage.arrays, run.slot, run.rows
    x, v_half, w_half = arrays.decode(arrays.read("p", slot, n))
    order = transfer.here(x, arrays.read("ids", slot, n))
    v, w = stage.whole_step(run)
    work = math.fsum([*arrays.read("work", slot, n), *run.past_work])  # exact, so that no order matters
    part = 0.5 * run.numerics.dt if run.step > 0 else 0.0
    sums = totals(run.scene, x[order], v[order], w[order], v_half[order], w_half[order], part, work)
    pairs, walls = (int(np.bitwise_count(arrays.read(name, slot, n)).sum()) for name in ("held", "wall_held"))
    row = {
        "grains": len(order),
        **sums,
        "max_overlap": stage.deepest(run),
        "touching": pairs // 2 + walls,
        "rebuilds": int(fetch(arrays.system.rebuilds)[slot]),
    }
    return _stamped(run, {name: np.array([value]) for name, value in row.items()}, 1)


def _stamped(run: Run, table: dict[str, np.ndarray], n: int) -> Table:
    return {"step": np.full(n, run.step), "time": np.full(n, run.time), **table}
