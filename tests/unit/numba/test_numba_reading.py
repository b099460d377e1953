"""What is read of a member of the CPU backend leaves no trace in its state."""

from contextlib import closing

import pytest

pytest.importorskip("numba")

from labbook_numba import Backend
from labbook_numba import state as S

from labbook.backend.probes import Crossing
from labbook.checks.bench.speed import FAN_STEP, fan
from labbook.filling.placing import place

pytestmark = pytest.mark.compiles


def test_a_packing_that_is_read_changes_no_bit_of_the_state():
    """A run that was killed takes the picture of its bed later, perhaps in its last beat: a grain that had fallen out
    then lost its row before the last state was kept."""
    scene, backend = fan(grains=60), Backend(wide=True)
    spec = backend.specialise(scene, FAN_STEP, [Crossing()])
    fallen = 0
    with closing(backend.open(spec)) as ensemble:
        member = ensemble.admit(scene, FAN_STEP, place(scene.close(), "rain", 1))
        for _ in range(60):
            ensemble.advance(1)
            before = dict(ensemble.checkpoint(member).arrays)
            packing = ensemble.packing(member)
            after = dict(ensemble.checkpoint(member).arrays)
            assert {name: array.tobytes() for name, array in before.items()} == {
                name: array.tobytes() for name, array in after.items()
            }
            fallen += len(packing) < before["count"][S.GRAINS]
    assert fallen, "in some beat a grain was far below the outlet"
