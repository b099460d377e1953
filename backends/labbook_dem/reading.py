"""Rows of the probes, from a backend's readings of a member between two beats."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple, TypeVar

import numpy as np

from labbook.backend.numerics import Numerics
from labbook.backend.probes import (
    Above,
    Contacts,
    Crossing,
    Dissipation,
    Film,
    Ledger,
    Probe,
    Sample,
    Slab,
    Table,
    Traction,
    Zone,
    due,
)
from labbook.scene import Bodies, Scene
from labbook_dem.ledger import contact_power, totals
from labbook_dem.traction import BinTable

CROSSING_COLUMNS = ("id", "step", "time", "x", "y", "z", "vx", "vy", "vz", "wx", "wy", "wz")
OF_RODS = ("qw", "qx", "qy", "qz")
"""Further columns of crossings of rods."""
CONTACT_COLUMNS = ("i", "j", "wall", "fx", "fy", "fz", "bx", "by", "bz")
M = TypeVar("M", bound="Readable")

Inside = Callable[[np.ndarray], np.ndarray]
"""Function of centres x [m], shape [n, 3], that selects those within a part of the bed: mask of shape [n]."""


def crossing_columns(rods: bool) -> tuple[str, ...]:
    """Columns of the crossings of a plane; rods have an orientation."""
    return CROSSING_COLUMNS + OF_RODS if rods else CROSSING_COLUMNS


class Grains(NamedTuple):
    """Present grains, by id.

    Attributes:
        ids: ids, shape [n].
        x: positions [m], shape [n, 3].
        v: velocities [m/s] at the time of x, shape [n, 3].
        w: angular velocities [rad/s], likewise.
        m: reduced angular momenta [rad/s], likewise (`labbook_dem.rotation`; of spheres w).
        v_half: velocities half a step before [m/s], shape [n, 3].
        m_half: reduced angular momenta half a step before [rad/s], shape [n, 3].
        q: orientations of rods, shape [n, 4].
        bodies: properties of each grain, in a mixture.
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
        """Select the grains `inside`; None: all of them."""
        if inside is None:
            return self
        selected = inside(self.x)
        bodies = self.bodies and Bodies(*(array[selected] for array in vars(self.bodies).values()))
        q = None if self.q is None else self.q[selected]
        return Grains(*(array[selected] for array in self[:7]), q=q, bodies=bodies)


class SlabGrains(NamedTuple):
    """Grains in a slab, by id: ids, shape [n]; x [m] and v [m/s] at the same time, shape [n, 3]."""

    ids: np.ndarray
    x: np.ndarray
    v: np.ndarray


class Snapshot(NamedTuple):
    """Reading of a probe at a step.

    Attributes:
        step: number of the step.
        time: time [s].
        rows: fields of grains, by row, or values of one column each.
    """

    step: int
    time: float
    rows: Mapping[str, np.ndarray]


