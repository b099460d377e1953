"""A case of `labbook stress`: what is done to a backend, which oracle judges it, and how each of its parts ended."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

from labbook.backend import Unsupported
from labbook.checks.verify.case import SCENE_KEYS, Criterion, kind
from labbook.checks.verify.stand import CaseNotMeasured, Stand

Outcome = Literal["right", "named error", "failed", "unsupported"]


class Broken(Exception):
    """A backend did what it must never do: a state that is not finite, a guard that keeps no good state, silence."""


@dataclass(frozen=True)
class Ending:
    """How one part of a case ended.

    `figure`: the error against its limit, or the message of the error. `error`, `limit`: None where no number judges.
    """

    part: str
    outcome: Outcome
    figure: str
    error: float | None = None
    limit: float | None = None
    unit: str = ""


@dataclass(frozen=True)
class StressCase:
    """One attempt to break a backend. `run` yields how each part of it ended.

    `what`: what is done, in a line. `oracle`: what tells right from wrong. `seconds`: wall-clock time after which the
    case counts as hung.
    """

    name: str
    what: str
    oracle: str
    run: Callable[[Stand], Iterator[Ending]]
    slow: bool = False
    """Takes more than about thirty seconds."""
    seconds: float = 600.0


@dataclass(frozen=True)
class Row:
    """One part of a case as it is shown."""

    case: str
    what: str
    oracle: str
    part: str
    outcome: Outcome
    figure: str
    error: float | None
    limit: float | None
    unit: str


def judge(case: StressCase, stand: Stand) -> list[Row]:
    """Run a case: its parts, and what stopped it, if anything did. A case without a single part has failed."""
    endings: list[Ending] = []
    try:
        for ending in case.run(stand):
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
    """An ending with its case."""
    return Row(case=case.name, what=case.what, oracle=case.oracle, **vars(ending))


def within(stand: Stand, part: str, what: str, error: float, measure: Criterion) -> Ending:
    """Right if the error is at most the limit of the stand's precision; failed beyond it, or if it is NaN."""
    limit = measure.limits[kind(stand)]
    unit = f" {measure.unit}" if measure.unit else ""
    right = error <= limit
    figure = f"{what}: {error:.3g}{unit} {'<=' if right else '>'} {limit:.3g}{unit}"
    return Ending(part, "right" if right else "failed", figure, float(error), limit, measure.unit)
