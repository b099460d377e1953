"""What a measurement reads: one finished run, free of any backend and of where it is stored."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from labbook.backend.numerics import Numerics
from labbook.scene import Scene
from labbook.scene.packing import Packing


@dataclass(frozen=True, eq=False)
class RunData:
    """A discharge as it was observed.

    `tables`: rows of the probes by their lower-case names (`crossing`, `sample`, `slab`, `zone`, `contacts`, `ledger`),
    columns as `labbook.backend.probes` lists them. `duration`: simulated time covered since the opening [s].
    `outcome`: how it ended (finished, precise, emptied, clogged, diverged, time-limit).
    """

    scene: Scene
    numerics: Numerics
    seed: int
    start: Packing
    outcome: str
    duration: float
    tables: Mapping[str, Mapping[str, np.ndarray]] = field(default_factory=dict)
