"""A member's bits depend on its scene, numerics, start and Spec, and on nothing else."""

from dataclasses import replace

import pytest
from platforms import identical

from labbook.checks.verify.platform import rows_of
from labbook.checks.verify.symmetry import DT

BEATS = 12


@pytest.fixture(scope="module")
def alone(silo):
    """State and rows of the member advanced by itself; grains leave, and lists are rebuilt, while it runs."""
    state, tables = silo.discharge(BEATS)
    ledger = tables[silo.ledger]
    assert ledger["grains"][-1] < ledger["grains"][0]
    if silo.platform.lists:
        assert ledger["rebuilds"][-1] > ledger["rebuilds"][0] + 3
    return state, tables


def check(ensemble, member, alone):
    state, tables = alone
    assert identical(ensemble.packing(member), state)
    rows = ensemble.drain()
    for probe, table in tables.items():
        assert identical(rows_of(rows[probe], member), table), probe


@pytest.mark.parametrize("splits", [[1] * BEATS, [5, 7], [7, 1, 4]])
def test_however_advance_is_split(silo, alone, splits):
    with silo.ensemble() as ensemble:
        member = silo.admit(ensemble)
        for beats in splits:
            ensemble.advance(beats)
        check(ensemble, member, alone)


@pytest.mark.parametrize("slots", [1, 2, None])
def test_whatever_its_neighbours_are(silo, alone, slots):
    other = silo.scene.model_copy(update={"gravity": 5.0})
    shuffled = silo.start.renumbered(silo.start.x[:, 2].argsort())
    with silo.ensemble(slots=slots) as ensemble:
        ensemble.admit(other, silo.numerics(0.5 * DT), shuffled)
        member = silo.admit(ensemble)
        twin = silo.admit(ensemble)
        ensemble.advance(BEATS)
        state, _ = alone
        assert identical(ensemble.packing(twin), state)
        check(ensemble, member, alone)


def test_whichever_slot_it_has(silo, alone):
    with silo.ensemble(slots=1) as ensemble:
        before = [silo.admit(ensemble) for _ in range(2)]
        ensemble.advance(2)
        for member in before:
            ensemble.retire(member)
        late = silo.admit(ensemble)
        ensemble.drain()
        ensemble.advance(BEATS)
        check(ensemble, late, alone)


def test_whoever_was_there_before(silo):
    """Of a member that is gone, nothing stays: not its clock, nor its material, in what was compiled or captured."""
    contact = silo.scene.contact
    other = silo.scene.model_copy(update={"contact": contact.model_copy(update={"friction": 0.5 * contact.friction})})
    with silo.ensemble(slots=1) as ensemble:
        first = ensemble.admit(other, silo.numerics(0.5 * DT), silo.start)
        ensemble.advance(2)
        with_other = ensemble.packing(first)
        ensemble.retire(first)
        ensemble.drain()
        second = silo.admit(ensemble)
        ensemble.advance(2)
        state, _ = silo.discharge(2)
        assert identical(ensemble.packing(second), state)
        assert not identical(state, with_other)


def test_members_keep_their_own_clocks(silo):
    with silo.ensemble() as ensemble:
        slow, fast = silo.admit(ensemble), ensemble.admit(silo.scene, silo.numerics(0.5 * DT), silo.start)
        ensemble.advance(4)
        ours, theirs = ensemble.status(slow), ensemble.status(fast)
        # all but the energy, which may be left out
        assert replace(ensemble.progress(slow), kinetic=ours.kinetic) == ours
        assert ours.step == theirs.step == 4 * silo.numerics().steps_per_beat
        assert ours.time == pytest.approx(2 * theirs.time, rel=1e-12)
        late = silo.admit(ensemble)
        assert ensemble.status(late).step == 0
        ensemble.advance(1)
        assert ensemble.status(late).step == silo.numerics().steps_per_beat


def test_a_retired_member_is_gone(silo):
    with silo.ensemble() as ensemble:
        gone, stays = silo.admit(ensemble), silo.admit(ensemble)
        ensemble.retire(gone)
        assert gone != stays
        ensemble.advance(1)
        with pytest.raises(KeyError):
            ensemble.status(gone)
        assert ensemble.status(stays).step > 0
        assert set(ensemble.drain()[silo.ledger]["member"]) == {stays.index}


def test_the_start_is_taken_as_given(silo):
    with silo.ensemble() as ensemble:
        assert identical(ensemble.packing(silo.admit(ensemble)), silo.start)


def test_grains_may_have_left_before_the_start(silo):
    state, _ = silo.discharge(BEATS)
    assert len(state) < len(silo.start)
    with silo.ensemble() as ensemble:
        member = silo.admit(ensemble, state)
        ensemble.advance(2)
        assert set(ensemble.packing(member).ids) <= set(state.ids)
        crossed = ensemble.drain()[silo.crossing]["id"]
        assert set(crossed) <= set(state.ids)
