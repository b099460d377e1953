"""Every number of an analysis as data frames: SI units, a row a number, NaN for what is not known."""

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from labbook.export import turning
from labbook.fit.outlet import DEFINITIONS, OF_OUTLET, Outlet
from labbook.report.analysis import Analysis
from labbook.report.points import PointResult
from labbook.report.ratios import RATIOS, angle_laws
from labbook.report.series import Series

if TYPE_CHECKING:
    import pandas as pd


Row = dict[str, Any]


def frames(analysis: Analysis) -> dict[str, "pd.DataFrame"]:
    """Data frames by name; those without rows are left out.

    `runs`: what was measured of each run, with error, effective sample size, window, method and note. `points`: pooled
    over seeds, with 95 % intervals. `ratios`: flow rates over a plain hopper's, with the laws of the angle. `fits`:
    parameters of laws and of profiles. `flow`: W(t) of each run. `profiles`: phi and v along each outlet, mean and
    standard error over seeds, by definition. `outlets`: what was fitted to each outlet. `reference`: a paper's numbers
    beside ours. `rotation`: ratios to a bottom at rest. `accelerations`: above outlets. `statements`: of a paper, with
    their verdicts. Columns that begin with a key of the study say what was swept.
    """
    import pandas as pd

    made = {
        "runs": _runs(analysis),
        "points": _points(analysis),
        "ratios": _ratios(analysis),
        "fits": _fits(analysis),
        "flow": _flow(analysis),
        "profiles": _profiles(analysis),
        "outlets": _outlets(analysis),
        "reference": _reference(analysis),
        "rotation": turning.ratios(analysis),
        "accelerations": turning.accelerations(analysis),
        "statements": turning.statements(analysis),
    }
    found = {name: pd.DataFrame(list(rows)) for name, rows in made.items()}
    return {name: frame for name, frame in found.items() if len(frame)}


def _of_point(result: PointResult) -> Row:
    return {"point": result.point.index + 1, **result.point.at}


def _runs(analysis: Analysis) -> Iterator[Row]:
    for result in analysis.points:
        for run in result.runs:
            head = {**_of_point(result), "seed": run.seed, "run_key": run.run_key, "outcome": run.outcome}
            yield from ({**head, **vars(measured)} for measured in run.measured.values())


def _points(analysis: Analysis) -> Iterator[Row]:
    for result in analysis.points:
        units = {name: measured.unit for run in result.runs for name, measured in run.measured.items()}
        for name, pooled in result.pooled.items():
            numbers = {"value": pooled.value, "error": pooled.error, "low": pooled.low, "high": pooled.high}
            head = {**_of_point(result), "quantity": name, **numbers, "unit": units[name]}
            yield {**head, "replicates": pooled.n, "confidence": pooled.confidence, "remark": result.remark}


def _ratios(analysis: Analysis) -> Iterator[Row]:

    for name, found in RATIOS.items():
        for one in found(analysis.points):
            numbers = {"value": one.value, "error": one.error, "low": one.low, "high": one.high}
            row = {**_of_point(one.result), "quantity": name, **numbers}
            if name.endswith("angle"):
                yield row | {_column(law.name): law.factor(one.at) for law in angle_laws(one.result)}
            else:
                yield row | {"s_star": one.at}


def _column(law: str) -> str:
    """`rose_tanaka` of a law's name."""
    return law.partition(",")[0].lower().replace(" & ", "_")


def _of_series(series: Series) -> Row:
    return {"series": series.label, **series.at}


def _fits(analysis: Analysis) -> Iterator[Row]:
    for series in analysis.series:
        for law in (*series.fits, *series.profiles):
            for name, parameter in series.parameters(law).items():
                yield {**_of_series(series), "law": law, "parameter": name, **vars(parameter), **_goodness(series, law)}


def _goodness(series: Series, law: str) -> Mapping[str, float]:
    if law not in series.fits:
        return {}
    fit = series.fits[law]
    return {"chi2": fit.chi2, "degrees_of_freedom": fit.dof, "p_value": fit.p_value, "aicc": fit.aicc}


def _flow(analysis: Analysis) -> Iterator[Row]:
    for result in analysis.points:
        for run in result.runs:
            if run.trace is not None:
                for time, rate in zip(run.trace.time, run.trace.rate, strict=True):
                    yield {**_of_point(result), "seed": run.seed, "time": float(time), "flow_rate": float(rate)}


def _profiles(analysis: Analysis) -> Iterator[Row]:
    for result in analysis.points:
        for definition in (name for name in DEFINITIONS if result.outlets(name)):
            head = {**_of_point(result), "definition": definition}
            yield from ({**head, **row} for row in _along(result.outlets(definition)))


def _along(outlets: Sequence[Outlet]) -> Iterator[Row]:
    """A row a bin: mean over seeds, and its standard error."""
    first, n = outlets[0], len(outlets)
    middle = (first.edges[1:] + first.edges[:-1]) / 2
    columns: dict[str, np.ndarray] = {"x_star": middle, "x": middle * first.R, "fitted": first.inside}
    for name in ("area_fraction", "velocity"):
        seeds = np.array([getattr(one, name) for one in outlets])
        columns[name] = seeds.mean(axis=0)
        columns[f"{name}_error"] = seeds.std(axis=0, ddof=1) / n**0.5 if n > 1 else np.full(len(middle), np.nan)
    for values in zip(*columns.values(), strict=True):
        yield dict(zip(columns, (value.item() for value in values), strict=True))


def _outlets(analysis: Analysis) -> Iterator[Row]:
    for series in analysis.series:
        for definition, fit in series.profiles.items():
            for result, one in zip(series.profiled, fit.outlets, strict=True):
                numbers = {name: getattr(one, name) for name in OF_OUTLET}
                means = {name: pooled.value for name, pooled in numbers.items()}
                errors = {f"{name}_error": pooled.error for name, pooled in numbers.items()}
                yield {**_of_point(result), "definition": definition, "R": one.profile.R, **means, **errors}


def _reference(analysis: Analysis) -> Iterator[Row]:
    for one in analysis.comparisons:
        theirs = {"reference": one.reference, "reference_error": one.reference_error}
        ours = {"ours": one.ours, "error": one.error, "low": one.low, "high": one.high, "unit": one.unit}
        apart = {"difference_in_errors": one.in_errors, "why": one.why}
        yield {"quantity": one.quantity, **one.at, **theirs, **ours, **apart}
