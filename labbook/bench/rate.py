"""Grain-steps per second of processor time of one member."""

import statistics
import time
from dataclasses import dataclass

from labbook.backend import Backend, Ensemble, Failed, Member
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Probe
from labbook.scene import Scene
from labbook.scene.packing import Packing

TIMED = 12_000_000  # grain-steps of one timing, about
LONGEST = 1.5  # s of processor time of one timing, about; at least one beat


@dataclass(frozen=True)
class Rate:
    """Millions of grain-steps per second of processor time: median and range over `repeats`."""

    case: str
    precision: str
    median: float
    low: float
    high: float
    grains: int
    repeats: int


def timed(
    backend: Backend,
    case: str,
    scene: Scene,
    numerics: Numerics,
    start: Packing,
    repeats: int,
    probes: list[Probe] | None = None,
    after: float = 0.0,
) -> Rate:
    """Rate of one member, from `after` [s] on; the first two beats are not timed: kernels may be compiled in one, and
    the other tells how many beats to time."""
    ensemble = backend.open(backend.specialise(scene, numerics, probes or []), 1)
    member = ensemble.admit(scene, numerics, start)
    ensemble.advance(max(1, round(after / numerics.beat)))
    began = time.process_time()
    ensemble.advance(1)
    beat = max(time.process_time() - began, 1e-6)
    beats = max(1, min(TIMED // (len(start) * numerics.steps_per_beat), round(LONGEST / beat)))
    rate = _rate(case, numerics.precision, ensemble, [member], beats, repeats)
    ensemble.close()
    return rate


def _rate(case: str, precision: str, ensemble: Ensemble, members: list[Member], beats: int, repeats: int) -> Rate:
    rates = []
    for _ in range(repeats):
        before = [ensemble.status(member) for member in members]
        began = time.process_time()
        events = ensemble.advance(beats)
        if failed := [event for event in events if isinstance(event, Failed)]:
            raise RuntimeError(f"{case}: {failed[0].message}")
        spent = time.process_time() - began
        after = [ensemble.status(member) for member in members]
        done = sum((b.step - a.step) * (a.grains + b.grains) / 2 for a, b in zip(before, after, strict=True))
        rates.append(done / spent / 1e6)
    grains = ensemble.status(members[0]).grains
    return Rate(case, precision, statistics.median(rates), min(rates), max(rates), grains, repeats)
