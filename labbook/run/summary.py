"""The outcome of `labbook run`: which runs are done, failed, diverged or suspect, and what it cost."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from labbook.plan.demand import Demand, recorded_in_words
from labbook.plan.plan import PointPlan, counted
from labbook.run.board import Tally
from labbook.run.shard import everything
from labbook.scene.quantities import duration
from labbook.study import Study
from labbook.study.problems import grouped

_NOTABLE = 0.05  # part of the wall time that went into preparing, from which on it is told


@dataclass(frozen=True)
class Summary:
    """What came of one `labbook run`."""

    tally: Tally
    points: tuple[PointPlan, ...]
    """How every point stands at the end, with the decision on its replicates."""
    stopped: bool
    """Whether it was asked to stop before the study was complete."""
    wall_time: float
    work_done: float
    """Grain-steps."""
    problems: tuple[str, ...]
    """Folders of the lab that cannot be read."""
    left_behind: bool = False
    """Whether threads of this process still compile for jobs that were dropped: nothing waits for them but the end of
    the process, unless it is ended by `os._exit`."""
    holds: Callable[[Demand], bool] = everything
    """Whether a run belongs to the part that was asked for; it is these that are counted."""
    no_flow: str = ""
    """Why no point of the study has a flow rate, though the study measures it; empty if one has."""
    study: Study | None = None
    """The study as it was run, with the numerics that its pilot has chosen and the points that its strategy has
    proposed."""
    campaign: tuple[str, ...] = ()
    """What its strategy has proposed and why, line by line; empty for a study without one."""
    preparing: float = 0.0
    """Wall time [s] in which no job took steps, since all waited for kernels or for grains to be placed."""

    stepping: float = 0.0
    """Wall time [s] of all beats, those of several lanes added up."""

    @property
    def done(self) -> int:
        """Runs of the study that are there."""
        return counted(self.points, self.holds)[0]

    @property
    def asked(self) -> int:
        """Runs that the study asks for so far."""
        return counted(self.points, self.holds)[1]

    @property
    def failed(self) -> tuple[str, ...]:
        """Why runs failed, which are not there therefore."""
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
        """Why runs are suspect and left out of every mean, by the label of their point and their seed; of several
        discharges of a bed the first reason."""
        reasons: dict[str, dict[int, str]] = {}
        for label, runs in self._suspect.items():
            for run, why in runs:
                reasons.setdefault(label, {}).setdefault(run.seed, why)
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
        """Whether all runs are there, and none diverged or is suspect."""
        return self.done == self.asked and not self.diverged and not self.suspect

    def lines(self) -> list[str]:
        """What came of it, line by line."""
        tally, outcomes = self.tally, Counter(self.tally.ran.values())
        lines = [f"{self.done} of {self.asked} runs done"]
        if tally.ran or tally.packings:
            stepping = self.wall_time - self.preparing
            what = ", ".join(f"{count} {outcome}" for outcome, count in outcomes.items()) or "none ended"
            made = f"{tally.packings} packing{'' if tally.packings == 1 else 's'}"
            lines[0] += f"; now: {what}; {made}; {duration(self.wall_time)}"
            if stepping > 0:
                apart = f" without {duration(self.preparing)} of compiling and loading kernels"
                lines[0] += f", {self.work_done / stepping / 1e6:.2f} M grain-steps/s"
                lines[0] += apart if self.preparing > max(1.0, _NOTABLE * self.wall_time) else ""
        if self.points and (recorded := recorded_in_words(point.shared for point in self.points)):
            lines.append(recorded)
        if tally.resumed:
            lines.append(f"{tally.resumed} continued from a checkpoint")
        for point in self.points:
            if point.ended is not None and point.ended.reason:
                lines.append(f"{point.shared.point.label}: {point.ended.reason}")
        lines += self.campaign
        for label, diverged in self._diverged.items():
            lines.append(f"Diverged: {label}, {_numbered(diverged)}: stopped by a guard, and left out of every mean")
        for label, suspects in self._suspect.items():
            lines += [f"Suspect: {label}, {run.repeat}: {why}; left out of every mean" for run, why in suspects]
        lines += [f"Failed: {why}" for why in grouped(tally.failed)]
        lines += [f"Unreadable: {problem}" for problem in self.problems]
        return lines + ([f"No point of the study has a flow rate: {self.no_flow}"] if self.no_flow else [])

    def __repr__(self) -> str:
        stopped = ["Stopped early; everything is saved: run the study again to go on"] if self.stopped else []
        return "\n".join(self.lines() + stopped)


def _numbered(runs: Sequence[Demand]) -> str:
    """`seed 3`, `seeds 1, 2`, `seed 1, discharge 2; seed 4`."""
    if len(runs) == 1 or any(run.discharge > 1 for run in runs):
        return "; ".join(run.repeat for run in runs)
    return f"seeds {', '.join(str(run.seed) for run in runs)}"
