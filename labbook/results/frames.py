"""Results of a study as tidy data frames: SI units, a row for each number, NaN for unknown numbers."""

import json
import math
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from labbook.measure.flow import WINDOW_START
from labbook.measure.outlet import DEFINITIONS, ProfileAcross
from labbook.measure.series import discharged, mean_mass
from labbook.results import display
from labbook.results.against import against
from labbook.results.against import rows as against_rows
from labbook.results.budget import budgets
from labbook.results.clogging import clogging
from labbook.results.composition import composition_of
from labbook.results.composition import rows as composition_rows
from labbook.results.paper import Row, analyses
from labbook.results.paper import frames as frames_of_papers
from labbook.results.points import PointResult, RunResult
from labbook.results.recorded import acceleration
from labbook.results.residence import curve_rows, map_rows, residence_curve, residence_map
from labbook.results.series import Series
from labbook.results.starts import at_starts
from labbook.results.study import StudyResults
from labbook.results.velocities import outlet_profile
from labbook.results.walls import PooledWalls, pooled_walls

if TYPE_CHECKING:
    import pandas as pd

_WALLS = ("wall_stress", "wall_peaks", "vertical_stress")
_RESIDENCE = ("residence", "residence_times", "layers")
EVERY = ("runs", "flow", "bands", "accelerations", "profiles", "composition", "outlet_velocity", *_RESIDENCE, *_WALLS)
"""Frames with a row for every run, instant or place."""
_PLACES = 60
"""Orifices at which bands are given."""
_INTERVALS = (("low", "high"), ("point_low", "point_high"))
"""Columns with the two ends of an interval."""
_UNITS: dict[str, dict[str, str]] = {
    "flow": {"time": "s", "flow_rate": "kg/s"},
    "bands": {"orifice": "m"} | dict.fromkeys(("flow_rate", "low", "high", "point_low", "point_high"), "kg/s"),
    "inside": {"time": "s", "mass": "kg"},
    "residence": dict.fromkeys(("across_from", "across_to", "z_from", "z_to"), "m") | {"median": "s"},
    "residence_times": {"age": "s", "part": "", "error": "", "exit_age": "1/s"},
    "clogging": {"flow_while_flowing": "kg/s", "error": "kg/s", "t_min": "s"}
    | dict.fromkeys(("width_ratio", "probability", "low", "high", "alpha", "goodness"), ""),
    "wall_peaks": {"filter_time": "s"} | dict.fromkeys(("peak", "error", "peak_of_mean"), ""),
    "outlet_velocity": dict.fromkeys(("from", "to"), "m")
    | dict.fromkeys(("velocity", "error"), "m/s")
    | {"flux": "kg/(m^2 s)"},
    "vertical_stress": {"z": "m"} | dict.fromkeys(("walls", "walls_error", "field", "field_error"), "Pa"),
    "wall_stress": dict.fromkeys(("from", "to"), "m")
    | {
        f"{name}_{when}{error}": "Pa"
        for name in ("normal", "shear", "across")
        for when in ("rest", "flow")
        for error in ("", "_error")
    },
    "profiles": {"x_star": "", "x": "m", "velocity": "m/s", "velocity_error": "m/s"}
    | dict.fromkeys(("area_fraction", "area_fraction_error"), ""),
    "accelerations": dict.fromkeys(("bottom", "top"), "m")
    | dict.fromkeys(("acceleration", "error"), "m/s^2")
    | {"interval": "s"},
}
"""SI units of columns that mean the same in every row, by table."""


