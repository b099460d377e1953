"""Ensembles of all backends: members, rows of probes and events."""

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
from labbook.scene.quantities import format_distinct, span
from labbook_dem.features import covers, specialise
from labbook_dem.ledger import kinetic, status
from labbook_dem.mesh import TOO_MANY
from labbook_dem.reading import Readable, read
from labbook_dem.traction import BinTable

LONGEST = 2**53
"""Number of steps from which on times are not exact."""
NOT_RECORDED = math.inf
"""Largest overlap or speed after a checkpoint that lacks it: infinite, so that no later value exceeds it."""


@dataclass(frozen=True)
class Failure:
    """Reason why a check stopped a member; see `labbook.backend.Failed`."""

    guard: str
    step: int
    grain: int
    message: str


class MemberState(Readable):
    """State of a member that every backend provides."""

    failure: Failure | None

    @property
    @abstractmethod
    def grains(self) -> int:
        """Number of grains that have not left."""

    @abstractmethod
    def checkpoint(self) -> Checkpoint:
        """The exact state, copied."""

    @abstractmethod
    def packing(self) -> Packing:
        """The portable state."""

    @abstractmethod
    def extremes(self) -> tuple[float, float]:
        """Return the largest overlap [m] and speed [m/s] of all steps so far; NOT_RECORDED if a checkpoint lacked
        them."""

    @abstractmethod
    def present(self) -> np.ndarray:
        """Ids of the grains that have not left, in any order."""

    @abstractmethod
    def put_back(self, grains: Packing, half_v: np.ndarray) -> None:
        """Insert grains that left. half_v: their velocities [m/s] at the time of the stored ones, shape [n, 3]."""

    @abstractmethod
    def set_velocities(self, ids: np.ndarray, v: np.ndarray) -> None:
        """Set velocities [m/s] of grains: half a step before, and the predicted ones."""

    def energy(self) -> float:
        """Kinetic energy [J] at the time of positions."""
        now = self.look()
        return kinetic(now.bodies or self.scene.grains, now.v, now.m, now.q)

    def status(self) -> Status:
        """See `labbook.backend.Status`."""
        return status(self.scene, self.step, self.time, self.grains, self.energy(), *self.extremes())

    def progress(self) -> Status:
        """Status without the kinetic energy, which takes the forces of another step."""
        return status(self.scene, self.step, self.time, self.grains, math.nan, *self.extremes())


@dataclass
class Settling:
    """Criterion for a settled member.

    Args:
        below: limit of the kinetic energy per grain.
        beats: successive beats below the limit.
        beats_below: successive beats below the limit so far.
    """

    below: float
    beats: int
    beats_below: int = 0

    def after(self, kinetic: float) -> bool:
        """Count a beat with this kinetic energy per grain; return True at the beat that makes the member settled."""
        self.beats_below = self.beats_below + 1 if kinetic < self.below else 0
        # Equal, not at least: a member that stays at rest gives the event once.
        return self.beats_below == self.beats


R = TypeVar("R", bound=MemberState)


