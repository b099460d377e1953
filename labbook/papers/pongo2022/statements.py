"""Judgement of statements of a reference on a rotating bottom."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

from labbook.fit import LAWS
from labbook.papers.pongo2022.rotation import (
    CONFIDENCE,
    FLOW,
    ROTATION,
    TRENDS,
    Rotation,
    along_rotation,
    drop_of,
    rise_of,
    trend,
)
from labbook.results import display
from labbook.results.points import PointResult, by_seed
from labbook.results.reference import matches
from labbook.results.series import Series
from labbook.results.statements import LACKING, Judged
from labbook.stats import Pooled
from labbook.stats.ratio import paired_ratio
from labbook.study import Statement

TURNING = "rotation"
"""Head of statements `rotation.QUANTITY`, on the quantity over that with the bottom at rest."""
FEATURES = ("drop", "minimum", "rise", "for_O_zz", *TRENDS)
"""Features of statements `rotation.QUANTITY.FEATURE`.

| feature            | number                                                                        |
|--------------------|-------------------------------------------------------------------------------|
| `drop`             | 1 less the smallest ratio, in size, while turning                             |
| `minimum`          | the frequency at which the quantity is smallest in size [Hz]                   |
| `rise`             | at the fastest rotation over the smallest at slower ones                      |
| `for_O_zz`         | of O_rr: what it gains over what O_zz loses                                   |
| `drop_with_length`, `drop_with_orifice` | slope of ln(at rest / smallest) by L/d, by D [1/m] |
| `rise_with_length`, `rise_with_orifice` | slope of ln(fastest / smallest) by L/d, by D [1/m] |

