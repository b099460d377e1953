"""Grains that left are put back into a member: they fall, pass the outlet again, and change nothing else."""

import numpy as np
import pytest
from platforms import identical

from labbook.backend import Member
from labbook.backend.probes import Crossing, Ledger
from labbook.checks.verify.mixture import graded_hopper
from labbook.checks.verify.platform import rows_of
from labbook.checks.verify.symmetry import DT
from labbook.filling import Feeder, Refill, place, refill, start_of_discharge
from labbook.scene import BedTop, CylinderSilo, Feed, LinearSpringDashpot, Packing, Scene, Spherocylinders

BEATS = 24
MOTION = ("x", "v", "omega")
FED = Feed(kind="reinject")
PROBES = CROSSING, LEDGER = Crossing(), Ledger()


def feeder(silo) -> Feeder:
    return Feeder(silo.scene.model_copy(update={"feed": FED}), silo.start, "gas", 1)


def go_on(ensemble, member, fed: Feeder, beats) -> list[int]:
    """Take these beats, with grains put back after each; how many were, beat by beat."""
    many = []
    for beat in beats:
        ensemble.advance(1)
        top = ensemble.tops({member: fed.floor})[member]
        check_top(ensemble.packing(member), top, fed.floor)
        back = refill([Refill(fed, top, beat)])[0]
        if back is not None:
            ensemble.put_back(member, back)
        many.append(0 if back is None else len(back))
    return many


@pytest.fixture(scope="module")
def alone(silo):
    """End, rows and grains put back of a member that is fed."""
    with silo.ensemble() as ensemble:
        member = silo.admit(ensemble)
        many = go_on(ensemble, member, feeder(silo), range(1, BEATS + 1))
        rows = {probe: rows_of(table, member) for probe, table in ensemble.drain().items()}
        return ensemble.packing(member), rows, many


def test_no_grain_is_lost(silo, alone):
    state, rows, many = alone
    count = len(silo.start)
    assert sum(many) > 10, "else nothing was tested"
    assert np.array_equal(np.sort(state.ids), np.arange(count))
    assert set(rows[LEDGER]["grains"]) <= set(range(count - max(many) - 1, count + 1))
    assert len(rows[CROSSING]["id"]) >= sum(many)


@pytest.mark.parametrize("at", [7, 15])
def test_fed_it_continues_from_a_checkpoint_bit_for_bit(silo, alone, at):
    state, rows, many = alone
    with silo.ensemble() as ensemble:
        member = silo.admit(ensemble)
        first = go_on(ensemble, member, feeder(silo), range(1, at + 1))
        checkpoint, before = ensemble.checkpoint(member), rows_of(ensemble.drain()[CROSSING], member)
    with silo.ensemble() as ensemble:
        silo.admit(ensemble)  # another slot, and a neighbour that is not fed
        member = silo.admit(ensemble, checkpoint)
        rest = go_on(ensemble, member, feeder(silo), range(at + 1, BEATS + 1))
        after = rows_of(ensemble.drain()[CROSSING], member)
        assert identical(ensemble.packing(member), state)
    assert first + rest == many
    joined = {name: np.concatenate([before[name], after[name]]) for name in after}
    assert identical(joined, rows[CROSSING])


def test_a_grain_that_came_back_can_be_pushed(silo):
    """It is the one that is there, not the one that left. Its velocity is set half a step before: g dt more or less."""
    v = np.array([0.02, 0.01, 0.3])
    with silo.ensemble() as ensemble:
        fed = silo.admit(ensemble)
        ensemble.advance(12)
        away = np.setdiff1d(silo.start.ids, ensemble.packing(fed).ids)[:2]
        x = np.array([[0.0, 0.0, 0.12], [-8e-3, 0.0, 0.12]])
        ensemble.put_back(fed, Packing(x=x, v=np.zeros((2, 3)), omega=np.zeros((2, 3)), ids=away))
        ensemble.set_velocities(fed, away, np.array([v, v]))
        now = ensemble.packing(fed)
        assert np.allclose(now.v[now.rows(away)], v, rtol=1e-6, atol=silo.scene.gravity * silo.numerics().dt)


