"""Arches at the points of a study: their size against D/d, and the bed that the last one holds."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from labbook.measure.arch import FORCE, SIZE, Arch, StoppedBed
from labbook.measure.clogging import width_ratio
from labbook.results.points import PointResult, RunResult
from labbook.stats import Pooled
from labbook.warning import RenamedAttribute


@dataclass(frozen=True, eq=False)
class PointArches:
    """Arches at a point that has some.

    Attributes:
        result: The point.
        runs: Its runs with arches.
    """

    result: PointResult
    runs: tuple[RunResult, ...]
    width = RenamedAttribute("width_ratio")

    @property
    def width_ratio(self) -> float:
        """D/d, with the diameter of spheres of the grains' volume."""
        return width_ratio(self.result.point.scene)

    @property
    def size(self) -> Pooled:
        """Mean number of grains of an arch, over beds."""
        return self.result.pooled[SIZE]

    @property
    def force(self) -> Pooled:
        """Mean force along the arches in weights of a grain, over beds."""
        return self.result.pooled[FORCE]

    @cached_property
    def sizes(self) -> np.ndarray:
        """Grains of each arch of all runs, shape [n]."""
        return np.concatenate([run.evaluation(Arch()).arrays["size"] for run in self.runs])

    @property
    def last(self) -> StoppedBed:
        """The bed of the first of its runs at the last stop that has an arch."""
        bed = StoppedBed.of(self.runs[0].evaluation(Arch()).arrays)
        assert bed is not None
        return bed


def arches(results: Sequence[PointResult]) -> list[PointArches]:
    """Arches of the points that have some, by D/d."""
    points = []
    for result in results:
        runs = [run for run in result.runs if run.counted and Arch.name in run.measures]
        runs = tuple(run for run in runs if "size" in run.evaluation(Arch()).arrays)
        if runs and SIZE in result.pooled:
            points.append(PointArches(result, runs))
    return sorted(points, key=lambda point: point.width_ratio)
