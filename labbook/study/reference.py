"""The `reference` section: published numbers, each for the points it was measured at."""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from labbook.fit import LAWS
from labbook.measure import MEASURES
from labbook.scene import attached
from labbook.scene.attached import AttachedError
from labbook.scene.quantities import parse
from labbook.study.absent import absent
from labbook.study.applicable import unit_of
from labbook.study.keys import Key, find, nearest
from labbook.study.measurements import NotAMeasurement, measured_values
from labbook.study.paper import Wrong
from labbook.study.point import Point
from labbook.study.problems import Problem, instead, quote
from labbook.study.schema import Reference, ReferenceEntry, Settings, Statement
from labbook.study.source import Location, StudyText, dotted

_QUANTITY = re.compile(r"[A-Za-z][A-Za-z0-9_]*(\.[^\s.]{1,40}){0,2}")
_ROOT = re.compile(r"/\d|\(")
"""Units with roots, which a study cannot write: their numbers stand without one, in SI."""
_RATES = ("kg/s", "1/s")
"""SI units of rates at which mass and grains leave: there is no comparison with a rate of zero or below."""
_ENDS = ("from", "to")
"""Ends of a statement."""
_ENTRY_KEYS = ("at", "value", "error", "from", "to", "says")
_OWN_KEYS = ("source", "file")
"""Keys of `reference` that are no quantities."""


