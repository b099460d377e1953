"""Section of the page on clogging: probability of a stop, tests of a flow without memory, and laws of D/d."""

import math
from collections.abc import Sequence
from pathlib import Path

from labbook.measure.clogging import transient
from labbook.report import figures
from labbook.report.blocks import Block, Formula, Prose, Section, picture
from labbook.report.fitted_tables import parameter_row
from labbook.report.tables import Table
from labbook.results import display
from labbook.results.clogging import FEW_BEDS, PointClogging, SeriesClogging, clogging
from labbook.results.points import FLOW_RATE
from labbook.results.study import StudyResults
from labbook.scene import Scene
from labbook.stats.rates import PooledRate
from labbook.stats.survival import Correlation


def clogging_sections(results: StudyResults, folder: Path) -> list[Section]:
    """Figure and tables of every series; none where clogging is not measured."""
    every = clogging(results)
    sections = []
    for index, series in enumerate(every):
        suffix = f"-{index + 1}" if len(every) > 1 else ""
        stem = folder / f"clogging{suffix}"
        figure = picture(figures.clogging_figure(series), stem, "survival, hazard and mean of avalanches", _CAPTION)
        blocks: list[Block] = [clogging_table(series), figure, memory_table(series)]
        blocks += [table] if (table := times_table(series)) is not None else []
        blocks += [Prose(sentence) for sentence in series.doubts]
        blocks += [Section(fit.law.name.capitalize(), (Formula(fit.law.formula, fit.law.source), table))
                   for fit, table in zip(series.fits, law_tables(series), strict=True)]  # fmt: skip
        blocks += [Prose(series.verdict)] if series.verdict else []
        blocks += [Prose(f"Not fitted: {problem}.", note=True) for problem in series.problems]
        sections.append(Section(series.series.label or "Clogging", tuple(blocks)))
    return sections if len(sections) < 2 else [Section("Clogging", tuple(sections))]


def clogging_table(series: SeriesClogging) -> Table:
    """Every point: stops, grains, the probability of a stop with both intervals, the mean avalanche, and W."""
    flow = display.quantity(FLOW_RATE)
    rows = []
    for point in series.points:
        q, result = point.probability, point.result
        runs = f"{result.outcomes['clogged']} of {len(result.runs)}"
        head = (result.label or "the only point", f"{point.width_ratio:.3g}", runs)
        rates = [display.with_error(w.value, w.error, flow.scale) if w is not None else "–"
                 for w in (result.flow_rate, point.flowing)]  # fmt: skip
        if q is None:
            rows.append((*head, "–", "–", "–", "–", "–", "–", *rates))
            continue
        low, high = point.over_beds
        interval = f"{_short(low)} to {_short(high)}" if math.isfinite(low) and not q.bound else "–"
        rows.append(
            (*head, str(q.events), f"{q.exposure:.0f}", probability(q), interval, _mean(point),
             f"{point.preceding:.2g}" if math.isfinite(point.preceding) else "–", *rates)
        )  # fmt: skip
    headings = ("point", "D/d", "clogged", "stops", "grains", "q (95 %)", "q over packings", "mean avalanche", "F")
    notes = [_TABLE.format(transient=_transients(series))]
    if any(len(point.result.beds) < FEW_BEDS for point in series.points):
        notes.append(f"Of fewer than {FEW_BEDS} packings the interval over packings is too narrow.")
    return Table((*headings, f"{flow.heading}", f"{flow.heading}, flowing"), tuple(rows), notes=tuple(notes))


def memory_table(series: SeriesClogging) -> Table:
    """Tests of whether the flow has no memory, and of whether avalanches are independent."""
    rows = []
    for point in series.points:
        p = point.hazard.p if point.hazard is not None else math.nan
        chance = f"{p:.2g}" if math.isfinite(p) else "–"
        inside = str(point.within_transient)
        rows.append(
            (point.result.label, chance, inside, _correlation(point.consecutive), _correlation(point.within_beds))
        )
    headings = ("point", "p of a constant hazard", "stops within the transient", "consecutive", "within packings")
    return Table(headings, tuple(rows), notes=(_MEMORY,))


def times_table(series: SeriesClogging) -> Table | None:
    """Times between grains of the points whose walls move: tail, verdict and flowing fraction; None without any."""
    rows, reasons = [], []
    for point in (point for point in series.points if point.times is not None):
        label, fraction = point.result.label or "the only point", f"{point.flowing_fraction:.3g}"
        if isinstance(point.tail, str):
            rows.append((label, fraction, *("–",) * 7))
            reasons.append(f"{label}: {point.tail}.")
            continue
        tail = point.tail
        alpha = f"{tail.alpha:.2f} ({tail.low:.2f} to {tail.high:.2f})"
        counts = f"{tail.n} (+{tail.censored} censored)"
        ratios = f"{tail.exponential:.1f}", f"{tail.stretched:.1f}", f"{point.tail_goodness:.2g}"
        rows.append((label, fraction, alpha, f"{tail.t_min:.3g}", counts, *ratios, tail.verdict))
    headings = ("point", "flowing fraction", "α (95 %)", "t_min [s]", "times", "ln L, exponential",
                "ln L, stretched", "p", "verdict")  # fmt: skip
    return Table(headings, tuple(rows), frozenset({0, 8}), notes=(_TIMES, *reasons)) if rows else None


