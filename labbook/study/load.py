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
from labbook.study.applicable import (
    unadaptable,
    unbroken,
    undischarged,
    undivided,
    unfed,
    unfillable,
    unfittable,
    unmeasurable,
)
from labbook.study.calibrate import CalibrateReader
from labbook.study.explain import complaints
from labbook.study.habits import habit
from labbook.study.include import with_included
from labbook.study.keys import all_keys, find, nearest
from labbook.study.notebook import study_html
from labbook.study.paper import fits, words
from labbook.study.point import Point
from labbook.study.points import PointReader
from labbook.study.problems import MAX_PRINTED, Problem, StudyError, closest, instead, quote
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
from labbook.study.source import StudyText, as_yaml, changed, dotted, given_path, read, text_of_keys
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
    keyword_parameters = [Parameter(key, Parameter.KEYWORD_ONLY, default=...) for key in StudyKeys.__annotations__]
    vars(function)["__signature__"] = own.replace(parameters=[*fixed, *keyword_parameters])
    return function


@dataclass(frozen=True)
class Study:
    """A study with all defaults resolved: the points of its sweep, and the measures and fits that it requests.

    `fill` is that of points that do not sweep it: use a point's own.

    Args:
        name: Name of the study.
        about: Its purpose, in a sentence.
        points: Scenes with their filling and numerics.
        replicates: Minimum number of beds of each point.
        accuracy: Requested errors.
        fill: Filling of the closed container.
        window: Part of the discharge in which flow rates are measured.
        stop: Conditions that end a discharge.
        measure: Names of the measures.
        fit: Names of the laws to fit.
        record: Runs that keep frames; None: none.
        reference: Published numbers to compare with.
        discharges_per_bed: Number of discharges of each bed; `auto`: the cheapest one.
    """

    path: Path
    """File of the study; `study NAME` if it was made in Python."""
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
    definition: Mapping[str, Any] = field(default_factory=dict, repr=False, compare=False)
    """Keys and values as its author wrote them, as in YAML."""
    source: str = field(default="", repr=False, compare=False)
    """The text of its file as it was read, with comments; empty for a study made in Python."""
    calibration: Calibration | None = field(default=None, repr=False, compare=False)
    """Calibration of the study joined with the shipped one; None: the shipped one alone."""
    calibration_file: Path | None = field(default=None, repr=False, compare=False)
    """File of its own calibration: the one that it names, or the one that a pilot has written beside it."""
    beside: StudyFolder = field(default_factory=StudyFolder, repr=False, compare=False)
    """Folder of the files that it names, and those that were read."""

    @property
    def fed(self) -> bool:
        """True if discharged grains are fed again, at all points."""
        return self.points[0].scene.feed is not None

    @_with_keys
    def change(self, changes: Changed | Mapping[str, Any] | None = None, /, **keys: Unpack[StudyKeys]) -> "Study":
        """Copy the study with other values.

        Args:
            changes: New values by dotted key (`contact.friction`, `sweep.container.orifice`), as `define` takes them;
                None removes a key.
            keys: New values of whole sections and settings.

        Returns:
            The changed study; this one stays as it is.

        Raises:
            StudyError: The new study has problems, or a changed key is swept.
            TypeError: `changes` is no dict.
        """
        new = {**_keys_and_values(changes, "change({'contact.friction': 0.3}), or change(replicates=4)"), **keys}
        stays = not any(str(key).partition(".")[0] == "accuracy" for key in new)
        return _resolved(changed(self.definition, new, self.beside), self.calibration_file if stays else None)

    def calibrated(self, file: Path) -> "Study":
        """Choose the numerics of the study by another calibration file.

        Args:
            file: The calibration file.

        Returns:
            The study with these numerics.

        Raises:
            StudyError: The file cannot be read.
        """
        source = StudyText(self.path, dict(self.definition), {}, self.source, self.beside.again())
        return _resolved(source, file)

    def frame(self) -> "pd.DataFrame":
        """Points as a data frame: a row each, with `point` (from 1), swept values (SI, units in `attrs`), `label`."""
        import pandas as pd

        rows = [{"point": point.index + 1, **point.at, "label": point.label} for point in self.points]
        frame = pd.DataFrame(rows)
        frame.attrs = {"study": self.name, "units": self.units}
        return frame

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
        return as_yaml(self.definition)

    def save(self, path: Path | str) -> Path:
        """Write the study to a file, for the command line, with the files that it names beside it.

        Args:
            path: File to write.

        Returns:
            Its path.

        Raises:
            FileExistsError: Another file has the name of a file that the study names.
            AttachedError: The content of such a file is gone (of `labbook.scene.attached`).
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
        swept_keys = f" of {', '.join(swept)}" if swept else ""
        return f"<Study {self.name}: {points}{swept_keys}; replicates: {self.replicates}>"

    def _repr_html_(self) -> str:
        return study_html(self.name, self.about, self.definition, self.points, self.replicates, self.discharges_per_bed)


def load(path: Path | str, calibration: Path | None = None) -> Study:
    """Read a study from its file.

    Args:
        path: The file (YAML).
        calibration: Calibration file in place of the one that the study names, or that a pilot has written beside it.

    Returns:
        The study.

    Raises:
        StudyError: The file has problems; all are listed.
    """
    return _resolved(read(given_path(path, "labbook.load")), calibration)


@_with_keys
def define(definition: StudyKeys | Mapping[str, Any] | None = None, /, **keys: Unpack[StudyKeys]) -> Study:
    """Define a study in Python, with the keys and values of a study file.

    Sections are dicts, quantities text with a unit (`"3 mm"`) or pint quantities, lists any sequence or array.

    Args:
        definition: Keys and values as a dict.
        keys: Further keys and values; no key may be in both.

    Returns:
        The study.

    Raises:
        StudyError: The study has problems; all are listed.
    """
    return _resolved(text_of_keys(_keys_and_values(definition, "labbook.load(path) to read a file"), keys))


def _keys_and_values(definition: Any, instead: str) -> Mapping[str, Any]:
    """Keys and values of a study made in Python; {} for None. Raises TypeError with the remedy `instead`."""
    if definition is not None and not isinstance(definition, Mapping):
        raise TypeError(f"a dict of keys and values is needed, and not {quote(definition)}; write {instead}")
    return definition or {}


def _resolved(source: StudyText, calibration_file: Path | None = None) -> Study:
    source = with_included(source)
    problems = _unknown_keys(source)
    unknown_keys = [key for key in source.data if key not in TOP_KEYS]
    misspelled = {closest(key, TOP_KEYS) for key in unknown_keys[:_COMPARED]}
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
        problems += undivided(source, settings, points)
        problems += unadaptable(source, settings, points)
    window, stop = resolved(settings, points) if settings is not None and points else (None, None)
    if settings is not None and window is not None:
        problems += unfed(source, settings, points, window)
    if problems or settings is None:
        raise StudyError(problems)
    values = {name: getattr(settings, name) for name in SETTING_KEYS} | {"window": window, "stop": stop}
    values["adapt"] = strategy or settings.adapt
    return Study(
        path=source.path,
        points=points,
        fill=points[0].fill,
        reference=published,
        definition=source.data,
        source=source.text,
        calibration=calibration,
        calibration_file=file,
        beside=source.beside,
        **values,
    )


def known_names() -> set[str]:
    """First words of the quantities of a reference: measurements, laws, and words of papers."""
    return {*MEASURES, *LAWS, *words()}


def _unknown_keys(source: StudyText) -> list[Problem]:
    unknown_keys = [key for key in source.data if key not in TOP_KEYS]
    # of thousands only the first are printed, and likenesses take time
    reasons = {
        key: _at_top(key, source.data) if n < MAX_PRINTED else ("unknown key", "leave it out")
        for n, key in enumerate(unknown_keys)
    }
    return [Problem(source.path, source.line((k,)), quote(k), *reasons[k]) for k in unknown_keys]


def _at_top(key: str, data: dict[str, Any]) -> tuple[str, str]:
    """Message and remedy for an unknown key at the top of a study."""
    if (row := absent("", key)) is not None:
        return row.says, row.remedy
    foreign = habit(key, data[key], TOP_KEYS)
    if foreign is not None:
        return "unknown key", foreign.remedy
    match = closest(key, TOP_KEYS)
    if match:
        return "unknown key", f"did you mean {match}?"
    elsewhere = any(known.name.rpartition(".")[2] == key for known in all_keys())
    return "unknown key", nearest(key) if elsewhere else instead(key, TOP_KEYS)


def _settings(source: StudyText, misspelled: Set[str | None], problems: list[Problem]) -> Settings | None:
    values = {key: source.data[key] for key in SETTING_KEYS if key in source.data}
    try:
        return Settings.model_validate(values, context={"units": "required"})
    except ValidationError as error:
        for complaint in complaints(error, values):
            if dotted(complaint.location) not in misspelled:
                line, key = source.line(complaint.location), quote(dotted(complaint.location))
                problems.append(Problem(source.path, line, key, complaint.message, complaint.remedy))
        return None


def _calibration_file(source: StudyText, settings: Settings | None) -> Path | None:
    """The file that the study names, or else the one that its pilot has written beside it; None if there is neither."""
    file_name = settings.accuracy.calibration if settings is not None else None
    if file_name is not None:
        return source.path.parent / file_name
    beside = source.path.with_suffix(BESIDE)
    return beside if source.text and beside.is_file() else None


def _calibration(source: StudyText, path: Path | None, problems: list[Problem]) -> Calibration | None:
    """Read the calibration of a study; None if it has no file, or one that cannot be read, which is a problem."""
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
            row, message = absent("measure", name), f"no measurement is called {quote(name)}"
            message, remedy = (f"{message}: {row.says}", row.remedy) if row else (message, instead(name, MEASURES))
            yield Problem(source.path, source.line(("measure", index)), "measure", message, remedy)
    for index, name in enumerate(settings.fit):
        if name in LAWS:  # papers are not looked up where no study speaks of them: that takes time
            continue
        line, needed = source.line(("fit", index)), fits().get(name)
        if needed is None:
            row, message = absent("fit", name), f"no law is called {quote(name)}"
            if row is None:
                remedy = instead(name, [*LAWS, *fits()])
            else:
                message, remedy = f"{message}: {row.says}", row.remedy
            yield Problem(source.path, line, "fit", message, remedy)
        elif needed not in settings.measure:
            message = f"{name} cannot be fitted: {needed} is not measured"
            yield Problem(source.path, line, "fit", message, f"add {needed} to measure")
