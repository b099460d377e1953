"""What the CPU backend notices of states that went wrong, and that it reads only grains that are there."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from labbook_numba import Backend
from labbook_numba.state import LEAVING, MOVED, W

from labbook.backend import Checkpoint, Failed
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Crossing, Ledger
from labbook.checks.verify.platform import grains_at
from labbook.checks.verify.symmetry import hopper
from labbook.scene import CylinderSilo, LinearSpringDashpot, Scene, Spheres, Spherocylinders

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


RODS = Scene(
    grains=Spherocylinders(diameter=6e-3, length=20e-3, density=620, count=4),
    contact=LinearSpringDashpot(normal_stiffness=200.0, friction=0.5, rolling_friction=0.01, restitution=0.5),
    container=CylinderSilo(diameter=10.0, height=0.5, orifice=9.0),
)
"""Rods over an outlet that they fall through without touching anything."""


@pytest.mark.parametrize("scene", [APART, RODS], ids=["spheres", "rods"])
def test_a_grain_that_loses_its_row_while_the_state_is_read_is_not_read(scene):
    """Reading makes new lists where grains have moved far, and these leave out grains far below the outlet."""
    backend = Backend(wide=True)
    rods, count = isinstance(scene.grains, Spherocylinders), scene.grains.count
    numerics = NUMERICS if not rods else Numerics(dt=1e-4, steps_per_beat=50)
    start = grains_at([[0.1 * k, 0, 0.2] for k in range(count)])
    start.x[0, 2] = -1.0 if rods else -5.0
    start = replace(start, q=np.tile([1.0, 0, 0, 0], (count, 1))) if rods else start
    ensemble: Any = backend.open(backend.specialise(scene, numerics, [Crossing(), Ledger()]), 1)
    try:
        run = ensemble._runs[ensemble.admit(scene, numerics, start)]
        ensemble.advance(1)
        run.state.count[LEAVING] = 1  # as a step tells of a grain that has just fallen far enough
        run.state.sums[MOVED] = 1.0
        rows = run.grains
        seen = run.look()
        assert run.grains == rows - 1
        assert sorted(seen.ids) == list(range(1, count))
        for array in (seen.x, seen.v, seen.w, seen.m, seen.v_half, seen.m_half):
            assert len(array) == count - 1
    finally:
        ensemble.close()
