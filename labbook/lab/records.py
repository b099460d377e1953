"""Records of finished runs (`run.json`) and packings, in their folders."""

import hashlib
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    StrictBool,
    StrictInt,
    TypeAdapter,
    ValidationError,
    field_validator,
    model_validator,
)
from typing_extensions import TypedDict

from labbook.backend.numerics import Numerics
from labbook.backend.probes import parse_probe
from labbook.filling import Kick
from labbook.lab.folder import open_file, write_bytes
from labbook.measure import Window, scales
from labbook.measure.measure import after_start_up
from labbook.scene import Scene
from labbook.study.schema import names_a_study


def _without_nul(text: str) -> str:
    if "\0" in text:
        raise ValueError("it has a NUL character")
    return text


def _names_a_study(name: str) -> str:
    if not names_a_study(name):
        raise ValueError(f"{name!r} is not the name of a study: letters, digits, - and _, beginning with a letter")
    return name


Whole = Annotated[int, Field(ge=0, lt=2**63)]
"""Count, or another non-negative integer that SQLite can store."""
StudyName = Annotated[str, AfterValidator(_names_a_study)]
"""Name of a study, valid as a file name: pages and notes are found by it."""
Measure = Annotated[float, Field(ge=0, allow_inf_nan=False)]
"""Non-negative finite number: a time, a length or a fraction."""
Text = Annotated[str, AfterValidator(_without_nul)]
"""Line of text that every database can store."""
OptionalMeasure = Annotated[Measure | None, Field(exclude_if=lambda stated: stated is None)]
"""Optional non-negative number; None is left out of what is stored."""
RunKey = Annotated[str, Field(pattern="^[0-9a-f]{8,64}$")]
StoredVersions = Annotated[
    dict[Text, Annotated[int, Field(gt=1, lt=2**31)] | Annotated[str, Field(pattern="^[0-9a-f]{8,64}$")]],
    Field(exclude_if=lambda versions: not versions),
]
"""Formula versions above 1 and source hashes of extensions (`labbook.lab.identity.Versions`); left out where there are
none."""
StoredBackend = Annotated[Text, Field(validation_alias="engine", serialization_alias="engine")]
"""Name of a backend; files have it under the key `engine`."""
MAX_FRAMES_BEFORE = 200
"""Maximum number of frames in older recordings."""
MAX_RECORD_BYTES = 2**26
"""Maximum size of a record: that of some 10^4 sessions."""


class Unreadable(Exception):
    """The content of a folder cannot be used; the message names file and reason."""


class StoredModel(BaseModel):
    """Frozen part of a record; an unknown key is an error."""

    # "constants": the rule of a fed bed has an infinite `discharged`, which JSON would else store as null
    model_config = ConfigDict(frozen=True, extra="forbid", ser_json_inf_nan="constants", validate_by_name=True)

    def as_stored(self) -> bytes:
        """Return the JSON that a file holds."""
        return (self.model_dump_json(indent=1, by_alias=True) + "\n").encode()


class Provenance(TypedDict, total=False):
    """Entries of a session's provenance that the code uses; other entries are only shown as text."""

    __pydantic_config__ = ConfigDict(extra="allow")  # pyright: ignore[reportGeneralTypeIssues]

    commit: Text | None
    dirty: StrictBool | None
    packages: dict[Text, Text]
    python: Text
    system: Text
    processor: Text
    threads: StrictInt
    machine: Text
    gpu: dict[Text, Text]


_PROVENANCE = TypeAdapter(Provenance)


def _is_provenance(values: dict[str, Any]) -> dict[str, Any]:
    """Validate a provenance and return it unchanged: a record is written again with the bytes that were read."""
    try:
        _PROVENANCE.validate_python(values)
    except ValidationError as error:
        raise ValueError(_first_problem(error)) from None
    return values


def _first_problem(error: ValidationError) -> str:
    """Place and text of the first error in a file."""
    first = error.errors()[0]
    return ": ".join(filter(None, (".".join(map(str, first["loc"])), first["msg"].removeprefix("Value error, "))))


class Session(StoredModel):
    """Part of a computation that ran within one process."""

    from_step: Whole
    to_step: Whole
    started: Text
    """UTC, ISO 8601."""
    wall_time: Measure
    """Wall time spent stepping [s]."""
    process_time: Measure
    """Share of the process's CPU time while stepping [s]."""
    grain_steps: Measure
    device_time: OptionalMeasure = None
    """Time of the device [s]: of each beat the wall time times the share of the ensemble's grain-steps. The first beat
    of a process does not count, since kernels are compiled in it. A core counts as a device. None in older files."""
    provenance: Annotated[dict[str, Any], AfterValidator(_is_provenance)] = {}