class Readable(ABC):
    """State of a member that probes read. A backend defines how its memory is read."""

    scene: Scene
    numerics: Numerics
    probes: Sequence[Probe]
    """Probes that read it."""
    frames: list[tuple[Film, Snapshot]]
    """Frames of the beat, in the order of steps."""
    bins: Mapping[Traction, BinTable]
    """Bins of its walls for each probe."""
    step: int
    """Steps taken."""

    @property
    def time(self) -> float:
        """Time [s] since step 0."""
        return self.step * self.numerics.dt

    @property
    def since_half(self) -> float:
        """Time [s] since the last kick of velocities; at the start they are of the time of positions."""
        return 0.5 * self.numerics.dt if self.step > 0 else 0.0

    @abstractmethod
    def crossings(self) -> np.ndarray:
        """Return the first passages of the last beat, in `crossing_columns`."""

    @abstractmethod
    def look(self, moving: bool = True, inside: Inside | None = None) -> Grains:
        """Return its grains, or those `inside`.

        v, w and m may be those of half a step before unless `moving`.
        """

    def layer(self, slab: Slab) -> SlabGrains:
        """Return its grains in a slab."""
        grains = self.look(inside=lambda x: slab.holds(x[:, 2]))
        return SlabGrains(grains.ids, grains.x, grains.v)

    @abstractmethod
    def contacts(self) -> np.ndarray:
        """Return its touching contacts, in CONTACT_COLUMNS."""

    @abstractmethod
    def wall_sums(self, probe: Traction) -> np.ndarray:
        """Return sums over its contacts with walls, integers by bin; see `labbook_dem.traction`."""

    @abstractmethod
    def accumulated(self) -> Mapping[str, float]:
        """Return `work` of contacts in all kicks so far [J], and the columns of `Ledger` that are counted during steps:
        max_overlap, touching, rebuilds."""

    def totals(self) -> Mapping[str, float]:
        """Return the columns of `Ledger`."""
        now, accumulated = self.look(), dict(self.accumulated())
        halves, work = (now.v_half, now.m_half, self.since_half), accumulated.pop("work")
        energies = totals(self.scene, now.x, now.v, now.m, *halves, work, now.q, now.bodies)
        return {"grains": len(now.ids), **energies, **accumulated}

    def above(self, planes: Sequence[float]) -> Mapping[str, np.ndarray]:
        """Return the columns of `Above`; sums of masses are exact, so that the order of grains decides no bit."""
        now = self.look(moving=False)
        is_above = [now.x[:, 2] > plane for plane in planes]
        grains = np.array([int(selected.sum()) for selected in is_above])
        equal = grains * self.scene.grains.mass
        mass = (
            equal if now.bodies is None else np.array([math.fsum(now.bodies.mass[selected]) for selected in is_above])
        )
        return {"plane": np.arange(len(planes)), "grains": grains, "mass": mass}

    def powers(self) -> Mapping[str, float]:
        """Return the columns of `Dissipation`."""
        now = self.look()
        radius = np.full(len(now.ids), self.scene.grains.radius) if now.bodies is None else now.bodies.radius
        return contact_power(self.scene, now.ids, radius, now.x, now.v, now.w, self.contacts(), self.time)

    def frame_steps(self) -> list[int]:
        """Steps of the next beat, without its end, after which frames are due; for the first beat, with its
        beginning."""
        beat, dt = self.numerics.steps_per_beat, self.numerics.dt
        first, last = self.step + (self.step > 0), (self.step // beat + 1) * beat - 1
        return sorted({step for film in _films(self) for step in film.steps(dt, first, last)})

    def take_frames(self) -> None:
        """Read the frames that are due at this step."""
        for film in _films(self):
            if _is_due(film, self, self.numerics.steps_per_beat):
                self.frames.append((film, Snapshot(self.step, self.time, _read_probe(self, film))))


def _films(member: Readable) -> list[Film]:
    return [probe for probe in member.probes if isinstance(probe, Film)]


def read(members: Mapping[int, Readable], steps_per_beat: int) -> Mapping[Probe, Table]:
    """Return the rows of the probes that are due after this beat, in one table for all members, and clear their frames.

    Args:
        members: members by number.
        steps_per_beat: steps of a beat.
    """
    due_of: dict[Probe, dict[int, Readable]] = {}
    for number, member in members.items():
        for probe in member.probes:
            if due(probe, member.step // steps_per_beat):
                due_of.setdefault(probe, {})[number] = member
    tables = {probe: _table(probe, _snapshots(probe, readers)) for probe, readers in due_of.items()}
    for member in members.values():
        member.frames.clear()
    return tables


def looking(members: Iterable[M], steps_per_beat: int) -> list[M]:
    """Return the members with a due probe that reads every grain."""
    frames = (Sample, Film, Zone, Above, Ledger, Dissipation)
    return [
        member
        for member in members
        if any(isinstance(probe, frames) and _is_due(probe, member, steps_per_beat) for probe in member.probes)
    ]


def _is_due(probe: Probe, member: Readable, steps_per_beat: int) -> bool:
    if isinstance(probe, Film):
        return any(True for _ in probe.steps(member.numerics.dt, member.step, member.step))
    return due(probe, member.step // steps_per_beat)


def _snapshots(probe: Probe, members: Mapping[int, Readable]) -> list[tuple[int, Snapshot]]:
    """Snapshots of a probe with the numbers of their members: one a member, or one a frame."""
    if isinstance(probe, Film):
        return [
            (number, snapshot)
            for number, member in members.items()
            for film, snapshot in member.frames
            if film == probe
        ]
    return [
        (number, Snapshot(member.step, member.time, _read_probe(member, probe))) for number, member in members.items()
    ]


def _table(probe: Probe, snapshots: Sequence[tuple[int, Snapshot]]) -> Table:
    """Rows of a probe, snapshot after snapshot.

    Columns are made for all snapshots together: there may be a hundred members, each with few rows of two dozen
    columns.
    """
    if not snapshots:
        return {"member": np.zeros(0, np.int64)}
    sizes = [len(next(iter(snapshot.rows.values()))) for _, snapshot in snapshots]
    table = {"member": np.repeat(np.array([number for number, _ in snapshots], np.int64), sizes)}
    if not isinstance(probe, Crossing):  # each of its rows has a time of its own
        table["step"] = np.repeat(np.array([snapshot.step for _, snapshot in snapshots], np.int64), sizes)
        table["time"] = np.repeat(np.array([snapshot.time for _, snapshot in snapshots]), sizes)
    names = snapshots[0][1].rows
    return {
        **table,
        **_columns(probe, {name: np.concatenate([snapshot.rows[name] for _, snapshot in snapshots]) for name in names}),
    }


def _read_probe(member: Readable, probe: Probe) -> Mapping[str, np.ndarray]:
    """Read a probe of a member: fields of grains by row, or values of one column each."""
    match probe:
        case Crossing():
            return {"rows": member.crossings()}
        case Contacts():
            return {"rows": member.contacts()}
        case Sample() | Film():
            grains, fields = member.look(bool({"v", "omega"} & set(probe.fields))), probe.fields
        case Slab():
            grains, fields = member.layer(probe), ("x", "v")
        case Zone():
            grains = member.look(inside=probe.holds)
            fields = ("x", "v") if grains.q is None else ("x", "v", "q")
        case Traction():
            return member.bins[probe].rows(member.wall_sums(probe))
        case Above():
            return member.above(probe.planes)
        case Ledger():
            return {name: np.array([value]) for name, value in member.totals().items()}
        case Dissipation():
            return {name: np.array([value]) for name, value in member.powers().items()}
    return {"id": grains.ids, **{name: getattr(grains, _FIELDS[name][1]) for name in fields}}


def _columns(probe: Probe, rows: Mapping[str, np.ndarray]) -> Table:
    """Columns of a probe from the rows of `_read_probe`."""
    if isinstance(probe, Above | Ledger | Dissipation | Traction):
        return rows
    if isinstance(probe, Crossing | Contacts):
        crossing = isinstance(probe, Crossing)
        names = crossing_columns(rows["rows"].shape[1] > len(CROSSING_COLUMNS)) if crossing else CONTACT_COLUMNS
        table = dict(zip(names, rows["rows"].T.copy(), strict=True))
        return {**table, **{name: table[name].astype(np.int64) for name in (_WHOLE & table.keys())}}
    table = {"id": rows["id"]}
    for name, array in rows.items():
        if name != "id":
            axes = "wxyz" if name == "q" else "xyz"
            table |= {_FIELDS[name][0] + axis: column for axis, column in zip(axes, array.T.copy(), strict=True)}
    return table


_FIELDS = {"x": ("", "x"), "v": ("v", "v"), "omega": ("w", "w"), "q": ("q", "q")}
"""Prefix of the columns of a field, and its attribute in `Grains`."""
_WHOLE = {"id", "step", "i", "j", "wall"}
"""Columns of whole numbers."""
