"""What a finished run (`run.json`) or a packing says of itself, in its folder."""

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
"""A count, or another number that SQLite can hold."""
StudyName = Annotated[str, AfterValidator(_names_a_study)]
"""Pages and notes are found by it."""
Measure = Annotated[float, Field(ge=0, allow_inf_nan=False)]
"""A time, a length or a fraction."""
Text = Annotated[str, AfterValidator(_without_nul)]
"""A line for people, as every database can keep it."""
Stated = Annotated[Measure | None, Field(exclude_if=lambda stated: stated is None)]
"""The same where a study may state it; None, and left out of what is stored, where it does not."""
RunKey = Annotated[str, Field(pattern="^[0-9a-f]{8,64}$")]
StoredVersions = Annotated[
    dict[Text, Annotated[int, Field(gt=1, lt=2**31)] | Annotated[str, Field(pattern="^[0-9a-f]{8,64}$")]],
    Field(exclude_if=lambda versions: not versions),
]
"""Versions of the law and the walls of a scene that are above 1, and hashes of the source of extensions among them
(`labbook.lab.identity.Versions`); absent where there is none, as in all records from before there were any."""
StoredBackend = Annotated[Text, Field(validation_alias="engine", serialization_alias="engine")]
"""Name of a backend; files have it under the key `engine`."""
THINNED_TO = 200
"""Most frames of older recordings."""
LONGEST = 2**26
"""Bytes that a record may have: those of some 10^4 sessions."""


class Unreadable(Exception):
    """A folder that holds nothing that can be read; the message names file and reason."""


class Part(BaseModel):
    """A frozen piece of a record; an unknown key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", ser_json_inf_nan="constants", validate_by_name=True)

    def as_stored(self) -> bytes:
        """The JSON that a file holds."""
        return (self.model_dump_json(indent=1, by_alias=True) + "\n").encode()


class Provenance(TypedDict, total=False):
    """What the code reads of a session's provenance; whatever else is there is shown as text."""

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


def _is_provenance(given: dict[str, Any]) -> dict[str, Any]:
    """Keeps what was given, with its order: a record is written again with the bytes that were read."""
    try:
        _PROVENANCE.validate_python(given)
    except ValidationError as error:
        raise ValueError(_first(error)) from None
    return given


def _first(error: ValidationError) -> str:
    """The first thing that is wrong with a file: where, and what."""
    first = error.errors()[0]
    return ": ".join(filter(None, (".".join(map(str, first["loc"])), first["msg"].removeprefix("Value error, "))))


class Session(Part):
    """A stretch of one computation within one process."""

    from_step: Whole
    to_step: Whole
    started: Text
    """UTC, ISO 8601."""
    wall_time: Measure
    """Spent stepping [s]."""
    process_time: Measure
    """Share of the process's processor time while stepping [s]."""
    grain_steps: Measure
    provenance: Annotated[dict[str, Any], AfterValidator(_is_provenance)] = {}


class FolderRecord(Part):
    """A folder's account of how its content was computed, in one or more sessions."""

    FILE: ClassVar[str]
    KEY: ClassVar[str]

    seal: Annotated[str | None, Field(pattern="^[0-9a-f]{32}$", exclude_if=lambda seal: seal is None)] = None
    """Hash of the whole file with zeros in place of this: every changed bit is noticed. None in older files."""
    sessions: Annotated[tuple[Session, ...], Field(min_length=1)]

    @property
    def wall_time(self) -> float:
        """Time spent stepping [s], over all sessions."""
        return sum(session.wall_time for session in self.sessions)

    @property
    def process_time(self) -> float:
        """Processor time spent stepping [s], over all sessions."""
        return sum(session.process_time for session in self.sessions)

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
        """Write into `folder`, with a seal; `durable`: it is there after a crash."""
        text = self.model_copy(update={"seal": _UNSEALED}).as_stored()
        sealed = text.replace(_UNSEALED.encode(), _seal(text).encode(), 1)
        write_bytes(folder / self.FILE, sealed, durable=durable)

    @classmethod
    def read(cls, folder: Path, key: str | None = None) -> Self:
        """Read the record in `folder`, which is named by its key, or has yet to be named `key`. Raises Unreadable."""
        path, key = folder / cls.FILE, key or folder.name
        try:
            with open_file(path) as file:
                text = file.read(LONGEST + 1)
            record = cls.model_validate_json(text)
        except OSError as error:
            raise Unreadable(f"{path}: {error.strerror or error}") from error
        except ValidationError as error:
            raise Unreadable(f"{path}: {_first(error)}") from error
        if record.seal is not None and record.seal != _seal(text.replace(record.seal.encode(), _UNSEALED.encode(), 1)):
            raise Unreadable(f"{path}: it was changed after it was written (wrong checksum)")
        if getattr(record, cls.KEY) != key:
            raise Unreadable(f"{path}: it belongs to {getattr(record, cls.KEY)}: the folder was renamed or copied")
        return record


