"""Changes of a study since a moment: new runs, and means then and now."""

from dataclasses import dataclass
from datetime import UTC, datetime

from labbook.results import display
from labbook.results.points import PointResult, pooled_point, redundant
from labbook.results.study import StudyResults
from labbook_web.pages.sheet import leading, unit_of


class NoMoment(ValueError):
    """Error for text that is no date; the message has the form of one."""


@dataclass(frozen=True)
class PointChange:
    """A point with new runs.

    Attributes:
        point: Its number, from 1.
        label: Its settings.
        new_runs: Number of new runs.
        before: Mean without them, with its interval; a dash without one.
        now: Mean with them.
    """

    point: int
    label: str
    new_runs: int
    before: str
    now: str


@dataclass(frozen=True)
class Changes:
    """Points with new runs since a moment; `heading`: of their means."""

    since: str
    heading: str
    rows: tuple[PointChange, ...]

    @property
    def new_runs(self) -> int:
        """Number of new runs."""
        return sum(row.new_runs for row in self.rows)


def moment(text: str) -> str:
    """Convert a date, with or without a time, to the form of the index (UTC, also without a zone). Raises NoMoment."""
    try:
        time = datetime.fromisoformat(text)
    except ValueError:
        raise NoMoment(f"since={text[:40]} is not a date: use since=2026-11-20 or since=2026-11-20T08:30:00") from None
    time = time.astimezone(UTC) if time.tzinfo is not None else time
    return time.replace(tzinfo=None).isoformat()


def latest(results: StudyResults) -> str:
    """Time at which the last run ended (UTC, ISO 8601); empty without any."""
    times = [run.ended for result in results.points for run in result.runs if run.ended]
    return moment(max(times)) if times else ""


def changes(results: StudyResults, since: str) -> Changes:
    """Find runs that ended after a moment, and pool the means of their points without them.

    Args:
        results: Of a study.
        since: As `moment` gives it.
    """
    quantity = leading(results)
    unit, extra = unit_of(results, quantity), redundant(results.study.points)
    rows = []
    for result in results.points:
        earlier = tuple(run for run in result.runs if moment(run.ended) <= since)
        if len(earlier) < len(result.runs):
            before = pooled_point(results.study, result.point, extra, earlier)
            texts = (_mean(result, quantity, unit) for result in (before, result))
            rows.append(PointChange(result.point.index + 1, result.label, len(result.runs) - len(earlier), *texts))
    return Changes(since, unit.heading, tuple(rows))


def _mean(result: PointResult, quantity: str, unit: display.Notation) -> str:
    pooled = result.pooled.get(quantity)
    return "–" if pooled is None else display.with_interval(pooled, unit.scale)
