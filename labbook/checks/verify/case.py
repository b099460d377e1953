"""Verification case: a statement, its source, the errors that measure it, and their limits."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

from labbook.backend import Unsupported
from labbook.checks.verify.platform import CaseNotMeasured, Platform

Result = Literal["passed", "failed", "reported", "unsupported"]
SCENE_KEYS = ("grains.shape", "container")
"""Keys of a scene that a backend may lack without failing: a case with such shapes or walls is then `unsupported`."""


@dataclass(frozen=True)
class Criterion:
    """Limits of one error of a case.

    Args:
        limits: Largest error that passes, by precision; empty: the error is reported only.
        unit: Unit of the error; empty for a relative error or a plain number.
    """

    limits: Mapping[str, float]
    unit: str = ""


SINGLE_VELOCITIES = "mixed, velocities in single"
ROUNDING = 2.0**-24
"""Largest relative error of one operation in single precision."""


def limited(limit: float, unit: str = "", *, roundings: float = 0, steps: float = 0) -> Criterion:
    """Build a criterion from a limit in double precision and the roundings that single precision adds.

    Args:
        limit: Largest error in double precision, where round-off is far below it.
        unit: Unit of the error.
        roundings: Roundings of a law in single precision that may add up in the error; `mixed` is allowed these too. A
            contact force takes about 16 operations one after the other.
        steps: Roundings of a velocity that may add up where `mixed` keeps velocities in single precision as well. At
            most one a step: a small kick to a large velocity is rounded the same way again and again.
    """
    mixed = limit + roundings * ROUNDING
    return Criterion({"double": limit, "mixed": mixed, SINGLE_VELOCITIES: mixed + steps * ROUNDING}, unit)


@dataclass(frozen=True)
class Case:
    """One verification case.

    Args:
        name: Name of the case.
        statement: Property that holds for a correct backend, in a line.
        source: Origin of the expected values.
        measures: Criteria by name of the error.
        run: Runs the case on a platform and returns the error of each criterion, by name.
        slow: The case takes more than about ten seconds.
    """

    name: str
    statement: str
    source: str
    measures: Mapping[str, Criterion]
    run: Callable[[Platform], Mapping[str, float]]
    slow: bool = False


@dataclass(frozen=True)
class CriterionResult:
    """Error of one criterion with its verdict. `limit` None: reported only."""

    case: str
    measure: str
    error: float
    limit: float | None
    unit: str
    source: str
    result: Result
    note: str = ""
    """Reason for a missing number."""


def kind(platform: Platform) -> str:
    """Select the precision whose limits hold on a platform."""
    single = platform.precision == "mixed" and platform.backend.capabilities.single_velocities
    return SINGLE_VELOCITIES if single else platform.precision


def judge(case: Case, platform: Platform) -> list[CriterionResult]:
    """Run a case and compare its errors with their limits; NaN fails.

    Args:
        case: The case.
        stand: The platform.

    Returns:
        A result for each criterion: `unsupported` if the backend lacks a shape or wall of the scene.

    Raises:
        ValueError: The case has no limit for the platform's precision, or returns other errors than it declares.
        Unsupported: The backend lacks something else.
    """
    try:
        errors = case.run(platform)
    except Unsupported as reason:
        if reason.key not in SCENE_KEYS:
            raise
        verdicts = [_verdict(case, name, math.nan, kind(platform), reason.remedy) for name in case.measures]
        return [replace(verdict, result="unsupported") for verdict in verdicts]
    except CaseNotMeasured as reason:
        return failed(case, platform, str(reason))
    if set(errors) != set(case.measures):
        raise ValueError(f"case {case.name} measures {sorted(errors)}, not {sorted(case.measures)}")
    return [_verdict(case, name, float(errors[name]), kind(platform)) for name in case.measures]


def failed(case: Case, platform: Platform, why: str) -> list[CriterionResult]:
    """Fail every criterion of a case that measured nothing; `why`: the reason."""
    return [_verdict(case, name, math.nan, kind(platform), why) for name in case.measures]


def _verdict(case: Case, name: str, error: float, precision: str, note: str = "") -> CriterionResult:
    measure = case.measures[name]
    if measure.limits and precision not in measure.limits:
        raise ValueError(f"case {case.name} states no limit of {name} for precision {precision}")
    limit = measure.limits.get(precision)
    result: Result = "passed" if limit is not None and error <= limit else "failed"
    if limit is None and not note:
        result = "reported"
    return CriterionResult(case.name, name, error, limit, measure.unit, case.source, result, note)
