"""Parts of a study's runs, for several processes, devices or machines."""

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from labbook.backend import Capabilities
from labbook.plan.demand import Demand, PointDemand, discharges
from labbook.plan.forecast import discharge_work, fill_work

MAX_PARTS = 100_000
_WORK_UNITS = 10_000
"""Work of the largest packing, as an integer: sums of integers are equal on every machine."""


@dataclass(frozen=True)
class Shard:
    """Part `number` of `of`, from 1."""

    number: int
    of: int

    @classmethod
    def parse(cls, text: str) -> "Shard":
        """Parse `i/n`. Raises ValueError."""
        match = re.fullmatch(r"\s*(\d{1,6})\s*/\s*(\d{1,6})\s*", text)
        number, of = map(int, match.groups()) if match else (0, 0)
        if not 1 <= number <= of <= MAX_PARTS:
            raise ValueError(f"{text!r} is not a part of a study; write I/N with I from 1 to N, such as 1/4")
        return cls(number, of)

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"


WHOLE = Shard(1, 1)
"""The shard that has all runs of a study."""


@dataclass(frozen=True)
class ProcessRank:
    """Rank of a process among several in one lab, from 1, and the speeds of all.

    Each begins with its own part of the work, and then takes runs that the others have not begun.
    """

    number: int
    speeds: tuple[float, ...]


def everything(demand: Demand) -> bool:
    """Return True: a part that has every run."""
    return True


class WorkPartition:
    """Fixed partition of a study's runs among several processes.

    All runs from one packing are in one part. Parts have equal forecast work (grain-steps of fillings and discharges),
    or work in proportion to `speeds`. It depends on the study alone, not on a lab or a machine. More replicates move no
    run to another part; more points may.

    Args:
        points: Points of the study.
        backend: Capabilities of the backend.
        speeds: Relative speed of each part.
        includes: Decides which runs are divided.
    """

    def __init__(
        self,
        points: Iterable[PointDemand],
        backend: Capabilities,
        speeds: Sequence[float],
        includes: Callable[[Demand], bool] = everything,
    ):
        self._includes, self._speeds = includes, tuple(speeds)
        beds: dict[str, dict[str, Demand]] = {}
        self._bed_by_point: dict[int, int] = {}
        """Number of the packing of a point's first seed, by index: points that share it share all packings."""
        numbers: dict[str, int] = {}
        for shared in points:
            first_run = shared.run(1)
            keys = first_run.keys(backend)
            beds.setdefault(keys.packing, {})[keys.run] = first_run
            self._bed_by_point[shared.point.index] = numbers.setdefault(keys.packing, len(numbers))
        self._first_demands = [next(iter(runs.values())).shared for runs in beds.values()]
        work = [
            fill_work(next(iter(runs.values())))
            + sum(discharges(run.shared.study)[0] * discharge_work(run.shared) for run in runs.values())
            for runs in beds.values()
        ]
        largest = max(work, default=0.0) or 1.0
        # whole numbers: sums of floats could differ in the last bit between machines, and with them the parts
        self._bed_work = [max(1, round(bed_work / largest * _WORK_UNITS)) for bed_work in work]
        # largest first (Graham's rule): the small ones then fill the gaps
        self._by_work = sorted(range(len(work)), key=lambda bed: -self._bed_work[bed])
        self._assigned_work = [0] * len(self._speeds)
        self._parts_by_seed: list[dict[int, int]] = []
        """Part of each packing, for each seed from 1."""

    def number(self, demand: Demand) -> int | None:
        """Return the part of a run, from 1; None if it is not divided, as runs of points that a strategy added
        later."""
        bed = self._bed_by_point.get(demand.point.index)
        if bed is None:
            return None
        # seed by seed in order, so that further replicates move no run of earlier seeds to another part
        while len(self._parts_by_seed) < demand.seed:
            self._parts_by_seed.append(self._assign(len(self._parts_by_seed) + 1))
        return self._parts_by_seed[demand.seed - 1].get(bed)

    def holds(self, number: int) -> Callable[[Demand], bool]:
        """Return a function that decides whether a run belongs to part `number`."""
        return lambda demand: self.number(demand) == number

    def _assign(self, seed: int) -> dict[int, int]:
        """Assign the packings of one seed, the largest first, each to the part that would finish it first."""
        ranks: dict[int, int] = {}
        for bed in self._by_work:
            if self._includes(self._first_demands[bed].run(seed)):
                work, loads = self._bed_work[bed], self._assigned_work
                target = min(range(len(loads)), key=lambda part: ((loads[part] + work) / self._speeds[part], part))
                loads[target] += work
                ranks[bed] = target + 1
        return ranks


def part_of(
    points: Iterable[PointDemand], backend: Capabilities, rank: ProcessRank, includes: Callable[[Demand], bool]
) -> Callable[[Demand], bool]:
    """Return a function that decides whether a run belongs to the first part of the process `rank`."""
    return WorkPartition(points, backend, rank.speeds, includes).holds(rank.number)


def shard_of(points: Iterable[PointDemand], backend: Capabilities, shard: Shard) -> Callable[[Demand], bool]:
    """Return a function that decides whether a run belongs to `shard`."""
    if shard == WHOLE:
        return everything
    return WorkPartition(points, backend, [1.0] * shard.of).holds(shard.number)