class FolderRecord(StoredModel):
    """Record of a folder: how its content was computed, in one or more sessions.

    Subclasses state `FILE`, the name of the record's file, and `KEY`, the field with the key by which the folder is
    named.
    """

    FILE: ClassVar[str]
    KEY: ClassVar[str]

    seal: Annotated[str | None, Field(pattern="^[0-9a-f]{32}$", exclude_if=lambda seal: seal is None)] = None
    """Checksum of the whole file with zeros in place of this field, which shows every changed bit; None in older
    files."""
    sessions: Annotated[tuple[Session, ...], Field(min_length=1)]

    @property
    def wall_time(self) -> float:
        """Wall time spent stepping [s], in all sessions."""
        return sum(session.wall_time for session in self.sessions)

    @property
    def process_time(self) -> float:
        """CPU time spent stepping [s], in all sessions."""
        return sum(session.process_time for session in self.sessions)

    @property
    def device_time(self) -> float | None:
        """Device time [s], in all sessions; None if it is not known of all of them."""
        times = [session.device_time for session in self.sessions]
        return None if any(time is None for time in times) else sum(time for time in times if time is not None)

    @property
    def rate(self) -> float:
        """Grain-steps per second of wall time; NaN if nothing was stepped."""
        wall = self.wall_time
        return sum(session.grain_steps for session in self.sessions) / wall if wall else float("nan")

    @property
    def machine(self) -> str | None:
        """Processor, and device, of the last session."""
        return self.sessions[-1].provenance.get("machine")

    def write(self, folder: Path, *, durable: bool = True) -> None:
        """Write the record into `folder`, with its checksum; `durable`: synchronise it with the disk."""
        # The checksum is of the bytes with zeros in its own place, not of parsed values: so it shows every changed bit.
        text = self.model_copy(update={"seal": _UNSEALED}).as_stored()
        sealed = text.replace(_UNSEALED.encode(), _seal(text).encode(), 1)
        write_bytes(folder / self.FILE, sealed, durable=durable)

    @classmethod
    def read(cls, folder: Path, key: str | None = None) -> Self:
        """Read the record in `folder` and check it.

        Args:
            folder: Folder of a run or packing.
            key: Key that the folder will be named by; None: its name is the key.

        Raises:
            Unreadable: The file is missing, damaged, or belongs to another key.
        """
        path, key = folder / cls.FILE, key or folder.name
        try:
            with open_file(path) as file:
                text = file.read(MAX_RECORD_BYTES + 1)  # a larger file is cut, and is no JSON any more
            record = cls.model_validate_json(text)
        except OSError as error:
            raise Unreadable(f"{path}: {error.strerror or error}") from error
        except ValidationError as error:
            raise Unreadable(f"{path}: {_first_problem(error)}") from error
        # `seal` is the first field, so that the first match is its value even if the text has these digits again.
        if record.seal is not None and record.seal != _seal(text.replace(record.seal.encode(), _UNSEALED.encode(), 1)):
            raise Unreadable(f"{path}: it was changed after it was written (wrong checksum)")
        if getattr(record, cls.KEY) != key:
            raise Unreadable(f"{path}: it belongs to {getattr(record, cls.KEY)}: the folder was renamed or copied")
        return record


_UNSEALED = "0" * 32


def _seal(text: bytes) -> str:
    return hashlib.blake2b(text, digest_size=16).hexdigest()


class RunLedger(StoredModel):
    """Extremes over all steps of a run, and the final balance of its grains; None where a value is unknown."""

    overlap: Measure | None
    """Largest overlap of any contact, in diameters of the smallest grains, as `numerics.overlap_limit` counts it."""
    speed: Measure | None
    """Largest speed of any grain [m/s], as `numerics.speed_limit` counts it."""
    expected_speed: Measure | None
    """Speed [m/s] of a grain that falls from the top of the start to the height where it is removed, with the speed of
    moving walls added; None for a filling."""
    started: Whole
    """Number of grains at the start, with those of a stream that were still to enter."""
    inside: Whole
    """Number of grains between the walls at the end."""
    left: Whole
    """Number of grains that have left through the outlet."""
    outside: Whole
    """Number of grains behind a wall at the end, or that passed the plane of the outlet beside it."""
    waiting: Annotated[Whole, Field(exclude_if=lambda waiting: waiting == 0)] = 0
    """Number of grains of a stream that had not entered at the end."""

    @property
    def lost(self) -> int:
        """Number of grains that are in none of these places; negative if some are counted twice."""
        return self.started - self.inside - self.left - self.outside - self.waiting

    def fault(self, grains: int) -> str:
        """Name the first value that is impossible in a scene of `grains` grains, with the reason; empty if there is
        none."""
        if self.started > grains:
            return f"started: {self.started} grains of {grains}"
        for name in ("inside", "left", "outside", "waiting"):
            if (count := getattr(self, name)) > self.started:
                return f"{name}: {count} of {self.started} grains"
        return ""


