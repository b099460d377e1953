"""The first lines of a report: what was found, and what a reader must know before quoting it."""

import math
from collections.abc import Callable, Iterator, Sequence

from labbook.campaign import Calibrate, Goal
from labbook.commands import command
from labbook.fit import NOT_DETERMINED, FitResult
from labbook.measure.clogging import PROBABILITY
from labbook.measure.flow import CUT_SHORT
from labbook.plan.advice import limits
from labbook.report.against import changes, found_against
from labbook.report.blocks import Facts
from labbook.report.clogging import probability
from labbook.report.fitted_tables import parameter_row
from labbook.results import display
from labbook.results.budget import point_budgets
from labbook.results.budget import summed_up as budget_summed_up
from labbook.results.numerical import NUMERICS
from labbook.results.numerical import summed_up as numerics_summed_up
from labbook.results.points import FLOW_RATE, PointResult, redundant
from labbook.results.reference import agreement
from labbook.results.series import PACKING_FRACTION, Series
from labbook.results.statements import summed_up
from labbook.results.study import StudyResults
from labbook.scene.quantities import percent
from labbook.stats.rates import PooledRate, events_needed

ATTENTION = "Attention"
_LISTED = 5
"""Places that a sentence names one by one."""
_APART = 3
"""Series whose parameters are stated one by one."""
_LEADING = {"beverloo": ("C", "C_particle", "k"), "beverloo_3d": ("C", "C_particle", "k")}
"""Parameters by which a law is known, where it reports others too."""

Row = tuple[str, str]
_EXPECTED = {PACKING_FRACTION: "packing fraction", "power_released": "energy balance", "velocity_outlet": "velocities"}
"""Quantities whose lack is stated with its reason, in words."""


def result_box(results: StudyResults) -> Facts:
    """Findings of a study: rows of a term and a sentence. Rows that need attention are marked."""
    rows = [*_findings(results), *((ATTENTION, text) for text in concerns(results))]
    rows.append(("Runs", _run_counts(results)))
    return Facts(tuple(rows), frozenset({ATTENTION}))


def summary(results: StudyResults) -> list[str]:
    """The same as plain sentences."""
    return [_run_counts(results), *concerns(results), *(text for _, text in _findings(results))]


def headline(results: StudyResults) -> str:
    """Main finding in a line, for lists of studies: parameters of the first fitted law and the preferred law, else the
    range of the flow rates. Empty without finished runs."""
    fitted = [each_series for each_series in results.series if each_series.fits]
    if fitted:
        law = next(iter(fitted[0].fits))
        parameters = _parameters(law, [each_series for each_series in fitted if law in each_series.fits]).rstrip(".")
        judged = dict.fromkeys(each_series.verdict.rstrip(".") for each_series in fitted if each_series.verdict)
        verdict = f"; {next(iter(judged))}" if len(judged) == 1 else "; series differ in the law" if judged else ""
        return f"{display.law(law)}: {parameters}{verdict}."
    return next((text for _, text in _flow_rates(results)), "")


def _run_counts(results: StudyResults) -> str:
    runs = sum(len(result.runs) for result in results.points)
    return f"{_count(runs, 'run')} of {_count(len(results.points), 'point')}."


def _findings(results: StudyResults) -> list[Row]:
    if isinstance(results.study.adapt, Calibrate):  # its points differ in parameters that have no meaning alone
        return [*_goal(results)]
    rows = [*_goal(results), *_flow_rates(results), *_clogging(results)]
    rows += [*effects(results), *conclusions(results)]
    budgets = point_budgets(results)
    sentences = [budget_summed_up(budgets, quantity) for quantity in (FLOW_RATE, PACKING_FRACTION)]
    if any(sentences):
        rows.append(("Error budget", " ".join(filter(None, sentences))))
    return rows


def effects(results: StudyResults) -> list[Row]:
    """Changes of the flow rate with each swept key, in lines of a term and a sentence."""
    tested = numerics_summed_up(results.numerical)
    swept = [against for against in found_against(results) if not (tested and against.key.startswith(NUMERICS))]
    return [(_term(against.key), text) for against in swept for text in changes(against)]


def conclusions(results: StudyResults) -> list[Row]:
    """Fitted laws, agreement with the reference and its statements, and the test of numerics, in lines of a term and a
    sentence."""
    rows = _fits(results)
    if results.comparisons:
        rows.append((results.source, agreement(results.comparisons, results.source)))
    if results.judged:
        rows.append((results.source, summed_up(results.judged, results.source)))
    if tested := numerics_summed_up(results.numerical):
        rows.append(("Numerics", tested))
    return rows