def frames(
    results: StudyResults, names: Collection[str] | None = None, without: Collection[str] = ()
) -> dict[str, "pd.DataFrame"]:
    """Data frames called `names` (None: all), but those called `without`, by name; those without rows are left out.

    Columns named by a key of the study say what was swept.

    | frame           | a row                                                                                     |
    |-----------------|-------------------------------------------------------------------------------------------|
    | `points`        | point and quantity: mean over beds, interval, n, effective n, unit, window, outcomes      |
    | `runs`          | run and quantity: value, error, effective n, window, method, note                         |
    | `flow`          | run and bin of time: W(t)                                                                 |
    | `against`       | point and swept key: W, and its ratio to that at the first value, paired where runs can be   |
    | `series`        | series of points that differ in their orifice: the laws that the data prefer              |
    | `fits`          | series, law and parameter: value, error, interval; goodness, version and formula          |
    | `starts`        | series, start of the window, law and parameter: value and error                           |
    | `bands`         | series, law and orifice: W, its 95 % band, and that of one more point of as many seeds     |
    | `problems`      | what is lacking: points without runs, runs that cannot be read or measured, laws not fitted |
    | `reference`     | number of the reference: theirs, ours, and how far they lie apart                         |
    | `statements`    | statement of the reference and where: ours, interval, verdict                             |
    | `numerics`      | pair of points that differ in numerics only: difference and test of equivalence           |
    | `budget`        | number and source: what it adds to the error, a part of it, and what that rests on         |
    | `accelerations` | point and bin of height above the outlet                                                  |
    | `profiles`      | point, definition and bin along the outlet: phi and v, mean and error over seeds          |
    | `composition`   | point, kind and bin of the outflow: share of the mass, errors of seeds and of counting    |
    | `residence`     | point and cell of the initial position: median time to leave, number of grains           |
    | `layers`        | point, initial layer and bin of the outflow, as in `composition`                          |
    | `residence_times` | point of a fed silo and age: part of the outflow that stayed shorter, exit-age density   |
    | `wall_stress`   | point, wall and bin: stresses at rest and later, with errors over beds, contacts          |
    | `wall_peaks`    | point and time of the moving mean: peak of the normal force after the opening             |
    | `outlet_velocity` | point, kind and bin over the outlet: downward velocity, error over beds, mass flux         |
    | `vertical_stress` | point and height: vertical stress in the bed by walls and by contacts, errors over beds  |
    | `clogging`      | point: stops, probability of a stop with its intervals, tail of the times between grains  |
    | `clogging_laws` | series, law of the mean avalanche and parameter: value, error, interval; goodness         |

    An interval whose both ends are unknown is NaN at both, as is an unknown error; one that is open at one end is
    infinite there. `attrs["units"]` has the SI units of columns that mean the same in every row.

    `replicates` counts beds; where a study states `discharges_per_bed`, rows of runs have `seed` and `discharge`.

    Papers add theirs (`labbook.papers`). What rests on several points names them (`points`, counted from 1); `stale`:
    runs of another version of the backend than the one installed, or of an older one of the law, are among them.
    """
    import pandas as pd

    tables: dict[str, Iterable[Row]] = {
        "points": _points(results),
        "runs": _runs(results),
        "flow": _flow(results),
        "against": _against(results),
        "series": _series(results),
        "fits": _fits(results),
        "starts": _starts(results),
        "bands": _bands(results),
        "problems": (),
        "reference": _reference(results),
        "statements": _statements(results),
        "numerics": _numerics(results),
        "budget": _budget(results),
        "accelerations": _accelerations(results),
        "profiles": _profiles(results),
        "composition": _composition(results),
        "residence": _residence(results),
        "layers": _layers(results),
        "residence_times": _residence_times(results),
        "outlet_velocity": _outlet_velocity(results),
        "wall_stress": _walls(results, PooledWalls.rows),
        "wall_peaks": _walls(results, PooledWalls.peak_rows),
        "vertical_stress": _walls(results, PooledWalls.vertical_rows),
        "clogging": _clogging(results),
        "clogging_laws": _clogging_laws(results),
    }
    of_papers, problems = frames_of_papers(results)
    tables |= of_papers
    tables["problems"] = (*_problems(results), *({"kind": "paper", "where": "", "why": why} for why in problems))
    requested = tables.keys() if names is None else names
    selected = {
        name: pd.DataFrame(list(rows)) for name, rows in tables.items() if name in requested and name not in without
    }
    return {name: _with_units(results, name, _with_known_ends(frame)) for name, frame in selected.items() if len(frame)}


def known_interval(low: float, high: float) -> tuple[float, float]:
    """The ends of an interval; NaN for both where neither is known, which is how tables have what is not known."""
    return (math.nan, math.nan) if math.isinf(low) and math.isinf(high) else (low, high)


def _with_known_ends(frame: "pd.DataFrame") -> "pd.DataFrame":
    """With NaN in place of intervals without any end, and of infinite errors."""
    for low, high in _INTERVALS:
        if low in frame and high in frame:
            ends = frame[[low, high]].astype(float)
            frame.loc[np.isinf(ends).all(axis=1), [low, high]] = math.nan
    if "error" in frame:
        frame.loc[np.isinf(frame["error"].astype(float)), "error"] = math.nan
    return frame


def _with_units(results: StudyResults, name: str, frame: "pd.DataFrame") -> "pd.DataFrame":
    """With the name of the study and the SI units of its columns in `attrs`."""
    columns = {**_UNITS, **{table: of for paper in analyses() for table, of in paper.columns.items()}}
    units = {**results.study.units, **columns.get(name, {})}
    frame.attrs = {"study": results.study.name, "units": {column: units[column] for column in frame if column in units}}
    return frame


