"""What the CPU backend notices of states that went wrong."""

from typing import Any

import numpy as np
import pytest
from labbook_numba import Backend
from labbook_numba.state import W

from labbook.backend import Checkpoint, Failed
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Crossing, Ledger
from labbook.scene import Scene, Spheres
from labbook.verify.stand import grains_at
from labbook.verify.symmetry import hopper

pytestmark = pytest.mark.compiles

APART = Scene(
    grains=Spheres(diameter=3e-3, density=2500, count=3),
    contact=hopper().contact,
    container=hopper(300.0).container,
)
"""Grains above an outlet of metres, whose walls are beyond reach."""
NUMERICS = Numerics(dt=1e-5, steps_per_beat=50)


def test_a_spin_that_is_no_number_is_caught_although_its_grain_touches_nothing():
    backend = Backend(wide=True)  # whose kernels are those of the contract's tests
    ensemble: Any = backend.open(backend.specialise(APART, NUMERICS, [Crossing(), Ledger()]), 1)
    try:
        sound = ensemble.admit(APART, NUMERICS, grains_at([[0, 0, 1], [0.1, 0, 1], [0.2, 0, 1]]))
        ensemble.advance(1)
        saved = ensemble.checkpoint(sound)
        harmed = {name: np.array(array) for name, array in saved.arrays.items()}
        harmed["grains"][1, W + 2] = np.nan
        with pytest.raises(ValueError, match="grains is not finite in row 1"):
            ensemble.admit(APART, NUMERICS, Checkpoint(saved.backend, saved.cache_version, harmed))
        bad = ensemble.admit(APART, NUMERICS, saved)
        ensemble._runs[bad].state.grains[1, W + 2] = np.nan  # as if the law had given it
        (event,) = ensemble.advance(3)
        assert isinstance(event, Failed)
        assert (event.member, event.guard, event.grain) == (bad, "state", 1)
        assert "grain 1 at step 100 (1 ms, dt = 10 us): its spin is NaN" in event.message
        assert ensemble.status(bad).step == 50, "left as it was before the beat"
        assert ensemble.status(sound).step == 200
        assert not ensemble.advance(1)
        with pytest.raises(ValueError, match="omega is not finite in row 1"):
            ensemble.packing(bad)
    finally:
        ensemble.close()
