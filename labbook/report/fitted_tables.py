"""Tables of fitted parameters, with the reference's beside ours where it has any."""

import itertools
import math
from collections.abc import Iterator, Mapping
from types import MappingProxyType

from labbook.fit import NOT_DETERMINED, FitResult, Parameter
from labbook.report.tables import INSIDE, Table, inside
from labbook.results import display
from labbook.results.reference import Comparison
from labbook.scene.quantities import percent


def fit_table(
    law: str, fit: FitResult, comparisons: Mapping[str, Comparison] = MappingProxyType({}), source: str = ""
) -> Table:
    """Parameters of a fit with standard errors and intervals, beside the reference; goodness and notes below."""
    goodness = f"χ² = {fit.chi2:.3g} with {fit.dof} degree{'' if fit.dof == 1 else 's'} of freedom"
    if math.isfinite(fit.p_value):
        goodness += f" (p = {fit.p_value:.2g}{', F test: the errors are estimates' if fit.error_dof else ''})"
    if math.isfinite(fit.aicc):
        goodness += f"; AICc = {fit.aicc:.4g}".replace("-", "−")
    notes = (
        goodness + ".",
        *(f"{note[:1].upper()}{note[1:]}." for note in fit.notes),
        *_together(law, fit, comparisons, source),
    )
    return parameter_table(law, fit.parameters, comparisons, source, notes)


def _together(law: str, fit: FitResult, comparisons: Mapping[str, Comparison], source: str) -> Iterator[str]:
    """Test the reference's parameters jointly, in each set of them that leaves no parameter of the law free.

    Parameters fitted to a measurement are left out: their errors are correlated, and the test has no covariance.
    """
    reported = fit.law.reported(fit.context)
    published = {name: comparison for name, comparison in comparisons.items() if not comparison.measured}
    names = [
        [parameter.name for parameter in reported if parameter.free == free and parameter.name in published]
        for free in range(len(fit.law.free))
    ]
    for group in itertools.product(*names) if len(names) > 1 else ():
        try:
            p = fit.together({name: published[name].reference for name in group})
        except ValueError:
            continue
        parameters_text = " and ".join(
            display.quantity(f"{law}.{name}", fit.parameters[name].unit).name for name in group
        )
        where = f"{'within' if p >= 1 - fit.confidence else 'outside'} our joint {percent(fit.confidence)} region"
        yield f"{parameters_text} of {source} together: {where} (p = {p:.2g}, F test)."


def parameter_table(
    law: str,
    parameters: Mapping[str, Parameter],
    comparisons: Mapping[str, Comparison],
    source: str,
    notes: tuple[str, ...] = (),
) -> Table:
    """Parameters of `law` with intervals and, where the reference has any (`known`), whether it lies inside."""
    rows = [parameter_row(f"{law}.{name}", parameter) for name, parameter in parameters.items()]
    headings = ("parameter", "value", "95 % interval")
    theirs = [comparisons.get(name) for name in parameters]
    if not any(theirs):
        return Table(headings, tuple(rows), notes=notes)
    rows = [(*row, *_beside(one)) for row, one in zip(rows, theirs, strict=True)]
    far = frozenset(k for k, comparison in enumerate(theirs) if comparison is not None and comparison.inside is False)
    return Table((*headings, source, INSIDE), tuple(rows), marked=far, notes=notes)


def _beside(comparison: Comparison | None) -> tuple[str, str]:
    """The reference's number, and whether it lies inside our interval."""
    if comparison is None:
        return "–", "–"
    scale = display.quantity(comparison.quantity, comparison.unit).scale
    return display.with_error(comparison.reference, comparison.reference_error or math.nan, scale), inside(comparison)


def parameter_row(quantity: str, parameter: Parameter) -> tuple[str, str, str]:
    """A parameter with its interval; one without an end, or far wider than the value, leaves no value to quote."""
    notation = display.quantity(quantity, parameter.unit)
    width = parameter.high - parameter.low
    digits = width / 4  # about a standard error, also where the linearised one means nothing
    ends = (display.number(end, digits, notation.scale) for end in (parameter.low, parameter.high))
    if not parameter.determined(notation.about_zero):
        value = NOT_DETERMINED
    elif parameter.error > width:
        value = display.number(parameter.value, digits, notation.scale)
    else:
        value = display.with_error(parameter.value, parameter.error, notation.scale)
    return notation.heading, value, " to ".join(ends)
