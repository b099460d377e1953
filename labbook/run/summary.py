"""Summary of `labbook run`: runs that are done, failed, diverged or suspect, and their cost."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from labbook.plan.demand import Demand, recorded_in_words
from labbook.plan.plan import PointPlan, done_and_demanded
from labbook.run.job_queue import Tally
from labbook.run.shard import everything
from labbook.scene.quantities import duration
from labbook.study import Study
from labbook.study.problems import grouped

_REPORTED_SHARE = 0.05  # part of the wall time that went into preparing, from which on it is told


@dataclass(frozen=True)
class Summary:
    """Result of one `labbook run`.

    Args:
        tally: Counts of this session.
        points: State of every point at the end, with the decision on its replicates.
        stopped: A stop was requested before the study was complete.
        wall_time: Wall time of the session [s].
        work_done: Grain-steps of the session.
        problems: Problems of folders that cannot be read.
        left_behind: Threads of this process still compile for jobs that were dropped. Python waits for them at its
            exit, unless the process ends by `os._exit`.
        holds: Decides whether a run belongs to the shard of the session; only those are counted.
        no_flow: Why no point has a flow rate, though the study measures it; empty if one has.
        study: Study as it was run, with the numerics of its pilot and the points of its strategy.
        campaign: Proposals of its strategy with their reasons, as lines; empty without a strategy.
        preparing: Wall time [s] without any step, while all jobs waited for kernels or placed grains.
        stepping: Wall time [s] of all beats, summed over workers.
    """

    tally: Tally
    points: tuple[PointPlan, ...]
    stopped: bool
    wall_time: float
    work_done: float
    problems: tuple[str, ...]
    left_behind: bool = False
    holds: Callable[[Demand], bool] = everything
    no_flow: str = ""
    study: Study | None = None
    campaign: tuple[str, ...] = ()
    preparing: float = 0.0

    stepping: float = 0.0

    @property
    def done(self) -> int:
        """Number of runs of the study that are done."""
        return done_and_demanded(self.points, self.holds)[0]

    @property
    def requested(self) -> int:
        """Number of runs that the study demands so far."""
        return done_and_demanded(self.points, self.holds)[1]

    @property
    def failed(self) -> tuple[str, ...]:
        """Reasons of failed runs, which have no result."""
        return tuple(self.tally.failed)

    @property
    def diverged(self) -> dict[str, list[int]]:
        """Seeds of the runs that diverged, now or earlier, by the label of their point."""
        return {label: list(dict.fromkeys(run.seed for run in runs)) for label, runs in self._diverged.items()}

    @property
    def _diverged(self) -> dict[str, list[Demand]]:
        runs: dict[str, list[Demand]] = {}
        for item in (item for point in self.points for item in point.items):
            if item.state == "done" and item.outcome == "diverged":
                runs.setdefault(item.demand.point.label, []).append(item.demand)
        return runs

    @property
    def suspect(self) -> dict[str, dict[int, str]]:
        """Reasons of suspect runs that are left out of means, by label of their point and seed.

        There are none with `accuracy.count_suspect`. For several discharges of a bed it is the first reason.
        """
        reasons: dict[str, dict[int, str]] = {}
        for label, runs in self._suspect.items():
            for run, reason in runs:
                reasons.setdefault(label, {}).setdefault(run.seed, reason)
        return reasons

    @property
    def _suspect(self) -> dict[str, list[tuple[Demand, str]]]:
        runs: dict[str, list[tuple[Demand, str]]] = {}
        for item in (item for point in self.points for item in point.items):
            if item.state == "done" and item.suspect and not item.counts:
                runs.setdefault(item.demand.point.label, []).append((item.demand, item.suspect))
        return runs

    @property
    def complete(self) -> bool:
        """True if all runs are done, and none diverged or is suspect."""
        return self.done == self.requested and not self.diverged and not self.suspect

    def lines(self) -> list[str]:
        """Format the summary as lines."""
        tally, outcomes = self.tally, Counter(self.tally.ran.values())
        lines = [f"{self.done} of {self.requested} runs done"]
        if tally.ran or tally.packings:
            stepping = self.wall_time - self.preparing
            outcomes_text = ", ".join(f"{count} {outcome}" for outcome, count in outcomes.items()) or "none ended"
            packings_text = f"{tally.packings} packing{'' if tally.packings == 1 else 's'}"
            lines[0] += f"; now: {outcomes_text}; {packings_text}; {duration(self.wall_time)}"
            if stepping > 0:
                exclusion = f" without {duration(self.preparing)} of compiling and loading kernels"
                lines[0] += f", {self.work_done / stepping / 1e6:.2f} M grain-steps/s"
                lines[0] += exclusion if self.preparing > max(1.0, _REPORTED_SHARE * self.wall_time) else ""
        if self.points and (recorded := recorded_in_words(point.shared for point in self.points)):
            lines.append(recorded)
        if tally.resumed:
            lines.append(f"{tally.resumed} continued from a checkpoint")
        for point in self.points:
            if point.ended is not None and point.ended.reason:
                lines.append(f"{point.shared.point.label}: {point.ended.reason}")
        lines += self.campaign
        for label, diverged in self._diverged.items():
            lines.append(f"Diverged: {label}, {_seed_list(diverged)}: stopped by a guard, and left out of every mean")
        for label, suspects in self._suspect.items():
            lines += [f"Suspect: {label}, {run.repeat}: {why}; left out of every mean" for run, why in suspects]
        lines += [f"Failed: {why}" for why in grouped(tally.failed)]
        lines += [f"Unreadable: {problem}" for problem in self.problems]
        return lines + ([f"No point of the study has a flow rate: {self.no_flow}"] if self.no_flow else [])

    def __repr__(self) -> str:
        stopped = ["Stopped early; everything is saved: run the study again to go on"] if self.stopped else []
        return "\n".join(self.lines() + stopped)


def _seed_list(runs: Sequence[Demand]) -> str:
    """Format runs of a point: `seed 3`, `seeds 1, 2`, `seed 1, discharge 2; seed 4`."""
    if len(runs) == 1 or any(run.discharge > 1 for run in runs):
        return "; ".join(run.repeat for run in runs)
    return f"seeds {', '.join(str(run.seed) for run in runs)}"
