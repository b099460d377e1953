"""Velocity profile over the outlet of each point, pooled over its beds."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from labbook.measure.composition import class_names
from labbook.measure.velocities import OutletVelocities, Velocities
from labbook.results.paper import Row
from labbook.results.points import PointResult
from labbook.stats.pooling import student

ALL = "all"
"""Name of all grains, beside those of the classes of a mixture."""


@dataclass(frozen=True, eq=False)
class PooledProfile:
    """Velocity over the outlet, means over beds.

    Attributes:
        result: The point.
        names: Of the classes of grains, the first of which is ALL, shape [s].
        edges: Of the bins [m], shape [b + 1].
        velocity: Mean downward velocity of the grains in the plane [m/s], shape [s, b].
        error: Its standard error between beds, shape [s, b]; NaN of one bed.
        flux: Mass per time and area [kg/m^2/s], shape [s, b].
        beds: Their number.
    """

    result: PointResult
    names: tuple[str, ...]
    edges: np.ndarray
    velocity: np.ndarray
    error: np.ndarray
    flux: np.ndarray
    beds: int

    @property
    def half_width(self) -> np.ndarray:
        """Half width of the 95 % interval of `velocity`, shape [s, b]."""
        return self.error * (student(0.95, self.beds - 1) if self.beds > 1 else math.nan)

    def rows(self) -> Iterator[Row]:
        """A row for each class of grains and bin."""
        for index, name in enumerate(self.names):
            for k in range(len(self.edges) - 1):
                columns = {"velocity": self.velocity, "error": self.error, "flux": self.flux}
                ends = {"from": float(self.edges[k]), "to": float(self.edges[k + 1])}
                numbers = {key: float(values[index, k]) for key, values in columns.items()}
                yield {"kind": name, **ends, **numbers, "beds": self.beds}


def outlet_profile(result: PointResult) -> PooledProfile | None:
    """Pool the profile of a point; None if it was not measured."""
    beds: dict[int, list[OutletVelocities]] = {}
    for run in result.runs:
        if run.counted and Velocities.name in run.measures:
            profile = OutletVelocities.of(run.evaluation(Velocities()))
            if profile is not None:
                beds.setdefault(run.seed, []).append(profile)
    if not beds:
        return None
    velocity, flux = (
        np.array([_mean([getattr(profile, name) for profile in bed]) for bed in beds.values()])
        for name in ("velocity", "flux")
    )
    first = next(iter(beds.values()))[0]
    count = np.isfinite(velocity).sum(axis=0)
    spread = np.sqrt(_mean([(bed - _mean(list(velocity))) ** 2 for bed in velocity]))
    error = np.where(count > 1, spread / np.sqrt(np.maximum(count - 1, 1)), math.nan)
    names = (ALL, *class_names(result.point.scene.grains))
    return PooledProfile(result, names, first.edges, _mean(list(velocity)), error, flux.mean(axis=0), len(beds))


def _mean(arrays: list[np.ndarray]) -> np.ndarray:
    """Mean of arrays, without their NaN; NaN where all are."""
    values = np.array(arrays)
    finite = np.isfinite(values)
    total, count = np.where(finite, values, 0.0).sum(axis=0), finite.sum(axis=0)
    return np.divide(total, count, out=np.full(total.shape, math.nan), where=count > 0)
