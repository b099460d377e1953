"""One computation, a filling or a discharge, from its start or last save to its folder in the lab."""

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
from labbook.scene import BedTop, Packing, Scene
from labbook.study.extensions import used_by_runs


@dataclass(frozen=True)
class JobContext:
    """Lab, backend and device of jobs."""

    lab: LabFolder
    backend: Backend
    device: str


@dataclass(frozen=True)
class BeatCost:
    """Cost of one beat of a job.

    Args:
        wall: Wall time [s].
        process: Share of the CPU time [s].
        device: Share of the time of the device [s].
        grain_steps: Number of grain-steps.
    """

    wall: float
    process: float
    device: float
    grain_steps: float


@dataclass(frozen=True)
class LabEntry:
    """Index rows of a job whose output is in the lab; for a filling also the packing with its record."""

    rows: RunRows
    packing: tuple[PackingRecord, Packing] | None = None


@dataclass(frozen=True)
class JobOutput(ABC):
    """Output of an ended job, independent of the job: another process can put it into the lab.

    Args:
        lab: Folder of the lab.
        key: Key of the run or packing.
        folder: Final folder of the output.
        label: Name of the job for messages.
    """

    lab: LabFolder
    key: str
    folder: Path
    label: str

    @abstractmethod
    def fill_folder(self, folder: Path) -> None:
        """Write the output into the new `folder`, which is synchronised later. Raises Unreadable if saved rows cannot
        be read."""

    @abstractmethod
    def entry(self) -> LabEntry:
        """Return the lab entry after `put`, from memory."""

    @abstractmethod
    def reread(self) -> LabEntry:
        """Return the lab entry from the folder, where another process has put it."""

    def put(self) -> None:
        """Put the output into the lab, by one rename.

        Raises:
            DiskFull: The disk is full.
            JobFailed: Saved rows cannot be read.
        """
        folder = self.lab.work(self.key) / "done"
        with room(folder):
            # what a killed process has left there may be incomplete
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)  # `put` makes it durable
            try:
                self.fill_folder(folder)
            except Unreadable as problem:
                raise JobFailed(
                    f"{self.label}: {problem}; give the same command again, and it starts from step 0"
                ) from problem
            self.lab.put(folder, self.folder)
        self.lab.clear(self.key)  # after `put`: until then the last save may be needed


class JobFailed(Exception):
    """A job cannot give its result; the message gives the reason and a remedy. Its last state is kept."""


