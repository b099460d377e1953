"""What each switch of a backend saves: one settled bed, with less or more to compute of the same contacts."""

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from labbook.backend import Backend
from labbook.backend.probes import Ledger
from labbook.bench.scenes import FAN_STEP, variants
from labbook.scene import Scene
from labbook.scene.packing import Packing

STILL = FAN_STEP.model_copy(update={"dt": 1e-10})
"""While they are timed, grains move by less than 1e-9 m, and overlaps are some 2e-7 m: contacts remain those of the
settled bed, also where nothing holds the grains any more."""
TIMED = 4000  # steps of one timing, about


@dataclass(frozen=True)
class Saving:
    """How many times as fast the bed is, next to the full scene in the same round: median and range over rounds."""

    case: str
    times: float
    low: float
    high: float


def bed_of(scene: Scene, bed: Packing) -> Packing:
    """The same bed for a variant: where there are kinds, grains are of one after another in turn."""
    kinds = len(scene.grains.kinds)
    return replace(bed, kind=np.arange(len(bed)) % kinds) if kinds else bed


def savings(
    backend: Backend, closed: Scene, bed: Packing, rounds: int, say: Callable[[str], None] = lambda _: None
) -> tuple[Saving, ...]:
    """Time the settled `bed` of the scene `closed` and of its variants, in turn, by processor time."""
    cases = {"as it is": (closed, []), **{what: (scene, []) for what, scene in variants(closed).items()}}
    cases["with a ledger"] = (closed, [Ledger()])
    open_ones = {}
    for what, (scene, probes) in cases.items():
        say(f"preparing the settled bed {what} (compiles)")
        ensemble = backend.open(backend.specialise(scene, STILL, probes), 1)
        ensemble.admit(scene, STILL, bed_of(scene, bed))
        ensemble.advance(1)  # kernels are compiled
        open_ones[what] = ensemble
    spent = {what: [] for what in cases}
    for turn in range(rounds):
        say(f"timing what switches save, round {turn + 1} of {rounds}")
        for what, ensemble in open_ones.items():
            began = time.process_time()
            ensemble.advance(max(1, TIMED // STILL.steps_per_beat))
            spent[what].append(time.process_time() - began)
            ensemble.drain()
    for ensemble in open_ones.values():
        ensemble.close()
    full = spent.pop("as it is")
    ratios = {what: [a / b for a, b in zip(full, times, strict=True)] for what, times in spent.items()}
    return tuple(Saving(what, statistics.median(r), min(r), max(r)) for what, r in ratios.items())
