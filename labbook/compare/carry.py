"""Making the runs that a comparison needs: ordinary runs of the lab, each made once."""

from dataclasses import dataclass, field

from labbook.compare.pair import Contestant, Pair
from labbook.lab.folder import Lab
from labbook.run.runner import CHECKPOINT_EVERY, Runner, Summary
from labbook.run.watch import Unwatched, Watcher
from labbook.study import Study


class Stopped(Exception):
    """The runner was asked to stop; everything is saved. `left_behind` as in its Summary."""

    def __init__(self, *, left_behind: bool = False):
        super().__init__()
        self.left_behind = left_behind


@dataclass
class Session:
    """What one backend did now: wall time from start to end [s], compiling and saving included."""

    grain_steps: float = 0.0
    wall_time: float = 0.0
    runs: int = 0
    packings: int = 0
    failed: list[str] = field(default_factory=list)

    def add(self, summary: Summary) -> None:
        """Count what a runner did; nothing if there was nothing to do."""
        self.failed += summary.tally.failed
        if summary.work_done:
            self.grain_steps += summary.work_done
            self.wall_time += summary.wall_time
            self.runs += len(summary.tally.ran)
            self.packings += summary.tally.packings


def carry_out(
    study: Study,
    lab: Lab,
    pair: Pair,
    watcher: Watcher | None = None,
    checkpoint_every: float = CHECKPOINT_EVERY,
) -> tuple[Session, Session]:
    """Run what is missing: the first backend's runs, the second's from the same packings, and its own packings.

    Raises Stopped, and all that Runner.run raises.
    """
    first, second = pair
    watched = watcher or Unwatched()

    def run(one: Contestant, session: Session, *, shared: bool = False, packings_only: bool = False) -> None:
        runner = Runner(
            one.of(study),
            lab,
            one.backend,
            one.device,
            checkpoint_every,
            watched,
            packings_of=first.packings(study) if shared else None,
            packings_only=packings_only,
        )
        summary = runner.run()
        session.add(summary)
        if summary.stopped:
            raise Stopped(left_behind=summary.left_behind)

    sessions = Session(), Session()
    run(first, sessions[0])
    run(second, sessions[1], shared=True)
    run(second, sessions[1], packings_only=True)
    return sessions
