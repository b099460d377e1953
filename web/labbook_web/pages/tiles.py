"""The three tiles with which the page of a study begins: the range of the flow rate, what matters, and attention."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from labbook.campaign import Calibrate
from labbook.measure.arch import Arch
from labbook.report.result_box import Row, concerns, conclusions, effects, interval_widths, no_number, unfinished
from labbook.results import display
from labbook.results.explore import DesignSurface, explore
from labbook.results.points import FLOW_RATE, PointResult, RunResult
from labbook.results.study import StudyResults
from labbook.results.surface import NoSurface
from labbook_web.pages.explore import bars
from labbook_web.pages.sheet import leading, unit_of

_SENTENCES = 3
"""Largest number of sentences of a tile; the rest is folded."""
_LONGEST = 160
"""Characters of a sentence on laws, such as of many series, from which on it is folded."""
_STOPS = 3
"""Largest number of clogged points that a tile links."""


@dataclass(frozen=True)
class End:
    """End of a range.

    Attributes:
        name: `smallest` or `largest`; `mean` or `at all points` where both are the same.
        text: Mean with its interval.
        label: Settings of its point.
        point: Number of the point, from 1.
    """

    name: str
    text: str
    label: str
    point: int


@dataclass(frozen=True)
class Range:
    """Range of the means of a quantity over all points.

    Attributes:
        heading: Name of the quantity.
        text: Smallest and largest mean.
        unit: Unit of the numbers.
        ends: Points of both ends; a single one of a single point.
        widths: Sentence on the relative widths of the 95 % intervals.
    """

    heading: str
    text: str
    unit: str
    ends: tuple[End, ...]
    widths: str


@dataclass(frozen=True)
class CloggedPoint:
    """A point at which runs clogged.

    Attributes:
        label: Its settings.
        clogged: Number of its runs that clogged.
        runs: Number of its runs.
        run_key: Key of the clogged run with most data on the arch.
    """

    label: str
    clogged: int
    runs: int
    run_key: str


@dataclass(frozen=True)
class Tiles:
    """Answers of a study.

    Attributes:
        range: Range of the flow rate, or of the first quantity that has a number; None without any.
        nothing: Why there is no number.
        bars: Share of each swept key in the variance, with its interval.
        verdict: Which key matters more.
        findings: Terms and sentences: laws, changes, references.
        more_findings: Those behind "show".
        attention: Sentences that limit the numbers.
        more_attention: Those behind "show".
        stops: Points at which runs clogged.
        waiting: How many runs are there while the study runs; empty if none is lacking.
    """

    range: Range | None
    nothing: str
    bars: list[dict[str, Any]]
    verdict: str
    findings: tuple[Row, ...]
    more_findings: tuple[Row, ...]
    attention: tuple[str, ...]
    more_attention: tuple[str, ...]
    stops: tuple[CloggedPoint, ...]
    waiting: str


def tiles(results: StudyResults, progress: Mapping[str, Any], surface: DesignSurface | None) -> Tiles:
    """Sum up the results of a study.

    Args:
        results: Of a study with at least one finished run.
        progress: As `labbook_web.pages.lab.progress` gives it. While processes make runs, missing ones are no cause for
            alarm.
        surface: As `surface_of` gives it.
    """
    rows = bars(surface) if surface is not None else []
    findings = [*conclusions(results), *(effects(results) if not rows else [])]
    lacking = unfinished(results) if progress["running"] else []
    nothing = no_number(results)
    short = [row for row in findings if len(row[1]) <= _LONGEST][:_SENTENCES]
    sentences = [text for text in concerns(results) if text not in (*lacking, nothing)]
    return Tiles(
        value_range(results),
        nothing,
        rows,
        surface.verdict if surface is not None and len(surface.factors) > 1 else "",
        tuple(short),
        tuple(row for row in findings if row not in short),
        tuple(sentences[:_SENTENCES]),
        tuple(sentences[_SENTENCES:]),
        _stops(results),
        f"{progress['done']} of {progress['asked']} runs so far: all numbers are preliminary." if lacking else "",
    )


def surface_of(results: StudyResults) -> DesignSurface | None:
    """Response surface of the flow rate over all swept keys of numbers; None if the points do not determine it."""
    with suppress(LookupError, NoSurface):
        return explore(results)
    return None


def value_range(results: StudyResults) -> Range | None:
    """Range of the means over all points; None without any, and of a calibration, whose points are no result."""
    quantity = leading(results)
    if isinstance(results.study.adapt, Calibrate):
        return None
    ranked = sorted(
        (result for result in results.points if quantity in result.pooled),
        key=lambda result: result.pooled[quantity].value,
    )
    if not ranked:
        return None
    unit = unit_of(results, quantity)
    ends = [ranked[0], ranked[-1]] if len(ranked) > 1 else ranked
    numbers = dict.fromkeys(
        display.number(result.pooled[quantity].value, result.pooled[quantity].error, unit.scale) for result in ends
    )
    names = ("smallest", "largest") if len(numbers) > 1 else ("at all points" if len(ranked) > 1 else "mean",)
    return Range(
        f"Flow rate {unit.name}" if quantity == FLOW_RATE else unit.name,
        " to ".join(numbers),
        unit.unit,
        tuple(_end(name, result, quantity, unit) for name, result in zip(names, ends, strict=False)),
        interval_widths(ranked, quantity),
    )


def _end(name: str, result: PointResult, quantity: str, unit: display.Notation) -> End:
    text = display.with_interval(result.pooled[quantity], unit.scale)
    return End(name, text, result.label if name != "at all points" else "", result.point.index + 1)


def _stops(results: StudyResults) -> tuple[CloggedPoint, ...]:
    """Points with clogged runs, those with most of them first."""
    clogged = [(result, [run for run in result.runs if run.outcome == "clogged"]) for result in results.points]
    clogged = sorted((pair for pair in clogged if pair[1]), key=lambda pair: -len(pair[1]) / len(pair[0].runs))
    return tuple(
        CloggedPoint(result.label or "the only point", len(runs), len(result.runs), representative_run(runs).run_key)
        for result, runs in clogged[:_STOPS]
    )


def representative_run(runs: Sequence[RunResult]) -> RunResult:
    """Choose the run with most data: one that measured the arch, else one with frames, else the first."""
    return min(runs, key=lambda run: (Arch.name not in run.measures, not run.recorded))
