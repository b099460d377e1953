"""Residence times of each point, pooled over its beds."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from labbook.measure.marks import Marks, planes_above
from labbook.measure.measure import Measure
from labbook.measure.regime import FlowRegime
from labbook.measure.residence import LAYERS, Residence, ResidenceCurve, ResidenceMap, layers_of
from labbook.results.composition import PooledShares, pooled_shares
from labbook.results.points import PointResult, RunResult
from labbook.stats import Pooled, pool

LAYER_NAMES = tuple(f"layer {k + 1}" for k in range(LAYERS))
"""From the lowest to the highest."""


@dataclass(frozen=True, eq=False)
class PooledMap:
    """Residence times of a batch discharge over the initial position: mean over beds, and composition by layers."""

    result: PointResult
    map: ResidenceMap
    layers: PooledShares | None


@dataclass(frozen=True, eq=False)
class PooledCurve:
    """Distribution of residence times of a fed silo: F at the same ages [s] of all beds, shape [beds, k]."""

    result: PointResult
    age: np.ndarray
    fractions: np.ndarray


def residence_map(result: PointResult) -> PooledMap | None:
    """Pool the map of a batch discharge over beds; None if it was not measured.

    Cells have the same places in all beds. The time of a cell is the mean over the beds that have grains in it.
    """
    evaluations = [run.evaluation(Residence()) for run in _measured(result)]
    maps = [field for evaluation in evaluations if (field := ResidenceMap.of(evaluation)) is not None]
    if not maps:
        return None
    across, z = (_union([getattr(field, name) for field in maps]) for name in ("across", "z"))
    times = np.array([_placed(field, across, z, field.median, np.nan) for field in maps])
    counts = np.array([_placed(field, across, z, field.grains, 0.0) for field in maps])
    filled = ~np.isnan(times)
    total, number = np.where(filled, times, 0.0).sum(axis=0), filled.sum(axis=0)
    median = np.divide(total, number, out=np.full(total.shape, np.nan), where=number > 0)
    layers = pooled_shares(result, LAYER_NAMES, Residence.name, layers_of)
    return PooledMap(result, ResidenceMap(across, z, median, counts.mean(axis=0)), layers)


def residence_curve(result: PointResult) -> PooledCurve | None:
    """Distributions of residence times of a fed point, of all its runs; None if it was not measured."""
    evaluations = [run.evaluation(Residence()) for run in _measured(result)]
    curves = [curve for evaluation in evaluations if (curve := ResidenceCurve.of(evaluation)) is not None]
    if not curves:
        return None
    age = np.linspace(0.0, min(curve.age[-1] for curve in curves), len(curves[0].age))
    return PooledCurve(result, age, np.array([np.interp(age, curve.age, curve.part) for curve in curves]))


def regime_of(result: PointResult) -> dict[str, Pooled]:
    """Mass-flow index and stagnant fraction by name, pooled over the recorded runs that measured residence times."""
    return {} if result.point.scene.container.symmetry is None else _of_recorded(result, FlowRegime())


def marks_of(result: PointResult) -> dict[str, Pooled]:
    """Times from planes above the outlet to the outlet by name (`Marks`), of the same runs."""
    return _of_recorded(result, Marks()) if planes_above(result.point.scene) else {}


def _of_recorded(result: PointResult, measure: Measure) -> dict[str, Pooled]:
    values: dict[str, list[float]] = {}
    for run in _measured(result):
        if run.recorded:
            for number in run.evaluation(measure).numbers:
                if np.isfinite(number.value):
                    values.setdefault(number.quantity, []).append(number.value)
    return {name: pool(numbers) for name, numbers in values.items()}


def map_rows(pooled: PooledMap) -> Iterator[dict[str, float]]:
    """A row for each cell of the initial position that has grains."""
    field = pooled.map
    for line, column in np.argwhere(field.grains > 0):
        yield {
            "across_from": float(field.across[column]),
            "across_to": float(field.across[column + 1]),
            "z_from": float(field.z[line]),
            "z_to": float(field.z[line + 1]),
            "median": float(field.median[line, column]),
            "grains": float(field.grains[line, column]),
        }


def curve_rows(pooled: PooledCurve) -> Iterator[dict[str, float]]:
    """A row for each age: F, its standard error from seeds, and E up to the next age."""
    n = len(pooled.fractions)
    mean = pooled.fractions.mean(axis=0)
    error = pooled.fractions.std(axis=0, ddof=1) / n**0.5 if n > 1 else np.full(len(mean), np.nan)
    density = np.append(np.diff(mean) / np.diff(pooled.age), np.nan)
    for values in zip(pooled.age, mean, error, density, strict=True):
        yield dict(zip(("age", "part", "error", "exit_age"), map(float, values), strict=True))


def _measured(result: PointResult) -> list[RunResult]:
    return [run for run in result.runs if run.counted and Residence.name in run.measures]


def _union(edges: list[np.ndarray]) -> np.ndarray:
    """Edges of equal cells that cover those of all maps."""
    step = edges[0][1] - edges[0][0]
    first, last = round(min(cells[0] for cells in edges) / step), round(max(cells[-1] for cells in edges) / step)
    return step * np.arange(first, last + 1)


def _placed(field: ResidenceMap, across: np.ndarray, z: np.ndarray, values: np.ndarray, empty: float) -> np.ndarray:
    """Values of a map on the cells that cover all maps."""
    step = across[1] - across[0]
    line, column = round((field.z[0] - z[0]) / step), round((field.across[0] - across[0]) / step)
    placed = np.full((len(z) - 1, len(across) - 1), empty)
    placed[line : line + values.shape[0], column : column + values.shape[1]] = values
    return placed
