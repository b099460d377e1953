"""A case: what is checked, where it comes from, how it is measured, and how large an error may be."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

from labbook.backend import Unsupported
from labbook.checks.verify.stand import CaseNotMeasured, Stand

Result = Literal["passed", "failed", "reported", "unsupported"]
SCENE_KEYS = ("grains.shape", "container")
"""What a backend may lack without failing: cases with shapes or walls that it does not have say nothing of it."""


@dataclass(frozen=True)
class Criterion:
    """One error of a case.

    `limits`: the largest error that passes, by precision; empty: the number is reported, and judged by no one.
    `unit`: of the error; "" for a relative one or a plain number.
    """

    limits: Mapping[str, float]
    unit: str = ""


SINGLE_VELOCITIES = "mixed, velocities in single"
ROUNDING = 2.0**-24
"""Largest relative error of one operation in single precision."""


def limited(limit: float, unit: str = "", *, roundings: float = 0, steps: float = 0) -> Criterion:
    """A measure with a limit: `limit` in double precision, where round-off is far below it.

    `roundings`: how many roundings of a law in single precision may add up in the error; `mixed` is allowed these too.
    A force of contact takes about 16 operations one after the other. `steps`: how many roundings of a velocity may add
    up, where `mixed` keeps velocities in single as well: at most one a step, since a small kick to a large velocity is
    rounded the same way again and again.
    """
    mixed = limit + roundings * ROUNDING
    return Criterion({"double": limit, "mixed": mixed, SINGLE_VELOCITIES: mixed + steps * ROUNDING}, unit)


@dataclass(frozen=True)
class Case:
    """One check. `run` measures every error of `measures` by name on a stand.

    `statement`: what holds, in a line. `source`: where that comes from.
    """

    name: str
    statement: str
    source: str
    measures: Mapping[str, Criterion]
    run: Callable[[Stand], Mapping[str, float]]
    slow: bool = False
    """Takes more than about ten seconds."""


@dataclass(frozen=True)
class CriterionResult:
    """What one measure of a case came to. `limit` None: reported only."""

    case: str
    measure: str
    error: float
    limit: float | None
    unit: str
    source: str
    result: Result
    note: str = ""
    """Why there is no number, where there is none."""


def kind(stand: Stand) -> str:
    """The precision whose limits hold on a stand."""
    single = stand.precision == "mixed" and stand.backend.capabilities.single_velocities
    return SINGLE_VELOCITIES if single else stand.precision


def judge(case: Case, stand: Stand) -> list[CriterionResult]:
    """Run a case and compare its errors with their limits; an error that is no number fails.

    A case in a scene that the backend does not have is `unsupported`.

    Raises ValueError if the case states no limit for the stand's precision, or does not measure what it says.
    """
    try:
        errors = case.run(stand)
    except Unsupported as reason:
        if reason.key not in SCENE_KEYS:
            raise
        found = [_verdict(case, name, math.nan, kind(stand), reason.remedy) for name in case.measures]
        return [replace(verdict, result="unsupported") for verdict in found]
    except CaseNotMeasured as reason:
        return failed(case, stand, str(reason))
    if set(errors) != set(case.measures):
        raise ValueError(f"case {case.name} measures {sorted(errors)}, not {sorted(case.measures)}")
    return [_verdict(case, name, float(errors[name]), kind(stand)) for name in case.measures]


def failed(case: Case, stand: Stand, why: str) -> list[CriterionResult]:
    """CriterionResults of a case that measured nothing; `why`: the reason."""
    return [_verdict(case, name, math.nan, kind(stand), why) for name in case.measures]


def _verdict(case: Case, name: str, error: float, precision: str, note: str = "") -> CriterionResult:
    measure = case.measures[name]
    if measure.limits and precision not in measure.limits:
        raise ValueError(f"case {case.name} states no limit of {name} for precision {precision}")
    limit = measure.limits.get(precision)
    result: Result = "passed" if limit is not None and error <= limit else "failed"
    if limit is None and not note:
        result = "reported"
    return CriterionResult(case.name, name, error, limit, measure.unit, case.source, result, note)