def test_a_grain_that_is_put_back_falls_and_the_others_do_not_know(silo):
    """The leapfrog is exact in free fall; a grain far above changes no bit of the others in the silo.

    Those that have left may still touch one that is dropped when lists are made again: earlier, since this one is fast.
    """
    g, v = silo.scene.gravity, np.array([0.02, 0.0, 0.3])
    with silo.ensemble() as ensemble:
        fed, other = silo.admit(ensemble), silo.admit(ensemble)
        ensemble.advance(12)
        away = np.setdiff1d(silo.start.ids, ensemble.packing(fed).ids)[:2]
        assert len(away) == 2
        x = np.array([[0.0, 0.0, 0.12], [-8e-3, 0.0, 0.12]])
        own = Packing(x=x, v=np.array([v, -v]), omega=np.array([[0.0, 5.0, 0.0]] * 2), ids=away)
        ensemble.put_back(fed, own)
        now, alone = ensemble.packing(fed), ensemble.packing(other)
        common = np.setdiff1d(now.ids, away)
        a, b = now.rows(common), alone.rows(common)
        assert all(np.array_equal(getattr(now, name)[a], getattr(alone, name)[b]) for name in MOTION)
        mine = now.rows(away)
        assert np.allclose(now.x[mine], x, rtol=0, atol=1e-15)
        assert np.allclose(now.v[mine], own.v, rtol=8 * silo.rounding, atol=0)
        ensemble.advance(3)
        now, alone = ensemble.packing(fed), ensemble.packing(other)
        t, mine = 3 * silo.numerics().beat, now.rows(away)
        fallen = x + own.v * t - np.array([0, 0, g * t**2 / 2])
        assert np.allclose(now.x[mine], fallen, rtol=0, atol=200 * silo.rounding * t)
        assert np.allclose(now.v[mine, 2], own.v[:, 2] - g * t, rtol=200 * silo.rounding)
        assert np.allclose(now.omega[mine], own.omega, rtol=8 * silo.rounding)
        inside = np.setdiff1d(alone.ids[alone.x[:, 2] > 0], away)
        assert len(inside) > len(silo.start) / 2
        a, b = now.rows(inside), alone.rows(inside)
        if silo.platform.precision == "double":
            assert all(np.array_equal(getattr(now, n)[a], getattr(alone, n)[b]) for n in MOTION)
        else:  # in single precision a law may round by where in a register a contact stands, which lists decide
            assert np.allclose(now.x[a], alone.x[b], rtol=0, atol=1e-3 * silo.scene.grains.diameter)


def test_grains_that_were_not_there_at_the_start_join_it(silo):
    """As if they had been there: half of the grains start, and the others join them before the first step."""
    every = silo.start.subset(np.arange(len(silo.start)))
    first = np.arange(len(every)) % 2 == 0
    with silo.ensemble() as ensemble:
        whole, joined = silo.admit(ensemble, every), silo.admit(ensemble, every.subset(first))
        ensemble.put_back(joined, every.subset(~first))
        ensemble.advance(1)
        a, b = ensemble.packing(whole), ensemble.packing(joined)
        assert np.array_equal(np.sort(a.ids), np.sort(b.ids))
        close = 1e-3 * silo.scene.grains.diameter  # contacts may be summed in another order
        assert np.allclose(b.x[b.rows(a.ids)], a.x, rtol=0, atol=close)
        state = ensemble.checkpoint(joined)
        ensemble.advance(2)
        later = ensemble.packing(joined)
    with silo.ensemble() as ensemble:
        again = silo.admit(ensemble, state)
        ensemble.advance(2)
        assert identical(ensemble.packing(again), later)


def test_put_back_together_members_have_the_bits_of_one_after_another(silo):
    ends = []
    for together in (True, False):
        with silo.ensemble() as ensemble:
            members = [silo.admit(ensemble) for _ in range(3)]
            ensemble.advance(12)
            away = np.setdiff1d(silo.start.ids, ensemble.packing(members[0]).ids)
            assert len(away) > 1
            back = dict[Member, Packing]()
            for n, member in enumerate(members[:2], 1):
                x, still = np.array([[6e-3 * k, 0.0, 0.12] for k in range(n)]), np.zeros((n, 3))
                back[member] = Packing(x=x, v=still, omega=still, ids=away[:n])
            if together:
                ensemble.put_back_all(back)
            else:
                for member, grains in back.items():
                    ensemble.put_back(member, grains)
            ensemble.advance(3)
            ends.append([ensemble.packing(member) for member in members])
    for one, other in zip(*ends, strict=True):
        assert identical(one, other)
    assert len({len(end) for end in ends[0]}) == 3, "each has other grains"


def check_top(bed: Packing, top: BedTop, height: float) -> None:
    """Compare what is read of a bed's top with its packing, whatever the order of grains."""
    expected = BedTop.of(bed, height)
    first, second = np.argsort(expected.ids), np.argsort(top.ids)
    assert np.array_equal(np.sort(top.present), np.sort(expected.present))
    assert np.array_equal(top.ids[second], expected.ids[first])
    assert np.array_equal(top.x[second], expected.x[first])
    assert (top.q is None) == (expected.q is None)
    assert top.q is None or (expected.q is not None and np.array_equal(top.q[second], expected.q[first]))


def test_the_top_of_a_bed_has_the_grains_of_its_packing(silo):
    """Of several beds, each with a height of its own, before and after a grain returns to one of them."""
    with silo.ensemble() as ensemble:
        members = [silo.admit(ensemble) for _ in range(3)]
        ensemble.advance(12)
        beds = [ensemble.packing(member) for member in members]
        middle = float(np.median(beds[0].x[:, 2]))
        heights = dict(zip(members, (middle, -np.inf, np.inf), strict=True))
        for member, bed in zip(members, beds, strict=True):
            check_top(bed, ensemble.tops(heights)[member], heights[member])
        x, away = np.array([[0.0, 0.0, 0.12]]), np.setdiff1d(silo.start.ids, beds[0].ids)[:1]
        ensemble.put_back(members[0], Packing(x=x, v=0 * x, omega=0 * x, ids=away))
        top = ensemble.tops(heights)[members[0]]
        check_top(ensemble.packing(members[0]), top, middle)
        assert np.isin(away, top.ids).all()


