"""Grains of a member get other velocities: these, from this beat on, and nothing else changes."""

import numpy as np
import pytest
from platforms import identical

from labbook.checks.verify.platform import rows_of

BEATS, AT = 16, 6
V = np.array([0.02, 0.0, 0.03])


def set_some(ensemble, member):
    """Give every third grain the velocity V."""
    ids = np.sort(ensemble.packing(member).ids)[::3]
    ensemble.set_velocities(member, ids, np.tile(V, (len(ids), 1)))
    return ids


@pytest.fixture(scope="module")
def pushed(silo):
    """End and rows of a member whose grains were pushed after beat AT."""
    with silo.ensemble() as ensemble:
        member = silo.admit(ensemble)
        ensemble.advance(AT)
        set_some(ensemble, member)
        ensemble.advance(BEATS - AT)
        rows = {probe: rows_of(table, member) for probe, table in ensemble.drain().items()}
        return ensemble.packing(member), rows


def test_grains_have_the_velocities_and_others_keep_theirs(silo):
    """Half a step of acceleration is added to those of the half step before: in a bed some 100 g, so that 2 % do."""
    with silo.ensemble() as ensemble:
        member = silo.admit(ensemble)
        ensemble.advance(AT)
        before = ensemble.packing(member)
        ids = set_some(ensemble, member)
        after = ensemble.packing(member)
        assert np.array_equal(after.x, before.x)
        assert np.array_equal(after.ids, before.ids)
        mine = np.isin(after.ids, ids)
        assert np.median(np.linalg.norm(after.v[mine] - V, axis=1)) < 0.1 * np.linalg.norm(V)
        assert np.median(np.linalg.norm((after.v - before.v)[~mine], axis=1)) < 0.02 * np.linalg.norm(V)


@pytest.mark.parametrize("at", [AT, AT + 4])
def test_it_continues_from_a_checkpoint_bit_for_bit(silo, pushed, at):
    """Taken just after grains were pushed, and later; in another slot, beside a member that is not pushed."""
    state, _ = pushed
    with silo.ensemble() as ensemble:
        member = silo.admit(ensemble)
        ensemble.advance(AT)
        set_some(ensemble, member)
        ensemble.advance(at - AT) if at > AT else None
        checkpoint = ensemble.checkpoint(member)
    with silo.ensemble() as ensemble:
        silo.admit(ensemble)
        member = silo.admit(ensemble, checkpoint)
        ensemble.advance(BEATS - at)
        assert identical(ensemble.packing(member), state)


def test_the_motion_differs_and_a_neighbour_does_not_know(silo, pushed):
    with silo.ensemble() as ensemble:
        members = [silo.admit(ensemble) for _ in range(2)]
        ensemble.advance(AT)
        set_some(ensemble, members[0])
        ensemble.advance(BEATS - AT)
        assert identical(ensemble.packing(members[0]), pushed[0])
        alone = ensemble.packing(members[1])
    with silo.ensemble() as ensemble:
        member = silo.admit(ensemble)
        ensemble.advance(BEATS)
        assert identical(ensemble.packing(member), alone)
        assert not identical(alone, pushed[0])


def test_grains_that_are_not_there_are_refused(silo):
    with silo.ensemble() as ensemble:
        member = silo.admit(ensemble)
        with pytest.raises(ValueError, match="not in the scene"):
            ensemble.set_velocities(member, np.array([10**6]), np.zeros((1, 3)))