_UNSEALED = "0" * 32


def _seal(text: bytes) -> str:
    return hashlib.blake2b(text, digest_size=16).hexdigest()


class RunLedger(Part):
    """What guards saw in all steps, and where the grains are at the end; None where it is not known."""

    overlap: Measure | None
    """Largest overlap of any contact, in diameters of the smallest grains, as `numerics.overlap_limit` counts it."""
    speed: Measure | None
    """Largest speed of any grain [m/s], as `numerics.speed_limit` counts it."""
    expected_speed: Measure | None
    """Speed [m/s] of a grain that falls from the top of the start to where it is dropped, moving walls helping; None of
    a filling."""
    started: Whole
    """Grains at the start."""
    inside: Whole
    """Grains between the walls at the end."""
    left: Whole
    """Grains that have left through the outlet."""
    outside: Whole
    """Grains behind a wall at the end, or that passed the plane of the outlet beside it."""

    @property
    def lost(self) -> int:
        """Grains that are in none of these places; negative if some are in two."""
        return self.started - self.inside - self.left - self.outside

    def fault(self, grains: int) -> str:
        """Which of these numbers a scene of so many grains cannot have, and why; empty if it can have all."""
        if self.started > grains:
            return f"started: {self.started} grains of {grains}"
        for name in ("inside", "left", "outside"):
            if (many := getattr(self, name)) > self.started:
                return f"{name}: {many} of {self.started} grains"
        return ""


Ending = Literal["finished", "precise", "emptied", "clogged", "diverged", "time-limit"]
UNREADABLE = "unreadable"
"""Outcome, in the index, of a run whose folder cannot be read."""
Outcome = Annotated[
    Ending,
    BeforeValidator(lambda word: "time-limit" if word == "interrupted" else word),  # as older runs have it
]
"""How a discharge ended; every one of them is physics, none an error.

`finished`: the asked part was discharged. `precise`: stopped because the answer was precise enough.
`emptied`: no grain is left. `clogged`: no grain left for the stall time, a censored waiting time. `diverged`:
a guard stopped it. `time-limit`: it came to the end of `stop.max_time`.
"""


class Precise(Part):
    """How precise the flow rate of one run has to be."""

    flow_rate: float
    """Half width of its 95 % interval, of what the run itself tells, relative to it."""
    start: float
    """Mass that has left when the start-up is over, of that of the bed."""


class StopRule(Part):
    """When a discharge ends."""

    discharged: float
    """Fraction of the mass that has left; infinite where grains are fed."""
    max_time: float
    """Time since the opening [s]."""
    stall: float
    """Time without a grain leaving [s] after which the outlet counts as clogged."""
    still: Annotated[bool, Field(exclude_if=lambda still: not still)] = False
    """True if the outlet counts as clogged already once grains near it are still."""
    fill_height: float | None = None
    """Height of the bed [m] at which it has fallen far enough; None: any."""
    # where there is none it is left out of what is stored
    precise: Annotated[Precise | None, Field(exclude_if=lambda precise: precise is None)] = None
    """Of a fed bed: when its flow rate is known well enough; None: never."""

    @property
    def fed(self) -> bool:
        """Whether grains that left are fed again."""
        return math.isinf(self.discharged)

    def as_precise(self, asked: "StopRule") -> bool:
        """Whether a run that this rule found precise is as precise as `asked`."""
        mine, theirs = self.precise, asked.precise
        if mine is None or theirs is None:
            return False
        return mine.start == theirs.start and mine.flow_rate <= theirs.flow_rate * (1 + 1e-12)


