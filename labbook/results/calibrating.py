"""A calibration from the runs of a study: what its numerics did to the flow rate, by one regression."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from labbook.accuracy.calibration import KINDS, RANGES
from labbook.accuracy.groups import Groups, groups
from labbook.accuracy.regression import Observed, Slopes, regress
from labbook.results.points import FLOW_RATE, PointResult, by_seed


class NotCalibrated(ValueError):
    """A study that gives no calibration; the message says why."""


@dataclass(frozen=True)
class Effect:
    """What a setting does to W against the first one of its outlet, seed by seed: `change` of ln W with its standard
    error over `seeds` seeds, and `fitted`, the same by the regression."""

    label: str
    flow: Groups
    filled: Groups
    change: float
    error: float
    seeds: int
    fitted: float


@dataclass(frozen=True)
class Calibrated:
    """Slopes with their errors, what each setting did, and the entry of a calibration file."""

    slopes: Slopes
    effects: tuple[Effect, ...]
    entry: dict[str, Any]

    def lines(self) -> list[str]:
        """What came of it, line by line."""
        found = [
            f"{one.label}: overlap {one.flow.overlap:.2g} d (filled {one.filled.overlap:.2g}), "
            f"dt/t_c {one.flow.step:.3g}: W {one.change:+.2%} +- {one.error:.2%} ({one.seeds} seeds), "
            f"by the fit {one.fitted:+.2%}"
            for one in self.effects
        ]
        errors = np.sqrt(np.diag(self.slopes.covariance))
        words = ("overlap", "(dt/t_c)^2", "overlap while filling")
        found += [
            f"d ln W/d {w} = {v:.3g} +- {e:.2g}" for w, v, e in zip(words, self.slopes.values, errors, strict=True)
        ]
        scatter = (
            f"scatter between seeds {self.slopes.between:.2%}, between settings in one bed {self.slopes.within:.2%}"
        )
        return [*found, f"{self.slopes.runs} runs from {self.slopes.beds} beds; {scatter}"]


def calibrate(name: str, points: Sequence[PointResult]) -> Calibrated:
    """The calibration that the points of the study `name` give. Raises NotCalibrated."""
    if not points:
        raise NotCalibrated("no run is there")
    numerics = {one.point.index: _groups(one) for one in points}
    try:
        slopes = regress([run for one in points for run in _observed(one, *numerics[one.point.index])])
    except ValueError as reason:
        raise NotCalibrated(str(reason)) from None
    known = [group for pair in numerics.values() for group in pair]
    made = sorted({f"{run.backend} version {run.cache_version}" for one in points for run in one.runs})
    ranges = {key: [min(getattr(g, key) for g in known), max(getattr(g, key) for g in known)] for key in RANGES}
    ranges["overlap"] = [0.0, max(group.overlap for group in known)]
    ranges["step"] = [0.0, max(flow.step for flow, _ in numerics.values())]
    entry = {
        "kinds": {key: getattr(known[0], key) for key in KINDS},
        "ranges": ranges,
        "slopes": [float(value) for value in slopes.values],
        "covariance": [[None if math.isinf(v) else float(v) for v in row] for row in slopes.covariance],
        "freedom": slopes.freedom,
        "scatter": slopes.between,
        "source": f"{name}, {slopes.runs} runs on {', '.join(made)}, {datetime.now(UTC):%Y-%m-%d}",
    }
    return Calibrated(slopes, tuple(_effects(points, numerics, slopes)), entry)


def write(path: Path, entries: Sequence[dict[str, Any]]) -> None:
    """Write a calibration file. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"effects": list(entries)}, indent=2) + "\n", encoding="utf-8")


def _groups(point: PointResult) -> tuple[Groups, Groups]:
    """Of its flow and of its filling."""
    scene, numerics = point.point.scene, point.point.numerics
    own = point.point.fill.numerics or numerics
    flow, filled = (groups(scene, one.dt, one.stiffness_scale) for one in (numerics, own))
    if flow is None or filled is None:
        raise NotCalibrated(f"{point.label}: scenes of its outlet, bed or materials cannot be calibrated")
    return flow, filled


def _place(point: PointResult) -> str:
    """What is swept beside numerics."""
    return repr(
        [(key, value) for key, value in point.at.items() if not key.startswith(("numerics.", "fill.numerics."))]
    )


def _observed(point: PointResult, flow: Groups, filled: Groups) -> list[Observed]:
    beds, place = {run.seed: run.packing_key for run in point.runs}, _place(point)
    rates = by_seed(point, FLOW_RATE).items()
    return [Observed(f"{beds[s]} {place}", place, filled.overlap, flow.overlap, flow.step, rate) for s, rate in rates]


def _effects(points: Sequence[PointResult], numerics: dict[int, tuple[Groups, Groups]], slopes: Slopes) -> list[Effect]:
    found = []
    for point in points:
        first = next(one for one in points if _place(one) == _place(point))
        (flow, filled), (reference, bed) = numerics[point.point.index], numerics[first.point.index]
        a, b = by_seed(first, FLOW_RATE), by_seed(point, FLOW_RATE)
        change = np.array([math.log(b[seed] / a[seed]) for seed in sorted(a.keys() & b.keys())])
        x = [flow.overlap - reference.overlap, flow.step**2 - reference.step**2, filled.overlap - bed.overlap]
        error = float(change.std(ddof=1)) / math.sqrt(len(change)) if len(change) > 1 else math.nan
        mean = float(change.mean()) if len(change) else math.nan
        found.append(Effect(point.label, flow, filled, mean, error, len(change), float(slopes.values @ x)))
    return found
