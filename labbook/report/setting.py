"""Simulated system as a page lists it: grains, contact law, container, values common to all points, the sweep."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from datetime import date, datetime
from functools import lru_cache
from typing import Any

from labbook.measure.measure import window_in_words
from labbook.report.blocks import Facts
from labbook.results import display
from labbook.results.beds import shares_in_words
from labbook.results.display import Notation
from labbook.results.study import StudyResults
from labbook.scene import attached
from labbook.scene.quantities import span
from labbook.scene.walls import AT_REST, Frustum, Plane, Strip, WallShape
from labbook.study import Point
from labbook.study.keys import find
from labbook.study.schema import AUTO

_UNITS = {
    "m": Notation("", "mm", 1e3),
    "rad": Notation("", "deg", display.KEYS["container.angle"].scale),
    "kg/m^3": Notation("", "kg/m³"),
    "m/s^2": Notation("", "m/s²"),
}
"""Notations of quantities by SI unit, for keys without an entry of their own."""
_PARTS = {"grains": "Grains", "contact": "Contact", "container": "Container", "walls": "Walls", "fill": "Filling"}
_FIRST = {"grains": "shape", "contact": "law", "container": "kind", "fill": "kind"}
_HIDDEN = {"container.closed"}
_VALUES = 8
"""Values of a swept key that are listed one by one."""


def setting(results: StudyResults, today: date) -> Facts:
    """Rows of a term and what there is to say of it. today: the date of the report."""
    points = results.study.points
    rows = common(points)
    rows += [("Swept", text) for text in _swept(points)]
    rows += [("Points chosen", text) for text in results.campaign]
    rows += [("Measured", _measured(results)), ("Replicates", _replicates(results))]
    rows += [("Discharges", text) for text in _discharges(results)]
    rows.append(("Recorded", _recorded(results)))
    rows += [("Backend", text) for text in _backend(results)]
    rows.append(("Dates", _dates(results, today)))
    return Facts(tuple((term, text) for term, text in rows if text))


def common(points: Sequence[Point]) -> list[tuple[str, str]]:
    """Values that points have in common: grains, contact law, container, walls, filling, gravity and time step."""
    rows = [(term, text) for part, term in _PARTS.items() if (text := _common(points, part))]
    rows += [("Gravity", _value_of(points, "gravity")), ("Time step", _range(points, "numerics.dt"))]
    return [(term, text) for term, text in rows if text]


def differences(points: Sequence[Point]) -> list[tuple[str, tuple[str, ...]]]:
    """In what points differ: the key of a study, and its value at each of them in the units of the field."""
    values = [
        {**{name: value for part in _PARTS for name, value in _leaves(_plain(point, part), part)},
         **dict(_leaves(point.numerics.model_dump(mode="json"), "numerics")), "gravity": point.scene.gravity}
        for point in points
    ]  # fmt: skip
    rows = []
    for name in dict.fromkeys(name for settings in values for name in settings):
        of_points = [settings.get(name) for settings in values]
        if name not in _HIDDEN and any(value != of_points[0] for value in of_points):
            rows.append((name, tuple(_valued(name, value) for value in of_points)))
    return rows


def _valued(name: str, value: float | str | bool | None) -> str:
    if value is None:
        return "–"
    if isinstance(value, bool | str):
        return str(value).lower() if isinstance(value, bool) else value
    notation = _notation(name)
    return f"{value * notation.scale:.6g} {notation.unit}".rstrip()


def _common(points: Sequence[Point], part: str) -> str:
    """All of a part of the scene that is the same at every point."""
    values = [_with_youngs_moduli(dict(_leaves(_plain(point, part), part))) for point in points]
    shared = {name: value for name, value in values[0].items() if all(other.get(name) == value for other in values)}
    swept = {name for point in points for name in point.at}
    first = f"{part}.{_FIRST.get(part, '')}"
    texts = [str(shared[first])] if first in shared else []
    for name, value in shared.items():
        if name not in swept and name != first and name not in _HIDDEN and value is not None:
            texts.append(_setting(name, value))
    return ", ".join(texts)


def _with_youngs_moduli(leaves: Mapping[str, Any]) -> dict[str, Any]:
    """Beside each shear modulus of a contact law Young's modulus E = 2 G (1 + nu), by which a study may state it."""
    extended = dict[str, Any]()
    for name, value in leaves.items():
        section, _, leaf = name.rpartition(".")
        if leaf == "shear_modulus" and section.endswith("contact"):
            young = 2 * value * (1 + leaves[f"{section}.poisson_ratio"])
            extended[f"{section}.youngs_modulus"] = float(
                f"{young:.12g}"
            )  # of points that differ in nu alone, the same
        extended[name] = value
    return extended


