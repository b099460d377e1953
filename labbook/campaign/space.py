"""Space of several keys: coordinates from 0 to 1 for each key, designs of runs, and values of runs."""

import math
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labbook.campaign.goal import rounded
from labbook.campaign.strategy import Assignment, Trial, point_key
from labbook.fit.interpolation import trend_of_outlets
from labbook.stats.emulator import Emulator
from labbook.stats.nested import by_bed, of_beds

FEWEST_REPEATS = 8
"""Fewest degrees of freedom of the scatter of runs for an emulator: with fewer its noise would be unknown."""


@dataclass(frozen=True)
class Axis:
    """A key with its range, and coordinates from 0 to 1 over it.

    Args:
        key: The key.
        low: Smallest value [SI].
        high: Largest value [SI].
        logarithmic: Coordinates are linear in the logarithm of the value.
    """

    key: str
    low: float
    high: float
    logarithmic: bool = False

    def unit(self, value: float | np.ndarray) -> np.ndarray:
        """Convert values [SI] to coordinates from 0 to 1."""
        low, high, x = self._ends(np.asarray(value, float))
        return (x - low) / (high - low)

    def value(self, unit: float | np.ndarray) -> np.ndarray:
        """Convert coordinates from 0 to 1 to values [SI]."""
        low, high, _ = self._ends(np.array(1.0))
        x = low + (high - low) * np.asarray(unit, float)
        return np.exp(x) if self.logarithmic else x

    def setting(self, unit: float) -> float:
        """Convert a coordinate from 0 to 1 to a value of four digits within the range."""
        return min(max(rounded(float(self.value(unit))), self.low), self.high)

    def _ends(self, x: np.ndarray) -> tuple[float, float, np.ndarray]:
        if self.logarithmic:
            return math.log(self.low), math.log(self.high), np.log(x)
        return self.low, self.high, x


def sobol(number: int, dimensions: int, skip: int = 0, stream: int = 0) -> np.ndarray:
    """Compute points of a Sobol sequence in the unit cube, shape [number, dimensions].

    Args:
        number: Number of points.
        dimensions: Dimensions of the cube.
        skip: Number of points of the sequence before them.
        stream: Number of a shift of the whole sequence (modulo 1); other streams have other points.
    """
    from scipy.stats import qmc

    # a shift of the whole sequence (Cranley & Patterson 1976) keeps it nested, so that `skip` continues it, and moves
    # its first point away from the corner 0
    engine = qmc.Sobol(dimensions, scramble=False)
    points = engine.random_base2(max(1, math.ceil(math.log2(skip + number))))[skip : skip + number]
    return (points + np.random.default_rng([stream, dimensions]).uniform(size=dimensions)) % 1


def one_bed_more(points: Sequence[Mapping[str, float]], trials: Sequence[Trial]) -> tuple[Assignment, ...]:
    """Assign a further bed to each point, and several to one that is listed several times."""
    beds: dict[tuple, int] = {}
    for trial in trials:
        beds[point_key(trial.at)] = max(beds.get(point_key(trial.at), 0), trial.seed)
    assigned: dict[tuple, Assignment] = {}
    for at in points:
        beds[point_key(at)] = beds.get(point_key(at), 0) + 1
        assigned[point_key(at)] = Assignment(at, beds[point_key(at)])
    return tuple(assigned.values())


@dataclass(frozen=True, eq=False)
class BedValues:
    """Logarithms of a quantity of n beds, each at one point.

    Attributes:
        settings: Coordinates of the points, shape [n, d].
        values: Logarithms less the trend, shape [n].
        beds: Seeds, shape [n].
        noise: Variance of the noise of each, shape [n].
        variance: Variance of the noise of a bed at a point, the mean over all.
        of_beds: Variance of the contribution that beds of one seed share at all points, since points may share
            packings.
        repeats: Degrees of freedom of `variance`.
        noises: Variance of the noise by the values of the keys `noise_by` of `of`.
        noise_by: These keys.
    """

    settings: np.ndarray
    values: np.ndarray
    beds: np.ndarray
    noise: np.ndarray
    variance: float
    of_beds: float
    repeats: int
    noises: Mapping[tuple, float]
    noise_by: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        trials: Sequence[Trial],
        quantity: str,
        axes: Sequence[Axis],
        trend: "SpaceTrend",
        noise_by: Sequence[str] = (),
    ) -> "BedValues":
        """Collect a quantity from runs; clogged and diverged runs have none.

        Args:
            trials: Runs.
            quantity: Name of a quantity, above 0 in all runs that are used.
            axes: Axes of the space.
            trend: Known part of the quantity's logarithm.
            noise_by: Keys with few values, each combination of which has a noise of its own.
        """
        points: dict[tuple, list[tuple[int, float]]] = defaultdict(list)
        where: dict[tuple, Mapping[str, float | str]] = {}
        for trial in sorted(trials, key=lambda trial: (point_key(trial.at), trial.seed, trial.discharge)):
            value = trial.numbers.get(quantity, math.nan)
            if trial.outcome != "clogged" and value > 0:
                points[point_key(trial.at)].append((trial.seed, math.log(value) - trend.at(trial.at)))
                where[point_key(trial.at)] = trial.at
        rows = list[tuple[int, int, float]]()
        for index, of in enumerate(points.values()):
            beds = by_bed(of)
            rows += [(index, seed, value) for seed, value in zip(beds, of_beds(beds), strict=True)]
        index, seeds, values = (np.array(column) for column in zip(*rows, strict=True)) if rows else ([], [], [])
        settings = [[float(axis.unit(float(at[axis.key]))) for axis in axes] for at in where.values()]
        settings = np.array(settings).reshape(len(where), len(axes))[np.asarray(index, int)]
        names = [point_key({key: at[key] for key in noise_by}) for at in where.values()]
        groups = {name: number for number, name in enumerate(dict.fromkeys(names))}
        group_of = np.array([groups[name] for name in names], int)[np.asarray(index, int)]
        variance, of_beds_, repeats, by_group = _variances(index, seeds, values, group_of)
        noises, noise = dict(zip(groups, by_group.tolist(), strict=True)), by_group[group_of]
        return cls(settings, np.asarray(values), np.asarray(seeds), noise, variance, of_beds_, repeats, noises,
                   tuple(noise_by))  # fmt: skip

    def noise_at(self, at: Mapping[str, float | str]) -> float:
        """Return the variance of the noise of a bed at values of keys; the mean of all where no run tells it."""
        return self.noises.get(point_key({key: at[key] for key in self.noise_by}), self.variance)

    @property
    def of_bed_means(self) -> float:
        """Variance of the mean of all runs that comes from beds."""
        return self.of_beds / max(1, len(np.unique(self.beds)))

    @property
    def points(self) -> int:
        """Number of different points."""
        return len(np.unique(self.settings, axis=0))

    def emulator(self) -> Emulator:
        """Fit an emulator. Raises LearnMissing."""
        return Emulator.of(self.settings, self.values, self.noise, self.beds, self.of_beds)


