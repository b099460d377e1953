"""A study, and how one is read from a file or made in Python: everything that is wrong is found at once, before
anything runs."""

from collections.abc import Callable, Iterator, Mapping, Set
from dataclasses import dataclass, field
from inspect import Parameter, cleandoc, signature
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar, Unpack

from pydantic import ValidationError

from labbook.accuracy import BESIDE, Calibration
from labbook.accuracy import load as load_calibration
from labbook.campaign import Strategy
from labbook.fit import LAWS
from labbook.measure import MEASURES
from labbook.scene.attached import StudyFolder
from labbook.study.absent import absent
from labbook.study.applicable import unadaptable, unbroken, undischarged, unfed, unfillable, unfittable, unmeasurable
from labbook.study.calibrate import CalibrateReader
from labbook.study.explain import complaints
from labbook.study.habits import habit
from labbook.study.include import with_included
from labbook.study.keys import all_keys, find, nearest
from labbook.study.notebook import study_html
from labbook.study.paper import fits, words
from labbook.study.point import Point
from labbook.study.points import PointReader
from labbook.study.problems import MOST, Problem, StudyError, instead, meant, shown
from labbook.study.reference import ReferenceReader
from labbook.study.schema import (
    AUTO,
    SETTING_KEYS,
    TOP_KEYS,
    Accuracy,
    Fill,
    Record,
    Reference,
    Settings,
    Stop,
    Window,
)
from labbook.study.source import StudyText, changed, dotted, given, given_path, read, written
from labbook.study.stated import KEYS, Changed, StudyKeys
from labbook.study.sweep import BYTES, MAX_POINTS, Sweep
from labbook.study.window import resolved

if TYPE_CHECKING:
    import pandas as pd

MAX_RUNS = 200_000
"""Runs that a plan holds at once."""
_COMPARED = 200
"""Unknown keys that are compared with those that are known."""


_F = TypeVar("_F", bound=Callable[..., Any])


def _with_keys(function: _F) -> _F:
    """Show the keys of a study in `help` of a function that takes them, and in its signature, which notebooks read."""
    function.__doc__ = f"{cleandoc(function.__doc__ or '')}\n\nKeys, with SI units (see docs/studies.md):\n\n{KEYS}"
    own = signature(function)
    *fixed, _ = own.parameters.values()
    fixed = [parameter.replace(annotation=Parameter.empty) for parameter in fixed]
    named = [Parameter(key, Parameter.KEYWORD_ONLY, default=...) for key in StudyKeys.__annotations__]
    vars(function)["__signature__"] = own.replace(parameters=[*fixed, *named])
    return function


@dataclass(frozen=True)
class Study:
    """What is asked, resolved: the points of a sweep, and what is to be measured of each.

    `fill` and `numerics` are those of points that do not sweep them: use a point's own.
    """

    path: Path
    """Its file; `study NAME` of one that was made in Python."""
    name: str
    about: str
    points: tuple[Point, ...]
    replicates: int
    accuracy: Accuracy
    fill: Fill
    window: Window
    stop: Stop
    measure: tuple[str, ...]
    fit: tuple[str, ...]
    record: Record | None
    reference: Reference | None
    discharges_per_bed: int | Literal["auto"] = 1
    adapt: Strategy | None = field(default=None, compare=False)
    """Proposes the points that are run, within the range of `points`; None: `points` are run."""
    stated: Mapping[str, Any] = field(default_factory=dict, repr=False, compare=False)
    """What its author wrote: keys and values as in YAML."""
    source: str = field(default="", repr=False, compare=False)
    """The text of its file as it was read, with comments; empty for a study made in Python."""
    calibration: Calibration | None = field(default=None, repr=False, compare=False)
    """Its own, with the one that ships; None for the latter alone."""
    calibration_file: Path | None = field(default=None, repr=False, compare=False)
    """Where its own calibration is: the file that it names, or the one that a pilot has written beside it."""
    beside: StudyFolder = field(default_factory=StudyFolder, repr=False, compare=False)
    """Folder of the files that it names, and those that were read."""

    @property
    def fed(self) -> bool:
        """Whether grains that left are fed again, at all points."""
        return self.points[0].scene.feed is not None

    @_with_keys
    def change(self, changes: Changed | Mapping[str, Any] | None = None, /, **keys: Unpack[StudyKeys]) -> "Study":
        """The study with other values; this one stays as it is.

        changes: dotted keys (`contact.friction`, `sweep.container.orifice`) and new values, as `define` takes them;
        None leaves a key out. keys: the same for whole sections and settings. Raises StudyError, also for a key that
        is swept, and TypeError where `changes` is no dict.
        """
        new = {**_keys_and_values(changes, "change({'contact.friction': 0.3}), or change(replicates=4)"), **keys}
        stays = not any(str(key).partition(".")[0] == "accuracy" for key in new)
        return _resolved(changed(self.stated, new, self.beside), self.calibration_file if stays else None)

    def calibrated(self, file: Path) -> "Study":
        """The study with numerics chosen by another calibration file. Raises StudyError."""
        source = StudyText(self.path, dict(self.stated), {}, self.source, self.beside.again())
        return _resolved(source, file)

    def frame(self) -> "pd.DataFrame":
        """The points: a row each, with `point` (from 1), what was swept [SI, units in `attrs`], and `label`."""
        import pandas as pd

        rows = [{"point": point.index + 1, **point.at, "label": point.label} for point in self.points]
        made = pd.DataFrame(rows)
        made.attrs = {"study": self.name, "units": self.units}
        return made

    @property
    def units(self) -> dict[str, str]:
        """SI units of the swept keys; those that take words have none."""
        names = dict.fromkeys(name for point in self.points for name in point.at)
        units = {name: next((key.unit for key in find(name)), None) for name in names}
        return {name: unit for name, unit in units.items() if unit is not None}

    @property
    def text(self) -> str:
        """The study as its author wrote it: the text of its file, or `yaml()` for a study made in Python."""
        return self.source or self.yaml()

    def yaml(self) -> str:
        """The study as a study file has it, without comments."""
        return written(self.stated)

    def save(self, path: Path | str) -> Path:
        """Write the study to a file, for the command line, and the files that it names beside it; its path.

        Raises FileExistsError where another file has the name of such a file, and AttachedError (of
        `labbook.scene.attached`) where its content is gone.
        """
        there = given_path(path, "study.save")
        self.beside.copy(there.parent)
        there.write_text(self.yaml(), encoding="utf-8")
        return there

    def __hash__(self) -> int:
        # of some of what is compared: scenes hold dicts, which have none
        return hash((self.path, self.name, self.replicates, self.measure, tuple(point.label for point in self.points)))

    def __repr__(self) -> str:
        points = f"{len(self.points)} point{'' if len(self.points) == 1 else 's'}"
        swept = dict.fromkeys(name for point in self.points for name in point.at)
        over = f" of {', '.join(swept)}" if swept else ""
        return f"<Study {self.name}: {points}{over}; replicates: {self.replicates}>"

    def _repr_html_(self) -> str:
        return study_html(self.name, self.about, self.stated, self.points, self.replicates, self.discharges_per_bed)