def inside(results: StudyResults, every: float) -> "pd.DataFrame":
    """N(t): a row for each run and each time, from 0 to its end in steps of `every` [s].

    Columns say which point and run it is, and `time` [s], `grains` that are inside (have not crossed the outlet) and
    their `mass` [kg]. Runs without an outlet have no rows, nor have those of fed beds, which stay as full as they are.
    """
    import pandas as pd

    rows: list[Row] = []
    for result in results.points:
        for run in result.runs if _runs_empty(result) else ():
            data = run.run.data()
            times, mass = discharged(data)
            total, count = len(data.start) * mean_mass(data), len(data.start)
            head = {**of_run(results, result, run), "run_key": run.run_key}
            for k in range(math.floor(data.duration / every * (1 + 1e-12)) + 1):
                left = int(np.searchsorted(times, k * every, side="right"))
                outflow = float(mass[left - 1]) if left else 0.0
                rows.append({**head, "time": k * every, "grains": count - left, "mass": total - outflow})
    return _with_units(results, "inside", pd.DataFrame(rows))


def _runs_empty(result: PointResult) -> bool:
    scene = result.point.scene
    return scene.container.outlet_plane is not None and scene.feed is None


def to_json(results: StudyResults, names: Collection[str] | None = None) -> str:
    """The frames called `names` (all but EVERY, if none are given) as JSON: SI, null for what is unknown or endless."""
    selected = frames(results, names or None, () if names else EVERY)
    parts = {
        name: json.loads(frame.to_json(orient="records", double_precision=15) or "[]")
        for name, frame in selected.items()
    }
    campaign = {"campaign": list(results.campaign)} if results.campaign else {}
    return json.dumps({"study": results.study.name, **campaign, **parts}, indent=2, allow_nan=False)


def of_point(result: PointResult) -> Row:
    """The columns that say which point it is."""
    return {"point": result.point.index + 1, **result.point.at}


def of_run(results: StudyResults, result: PointResult, run: RunResult) -> Row:
    """The columns that say which run of a point it is; `discharge` only where beds have several."""
    several = results.study.discharges_per_bed != 1
    return {**of_point(result), "seed": run.seed, **({"discharge": run.discharge} if several else {})}


def _runs(results: StudyResults) -> Iterator[Row]:
    for result in results.points:
        for run in result.runs:
            head = {**of_run(results, result, run), "run_key": run.run_key, "outcome": run.outcome}
            head |= {"suspect": run.suspect}
            for measured in run.measured.values():
                yield {**head, **vars(measured), "stale": bool(results.stale_because(run))}


def _points(results: StudyResults) -> Iterator[Row]:
    for result in results.points:
        outcomes = {f"runs_{name.replace('-', '_')}": n for name, n in sorted(result.outcomes.items())}
        outcomes |= {"runs_suspect": len(result.suspect)} if result.suspect else {}
        for name, pooled in result.pooled.items():
            measured = [run.measured[name] for run in result.runs if run.counted and name in run.measured]
            yield {
                **of_point(result),
                "quantity": name,
                "value": pooled.value,
                "error": pooled.error,
                "low": pooled.low,
                "high": pooled.high,
                "confidence": pooled.confidence,
                "unit": measured[0].unit,
                "replicates": pooled.n,
                "n_effective": math.fsum(
                    number.n_effective for number in measured if math.isfinite(number.n_effective)
                ),
                "window_start": _window_start(results, result),
                "window_end": results.study.window.end,
                **({"window_unit": "s"} if results.study.window.timed else {}),
                **outcomes,
                "trending": result.trending,
                "precise": result.precise,
                "remark": result.remark,
                "stale": any(map(results.stale_because, result.runs)),
            }


def _window_start(results: StudyResults, result: PointResult) -> float:
    """Start of the window of a point; of windows that open at the end of the start-up the mean over its runs."""
    if not results.study.window.auto:
        return results.study.window.start
    start = result.pooled.get(WINDOW_START)
    return math.nan if start is None else start.value


def _against(results: StudyResults) -> Iterator[Row]:
    yield from against_rows(against(results.points))


def _problems(results: StudyResults) -> Iterator[Row]:
    for point in results.missing:
        yield {"kind": "point", "where": point.label, "why": "no finished run"}
    for why in results.unreadable:
        yield {"kind": "run", "where": "", "why": why}
    for why in results.unmeasured:
        yield {"kind": "measure", "where": "", "why": why}
    for series in results.series:
        for why in series.problems:
            yield {"kind": "fit", "where": series.label, "why": why}


