"""How a run is watched: where it stands, at what rate, and who is told."""

import time
from collections import deque
from dataclasses import dataclass
from typing import Literal, Protocol

_WINDOW = 30.0  # s over which the rate is taken
_FIRST = 3.0  # s before a rate is given at all


Phase = Literal["placing", "compiling", "preparing", "settling", "discharging", "writing"]
"""`compiling`: kernels are being compiled. `preparing`: everything else before the end of the first beat, such as
reading compiled kernels. `writing`: its last beat was taken, and its results are drawn, written and measured."""


@dataclass(frozen=True)
class Going:
    """A job that is going on."""

    label: str
    phase: Phase
    says: tuple[str, ...]
    """How far it is, in parts; the most telling one first, the others can be left out."""


@dataclass(frozen=True)
class View:
    """What a progress bar shows."""

    runs_done: int
    runs_asked: int
    fillings_left: int
    """Packings that runs still wait for."""
    going: tuple[Going, ...]
    elsewhere: int
    """Jobs that another process holds."""
    work_done: float
    """Grain-steps of this session."""
    work_left: float
    rate: float
    """Grain-steps per second over the last half minute, all lanes together; 0 while it is not known."""
    open_ended: bool = False
    """Whether some job goes on for longer than expected, so that `work_left` is a lower bound."""

    @property
    def seconds_left(self) -> float | None:
        """Wall time that the work left takes at this rate [s]; None while the rate is not known."""
        return self.work_left / self.rate if self.rate else None


class Watcher(Protocol):
    """Someone to tell how it goes."""

    def show(self, view: View) -> None:
        """Take note of where things stand."""
        ...

    def tell(self, line: str) -> None:
        """Pass on a line that must not be missed. Called from a thread of its own."""
        ...


class Unwatched:
    """Nobody to tell."""

    def show(self, view: View) -> None:
        """Nothing."""

    def tell(self, line: str) -> None:
        """Nothing."""


class Meter:
    """Grain-steps done, their rate, the wall time [s] of beats, and that which went by before any could be done."""

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
        """Take note of whether no job takes steps now, since all are placed or wait for kernels.

        What was done when is forgotten then: a rate over time that was spent compiling says nothing of the rest.
        """
        now = time.perf_counter()
        if self._idle_since is not None:
            self.preparing += now - self._idle_since
        self._idle_since = now if idle else None
        if idle:
            self._history.clear()

    def rate(self) -> float:
        """Grain-steps per second over the last half minute; 0 in the first seconds, which would mislead."""
        now = time.perf_counter()
        self._history.append((now, self.work))
        while len(self._history) > 2 and now - self._history[1][0] > _WINDOW:
            self._history.popleft()
        then, work = self._history[0]
        return (self.work - work) / (now - then) if now - then >= _FIRST else 0.0
