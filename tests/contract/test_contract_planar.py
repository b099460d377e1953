"""A bed that starts in a plane stays in it: what would push a grain out of it is zero, not small."""

import numpy as np

from labbook.backend.probes import Crossing, Ledger
from labbook.checks.verify.symmetry import DT, hopper
from labbook.filling import place, start_of_discharge


def _across(packing) -> np.ndarray:
    """What a motion in the plane has none of: y, v_y, and spins about x and z."""
    return np.column_stack([packing.x[:, 1], packing.v[:, 1], packing.omega[:, [0, 2]]])


def test_a_planar_bed_never_leaves_its_plane(platform):
    """Filled and partly discharged: every part across the plane is exactly zero, so that no round-off can grow."""
    scene = hopper()
    closed, numerics, probes = scene.close(), platform.numerics(DT, steps_per_beat=250), [Crossing(), Ledger()]
    ensemble = platform.backend.open(platform.backend.specialise(closed, numerics, probes), 1, platform.device)
    filling = ensemble.admit(closed, numerics, place(closed, "planar", 1))
    ensemble.advance(round(60 * platform.part))
    bed = ensemble.packing(filling)
    ensemble.close()
    assert len(bed.pairs) > 20
    assert not np.any(_across(bed))
    assert not np.any(bed.pair_spring[:, 1])
    assert np.any(bed.omega[:, 1])
    ensemble = platform.backend.open(platform.backend.specialise(scene, numerics, probes), 1, platform.device)
    flowing = ensemble.admit(scene, numerics, start_of_discharge(bed, closed, scene))
    ensemble.advance(16)
    rest = ensemble.packing(flowing)
    ensemble.close()
    assert 0 < len(rest) < len(bed)
    assert not np.any(_across(rest))