def load(path: Path | str, calibration: Path | None = None) -> Study:
    """The study in the file `path` (YAML). Raises StudyError with all problems that were found.

    calibration: file to use in place of the one that it names, or that a pilot has written beside it.
    """
    return _resolved(read(given_path(path, "labbook.load")), calibration)


@_with_keys
def define(stated: StudyKeys | Mapping[str, Any] | None = None, /, **keys: Unpack[StudyKeys]) -> Study:
    """A study made in Python, of the keys and values of a study file.

    Sections are dicts, quantities text with a unit (`"3 mm"`) or pint quantities, lists any sequence or array. keys and
    `stated`, a dict of the same, together are the study. Raises StudyError with all problems that were found.
    """
    return _resolved(given(_keys_and_values(stated, "labbook.load(path) to read a file"), keys))


def _keys_and_values(stated: Any, instead: str) -> Mapping[str, Any]:
    """What was given as a dict of keys, {} for None. Raises TypeError with what to write `instead`."""
    if stated is not None and not isinstance(stated, Mapping):
        raise TypeError(f"a dict of keys and values is needed, and not {shown(stated)}; write {instead}")
    return stated or {}


def _resolved(source: StudyText, calibration_file: Path | None = None) -> Study:
    source = with_included(source)
    problems = _unknown_keys(source)
    unknown = [key for key in source.data if key not in TOP_KEYS]
    misspelled = {meant(key, TOP_KEYS) for key in unknown[:_COMPARED]}
    settings = _settings(source, misspelled, problems)
    sweep = Sweep(source)
    file = calibration_file or _calibration_file(source, settings)
    calibration = _calibration(source, file, problems)
    reader = PointReader(source, sweep.wrong | misspelled, settings, calibration)
    points = reader.read(sweep if sweep.size <= MAX_POINTS else islice(sweep, 1))
    reference = ReferenceReader(source, points, known_names, settings)
    published = reference.read()
    calibrate = CalibrateReader(source, points, published, settings)
    strategy = calibrate.read()
    problems += [*sweep.problems, *reader.problems, *reference.problems, *calibrate.problems]
    if settings is not None:
        problems += _unknown_names(source, settings)
        problems += _too_many_runs(source, settings, len(points))
        problems += unmeasurable(source, settings, points)
        problems += unfittable(source, settings, points)
        problems += unfillable(source, settings, points)
        problems += undischarged(source, settings, points)
        problems += unbroken(source, settings, points)
        problems += unadaptable(source, settings, points)
    window, stop = resolved(settings, points) if settings is not None and points else (None, None)
    if settings is not None and window is not None:
        problems += unfed(source, settings, points, window)
    if problems or settings is None:
        raise StudyError(problems)
    stated = {name: getattr(settings, name) for name in SETTING_KEYS} | {"window": window, "stop": stop}
    stated["adapt"] = strategy or settings.adapt
    return Study(
        path=source.path,
        points=points,
        fill=points[0].fill,
        reference=published,
        stated=source.data,
        source=source.text,
        calibration=calibration,
        calibration_file=file,
        beside=source.beside,
        **stated,
    )


