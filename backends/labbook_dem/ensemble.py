"""What ensembles of all backends do alike: members come and go, rows are collected, and events tell what happened."""

import math
from abc import abstractmethod
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from labbook import backend
from labbook.backend import Capabilities, Checkpoint, Emptied, Event, Failed, Member, Settled, Spec, Status
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Crossing, Ledger, Probe, Table, Traction, empty_table
from labbook.scene import Scene
from labbook.scene.packing import Packing
from labbook.scene.quantities import span, told_apart
from labbook_dem.features import covers, specialise
from labbook_dem.ledger import kinetic, status
from labbook_dem.mesh import TOO_MANY
from labbook_dem.reading import Readable, read
from labbook_dem.traction import BinTable

LONGEST = 2**53
"""Steps from which on their number has no exact time."""
UNKNOWN = math.inf
"""Largest overlap or speed of a member that went on from a checkpoint which does not tell it: none is ever larger."""


@dataclass(frozen=True)
class Failure:
    """Why a guard stopped a member; see `labbook.backend.Failed`."""

    guard: str
    step: int
    grain: int
    message: str


class Standing(Readable):
    """What a backend knows of a member, as far as every backend knows it."""

    failure: Failure | None

    @property
    @abstractmethod
    def grains(self) -> int:
        """Grains that have not left."""

    @abstractmethod
    def checkpoint(self) -> Checkpoint:
        """The exact state, copied."""

    @abstractmethod
    def packing(self) -> Packing:
        """The portable state."""

    @abstractmethod
    def extremes(self) -> tuple[float, float]:
        """Largest overlap [m] and speed [m/s] of all steps so far; UNKNOWN where they are not known."""

    @abstractmethod
    def present(self) -> np.ndarray:
        """Ids of the grains that have not left, in any order."""

    @abstractmethod
    def put_back(self, grains: Packing, half_v: np.ndarray) -> None:
        """Put grains that left back. half_v: their velocities [m/s] at the time of those that are kept."""

    @abstractmethod
    def set_velocities(self, ids: np.ndarray, v: np.ndarray) -> None:
        """Give grains other velocities [m/s], half a step before and as predicted for now."""

    def energy(self) -> float:
        """Kinetic energy [J] at the time of positions."""
        now = self.look()
        return kinetic(now.bodies or self.scene.grains, now.v, now.m, now.q)

    def status(self) -> Status:
        """See `labbook.backend.Status`."""
        return status(self.scene, self.step, self.time, self.grains, self.energy(), *self.extremes())


@dataclass
class Settling:
    """When a member counts as settled, and at how many beats on end it has been below the limit."""

    below: float
    beats: int
    seen: int = 0

    def after(self, kinetic: float) -> bool:
        """Whether it is settled as of this beat, at this kinetic energy per grain."""
        self.seen = self.seen + 1 if kinetic < self.below else 0
        return self.seen == self.beats


R = TypeVar("R", bound=Standing)


