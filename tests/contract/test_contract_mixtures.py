"""The contract holds for scenes whose grains differ in size and kind."""

# a packing need not have diameters and kinds; those of these tests do
# pyright: reportOptionalMemberAccess=false, reportOptionalSubscript=false, reportOptionalOperand=false
# pyright: reportArgumentType=false, reportCallIssue=false

from dataclasses import replace

import numpy as np
import pytest
from platforms import identical

from labbook.backend.probes import Crossing, Ledger
from labbook.checks.verify.bed import DT
from labbook.checks.verify.mixture import graded_hopper
from labbook.checks.verify.platform import rows_of
from labbook.filling import place, start_of_discharge
from labbook.scene import Bodies


@pytest.fixture(scope="module")
def flowing(platform):
    """A mixture that is about to flow out, and its ensemble. Who is who does not depend on the precision of forces."""
    if platform.second:
        pytest.skip("mixtures are checked in one precision of a backend on a processor")
    scene, numerics = graded_hopper(80), platform.numerics(DT / 2, steps_per_beat=500)
    closed = scene.close()
    spec = platform.backend.specialise(closed, numerics, [Ledger()])
    ensemble = platform.backend.open(spec, 1, platform.device)
    member = ensemble.admit(closed, numerics, place(closed, "gas", 1))
    ensemble.advance(30)
    start = start_of_discharge(ensemble.packing(member), closed, scene)
    ensemble.close()
    probes = [Crossing(), Ledger()]
    ensemble = platform.backend.open(platform.backend.specialise(scene, numerics, probes), 2, platform.device)
    yield scene, numerics, start, ensemble
    ensemble.close()


def test_a_packing_tells_who_is_what(flowing):
    scene, _, start, _ = flowing
    placed = place(scene.close(), "gas", 1)
    assert np.array_equal(start.diameter[np.argsort(start.ids)], placed.diameter)
    assert np.array_equal(start.kind[np.argsort(start.ids)], placed.kind)


def test_grains_that_leave_take_their_mass_along_and_the_rest_go_on_bit_for_bit(flowing):
    scene, numerics, start, ensemble = flowing
    one = ensemble.admit(scene, numerics, start)
    ensemble.advance(20)
    halfway = ensemble.checkpoint(one)
    ensemble.advance(20)
    end = ensemble.packing(one)
    rows = ensemble.drain()
    crossed = rows_of(rows[Crossing()], one)
    assert 5 < len(crossed["id"]) < len(start)
    mass = dict(zip(start.ids.tolist(), Bodies.of(scene.grains, start).mass.tolist(), strict=True))
    left = Bodies.of(scene.grains, end)
    assert [mass[grain] for grain in end.ids] == left.mass.tolist()
    assert rows_of(rows[Ledger()], one)["mass"][-1] == pytest.approx(left.mass.sum(), rel=1e-12)
    ensemble.retire(one)

    other = ensemble.admit(scene, numerics, halfway)
    ensemble.advance(20)
    assert identical(ensemble.packing(other), end)
    ensemble.retire(other)
    ensemble.drain()


def test_a_packing_without_them_is_refused(flowing):
    scene, numerics, start, ensemble = flowing
    with pytest.raises(ValueError, match="no kinds of grains"):
        ensemble.admit(scene, numerics, replace(start, kind=None))