def known_names() -> set[str]:
    """What the quantities of a reference begin with: measurements, laws, and words of papers."""
    return {*MEASURES, *LAWS, *words()}


def _unknown_keys(source: StudyText) -> list[Problem]:
    unknown = [key for key in source.data if key not in TOP_KEYS]
    # of thousands only the first are printed, and likenesses take time
    told = {
        key: _at_top(key, source.data) if n < MOST else ("unknown key", "leave it out") for n, key in enumerate(unknown)
    }
    return [Problem(source.path, source.line((k,)), shown(k), *told[k]) for k in unknown]


def _at_top(key: str, data: dict[str, Any]) -> tuple[str, str]:
    """Message and remedy for an unknown key at the top of a study."""
    if (row := absent("", key)) is not None:
        return row.says, row.remedy
    foreign = habit(key, data[key], TOP_KEYS)
    if foreign is not None:
        return "unknown key", foreign.remedy
    close = meant(key, TOP_KEYS)
    if close:
        return "unknown key", f"did you mean {close}?"
    elsewhere = any(known.name.rpartition(".")[2] == key for known in all_keys())
    return "unknown key", nearest(key) if elsewhere else instead(key, TOP_KEYS)


def _settings(source: StudyText, misspelled: Set[str | None], problems: list[Problem]) -> Settings | None:
    stated = {key: source.data[key] for key in SETTING_KEYS if key in source.data}
    try:
        return Settings.model_validate(stated, context={"units": "required"})
    except ValidationError as error:
        for found in complaints(error, stated):
            if dotted(found.location) not in misspelled:
                line, key = source.line(found.location), shown(dotted(found.location))
                problems.append(Problem(source.path, line, key, found.message, found.remedy))
        return None


def _calibration_file(source: StudyText, settings: Settings | None) -> Path | None:
    """The file that the study names, or else the one that its pilot has written beside it; None if there is neither."""
    named = settings.accuracy.calibration if settings is not None else None
    if named is not None:
        return source.path.parent / named
    beside = source.path.with_suffix(BESIDE)
    return beside if source.text and beside.is_file() else None


def _calibration(source: StudyText, path: Path | None, problems: list[Problem]) -> Calibration | None:
    """What is in its file; None if it has none, or one that cannot be read."""
    if path is None:
        return None
    try:
        return load_calibration(path)
    except (OSError, ValueError) as error:
        line = source.line(("accuracy", "calibration"))
        remedy = "give a file that labbook pilot has written, or remove it"
        problems.append(Problem(source.path, line, "accuracy.calibration", f"{path}: {error}", remedy))
        return None


def _too_many_runs(source: StudyText, settings: Settings, points: int) -> Iterator[Problem]:
    """More runs than a plan can hold."""
    discharges = 1 if settings.discharges_per_bed == AUTO else settings.discharges_per_bed
    runs = points * settings.replicates * discharges
    if runs > MAX_RUNS:
        memory = f"a plan of them takes about {runs * BYTES / 1e9:.3g} GB of memory"
        of = f"{settings.replicates} replicates" + (f" with {discharges} discharges each" if discharges > 1 else "")
        message = f"{points} points of {of} are {runs} runs, more than {MAX_RUNS}; {memory}"
        remedy = f"use at most {MAX_RUNS // (points * discharges)} replicates, or split the study"
        yield Problem(source.path, source.line(("replicates",)), "replicates", message, remedy)


def _unknown_names(source: StudyText, settings: Settings) -> Iterator[Problem]:
    """Measurements and fits that do not exist, and fits of what is not measured."""
    for index, name in enumerate(settings.measure):
        if name not in MEASURES:
            row, message = absent("measure", name), f"no measurement is called {shown(name)}"
            message, remedy = (f"{message}: {row.says}", row.remedy) if row else (message, instead(name, MEASURES))
            yield Problem(source.path, source.line(("measure", index)), "measure", message, remedy)
    for index, name in enumerate(settings.fit):
        if name in LAWS:  # papers are not looked up where no study speaks of them: that takes time
            continue
        line, needed = source.line(("fit", index)), fits().get(name)
        if needed is None:
            row, message = absent("fit", name), f"no law is called {shown(name)}"
            if row is None:
                remedy = instead(name, [*LAWS, *fits()])
            else:
                message, remedy = f"{message}: {row.says}", row.remedy
            yield Problem(source.path, line, "fit", message, remedy)
        elif needed not in settings.measure:
            message = f"{name} cannot be fitted: {needed} is not measured"
            yield Problem(source.path, line, "fit", message, f"add {needed} to measure")
