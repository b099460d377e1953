"""The tables of a report, as rows of text: the same for the page and for the terminal."""

import math
import statistics
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

from labbook.measure.flow import FlowRate
from labbook.measure.measure import FLOWING
from labbook.results import display
from labbook.results.budget import NOT_MEASURED, SOURCES, Share, budgets
from labbook.results.numerical import Numerical
from labbook.results.points import FLOW_RATE, PointResult
from labbook.results.reference import Comparison
from labbook.results.series import Series
from labbook.results.study import StudyResults
from labbook.scene.quantities import percent, value_range
from labbook.stats import Measured, Pooled
from labbook.stats.equivalence import replicates_needed
from labbook.stats.rates import PooledRate
from labbook.study.extensions import used_by_analysis

CONVENTIONS = (
    "Intervals are 95 %, by Student’s t on n replicates: those that gave a flow rate. ± is one standard error, from "
    "the scatter between replicates."
)
SEVERAL = "Beds are the replicates: each counts by the mean over its discharges."
CLOGGED = "Clogged runs while they flowed"
"""Title of `flowing_table`."""
ALONE = "For points with one fed run: from the scatter within the run, by Student’s t on its blocks."


@dataclass(frozen=True)
class Table:
    """Headings and rows of text. `text`: columns that are words; `marked`: rows that stand out; `notes` go below."""

    kind: ClassVar[str] = "table"
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    text: frozenset[int] = frozenset({0})
    marked: frozenset[int] = frozenset()
    notes: tuple[str, ...] = ()


_FLOW = ("flow_rate", "grain_rate", "flow_rate_drift", "gap_time")


def flow_table(results: StudyResults) -> Table:
    """Every point: what was swept, its pooled flow rate with errors, and what a reader must know of it."""
    swept = _swept(results)
    quantities = _measured(results, of_flow=True)
    flow = [column for column in quantities if column.quantity == FLOW_RATE]
    other_quantities = [column for column in quantities if column.quantity != FLOW_RATE and not _is_flowing(column)]
    rows = []
    for result in results.points:
        pooled = result.flow_rate
        scale = display.quantity(FLOW_RATE).scale
        value, interval, n = ("–", "–", 0)
        if pooled is not None:
            value, interval, n = display.number(pooled.value, pooled.error, scale), _interval(pooled, scale), pooled.n
        own = (value, interval) if flow else ()
        runs = str(n) if n == len(result.beds) else f"{n} of {len(result.beds)}"
        runs += f" ({len(result.runs)} runs)" if len(result.runs) > len(result.beds) else ""
        rows.append((*_at(result, swept), *own, *_cells(result, other_quantities), runs, "; ".join(_remarks(result))))
    headings = (
        *_headings(swept, flow),
        *(("95 % interval",) if flow else ()),
        *_headings((), other_quantities),
        "n",
        "remarks",
    )
    alone = results.study.fed and any(len(result.runs) == 1 for result in results.points)
    notes = (CONVENTIONS, ALONE) if alone else (CONVENTIONS,)
    if any(len(result.runs) > len(result.beds) for result in results.points):
        notes += (SEVERAL,)
    return Table(headings, tuple(rows), frozenset({len(headings) - 1}), notes=notes)


def flowing_table(results: StudyResults) -> Table | None:
    """Points with clogged runs: rates of these runs while grains still left; None without any."""
    swept = _swept(results)
    quantities = [one for one in _measured(results, of_flow=True) if _is_flowing(one)]
    names = {one.quantity for one in quantities}
    rows = tuple(
        (*_at(result, swept), *_cells(result, quantities)) for result in results.points if names & result.pooled.keys()
    )
    return Table(_headings(swept, quantities), rows, frozenset()) if rows else None


def _is_flowing(measured: Measured) -> bool:
    return measured.quantity.endswith(FLOWING)


