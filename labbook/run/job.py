"""One computation, from its start or its last save to its folder in the lab."""

import shutil
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from labbook.backend import Backend, Checkpoint, EndState, Ensemble, Event, Failed, Member, Status
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Probe, Table
from labbook.filling import Refill
from labbook.lab.folder import Claim, LabFolder, room
from labbook.lab.identity import Keys
from labbook.lab.index import RunRows
from labbook.lab.journal import Journal, Saved
from labbook.lab.packings import PackingRecord
from labbook.lab.provenance import now, provenance
from labbook.lab.records import Session, Unreadable
from labbook.plan.demand import Demand
from labbook.scene import Scene
from labbook.scene.packing import Packing
from labbook.study.extensions import used_by_runs


@dataclass(frozen=True)
class Bench:
    """Where jobs are done: lab, backend and device."""

    lab: LabFolder
    backend: Backend
    device: str


@dataclass(frozen=True)
class LabEntry:
    """Rows for the index of a job that is in the lab, and the packing with its record if it made one."""

    rows: RunRows
    packing: tuple[PackingRecord, Packing] | None = None


@dataclass(frozen=True)
class Kept(ABC):
    """What a job that has ended keeps. It stands apart from the job: another process can put it into the lab."""

    lab: LabFolder
    key: str
    place: Path
    label: str

    @abstractmethod
    def fill_folder(self, folder: Path) -> None:
        """Write it into the new `folder`, which is synchronised later. Raises Unreadable for rows that were saved and
        cannot be read."""

    @abstractmethod
    def entry(self) -> LabEntry:
        """Return what the lab has of it, once this object has put it there; nothing is read again."""

    @abstractmethod
    def reread(self) -> LabEntry:
        """Return what the lab has of it by what lies there, where another process has put it."""

    def put(self) -> None:
        """Put it into the lab, by one rename. Raises DiskFull, or JobFailed with the last state saved."""
        made = self.lab.work(self.key) / "done"
        with room(made):
            shutil.rmtree(made, ignore_errors=True)
            made.mkdir(parents=True)  # `put` makes it durable
            try:
                self.fill_folder(made)
            except Unreadable as problem:
                raise JobFailed(
                    f"{self.label}: {problem}; give the same command again, and it starts from step 0"
                ) from problem
            self.lab.put(made, self.place)
        self.lab.clear(self.key)


class JobFailed(Exception):
    """A job cannot give what others wait for; the message says why and what to do. Its last state is kept."""