def _goal(results: StudyResults) -> Iterator[Row]:
    """State of the goal: the last line of its campaign, which ends with the test of its promise."""
    if isinstance(results.study.adapt, Goal) and results.campaign:
        yield "Goal", f"{results.campaign[-1]}."


def _term(key: str) -> str:
    name = display.spoken(key)
    return name[:1].upper() + name[1:]


def _flow_rates(results: StudyResults) -> list[Row]:
    """The smallest and the largest flow rate with what was set there, and how well they are known."""
    rows: list[Row] = []
    for quantity, called in ((FLOW_RATE, "Flow rate"), (PACKING_FRACTION, "Packing fraction")):
        ordered = sorted(
            (result for result in results.points if quantity in result.pooled),
            key=lambda result: result.pooled[quantity].value,
        )
        if ordered:
            rows.append((called, _range(ordered, quantity)))
    tolerance = results.study.accuracy.flow_rate
    if tolerance is not None and results.points and all(result.precise for result in results.points):
        sentence = f"The flow rate of every point has the requested error of {percent(tolerance)} (95 % interval)."
        rows.append(("Accuracy", sentence))
    return rows


def _range(ordered: Sequence[PointResult], quantity: str) -> str:
    notation, ends = display.quantity(quantity), [ordered[0], ordered[-1]] if len(ordered) > 1 else [ordered[0]]
    texts = []
    for result in ends:
        pooled = result.pooled[quantity]
        value = f"{display.with_error(pooled.value, pooled.error, notation.scale)} {notation.unit}".rstrip()
        texts.append(f"{value} ({result.label})" if result.label else value)
    if len(texts) > 1 and ordered[0].pooled[quantity].value == ordered[-1].pooled[quantity].value:
        texts = [f"{texts[0].partition(' (')[0]} at all points"]
    return f"{notation.name} = {' to '.join(texts)}; {interval_widths(ordered, quantity)}."


def interval_widths(measured: Sequence[PointResult], quantity: str) -> str:
    """`95 % intervals of ±1.7 % to ±7 %; none at 2 points with one run`: relative half widths at points that have the
    quantity."""
    widths = [result.pooled[quantity].relative for result in measured]
    finite = sorted(width for width in widths if math.isfinite(width))
    single = "bed" if any(len(result.runs) > len(result.beds) for result in measured) else "run"
    if not finite:
        return f"one {single} per point: no errors"
    ends = dict.fromkeys(display.percentage(one) for one in (finite[0], finite[-1]))
    lacking = len(widths) - len(finite)
    return f"95 % intervals of {' to '.join(ends)}" + (
        f"; none at {_count(lacking, 'point')} with one {single}" if lacking else ""
    )


def _fits(results: StudyResults) -> list[Row]:
    """Parameters of each law with intervals, and which law the data prefer."""
    rows: list[Row] = []
    fitted = [each_series for each_series in results.series if each_series.fits]
    for law in dict.fromkeys(law for each_series in fitted for law in each_series.fits):
        mine = [each_series for each_series in fitted if law in each_series.fits]
        rows.append((display.law(law), _parameters(law, mine)))
    verdicts = {each_series.label: each_series.verdict for each_series in fitted if each_series.verdict}
    if len(set(verdicts.values())) == 1:
        rows.append(("Law", next(iter(verdicts.values()))))
    elif verdicts:
        rows.append(("Law", " ".join(f"{label}: {text}" for label, text in verdicts.items())))
    return rows


def _parameters(law: str, series: Sequence[Series]) -> str:
    names = list(dict.fromkeys(name for each_series in series for name in each_series.fits[law].parameters))
    names = [name for name in names if name in _LEADING.get(law, names)]
    if len(series) <= _APART:
        texts = [_of_series(law, names, each_series, len(series) > 1) for each_series in series]
        return f"{'; '.join(texts)}."
    parts = []
    for name in names:
        notation = display.quantity(f"{law}.{name}")
        fits = [each_series.fits[law] for each_series in series]
        values = (fit.parameters[name] for fit in fits if name in fit.parameters)
        ordered = sorted(values, key=lambda parameter: parameter.value)
        ends = [display.with_error(end.value, end.error, notation.scale) for end in (ordered[0], ordered[-1])]
        parts.append(f"{notation.name} = {ends[0]} to {ends[1]} {notation.unit}".rstrip())
    missed = [each_series for each_series in series if _misses(each_series.fits[law])]
    misfits = (
        f"; misses the points of {len(missed)} of {len(series)} series by more than their errors" if missed else ""
    )
    return f"{', '.join(parts)} ({len(series)} series){misfits}."


