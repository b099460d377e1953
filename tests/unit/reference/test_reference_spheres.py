"""The CPU backend, with its lists, blocks and registers, moves grains as the reference does, contact by contact."""

import labbook_reference
import numpy as np
import pytest

pytest.importorskip("numba")

from labbook_numba import Backend

from labbook.backend.numerics import Numerics
from labbook.checks.verify.case import ROUNDING
from labbook.checks.verify.materials import LAWS, D
from labbook.checks.verify.symmetry import DT, hopper
from labbook.filling.placing import place

pytestmark = pytest.mark.compiles

STEPS = 100
SOFT = {"hertz-mindlin": {"shear_modulus": 1e6}, "linear": {"normal_stiffness": 500.0}}
# Round-off of sums in another order grows in collisions; the case `renumbering` allows it 1e-12 d after 200 steps,
# and here are half as many. Single precision adds the roundings of a force, 16, to the path of a grain in that time:
# 1.5 d in 200 steps of free fall from rest, and not ten times as much
NEAR = {"double": 1e-12 * D, "mixed": 16 * ROUNDING * 10 * 1.5 * D}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "precision"), [("hertz-mindlin", "double"), ("hertz-mindlin", "mixed"), ("linear", "double")]
)
def test_both_move_alike(law, precision):
    """The mixed backend too, within the rounding of its forces: the reference is in double precision."""
    scene = hopper().close()
    scene = scene.model_copy(update={"contact": LAWS[law](**SOFT[law])})
    numerics = Numerics.model_validate({"dt": DT, "precision": precision, "steps_per_beat": STEPS})
    backend = Backend(wide=True)  # whose kernels are those of the contract's tests
    ensemble = backend.open(backend.specialise(scene, numerics), 1)
    member = ensemble.admit(scene, numerics, place(scene, "gas", 1))
    ensemble.advance(40)
    start = ensemble.packing(member)
    again = ensemble.admit(scene, numerics, start)
    ensemble.advance(1)
    end = ensemble.packing(again)
    ensemble.close()

    reference, exact = labbook_reference.Backend(), numerics.model_copy(update={"precision": "double"})
    stepped = reference.open(reference.specialise(scene, exact))
    member = stepped.admit(scene, exact, start)
    stepped.advance(1)
    plain = stepped.packing(member)

    assert len(start.pairs) > 30
    assert len(start.wall_grain) > 30
    assert len(plain.pairs) + len(plain.wall_grain) > 60
    moved = np.abs(end.x - start.x).max()
    assert moved > 1e3 * NEAR[precision]
    assert np.abs(end.x - plain.x).max() < NEAR[precision]
    # springs last touched at the step before the last positions; they are those of the same contacts
    pairs = {(int(i), int(j)) for i, j in end.pairs}
    assert pairs == {(int(i), int(j)) for i, j in plain.pairs}