class ReferenceReader:
    """Reads `reference`; problems are collected in `problems`."""

    def __init__(
        self,
        source: StudyText,
        points: Sequence[Point],
        names: Callable[[], set[str]],
        settings: Settings | None,
        measured: bool = False,
    ):
        """`settings`: what the study measures and fits; None if that is wrong, and units cannot be told. `measured`:
        whether the source is a line of a file of measurements, which may be for a point that is not simulated."""
        self._source, self._points, self._names, self._settings = source, points, names, settings
        self._measured = measured
        self.problems: list[Problem] = []

    def read(self) -> Reference | None:
        """The reference, or None if there is none or none that can be read."""
        raw = self._source.data.get("reference")
        if "reference" not in self._source.data:
            return None
        location: Location = ("reference",)
        if not isinstance(raw, dict):
            self._not_a_mapping(raw, location, "write `source:` and the quantities below it")
            return None
        source = raw.get("source", raw.get("file"))
        if not isinstance(source, str) or not source.strip():
            self._problem((*location, "source"), "the source is missing", "name the paper, for example Fan et al. 2023")
        entries: list[ReferenceEntry | Statement] = []
        if "file" in raw:
            entries += self._of_file(raw["file"], (*location, "file"))
        for name, content in raw.items():
            if name in _OWN_KEYS or not self._names_a_quantity(name, (*location, name)):
                continue
            items = [((*location, name), content)]
            if isinstance(content, list):
                items = [((*location, name, index), item) for index, item in enumerate(content)]
                if not content:
                    self._problem((*location, name), "the list is empty", "give at least one value, or leave it out")
            for where, item in items:
                entry = self._entry(name, item, where)
                if entry is not None:
                    entries.append(entry)
        numbers = tuple(entry for entry in entries if isinstance(entry, ReferenceEntry))
        return Reference(str(source), numbers, tuple(entry for entry in entries if isinstance(entry, Statement)))

    def _of_file(self, name: Any, location: Location) -> list[ReferenceEntry | Statement]:
        """Entries of a file of measurements."""
        if not isinstance(name, str):
            self._problem(location, f"{quote(name)} is no name of a file", "write measured.csv")
            return []
        try:
            content = attached.content(self._source.beside.attach(name))
        except AttachedError as error:
            self._problem(location, error.reason, error.remedy)
            return []
        path, entries = self._source.path.parent / name, list[ReferenceEntry | Statement | None]()
        try:
            for row in measured_values(content):
                line = StudyText(path, {}, {(): row.line})
                reader = ReferenceReader(line, self._points, self._names, self._settings, measured=True)
                if reader._names_a_quantity(row.quantity, ("quantity",)):
                    entries.append(reader._entry(row.quantity, row.entry, ()))
                self.problems += reader.problems
        except NotAMeasurement as error:
            self.problems.append(Problem(path, error.line, error.column, str(error), error.remedy))
        return [entry for entry in entries if entry is not None]

    def _not_a_mapping(self, raw: Any, location: Location, remedy: str) -> None:
        """Neither a mapping nor, as some write instead, the name of a file with numbers."""
        row = absent("reference", raw.rpartition(".")[2]) if isinstance(raw, str) else None
        self._problem(location, *((row.says, row.remedy) if row else ("a mapping of keys is needed", remedy)))

    def _names_a_quantity(self, name: str, location: Location) -> bool:
        if (row := absent("reference", name)) is not None:
            self._problem(location, row.says, row.remedy)
            return False
        if not _QUANTITY.fullmatch(name):
            self._problem(location, "this is not the name of a quantity", "write law.parameter, for example beverloo.k")
            return False
        head = name.partition(".")[0]
        if head in MEASURES or head in LAWS:
            return True
        names = self._names()
        remedy = instead(head, names)
        if head not in names and remedy.startswith("did"):
            self._problem(location, f"no law or measurement is called {head}", remedy)
            return False
        return True

    def _entry(self, name: str, raw: Any, location: Location) -> ReferenceEntry | Statement | None:
        if not isinstance(raw, dict):
            self._not_a_mapping(raw, location, "write {at: {...}, value: ...}")
            return None
        before = len(self.problems)
        is_statement = not raw.keys().isdisjoint(_ENDS)
        self._check_keys(raw, location, is_statement)
        diameter = self._points[0].scene.grains.diameter if self._points else None
        at = self._at(raw.get("at", {}), (*location, "at"), diameter)
        unit = self._unit(name, at, location, is_statement)
        keys = [key for key in ("value", "error", *_ENDS) if key in raw]
        numbers = {key: self._number(raw[key], (*location, key), diameter, unit) for key in keys}
        if len(self.problems) > before or not self._is_possible(raw, numbers, unit, location):
            return None
        if is_statement:
            return self._statement(name, at, numbers, unit or "", raw, location)
        says = raw.get("says", "")
        if not isinstance(says, str):
            self._problem((*location, "says"), "text is needed", "write its place in the paper, for example eq 14")
            return None
        return ReferenceEntry(name, at, numbers["value"] or 0.0, numbers.get("error"), says.strip(), self._measured)

    def _check_keys(self, raw: Mapping[str, Any], location: Location, is_statement: bool) -> None:
        """Note keys that are unknown, missing or, in a statement (`stated`), without a meaning."""
        for key in raw:
            if key not in _ENTRY_KEYS:
                row = absent(dotted(location), key)
                message = (row.says, row.remedy) if row else ("unknown key", instead(key, _ENTRY_KEYS))
                self._problem((*location, key), *message)
        if "value" not in raw and not is_statement:
            remedy = "add the published number, with its unit, or `from` and `to` of a statement"
            self._problem((*location, "value"), "this key is missing", remedy)
        for key in ("value", "error"):
            if key in raw and is_statement:
                remedy = "leave it out, or leave out from and to"
                self._problem((*location, key), "a statement has no value of its own", remedy)

    def _is_possible(
        self, raw: Mapping[str, Any], numbers: Mapping[str, float | None], unit: str | None, location: Location
    ) -> bool:
        """True if the error is not negative and a flow rate is above 0; a violation is noted as a problem."""
        error, value = numbers.get("error"), numbers.get("value")
        if error is not None and error < 0:
            self._problem((*location, "error"), "a standard error cannot be negative", "write the standard error")
            return False
        if unit in _RATES and value is not None and value <= 0:
            remedy = "write a rate above 0; leave out an outlet that clogs"
            self._problem((*location, "value"), f"{quote(raw['value'])}: a flow rate is above 0", remedy)
            return False
        return True

    def _statement(
        self,
        name: str,
        at: dict[str, float | str],
        ends: dict[str, float | None],
        unit: str,
        raw: Any,
        location: Location,
    ) -> Statement | None:
        low, high, says = ends.get("from"), ends.get("to"), raw.get("says")
        low, high = (-math.inf if low is None else low), (math.inf if high is None else high)
        if not low < high:
            self._problem((*location, "to"), "no number satisfies this statement", "use a `to` above `from`")
        elif not isinstance(says, str) or not says.strip():
            self._problem((*location, "says"), "this key is missing", "add what the paper says, in a few words")
        else:
            return Statement(name, at, low, high, says.strip(), unit)
        return None

    def _unit(self, name: str, at: Mapping[str, float | str], location: Location, is_statement: bool) -> str | None:
        """SI unit of the quantity; None where it cannot be told, or has one that a study cannot write."""
        if self._settings is None or not self._points:
            return None
        scenes = [point.scene for point in self._points if not at or _is_at(point, at)]
        unit = unit_of(name, self._settings, scenes or [self._points[0].scene], is_statement)
        if isinstance(unit, Wrong):
            self._problem(location, unit.reason, unit.remedy)
            return None
        return None if _ROOT.search(unit) else unit

    def _number(self, raw: Any, location: Location, diameter: float | None, unit: str | None) -> float | None:
        remedy = "write a number with its unit, if it has one"
        if unit is not None:
            example = f"{unit.removeprefix('1/')}^-1" if unit.startswith("1/") else unit
            remedy = f"write a quantity in {unit}, for example 1 {example}" if unit else "write a number without unit"
        try:
            if isinstance(raw, str):
                number = parse(raw, unit, diameter)
            elif unit and isinstance(raw, int | float):
                raise ValueError("the unit is missing")
            else:
                number = float(raw)
        except (ValueError, TypeError, OverflowError) as error:
            reason = "a number is needed" if isinstance(error, TypeError) else str(error)
            self._problem(location, f"{quote(raw)}: {reason}", remedy)
            return None
        if isinstance(raw, bool) or not math.isfinite(number):
            self._problem(location, f"{quote(raw)}: a finite number is needed", "write a number")
            return None
        return number

    def _at(self, raw: Any, location: Location, diameter: float | None) -> dict[str, float | str]:
        if not isinstance(raw, dict):
            self._problem(location, "a mapping of keys is needed", "write {container.orifice: 30 mm}")
            return {}
        at: dict[str, float | str] = {}
        for key, content in raw.items():
            keys = [known for known in find(key) if known.sweepable]
            if not keys:
                self._problem((*location, key), "there is no such key", nearest(key))
                continue
            try:
                at[key] = condition(content, keys[0], diameter)
            except ValueError as error:
                self._problem((*location, key), f"{quote(content)}: {error}", keys[0].remedy)
        if at and len(at) == len(raw):
            self._check_point(at, location)
        return at

    def _check_point(self, at: dict[str, float | str], location: Location) -> None:
        """Note an entry that is for no point; a measured one may be for other values of swept keys."""
        varied = {key for point in self._points for key in point.at} if self._measured else set[str]()
        fixed = {key: value for key, value in at.items() if key not in varied}
        if self._points and fixed and not any(_is_at(point, fixed) for point in self._points):
            of = f"{', '.join(fixed)}, which it does not sweep" if self._measured else ""
            message = f"this study has another value of {of}" if of else "this study has no such point"
            self._problem(location, message, "use the values that the study has or sweeps")

    def _problem(self, location: Location, message: str, remedy: str) -> None:
        line = self._source.line(location)
        self.problems.append(Problem(self._source.path, line, quote(dotted(location)), message, remedy))


def condition(content: Any, key: Key, diameter: float | None) -> float | str:
    """A value of `key`, in SI. Raises ValueError."""
    if key.type not in ("quantity", "integer"):
        return str(content).lower() if isinstance(content, bool) else str(content)
    if isinstance(content, str):
        return parse(content, key.unit or "", diameter)
    if isinstance(content, bool) or not isinstance(content, int | float):
        raise ValueError("a single value is needed")
    if key.unit:
        raise ValueError("the unit is missing")
    return float(content)


def _is_at(point: Point, at: Mapping[str, float | str]) -> bool:
    for key, target in at.items():
        value = point.value(key)
        if isinstance(target, str) or not isinstance(value, float):
            if value != target:
                return False
        elif not math.isclose(value, target, rel_tol=1e-9, abs_tol=1e-15):
            return False
    return True
