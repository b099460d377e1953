"""Two backends that start from the same packing, stepped side by side and observed at the same steps."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from labbook.backend import Ensemble, Failed, Member
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Sample, Table
from labbook.compare.pair import Contestant, Pair
from labbook.scene import Packing, Scene


@dataclass(frozen=True)
class Frame:
    """The same moment in both backends: time since the opening [s] and rows of the sample, sorted by id."""

    time: float
    tables: tuple[Table, Table]


class Walker:
    """A backend with one member; it counts grain-steps and the time that stepping took, but for its first beat,
    in which backends may still compile."""

    def __init__(self, ensemble: Ensemble, member: Member, probe: Sample):
        self._ensemble, self._member, self._probe = ensemble, member, probe
        self._status = ensemble.status(member)
        self._warm = False
        self.grain_steps = self.wall_time = 0.0
        self.failure: str | None = None

    @property
    def rate(self) -> float | None:
        """Grain-steps per second; None before the second beat."""
        return self.grain_steps / self.wall_time if self.wall_time else None

    def walk(self) -> Table:
        """Go on to the next frame: the rows of its sample, none if a guard stopped the member."""
        begun = time.perf_counter()
        events = self._ensemble.advance(self._probe.every)
        wall, before = time.perf_counter() - begun, self._status
        self._status = self._ensemble.status(self._member)
        if self._warm:
            self.wall_time += wall
            self.grain_steps += (self._status.step - before.step) * (self._status.grains + before.grains) / 2
        self._warm = True
        self.failure = next((event.message for event in events if isinstance(event, Failed)), None)
        table = self._ensemble.drain()[self._probe]
        order = np.argsort(table["id"], kind="stable")
        return {name: np.asarray(column)[order] for name, column in table.items()}


class Lockstep:
    """Both backends of a pair, in the same scene from the same start."""

    def __init__(self, walkers: tuple[Walker, Walker], interval: float):
        self.walkers, self._interval = walkers, interval

    def frames(self, longest: float) -> Iterator[Frame]:
        """Frame after frame until `longest` [s], or until a guard stops one of the backends or one is empty."""
        for frame in range(1, int(longest / self._interval * (1 + 1e-9)) + 1):
            tables = self.walkers[0].walk(), self.walkers[1].walk()
            if self.failure or not all(len(table["id"]) for table in tables):
                return
            yield Frame(frame * self._interval, tables)

    @property
    def failure(self) -> str | None:
        """Why a guard stopped one of the backends."""
        return next((walker.failure for walker in self.walkers if walker.failure), None)


@contextmanager
def side_by_side(pair: Pair, scene: Scene, numerics: Numerics, start: Packing, probe: Sample) -> Iterator[Lockstep]:
    """Both backends, opened for as long as they are used. Raises Unsupported."""
    with (
        _opened(pair[0], scene, numerics, start, probe) as first,
        _opened(pair[1], scene, numerics, start, probe) as second,
    ):
        yield Lockstep((first, second), probe.every * numerics.beat)


@contextmanager
def _opened(one: Contestant, scene: Scene, numerics: Numerics, start: Packing, probe: Sample) -> Iterator[Walker]:
    numerics = one.numerics(numerics)
    ensemble = one.backend.open(one.backend.specialise(scene, numerics, (probe,)), 1, one.device)
    try:
        yield Walker(ensemble, ensemble.admit(scene, numerics, start), probe)
    finally:
        ensemble.close()
