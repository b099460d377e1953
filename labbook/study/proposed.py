"""A study with other points than its author stated: those that a strategy has proposed, or those of a pilot."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from labbook.campaign import Assignment, point_key
from labbook.scene.quantities import DIGITS, parse
from labbook.study.keys import find
from labbook.study.load import Study
from labbook.study.point import Point
from labbook.study.source import as_yaml


def with_points(study: Study, assignments: Sequence[Assignment]) -> Study:
    """Give a study the points that were proposed, in place of its sweep.

    Args:
        study: As its author stated it.
        assignments: Values of keys [SI] and replicates of each point; each point once.

    Returns:
        The study with these points in this order, each with its own number of replicates; points that it states
        already are the same.

    Raises:
        StudyError: A point cannot be.
    """
    by_place = {point_key(point.at): point for point in study.points}
    new = [assignment for assignment in assignments if point_key(assignment.at) not in by_place]
    all_points = by_place | {
        point_key(assignment.at): point for assignment, point in zip(new, _read(study, new), strict=True)
    }
    points = (
        replace(all_points[point_key(assignment.at)], index=index, replicates=assignment.replicates)
        for index, assignment in enumerate(assignments)
    )
    return replace(study, points=tuple(points))


def _read(study: Study, assignments: Sequence[Assignment]) -> tuple[Point, ...]:
    """Points that the study does not state, read as if it did."""
    return study.change(_changes(study, [assignment.at for assignment in assignments])).points if assignments else ()


def _changes(study: Study, points: Sequence[Mapping[str, float | str]]) -> dict[str, Any]:
    """Changes of a study that give it these points, and leave their keys of runs as they are."""
    changes: dict[str, Any] = {"points": [written_at(at) for at in points], "adapt": None}
    # these sections may name points that the new study does not have
    changes |= {key: None for key in ("sweep", "reference", "calibrate") if key in study.definition}
    if not (study.window.timed or study.fed):  # with these points alone the window could be another one
        ends = {"start": study.window.opening, "end": study.window.end}
        changes["window"] = {**study.definition.get("window", {}), **ends}
    return changes


def study_at(study: Study, points: Sequence[Mapping[str, float | str]], name: str, replicates: int) -> tuple[str, str]:
    """Write a study of other points of the same scene as YAML.

    Args:
        study: As its author stated it.
        points: Values of keys [SI], within the range of the study.
        name: Of the new study.
        replicates: Beds of each point.

    Returns:
        The text up to its points, and the text of its points: together the study.

    Raises:
        StudyError: A point cannot be.
    """
    dropped = {key: None for key in ("fit", "about", "calibrate") if key in study.definition}  # of the whole sweep
    listed = [{key: _plain(key, value) for key, value in at.items()} for at in points]
    if study.record is not None and study.record.replicates > replicates:
        dropped["record"] = None
    changes = {**_changes(study, points), **dropped, "points": listed, "name": name, "replicates": replicates}
    new = study.change(changes)
    head = as_yaml({key: value for key, value in new.definition.items() if key != "points"})
    lines = ("- {" + ", ".join(f"{key}: {value}" for key, value in at.items()) + "}\n" for at in listed)
    return head, "points:\n" + "".join(lines)


def _plain(key: str, value: float | str) -> str:
    """A value as people write it: angles in degrees, numbers without a unit as they are."""
    ((_, text),) = written_at({key: value}).items()
    if not isinstance(value, str) and text.endswith(" rad"):
        return f"{math.degrees(value):.9g} deg"
    return text


def written_at(at: Mapping[str, float | str]) -> dict[str, str]:
    """Write SI values of keys as a study file has them: with units, lengths in mm where these are the same number."""
    return {key: value if isinstance(value, str) else _with_unit(key, value) for key, value in at.items()}


def _with_unit(key: str, value: float) -> str:
    unit = next((known.unit for known in find(key) if known.unit is not None), "")
    in_mm = f"{1e3 * value:.12g} mm"
    as_read = float(f"{value:.{DIGITS}g}")  # values of a sweep are rounded to as many digits
    return in_mm if unit == "m" and parse(in_mm, "m") == as_read else f"{value!r} {unit}".strip()