`rotation.LAW.PARAMETER`, of a law that the study fits, is the parameter at the fastest over that at the slowest turning
bottom, along a straight line of its logarithm against f.
"""
_HOW = (
    "Ratios to the bottom at rest are of means over the seeds that both have, with 90 % intervals; so is the frequency "
    "of a minimum, from curves drawn from the scatter between seeds. The smallest of several means is a little too "
    "small by being chosen."
)


_NONE = "run points with the bottom at rest and turning"
_TREND = (
    "Trends with length and orifice are slopes of one plane through ln of the drop or the rise of all curves, with "
    "90 % intervals from their scatter about it. Where beds clog at rest the ratios are those of the beds that flow."
)
_ALONG = "Parameters against the rotation: along a line of their logarithm, with 90 % intervals from the scatter."


def judged(statement: Statement, curves: Sequence[Rotation], series: Sequence[Series] = ()) -> list[Judged]:
    """Judge a statement on `rotation.QUANTITY` or one of its FEATURES.

    Args:
        statement: The statement.
        curves: Curves of the study.
        series: Series of the study, for parameters of laws.

    Returns:
        A judgement at each curve that the statement applies to; for a trend one over all these curves; for a parameter
        of a law one for each group of series that differ in the rotation only.
    """
    quantity = statement.quantity.partition(".")[2]
    name, _, feature = quantity.partition(".")
    if feature in TRENDS:
        return [replace(_trend(statement, name, feature, curves), how=_TREND)]
    if name in LAWS:
        ratios = [replace(ratio, how=_ALONG) for ratio in _along(statement, name, feature, series)]
        why = f"fit {name} to outlets over turning bottoms"
        return ratios or [Judged(statement, display.label(statement.at), None, why=why)]
    judgements = [judgement for curve in curves for judgement in _turning(statement, quantity or FLOW, curve)]
    if not judgements:
        return [Judged(statement, display.label(statement.at), None, why=_NONE)]
    return [replace(judgement, how=_HOW) for judgement in judgements]


def _turning(statement: Statement, name: str, curve: Rotation) -> Iterator[Judged]:
    """Judge `QUANTITY` over that at rest, at each frequency, or `QUANTITY.FEATURE` (see FEATURES)."""
    conditions = {key: value for key, value in statement.at.items() if key != ROTATION}
    if not matches(conditions, curve.points[0].point):
        return
    quantity, _, feature = name.partition(".")
    where = ", ".join(filter(None, (curve.shape, curve.label)))
    if not curve.has(quantity):
        yield Judged(statement, where, None, why=f"{quantity} was not measured at two frequencies")
        return
    if feature in ("", "for_O_zz"):
        for k, result in enumerate(curve.points):
            if k and matches(statement.at, result.point):
                at = f"{where}, f = {curve.frequencies[k]:g} Hz"
                if result.partial or curve.points[0].partial:
                    yield Judged(statement, at, None, why=LACKING)
                    continue
                ratio = curve.ratio(quantity, k) if not feature else _exchange(curve, k)
                yield _of_ratio(statement, at, ratio, (curve.points[0], result))
        return
    if curve.unfinished:
        rotations = ", ".join(f"{f:g}" for f in curve.unfinished)
        yield Judged(statement, where, None, why=f"{LACKING} (f = {rotations} Hz)")
        return
    lowest = curve.lowest(quantity)
    if lowest is None:
        yield Judged(statement, where, None, why="a minimum needs three frequencies")
    elif feature == "minimum" and not any(statement.low <= f <= statement.high for f in curve.frequencies):
        yield Judged(statement, where, None, why="no frequency of the study lies where it is stated")
    elif feature == "minimum":
        extreme = curve.minimum(quantity)
        if extreme is None:
            ours, why = float(curve.frequencies[lowest]), "its interval needs two seeds"
            yield Judged(statement, where, ours, why=why, points=curve.points)
        else:
            ours, low, high = extreme.frequency, extreme.low, extreme.high
            yield Judged(statement, where, ours, low=low, high=high, points=curve.points)
    elif feature == "rise":
        yield _of_ratio(statement, where, rise_of(curve, quantity), curve.points)
    else:
        yield _of_ratio(statement, where, drop_of(curve, quantity), curve.points)


def _trend(statement: Statement, quantity: str, feature: str, curves: Sequence[Rotation]) -> Judged:
    """Judge a slope through all curves that the statement applies to and that have all their runs."""
    matching = [curve for curve in curves if matches(statement.at, curve.points[0].point)]
    whole = [curve for curve in matching if not curve.unfinished]
    where = display.label(statement.at)
    if not whole:
        return Judged(statement, where, None, why=LACKING if matching else _NONE)
    try:
        slope, used = trend(whole, quantity, feature)
    except ValueError as problem:
        return Judged(statement, where, None, why=str(problem))
    points = tuple(point for curve in used for point in curve.points)
    where = f"{len(used)} of {len(matching)} curves"
    return Judged(statement, where, slope.value, slope.error, slope.low, slope.high, points=points)


def _along(statement: Statement, law: str, parameter: str, series: Sequence[Series]) -> Iterator[Judged]:
    groups: dict[tuple, list[Series]] = {}
    for line in series:
        if ROTATION in line.at and float(line.at[ROTATION]) != 0 and matches(statement.at, line.points[0].point):
            groups.setdefault(tuple((name, v) for name, v in line.at.items() if name != ROTATION), []).append(line)
    for at, group in groups.items():
        fitted = [(line, number) for line in group if (number := line.parameters(law).get(parameter)) is not None]
        where, points = display.label(dict(at)), tuple(point for line, _ in fitted for point in line.points)
        if any(point.partial for point in points):
            yield Judged(statement, where, None, why=LACKING)
        elif len(fitted) < 3 or any(number.value <= 0 for _, number in fitted):
            yield Judged(statement, where, None, why=f"a trend needs {law}.{parameter} above 0 at three frequencies")
        else:
            rotations = [abs(float(line.at[ROTATION])) for line, _ in fitted]
            comparison = along_rotation(rotations, [number.value for _, number in fitted])
            yield Judged(statement, where, *comparison, points=points)


def _exchange(curve: Rotation, k: int) -> Pooled | None:
    """Gain of O_rr over loss of O_zz, from rest to point k, paired by seeds."""
    values = [by_seed(curve.points[i], f"orifice_O_{c}{c}") for i in (0, k) for c in "rz"]
    seeds = sorted(set.intersection(*map(set, values)))
    if not seeds:
        return None
    r0, z0, r, z = ([numbers[s] for s in seeds] for numbers in values)
    gained, lost = [b - a for a, b in zip(r0, r, strict=True)], [a - b for a, b in zip(z0, z, strict=True)]
    return paired_ratio(gained, lost, CONFIDENCE)


def _of_ratio(statement: Statement, where: str, ratio: Pooled | None, points: tuple[PointResult, ...]) -> Judged:
    if ratio is None:
        return Judged(statement, where, None, why="no seed has both runs")
    return Judged(statement, where, ratio.value, ratio.error, ratio.low, ratio.high, pairs=ratio.n, points=points)
