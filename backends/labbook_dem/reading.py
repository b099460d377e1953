"""Rows of the probes, from what a backend reads of a member between two beats."""

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
"""Further columns of crossings."""
CONTACT_COLUMNS = ("i", "j", "wall", "fx", "fy", "fz", "bx", "by", "bz")
M = TypeVar("M", bound="Readable")

Inside = Callable[[np.ndarray], np.ndarray]
"""Which of centres x [m], shape [n, 3], lie within a part of the bed: shape [n]."""


def crossing_columns(rods: bool) -> tuple[str, ...]:
    """Columns of what crossed a plane; rods have an orientation."""
    return CROSSING_COLUMNS + OF_RODS if rods else CROSSING_COLUMNS


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


class SlabGrains(NamedTuple):
    """Grains in a slab, by id: ids, shape [n]; x [m] and v [m/s] at the same time, shape [n, 3]."""

    ids: np.ndarray
    x: np.ndarray
    v: np.ndarray


class Seen(NamedTuple):
    """What a probe saw at a step: fields of grains by row, or numbers that belong to one column each. time [s]."""

    step: int
    time: float
    rows: Mapping[str, np.ndarray]


class Readable(ABC):
    """A member, as probes see it. A backend tells how its memory is read."""

    scene: Scene
    numerics: Numerics
    probes: Sequence[Probe]
    """All that look at it."""
    frames: list[tuple[Film, Seen]]
    """Taken in the beat, in the order of steps."""
    bins: Mapping[Traction, BinTable]
    """Of its walls, for each of these probes."""
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

    def layer(self, slab: Slab) -> SlabGrains:
        """Its grains in a slab."""
        found = self.look(inside=lambda x: slab.holds(x[:, 2]))
        return SlabGrains(found.ids, found.x, found.v)

    @abstractmethod
    def contacts(self) -> np.ndarray:
        """Its touching contacts, in CONTACT_COLUMNS."""

    @abstractmethod
    def wall_sums(self, probe: Traction) -> np.ndarray:
        """Sums over its contacts with walls, whole numbers by bin; see `labbook_dem.traction`."""

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

    def above(self, planes: Sequence[float]) -> Mapping[str, np.ndarray]:
        """The columns of `Above`; sums of masses are exact, so that no order of grains matters."""
        now = self.look(moving=False)
        over = [now.x[:, 2] > plane for plane in planes]
        grains = np.array([int(one.sum()) for one in over])
        equal = grains * self.scene.grains.mass
        mass = equal if now.bodies is None else np.array([math.fsum(now.bodies.mass[one]) for one in over])
        return {"plane": np.arange(len(planes)), "grains": grains, "mass": mass}

    def powers(self) -> Mapping[str, float]:
        """The columns of `Dissipation`."""
        now = self.look()
        radius = np.full(len(now.ids), self.scene.grains.radius) if now.bodies is None else now.bodies.radius
        return contact_power(self.scene, now.ids, radius, now.x, now.v, now.w, self.contacts(), self.time)

    def frame_steps(self) -> list[int]:
        """Steps of the next beat, without its end, after which frames are due; of the first beat with its beginning."""
        beat, dt = self.numerics.steps_per_beat, self.numerics.dt
        first, last = self.step + (self.step > 0), (self.step // beat + 1) * beat - 1
        return sorted({step for film in _films(self) for step in film.steps(dt, first, last)})

    def take_frames(self) -> None:
        """Take the frames that are due at this step."""
        for film in _films(self):
            if _is_due(film, self, self.numerics.steps_per_beat):
                self.frames.append((film, Seen(self.step, self.time, _seen(self, film))))


def _films(member: Readable) -> list[Film]:
    return [probe for probe in member.probes if isinstance(probe, Film)]


def read(members: Mapping[int, Readable], steps_per_beat: int) -> Mapping[Probe, Table]:
    """Rows of the probes that are due after this beat, those of all members in one table; members by number. Frames
    that were taken are read once."""
    due_of: dict[Probe, dict[int, Readable]] = {}
    for number, member in members.items():
        for probe in member.probes:
            if due(probe, member.step // steps_per_beat):
                due_of.setdefault(probe, {})[number] = member
    found = {probe: _table(probe, _parts(probe, of)) for probe, of in due_of.items()}
    for member in members.values():
        member.frames.clear()
    return found


def looking(members: Iterable[M], steps_per_beat: int) -> list[M]:
    """Return those of these members that have a probe due that looks at every grain."""
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


def _parts(probe: Probe, members: Mapping[int, Readable]) -> list[tuple[int, Seen]]:
    """What a probe saw of members, by number: of each all at once, or frame by frame."""
    if isinstance(probe, Film):
        return [(number, seen) for number, one in members.items() for film, seen in one.frames if film == probe]
    return [(number, Seen(one.step, one.time, _seen(one, probe))) for number, one in members.items()]


def _table(probe: Probe, parts: Sequence[tuple[int, Seen]]) -> Table:
    """Rows of a probe, one part after another. Columns are made of what all have together: there may be a hundred
    members, each with a few rows of two dozen columns."""
    if not parts:
        return {"member": np.zeros(0, np.int64)}
    sizes = [len(next(iter(seen.rows.values()))) for _, seen in parts]
    table = {"member": np.repeat(np.array([number for number, _ in parts], np.int64), sizes)}
    if not isinstance(probe, Crossing):  # each of its rows has a time of its own
        table["step"] = np.repeat(np.array([seen.step for _, seen in parts], np.int64), sizes)
        table["time"] = np.repeat(np.array([seen.time for _, seen in parts]), sizes)
    names = parts[0][1].rows
    return {
        **table,
        **_columns(probe, {name: np.concatenate([seen.rows[name] for _, seen in parts]) for name in names}),
    }


def _seen(member: Readable, probe: Probe) -> Mapping[str, np.ndarray]:
    """What a probe sees of a member, by row: fields of grains, or numbers that belong to one column each."""
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


def _columns(probe: Probe, seen: Mapping[str, np.ndarray]) -> Table:
    """Columns of a probe, of what `_seen` gave."""
    if isinstance(probe, Above | Ledger | Dissipation | Traction):
        return seen
    if isinstance(probe, Crossing | Contacts):
        crossing = isinstance(probe, Crossing)
        names = crossing_columns(seen["rows"].shape[1] > len(CROSSING_COLUMNS)) if crossing else CONTACT_COLUMNS
        table = dict(zip(names, seen["rows"].T.copy(), strict=True))
        return {**table, **{name: table[name].astype(np.int64) for name in (_WHOLE & table.keys())}}
    table = {"id": seen["id"]}
    for name, array in seen.items():
        if name != "id":
            axes = "wxyz" if name == "q" else "xyz"
            table |= {_FIELDS[name][0] + axis: column for axis, column in zip(axes, array.T.copy(), strict=True)}
    return table


_FIELDS = {"x": ("", "x"), "v": ("v", "v"), "omega": ("w", "w"), "q": ("q", "q")}
"""What columns of a field begin with, and its attribute in `Grains`."""
_WHOLE = {"id", "step", "i", "j", "wall"}
"""Columns of whole numbers."""