class Job(ABC):
    """A member of an ensemble, with its book-keeping. It holds the claim of its key until it is released."""

    kind: ClassVar[str]
    scene: Scene
    probes: tuple[Probe, ...] = ()
    settled_below: float | None = None
    settled_beats: int = 3

    def __init__(self, bench: Bench, demand: Demand, keys: Keys, key: str, place: Path, claim: Claim):
        self.bench, self.demand, self.keys, self.key, self.place = bench, demand, keys, key, place
        self._claim = claim
        self.journal = Journal(bench.lab.work(key))
        self.damaged: dict[Path, str] = {}
        """Why what was found of it, by folder, could not be taken up."""
        self._rows: dict[str, list[Table]] = {}
        self.unsaved = 0
        """Bytes of the rows since the last save."""
        self._earlier: tuple[Session, ...] = ()
        self._from, self._started = 0, now()
        self._wall = self._process = self._grain_steps = 0.0
        self.status = Status(0, 0.0, demand.point.scene.grains.count, float("inf"))

    @property
    def numerics(self) -> Numerics:
        """How it is computed."""
        return self.demand.shared.numerics

    @property
    def declared(self) -> tuple[Probe, ...]:
        """The probes of the ensemble that takes it: its own, and those of others that may go on beside it."""
        return self.probes

    @property
    def stage(self) -> int:
        """Number of the scene that it is stepped in now; it changes with a verdict that lets it go on."""
        return 0

    @property
    def stepped(self) -> Scene:
        """The scene that it is stepped in now."""
        return self.scene

    @property
    def widest(self) -> Scene:
        """The scene, of all its stages, that needs most of the kernels."""
        return self.scene

    # what jobs differ in

    @abstractmethod
    def fresh(self) -> Packing:
        """The start of a job that was never saved. Raises JobFailed."""

    @abstractmethod
    def recall(self, saved: Saved | None) -> Saved | None:
        """Take up what was saved, in the work folder or elsewhere; None to start afresh. Raises Unreadable if it cannot
        be taken up."""

    @abstractmethod
    def state(self) -> dict[str, Any]:
        """What `recall` needs beside checkpoint and rows."""

    @abstractmethod
    def absorb(self, probe: Probe, table: Table) -> None:
        """Take rows that were observed."""

    @abstractmethod
    def verdict(self, events: Sequence[Event]) -> str | None:
        """How it ended, or None while it goes on."""

    @abstractmethod
    def kept(self, verdict: str, left: EndState) -> Kept:
        """What is kept of it. Raises DiskFull, or JobFailed if that is nothing, with the last state saved."""

    @abstractmethod
    def progress(self) -> float:
        """Part of the work that is done, from 0 to 1, as far as can be told."""

    @property
    def looks(self) -> bool:
        """True if `look` reads the state after this beat: the verdict, or a picture, needs more than `status` has."""
        return False

    def look(self, ensemble: Ensemble, member: Member) -> None:
        """Read the state after a beat."""
        return

    @property
    def lacks_grains(self) -> bool:
        """True if grains that left come back after this beat."""
        return False

    def refill(self, bed: Packing) -> Refill:
        """Return this bed and what brings its grains. Only of a job that lacks grains."""
        raise NotImplementedError

    def refilled(self, grains: Packing) -> None:
        """Note that these grains have entered."""
        return

    @property
    def pauses(self) -> bool:
        """True if the flow may have stopped, so that `intervene` looks at the bed after this beat."""
        return False

    def intervene(self, ensemble: Ensemble, member: Member, bed: Packing) -> None:
        """Note a stop of the flow, and break the arch that holds it, in a member whose bed this is."""
        return

    @abstractmethod
    def doing(self) -> tuple[str, ...]:
        """How far it is, for people: parts of a line, the most telling one first."""

    @property
    def open_ended(self) -> bool:
        """Whether it goes on for longer than expected, so that nobody can tell how long."""
        return False

    def warning(self) -> str | None:
        """What the user has to know now, once; None if there is nothing."""
        return None

    @property
    def may_save(self) -> bool:
        """Whether a restart from here would go on exactly as without it."""
        return True

    # what they share

    def begin(self) -> Packing | Checkpoint:
        """Where the member starts: at the last save, else afresh. Raises JobFailed."""
        self.bench.lab.mend(self.key, self.place)
        try:
            saved = self.recall(self.journal.restore())
        except Unreadable as problem:
            self.damaged[self.journal.folder] = f"{problem}; it starts from step 0"
            self.start_over()
            saved = self.recall(None)
        if saved is None:
            return self.fresh()
        self._earlier = saved.sessions
        self._from = saved.step
        return saved.checkpoint

    def start_over(self) -> None:
        """Forget what is in the work folder."""
        self.bench.lab.clear(self.key)
        self.journal = Journal(self.bench.lab.work(self.key))

    def check(self, saved: Saved, where: Path) -> None:
        """Whether the backend can go on from what was saved in `where`. Raises Unreadable."""
        backend = self.bench.backend
        own = backend.capabilities.name, backend.capabilities.cache_version
        try:
            if (saved.checkpoint.backend, saved.checkpoint.cache_version) != own:
                raise ValueError(f"made by {saved.checkpoint.backend} version {saved.checkpoint.cache_version}")
            backend.verify(self.scene, self.numerics, saved.checkpoint, saved.step)
        except ValueError as error:
            raise Unreadable(f"{where}: the run cannot go on from the checkpoint: {error}") from error

    @property
    def resumed(self) -> bool:
        """Whether it goes on from an earlier session."""
        return self._from > 0

    def after(
        self, status: Status, tables: Mapping[Probe, Table], wall: float, process: float, grain_steps: float
    ) -> None:
        """Account for an advance that led to `status`, observed `tables`, and took `wall` and `process`
        seconds."""
        self.status = status
        self._wall += wall
        self._process += process
        self._grain_steps += grain_steps
        for probe, table in tables.items():
            self.absorb(probe, table)

    def keep(self, name: str, table: Table) -> None:
        """Add rows to a table of this job, which is kept even if it stays empty."""
        kept = self._rows.setdefault(name, [])
        if not kept or len(table["step"]):
            kept.append(table)
            self.unsaved += sum(column.nbytes for column in table.values())

    def save(self, ensemble: Ensemble, member: Member) -> None:
        """Write an exact checkpoint and the rows up to it. Raises DiskFull."""
        if self.may_save:
            self._write(ensemble.checkpoint(member))

    def _write(self, checkpoint: Checkpoint) -> None:
        self.journal.save(checkpoint, self._rows, {"step": self.status.step, **self.state()}, self.sessions())
        self._rows, self.unsaved = {}, 0

    def release(self) -> None:
        """Let others claim the key."""
        self._claim.release()

    def sessions(self) -> tuple[Session, ...]:
        """The stretches in which it was computed, this one last."""
        used = used_by_runs(self.demand.point, self.bench.backend.capabilities.name)
        this = Session(
            from_step=self._from,
            to_step=self.status.step,
            started=self._started,
            wall_time=self._wall,
            process_time=self._process,
            grain_steps=self._grain_steps,
            provenance=provenance(self.bench.device, used),
        )
        return (*self._earlier, this)

    def tables(self) -> dict[str, Any]:
        """All rows, saved or not, by table name."""
        return self.journal.tables(self._rows)

    @property
    def work(self) -> float:
        """Grain-steps that it took so far, in all sessions."""
        return sum(one.grain_steps for one in self._earlier) + self._grain_steps

    @property
    def label(self) -> str:
        """For people: what, where, which repeat."""
        return f"{self.kind} of {self.demand.point.label}, {self.demand.repeat}"


def failure(events: Sequence[Event]) -> Failed | None:
    """The failure among `events`, if there is one."""
    return next((event for event in events if isinstance(event, Failed)), None)
