"""Section of the page on a calibration: parameters, picture of the posterior, sensitivities and next experiments."""

from pathlib import Path

from labbook.report import figures
from labbook.report.blocks import Block, Prose, Section, Verbatim, picture
from labbook.report.tables import Table
from labbook.results import display
from labbook.results.calibrated import CalibrationResults, NoPosterior, calibration
from labbook.results.study import StudyResults
from labbook.scene.quantities import percent
from labbook.stats.emulator import LearnMissing

_ROWS = 5
"""Experiments that are listed."""


def calibrated_sections(results: StudyResults, folder: Path) -> list[Section]:
    """Results of a calibration."""
    try:
        result = calibration(results)
    except (NoPosterior, LearnMissing) as problem:
        return [Section("Calibration", (Prose(f"{problem}."),))]
    figure = figures.posterior_figure(result)
    blocks: list[Block] = [
        parameter_table(result),
        Prose(". ".join(result.lines()) + "."),
        picture(figure, folder / "posterior", "the posterior of the parameters", _caption(result)),
        agreement_table(result),
    ]
    if not result.lacking:
        blocks += [sensitivity_table(result), experiment_table(result)]
        blocks.append(Section("Material card", (Verbatim(result.card()),)))
    return [Section("Calibration", tuple(blocks))]


def parameter_table(result: CalibrationResults) -> Table:
    """Prior, median and interval of each parameter."""
    rows = []
    for key, entry in result.parameters.items():
        unit, prior = display.key(key), result.goal.parameters[key]
        error = (entry.high - entry.low) / 4
        median, low, high = (display.number(x, error, unit.scale) for x in (entry.median, entry.low, entry.high))
        kind = "loguniform" if prior.logarithmic else "uniform"
        ends = (
            f"{kind}, {display.number(prior.low, None, unit.scale)} to {display.number(prior.high, None, unit.scale)}"
        )
        rows.append((unit.heading, median, f"{low} to {high}", f"±{percent(entry.relative, '.2g')}", ends))
    headings = ("parameter", "median", "95 % interval", "half width", "prior")
    return Table(headings, tuple(rows), notes=(_LIKELIHOOD,))


def agreement_table(result: CalibrationResults) -> Table:
    """Measured values beside the model."""
    rows = []
    for entry in result.agreements:
        unit = display.quantity(entry.quantity)
        measured = f"{display.with_error(entry.value, entry.error, unit.scale)} {unit.unit}".rstrip()
        rows.append((result.quantity_label(entry), measured, result.amount(entry.quantity, entry.model)))
    for entry in result.predictions:
        unit = display.quantity(entry.quantity)
        measured = "not measured"
        if entry.measured is not None and entry.error is not None:
            measured = f"{display.with_error(entry.measured, entry.error, unit.scale)} {unit.unit}".rstrip()
        rows.append(
            (f"{result.quantity_label(entry)} (prediction)", measured, result.amount(entry.quantity, entry.interval))
        )
    return Table(("quantity", "measured", "model"), tuple(rows), notes=(_PREDICTED,))


def sensitivity_table(result: CalibrationResults) -> Table:
    """Sobol indices of each measured quantity."""
    keys, rows = [*result.parameters], []
    taking_part = [entry for entry in result.agreements]
    for (quantity, number), of in result.inference.sobol_indices().items():
        entry = [agreement for agreement in taking_part if agreement.quantity == quantity][number]
        rows.append((result.quantity_label(entry), *(f"{of[key][0]:.2f} ({of[key][1]:.2f})" for key in keys)))
    return Table(("quantity", *(display.key(key).name for key in keys)), tuple(rows), notes=(_INDICES,))


def experiment_table(result: CalibrationResults) -> Table:
    """Measurements that would narrow the posterior most."""
    rows = tuple(
        (result.quantity_label(entry), percent(entry.error), f"{entry.gain:.2f}")
        for entry in result.experiments[:_ROWS]
    )
    return Table(("next experiment", "its standard error", "posterior narrower by"), rows, notes=(_GAIN,))


def _caption(result: CalibrationResults) -> str:
    """Caption of the picture of the posterior."""
    return _CAPTION if len(result.parameters) > 1 else _CAPTION_OF_ONE


_CAPTION = (
    "Posterior of the parameters over the range of their priors. Diagonal: density of each one, with its 95 % "
    "interval. Below: regions with 50 % and 95 % of the posterior. Points: parameter sets of runs; crosses: clogged "
    "runs."
)
_CAPTION_OF_ONE = "Posterior density over the range of the prior, with the median and the 95 % interval."
_LIKELIHOOD = (
    "The likelihood has the errors of the measurements, the stated discrepancy of the model, and the covariance of the "
    "emulator across all measurements."
)
_PREDICTED = "Intervals of 95 %. Those of predictions have the errors of the measurements and the discrepancy."
_INDICES = (
    "Part of the variance over the priors that a parameter explains alone, and in brackets with all its interactions."
)
_GAIN = "Factor by which the volume of the posterior would fall (root of the determinant of its covariance)."