class Ensemble(backend.Ensemble, Generic[R]):
    """Base of the ensembles; see `labbook.backend.Ensemble`. A backend adds the start and the steps of a member."""

    def __init__(self, capabilities: Capabilities, spec: Spec):
        self._can, self._spec = capabilities, spec
        self._runs: dict[Member, R] = {}
        self._settling: dict[Member, Settling] = {}
        self._last_status: dict[Member, Status] = {}
        """Status after the last beat, of members whose rest is looked for: the energy takes the forces of a step."""
        self._rows: dict[Probe, list[Table]] = defaultdict(list)
        self._next = 0

    def _specialise(self, scene: Scene, numerics: Numerics) -> Spec:
        return specialise(self._can, scene, numerics, self._spec.probes)

    @abstractmethod
    def _begin(self, scene: Scene, numerics: Numerics, start: Packing | Checkpoint) -> R: ...

    @abstractmethod
    def advance(self, beats: int = 1) -> Sequence[Event]:
        """Take `beats` beats with every member; failed and empty ones rest."""

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
        """Add a member; see `labbook.backend.Ensemble`.

        Raises:
            ValueError: it needs features that this ensemble's Spec lacks, or has no grains.
        """
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
        """Drop a member and free its slot."""
        del self._runs[member]
        self._settling.pop(member, None)
        self._last_status.pop(member, None)

    def status(self, member: Member) -> Status:
        """Status of a member."""
        run, last = self._runs[member], self._last_status.get(member)
        # reading a state may drop grains that are far below the outlet
        if last is not None and (last.step, last.grains) == (run.step, run.grains):
            return last
        return run.status()

    def progress(self, member: Member) -> Status:
        """Status of a member without its kinetic energy."""
        return self._runs[member].progress()

    def checkpoint(self, member: Member) -> Checkpoint:
        """The exact state of a member."""
        return self._runs[member].checkpoint()

    def packing(self, member: Member) -> Packing:
        """The portable state of a member."""
        return self._runs[member].packing()

    def put_back(self, member: Member, grains: Packing) -> None:
        """Insert grains that left into a member. Raises ValueError for grains that have not left."""
        self.put_back_all({member: grains})

    def put_back_all(self, grains: Mapping[Member, Packing]) -> None:
        """Insert grains that left into members. Raises ValueError for grains that have not left, before any change."""
        if not grains:
            return
        with self.reading(grains):
            for member, returning in grains.items():
                _check_absent(self._runs[member], returning)
        for member in grains:
            self._last_status.pop(member, None)
        runs = ((self._runs[member], returning) for member, returning in grains.items())
        self._put_back([(run, returning, _half_step(run, returning)) for run, returning in runs])

    def _put_back(self, returning: Sequence[tuple[R, Packing, np.ndarray]]) -> None:
        """Insert grains into each run, with their velocities [m/s] at the time of the stored ones."""
        for run, grains, half_v in returning:
            run.put_back(grains, half_v)

    def set_velocities(self, member: Member, ids: np.ndarray, v: np.ndarray) -> None:
        """Set velocities of grains of a member. Raises ValueError for grains that are not present."""
        run = self._runs[member]
        if not np.isin(ids, run.present()).all():
            raise ValueError("set_velocities: some of these grains are not in the scene")
        self._last_status.pop(member, None)
        run.set_velocities(ids, v)

    def close(self) -> None:
        """Free all arrays."""
        self._runs.clear()

    def _going(self) -> dict[Member, R]:
        """Members that take steps: failed and empty ones rest."""
        return {member: run for member, run in self._runs.items() if run.failure is None and run.grains > 0}

    def _observed(self, runs: Mapping[Member, R]) -> Mapping[Probe, Table]:
        """Rows of the probes that are due after a beat of these members, with frames within it; failed members have
        none."""
        valid = {member.index: run for member, run in runs.items() if run.failure is None}
        for run in valid.values():
            run.take_frames()
        return read(valid, self._spec.steps_per_beat)

    def _events(self, member: Member, run: R) -> list[Event]:
        """Events of a beat; for a failed member, only its failure."""
        if failure := run.failure:
            return [Failed(member, failure.guard, failure.step, failure.grain, failure.message)]
        if run.grains == 0:
            return [Emptied(member, run.time)]
        # The kinetic energy is a sum over all grains: it is computed only for members whose rest is looked for.
        settling = self._settling.get(member)
        if settling is None:
            return []
        self._last_status[member] = now = run.status()
        return [Settled(member, run.time)] if settling.after(now.kinetic) else []

    def _keep(self, rows: Mapping[Probe, Table]) -> None:
        for probe, table in rows.items():
            if len(table["member"]):
                self._rows[probe].append(table)

    def drain(self) -> Mapping[Probe, Table]:
        """Return the rows since the last drain, of every declared probe."""
        # Tables of probes without a row are there too, with their columns: readers need not know which were due.
        rows, self._rows = self._rows, defaultdict(list)
        return {
            probe: _joined(rows[probe] or [empty_table(probe, self._spec.feature("ORIENTED"))])
            for probe in self._spec.probes
        }