def _variances(
    points: Sequence[int] | np.ndarray,
    seeds: Sequence[int] | np.ndarray,
    values: Sequence[float] | np.ndarray,
    groups: np.ndarray,
) -> tuple[float, float, int, np.ndarray]:
    """Analyse the variance of beds at points, with effects of points and of beds (Henderson, Biometrics 9 (1953) 226,
    method 3).

    Args:
        points: Number of the point of each run, shape [n].
        seeds: Seed of its bed, shape [n].
        values: Value, shape [n].
        groups: Number of its group from 0 on, shape [n]; each has a noise of its own.

    Returns:
        Variance of the noise, of the contribution that beds of one seed share, degrees of freedom of the first, and the
        variance of the noise of each group, drawn to that of all where a group has few degrees of freedom.
    """
    points, seeds, values = np.asarray(points), np.asarray(seeds), np.asarray(values)
    number = int(groups.max()) + 1 if len(groups) else 0
    without = math.nan, 0.0, 0, np.full(number, math.nan)
    _, where, counts = np.unique(points, return_inverse=True, return_counts=True)
    several = counts[where] > 1 if len(points) else np.zeros(0, bool)
    if not several.any():
        return without
    groups = groups[several]
    _, where, counts = np.unique(points[several], return_inverse=True, return_counts=True)
    beds, columns = np.unique(seeds[several], return_inverse=True)
    y, design = values[several], np.eye(len(beds))[columns]
    of_point = np.eye(where.max() + 1)[where]
    mean = of_point / of_point.sum(axis=0)
    # effects of points are projected out of values and bed columns (Frisch-Waugh): what is left estimates beds
    off, own = y - of_point @ (mean.T @ y), design - of_point @ (mean.T @ design)
    directions, sizes, _ = np.linalg.svd(own, full_matrices=False)
    directions = directions[:, sizes > 1e-9 * sizes[0]]
    repeats = len(y) - of_point.shape[1] - directions.shape[1]
    if repeats < 1:
        return without
    of_beds_, leverage = directions @ (directions.T @ off), np.sum(directions**2, axis=1)
    squares, freedom = (off - of_beds_) ** 2, 1 - 1 / counts[where] - leverage
    variance = float(squares.sum()) / repeats
    sums, degrees = (np.bincount(groups, weights, number) for weights in (squares, freedom))
    noises = (sums + FEWEST_REPEATS * variance) / (degrees + FEWEST_REPEATS)
    # squares of the effects of beds hold noise too, as much as its variance at their leverages
    common = float(of_beds_ @ of_beds_ - leverage @ noises[groups]) / float(np.sum(own**2))
    return variance, max(common, 0.0), repeats, noises


@dataclass(frozen=True)
class SpaceTrend:
    """Known part of the logarithm of a quantity, up to a constant: the dependence of a flow rate on the outlet.

    Args:
        key: Key on which it depends; empty without a trend.
    """

    key: str = ""
    _of: Callable[[np.ndarray], np.ndarray] | None = None

    @classmethod
    def of(cls, quantity: str, axes: Sequence[Axis], scene: object) -> "SpaceTrend":
        """Find the trend of a quantity in a space; a trend of zero if none is known."""
        for axis in axes:
            dependence = trend_of_outlets(quantity, axis.key, scene, axis.low)  # pyright: ignore[reportArgumentType]
            if dependence is not None:
                return cls(axis.key, dependence)
        return cls()

    def at(self, at: Mapping[str, float | str]) -> float:
        """Compute it at values of keys."""
        return float(self._of(np.array(float(at[self.key])))) if self._of is not None else 0.0