def _of_series(law: str, names: Sequence[str], series: Series, labelled: bool) -> str:
    fit = series.fits[law]
    parts = []
    for name in names:
        if name in fit.parameters:
            notation = display.quantity(f"{law}.{name}", fit.parameters[name].unit)
            _, value, interval = parameter_row(f"{law}.{name}", fit.parameters[name])
            estimate = f"= {value} {notation.unit}".rstrip() if value != NOT_DETERMINED else value
            if value != NOT_DETERMINED and "±" not in value:  # its interval is all that tells how well it is known
                estimate += f" (95 %: {interval})"
            parts.append(f"{notation.name} {estimate}")
    text = ", ".join(parts)
    if _misses(fit):
        text += " (misses the points by more than their errors)"
    return f"{series.label}: {text}" if labelled and series.label else text


def _misses(fit: FitResult) -> bool:
    """True if the points deviate from the law by more than their errors explain, at the 5 % level."""
    return fit.p_value < 0.05


def unfinished(results: StudyResults) -> list[str]:
    """Points and runs that are lacking, in plain sentences; nothing of a study that is complete."""
    sentences = []
    if results.missing:
        extra = redundant(results.study.points)
        names = [display.label(point.at, extra) for point in results.missing]
        sentences.append(f"Points without a finished run: {_listed(names)}.")
    partial = [
        f"{result.label} ({len(result.runs)} of {result.requested})" for result in results.points if result.partial
    ]
    if partial:
        sentences.append(f"Missing runs at {_listed(partial)}: runs that finish first are biased to fast flow.")
    return sentences


def concerns(results: StudyResults) -> list[str]:
    """Reservations about the numbers, in sentences: read them before quoting one. Empty if all is as requested."""
    study, points, sentences = results.study, results.points, []
    sentences += [*_stale(results), *unfinished(results)]
    if results.unreadable:
        sentences.append(f"{_count(len(results.unreadable), 'run')} could not be read: {results.unreadable[0]}.")
    if results.unmeasured:
        sentences.append(_unmeasured(results))
    if results.unevaluated:
        sentences.append(_unevaluated(results))
    for how in ("clogged", "diverged"):
        ended = [(point, point.outcomes[how]) for point in points if point.outcomes[how]]
        if ended:
            labels = [f"{point.label or 'the only point'} ({n} of {len(point.runs)})" for point, n in ended]
            sentences.append(f"{_count(sum(n for _, n in ended), 'run')} {how}: {_listed(labels)}.")
    sentences.append(_no_flow(results))
    suspects = [(point, run) for point in points for run in point.suspect]
    if suspects:
        verb = "is" if len(suspects) == 1 else "are"
        fate = "counted all the same (accuracy.count_suspect)" if study.accuracy.count_suspect else "left out"
        why = [f"{point.label or 'the only point'}, {run.repeat}: {run.suspect}" for point, run in suspects]
        sentences.append(f"{_count(len(suspects), 'run')} {verb} suspect and {fate}: {_listed(why)}.")
    sentences += _imprecise(results)
    sentences += _few_stops(results)
    sentences += _limits(results)
    measured = [run.measured for result in points for run in result.runs]
    for quantity, words in _EXPECTED.items():
        numbers = [one[quantity] for one in measured if quantity in one]
        if lacking := [number for number in numbers if math.isnan(number.value)]:
            sentences.append(f"No {words} in {len(lacking)} of {_count(len(numbers), 'run')}: {lacking[0].note}.")
    if trending := _labels(points, lambda one: one.trending):
        sentences.append(f"No plateau of W within the window (trending): {_listed(trending)}.")
    if cut := _labels(points, lambda one: bool(one.notes[CUT_SHORT])):
        sentences.append(
            f"The bed fell to stop.fill_height before the window ended (window.end, {study.window.end:g}) at "
            f"{'; '.join(cut)}, so that W is a mean over less than the window: lower stop.fill_height or window.end in "
            f"{study.path.name}."
            if not study.window.timed
            else f"Runs met the stop rule before the window ended (window.until, {study.window.end:g} s) at "
            f"{'; '.join(cut)}, so that W is a mean over less than the window: raise stop.discharged, or lower "
            f"window.until in {study.path.name}."
        )
    return list(dict.fromkeys(filter(None, (no_number(results), *sentences))))