class Ensemble(backend.Ensemble, Generic[R]):
    """See `labbook.backend.Ensemble`. A backend adds how a member begins and is stepped."""

    def __init__(self, capabilities: Capabilities, spec: Spec):
        self._can, self._spec = capabilities, spec
        self._runs: dict[Member, R] = {}
        self._settling: dict[Member, Settling] = {}
        self._rows: dict[Probe, list[Table]] = defaultdict(list)
        self._next = 0

    def _specialise(self, scene: Scene, numerics: Numerics) -> Spec:
        return specialise(self._can, scene, numerics, self._spec.probes)

    @abstractmethod
    def _begin(self, scene: Scene, numerics: Numerics, start: Packing | Checkpoint) -> R: ...

    @abstractmethod
    def advance(self, beats: int = 1) -> Sequence[Event]:
        """Let every member take `beats` beats; those that failed or emptied rest."""

    def admit(
        self,
        scene: Scene,
        numerics: Numerics,
        start: Packing | Checkpoint,
        *,
        settled_below: float | None = None,
        settled_beats: int = 3,
        probes: Sequence[Probe] | None = None,
    ) -> Member:
        """Add a member. Raises ValueError if it needs what this ensemble's Spec has not, or has no grains."""
        read_by = self._spec.probes if probes is None else tuple(probes)
        check_read_by(self._spec, read_by)
        if isinstance(start, Packing) and not len(start):
            raise ValueError("packing: it has no grains; start from one grain or more")
        if not covers(self._spec, self._specialise(scene, numerics)):
            raise ValueError("this member needs kernels that the ensemble's Spec does not have")
        run = self._begin(scene, numerics, start)
        run.probes, run.frames = read_by, []
        run.bins = {probe: BinTable.of(scene, probe) for probe in read_by if isinstance(probe, Traction)}
        member = Member(self._next)
        self._next += 1
        self._runs[member] = run
        if settled_below is not None:
            self._settling[member] = Settling(settled_below, settled_beats)
        return member

    def retire(self, member: Member) -> None:
        """Drop a member; its slot is free."""
        del self._runs[member]
        self._settling.pop(member, None)

    def status(self, member: Member) -> Status:
        """Where a member stands."""
        return self._runs[member].status()

    def checkpoint(self, member: Member) -> Checkpoint:
        """The exact state of a member."""
        return self._runs[member].checkpoint()

    def packing(self, member: Member) -> Packing:
        """The portable state of a member."""
        return self._runs[member].packing()

    def put_back(self, member: Member, grains: Packing) -> None:
        """Put grains that left back into a member. Raises ValueError for grains that have not left."""
        self.put_back_all({member: grains})

    def put_back_all(self, grains: Mapping[Member, Packing]) -> None:
        """Put grains that left back into members. Raises ValueError, before any is changed, for grains that have not
        left."""
        if not grains:
            return
        with self.reading(grains):
            for member, own in grains.items():
                _check_absent(self._runs[member], own)
        runs = ((self._runs[member], own) for member, own in grains.items())
        self._put_back([(run, own, _half_step(run, own)) for run, own in runs])

    def _put_back(self, returning: Sequence[tuple[R, Packing, np.ndarray]]) -> None:
        """Put grains back into each run, with their velocities [m/s] at the time of those that are stored."""
        for run, grains, half_v in returning:
            run.put_back(grains, half_v)

    def set_velocities(self, member: Member, ids: np.ndarray, v: np.ndarray) -> None:
        """Give grains of a member other velocities. Raises ValueError for grains that are not there."""
        run = self._runs[member]
        if not np.isin(ids, run.present()).all():
            raise ValueError("set_velocities: some of these grains are not in the scene")
        run.set_velocities(ids, v)

    def close(self) -> None:
        """Free all arrays."""
        self._runs.clear()

    def _going(self) -> dict[Member, R]:
        """Members that take steps: those that failed or emptied rest."""
        return {member: run for member, run in self._runs.items() if run.failure is None and run.grains > 0}

    def _observed(self, runs: Mapping[Member, R]) -> Mapping[Probe, Table]:
        """Rows of the probes that are due after a beat of these members, and of frames within it; those that failed
        have none."""
        well = {member.index: run for member, run in runs.items() if run.failure is None}
        for run in well.values():
            run.take_frames()
        return read(well, self._spec.steps_per_beat)

    def _events(self, member: Member, run: R) -> list[Event]:
        """What happened in a beat; of a failed member, only that it failed."""
        if failure := run.failure:
            return [Failed(member, failure.guard, failure.step, failure.grain, failure.message)]
        if run.grains == 0:
            return [Emptied(member, run.time)]
        settling = self._settling.get(member)
        return [Settled(member, run.time)] if settling and settling.after(run.status().kinetic) else []

    def _keep(self, rows: Mapping[Probe, Table]) -> None:
        for probe, table in rows.items():
            if len(table["member"]):
                self._rows[probe].append(table)

    def drain(self) -> Mapping[Probe, Table]:
        """Rows since the last drain, of every declared probe."""
        rows, self._rows = self._rows, defaultdict(list)
        return {
            probe: _joined(rows[probe] or [empty_table(probe, self._spec.feature("ORIENTED"))])
            for probe in self._spec.probes
        }


