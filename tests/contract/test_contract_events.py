"""How members end: settled, emptied, or stopped by a guard; and what a backend refuses."""

import numpy as np
import pytest
from platforms import identical, specialised

from labbook.backend import Emptied, Failed, Settled, Unsupported
from labbook.backend.probes import Ledger
from labbook.checks.verify.platform import grains_at
from labbook.checks.verify.symmetry import DT, hopper
from labbook.scene import LinearSpringDashpot, Plane, Primitives, SurfaceMotion, Wall
from labbook.scene.packing import Packing


def happened(events, kind):
    return [event for event in events if isinstance(event, kind)]


@pytest.mark.parametrize("needed", [1, 4])
def test_settled_comes_once_after_the_asked_beats(silo, needed):
    with silo.ensemble() as ensemble:
        member = silo.admit(ensemble, settled_below=1e9, settled_beats=needed)
        restless = silo.admit(ensemble, settled_below=1e-30)
        silo.admit(ensemble)
        events = [(beat, event) for beat in range(1, 8) for event in ensemble.advance(1)]
        assert [(beat, event.member) for beat, event in events] == [(needed, member)]
        (event,) = happened([event for _, event in events], Settled)
        assert event.time == pytest.approx(needed * silo.numerics().beat, rel=1e-12)
        assert ensemble.status(restless).step == ensemble.status(member).step


def test_settled_grains_hardly_move(silo):
    closed = hopper().close()
    below = 1e-6
    with silo.ensemble(scene=closed, probes=(Ledger(),)) as ensemble:
        start = Packing(x=silo.start.x, v=silo.start.v, omega=silo.start.omega)
        member = ensemble.admit(closed, silo.numerics(dt=DT / 2), start, settled_below=below)
        for _ in range(800):
            if happened(ensemble.advance(1), Settled):
                break
        else:
            pytest.fail("the packing has not settled in 2.5 s")
        rows = ensemble.drain()[silo.ledger]
        unit = closed.grains.mass * closed.gravity * closed.grains.diameter * closed.grains.count
        kinetic = rows["kinetic"] / unit
        assert np.all(kinetic[-3:] < below)
        assert kinetic[-4] >= below
        assert ensemble.status(member).kinetic < below


def test_emptied_comes_once_and_the_member_rests(silo):
    falling = grains_at([[-6e-3, 0, 0], [-2e-3, 0, 0], [-6e-3, 0, 4e-3]])
    with silo.ensemble() as ensemble:
        scene = silo.scene.model_copy(update={"grains": silo.scene.grains.model_copy(update={"count": 3})})
        member = ensemble.admit(scene, silo.numerics(), falling)
        stays = silo.admit(ensemble)
        events = [event for _ in range(30) for event in ensemble.advance(1)]
        (event,) = happened(events, Emptied)
        assert event.member == member
        status = ensemble.status(member)
        assert status.grains == len(ensemble.packing(member)) == 0
        assert status.step < ensemble.status(stays).step
        rows = ensemble.drain()[silo.crossing]
        assert sorted(rows["id"][rows["member"] == member.index]) == [0, 1, 2]


def with_changed(packing: Packing, grain: int, **vectors) -> Packing:
    arrays = {"x": packing.x.copy(), "v": packing.v.copy(), "omega": packing.omega.copy()}
    for name, vector in vectors.items():
        arrays[name][grain] = vector
    return Packing(**arrays)