def _stale(results: StudyResults) -> list[str]:
    """Reasons that runs are stale, a sentence each."""
    total = sum(len(result.runs) for result in results.points)
    return [
        f"{n} of {_count(total, 'run')} {'is' if n == 1 else 'are'} stale: {why}. labbook run makes "
        f"{'it' if n == 1 else 'them'} again."
        for why, n in results.stale.items()
    ]


def _limits(results: StudyResults) -> list[str]:
    """Warnings of `labbook plan` that limit the meaning of existing numbers, without the name of the file."""
    if not any(result.pooled for result in results.points):
        return []
    runs: dict[tuple[str, ...], list[str]] = {}
    for result in results.points:
        runs.setdefault(tuple(run.run_key for run in result.runs), []).append(result.label)
    duplicates = [
        f"These points are the same runs, as what differs between them changes nothing: {_listed(labels)}."
        for labels in runs.values()
        if len(labels) > 1
    ]
    plan_warnings = (
        text.removeprefix(f"{results.study.path}: ").partition("\n    remedy: ") for text in limits(results.study)
    )
    return [*duplicates, *(f"{reason} (remedy: {remedy})." for reason, _, remedy in plan_warnings)]


def no_number(results: StudyResults) -> str:
    """Reason that no finished run gave a number, in a sentence; empty if any did, or if none has finished."""
    if not results.points or any(result.pooled for result in results.points):
        return ""
    if results.unevaluated:
        return _unevaluated(results)
    if reason := _no_flow(results):
        return reason
    runs = [run for result in results.points for run in result.runs]
    if not any(run.counted for run in runs):
        return "No number: every run diverged or is suspect."
    notes = [
        number.note for run in runs for number in run.measured.values() if math.isnan(number.value) and number.note
    ]
    if notes:
        return f"No run gave a number: {notes[0]}."
    return _unmeasured(results) if results.unmeasured else "No run gave a number."


def _no_flow(results: StudyResults) -> str:
    """Points with runs and no flow rate, with reasons and remedies; empty if there are none."""
    points = results.points
    reasons = [
        f"at {_listed(_labels(points, lambda one, why=why: one.no_flow == why))}: {why}"
        for why in dict.fromkeys(result.no_flow for result in points if result.no_flow)
    ]
    return f"No flow rate {'; '.join(reasons)}." if reasons else ""


def _unevaluated(results: StudyResults) -> str:
    runs = f"{_count(len(results.unevaluated), 'run')} not evaluated yet"
    return f"{runs}: {command('fit', results.study.path.name)} evaluates them."


def _unmeasured(results: StudyResults) -> str:
    failed = _count(len(results.unmeasured), "measurement")
    return f"{failed} could not be made: {results.unmeasured[0]}."


def _clogging(results: StudyResults) -> list[Row]:
    """The largest and the smallest probability of a stop per grain, with their intervals."""
    rates = [
        (q, result.label) for result in results.points if isinstance(q := result.pooled.get(PROBABILITY), PooledRate)
    ]
    if not rates:
        return []
    rates.sort(key=lambda pair: pair[0].high)
    ends = [rates[-1]] if len(rates) == 1 else [rates[-1], rates[0]]
    parts = [f"{probability(q)}{f' at {label}' if label else ''}" for q, label in ends]
    return [("Clogging", f"q = {' and '.join(parts)} stops per grain (95 %).")]


def _few_stops(results: StudyResults) -> list[str]:
    """Points at which fewer stops were counted than the requested error of their probability needs."""
    error = results.study.accuracy.clogging
    if error is None:
        return []
    needed = events_needed(error)
    rates = {result.label or "the only point": result.pooled.get(PROBABILITY) for result in results.points}
    few = [f"{label} ({q.events} of {needed} stops)" for label, q in rates.items()
           if isinstance(q, PooledRate) and q.events < needed]  # fmt: skip
    return [f"The requested error of {percent(error)} of q is not reached at {_listed(few)}."] if few else []


def _imprecise(results: StudyResults) -> list[str]:
    if results.study.accuracy.flow_rate is None or not results.points:
        return []
    tolerance = percent(results.study.accuracy.flow_rate)
    if short := _labels(results.points, lambda one: one.precise is False):
        return [f"The requested error of {tolerance} of the flow rate is not reached at {'; '.join(short)}."]
    return []


def _labels(points: Sequence[PointResult], wanted: Callable[[PointResult], bool]) -> list[str]:
    return [result.label or "the only point" for result in points if wanted(result)]


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    return "; ".join(names[:_LISTED]) + more


def _count(n: int, noun: str) -> str:
    return f"{n} {noun}{'' if n == 1 else 's'}"