def _series(results: StudyResults) -> Iterator[Row]:
    for series in results.series:
        contenders = ", ".join(series.contenders)
        preference = {"preferred": series.preferred, "contenders": contenders, "verdict": series.verdict}
        yield {**_of_series(series), **preference, **_resting(results, series.points)}


def _numerics(results: StudyResults) -> Iterator[Row]:
    for pair in results.numerical:
        row: Row = {"key": pair.key, "first": pair.first.point.label, "other": pair.second.point.label}
        row |= {"margin": pair.margin, "why": pair.why}
        if pair.test is not None:
            row |= {name: getattr(pair.test, name) for name in ("difference", "error", "low", "high")}
            row |= {"p": pair.test.p, "power": pair.test.power, "finding": pair.finding} if pair.finding else {}
            row |= {"paired": pair.paired}
        yield row | _resting(results, (pair.first, pair.second))


def _budget(results: StudyResults) -> Iterator[Row]:
    for budget in budgets(results):
        for share in budget.shares:
            where = of_point(budget.of) if isinstance(budget.of, PointResult) else _of_series(budget.of)
            numbers = {"source": share.source, "part": share.relative, "basis": share.basis}
            yield {**where, "quantity": budget.quantity, **numbers}


def _of_series(series: Series) -> Row:
    return {"series": series.label, **series.at}


def _fits(results: StudyResults) -> Iterator[Row]:
    for series in results.series:
        for law in (*series.fits, *series.further):
            for name, parameter in series.parameters(law).items():
                head = {**_of_series(series), "law": law, "parameter": name}
                about_zero = display.quantity(f"{law}.{name}", parameter.unit).about_zero
                head |= {**vars(parameter), "determined": parameter.determined(about_zero)}
                yield {**head, **_goodness(series, law), **_resting(results, _fitted(series, law))}


def _starts(results: StudyResults) -> Iterator[Row]:
    for series in results.series:
        for at, moved in ((at, at.of(series)) for at in at_starts(results)):
            start = {"start": "auto" if at.window.auto else f"{at.window.start:g}", "opens": at.opens}
            for law, fit in moved.fits.items() if moved is not None else ():
                for name, parameter in fit.parameters.items():
                    value = {"value": parameter.value, "error": parameter.error, "unit": parameter.unit}
                    yield {**_of_series(series), **start, "law": law, "parameter": name, **value}


def _fitted(series: Series, law: str) -> Sequence[PointResult]:
    """The points that a law was fitted to."""
    if law in series.further:
        return series.further[law].points
    return [result for result in series.points if result.identity in series.used]


def _bands(results: StudyResults) -> Iterator[Row]:
    for series in results.series:
        for law, fitted in series.fits.items():
            D = np.linspace(fitted.D.min(), fitted.D.max(), _PLACES)
            of_law, of_point = fitted.band(D), fitted.band(D, new_point=True)
            names = ("orifice", "flow_rate", "low", "high", "point_low", "point_high")
            for values in zip(D, *of_law, *of_point[1:], strict=True):
                yield {**_of_series(series), "law": law, **dict(zip(names, map(float, values), strict=True))}


def _resting(results: StudyResults, points: Sequence[PointResult]) -> Row:
    """The points that a number rests on, and whether runs of theirs are stale."""
    numbers = sorted({result.point.index + 1 for result in points})
    stale = any(results.stale_because(run) for result in points for run in result.runs)
    return {"points": ", ".join(map(str, numbers)), "stale": stale}


def _goodness(series: Series, law: str) -> Row:
    if law not in series.fits:
        further = series.further[law]
        return {"version": further.version, "formula": further.formula, "notes": "; ".join(further.notes)}
    fit = series.fits[law]
    goodness = {"chi2": fit.chi2, "degrees_of_freedom": fit.dof, "p_value": fit.p_value, "aicc": fit.aicc}
    notes = "; ".join(fit.notes)
    description = {"version": fit.law.version, "formula": fit.law.formula, "notes": notes}
    return {"confidence": fit.confidence, **goodness, **description}


def _flow(results: StudyResults) -> Iterator[Row]:
    for result in results.points:
        for run in result.runs:
            if run.trace is not None:
                for time, rate in zip(run.trace.time, run.trace.rate, strict=True):
                    yield {**of_run(results, result, run), "time": float(time), "flow_rate": float(rate)}


def _profiles(results: StudyResults) -> Iterator[Row]:
    for result in results.points:
        for definition in (name for name in DEFINITIONS if result.outlets(name)):
            head = {**of_point(result), "definition": definition}
            yield from ({**head, **row} for row in _along(result.outlets(definition)))


