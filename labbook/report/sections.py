"""Sections of the page for each series: figures with their captions, and tables."""

import math
from collections.abc import Hashable, Sequence
from pathlib import Path

from labbook.fields.pattern import SLOW
from labbook.measure.acceleration import AccelerationProfile
from labbook.report import figures
from labbook.report.blocks import Beside, Block, Formula, Picture, Prose, Section, picture
from labbook.report.figures.flow import panel_content
from labbook.report.figures.orifice import side_by_side, zero_of
from labbook.report.fitted_tables import fit_table
from labbook.report.paper import beds_shown_by_all, blocks_of_all
from labbook.report.tables import orifice_table
from labbook.results import display
from labbook.results.points import PointResult
from labbook.results.recorded import acceleration, flow_patterns, pooled_means
from labbook.results.reference import at_series
from labbook.results.series import Series
from labbook.results.study import StudyResults
from labbook.scene.quantities import value_range


def series_sections(results: StudyResults, folder: Path) -> list[Section]:
    """Figures, tables and remarks of every series. Single points to which no law is fitted share theirs."""
    alone = [
        each_series
        for each_series in results.series
        if len(each_series.points) == 1 and not each_series.fits and not each_series.further
    ]
    merged = alone if len(alone) > 1 else []
    sections = [
        _series(results, k, folder) for k, each_series in enumerate(results.series) if each_series not in merged
    ]
    if merged:
        sections.append(_together(results, merged, folder, "-points" if sections else ""))
    if len(sections) < 2:
        return sections
    return [Section("Series by series", tuple(sections))]


def _series(results: StudyResults, index: int, folder: Path) -> Section:
    series = results.series[index]
    suffix = f"-{index + 1}" if len(results.series) > 1 else ""
    where = f" ({series.label})" if series.label else ""
    laws: list[Block] = []
    for law, law_fit in series.fits.items():
        table = fit_table(law, law_fit, at_series(results.comparisons, law, series), results.source)
        laws.append(Section(display.law(law), (Formula(law_fit.law.formula, law_fit.law.source), table)))
    laws += [Prose(series.verdict)] if series.verdict else []
    blocks: list[Block] = laws
    if series.fits or len(series.used) > 1:  # a single point shows nothing
        figure = figures.flow_against_orifice(series, results.comparisons, results.source)
        stem = folder / f"{'fit' if series.fits else 'orifice'}{suffix}"
        fit = picture(figure, stem, f"a power of W against orifice{where}", fit_caption(series))
        blocks = [Beside((fit,), tuple(laws))]
    patterns, lacking = _patterns_if_they_can_be(results, series, folder, suffix, where)
    blocks += [Prose(f"Not fitted: {problem}.", note=True) for problem in series.problems]
    blocks += [Prose(text, note=True) for text in lacking]
    blocks.append(_flow(series, folder, suffix, where))
    blocks += patterns
    blocks += blocks_of_all(results, series, folder, suffix, where)
    return Section(series.label or "Flow rate against orifice", tuple(blocks))


def _together(results: StudyResults, series: Sequence[Series], folder: Path, suffix: str) -> Section:
    """Points that are series by themselves, in one section."""
    points = tuple(each_series.whole_points[0] for each_series in series)
    whole = series_of_points(points)
    problems = dict.fromkeys(problem for each_series in series for problem in each_series.problems)
    patterns, lacking = _patterns_if_they_can_be(results, whole, folder, suffix, "")
    blocks: list[Block] = [Prose(f"Not fitted: {problem}.", note=True) for problem in problems]
    blocks += [Prose(text, note=True) for text in lacking]
    return Section("Flow rate against time", (*blocks, _flow(whole, folder, suffix, ""), *patterns))


def series_of_points(points: tuple[PointResult, ...]) -> Series:
    """Points as one series to which no law is fitted: figures with a panel for each of them are one figure."""
    return Series({}, points, {}, frozenset(), frozenset(), (), ())


def _flow(series: Series, folder: Path, suffix: str, where: str) -> Picture:
    figure = figures.flow_against_time(series)
    return picture(figure, folder / f"flow{suffix}", f"W against time{where}", flow_caption(series))


def fit_caption(series: Series) -> str:
    """Caption of W against the orifice of a series."""
    fits = f"; {_FITS}" if series.fits else "."
    fits += _ZERO if any(zero_of(fit) is not None for fit in series.fits.values()) else ""
    return f"{_POINTS}{fits}{marks(series.points, series.flagged if series.fits else frozenset())}"


