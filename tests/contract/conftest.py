"""The backends under the contract: every bundled one, in each of its precisions, on each of its devices."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from platforms import Bundled, platforms, sharing, where

from labbook.backend import Checkpoint, Ensemble, Member
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Crossing, Ledger, Probe, Table
from labbook.checks.verify.platform import rows_of
from labbook.checks.verify.symmetry import DT, hopper
from labbook.filling.opening import start_of_discharge
from labbook.filling.placing import place
from labbook.scene import Scene
from labbook.scene.packing import Packing

STEPS = 250
"""Steps per beat of these tests."""


def in_the_ring(platform: Bundled):
    """In its other precision a backend takes the contract in the ring, and on a GPU: most of the time goes into
    compiling the same kernels again. Verification takes both."""
    found = where(platform)
    return pytest.param(*found.values, id=found.id, marks=[*found.marks, *[pytest.mark.ring] * platform.second])


@pytest.fixture(scope="session", params=[in_the_ring(sharing(platform)) for platform in platforms()])
def platform(request) -> Bundled:
    return request.param


@dataclass(frozen=True)
class Silo:
    """A small hopper that is about to flow out, and how to open ensembles of it."""

    platform: Bundled
    scene: Scene
    start: Packing
    crossing = Crossing()
    ledger = Ledger()

    @property
    def rounding(self) -> float:
        """Relative rounding error of forces and velocities."""
        return float(np.finfo(np.float32 if self.platform.precision == "mixed" else np.float64).eps)

    def numerics(self, dt: float = DT, **further: Any) -> Numerics:
        return self.platform.numerics(dt, **{"steps_per_beat": STEPS, **further})

    @contextmanager
    def ensemble(
        self,
        scene: Scene | None = None,
        numerics: Numerics | None = None,
        probes: Sequence[Probe] = (Crossing(), Ledger()),
        slots: int | None = None,
        platform: Bundled | None = None,
    ) -> Iterator[Ensemble]:
        backend = (platform or self.platform).backend
        spec = backend.specialise(scene or self.scene, numerics or self.numerics(), probes)
        ensemble = backend.open(spec, slots, self.platform.device)
        try:
            yield ensemble
        finally:
            ensemble.close()

    def admit(self, ensemble: Ensemble, start: Packing | Checkpoint | None = None, **further: Any) -> Member:
        return ensemble.admit(self.scene, self.numerics(), start or self.start, **further)

    def discharge(self, beats: int) -> tuple[Packing, dict[Probe, Table]]:
        """The member alone, advanced in one go: its state and rows."""
        with self.ensemble() as ensemble:
            member = self.admit(ensemble)
            ensemble.advance(beats)
            tables = {probe: rows_of(table, member) for probe, table in ensemble.drain().items()}
            return ensemble.packing(member), tables


@pytest.fixture(scope="session")
def silo(platform) -> Silo:
    """Grains that have fallen into the closed hopper and still move; the outlet is open."""
    closed = hopper().close()
    numerics = platform.numerics(DT)
    ensemble = platform.backend.open(platform.backend.specialise(closed, numerics, [Ledger()]), 1, platform.device)
    member = ensemble.admit(closed, numerics, place(closed, "gas", 1))
    ensemble.advance(4)
    fallen = ensemble.packing(member)
    ensemble.close()
    return Silo(platform, hopper(), start_of_discharge(fallen, closed, hopper()))
