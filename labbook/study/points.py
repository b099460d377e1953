"""All points of a study: each assignment of a sweep put into its sections, read, and given its numerics."""

from collections.abc import Iterable, Iterator, Mapping, Set
from dataclasses import replace
from hashlib import blake2b
from typing import Any

from labbook.accuracy import Calibration, Choice, NotMeasured, OutOfRange, choose
from labbook.backend.numerics import Numerics
from labbook.scene.scene import Scene
from labbook.study.draft import Draft, guarded
from labbook.study.explain import Complaint
from labbook.study.point import Point, value_of
from labbook.study.problems import Problem, and_others, quote
from labbook.study.schema import Fill, Settings
from labbook.study.source import StudyText, dotted
from labbook.study.sweep import Assignment

MAX_WRONG = 500
"""After this many points that are wrong, the rest are not looked at: they repeat the same mistakes."""

_OWN = ("walls.", "fill.")
_SOFTENED = {"flow_rate", "packing"}
"""Measures of which the calibration says what softer grains do to them; with others stiffness is left as stated."""


class PointReader:
    """Validates points and collects what is wrong with them."""

    def __init__(
        self,
        source: StudyText,
        wrong_already: Set[str | None],
        settings: Settings | None,
        calibration: Calibration | None = None,
    ):
        """`wrong_already`: keys of which it is known that they are misspelled, or that their sweep is wrong;
        `settings`: what the study states once, None if that is wrong; `calibration`: its own, None for the one that
        ships."""
        self._source, self._settings, self._calibration = source, settings, calibration
        self._wrong_already = wrong_already
        self._problems: dict[Problem, list[str]] = {}

    @property
    def problems(self) -> Iterator[Problem]:
        """Problems, each once, with the points at which it occurs."""
        for problem, labels in self._problems.items():
            where = f" (at {labels[0]}{and_others(len(labels) - 1)})" if labels else ""
            yield replace(problem, message=problem.message + where)

    def read(self, assignments: Iterable[Assignment]) -> tuple[Point, ...]:
        """All points that are right. A point that repeats another is a problem."""
        wrong, points = 0, list[Point]()
        labels: dict[bytes, str] = {}
        for assignment in assignments:
            point = self._point(len(points), assignment)
            if point is None:
                wrong += 1
                if wrong == MAX_WRONG:
                    break
                continue
            identity = _identity(point)
            if identity in labels:
                self._note_repetition(assignment, point.label, labels[identity])
                continue
            labels[identity] = point.label
            points.append(point)
        return tuple(points)

    def _point(self, index: int, assignment: Assignment) -> Point | None:
        """The point of an assignment; None if anything is wrong with it, which then is noted."""
        label = _label(assignment)
        draft = Draft(_assign(self._source.data, assignment), self._source.beside)
        for complaint in draft.complaints:
            self._note(complaint, assignment, label)
        if draft.validated is None:
            return None
        scene, fill, numerics = draft.validated
        choice, unmet = self._choose(scene, fill, draft.numerics_keys, numerics)
        if choice is not None:
            choices = {key: getattr(choice, key) for key in ("dt", "stiffness_scale", "precision")}
            numerics = numerics.model_copy(update=choices)
        numerics = guarded(numerics, draft.numerics_keys, scene)
        at = {key: value for key in assignment if (value := value_of(key, scene, fill, numerics)) is not None}
        why = "" if unmet is None else str(unmet)
        piloted = isinstance(unmet, NotMeasured) and "dt" not in draft.numerics_keys and not self._names_calibration
        return Point(index, scene, fill, numerics, at, label or "the only point", choice, why, piloted)

    @property
    def _names_calibration(self) -> bool:
        return self._settings is not None and self._settings.accuracy.calibration is not None

    def _choose(
        self, scene: Scene, fill: Fill, keys: Mapping[str, Any], numerics: Numerics
    ) -> tuple[Choice | None, OutOfRange | None]:
        """Numerics for the requested error, keeping those that the study states; or why there are none."""
        settings = self._settings
        if settings is None or settings.accuracy.flow_rate is None or fill.numerics is not None:
            return None, None
        soft = "stiffness_scale" not in keys and set(settings.measure) <= _SOFTENED
        dt, usual = (numerics.dt, None) if "dt" in keys else (None, numerics.dt)
        fixed: dict[str, Any] = {"dt": dt, "stiffness_scale": None if soft else numerics.stiffness_scale}
        fixed["precision"] = numerics.precision if "precision" in keys else None
        closed = scene.close(fill.friction, fill.contact)
        try:
            tolerance, own = settings.accuracy.flow_rate, self._calibration
            return choose(scene, closed, tolerance, **fixed, usual=usual, calibration=own), None
        except OutOfRange as reason:
            return None, reason

    def _note(self, complaint: Complaint, assignment: Assignment, label: str) -> None:
        """Note a complaint as a problem, with the points at which values clash."""
        key = dotted(complaint.location)
        if key in self._wrong_already:
            return
        swept = next((name for name in assignment if name == key or name.startswith(f"{key}.")), None)
        line = assignment[swept].line if swept else self._source.line(complaint.location)
        problem = Problem(self._source.path, line, quote(key), complaint.message, complaint.remedy)
        labels = self._problems.setdefault(problem, [])
        if complaint.clash and label:
            labels.append(label)

    def _note_repetition(self, assignment: Assignment, label: str, earlier: str) -> None:
        key, value = next(iter(assignment.items()), ("points", None))
        line = value.line if value else self._source.line(("points",))
        message = f"the point {label} repeats the point {earlier}"
        self._problems[Problem(self._source.path, line, key, message, "leave one of them out")] = []


def _identity(point: Point) -> bytes:
    """Hash of scene, filling and numerics."""
    parts = (point.scene, point.fill, point.numerics)
    text = "\n".join([part.model_dump_json() for part in parts])
    return blake2b(text.encode(), digest_size=16).digest()


def _assign(data: Mapping[str, Any], assignment: Assignment) -> dict[str, Any]:
    """The study's data with the point's values put in; sections on the way are copied, never changed."""
    result = dict(data)
    for key, value in assignment.items():
        *sections, leaf = key.split(".")
        inner: Any = result
        for section in sections:
            below = inner.get(section, {})
            if not isinstance(below, dict):
                break  # not a mapping: reported where it stands
            inner[section] = dict(below)
            inner = inner[section]
        else:
            inner[leaf] = value.raw
    return result


def _label(assignment: Assignment) -> str:
    """The point in the words of the study; empty for one that sweeps nothing."""
    names = _short_names(assignment)
    return ", ".join([f"{names[key]} {value.text}" for key, value in assignment.items()])


def _short_names(keys: Iterable[str]) -> dict[str, str]:
    """`orifice` for container.orifice, unless another key has the same ending. Keys of walls and fillings are called by
    their whole names, since grains have a friction, too."""
    names = list(keys)
    leaves = [name.rpartition(".")[2] for name in names]
    plain = [leaves.count(leaf) == 1 and not name.startswith(_OWN) for name, leaf in zip(names, leaves, strict=True)]
    return {name: leaf if short else name for name, leaf, short in zip(names, leaves, plain, strict=True)}
