"""Selection of a point or a series of results by swept values, called `at`."""

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

from labbook.results import display
from labbook.results.points import ORIFICE
from labbook.results.series import Series
from labbook.scene.quantities import parse
from labbook.study import Point
from labbook.study.keys import find as find_keys
from labbook.study.problems import instead

_LISTED = 12
"""Series, points or runs that a message names."""


def point_at(points: Sequence[Point], at: Mapping[str, Any]) -> Point:
    """The point with these swept values.

    Args:
        points: the points of a study.
        at: values by key or its last part; text is read with its unit, a number is in SI.

    Raises:
        LookupError: no point has these values, or several do.
    """
    keys = list(dict.fromkeys(key for point in points for key in point.at))
    values: dict[str, float | str] = {}
    for key, value in at.items():
        names = _ending_in(str(key), keys)
        if len(names) != 1:
            raise LookupError(f"at: the study does not sweep {key}; {instead(str(key), keys)}")
        values[names[0]] = value_of_key(names[0], value, points[0])
    matches = [point for point in points if has(point.at, values)]
    if len(matches) == 1:
        return matches[0]
    there = "; ".join(listed([_as_text(point.at) for point in matches or points]))
    raise LookupError(f"{len(matches)} points are at {dict(at)}; there are: {there}")


def series_at(series: Sequence[Series], at: Mapping[str, Any] | None, like: Point) -> Series:
    """The series with these values of the keys in which series differ.

    Args:
        series: all series of a study.
        at: values as for `point_at`, and `outlet` (`slot` or `hole`) where outlets of both forms are in one silo; None
            if there is one series.
        like: a point of the study, whose grain diameter is the unit `d`.

    Raises:
        LookupError: no series has these values, or several do.
    """
    if not series:
        raise LookupError("there is no series, as no point with an orifice is done")
    selector, values = dict(at or {}), dict[str, float | str]()
    if any(each_series.of_one_form for each_series in series) and "outlet" in selector:
        form = selector.pop("outlet")
        series = [each_series for each_series in series if each_series.outlet == form]
    for key, value in selector.items():
        name = _series_key(series, str(key))
        values[name] = value_of_key(name, value, like)
    matches = [each_series for each_series in series if has(each_series.at, values)]
    if len(matches) == 1:
        return matches[0]
    there = "; ".join(listed([_as_text(_selector(each_series)) for each_series in series]))
    if at:
        raise LookupError(f"{len(matches)} series are at {dict(at)}; there are: {there}")
    raise LookupError(f"the study has several series: say which by `at`; there are: {there}")


def _selector(series: Series) -> Mapping[str, float | str]:
    """Argument `at` that selects a series."""
    return {**series.at, **({"outlet": series.outlet} if series.of_one_form else {})}


def _series_key(series: Sequence[Series], name: str) -> str:
    """The key with this name, or the only one that ends with it, among those in which series differ.

    Raises:
        LookupError: no key has this name, or several end with it.
    """
    keys = list(dict.fromkeys(key for each_series in series for key in each_series.at))
    names = _ending_in(name, keys)
    if len(names) == 1:
        return names[0]
    if len(names) > 1:
        raise LookupError(f"at: {name} may be {' or '.join(names)}")
    if name == ORIFICE or ORIFICE.endswith(f".{name}"):
        raise LookupError(
            f"at: {ORIFICE} is the axis of every series and selects none; "
            + (f"series differ in {', '.join(keys)}" if keys else "there is one series: leave out `at`")
        )
    raise LookupError(f"at: series do not differ in {name}; {instead(name, keys)}")


def key_named(name: str, keys: Sequence[str]) -> str:
    """Find the key with this name or ending among several. Raises LookupError."""
    names = _ending_in(name, keys)
    if len(names) != 1:
        raise LookupError(f"the study does not sweep {name}; {instead(name, keys)}")
    return names[0]


def _ending_in(name: str, keys: Sequence[str]) -> list[str]:
    """The keys with this name or ending."""
    return [key for key in keys if key == name or key.endswith(f".{name}")]


def has(at: Mapping[str, float | str], wanted: Mapping[str, float | str]) -> bool:
    """True if swept values have all wanted values; a wanted key that is not swept does not match."""
    return all(_equal(at.get(key), value) for key, value in wanted.items())


def value_of_key(key: str, value: Any, point: Point) -> float | str:
    """A value of a key in SI, or the word that it is; text is read as a study's, with its unit."""
    key_with_unit = next((candidate for candidate in find_keys(key) if candidate.unit is not None), None)
    if isinstance(value, str) and key_with_unit is not None:
        return parse(value, key_with_unit.unit, point.scene.grains.diameter)
    return value if isinstance(value, str) else float(value)


def _as_text(at: Mapping[str, float | str]) -> str:
    """Values of a series as text for the argument `at`: with units, and with digits that give exactly these values."""
    values: dict[str, float | str] = {}
    for key, value in at.items():
        notation = display.key(key)
        values[key] = value
        if not isinstance(value, str) and notation.unit:
            text = f"{value * notation.scale:.12g} {notation.unit}"
            with suppress(ValueError):  # units that are shown by a sign of their own
                values[key] = text if _equal(parse(text, None), value) else value
    return repr(values)


def listed(texts: Sequence[str]) -> list[str]:
    """The first of many, and how many there are."""
    return [*texts[:_LISTED], f"... ({len(texts)} in all)"] if len(texts) > _LISTED else [*texts]


def _equal(first: float | str | None, second: float | str) -> bool:
    if isinstance(first, str) or isinstance(second, str) or first is None:
        return first == second
    return math.isclose(first, second, rel_tol=1e-9)