Ending = Literal["finished", "precise", "emptied", "clogged", "diverged", "time-limit"]
UNREADABLE = "unreadable"
"""Outcome, in the index, of a run whose folder cannot be read."""
Outcome = Annotated[
    Ending,
    BeforeValidator(lambda word: "time-limit" if word == "interrupted" else word),  # as older runs have it
]
"""Outcome of a discharge. Each is a result, none an error.

`finished`: the demanded part was discharged. `precise`: stopped because the flow rate was precise enough. `emptied`: no
grain is left. `clogged`: no grain left for the stall time, a censored waiting time. `diverged`: a guard stopped it.
`time-limit`: it reached `stop.max_time`.
"""


class Precise(StoredModel):
    """Demanded precision of the flow rate of one run."""

    flow_rate: float
    """Half width of the 95 % interval from this run alone, relative to the flow rate."""
    start: float
    """End of the start-up: discharged mass as a fraction of the mass of the bed."""


class StopRule(StoredModel):
    """Conditions that end a discharge."""

    discharged: float
    """Fraction of the mass that has left; infinite for a fed bed."""
    max_time: float
    """Simulated time since the opening [s]."""
    stall: float
    """Time without a grain leaving [s] after which the outlet counts as clogged."""
    still: Annotated[bool, Field(exclude_if=lambda still: not still)] = False
    """Count the outlet as clogged before that if the grains near it are at rest."""
    fill_height: float | None = None
    """Height of the bed [m] at which the run ends; None: any."""
    # where there is none it is left out of what is stored
    precise: Annotated[Precise | None, Field(exclude_if=lambda precise: precise is None)] = None
    """Precision at which the run of a fed bed ends; None: none."""

    @property
    def fed(self) -> bool:
        """True if discharged grains are fed again."""
        return math.isinf(self.discharged)

    def as_precise(self, required: "StopRule") -> bool:
        """Decide whether a run that this rule stopped as precise also fulfils the rule `required`."""
        mine, theirs = self.precise, required.precise
        if mine is None or theirs is None:
            return False
        return mine.start == theirs.start and mine.flow_rate <= theirs.flow_rate * (1 + 1e-12)


class Coverage(StoredModel):
    """Extent of a run and its observations, which demands are compared with."""

    duration: Measure
    """Simulated time since the opening [s]."""
    steps: Whole
    grains: Annotated[Whole, Field(ge=1)]
    """Number of grains at the opening."""
    crossed: Whole
    """Number of grains that left through the outlet plane; fed grains count each time."""
    last_crossing: Measure
    """Time at which the last grain left [s]; 0 if none did."""
    stop: StopRule
    """Stop rule that ended the run."""
    guards: dict[str, float]
    probes: tuple[str, ...]
    """Probes, as `describe_probe` writes them."""
    recording: Annotated[Measure, Field(gt=0)] | None = None
    """Time between recorded frames [s], None without a recording; in older runs rounded to beats."""
    # where they may be it is left out of what is stored
    every_frame: Annotated[bool, Field(exclude_if=lambda every: not every)] = False
    """True if no frames were left out. Older runs kept every second, fourth ... frame, so that they had at most
    MAX_FRAMES_BEFORE."""
    mass_left: Measure | None = None
    """Fraction of the mass that left with these grains; None where all grains are equal."""
    restarts: Annotated[tuple[tuple[Measure, Measure], ...], Field(exclude_if=lambda restarts: not restarts)] = ()
    """For each restart of a run with `restart`: time of the last grain before the stop, and time at which the arch was
    first broken [s]."""
    bed_height: Measure | None = None
    """Height of the settled bed at the opening [m]: twice its mean height above the outlet plane."""

    @field_validator("probes")
    @classmethod
    def _are_probes(cls, probes: tuple[str, ...]) -> tuple[str, ...]:
        for probe in probes:
            parse_probe(probe)
        return probes

    @model_validator(mode="after")
    def _belongs_together(self):
        if self.crossed > self.grains and not self.stop.fed:
            raise ValueError(f"{self.crossed} of {self.grains} grains have left")
        return self

    @property
    def restart_table(self) -> dict[str, dict[str, np.ndarray]]:
        """Table `restart` of a run that has restarts, by its name: columns `stopped` and `time` [s]."""
        if not self.restarts:
            return {}
        stopped, time = np.array(self.restarts).T
        return {"restart": {"stopped": stopped, "time": time}}

    @property
    def frame_interval(self) -> float | None:
        """Time between two frames of the recording [s]; None without one."""
        if self.recording is None or self.every_frame:
            return self.recording
        frames, stride = int(self.duration / self.recording * (1 + 1e-9)), 1
        while frames // stride > MAX_FRAMES_BEFORE:
            stride *= 2
        return stride * self.recording

    @property
    def discharged(self) -> float:
        """Discharged mass as a fraction of the mass of the bed; above 1 where grains were fed."""
        return self.crossed / self.grains if self.mass_left is None else self.mass_left

    @property
    def fill_height(self) -> float | None:
        """Present height of the bed [m], if the cross-section is the same everywhere; None if unknown."""
        return None if self.bed_height is None else self.bed_height * (1 - self.discharged)

    @property
    def waiting(self) -> float:
        """Time since the last grain left, or since the opening [s]; a censored waiting time if the run clogged."""
        return self.duration - self.last_crossing