def _interval(pooled: Pooled, scale: float) -> str:
    """`66.5 to 73.4 (±4.9 %)`, or `unknown`."""
    if not math.isfinite(pooled.half_width):
        return display.percentage(pooled.relative)
    low, high = (display.number(end, pooled.error, scale) for end in (pooled.low, pooled.high))
    return f"{low} to {high} ({display.percentage(pooled.relative)})"


def further_table(results: StudyResults) -> Table | None:
    """Every point: whatever else was measured, pooled over replicates; None if nothing was. Points with the same
    numbers, as those that share packings, stand in one row."""
    swept, measured = _swept(results), _measured(results, of_flow=False)
    if not measured:
        return None
    groups: dict[tuple[str, ...], list[tuple[str, ...]]] = {}
    for result in results.points:
        groups.setdefault(_cells(result, measured), []).append(_at(result, swept))
    rows = tuple((*at, *cells) for cells, settings in groups.items() for at in _together(settings))
    return Table(_headings(swept, measured), rows, frozenset())


def _together(rows: Sequence[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """One row for places that are all combinations of the values of their keys, `18, 21, 24` of one key; else a row for
    each."""
    values = [list(dict.fromkeys(column)) for column in zip(*rows, strict=True)]
    if len(rows) == 1 or math.prod(map(len, values)) != len(set(rows)):
        return list(rows)
    return [tuple(_listed(each) for each in values)]


def _listed(values: Sequence[str]) -> str:
    """All values, or the first and the last of many with their number."""
    few = len(values) <= _FEW
    return ", ".join(values) if few else f"{values[0]} to {values[-1]} ({len(values)} values)"


_FEW = 6


def _swept(results: StudyResults) -> list[str]:
    """Keys that were swept, and after them those that follow from them."""
    along = (name for result in results.points for name in result.along)
    return list(dict.fromkeys((*(name for result in results.points for name in result.at), *along)))


def _measured(results: StudyResults, of_flow: bool) -> list[Measured]:
    """One example of each pooled quantity, flow rate first: that one wherever it was asked for."""
    examples: dict[str, Measured] = {}
    for result in results.points:
        for run in result.runs:
            examples |= {name: m for name, m in run.measured.items() if name in result.pooled and name not in examples}
    if FlowRate.name in results.study.measure and FLOW_RATE not in examples:
        examples[FLOW_RATE] = Measured(FLOW_RATE, math.nan, math.nan, 0, "", "", "kg/s")
    ordered = sorted(examples, key=lambda name: _FLOW.index(name) if name in _FLOW else len(_FLOW))
    return [examples[name] for name in ordered if (name.removesuffix(FLOWING) in _FLOW) == of_flow]


def _headings(swept: Iterable[str], measured: Iterable[Measured]) -> tuple[str, ...]:
    named = (display.quantity(m.quantity, m.unit).heading for m in measured)
    return (*(display.key(name).heading for name in swept), *named)


def _at(result: PointResult | Series, swept: Iterable[str]) -> tuple[str, ...]:
    at = {**result.at, **result.along}
    return tuple(display.amount(name, at[name]) if name in at else "–" for name in swept)


def _cells(result: PointResult, measured: Iterable[Measured]) -> tuple[str, ...]:
    cells = []
    for m in measured:
        pooled = result.pooled.get(m.quantity)
        scale = display.quantity(m.quantity, m.unit).scale
        if isinstance(pooled, PooledRate) and pooled.bound:
            cells.append(f"< {display.number(pooled.high, None, scale)}")
            continue
        cells.append("–" if pooled is None else display.with_error(pooled.value, pooled.error, scale))
    return tuple(cells)


def _remarks(result: PointResult) -> list[str]:
    remarks = [result.remark] if result.remark else []
    remarks += [f"{note} ({n})" for note, n in result.notes.items() if note != "trending"]
    if result.precise is False:
        remarks.append(f"requested error of {percent(result.tolerance or 0)} not reached")
    return remarks


def budget_table(results: StudyResults) -> Table:
    """The error of every number that reports lead with, by source, in percent of it."""
    swept, rows = _swept(results), []
    reasons: dict[str, None] = {}
    for budget in budgets(results):
        cells = {share.source: _share(share) for share in budget.shares}
        total = "–" if len(budget.unmeasured) == len(budget.shares) else _fraction(budget.total)
        if budget.quantity == FLOW_RATE:
            reasons |= dict.fromkeys(f"{share.source}: {share.basis}" for share in budget.shares)
        rows.append((budget.name, _at(budget.of, swept), (*(cells.get(source, "–") for source in SOURCES), total)))
    rows = [(name, *at, *cells) for name, at, cells in _once(rows)]
    headings = ("of", *_headings(swept, ()), *SOURCES, "sum of known parts")
    unmeasured = [reason for reason in reasons if NOT_MEASURED in reason]
    return Table(headings, tuple(rows), frozenset({0}), notes=(_BUDGET, *unmeasured))


def _once(rows: Sequence[tuple[str, tuple[str, ...], tuple[str, ...]]]) -> Iterator[tuple[str, tuple[str, ...], tuple]]:
    """Names, places and cells; those of a name that are the same everywhere stand once."""
    for name in dict.fromkeys(row[0] for row in rows):
        mine = [row for row in rows if row[0] == name]
        if len(mine) > 1 and len({cells for _, _, cells in mine}) == 1:
            yield name, tuple("all" for _ in mine[0][1]), mine[0][2]
        else:
            yield from mine


def _share(share: Share) -> str:
    if share.relative is None:
        return "–"
    return f"{_fraction(share.relative)} ({share.beside})" if share.beside else _fraction(share.relative)


def _fraction(fraction: float) -> str:
    return percent(fraction, ".2f")


_BUDGET = (
    "Relative to the value. Seeds: half width of the 95 % interval. Numerics: the largest difference in this study, or "
    "for W, if there is none, the calibrated bound of the bias. Window: for W, half of the significant drift, that "
    "beyond its 95 % interval; for fitted parameters the largest "
    "difference to windows that open at 0.1, 0.15, 0.2 and at the end of the start-up. Filling, bed: the largest "
    "difference in this study."
)


_DIGEST = 12
"""Numbers of a reference from which on a digest is shown above them."""


def digest_table(comparisons: Sequence[Comparison]) -> Table | None:
    """Of each quantity of a reference: how many numbers, how many agree, and how far the others are; None for few."""
    groups: dict[str, list[Comparison]] = {}
    for comparison in comparisons:
        if comparison.inside is not None:
            groups.setdefault(comparison.quantity, []).append(comparison)
    if sum(map(len, groups.values())) < _DIGEST:
        return None
    rows = []
    for quantity, group in groups.items():
        agreeing = sum(member.inside is True for member in group)
        sizes = sorted(abs(member.relative) for member in group if math.isfinite(member.relative))
        middle = percent(statistics.median(sizes)) if sizes else "–"
        largest = percent(sizes[-1]) if sizes else "–"
        rows.append((display.quantity(quantity).name, str(len(group)), str(agreeing), middle, largest))
    headings = ("quantity", "numbers", "inside our 95 % intervals", "median difference", "largest")
    return Table(headings, tuple(rows))


INSIDE = "inside interval"
"""Heading of what `inside` gives."""


def inside(one: Comparison) -> str:
    """Tell in a word if the reference lies inside our 95 % interval."""
    return {True: "yes", False: "no", None: "–"}[one.inside]


def comparison_table(comparisons: Iterable[Comparison]) -> Table:
    """The reference's numbers beside ours; rows of numbers outside our 95 % intervals are marked."""
    rows, marked, reasons = [], set(), []
    for index, c in enumerate(comparisons):
        notation = display.quantity(c.quantity, c.unit)
        reference = display.with_error(c.reference, c.reference_error or math.nan, notation.scale)
        name = f"{notation.heading}, {c.says}" if c.says else notation.heading
        if c.ours is None:
            rows.append((name, c.label, reference, "–", "–", "–", "–"))
            reasons.append(f"{notation.name}{f' at {c.label}' if c.label else ''}: {c.why}.")
            continue
        interval = (
            f"{display.number(c.low, c.error, notation.scale)} to {display.number(c.high, c.error, notation.scale)}"
        )
        ours = display.with_error(c.ours, c.error, notation.scale)
        deviation = "–" if math.isnan(c.relative) else percent(c.relative, "+.1f").replace("-", "−")
        rows.append((name, c.label, reference, ours, interval, deviation, inside(c)))
        if c.inside is False:
            marked.add(index)
    headings = ("quantity", "at", "reference", "ours", "95 % interval", "difference", INSIDE)
    notes = (
        "The last column: whether the reference lies inside our 95 % interval, widened by the reference’s error if it "
        "gives one. Rows with numbers outside are bold.",
        *reasons,
    )
    return Table(headings, tuple(rows), frozenset({0, 1}), frozenset(marked), notes)


def outcomes_table(results: StudyResults) -> Table:
    """Number of runs by outcome, with their points."""
    total: Counter[str] = Counter()
    where: dict[str, list[str]] = {}
    for result in results.points:
        total.update(result.outcomes)
        for outcome in result.outcomes:
            where.setdefault(outcome, []).append(result.label)
        if result.trending:
            where.setdefault("trending", []).append(result.label)
        if result.suspect:
            where.setdefault("suspect", []).append(result.label)
    total["suspect"] = sum(len(result.suspect) for result in results.points)
    total["trending"] = sum(result.trending for result in results.points)
    rows = [
        (name, str(n), "all" if len(where[name]) == len(results.points) else "; ".join(where[name]))
        for name, n in total.items()
        if n
    ]
    notes: tuple[str, ...] = ()
    if total["trending"]:
        notes = ("Trending points have no plateau: W still changes within the window. The number counts points.",)
    if total["suspect"]:
        fate = "They are counted." if results.study.accuracy.count_suspect else "They are left out."
        notes += (f"Suspect runs ended as listed above, but their ledger shows a fault. {fate}",)
    return Table(("outcome", "runs", "points"), tuple(rows), frozenset({0, 2}), notes=notes)


def provenance_table(results: StudyResults) -> Table:
    """Provenance of the runs: facts on which all agree, the number of values where they differ, and the extensions that
    the analysis uses now."""
    skipped = {"seed", "sessions"}
    facts: dict[str, list] = {}
    for run in (run for result in results.points for run in result.runs):
        for name, value in _flat(run.provenance):
            if name not in skipped:
                facts.setdefault(name, []).append(value)
    rows = []
    for name, values in facts.items():
        if all(isinstance(v, float) for v in values):
            low, high = min(values), max(values)
            text = f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"
            if name.endswith("time"):
                text += f" s, {sum(values):.4g} s in all"
        else:
            distinct = list(dict.fromkeys("not known" if v is None else str(v) for v in values))
            text = "; ".join(distinct[:6]) + (f"; and {len(distinct) - 6} more" if len(distinct) > 6 else "")
        rows.append((name.replace("_", " "), text))
    rows += [(f"analysis: {package.use}", package.made_by) for package in used_by_analysis(results.study)]
    return Table(("item", "value"), tuple(rows), frozenset({0, 1}))


def runs_table(results: StudyResults) -> Table:
    """Point, seed and discharge, outcome and key of every run."""
    rows = tuple(
        (
            result.label,
            run.repeat.removeprefix("seed "),
            f"{run.outcome}, suspect" if run.suspect else run.outcome,
            run.run_key,
        )
        for result in results.points
        for run in result.runs
    )
    return Table(("point", "seed", "outcome", "run key"), rows, frozenset({0, 2, 3}))


def _flat(facts, prefix: str = ""):
    for name, value in facts.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{name} ")
        else:
            yield prefix + name, value


def numerical_table(comparisons: Sequence[Numerical]) -> Table:
    """Every comparison: both means, their difference with its interval, and what the test of equivalence shows."""
    notation = display.quantity(FLOW_RATE)
    rows, notes = [], [_OF_NUMERICS]
    for comparison in comparisons:
        means = [
            "–" if flow is None else display.with_error(flow.value, flow.error, notation.scale)
            for flow in (comparison.first.flow_rate, comparison.second.flow_rate)
        ]
        runs = f"{len(comparison.first.beds)}, {len(comparison.second.beds)}"
        rows.append((comparison.label, comparison.where or "–", runs, *means, *_numerical_cells(comparison)))
        if comparison.test is not None and comparison.finding == "undecided":
            need = replicates_needed(comparison.test, min(len(comparison.first.beds), len(comparison.second.beds)))
            number = "more than 1000" if need is None else str(need)
            notes.append(
                f"{comparison.label}: {number} replicates of each would decide with a power of 90 % if W is the same."
            )
    margin = next((one.margin for one in comparisons if one.margin is not None), None)
    if margin is None:
        notes.append("Equivalence is not tested: no margin is stated (accuracy.numerics).")
    else:
        notes.insert(1, _NUMERICS_TESTED.format(margin=percent(margin)))
    headings = ("changed", "at", "runs", f"first {notation.heading}", f"other {notation.heading}", "difference")
    return Table(
        (*headings, "90 % interval", "p", "power", "finding"),
        tuple(rows),
        frozenset({0, 1, 9}),
        frozenset(k for k, one in enumerate(comparisons) if one.finding == "different"),
        tuple(notes),
    )


def _numerical_cells(comparison: Numerical) -> tuple[str, ...]:
    test = comparison.test
    if test is None:
        return ("–", "–", "–", "–", comparison.why)
    low, high = (display.number(end, test.error, 100) for end in (test.low, test.high))
    difference = f"{display.with_error(test.difference, test.error, 100)} %"
    if not comparison.finding:
        return (difference, f"{low} to {high} %", "–", "–", "–")
    return (difference, f"{low} to {high} %", f"{test.p:.2g}", percent(test.power, ".0f"), comparison.finding)


_OF_NUMERICS = (
    "Differences are relative to the mean at the value listed first; ± is one standard error: of differences "
    "seed by seed if both start from the same packings, else of independent means."
)


_NUMERICS_TESTED = (
    "Two one-sided tests at 5 % with a margin of ±{margin}: equivalent if the interval lies within the margin, "
    "different if it lies beyond, undecided otherwise. Power: probability of equivalence if W is the same."
)


def orifice_table(rows: Sequence[tuple[PointResult, Mapping[str, Pooled]]]) -> Table:
    """Means of fields above the orifice of each point, over its recorded runs."""
    names = list(dict.fromkeys(name for _, means in rows for name in means))
    cells = []
    for result, means in rows:
        numbers = ("–" if name not in means else _mean(name, means[name]) for name in names)
        cells.append((result.label, *numbers, str(means["stagnant_fraction"].n)))
    headings = ("point", *(display.quantity(f"orifice.{name}").heading for name in names), "recorded runs")
    layer = value_range((result.layer for result, _ in rows), "mm", 1e3)
    remarks = [
        _ORIFICE.format(layer),
        *(meaning for name, meaning in _OF_ORIFICE.items() if name in names),
    ]
    if any("v_z" not in means for _, means in rows):
        remarks.append("there are none (–) where no grain was in this layer, or where a cell of the fields is thicker")
    alone = any(mean.n < 2 for _, means in rows for mean in means.values())
    errors_note = " Errors need two recorded runs (record.replicates)." if alone else ""
    return Table(headings, tuple(cells), notes=(f"{'; '.join(remarks)}.{errors_note}",))


_ORIFICE = "Means over the first {} above the orifice, weighted by the packing fraction, in the window"
_OF_ORIFICE = {
    "kinetic_pressure": "p_k is the trace of the kinetic stress",
    "S": "S is the largest eigenvalue of the mean orientation tensor",
}
"""Meaning of the columns of that table, by quantity."""


def _mean(name: str, pooled: Pooled) -> str:
    return display.with_error(pooled.value, pooled.error, display.quantity(f"orifice.{name}").scale)