class Coverage(Part):
    """How far a run went and what was observed: what a demand is compared with."""

    duration: Measure
    """Simulated time since the opening [s]."""
    steps: Whole
    grains: Annotated[Whole, Field(ge=1)]
    """At the opening."""
    crossed: Whole
    """Grains that left through the outlet plane; those that were fed count each time."""
    last_crossing: Measure
    """When the last grain left [s]; 0 if none did."""
    stop: StopRule
    """The rule that ended it."""
    guards: dict[str, float]
    probes: tuple[str, ...]
    """Probes, as `describe_probe` writes them."""
    recording: Annotated[Measure, Field(gt=0)] | None = None
    """Time between recorded frames [s] if the run was recorded: as asked or, in older runs, in whole beats."""
    # where they may be it is left out of what is stored
    every_frame: Annotated[bool, Field(exclude_if=lambda every: not every)] = False
    """Whether no frames were left out. Older runs kept every second, fourth ... so that they had THINNED_TO at most."""
    mass_left: Measure | None = None
    """Fraction of the mass that left with these grains; None where all are equal."""
    restarts: Annotated[tuple[tuple[Measure, Measure], ...], Field(exclude_if=lambda restarts: not restarts)] = ()
    """Of a run with `restart`: when its last grain before a stop left, and when the arch was broken first [s]."""
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
        """The table `restart` of a run that has restarts, by its name: `stopped` and `time` [s] of each."""
        if not self.restarts:
            return {}
        stopped, time = np.array(self.restarts).T
        return {"restart": {"stopped": stopped, "time": time}}

    @property
    def frame_interval(self) -> float | None:
        """Time between two frames of the recording [s]; None without one."""
        if self.recording is None or self.every_frame:
            return self.recording
        frames, kept = int(self.duration / self.recording * (1 + 1e-9)), 1
        while frames // kept > THINNED_TO:
            kept *= 2
        return kept * self.recording

    @property
    def discharged(self) -> float:
        """Mass that has left, of that of the bed: more than 1 where it was fed again."""
        return self.crossed / self.grains if self.mass_left is None else self.mass_left

    @property
    def fill_height(self) -> float | None:
        """Height [m] of the bed as it is now, if its cross-section is the same everywhere."""
        return None if self.bed_height is None else self.bed_height * (1 - self.discharged)

    @property
    def waiting(self) -> float:
        """Time since the last grain left, or since the opening [s]; censored if the run clogged."""
        return self.duration - self.last_crossing


class RunFailure(Part):
    """Why a run diverged; its folder holds the state at the last good beat."""

    guard: str
    step: int
    grain: int
    message: str


def repeat(seed: int, discharge: int = 1) -> str:
    """Name a run among those of its point, for people: `seed 3`, and of a further discharge of its bed `seed 3,
    discharge 2`."""
    return f"seed {seed}" if discharge == 1 else f"seed {seed}, discharge {discharge}"


class Observe(Part):
    """What is measured, over which fractions of the initial mass discharged; `timed`: over which times [s]; `auto`:
    from the end of the start-up. The others: what the window states of `labbook.measure.scales`."""

    measure: tuple[str, ...]
    start: float
    end: float
    # where there is none it is left out of what is stored
    timed: Annotated[bool, Field(exclude_if=lambda timed: not timed)] = False
    auto: Annotated[bool, Field(exclude_if=lambda auto: not auto)] = False
    gap: Stated = None
    moment: Stated = None
    interval: Stated = None
    layer: Stated = None

    @classmethod
    def of(cls, measure: Iterable[str], window: Window) -> "Observe":
        """These measures, within a window."""
        stated = {key: getattr(window, key, None) for key in scales.KEYS}
        auto = after_start_up(window)
        return cls(measure=tuple(measure), start=window.start, end=window.end, timed=window.timed, auto=auto, **stated)


class RunRecord(FolderRecord):
    """All that is known of a finished run apart from its tables."""

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
    """Of a discharge after the first of its bed."""
    scene: Scene
    versions: StoredVersions = Field(default_factory=dict)
    """By which the scene was computed."""
    numerics: Numerics
    outcome: Outcome
    coverage: Coverage
    failure: RunFailure | None = None
    observe: Observe
    physics: dict[str, float]
    """What the backend derived: asked and realised restitution, damping coefficient."""
    device: Text
    finished: Text
    """When it ended (UTC, ISO 8601)."""
    ledger: Annotated[RunLedger | None, Field(exclude_if=lambda ledger: ledger is None)] = None
    """None of runs from before it was kept."""

    @model_validator(mode="after")
    def _is_possible(self):
        coverage = self.coverage
        if abs(coverage.duration / self.numerics.dt - coverage.steps) > 1:
            told = f"{coverage.duration:.6g} s are not {coverage.steps} steps of {self.numerics.dt:.6g} s"
            raise ValueError(f"coverage.duration: {told}")
        if self.ledger is not None and (fault := self.ledger.fault(coverage.grains)):
            raise ValueError(f"ledger.{fault}")
        return self

    @property
    def discharge(self) -> int:
        """Number of the discharge of its bed, from 1 on."""
        return 1 if self.kick is None else self.kick.discharge

    @property
    def repeat(self) -> str:
        """The number of a run among those of its point, for people: `seed 3, discharge 2`."""
        return repeat(self.seed, self.discharge)

    @property
    def provenance(self) -> dict[str, Any]:
        """What made its last stretch: commit, versions, processor, device, threads; with seed, precision and
        speeds."""
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