def failures(silo, start=None, beats=6, numerics=None):
    """Fail a member beside a sound one: its one event, its state and status, and the state it must have."""
    numerics = numerics or silo.numerics()
    with silo.ensemble(numerics=numerics) as ensemble:
        bad = ensemble.admit(silo.scene, numerics, start or silo.start)
        sound = silo.admit(ensemble)
        good = [ensemble.packing(bad)]
        events = []
        for _ in range(beats):
            events += ensemble.advance(1)
            good.append(ensemble.packing(bad))
        (event,) = events
        assert isinstance(event, Failed)
        assert event.member == bad
        status, state = ensemble.status(bad), ensemble.packing(bad)
        assert ensemble.status(sound).step == beats * numerics.steps_per_beat
        assert status.step % numerics.steps_per_beat == 0
        assert status.step <= event.step <= status.step + numerics.steps_per_beat
        assert identical(state, good[status.step // numerics.steps_per_beat])
        alone, _ = silo.discharge(beats)
        assert identical(ensemble.packing(sound), alone)
        assert f"grain {event.grain}" in event.message
        return event, status, state


def test_a_state_that_is_no_number_is_caught_and_named(silo):
    """Of two grains in the same place, neither has a direction to be pushed in: 0/0."""
    other = int(np.argmax(silo.start.x[:, 2]))
    start = with_changed(silo.start, 5, x=silo.start.x[other], v=silo.start.v[other])
    numerics = silo.numerics(overlap_limit=1.0)
    with silo.ensemble(numerics=numerics) as ensemble:
        bad = ensemble.admit(silo.scene, numerics, start)
        sound = silo.admit(ensemble)
        (event,) = ensemble.advance(2)
        assert isinstance(event, Failed)
        # a whole diameter, rounded to single, may be beyond the largest limit there is: then that guard comes first
        guards = ("state", "overlap") if numerics.precision == "mixed" else ("state",)
        assert event.member == bad
        assert event.guard in guards
        assert ensemble.status(bad).step == 0 <= event.step <= numerics.steps_per_beat
        assert ensemble.status(sound).step == 2 * numerics.steps_per_beat
        kept = ensemble.packing(bad)
        assert np.array_equal(kept.v, start.v[kept.ids])
        assert np.array_equal(kept.x, start.x[kept.ids])
        assert np.isfinite(ensemble.status(bad).kinetic)
    # one step is enough for it to reach those that it touches
    apart = np.linalg.norm(start.x - start.x[5], axis=1)
    assert event.grain in np.flatnonzero(apart < 1.01 * silo.scene.grains.diameter)
    assert f"grain {event.grain}" in event.message


@pytest.mark.parametrize("component", ["x", "v", "omega"])
def test_nothing_starts_from_what_is_no_number(silo, component):
    with pytest.raises(ValueError, match=f"{component} is not finite in row 17"):
        with_changed(silo.start, 17, **{component: [0, np.nan, 0]})


def test_nothing_starts_from_no_grains(silo):
    none = np.zeros((0, 3))
    with silo.ensemble() as ensemble, pytest.raises(ValueError, match="packing: it has no grains"):
        ensemble.admit(silo.scene, silo.numerics(), Packing(x=none, v=none, omega=none))


def test_a_grain_that_runs_away_is_caught_and_named(silo):
    start = with_changed(silo.start, 23, x=[0.0, 0.0, 0.2], v=[0, 0, -3.0])
    event, status, state = failures(silo, start, numerics=silo.numerics(speed_limit=3.01))
    assert (event.guard, event.grain) == ("speed", 23)
    expected = 0.01 / silo.scene.gravity / DT
    assert event.step == pytest.approx(expected, abs=2)
    assert np.linalg.norm(state.v, axis=1).max() <= 3.01
    assert status.step <= event.step


def test_grains_that_overlap_too_far_are_caught_and_named(silo):
    other = int(np.argmax(silo.start.x[:, 2]))
    beside = silo.start.x[other] + [0, 0, 0.6 * silo.scene.grains.diameter]
    event, status, _ = failures(silo, with_changed(silo.start, 5, x=beside, v=silo.start.v[other]))
    assert event.guard == "overlap"
    assert event.grain in (5, other)
    assert status.step == 0


def test_a_time_step_far_too_large_does_not_pass_unseen(silo):
    with silo.ensemble() as ensemble:
        member = ensemble.admit(silo.scene, silo.numerics(dt=100 * DT), silo.start)
        events = ensemble.advance(4)
        (event,) = events
        assert isinstance(event, Failed)
        assert event.guard in ("state", "speed", "overlap")
        assert 0 <= event.grain < len(silo.start)
        assert np.all(np.isfinite(ensemble.packing(member).x))
        assert not ensemble.advance(3)


def test_grains_that_left_are_dropped(silo):
    with silo.ensemble() as ensemble:
        member = silo.admit(ensemble)
        ensemble.advance(40)
        status, packing = ensemble.status(member), ensemble.packing(member)
        rows = ensemble.drain()
    assert status.grains == len(packing) < len(silo.start)
    assert np.all(np.diff(rows[silo.ledger]["grains"]) <= 0)
    assert np.all(packing.x[:, 2] > -10 * silo.scene.grains.diameter)
    assert np.all(np.isin(np.setdiff1d(np.arange(len(silo.start)), packing.ids), rows[silo.crossing]["id"]))
    assert np.all(packing.pairs < len(packing))
    assert np.all(packing.wall_grain < len(packing))


# what is refused


def changed(scene, part, **values):
    return scene.model_copy(update={part: getattr(scene, part).model_copy(update=values)})


def test_a_law_or_shape_that_it_lacks_is_refused_by_key(silo):
    backend, numerics = silo.platform.backend, silo.numerics()
    for part, name in (("contact", "law"), ("grains", "shape")):
        with pytest.raises(Unsupported, match="no-such") as refused:
            backend.specialise(changed(silo.scene, part, **{name: "no-such"}), numerics)
        assert refused.value.key == f"{part}.{name}"
        assert refused.value.remedy


def test_a_wall_that_it_lacks_is_refused(silo):
    shape = Plane(point=(0, 0, 0), normal=(0, 0, 1)).model_copy(update={"kind": "no-such"})
    wall = Wall.model_construct(name="odd", shape=shape, motion=SurfaceMotion())
    scene = silo.scene.model_copy(update={"container": Primitives().model_copy(update={"parts": (wall,)})})
    with pytest.raises(Unsupported, match="no-such"):
        silo.platform.backend.specialise(scene, silo.numerics())


def test_a_precision_that_it_lacks_is_refused(silo):
    backend = silo.platform.backend
    numerics = silo.numerics().model_copy(update={"precision": "no-such"})
    with pytest.raises(Unsupported, match="no-such"):
        backend.specialise(silo.scene, numerics)
    for precision in {"double", "mixed"} - backend.capabilities.precisions:
        with pytest.raises(Unsupported, match=precision):
            backend.specialise(silo.scene, silo.numerics().model_copy(update={"precision": precision}))


def test_a_device_that_is_not_there_is_an_error(silo):
    backend = silo.platform.backend
    spec = backend.specialise(silo.scene, silo.numerics())
    with pytest.raises(Unsupported, match="no-such-device") as refused:
        backend.open(spec, device="no-such-device")
    assert refused.value.key == "device"


def test_a_member_that_needs_what_the_spec_has_not_is_refused(silo):
    linear = LinearSpringDashpot(normal_stiffness=1e4, friction=0.5, restitution=0.5)
    other = silo.scene.model_copy(update={"contact": linear})
    assert other.contact.law != silo.scene.contact.law
    with (
        silo.ensemble(platform=specialised(silo.platform)) as ensemble,
        pytest.raises(ValueError, match="kernels that"),
    ):
        ensemble.admit(other, silo.numerics(), silo.start)


def test_values_are_no_part_of_the_spec(silo):
    backend = silo.platform.backend
    spec = backend.specialise(silo.scene, silo.numerics())
    other = changed(changed(silo.scene, "grains", diameter=1e-3), "contact", friction=0.1, restitution=0.9)
    assert backend.specialise(other.model_copy(update={"gravity": 1.0}), silo.numerics(dt=1e-7)) == spec
    assert hash(backend.specialise(silo.scene, silo.numerics())) == hash(spec)
    assert backend.specialise(silo.scene, silo.numerics(), [Ledger()]) != spec
    assert spec.backend == backend.capabilities.name


def test_capabilities_are_data(silo):
    can = silo.platform.backend.capabilities
    assert isinstance(can.cache_version, int)
    assert can.shapes
    assert can.laws
    assert can.walls
    assert "double" in can.precisions
    assert can.devices


def test_the_description_has_numbers_for_the_catalogue(silo):
    told = silo.platform.backend.describe(silo.scene, silo.numerics())
    assert told["restitution_asked"] == silo.scene.contact.restitution
    assert 0 < told["restitution_realised"] < 1
    assert told["damping_coefficient"] > 0