def _check_absent(run: Standing, grains: Packing) -> None:
    """Raises ValueError for grains that have not left."""
    there = run.present()
    assert grains.ids is not None
    if len(np.unique([*there, *grains.ids])) < len(there) + len(grains):
        raise ValueError("put_back: some of these grains are still in the scene")
    if len(grains) and not (grains.ids.min() >= 0 and grains.ids.max() < run.scene.grains.count):
        raise ValueError(f"put_back: ids are not those of {run.scene.grains.count} grains")


def _half_step(run: Standing, grains: Packing) -> np.ndarray:
    """Velocities [m/s] of grains that come back, half a step before: nothing touches them, so that only gravity has
    acted. The first kick of a run starts at the whole step."""
    since = run.numerics.dt / 2 if run.step else 0.0
    return grains.v - np.array([0.0, 0.0, -run.scene.gravity]) * since


def check_read_by(spec: Spec, probes: Sequence[Probe]) -> None:
    """Raises ValueError unless members of `spec` can be read by these probes and no others."""
    if other := {*probes} - {*spec.probes}:
        raise ValueError(f"probes: the ensemble's Spec lacks {', '.join(map(repr, other))}")
    if left_out := [one for one in {*spec.probes} - {*probes} if isinstance(one, Crossing | Ledger)]:
        raise ValueError(f"probes: the kernels are compiled for {left_out[0]!r}, so every member must be read by it")


def _joined(tables: list[Table]) -> Table:
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


def check_checkpoint(
    can: Capabilities, names: set[str], stored: Checkpoint, newer: frozenset[str] = frozenset()
) -> None:
    """Raises ValueError if a checkpoint is not of this backend and version, or has other arrays than `names`; those in
    `newer`, older checkpoints may lack."""
    if (stored.backend, stored.cache_version) != (can.name, can.cache_version):
        raise ValueError(
            f"the checkpoint is of {stored.backend} version {stored.cache_version}, "
            f"not of {can.name} version {can.cache_version}"
        )
    if other := (names ^ set(stored.arrays)) - (newer - set(stored.arrays)):
        raise ValueError(f"the checkpoint has other arrays than this backend's state: {', '.join(sorted(other))}")


def explain(guard: str, grain: int, step: int, value: float, scene: Scene, numerics: Numerics) -> str:
    """Message of a failed guard: which grain, when, by how much, and what to change.

    guard: overlap, speed, spin, or state for all that is NaN or too large to be counted. value: overlap [m] or speed
    [m/s]; of no meaning for the others.
    """
    where = f"grain {grain} at step {step} ({span(step * numerics.dt)}, dt = {span(numerics.dt)})"
    if guard == "overlap" and math.isinf(value):
        return f"{where}: {TOO_MANY}"
    if guard == "overlap":
        overlap, limit = told_apart(value / scene.grains.finest, numerics.overlap_limit)
        return (
            f"{where} overlaps by {overlap} d, more than numerics.overlap_limit "
            f"({limit}); use a smaller numerics.dt or stiffer grains, or raise the limit"
        )
    if guard == "speed":
        speed, limit = told_apart(value, numerics.speed_limit)
        return (
            f"{where} moves at {speed} m/s, faster than numerics.speed_limit ({limit} m/s); "
            "use a smaller numerics.dt, or raise the limit if grains may be this fast"
        )
    what = "its spin is NaN" if guard == "spin" else "its velocity or a force on it is NaN or too large"
    return f"{where}: {what}; use a smaller numerics.dt"


def places(ascending: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Where each wanted key stands in an ascending array; -1 if nowhere."""
    if not len(ascending):
        return np.full(len(wanted), -1)
    at = np.searchsorted(ascending, wanted).clip(max=len(ascending) - 1)
    return np.where(ascending[at] == wanted, at, -1)
