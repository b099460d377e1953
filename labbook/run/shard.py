"""A part of a study's runs, for one of several processes, devices or machines."""

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from labbook.backend import Capabilities
from labbook.plan.demand import Demand, PointDemand, discharges
from labbook.plan.forecast import discharge_work, fill_work

MOST = 100_000
_UNITS = 10_000
"""Parts of the dearest packing in which work is counted: whole numbers are added up alike on every machine."""


@dataclass(frozen=True)
class Shard:
    """Part `number` of `of`, from 1 on."""

    number: int
    of: int

    @classmethod
    def parse(cls, text: str) -> "Shard":
        """From i/n. Raises ValueError."""
        found = re.fullmatch(r"\s*(\d{1,6})\s*/\s*(\d{1,6})\s*", text)
        number, of = map(int, found.groups()) if found else (0, 0)
        if not 1 <= number <= of <= MOST:
            raise ValueError(f"{text!r} is not a part of a study; write I/N with I from 1 to N, such as 1/4")
        return cls(number, of)

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"


WHOLE = Shard(1, 1)
"""All runs of a study."""


@dataclass(frozen=True)
class Seat:
    """Which of several processes in one lab this is, `number` from 1 on, and how fast each is. It begins with its own
    part of the work, and then takes up what the others have not begun."""

    number: int
    speeds: tuple[float, ...]


def everything(demand: Demand) -> bool:
    """Holds every run."""
    return True


class Division:
    """The runs of a study, divided among several who each know their part beforehand.

    All runs from one packing are in one part. Parts are even in the grain-steps that are foreseen for their fillings
    and discharges, or go as `speeds`. The study alone decides: neither what a lab has nor the machine. More replicates
    change nothing for those that there were; more points may. `within`: the runs that are divided.
    """

    def __init__(
        self,
        points: Iterable[PointDemand],
        backend: Capabilities,
        speeds: Sequence[float],
        within: Callable[[Demand], bool] = everything,
    ):
        self._within, self._speeds = within, tuple(speeds)
        beds: dict[str, dict[str, Demand]] = {}
        self._bed: dict[int, int] = {}
        """Number of the packing that the first seed of a point starts from: points that share it share all packings."""
        numbers: dict[str, int] = {}
        for shared in points:
            first = shared.run(1)
            keys = first.keys(backend)
            beds.setdefault(keys.packing, {})[keys.run] = first
            self._bed[shared.point.index] = numbers.setdefault(keys.packing, len(numbers))
        self._first = [next(iter(runs.values())).shared for runs in beds.values()]
        work = [
            fill_work(next(iter(runs.values())))
            + sum(discharges(run.shared.study)[0] * discharge_work(run.shared) for run in runs.values())
            for runs in beds.values()
        ]
        most = max(work, default=0.0) or 1.0
        self._work = [max(1, round(one / most * _UNITS)) for one in work]
        self._dearest = sorted(range(len(work)), key=lambda bed: -self._work[bed])
        self._loads = [0] * len(self._speeds)
        self._seeds: list[dict[int, int]] = []
        """By seed, from 1 on: the part of each packing."""

    def number(self, demand: Demand) -> int | None:
        """Whose a run is, from 1 on; None if it is not among those that are divided, as those of points that a strategy
        has proposed since."""
        bed = self._bed.get(demand.point.index)
        if bed is None:
            return None
        while len(self._seeds) < demand.seed:
            self._seeds.append(self._deal(len(self._seeds) + 1))
        return self._seeds[demand.seed - 1].get(bed)

    def holds(self, number: int) -> Callable[[Demand], bool]:
        """Whether a run belongs to the part with this number."""
        return lambda demand: self.number(demand) == number

    def _deal(self, seed: int) -> dict[int, int]:
        """The packings of one seed, the dearest first, each to where it ends soonest."""
        dealt: dict[int, int] = {}
        for bed in self._dearest:
            if self._within(self._first[bed].run(seed)):
                work, loads = self._work[bed], self._loads
                to = min(range(len(loads)), key=lambda part: ((loads[part] + work) / self._speeds[part], part))
                loads[to] += work
                dealt[bed] = to + 1
        return dealt


def part_of(
    points: Iterable[PointDemand], backend: Capabilities, seat: Seat, within: Callable[[Demand], bool]
) -> Callable[[Demand], bool]:
    """Whether a run belongs to what `seat` begins with."""
    return Division(points, backend, seat.speeds, within).holds(seat.number)


def shard_of(points: Iterable[PointDemand], backend: Capabilities, shard: Shard) -> Callable[[Demand], bool]:
    """Whether a run belongs to `shard`."""
    if shard == WHOLE:
        return everything
    return Division(points, backend, [1.0] * shard.of).holds(shard.number)