def _plain(point: Point, part: str) -> Any:
    if part == "fill":
        return point.fill.model_dump(mode="json")
    dumped = point.scene.model_dump(mode="json")
    for key in point.scene.contact.ignored():
        del dumped["contact"][key]
    for wall, plain in zip(point.scene.container.parts, dumped["container"].get("parts", []), strict=False):
        if wall.shape.summary:  # in place of coordinates of thousands of vertices
            numbers = {key: value for key, value in plain["shape"].items() if not isinstance(value, str)}
            plain["shape"] = {"kind": wall.shape.kind, "surface": wall.shape.summary, **numbers}
        elif (words := _shape(wall.shape)) is not None:
            plain["shape"] = words
        if wall.motion == AT_REST:
            del plain["motion"]
    if zones := point.scene.container.zones:
        dumped["container"]["zones"] = {zone.name: f"{_corner(zone.low)} to {_corner(zone.high)} mm" for zone in zones}
    return dumped.get(part)


def _shape(shape: WallShape) -> str | None:
    """Name and places of a plane, a strip or a frustum; None of other walls."""
    if isinstance(shape, Plane):
        return f"plane at {_corner(shape.point)} mm, normal ({', '.join(f'{part:g}' for part in shape.normal)})"
    if isinstance(shape, Strip):
        return f"strip {_corner(shape.start)} to {_corner(shape.end)} mm"
    if isinstance(shape, Frustum):
        return f"frustum {_corner(shape.lower)} to {_corner(shape.upper)} mm"
    return None


def _corner(point: tuple[float, ...]) -> str:
    return f"({', '.join(f'{1e3 * part:g}' for part in point)})"


