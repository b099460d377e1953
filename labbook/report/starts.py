"""Section of the page on fitted laws against the start of the window."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from labbook.fit import LAWS
from labbook.report import figures
from labbook.report.blocks import Block, Folded, Section, picture, slug
from labbook.report.tables import Table
from labbook.results import display
from labbook.results.reference import of_reference
from labbook.results.series import Series
from labbook.results.starts import AtStart, at_starts
from labbook.results.study import StudyResults


def start_sections(results: StudyResults, folder: Path) -> list[Section]:
    """Parameters of each law for several starts of the window: figure and table."""
    starts = at_starts(results)
    blocks: list[Block] = []
    for law in dict.fromkeys(law for series in results.series for law in series.fits) if starts else ():
        fitted = [series for series in results.series if law in series.fits]
        figure = figures.parameters_against_start(starts, fitted, law, _independent(law, fitted), results.comparisons)
        called = display.law(law)
        stem = folder / f"start-{slug(called)}"
        blocks.append(picture(figure, stem, f"parameters of {called} against the start of the window", _CAPTION))
        table = start_table(results, starts, law, fitted)
        blocks.append(Folded(f"{called}: the numbers", (table,)) if len(fitted) > 1 else table)
    return [Section("Against the start of the window", tuple(blocks))] if blocks else []


def start_table(results: StudyResults, starts: Sequence[AtStart], law: str, fitted: Sequence[Series]) -> Table:
    """Tabulate the parameters of a law: a row for each series and start, and one for the reference where it has any."""
    names = list(dict.fromkeys(name for series in fitted for name in series.parameters(law)))
    symbols = {name: display.quantity(f"{law}.{name}") for name in names}
    rows: list[tuple[str, ...]] = []
    for series in fitted:
        for at in starts:
            moved = at.of(series)
            if moved is None or law not in moved.fits:
                continue
            parameters = moved.parameters(law)
            values = (display.with_error(parameters[name].value, parameters[name].error, symbols[name].scale)
                      if name in parameters else "–" for name in names)  # fmt: skip
            rows.append((series.label, start_label(at, series), *values, f"{moved.fits[law].chi2_reduced:.2g}"))
        if reference := of_reference(results.comparisons, law, series):
            values = (display.number(reference[name], None, symbols[name].scale) if name in reference else "–"
                      for name in names)  # fmt: skip
            rows.append((series.label, results.source, *values, "–"))
    headings = ("series", "start", *(symbol.heading for symbol in symbols.values()), "χ²/ν")
    if not any(series.label for series in fitted):
        return Table(headings[1:], tuple(row[1:] for row in rows), notes=(NOTE,))
    return Table(headings, tuple(rows), frozenset({0, 1}), notes=(NOTE,))


def start_label(at: AtStart, series: Series) -> str:
    """Label of a start, with the number of runs of the series that have no steady part."""
    unsteady = at.unsteady_in(series)
    return f"{at.label}; {unsteady} run{'' if unsteady == 1 else 's'} without steady part" if unsteady else at.label


def _independent(law: str, fitted: Iterable[Series]) -> list[str]:
    """One name for each free parameter of a law: C by one density, and not the slope as well."""
    available = {name for series in fitted for name in series.parameters(law)}
    names: dict[int, str] = {}
    for reported in LAWS[law].parameters.values():
        if reported.name in available:
            names.setdefault(reported.free, reported.name)
    return list(names.values())


_CAPTION = (
    "Fits to flow rates from windows that open at other discharged fractions; the end of the window stays. Bars: one "
    "standard error. Ring: the stated window. Hollow: windows that open at the end of the start-up of each run, at "
    "their mean. Dotted: the reference."
)
NOTE = (
    "Start: mass discharged when the window opens; auto: at the end of the start-up of each run (mean over runs). ± is "
    "one standard error. All rows rest on the same runs, so that they differ by less than their errors by chance."
)