def _check_absent(run: MemberState, grains: Packing) -> None:
    """Raise ValueError for grains that have not left."""
    assert grains.ids is not None
    count = run.scene.grains.count
    if len(grains) and not (grains.ids.min() >= 0 and grains.ids.max() < count):
        raise ValueError(f"put_back: ids are not those of {count} grains")
    if (np.bincount(run.present(), minlength=count) + np.bincount(grains.ids, minlength=count)).max(initial=0) > 1:
        raise ValueError("put_back: some of these grains are still in the scene")


def _half_step(run: MemberState, grains: Packing) -> np.ndarray:
    """Velocities [m/s] of returning grains half a step before: they touch nothing, so that only gravity has acted.

    The first kick of a run starts at the whole step.
    """
    since = run.numerics.dt / 2 if run.step else 0.0
    return grains.v - np.array([0.0, 0.0, -run.scene.gravity]) * since


def check_read_by(spec: Spec, probes: Sequence[Probe]) -> None:
    """Raise ValueError unless members of `spec` can be read by exactly these probes."""
    if undeclared := {*probes} - {*spec.probes}:
        raise ValueError(f"probes: the ensemble's Spec lacks {', '.join(map(repr, undeclared))}")
    if missing := [one for one in {*spec.probes} - {*probes} if isinstance(one, Crossing | Ledger)]:
        raise ValueError(f"probes: the kernels are compiled for {missing[0]!r}, so every member must be read by it")


def _joined(tables: list[Table]) -> Table:
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


def check_checkpoint(
    can: Capabilities, names: set[str], stored: Checkpoint, newer: frozenset[str] = frozenset()
) -> None:
    """Check backend, version and names of arrays of a checkpoint.

    Args:
        can: capabilities of the backend.
        names: names of the arrays.
        stored: the checkpoint.
        newer: names that older checkpoints may lack.

    Raises:
        ValueError: the checkpoint does not fit.
    """
    if (stored.backend, stored.cache_version) != (can.name, can.cache_version):
        raise ValueError(
            f"the checkpoint is of {stored.backend} version {stored.cache_version}, "
            f"not of {can.name} version {can.cache_version}"
        )
    if mismatched := (names ^ set(stored.arrays)) - (newer - set(stored.arrays)):
        raise ValueError(f"the checkpoint has other arrays than this backend's state: {', '.join(sorted(mismatched))}")


def explain(guard: str, grain: int, step: int, value: float, scene: Scene, numerics: Numerics) -> str:
    """Message of a failed check: grain, time, size, and the remedy.

    Args:
        guard: overlap, speed, spin, or state for all else that is NaN or too large for the quanta.
        grain: id of the grain.
        step: step of the failure.
        value: overlap [m], infinite if the grain has too many contacts with a mesh; or speed [m/s]; unused for the
            others.
        scene: scene of the member; overlaps are stated in its smallest diameter.
        numerics: its time step, and the limits that the message names.
    """
    where = f"grain {grain} at step {step} ({span(step * numerics.dt)}, dt = {span(numerics.dt)})"
    if guard == "overlap" and math.isinf(value):
        return f"{where}: {TOO_MANY}"
    if guard == "overlap":
        overlap, limit = format_distinct(value / scene.grains.finest, numerics.overlap_limit)
        return (
            f"{where} overlaps by {overlap} d, more than numerics.overlap_limit "
            f"({limit}); use a smaller numerics.dt or stiffer grains, or raise the limit"
        )
    if guard == "speed":
        speed, limit = format_distinct(value, numerics.speed_limit)
        return (
            f"{where} moves at {speed} m/s, faster than numerics.speed_limit ({limit} m/s); "
            "use a smaller numerics.dt, or raise the limit if grains may be this fast"
        )
    cause = "its spin is NaN" if guard == "spin" else "its velocity or a force on it is NaN or too large"
    return f"{where}: {cause}; use a smaller numerics.dt"


def indices(ascending: np.ndarray, keys: np.ndarray) -> np.ndarray:
    """Index of each key in an ascending array, -1 if it is missing."""
    if not len(ascending):
        return np.full(len(keys), -1)
    index = np.searchsorted(ascending, keys).clip(max=len(ascending) - 1)
    return np.where(ascending[index] == keys, index, -1)
