"""Progress of a run: its state, its rate, and the interface of those who show it."""

import time
from collections import deque
from dataclasses import dataclass
from typing import Literal, Protocol

_WINDOW = 30.0  # s over which the rate is taken
_MIN_TIME = 3.0  # s before a rate is given at all


Phase = Literal["placing", "compiling", "preparing", "settling", "discharging", "writing"]
"""Phase of a job.

`compiling`: kernels are being compiled. `preparing`: other work before the end of the first beat, such as loading
compiled kernels. `writing`: after the last beat, results are drawn, written and measured.
"""


@dataclass(frozen=True)
class ActiveJob:
    """State of an active job.

    Args:
        label: Name of the job.
        phase: Its phase.
        says: Its progress in parts, the most important first; the others can be dropped.
    """

    label: str
    phase: Phase
    says: tuple[str, ...]


@dataclass(frozen=True)
class View:
    """State of a run at one moment.

    Args:
        runs_done: Number of finished runs.
        runs_asked: Number of demanded runs.
        fillings_left: Number of packings that runs still need.
        going: Active jobs.
        elsewhere: Number of jobs that another process has claimed.
        work_done: Grain-steps of this session.
        work_left: Estimated grain-steps that are left.
        rate: Grain-steps per second over the last half minute, of all workers; 0 while unknown.
        open_ended: A job takes longer than expected, so that `work_left` is a lower bound.
    """

    runs_done: int
    runs_asked: int
    fillings_left: int
    going: tuple[ActiveJob, ...]
    elsewhere: int
    work_done: float
    work_left: float
    rate: float
    open_ended: bool = False

    @property
    def seconds_left(self) -> float | None:
        """Wall time for the work that is left, at the present rate [s]; None while the rate is unknown."""
        return self.work_left / self.rate if self.rate else None


class Watcher(Protocol):
    """Interface of an object that shows progress."""

    def show(self, view: View) -> None:
        """Show the state of the run; called often."""
        ...

    def tell(self, line: str) -> None:
        """Show a line that must not be missed. It may be called from another thread."""
        ...


class NullWatcher:
    """Watcher that shows nothing."""

    def show(self, view: View) -> None:
        """Do nothing."""

    def tell(self, line: str) -> None:
        """Do nothing."""


class Meter:
    """Counts grain-steps, their rate, the wall time of beats [s], and the time without any [s]."""

    def __init__(self):
        self.work = 0.0
        self.stepping = 0.0
        self.preparing = 0.0
        self._idle_since: float | None = None
        self._history: deque[tuple[float, float]] = deque()

    def add(self, work: float) -> None:
        """Count `work` more grain-steps."""
        self.work += work

    def look(self, idle: bool) -> None:
        """Record whether all jobs are idle: none takes steps, since all place grains or wait for kernels.

        The history is cleared then: a rate that includes time spent compiling would be misleading.
        """
        now = time.perf_counter()
        if self._idle_since is not None:
            self.preparing += now - self._idle_since
        self._idle_since = now if idle else None
        if idle:
            self._history.clear()

    def rate(self) -> float:
        """Grain-steps per second over the last half minute; 0 in the first seconds, where it would be misleading."""
        now = time.perf_counter()
        self._history.append((now, self.work))
        while len(self._history) > 2 and now - self._history[1][0] > _WINDOW:
            self._history.popleft()
        then, work = self._history[0]
        return (self.work - work) / (now - then) if now - then >= _MIN_TIME else 0.0
