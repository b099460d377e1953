"""The parts of a study beside its scene: filling, window, stop rule, accuracy, recording, reference."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import (
    BeforeValidator,
    Field,
    PrivateAttr,
    StrictBool,
    TypeAdapter,
    ValidationError,
    field_validator,
    model_validator,
)

from labbook.backend.numerics import Numerics
from labbook.campaign import STRATEGIES, Strategy
from labbook.filling import GrainFile
from labbook.filling.mobilising import Mobilise
from labbook.filling.placing import STARTS, FromFile, FromStream
from labbook.fit import law_name
from labbook.scene.attached import AttachedFile
from labbook.scene.contact import AnyLaw
from labbook.scene.model import Among, Fault, Model, OrWord, refuse
from labbook.scene.quantities import Coefficient, Coordinate, Duration, Instant, Length, Ratio, Whole
from labbook.scene.scene import Scene
from labbook.scene.stream import Stream

AUTO: Literal["auto"] = "auto"
"""Value of `discharges_per_bed` for which the cheapest number is chosen, and of `window.start` for the end of the
start-up."""
PLACED: Literal["placed"] = "placed"
"""Value of `fill.until` for an outlet that is open from the start."""
Fraction = Annotated[Ratio, Field(ge=0, le=1)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]*$", max_length=80)]


_NAME = TypeAdapter(Name)


def names_a_study(name: str) -> bool:
    """True for a valid name of a study. Valid names are safe as names of files."""
    try:
        _NAME.validate_python(name)
    except ValidationError:
        return False
    return True


LONGEST = 3400.0
"""Longest filling and longest discharge, in sqrt(d*/g), unless `max_time` is stated."""
STALL = 110.0
"""Time without a leaving grain after which a run is clogged, in sqrt(d*/g), unless `stop.stall` is stated."""
EVERY = 0.57
"""Time between two recorded frames, in sqrt(d*/g), unless `record.every` is stated."""
FALLS = 30.0
"""Largest speed of a grain, over that of free fall through the scene, unless `numerics.speed_limit` is stated."""


def _settled_below(fill: dict[str, Any]) -> float:
    """By the kind of start."""
    return STARTS[fill.get("kind", "rain")].settled_below


_Vector = tuple[Coordinate, Coordinate, Coordinate]


class Fill(Model):
    """Filling of the closed container, once for all runs that share the packing."""

    kind: Annotated[str, Among(STARTS)] = "rain"
    """Start of the grains: `rain`, a loose column of slow grains; `gas`, a denser one of fast grains; `planar`, a rain
    in the middle plane between front and back walls; `dense`, a bed pushed together that has little left to fall;
    `file`, at the positions in `fill.file`; `stream`, one after another through the region of `fill.stream`."""
    # where they are not stated they are left out of what is stored
    file: Annotated[AttachedFile | None, Field(exclude_if=lambda file: file is None)] = None
    """File of the grains, in the folder of the study (kind: file): a CSV file, a text dump of LAMMPS or LIGGGHTS, or a
    data file of LAMMPS."""
    shift: Annotated[_Vector | None, Field(exclude_if=lambda shift: shift is None)] = None
    """Displacement of all grains of the file; none: they stay where they are."""
    stream: Annotated[Stream | None, Field(exclude_if=lambda stream: stream is None)] = None
    """Stream by which grains enter (kind: stream)."""
    until: Annotated[
        Annotated[float, OrWord(Duration, PLACED)] | None, Field(exclude_if=lambda until: until is None)
    ] = None
    """Time after the start of the filling at which the outlet opens, whether the bed rests or not; `placed`: at once,
    so that grains fall into an open container. None: when the bed is at rest."""
    friction: Coefficient | None = None
    """Friction coefficient of grains and walls during filling; none: as in the study."""
    # where it is not stated it is left out of what is stored
    contact: Annotated[AnyLaw | None, Field(exclude_if=lambda law: law is None)] = None
    """Contact law during filling, with the keys of `contact`; none: as in the study. So studies of several laws can
    start from the same beds."""
    numerics: Annotated[Numerics | None, Field(exclude_if=lambda numerics: numerics is None)] = None
    """Numerics during filling; keys that are left out are as in `numerics`. So runs with other numerics can start
    from the same beds, and beds can be filled with a longer step."""
    settled_below: Annotated[Ratio, Field(gt=0, le=1)] = Field(default_factory=_settled_below)
    """Kinetic energy per grain, in units of m g d, below which the bed is at rest. If left out: 1e-6, and 1e-3 after a
    `dense` start."""
    moving: Fraction | None = None
    """Fraction of the grains that may still move in a bed at rest: each slow grain has less than `settled_below`.
    None: 1 % for rods and for spheres without rolling friction, which may roll for ever; else 0, and 0
    if `settled_below` is stated or after a `dense` start."""
    # by default it is left out of what is stored
    surface_motion: Annotated[StrictBool, Field(exclude_if=lambda moves: not moves)] = False
    """Move surfaces of walls (`container.rotation`, `container.parts[].motion`) during filling too."""
    mobilise: Annotated[Mobilise | None, Field(exclude_if=lambda mobilise: mobilise is None)] = None
    """Motion of the bottom against the upright walls once the bed is at rest, which mobilises the friction of walls;
    then it comes to rest again. None: no such motion."""
    max_time: Duration | None = None
    """Longest filling; a bed that moves after this time is an error."""

    @model_validator(mode="after")
    def _has_a_stream_where_one_flows(self):
        if self.until == PLACED:  # a filling of no time
            object.__setattr__(self, "until", 0.0)
        flows = self.kind == FromStream.name
        if flows and self.stream is None:
            refuse([Fault("stream", "this key is missing", "state rate, low and high of the stream")])
        if not flows and self.stream is not None:
            refuse([Fault("stream", f"a {self.kind} start has no stream", "leave it out, or use kind: stream")])
        if self.until is not None and self.mobilise is not None:
            refuse([Fault("until", "friction is mobilised in a bed at rest", "leave until or mobilise out")])
        return self

    @model_validator(mode="after")
    def _has_a_file_where_one_is_read(self):
        if self.kind == FromFile.name and self.file is None:
            refuse([Fault("file", "this key is missing", "state the file of the grains, such as grains.csv")])
        keys = [key for key in ("file", "shift") if getattr(self, key) is not None]
        if self.kind != FromFile.name:
            refuse(Fault(key, f"a {self.kind} start reads no file", "leave it out, or use kind: file") for key in keys)
        return self

    @property
    def grain_file(self) -> GrainFile | None:
        """File that the grains start from."""
        return None if self.file is None else GrainFile(self.file, self.shift or (0.0, 0.0, 0.0))


START_UP = 0.5
"""Mass that leaves a fed bed, of that of the bed, before its flow counts as steady, unless `window.start` is stated
(docs/accuracy.md)."""


EARLIEST, LATEST = 0.3, 0.6
"""Between which a window closes, by discharged fraction, unless `window.end` is stated (`labbook.study.window`)."""
MARGIN = 0.05
"""From the end of the window to that of the run, unless `stop.discharged` is stated."""


class Window(Model):
    """The part of a discharge in which its flow is taken to be steady, by discharged fraction of the mass, or by time.

    Of a window by time, `start` and `end` are the times [s] once it is made. Of one that opens at the end of the
    start-up, `auto` is true and `start` is 0.
    """

    start: Annotated[float, OrWord(Fraction, AUTO)] = 0.15
    """Discharged mass fraction at which the window opens. `auto`: in each run at the end of its start-up, where the
    flow rate has come within 1 % of its plateau."""
    end: Fraction = LATEST
    """Discharged mass fraction at which the window closes. If left out: where the lowest bed of the study is still
    1.2 container widths high, between 0.3 and 0.6; 0.6 where that height is unknown."""
    after: Instant | None = None
    """Time after the opening of the outlet at which the window opens, instead of `start`."""
    until: Duration | None = None
    """Time after the opening of the outlet at which the window closes, instead of `end`."""
    gap: Duration | None = None
    """A longer time without a leaving grain is left out of the flow rate, and reported."""
    moment: Duration | None = None
    """Time over which maps at three instants of the window are averaged, and at most between two frames of
    `contact_stress`."""
    interval: Duration | None = None
    """Time between the two velocities whose difference is the acceleration above the outlet."""
    layer: Length | None = None
    """Height of the layer above the outlet over which fields are averaged."""
    _auto: bool = PrivateAttr(default=False)

    @property
    def auto(self) -> bool:
        """True if it opens at the end of the start-up of each run."""
        return self._auto

    @property
    def opening(self) -> float | Literal["auto"]:
        """Value of `start` as a study states it."""
        return AUTO if self.auto else self.start

    @property
    def timed(self) -> bool:
        """True for a window by time."""
        return self.until is not None

    def endless(self) -> "Window":
        """The same of beds that are fed: it closes when the run ends, and opens later unless its start is stated."""
        start = self.start if "start" in self.model_fields_set else START_UP
        return self.model_copy(update={"start": start, "end": math.inf})

    @model_validator(mode="after")
    def _has_a_length(self):
        if self.start == AUTO:
            self._auto = True
            object.__setattr__(self, "start", 0.0)
        refuse(self._faults())
        if self.after is not None and self.until is not None:
            for end, time in (("start", self.after), ("end", self.until)):
                object.__setattr__(self, end, time)
        return self

    def _faults(self) -> Iterator[Fault]:
        by_time = {key for key in ("after", "until") if getattr(self, key) is not None}
        by_mass = self.model_fields_set & {"start", "end"}
        if by_time and by_mass:
            yield Fault(
                min(by_time), "the window is stated by mass and by time", "keep start and end, or after and until"
            )
        elif len(by_time) == 1:
            (lacking,) = {"after", "until"} - by_time
            yield Fault(lacking, "a window by time has two ends", "state after and until, such as 0.5 s and 3.5 s")
        elif by_time and self.until is not None and self.after is not None and self.until <= self.after:
            reason = f"the window ends at {self.until:g} s, before it starts ({self.after:g} s)"
            yield Fault("until", reason, f"use a time above {self.after:g} s")
        elif self.end <= self.start and "end" in by_mass:  # of a fed bed there is none
            reason = f"the window ends at {self.end:g}, before it starts ({self.start:g})"
            yield Fault("end", reason, f"use an end above {self.start:g}")


class Stop(Model):
    """Conditions that stop a discharge."""

    discharged: Annotated[Ratio, Field(gt=0, le=1)] = LATEST + MARGIN
    """Stop at this discharged mass fraction, at least `window.end`; if left out: `window.end` + 0.05."""
    max_time: Duration | None = None
    """Stop at this time after the opening of the outlet; if left out, not before `window.until`."""
    stall: Duration | None = None
    """Time without a leaving grain after which a run is clogged."""
    still: Annotated[StrictBool, Field(exclude_if=lambda still: not still)] = False
    """End a run as clogged once no grain has left for 20 `√(d*/g)`, and none within 2 D of the outlet is faster than
    0.01 `√(g d*)`."""
    fill_height: Length | None = None
    """Stop when the bed of a flat-bottomed silo has fallen to this height; none: no such stop."""


class Accuracy(Model):
    """The error that is tolerated in the pooled numbers of each point."""

    flow_rate: Annotated[Ratio, Field(gt=0, lt=1)] | None = None
    """Relative error of the flow rate to reach: bias of the numerics plus half-width of the 95 % interval.
    labbook then chooses numerics that are left out, and the number of replicates; none: `replicates` runs."""
    clogging: Annotated[Ratio, Field(gt=0, lt=1)] | None = None
    """Relative half-width of the 95 % interval of the probability of a stop to reach: replicates are added until
    (1.96/error)² stops were counted, 97 for 20 %; none: `replicates` runs."""
    max_replicates: Annotated[Whole, Field(ge=2, le=10_000)] = 100
    """Largest number of replicates per point, even if the error is not reached."""
    calibration: Annotated[str, Field(min_length=1, max_length=500)] | None = None
    """Calibration file written by `labbook pilot`; none: STUDY.calibration.json beside the study file, if
    it exists, and the file shipped with labbook."""
    numerics: Annotated[Ratio, Field(gt=0, lt=1)] | None = None
    """Relative margin of the equivalence test between swept numerics; none: no test."""
    count_suspect: StrictBool = False
    """Use suspect runs (by their ledger) in means and fits too."""


class Record(Model):
    """Recording: runs that keep frames, and the times between frames."""

    every: Duration | None = None
    """Time between two recorded frames, to the nearest time step. The first frame is at the opening."""
    replicates: Annotated[Whole, Field(ge=1, le=10_000)] = 1
    """Number of replicates of each point that are recorded; of each bed the first discharge."""
    film: StrictBool = False
    """Make a film of every recorded run in LAB/films once the study has run."""


Names = Annotated[tuple[str, ...], BeforeValidator(lambda names: [names] if isinstance(names, str) else names)]
"""A list of names; one alone need not stand in brackets."""


PerBed = Annotated[int | Literal["auto"], OrWord(Annotated[Whole, Field(ge=1, le=10_000)], AUTO)]


class Settings(Model):
    """Settings that a study states once, for all its points."""

    name: Name
    """Name of the study: letters, digits, - and _."""
    about: Annotated[str, Field(max_length=2000)] = ""
    """Purpose of the study, in a sentence."""
    replicates: Annotated[Whole, Field(ge=1, le=10_000)] = 1
    """Minimum number of beds per point; their seeds are 1, 2, 3 ..."""
    discharges_per_bed: PerBed = 1
    """Number of discharges of each bed: the second and further ones start with small random velocities. `auto`: the
    number that is cheapest for `accuracy.flow_rate`, from how much of the scatter beds and flow have each."""
    accuracy: Accuracy = Accuracy()
    measure: Names = ("flow_rate",)
    """Names of the measurements to take."""
    fit: Names = ()
    """Names of the laws to fit."""
    window: Window = Window()
    stop: Stop = Stop()
    record: Record | None = None
    adapt: Annotated[Strategy | None, STRATEGIES] = None
    """Strategy that chooses the points to run from the results so far, within the range of the sweep: its name, and
    its keys. None: the points of the sweep are run."""

    @field_validator("fit")
    @classmethod
    def _law_names(cls, laws: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(map(law_name, laws))

    @model_validator(mode="after")
    def _fits_together(self):
        refuse(self._faults())
        return self

    def _faults(self) -> Iterator[Fault]:
        requested = (self.accuracy.flow_rate, self.accuracy.clogging)
        if self.accuracy.max_replicates < self.replicates and requested != (None, None):
            reason = f"{self.accuracy.max_replicates} is less than the {self.replicates} requested replicates"
            yield Fault("accuracy.max_replicates", reason, f"use at least {self.replicates}")
        if self.accuracy.clogging is not None and "clogging" not in self.measure:
            reason = "an error of the probability of a stop is requested, which is not measured"
            yield Fault("accuracy.clogging", reason, "add clogging to measure")
        if self.accuracy.clogging is not None and self.adapt is not None:
            reason = f"the strategy {self.adapt.name} decides how many beds a point has"
            yield Fault("accuracy.clogging", reason, "leave one of the two out")
        if self.discharges_per_bed == AUTO and self.accuracy.flow_rate is None:
            reason = "the cheapest number of discharges follows from the error that is requested, and none is"
            yield Fault("discharges_per_bed", reason, "state accuracy.flow_rate, or a number such as 3")
        elif self.discharges_per_bed == AUTO and self.adapt is not None:
            reason = f"the strategy {self.adapt.name} decides how many beds a point has, so that no number is cheapest"
            yield Fault("discharges_per_bed", reason, "state a number such as 3")
        end = self.window.end
        if self.window.timed and self.stop.max_time is not None and self.stop.max_time < end:
            reason = f"a run that stops at {self.stop.max_time:g} s does not reach the end of the window ({end:g} s)"
            yield Fault("stop.max_time", reason, f"use at least {end:g} s, or end the window earlier")
        if self.window.timed and "discharged" not in self.stop.model_fields_set:
            reason = f"by default a run stops once {self.stop.discharged:g} of the mass has left, whatever the window"
            yield Fault("stop.discharged", reason, "state it beside a window by time, for example 1")
        both_ends = "end" in self.window.model_fields_set and "discharged" in self.stop.model_fields_set
        if not self.window.timed and both_ends and self.stop.discharged < end:
            reason = f"a run that stops at {self.stop.discharged:g} does not reach the end of the window ({end:g})"
            yield Fault("stop.discharged", reason, f"use at least {end:g}, or end the window earlier")
        if self.record is not None and self.record.replicates > self.replicates:
            reason = f"{self.record.replicates} replicates cannot be recorded of {self.replicates}"
            yield Fault("record.replicates", reason, f"use at most {self.replicates}")
        for key, names in (("measure", self.measure), ("fit", self.fit)):
            for name in sorted({name for name in names if names.count(name) > 1}):
                yield Fault(key, f"{name} is listed twice", "list it once")
        if self.fit and "flow_rate" not in self.measure:
            yield Fault(
                "fit", "the laws are fitted to the flow rate, which is not measured", "add flow_rate to measure"
            )


@dataclass(frozen=True)
class ReferenceEntry:
    """A published number [SI]: `quantity` as `law.parameter` or `measure.quantity`, `at` the points it is for.

    `says`: its place in the paper, such as an equation; empty if it is not stated. `measured`: whether it is from a
    file of measurements, which may have points that are not simulated.
    """

    quantity: str
    at: dict[str, float | str]
    value: float
    error: float | None = None
    says: str = ""
    measured: bool = False


@dataclass(frozen=True)
class Statement:
    """Statement of a paper without a number of its own: a quantity lies between two bounds.

    Args:
        quantity: Name of the quantity.
        at: Values of keys of the points that it speaks of [SI or word].
        low: Lower bound [SI]; may be -inf.
        high: Upper bound [SI]; may be inf.
        says: The statement in the paper's words.
        unit: SI unit of the quantity.
    """

    quantity: str
    at: dict[str, float | str]
    low: float
    high: float
    says: str
    unit: str = ""


@dataclass(frozen=True)
class Reference:
    """Published numbers, shown beside ours in every report, and statements that ours are held against."""

    source: str
    entries: tuple[ReferenceEntry, ...]
    statements: tuple[Statement, ...] = ()


SCENE_KEYS = tuple(Scene.model_fields)
SETTING_KEYS = tuple(Settings.model_fields)
OTHER_KEYS = ("fill", "numerics", "sweep", "points", "reference", "calibrate", "include")
TOP_KEYS = (*SETTING_KEYS, *SCENE_KEYS, *OTHER_KEYS)
