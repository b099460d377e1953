"""How long two backends agree on where the grains are, before chaos takes over.

Backends add up forces in different orders. Their rounding errors, some 1e-16 of a diameter at first, grow exponentially
in flowing grains, as any difference does; when they reach a diameter the two discharges are different replicates.
"""

import math
from collections.abc import Mapping

import numpy as np

from labbook.backend.probes import Sample
from labbook.compare.lockstep import Frame, side_by_side
from labbook.compare.pair import Pair
from labbook.compare.verdict import Divergence
from labbook.filling import opened
from labbook.lab.folder import Lab
from labbook.lab.packings import load_packing
from labbook.run.demand import Demand
from labbook.scene.model import digest

AGREE = 1e-3
"""Largest difference of a position [d] up to which backends agree."""
APART = 1.0
"""Largest difference [d] at which there is nothing left to compare."""
LONGEST = 50.0
"""Time after which looking ends [sqrt(d/g)]."""
_INTERVAL = 0.05  # between frames [sqrt(d/g)]


def divergence(pair: Pair, demands: tuple[Demand, Demand], lab: Lab, known: Mapping[str, Divergence]) -> Divergence:
    """Of the same run of both backends, whose packing the first one has made; one that is `known` by its key is not
    found again. Raises Unreadable or Unsupported."""
    first, _ = demands
    shared = first.shared
    keys = [demand.keys(one.can).run for one, demand in zip(pair, demands, strict=True)]
    key = digest({"runs": keys, "devices": [one.device for one in pair], "looks": [AGREE, APART, LONGEST, _INTERVAL]})
    if key in known:
        return known[key]
    tick = math.sqrt(shared.scene.grains.diameter / shared.scene.gravity)
    numerics = shared.numerics.model_copy(
        update={"steps_per_beat": max(1, round(_INTERVAL * tick / shared.numerics.dt))}
    )
    packing = load_packing(lab.packing(first.keys(pair[0].can).packing))
    start = opened(packing, shared.closed, shared.scene)
    times, medians, largest = [0.0], [0.0], [0.0]
    with side_by_side(pair, shared.scene, numerics, start, Sample(fields=("x",), every=1)) as both:
        for frame in both.frames(LONGEST * tick):
            apart = distances(frame) / shared.scene.grains.diameter
            if not len(apart):
                break
            times.append(frame.time)
            medians.append(float(np.median(apart)))
            largest.append(float(apart.max()))
            if largest[-1] >= APART:
                break
        whole = times[-1] >= LONGEST * tick - 1.5 * numerics.beat
        ended = "diverged" if largest[-1] >= APART else "failed" if both.failure else "longest" if whole else "empty"
        rates = both.walkers[0].rate, both.walkers[1].rate
        note = both.failure or ""
    return Divergence(
        key=key,
        seed=first.seed,
        time=tuple(times),
        median=tuple(medians),
        largest=tuple(largest),
        agree_until=agreement(times, largest),
        ended=ended,
        note=note,
        rates=rates,
    )


def distances(frame: Frame) -> np.ndarray:
    """Distances [m] between the two places of every grain that both backends have."""
    a, b = frame.tables
    _, here, there = np.intersect1d(a["id"], b["id"], assume_unique=True, return_indices=True)
    apart = [np.asarray(a[axis])[here] - np.asarray(b[axis])[there] for axis in "xyz"]
    return np.sqrt(sum(part**2 for part in apart))


def agreement(times: list[float], largest: list[float]) -> float:
    """The last of `times` before `largest` first exceeds AGREE."""
    beyond = next((k for k, value in enumerate(largest) if value > AGREE), len(largest))
    return times[beyond - 1]
