"""Rows of the probes, from what a backend reads of a member between two beats."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Contacts, Crossing, Ledger, Probe, Sample, Slab, Table, Zone, due
from labbook.scene import Bodies, Scene
from labbook_dem.ledger import totals

CROSSING_COLUMNS = ("id", "step", "time", "x", "y", "z", "vx", "vy", "vz", "wx", "wy", "wz")
OF_RODS = ("qw", "qx", "qy", "qz")
"""Further columns of crossings."""
CONTACT_COLUMNS = ("i", "j", "wall", "fx", "fy", "fz", "bx", "by", "bz")


Inside = Callable[[np.ndarray], np.ndarray]
"""Which of centres x [m], shape [n, 3], lie within a part of the bed: shape [n]."""


def crossing_columns(rods: bool) -> tuple[str, ...]:
    """Columns of what crossed a plane; rods have an orientation."""
    return (*CROSSING_COLUMNS, "qw", "qx", "qy", "qz") if rods else CROSSING_COLUMNS


class Grains(NamedTuple):
    """Grains that have not left, by id. Arrays of shape [n, 3] unless they say otherwise.

    ids: shape [n]; x [m]. At the time of x: v [m/s], angular velocities w [rad/s] and reduced angular momenta m [rad/s]
    (`labbook_dem.rotation`; of spheres w). Half a step before: v_half, m_half. q: orientations of rods, shape [n, 4].
    bodies: what each grain is, where they differ.
    """

    ids: np.ndarray
    x: np.ndarray
    v: np.ndarray
    w: np.ndarray
    m: np.ndarray
    v_half: np.ndarray
    m_half: np.ndarray
    q: np.ndarray | None = None
    bodies: Bodies | None = None

    def within(self, inside: Inside | None) -> "Grains":
        """Those that are `inside`; all of them for None."""
        if inside is None:
            return self
        mine = inside(self.x)
        bodies = self.bodies and Bodies(*(array[mine] for array in vars(self.bodies).values()))
        q = None if self.q is None else self.q[mine]
        return Grains(*(array[mine] for array in self[:7]), q=q, bodies=bodies)


class Layer(NamedTuple):
    """Grains in a slab, by id: ids, shape [n]; x [m] and v [m/s] at the same time, shape [n, 3]."""

    ids: np.ndarray
    x: np.ndarray
    v: np.ndarray


class Readable(ABC):
    """A member, as probes see it. A backend tells how its memory is read."""

    scene: Scene
    numerics: Numerics
    probes: Sequence[Probe]
    """All that look at it."""
    step: int
    """Steps taken."""

    @property
    def time(self) -> float:
        """Time [s] since step 0."""
        return self.step * self.numerics.dt

    @property
    def since_half(self) -> float:
        """Time [s] since velocities were kicked; at the start they are of the same time as positions."""
        return 0.5 * self.numerics.dt if self.step > 0 else 0.0

    @abstractmethod
    def crossings(self) -> np.ndarray:
        """First passages of the last beat, in `crossing_columns`."""

    @abstractmethod
    def look(self, moving: bool = True, inside: Inside | None = None) -> Grains:
        """Its grains, or those of them that are `inside`; v, w and m may be those of half a step before unless
        `moving`."""

    def layer(self, slab: Slab) -> Layer:
        """Its grains in a slab."""
        found = self.look(inside=lambda x: slab.holds(x[:, 2]))
        return Layer(found.ids, found.x, found.v)

    @abstractmethod
    def contacts(self) -> np.ndarray:
        """Its touching contacts, in CONTACT_COLUMNS."""

    @abstractmethod
    def counted(self) -> Mapping[str, float]:
        """`work` of contacts in all kicks so far [J], and the columns of `Ledger` that are counted while it steps:
        max_overlap, touching, rebuilds."""

    def totals(self) -> Mapping[str, float]:
        """The columns of `Ledger`."""
        now, counted = self.look(), dict(self.counted())
        halves, work = (now.v_half, now.m_half, self.since_half), counted.pop("work")
        found = totals(self.scene, now.x, now.v, now.m, *halves, work, now.q, now.bodies)
        return {"grains": len(now.ids), **found, **counted}


def read(member: Readable, beat: int) -> Mapping[Probe, Table]:
    """Rows of every probe that is due on this beat."""
    return {probe: _rows(member, probe) for probe in member.probes if due(probe, beat)}


def looking(members: Iterable[Readable], steps_per_beat: int) -> int:
    """How many of these members have a probe due that looks at every grain."""
    frames = (Sample, Zone, Ledger)
    return sum(
        any(isinstance(probe, frames) and due(probe, one.step // steps_per_beat) for probe in one.probes)
        for one in members
    )


def _rows(member: Readable, probe: Probe) -> Table:
    match probe:
        case Crossing():
            rows = member.crossings()
            return _columns(crossing_columns(rows.shape[1] > len(CROSSING_COLUMNS)), rows, ("id", "step"))
        case Sample():
            return _stamped(member, _sampled(member.look(bool({"v", "omega"} & set(probe.fields))), probe.fields))
        case Slab():
            return _stamped(member, _sampled(member.layer(probe), ("x", "v")))
        case Zone():
            grains = member.look(inside=probe.holds)
            return _stamped(member, _sampled(grains, ("x", "v") if grains.q is None else ("x", "v", "q")))
        case Contacts():
            return _stamped(member, _columns(CONTACT_COLUMNS, member.contacts(), ("i", "j", "wall")))
        case Ledger():
            return _stamped(member, {name: np.array([value]) for name, value in member.totals().items()})


def _columns(names: Sequence[str], rows: np.ndarray, whole: Sequence[str]) -> Table:
    table = dict(zip(names, rows.T.copy(), strict=True))
    return {**table, **{name: table[name].astype(np.int64) for name in whole}}


_FIELDS = {"x": ("", "x"), "v": ("v", "v"), "omega": ("w", "w"), "q": ("q", "q")}
"""What columns of a field begin with, and its attribute in `Grains`."""


def _sampled(grains: Grains | Layer, fields: Sequence[str]) -> Table:
    table = {"id": grains.ids.copy()}
    for name in fields:
        prefix, attribute = _FIELDS[name]
        array = getattr(grains, attribute)
        assert array is not None  # `features.check` has seen to it
        axes = "wxyz" if name == "q" else "xyz"
        table |= {prefix + axis: array[:, c].copy() for c, axis in enumerate(axes)}
    return table


def _stamped(member: Readable, table: Table) -> Table:
    n = len(next(iter(table.values())))
    return {"step": np.full(n, member.step), "time": np.full(n, member.time), **table}
