"""Composition of the outflow of each point, pooled over its beds."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from labbook.measure import Evaluation
from labbook.measure.composition import Composition, OutflowShares, class_names
from labbook.results.points import PointResult


@dataclass(frozen=True, eq=False)
class PooledShares:
    """Mass fraction of each of s kinds in b bins of the outflow: mean over beds."""

    result: PointResult
    names: tuple[str, ...]
    fraction: np.ndarray
    """Discharged fraction M of the initial mass at the edges of the bins, shape [b + 1]."""
    initial: np.ndarray
    """Mass fraction x_i0 in the bed, shape [s]."""
    share: np.ndarray
    """x_i in a bin, shape [s, b]."""
    error: np.ndarray
    """Standard error of x_i from the scatter between beds, shape [s, b]; NaN of one bed."""
    counting: np.ndarray
    """Counting error of x_i, shape [s, b]."""
    beds: tuple[OutflowShares, ...]
    """Composition of each bed: mean over its discharges."""


def composition_of(result: PointResult) -> PooledShares | None:
    """Pool the composition over the beds of a point; None if it was not measured, or no bin is complete."""
    names = class_names(result.point.scene.grains)
    return pooled_shares(result, names, Composition.name, OutflowShares.of)


def pooled_shares(
    result: PointResult, names: tuple[str, ...], measure: str, read: Callable[[Evaluation], OutflowShares | None]
) -> PooledShares | None:
    """Pool the composition of the outflow by any classes of grains over the beds of a point.

    The bins of all beds hold the same numbers of grains. Bins that are not complete in every run are left out.

    Args:
        result: the point.
        names: of the classes.
        measure: that has given the composition.
        read: finds the composition in its evaluation.

    Returns:
        The mean; None if it was not measured, or no bin is complete.
    """
    by_bed: dict[int, list[OutflowShares]] = {}
    for run in result.runs:
        if run.counted and measure in run.measures:
            shares = read(run.evaluation(measure))
            if shares is not None:
                by_bed.setdefault(run.seed, []).append(shares)
    if not by_bed:
        return None
    bins = min(shares.share.shape[1] for discharges in by_bed.values() for shares in discharges)
    beds = tuple(_mean([_shortened(shares, bins) for shares in discharges]) for discharges in by_bed.values())
    whole, values = _mean(beds), np.array([bed.share for bed in beds])
    n = len(beds)
    error = values.std(axis=0, ddof=1) / math.sqrt(n) if n > 1 else np.full_like(whole.share, math.nan)
    return PooledShares(result, names, whole.fraction, whole.initial, whole.share, error, whole.error, beds)


def rows(pooled: PooledShares) -> Iterator[dict[str, float | str | int]]:
    """A row for each kind and bin of the outflow: x_i, X_i = x_i/x_i0 and their errors."""
    for kind, name in enumerate(pooled.names):
        initial = float(pooled.initial[kind])
        for k in range(pooled.share.shape[1]):
            share, error, counting = (float(a[kind, k]) for a in (pooled.share, pooled.error, pooled.counting))
            yield {
                "kind": name,
                "from": float(pooled.fraction[k]),
                "to": float(pooled.fraction[k + 1]),
                "share": share,
                "error": error,
                "counting_error": counting,
                "initial": initial,
                "normalised": share / initial,
                "normalised_error": error / initial,
                "replicates": len(pooled.beds),
            }


def _shortened(shares: OutflowShares, bins: int) -> OutflowShares:
    return OutflowShares(
        shares.fraction[: bins + 1], shares.share[:, :bins], shares.error[:, :bins], shares.mass[:, :bins],
        shares.initial,
    )  # fmt: skip


def _mean(several: list[OutflowShares] | tuple[OutflowShares, ...]) -> OutflowShares:
    """Mean composition; counting errors are taken as independent."""
    fraction, share, mass, initial = (
        np.mean([getattr(shares, name) for shares in several], axis=0)
        for name in ("fraction", "share", "mass", "initial")
    )
    counting = np.sqrt(np.sum([shares.error**2 for shares in several], axis=0)) / len(several)
    return OutflowShares(fraction, share, counting, mass, initial)
