"""An analysis as plain data, for scripts: SI units, and null for what is not known or has no end."""

import math
from collections.abc import Mapping
from typing import Any

from labbook.fit import Parameter
from labbook.fit.outlet import FORMULA, OF_OUTLET, VERSION, ProfileFit
from labbook.report.analysis import Analysis
from labbook.report.comparison import Comparison
from labbook.report.numerical import Numerical
from labbook.report.points import PointResult
from labbook.report.series import Series
from labbook.report.statements import Judged


def plain(analysis: Analysis) -> dict[str, Any]:
    """What `labbook fit --json` prints."""
    return {
        "study": analysis.study.name,
        "points": [_point(result) for result in analysis.points],
        "missing": [point.label for point in analysis.missing],
        "unreadable": list(analysis.unreadable),
        "series": [_series(one) for one in analysis.series],
        "reference": [_comparison(one) for one in analysis.comparisons],
        "statements": [_judged(one) for one in analysis.judged],
        "numerics": [_numerical(one) for one in analysis.numerical],
    }


def _point(result: PointResult) -> dict[str, Any]:
    units = {name: measured.unit for run in result.runs for name, measured in run.measured.items()}
    return {
        "at": dict(result.point.at),
        "label": result.point.label,
        "seeds": [run.seed for run in result.runs],
        "outcomes": dict(result.outcomes),
        "trending": result.trending,
        "precise": result.precise,
        "notes": dict(result.notes),
        "measured": {
            name: {
                "value": _finite(pooled.value),
                "error": _finite(pooled.error),
                "half_width": _finite(pooled.half_width),
                "confidence": pooled.confidence,
                "replicates": pooled.n,
                "unit": units[name],
            }
            for name, pooled in result.pooled.items()
        },
    }


def _series(series: Series) -> dict[str, Any]:
    return {
        "at": dict(series.at),
        "preferred": series.preferred,
        "contenders": list(series.contenders),
        "problems": list(series.problems),
        "fits": {
            law: {
                "version": fit.law.version,
                "formula": fit.law.formula,
                "parameters": _parameters(fit.parameters),
                "confidence": fit.confidence,
                "chi2": _finite(fit.chi2),
                "degrees_of_freedom": fit.dof,
                "p_value": _finite(fit.p_value),
                "aicc": _finite(fit.aicc),
                "notes": list(fit.notes),
            }
            for law, fit in series.fits.items()
        },
        "profiles": {name: _profiles(fit) for name, fit in series.profiles.items()},
    }


def _judged(one: Judged) -> dict[str, Any]:
    stated = one.statement
    ends = {"from": _finite(stated.low), "to": _finite(stated.high)}
    ours = {"ours": None if one.ours is None else _finite(one.ours), "error": _finite(one.error)}
    interval = {"low": _finite(one.low), "high": _finite(one.high), "pairs": one.pairs}
    return {"quantity": stated.quantity, "at": one.label, "says": stated.says, **ends, **ours, **interval,
            "verdict": one.verdict, "why": one.why}  # fmt: skip


def _numerical(one: Numerical) -> dict[str, Any]:
    told = {"key": one.key, "first": one.first.point.label, "other": one.other.point.label, "margin": one.margin}
    test = one.test
    if test is None:
        return {**told, "why": one.why}
    parts = {name: _finite(getattr(test, name)) for name in ("difference", "error", "low", "high")}
    if not one.finding:
        return {**told, **parts}
    return {**told, **parts, "p": test.p, "power": test.power, "finding": one.finding}


def _profiles(fit: ProfileFit) -> dict[str, Any]:
    outlets = []
    for one in fit.outlets:
        pooled = {name: getattr(one, name) for name in OF_OUTLET}
        profile = one.profile
        outlets.append(
            {
                "R": profile.R,
                "edges": profile.edges.tolist(),
                "area_fraction": profile.area_fraction.tolist(),
                "velocity": [_finite(v) for v in profile.velocity],
                "fitted": profile.inside.tolist(),
                **{name: {"value": p.value, "error": _finite(p.error)} for name, p in pooled.items()},
            }
        )
    parameters = _parameters(fit.parameters)
    return {"version": VERSION, "formula": FORMULA, "parameters": parameters, "outlets": outlets, "notes": fit.notes}


def _parameters(parameters: Mapping[str, Parameter]) -> dict[str, Any]:
    return {
        name: {
            "value": _finite(parameter.value),
            "error": _finite(parameter.error),
            "low": _finite(parameter.low),
            "high": _finite(parameter.high),
            "unit": parameter.unit,
        }
        for name, parameter in parameters.items()
    }


def _comparison(comparison: Comparison) -> dict[str, Any]:
    return {
        "quantity": comparison.quantity,
        "at": dict(comparison.at),
        "reference": comparison.reference,
        "reference_error": comparison.reference_error,
        "ours": comparison.ours,
        "error": _finite(comparison.error),
        "low": _finite(comparison.low),
        "high": _finite(comparison.high),
        "unit": comparison.unit,
        "in_errors": _finite(comparison.in_errors),
        "why": comparison.why,
    }


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