def _along(outlets: Sequence[ProfileAcross]) -> Iterator[Row]:
    """A row a bin: mean over beds, and its standard error."""
    first, n = outlets[0], len(outlets)
    middle = (first.edges[1:] + first.edges[:-1]) / 2
    columns: dict[str, np.ndarray] = {"x_star": middle, "x": middle * first.R, "fitted": first.inside}
    for name in ("area_fraction", "velocity"):
        seeds = np.array([getattr(outlet, name) for outlet in outlets])
        columns[name] = seeds.mean(axis=0)
        columns[f"{name}_error"] = seeds.std(axis=0, ddof=1) / n**0.5 if n > 1 else np.full(len(middle), np.nan)
    for values in zip(*columns.values(), strict=True):
        yield dict(zip(columns, (value.item() for value in values), strict=True))


def _reference(results: StudyResults) -> Iterator[Row]:
    for comparison in results.comparisons:
        theirs = {
            "reference": comparison.reference,
            "reference_error": comparison.reference_error,
            "says": comparison.says,
        }
        ours = {
            "ours": comparison.ours,
            "error": comparison.error,
            "low": comparison.low,
            "high": comparison.high,
            "unit": comparison.unit,
        }
        apart = {"difference_in_errors": comparison.in_errors, "why": comparison.why}
        yield {
            "quantity": comparison.quantity,
            **comparison.at,
            **theirs,
            **ours,
            **apart,
            **_resting(results, comparison.points),
        }


def _accelerations(results: StudyResults) -> Iterator[Row]:
    """Mean upward acceleration [m/s^2] of the grains that start within each bin of height [m] above an outlet."""
    for result in results.points:
        profile = acceleration(result)
        if profile is None:
            continue
        columns = (profile.edges[:-1], profile.edges[1:], profile.acceleration, profile.error, profile.count)
        for bottom, top, value, error, count in zip(*columns, strict=True):
            height = {"bottom": float(bottom), "top": float(top)}
            numbers = {"acceleration": float(value), "error": float(error), "pairs": int(count)}
            yield {
                "point": result.point.index + 1,
                **result.point.at,
                **height,
                **numbers,
                "interval": profile.interval,
            }


def _composition(results: StudyResults) -> Iterator[Row]:
    for result in results.points:
        pooled = composition_of(result)
        if pooled is not None:
            yield from ({**of_point(result), **row} for row in composition_rows(pooled))


def _residence(results: StudyResults) -> Iterator[Row]:
    for result in results.points:
        pooled = residence_map(result)
        if pooled is not None:
            yield from ({**of_point(result), **row} for row in map_rows(pooled))


def _layers(results: StudyResults) -> Iterator[Row]:
    for result in results.points:
        pooled = residence_map(result)
        if pooled is not None and pooled.layers is not None:
            yield from ({**of_point(result), **row} for row in composition_rows(pooled.layers))


def _residence_times(results: StudyResults) -> Iterator[Row]:
    for result in results.points:
        pooled = residence_curve(result)
        if pooled is not None:
            yield from ({**of_point(result), **row} for row in curve_rows(pooled))


def _outlet_velocity(results: StudyResults) -> Iterator[Row]:
    for result in results.points:
        pooled = outlet_profile(result)
        if pooled is not None:
            yield from ({**of_point(result), **row} for row in pooled.rows())


def _walls(results: StudyResults, rows: Callable[[PooledWalls], Iterator[Row]]) -> Iterator[Row]:
    for result in results.points:
        pooled = pooled_walls(result)
        if pooled is not None:
            yield from ({**of_point(result), **row} for row in rows(pooled))


def _clogging(results: StudyResults) -> Iterator[Row]:
    for series in clogging(results):
        yield from ({**of_point(point.result), **point.row} for point in series.points)


def _clogging_laws(results: StudyResults) -> Iterator[Row]:
    for series in clogging(results):
        yield from ({**_of_series(series.series), **row} for row in series.law_rows)


def _statements(results: StudyResults) -> Iterator[Row]:
    """Statements of the reference with ours and the verdict."""
    for judgement in results.judged:
        statement = judgement.statement
        where = {"quantity": statement.quantity, "at": judgement.label, "says": statement.says}
        ours = {"from": statement.low, "to": statement.high, "ours": judgement.ours, "error": judgement.error}
        interval = {"low": judgement.low, "high": judgement.high, "pairs": judgement.pairs}
        yield {
            **where,
            **ours,
            **interval,
            "verdict": judgement.verdict,
            "why": judgement.why,
            **_resting(results, judgement.points),
        }
