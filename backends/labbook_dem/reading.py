"""Rows of the probes, from what a backend reads of a member between two beats."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from labbook.backend.probes import Contacts, Crossing, Ledger, Probe, Sample, Slab, Table, Zone, due

CROSSING_COLUMNS = ("id", "step", "time", "x", "y", "z", "vx", "vy", "vz", "wx", "wy", "wz")
OF_RODS = ("qw", "qx", "qy", "qz")
"""Further columns of crossings."""
CONTACT_COLUMNS = ("i", "j", "wall", "fx", "fy", "fz", "bx", "by", "bz")


def crossing_columns(rods: bool) -> tuple[str, ...]:
    """Columns of what crossed a plane; rods have an orientation."""
    return (*CROSSING_COLUMNS, "qw", "qx", "qy", "qz") if rods else CROSSING_COLUMNS


class Grains(NamedTuple):
    """Grains that have not left, by id: ids [n]; x [m], and at the whole step v [m/s], w [rad/s], shape [n, 3].

    q: orientations of rods, shape [n, 4].
    """

    ids: np.ndarray
    x: np.ndarray
    v: np.ndarray
    w: np.ndarray
    q: np.ndarray | None = None


class Readable(Protocol):
    """A member, as probes see it."""

    @property
    def probes(self) -> Sequence[Probe]:
        """All that look at it."""
        ...

    def clock(self) -> tuple[int, float]:
        """Step, and time [s]."""
        ...

    def crossings(self) -> np.ndarray:
        """First passages of the last beat, in `crossing_columns`."""
        ...

    def grains(self, moving: bool) -> Grains:
        """Its grains; v and w may be anything of their shape unless `moving`."""
        ...

    def contacts(self) -> np.ndarray:
        """Its touching contacts, in CONTACT_COLUMNS."""
        ...

    def totals(self) -> Mapping[str, float]:
        """The columns of `Ledger`."""
        ...


def read(member: Readable, beat: int) -> Mapping[Probe, Table]:
    """Rows of every probe that is due on this beat."""
    return {probe: _rows(member, probe) for probe in member.probes if due(probe, beat)}


def _rows(member: Readable, probe: Probe) -> Table:
    match probe:
        case Crossing():
            rows = member.crossings()
            return _columns(crossing_columns(rows.shape[1] > len(CROSSING_COLUMNS)), rows, ("id", "step"))
        case Sample():
            return _stamped(member, _sampled(member.grains(bool({"v", "omega"} & set(probe.fields))), probe.fields))
        case Slab():
            grains = member.grains(True)
            return _stamped(member, _within(grains, probe.holds(grains.x[:, 2]), ("x", "v")))
        case Zone():
            grains = member.grains(True)
            fields = ("x", "v") if grains.q is None else ("x", "v", "q")
            return _stamped(member, _within(grains, probe.holds(grains.x), fields))
        case Contacts():
            return _stamped(member, _columns(CONTACT_COLUMNS, member.contacts(), ("i", "j", "wall")))
        case Ledger():
            return _stamped(member, {name: np.array([value]) for name, value in member.totals().items()})


def _columns(names: Sequence[str], rows: np.ndarray, whole: Sequence[str]) -> Table:
    table = dict(zip(names, rows.T.copy(), strict=True))
    return {**table, **{name: table[name].astype(np.int64) for name in whole}}


def _sampled(grains: Grains, fields: Sequence[str]) -> Table:
    parts = {"x": ("", grains.x), "v": ("v", grains.v), "omega": ("w", grains.w), "q": ("q", grains.q)}
    table = {"id": grains.ids}
    for name in fields:
        prefix, array = parts[name]
        assert array is not None  # `features.check` has seen to it
        axes = "wxyz" if name == "q" else "xyz"
        table |= {prefix + axis: array[:, c].copy() for c, axis in enumerate(axes)}
    return table


def _within(grains: Grains, inside: np.ndarray, fields: Sequence[str]) -> Table:
    q = None if grains.q is None else grains.q[inside]
    return _sampled(Grains(grains.ids[inside], grains.x[inside], grains.v[inside], grains.w[inside], q), fields)


def _stamped(member: Readable, table: Table) -> Table:
    n = len(next(iter(table.values())))
    step, time = member.clock()
    return {"step": np.full(n, step), "time": np.full(n, time), **table}