def _leaves(value: Any, name: str) -> Iterator[tuple[str, float | str | bool | None]]:
    """Every single value within, by its dotted key; entries of a list by their name or number."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _leaves(inner, f"{name}.{key}")
    elif isinstance(value, list) and len(value) > _VALUES and not any(isinstance(inner, Mapping) for inner in value):
        yield name, f"({len(value)} values)"
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            has_name = isinstance(inner, Mapping) and "name" in inner
            own = inner["name"] if has_name else index
            content = {key: part for key, part in inner.items() if key != "name"} if has_name else inner
            yield from _leaves(content, f"{name}.{own}")
    else:
        yield name, value


def _setting(name: str, value: float | str | bool) -> str:
    if isinstance(value, bool):
        return f"{_called(name)}: {'yes' if value else 'no'}"
    if isinstance(value, str):
        return f"{_called(name)} {attached.name(value) if attached.is_hash(value) else value}"
    notation = _notation(name)
    return f"{notation.name} {value * notation.scale:.6g} {notation.unit}".rstrip()


@lru_cache(maxsize=512)
def _notation(name: str) -> Notation:
    """Notation of a key: that of `display.KEYS`, else one with the unit that studies use."""
    if name in display.KEYS:
        return display.KEYS[name]
    unit = next((key.unit for key in find(name) if key.unit), "")
    of_unit = _UNITS.get(unit, Notation("", unit))
    return Notation(_called(name), of_unit.unit, of_unit.scale)


def _called(name: str) -> str:
    """The part of a dotted key that tells it from others of its room: `restitution`, `front friction`."""
    parts = name.split(".")
    return " ".join(parts[1:] or parts).replace("_", " ")


def _value_of(points: Sequence[Point], name: str) -> str:
    """The value of a key, if it is not swept."""
    if any(name in point.at for point in points):
        return ""
    return _range(points, name)


def _range(points: Sequence[Point], name: str) -> str:
    """The value of a key of numbers, or its ends where points differ."""
    values = [value for point in points if isinstance(value := point.value(name), float)]
    if not values:
        return ""
    notation = _notation(name)
    ends = dict.fromkeys(f"{value * notation.scale:.4g}" for value in (min(values), max(values)))
    return f"{' to '.join(ends)} {notation.unit}".rstrip()


def _swept(points: Sequence[Point]) -> Iterator[str]:
    for name in dict.fromkeys(name for point in points for name in point.at):
        values = list(dict.fromkeys(point.at[name] for point in points if name in point.at))
        notation = _notation(name) if not any(isinstance(value, str) for value in values) else display.key(name)
        listed = [value if isinstance(value, str) else f"{value * notation.scale:.6g}" for value in values]
        if len(values) > _VALUES:
            numbers = [value for value in values if isinstance(value, float)]
            ends = (min(numbers), max(numbers)) if len(numbers) == len(values) else (values[0], values[-1])
            listed = [f"{display.amount(name, ends[0])} to {display.amount(name, ends[1])}"]
            listed[0] += f" ({len(values)} values)"
        yield f"{display.key(name).name} = {', '.join(listed)} {notation.unit}".rstrip()


def _measured(results: StudyResults) -> str:
    study = results.study
    window = f"in the window from {window_in_words(study.window)}"
    fits = f"; fitted: {', '.join(map(display.law, study.fit))}" if study.fit else ""
    return f"{', '.join(study.measure)}, {window}".replace("_", " ") + fits


def _replicates(results: StudyResults) -> str:
    runs = [len(result.runs) for result in results.points]
    if not runs:
        return ""
    per_point = " to ".join(dict.fromkeys(str(n) for n in (min(runs), max(runs))))
    total, points = (f"{n} {what}{'' if n == 1 else 's'}" for n, what in ((sum(runs), "run"), (len(runs), "point")))
    number = results.study.discharges_per_bed
    beds = "" if number == 1 else f", each a bed with {number} discharges"
    beds = ", each a bed with the cheapest number of discharges" if number == AUTO else beds
    return f"{total} of {points}, {per_point} at each; requested: {results.study.replicates}{beds}"


def _discharges(results: StudyResults) -> Iterator[str]:
    """Shares of bed and flow of the variance of W, and the cheapest number of discharges, by point where they
    differ."""
    for line, labels in shares_in_words(results).items():
        yield line if len(labels) == len(results.points) else f"{line} (at {'; '.join(labels)})"


def _recorded(results: StudyResults) -> str:
    """Number of runs with frames, and the times between frames."""
    apart = [run.frame_interval for result in results.points for run in result.runs if run.frame_interval]
    if not apart:
        return ""
    times = " to ".join(dict.fromkeys(span(time) for time in (min(apart), max(apart))))
    return f"{len(apart)} run{'' if len(apart) == 1 else 's'}, with frames {times} apart"


def _backend(results: StudyResults) -> Iterator[str]:
    """Each backend that made runs, with version, precision and device, and how many runs."""
    makers: Counter[str] = Counter()
    for run in (run for result in results.points for run in result.runs):
        makers[f"{run.backend} (version {run.cache_version}), {run.run.point.numerics.precision}, {run.device}"] += 1
    yield "; ".join(makers if len(makers) == 1 else (f"{text}: {n} runs" for text, n in makers.items()))


def _dates(results: StudyResults, today: date) -> str:
    report = f"report of {_day(today)}"
    ended = [run.ended for result in results.points for run in result.runs]
    return f"newest run of {_day(datetime.fromisoformat(max(ended)).date())}, {report}" if ended else report


def _day(when: date) -> str:
    return f"{when.day} {when:%B %Y}"