def marks(points: Sequence[PointResult], flagged: frozenset[Hashable] = frozenset()) -> str:
    """Legend of hollow points, dashed bars and crosses, as far as a figure of these points has any.

    Args:
        points: Points of the figure.
        flagged: Identities of points that lie outside a law's range or have no plateau.

    Returns:
        Sentences for a caption, each after a space.
    """
    with_flow = [result for result in points if result.flow_rate is not None]
    outside = any(result.identity in flagged for result in with_flow)
    text = ""
    if any(result.hollow for result in with_flow) or outside:
        text += f" Hollow: {'outside a law’s range, or ' if outside else ''}with a remark in the table"
        text += "; they take part in the fit." if outside else "."
    if any(result.flow_rate and not math.isfinite(result.flow_rate.half_width) for result in with_flow):
        text += " Dashed bar: one run, the interval is unknown."
    return text + (" Cross at the foot: no flow rate." if len(with_flow) < len(points) else "")


def flow_caption(series: Series) -> str:
    """Caption of W(t) of all points of a series."""
    content = panel_content(series)
    if not content.window:
        return f"{_FLOW} No run has enough grains in the window for a mean."
    interval = " and its 95 % interval" if content.interval else ""
    return f"{_FLOW} {_WINDOW}{f'; in it the pooled mean{interval}' if content.mean else ''}."


def _patterns_if_they_can_be(
    results: StudyResults, series: Series, folder: Path, suffix: str, where: str
) -> tuple[list[Block], list[str]]:
    """Flow patterns of points that no paper shows in a section of its own, and sentences on missing figures."""
    elsewhere = beds_shown_by_all(results)
    points = [result for result in series.whole_points if id(result) not in elsewhere]
    blocks, lacking = [], []
    try:
        blocks += _patterns(points, folder, suffix, where)
    except ImportError as missing:
        lacking.append(f"Flow patterns are not shown: {missing}.")
    return [*blocks, *acceleration_figures(points, folder, suffix, where)], lacking


def _patterns(points: Sequence[PointResult], folder: Path, suffix: str, where: str) -> list[Block]:
    patterns = [pattern for pattern in map(flow_patterns, points) if pattern]
    if not patterns:
        return []
    figure = figures.flow_patterns([pattern[0] for pattern in patterns])
    block = picture(figure, folder / f"patterns{suffix}", f"how the beds flow{where}", PATTERNS)
    table = orifice_table([(pattern[0].result, pooled_means(pattern)) for pattern in patterns])
    return [Section("How the beds flow", (block, table))]


def acceleration_figures(points: Sequence[PointResult], folder: Path, suffix: str, where: str) -> list[Block]:
    profiles = [(result, profile) for result in points if (profile := acceleration(result)) is not None]
    if not profiles:
        return []
    figure = figures.acceleration_against_height(profiles, profiles[0][0].point.scene.gravity)
    alt = f"acceleration against height{where}"
    return [picture(figure, folder / f"acceleration{suffix}", alt, acceleration_caption(profiles))]


def acceleration_caption(profiles: Sequence[tuple[PointResult, AccelerationProfile]]) -> str:
    """Caption of the acceleration against height of points."""
    return _ACCELERATION.format(value_range((profile.interval for _, profile in profiles), "ms", 1e3))


def overview_caption(fitted: Sequence[Series]) -> str:
    """Caption of the flow rates of all series."""
    lines = _FIRST_LAW if any(each_series.fits for each_series in fitted) else ""
    flagged = frozenset[Hashable]().union(*(each_series.flagged for each_series in fitted))
    marked = marks([result for each_series in fitted for result in each_series.points], flagged)
    return f"{_OVERVIEW}{_BESIDE if side_by_side(fitted) else ''}{lines}{marked}"


_OVERVIEW = "Flow rates of all series with 95 % intervals."
_BESIDE = " Points at one D are drawn side by side."
_FIRST_LAW = " Lines: the first law fitted."
_POINTS = "Points: pooled mean with its 95 % interval"
_FITS = (
    "lines: fits, dotted beyond the fitted points; bands of 95 % of the law and, fainter, of one more point of as many "
    "seeds; below: relative residuals with their 95 % intervals (thin) and with the standard errors that fit and test "
    "use, pooled over points (thick)."
)
_ZERO = " Bar on the axis: k d of Beverloo’s law with its 95 % interval, where the line meets zero."
_FLOW = "W(t) of every replicate."
_WINDOW = "Shaded: the window, between the requested fractions of mass discharged (mean over replicates)"

PATTERNS = (
    "First recorded run of each point. Above: velocities of the grains at one moment, in the middle of the window; "
    "arrows are as long as the square root of the speed. Below: mean speed in the window with streamlines; hatched: "
    f"stagnant, that is slower than {SLOW:g} times the speed at which the section at that height sinks as a whole. "
    "Percentages: stagnant part of the bed’s mass."
)
_ACCELERATION = (
    "Mean change of the vertical velocity within {}, of grains that start at this "
    "height within a quarter of the outlet’s width from its middle, in the window; 1 is free fall. Grains that leave "
    "meanwhile are continued by free fall. Bars: standard errors over grains, a lower bound."
)