def test_what_is_read_after_it_is_not_what_was_read_before(silo):
    """A backend may keep what it has read until its member changes."""
    found = []
    for early in (True, False):
        with silo.ensemble() as ensemble:
            members = [silo.admit(ensemble) for _ in range(2)]
            ensemble.advance(12)
            if early:
                _ = [(ensemble.status(member), ensemble.packing(member)) for member in members]
            away = np.setdiff1d(silo.start.ids, ensemble.packing(members[0]).ids)[:1]
            x, v = np.array([[-0.2, 0.0, 2e-3]]), np.array([[0.0, 0.0, -3.0]])
            ensemble.put_back(members[0], Packing(x=x, v=v, omega=0 * x, ids=away))
            found.append([(ensemble.status(member), ensemble.packing(member)) for member in reversed(members)])
    for (status, state), (fresh, other) in zip(*found, strict=True):
        assert status == fresh
        assert identical(state, other)
    (other, _), (fed, _) = found[0]
    assert fed.grains == other.grains + 1
    assert fed.kinetic > 2 * other.kinetic


def test_it_passes_the_outlet_again(silo):
    with silo.ensemble() as ensemble:
        member = silo.admit(ensemble)
        ensemble.advance(12)
        first = rows_of(ensemble.drain()[CROSSING], member)
        away = np.setdiff1d(silo.start.ids, ensemble.packing(member).ids)[:1]
        x = np.array([[-0.2, 0.0, 2e-3]])  # beside the hopper
        ensemble.put_back(member, Packing(x=x, v=0 * x, omega=0 * x, ids=away))
        ensemble.advance(8)
        again = rows_of(ensemble.drain()[CROSSING], member)
        start = 12 * silo.numerics().beat
        (row,) = np.flatnonzero(again["id"] == away[0])
        assert away[0] in first["id"]
        assert again["time"][row] - start == pytest.approx(np.sqrt(2 * 2e-3 / silo.scene.gravity), abs=DT)
        assert away[0] not in ensemble.packing(member).ids


def test_grains_that_have_not_left_are_refused(silo):
    with silo.ensemble() as ensemble:
        member = silo.admit(ensemble)
        ensemble.advance(12)
        before = ensemble.packing(member)
        away = np.setdiff1d(silo.start.ids, before.ids)
        x = np.zeros((1, 3))
        for ids in ([before.ids[0]], [len(silo.start)], [-1]):
            with pytest.raises(ValueError, match="put_back"):
                ensemble.put_back(member, Packing(x=x, v=x, omega=x, ids=np.array(ids)))
        two = np.zeros((2, 3))
        with pytest.raises(ValueError, match="put_back"):
            ensemble.put_back(member, Packing(x=two, v=two, omega=two, ids=away[[0, 0]]))
        assert identical(ensemble.packing(member), before)


def rods() -> Scene:
    grains = Spherocylinders(diameter=6e-3, length=20e-3, density=620, count=20)
    law = LinearSpringDashpot(normal_stiffness=200.0, friction=0.5, rolling_friction=0.01, restitution=0.5)
    silo = CylinderSilo(diameter=60e-3, height=0.5, orifice=50e-3, rotation=1.0)
    return Scene(grains=grains, contact=law, container=silo, gravity=9.81, feed=FED)


@pytest.mark.parametrize(
    ("scene", "dt"),
    [
        pytest.param(graded_hopper(80), 1e-5, id="mixture"),
        pytest.param(rods(), 1e-5, id="rods", marks=pytest.mark.ring),  # kernels that no other test needs
    ],
)
def test_grains_come_back_as_what_they_were(platform, scene, dt):
    """Grains of many sizes and kinds, and rods: none overlaps another or a wall where it is put."""
    if platform.second:
        pytest.skip("one precision of a backend is enough")
    scene, numerics = scene.model_copy(update={"feed": FED}), platform.numerics(dt, steps_per_beat=500)
    closed = scene.close()
    start = start_of_discharge(place(closed, "gas", 1), closed, scene)
    fed = Feeder(scene, start, "gas", 1)
    ensemble = platform.backend.open(platform.backend.specialise(scene, numerics, PROBES), 1, platform.device)
    try:
        member = ensemble.admit(scene, numerics, start)
        many = go_on(ensemble, member, fed, range(1, 30))
        end = ensemble.packing(member)
        rows = ensemble.drain()[LEDGER]
    finally:
        ensemble.close()
    assert sum(many) > 3
    everyone = np.arange(len(start))
    order, first = end.rows(everyone[np.isin(everyone, end.ids)]), start.rows(everyone[np.isin(everyone, end.ids)])
    for name in ("diameter", "kind"):
        own, was = getattr(end, name), getattr(start, name)
        assert (own is None) == (was is None)
        assert own is None or np.allclose(own[order], was[first], rtol=1e-12)
    if end.q is not None:
        assert np.allclose(np.linalg.norm(end.q, axis=1), 1)
    assert rows["max_overlap"].max() < 0.1 * scene.grains.diameter