class Job(ABC):
    """A member of an ensemble with its bookkeeping: status, rows, saves, sessions. It holds the claim of its key.

    Subclasses define the start, the restart from a save, and the verdict.

    Args:
        context: Lab, backend and device.
        demand: Run that is demanded, or whose packing is.
        keys: Keys of that run.
        key: Key of the job: that of the run or of the packing.
        folder: Folder of the result.
        claim: Claim of `key`.

    Attributes:
        scene: Scene of the job.
        probes: Probes whose rows it needs.
        settled_below: Kinetic energy per grain [m g d] below which the backend counts beats at rest; None: it does not.
        settled_beats: Number of such beats after which the backend reports `Settled`.
    """

    kind: ClassVar[str]
    scene: Scene
    probes: tuple[Probe, ...] = ()
    settled_below: float | None = None
    settled_beats: int = 3

    def __init__(self, context: JobContext, demand: Demand, keys: Keys, key: str, folder: Path, claim: Claim):
        self.context, self.demand, self.keys, self.key, self.folder = context, demand, keys, key, folder
        self._claim = claim
        self.journal = Journal(context.lab.work(key))
        self.damaged: dict[Path, str] = {}
        """Problems of saved states that could not be used, by folder."""
        self._rows: dict[str, list[Table]] = {}
        self.unsaved = 0
        """Size of the rows since the last save [bytes]."""
        self._earlier_sessions: tuple[Session, ...] = ()
        self._first_step, self._started = 0, now()
        self._wall = self._process = self._device = self._grain_steps = 0.0
        # with infinite kinetic energy: before its first beat no job is at rest
        self.status = Status(0, 0.0, demand.point.scene.grains.count, float("inf"))

    @property
    def numerics(self) -> Numerics:
        """Numerics of the job."""
        return self.demand.shared.numerics

    @property
    def declared(self) -> tuple[Probe, ...]:
        """Probes of the ensemble: those of this job and of others that may be stepped with it."""
        return self.probes

    @property
    def stage(self) -> int:
        """Number of the present stage; it rises in `verdict` when a stage ends. Each stage may have its own scene."""
        return 0

    @property
    def stepped(self) -> Scene:
        """Scene of the present stage."""
        return self.scene

    @property
    def widest(self) -> Scene:
        """Scene, among those of all stages, that needs the most kernel features."""
        return self.scene

    # what jobs differ in

    @abstractmethod
    def fresh(self) -> Packing:
        """Return the start of a job that has no save. Raises JobFailed."""

    @abstractmethod
    def recall(self, saved: Saved | None) -> Saved | None:
        """Restore the job's state from a save, in the work folder or elsewhere.

        Args:
            saved: Last save in the work folder; None without one.

        Returns:
            The save to continue from; None to start afresh.

        Raises:
            Unreadable: The save cannot be used.
        """

    @abstractmethod
    def state(self) -> dict[str, Any]:
        """Return the values that `recall` needs beside checkpoint and rows, as JSON."""

    @abstractmethod
    def absorb(self, probe: Probe, table: Table) -> None:
        """Process the rows of a probe since the last beat."""

    @abstractmethod
    def verdict(self, events: Sequence[Event]) -> str | None:
        """Decide how the job has ended; None while it goes on. `events`: events of the member in the last beat."""

    @abstractmethod
    def output(self, verdict: str, end_state: EndState) -> JobOutput:
        """Return the output of an ended job.

        Args:
            verdict: Its verdict.
            end_state: Packing and checkpoint at its end.

        Raises:
            DiskFull: The last state cannot be saved.
            JobFailed: There is no result; the last state is saved.
        """

    @abstractmethod
    def progress(self) -> float:
        """Return the fraction of the work that is done, from 0 to 1, as far as it is known."""

    @property
    def looks(self) -> bool:
        """True if `look` has to read the state after this beat, since `status` is not enough for the verdict or a
        picture."""
        return False

    def look(self, ensemble: Ensemble, member: Member) -> None:
        """Read the state of the member after a beat."""
        return

    @property
    def needs_refill(self) -> bool:
        """True if grains are put into the member after this beat."""
        return False

    @property
    def floor(self) -> float:
        """Height z [m] above which grains of the bed may be in the way of new ones. Only if the job lacks grains."""
        raise NotImplementedError

    def refill(self, bed: BedTop) -> Refill:
        """Return the bed above the floor with the source of new grains. Only called if the job lacks grains."""
        raise NotImplementedError

    def refilled(self, grains: Packing) -> None:
        """Count grains that have been put into the member."""
        return

    @property
    def pauses(self) -> bool:
        """True if the flow may have stopped, so that `break_arch` examines the bed after this beat."""
        return False

    def break_arch(self, ensemble: Ensemble, member: Member, bed: Packing) -> None:
        """Record a stop of the flow, and break the arch. `bed`: present packing of the member."""
        return

    @abstractmethod
    def doing(self) -> tuple[str, ...]:
        """Return the progress in words: parts of a line, the most important first."""

    @property
    def open_ended(self) -> bool:
        """True if the job takes longer than expected, so that its end cannot be forecast."""
        return False

    def warning(self) -> str | None:
        """Return a warning for the user, once; None if there is none."""
        return None

    @property
    def may_save(self) -> bool:
        """True if a restart from the present state would give the same bits."""
        return True

    # what they share

    def begin(self) -> Packing | Checkpoint:
        """Return the start of the member: its last save, else a fresh start. Raises JobFailed."""
        self.context.lab.recover(self.key, self.folder)  # a `put` that a killed process left half done
        try:
            saved = self.recall(self.journal.restore())
        except Unreadable as problem:
            self.damaged[self.journal.folder] = f"{problem}; it starts from step 0"
            self.start_over()
            saved = self.recall(None)
        if saved is None:
            return self.fresh()
        self._earlier_sessions = saved.sessions
        self._first_step = saved.step
        return saved.checkpoint

    def start_over(self) -> None:
        """Remove all saves."""
        self.context.lab.clear(self.key)
        self.journal = Journal(self.context.lab.work(self.key))

    def check(self, saved: Saved, where: Path) -> None:
        """Check that the backend can continue from a save. `where`: folder of the save, for messages. Raises
        Unreadable."""
        backend = self.context.backend
        own = backend.capabilities.name, backend.capabilities.cache_version
        try:
            # a state of another version could be restored, but would not continue bit for bit
            if (saved.checkpoint.backend, saved.checkpoint.cache_version) != own:
                raise ValueError(f"made by {saved.checkpoint.backend} version {saved.checkpoint.cache_version}")
            backend.verify(self.scene, self.numerics, saved.checkpoint, saved.step)
        except ValueError as error:
            raise Unreadable(f"{where}: the run cannot go on from the checkpoint: {error}") from error

    @property
    def resumed(self) -> bool:
        """True if the job continues an earlier session."""
        return self._first_step > 0

    def status_of(self, ensemble: Ensemble, member: Member) -> Status:
        """Read the status of its member; a job that needs no kinetic energy leaves it out."""
        return ensemble.status(member)

    def after(self, status: Status, tables: Mapping[Probe, Table], cost: BeatCost) -> None:
        """Account for a beat.

        Args:
            status: Status of the member after it.
            tables: Rows since the last beat, by probe.
            cost: Cost of the beat.
        """
        self.status = status
        self._wall += cost.wall
        self._process += cost.process
        self._device += cost.device
        self._grain_steps += cost.grain_steps
        for probe, table in tables.items():
            self.absorb(probe, table)

    def keep(self, name: str, table: Table) -> None:
        """Add rows to a table of this job; a first empty table is kept too."""
        tables = self._rows.setdefault(name, [])
        if not tables or len(table["step"]):  # the empty one gives the columns of a table that stays without rows
            tables.append(table)
            self.unsaved += sum(column.nbytes for column in table.values())

    def save(self, ensemble: Ensemble, member: Member) -> None:
        """Write an exact checkpoint and the rows up to it, if `may_save` is set. Raises DiskFull."""
        if self.may_save:
            self._write(ensemble.checkpoint(member))

    def _write(self, checkpoint: Checkpoint) -> None:
        self.journal.save(checkpoint, self._rows, {"step": self.status.step, **self.state()}, self.sessions())
        self._rows, self.unsaved = {}, 0

    def release(self) -> None:
        """Release the claim of the key."""
        self._claim.release()

    def sessions(self) -> tuple[Session, ...]:
        """Return all sessions of the computation, the present one last."""
        extensions = used_by_runs(self.demand.point, self.context.backend.capabilities.name)
        current = Session(
            from_step=self._first_step,
            to_step=self.status.step,
            started=self._started,
            wall_time=self._wall,
            process_time=self._process,
            grain_steps=self._grain_steps,
            device_time=self._device,
            provenance=provenance(self.context.device, extensions),
        )
        return (*self._earlier_sessions, current)

    def tables(self) -> dict[str, Any]:
        """Return all rows, saved or not, by table name."""
        return self.journal.tables(self._rows)

    @property
    def work(self) -> float:
        """Grain-steps in all sessions."""
        return sum(session.grain_steps for session in self._earlier_sessions) + self._grain_steps

    @property
    def label(self) -> str:
        """Name of the job for messages: kind, point, seed."""
        return f"{self.kind} of {self.demand.point.label}, {self.demand.repeat}"


def failure(events: Sequence[Event]) -> Failed | None:
    """Return the first failure among events; None without any."""
    return next((event for event in events if isinstance(event, Failed)), None)
