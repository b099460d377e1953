"""How a run is watched: where it stands, at what rate, and who is told."""

import time
from collections import deque
from dataclasses import dataclass
from typing import Protocol

_WINDOW = 30.0  # s over which the rate is taken
_FIRST = 3.0  # s before a rate is given at all


@dataclass(frozen=True)
class View:
    """What a progress bar shows."""

    runs_done: int
    runs_asked: int
    fillings_left: int
    """Packings that runs still wait for."""
    going: tuple[str, ...]
    elsewhere: int
    """Jobs that another process holds."""
    work_done: float
    """Grain-steps of this session."""
    work_left: float
    rate: float
    """Grain-steps per second over the last half minute, all lanes together."""


class Watcher(Protocol):
    """Someone to tell how it goes."""

    def show(self, view: View) -> None:
        """Take note of where things stand."""
        ...


class Unwatched:
    """Nobody to tell."""

    def show(self, view: View) -> None:
        """Nothing."""


class Meter:
    """Grain-steps done, and their rate."""

    def __init__(self):
        self.work = 0.0
        self._history: deque[tuple[float, float]] = deque()

    def add(self, work: float) -> None:
        """Count `work` more grain-steps."""
        self.work += work

    def rate(self) -> float:
        """Grain-steps per second over the last half minute; 0 in the first seconds, which would mislead."""
        now = time.perf_counter()
        self._history.append((now, self.work))
        while len(self._history) > 2 and now - self._history[1][0] > _WINDOW:
            self._history.popleft()
        then, work = self._history[0]
        return (self.work - work) / (now - then) if now - then >= _FIRST else 0.0
