"""Tables of what happens at outlets: parameters of profiles, flow put together again, means above orifices."""

from collections.abc import Mapping, Sequence

from labbook.fit.outlet import CROSSINGS
from labbook.report import display
from labbook.report.approach import approaches
from labbook.report.comparison import Comparison, at_series
from labbook.report.fitted_tables import parameter_table
from labbook.report.points import PointResult
from labbook.report.ratios import Ratio
from labbook.report.series import Series
from labbook.report.tables import Table
from labbook.stats import Pooled


def profile_table(series: Series, definition: str, comparisons: Sequence[Comparison] = (), source: str = "") -> Table:
    """Parameters of the profiles along the outlets of a series, beside the reference."""
    fit = series.profiles[definition]
    collapse = f"Root mean square about the domes: {fit.misfit[0]:.2g} of v_c, {fit.misfit[1]:.2g} of φ_c."
    notes = (collapse, *(f"{note[:1].upper()}{note[1:]}." for note in fit.notes))
    return parameter_table(definition, fit.parameters, at_series(comparisons, definition, series), source, notes)


def approach_table(
    ratios: Sequence[Ratio], definition: str, comparisons: Sequence[Comparison] = (), source: str = ""
) -> Table | None:
    """Limit, depth and rate of tilts and exponents against s*, beside the reference; None of too few places."""
    fitted = {name: one.approach for name, one in approaches(ratios, definition).items() if one.approach is not None}
    parameters = {f"{name}.{term}": p for name, law in fitted.items() for term, p in law.parameters.items()}
    known = {c.quantity.partition(".")[2]: c for c in comparisons if c.quantity.startswith(f"{definition}.")}
    return parameter_table(definition, parameters, known, source) if parameters else None


_OF_OUTLET = {
    "v_c": "v_c [m/s]",
    "phi_c": "φ_c",
    "direct": "∫/W",
    "centred": "eq 14/W",
    "printed": "printed/W",
    "eccentric": "eq 18/W",
}


def outlet_table(series: Series, definition: str) -> Table:
    """Each outlet of a series: middle of its profiles, and the flow that they come to over the flow counted."""
    fit = series.profiles[definition]
    whole = definition == CROSSINGS  # what crosses is what is counted
    shown = {name: heading for name, heading in _OF_OUTLET.items() if not (whole and name == "direct")}
    rows = tuple(
        (
            f"{result.orifice * 1e3:g}",
            *(display.with_error(getattr(one, name).value, getattr(one, name).error) for name in shown),
        )
        for result, one in zip(series.profiled, fit.outlets, strict=True)
    )
    measured = "" if whole else "by integrating them as measured; "
    notes = (
        f"Flow of the profiles over the flow counted, W: {measured}by eq 14 with v_c and φ_c of each outlet; by eq 14 "
        "as printed, with γ and φ_∞ (φ_c where φ_∞ could not be fitted); by eq 18.",
    )
    return Table(("D [mm]", *shown.values()), rows, frozenset(), notes=notes)


def orifice_table(rows: Sequence[tuple[PointResult, Mapping[str, Pooled]]]) -> Table:
    """Means of fields above the orifice of each point, over its recorded runs."""
    names = list(dict.fromkeys(name for _, means in rows for name in means))
    cells = []
    for result, means in rows:
        shown = ("–" if name not in means else _mean(name, means[name]) for name in names)
        cells.append((result.label, *shown, str(means["stagnant_fraction"].n)))
    headings = ("point", *(display.quantity(f"orifice.{name}").heading for name in names), "recorded runs")
    note = (
        "Means over the first centimetre above the orifice, weighted by the packing fraction, in the window; p_k is "
        "the trace of the kinetic stress, S the largest eigenvalue of the mean orientation tensor. Errors need two "
        "recorded runs (record.replicates)."
    )
    return Table(headings, tuple(cells), notes=(note,))


def _mean(name: str, pooled: Pooled) -> str:
    return display.with_error(pooled.value, pooled.error, display.quantity(f"orifice.{name}").scale)
