"""A case of `labbook stress`: an attempt to break a backend, the oracle that judges it, the outcome of each part."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

from labbook.backend import Unsupported
from labbook.checks.verify.case import SCENE_KEYS, Criterion, kind
from labbook.checks.verify.platform import CaseNotMeasured, Platform

Outcome = Literal["right", "named error", "failed", "unsupported"]


class Broken(Exception):
    """A backend did what it must never do: it gave a state that is not finite, lost the good one, or stayed silent."""


@dataclass(frozen=True)
class Ending:
    """Outcome of one part of a case.

    Args:
        part: Name of the part.
        outcome: `right`, `named error` (an error that the case expects), `failed` or `unsupported`.
        figure: The error against its limit, or the message of the error.
        error: Error; None if no number judges.
        limit: Largest error that passes; None if no number judges.
        unit: Unit of both; empty for a plain number.
    """

    part: str
    outcome: Outcome
    figure: str
    error: float | None = None
    limit: float | None = None
    unit: str = ""


@dataclass(frozen=True)
class StressCase:
    """One attempt to break a backend.

    Args:
        name: Name of the case.
        attempt: The attempt, in a line.
        oracle: Criterion that tells right from wrong, in a line.
        run: Runs the case on a platform and yields the outcome of each part.
        slow: The case takes more than about thirty seconds.
        seconds: Wall-clock time after which the case counts as hung.
    """

    name: str
    attempt: str
    oracle: str
    run: Callable[[Platform], Iterator[Ending]]
    slow: bool = False
    seconds: float = 600.0


@dataclass(frozen=True)
class Row:
    """Part of a case, as tables and JSON show it."""

    case: str
    what: str
    oracle: str
    part: str
    outcome: Outcome
    figure: str
    error: float | None
    limit: float | None
    unit: str


def judge(case: StressCase, platform: Platform) -> list[Row]:
    """Run a case and collect the rows of its parts.

    An exception becomes a row too. A case that yields no part has failed.
    """
    endings: list[Ending] = []
    try:
        for ending in case.run(platform):
            endings.append(ending)
        if not endings:
            endings.append(Ending("", "failed", "the case checked nothing"))
    except Unsupported as reason:
        outcome: Outcome = "unsupported" if reason.key in SCENE_KEYS else "failed"
        endings.append(Ending("", outcome, str(reason)))
    except (Broken, CaseNotMeasured) as reason:
        endings.append(Ending("", "failed", str(reason)))
    except Exception as error:  # whatever a backend raises that no case expects: it is what the suite looks for
        endings.append(Ending("", "failed", f"{type(error).__name__}: {error}"))
    return [row(case, ending) for ending in endings]


def row(case: StressCase, ending: Ending) -> Row:
    """Combine an ending with its case."""
    return Row(case=case.name, what=case.attempt, oracle=case.oracle, **vars(ending))


def within(platform: Platform, part: str, quantity: str, error: float, measure: Criterion) -> Ending:
    """Judge an error by its limit.

    Args:
        stand: The platform, whose precision selects the limit.
        part: Name of the part.
        quantity: Name of the error.
        error: The error; NaN fails.
        measure: Limits by precision.

    Returns:
        `right` if the error is at most the limit, else `failed`.
    """
    limit = measure.limits[kind(platform)]
    unit = f" {measure.unit}" if measure.unit else ""
    right = error <= limit
    figure = f"{quantity}: {error:.3g}{unit} {'<=' if right else '>'} {limit:.3g}{unit}"
    return Ending(part, "right" if right else "failed", figure, float(error), limit, measure.unit)