class RunFailure(StoredModel):
    """Divergence of a run: guard, step, grain and message. The folder holds the state at the last good beat."""

    guard: str
    step: int
    grain: int
    message: str


def repeat(seed: int, discharge: int = 1) -> str:
    """Label a run among those of its point: `seed 3`, or `seed 3, discharge 2` for a further discharge of its bed."""
    return f"seed {seed}" if discharge == 1 else f"seed {seed}, discharge {discharge}"


class Observe(StoredModel):
    """Measures of a run and their window.

    `start`, `end`: fractions of the initial mass discharged, or times [s] if `timed`; `auto`: start at the end of the
    start-up. `gap` to `layer`: the window's settings of `labbook.measure.scales`.
    """

    measure: tuple[str, ...]
    start: float
    end: float
    # where there is none it is left out of what is stored
    timed: Annotated[bool, Field(exclude_if=lambda timed: not timed)] = False
    auto: Annotated[bool, Field(exclude_if=lambda auto: not auto)] = False
    gap: OptionalMeasure = None
    moment: OptionalMeasure = None
    interval: OptionalMeasure = None
    layer: OptionalMeasure = None

    @classmethod
    def of(cls, measure: Iterable[str], window: Window) -> "Observe":
        """Combine measures with a window."""
        scale_values = {key: getattr(window, key, None) for key in scales.KEYS}
        auto = after_start_up(window)
        return cls(
            measure=tuple(measure), start=window.start, end=window.end, timed=window.timed, auto=auto, **scale_values
        )


class RunRecord(FolderRecord):
    """Record of a finished run: all but its tables."""

    FILE = "run.json"
    KEY = "run_key"

    format: Literal[1] = 1
    run_key: RunKey
    experiment_key: Text
    scene_key: Text
    packing_key: RunKey
    lineage_key: Text
    backend: StoredBackend
    cache_version: Whole
    study: StudyName
    point: Whole
    label: Text
    at: dict[Text, float | Text]
    seed: Whole
    kick: Annotated[Kick | None, Field(exclude_if=lambda kick: kick is None)] = None
    """Kick of a discharge after the first of its bed."""
    scene: Scene
    versions: StoredVersions = Field(default_factory=dict)
    """Versions of the formulas with which the scene was computed."""
    numerics: Numerics
    outcome: Outcome
    coverage: Coverage
    failure: RunFailure | None = None
    observe: Observe
    physics: dict[str, float]
    """Values that the backend derived: demanded and realised restitution, damping coefficient."""
    device: Text
    finished: Text
    """End of the run (UTC, ISO 8601)."""
    ledger: Annotated[RunLedger | None, Field(exclude_if=lambda ledger: ledger is None)] = None
    """Extremes and balance of the run; None in runs from before they were recorded."""

    @model_validator(mode="after")
    def _is_possible(self):
        coverage = self.coverage
        if abs(coverage.duration / self.numerics.dt - coverage.steps) > 1:
            mismatch = f"{coverage.duration:.6g} s are not {coverage.steps} steps of {self.numerics.dt:.6g} s"
            raise ValueError(f"coverage.duration: {mismatch}")
        if self.ledger is not None and (fault := self.ledger.fault(coverage.grains)):
            raise ValueError(f"ledger.{fault}")
        return self

    @property
    def discharge(self) -> int:
        """Number of the discharge of its bed, from 1 on."""
        return 1 if self.kick is None else self.kick.discharge

    @property
    def repeat(self) -> str:
        """Label of the run among those of its point: `seed 3, discharge 2`."""
        return repeat(self.seed, self.discharge)

    @property
    def provenance(self) -> dict[str, Any]:
        """Provenance of the last session, with backend, seed, precision, device, times and speed of the run."""
        return {
            **self.sessions[-1].provenance,
            "backend": self.backend,
            "cache_version": self.cache_version,
            "seed": self.seed,
            "precision": self.numerics.precision,
            "device": self.device,
            "wall_time": self.wall_time,
            "process_time": self.process_time,
            "grain_steps_per_second": self.rate,
            "sessions": len(self.sessions),
        }