def law_tables(series: SeriesClogging) -> list[Table]:
    """Parameters of each fitted law with their intervals."""
    tables = []
    for fit in series.fits:
        rows = tuple(parameter_row(name, found)[:3] for name, found in fit.parameters.items())
        aicc = f"{fit.aicc:.1f}" if math.isfinite(fit.aicc) else "not known (too few outlets)"
        p = f", p = {fit.p_value:.2g}" if math.isfinite(fit.p_value) else ""
        note = f"Maximum likelihood of stops and grains at {len(fit.x)} outlets. Deviance {fit.deviance:.3g}{p}"
        note += f"; AICc {aicc}."
        note += f" alpha = {fit.context.dimension}, the dimension." if "alpha" in fit.law.formula else ""
        tables.append(Table(("parameter", "value", "95 % interval"), rows, notes=(note,)))
    return tables


def probability(q: PooledRate) -> str:
    """`0.06 (0.045 to 0.08)`, or `< 0.0004` where no stop was counted."""
    return f"< {_short(q.high)}" if q.bound else f"{_short(q.value)} ({_short(q.low)} to {_short(q.high)})"


def _mean(point: PointClogging) -> str:
    mean, low, high = point.mean_avalanche
    return f"> {_short(low)}" if math.isinf(mean) else f"{_short(mean)} ({_short(low)} to {_short(high)})"


def _short(value: float) -> str:
    return display.number(float(f"{value:.2g}"))


def _transients(series: SeriesClogging) -> str:
    scenes = [(point.result.point.scene, point.outlet_index or 0) for point in series.points]
    after = (
        "" if all(scene.restart is None for scene, _ in scenes) else f", and {_range(scenes, False)} of each restart"
    )
    return f"{_range(scenes, True)} grains of each opening{after}"


def _range(scenes: Sequence[tuple[Scene, int]], opening: bool) -> str:
    """Smallest and largest transient of scenes and indices of their outlets."""
    first = sorted({transient(scene, opening, outlet_index) for scene, outlet_index in scenes})
    return " to ".join(dict.fromkeys((str(first[0]), str(first[-1]))))


def _correlation(found: Correlation) -> str:
    return f"{found.value:.2f} ({found.low:.2f} to {found.high:.2f})" if math.isfinite(found.value) else "–"


_CAPTION = (
    "Left: part of the avalanches that are longer than s (Kaplan and Meier); grey: a flow without memory. Middle: "
    "stops per grain in bins of s, over their mean. Right: mean avalanche with 95 % intervals and fitted laws; arrows: "
    "lower bounds of outlets without a stop."
)
_TABLE = (
    "q is the probability that a grain is the last before a stop: stops over grains, both beyond the first "
    "{transient}. Runs that ended without a stop are censored: their grains count. Interval of q: exact for a Poisson "
    "count; over packings: bootstrap. F is the part of the states of flow that precede a stop, 1/(1 + ⟨s⟩/s_m) "
    "(form as quoted from Thomas and Durian 2015). s_m is the number of grains that leave while one falls by d at the "
    "outlet. W is "
    "the mean of replicates that did not clog. W, flowing: mass over time of flow of all replicates, clogged ones up "
    "to their stop, which is not biased to those that flow on."
)
_TIMES = (
    "Times between grains where walls move: P(t >= T) = (T/t_min)^(1 - α). For α ≤ 2 the mean time diverges: “clogs” "
    "and “flows” are P(α ≤ 2) above 0.95 and below 0.05. ln L: ratio of the likelihood of the power law to that of an "
    "exponential and of a stretched exponential tail. Above 0 the power law is better. A stretched exponential has it "
    "as a limit: it is better below −2. p: probability that a power law is farther from its fit (parametric bootstrap "
    "with t_min as it is). Below 0.1 the tail is no power law, and α has no meaning. Flowing fraction: part of the "
    "time without gaps (window.gap)."
)
_MEMORY = (
    "In a flow without memory the hazard is constant. Consecutive: correlation of ln s of avalanches after each other "
    "in one silo. Within packings: rank correlation of the first avalanches of one packing; above 0.1 more packings "
    "are needed instead of more discharges."
)
