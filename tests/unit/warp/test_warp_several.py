"""The GPU backend takes several steps in one launch where grains are few."""

import pickle
from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest
from platforms import identical

pytest.importorskip("warp")

import warp as wp
from labbook_warp import arrays, stage
from labbook_warp.beat import Beat
from rods_in_silo import DENSITY, PRECISIONS, D, numerics, silo
from rods_on_warp import run, sharing

from labbook.backend import Failed
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Crossing, Film, Ledger, Sample, Slab, Zone
from labbook.filling.opening import start_of_discharge
from labbook.filling.placing import place
from labbook.scene import HertzMindlin, Scene, Spheres
from labbook.scene.packing import Packing

pytestmark = pytest.mark.compiles

GPU = "cuda:0"
SHAPES = ["rods", "spheres"]


def of_spheres(grains: int) -> Scene:
    """The silo, with spheres in it."""
    spheres = Spheres(diameter=D, density=DENSITY, count=grains)
    law = HertzMindlin(shear_modulus=2e6, poisson_ratio=0.25, friction=0.5, rolling_friction=0.01, restitution=0.5)
    return silo(1).model_copy(update={"grains": spheres, "contact": law})


def falling(scene: Scene, how: Numerics, device: str) -> Packing:
    """A bed that has not yet come to rest, opened."""
    closed = scene.close()
    bed, _ = run(closed, how, place(closed, "gas", 1), 150, device=device)
    return start_of_discharge(bed, closed, scene)


class End(NamedTuple):
    """What has become of some members."""

    packings: Sequence[Packing]
    crossed: dict
    failures: Sequence[tuple[str, int, int]]


def together(members: Sequence[tuple[Scene, Packing]], how: Numerics, lanes: int, device: str, beats: int) -> End:
    """Members side by side; after a while one more that fails."""
    backend, (scene, start) = sharing(device, lanes), members[0]
    ensemble = backend.open(backend.specialise(scene, how, [Crossing()]), len(members) + 1, device)
    admitted = [ensemble.admit(each, how, packing) for each, packing in members]
    events = list(ensemble.advance(beats // 2))
    ensemble.admit(scene, how.model_copy(update={"overlap_limit": 1e-4}), start)
    events += [event for _ in range(beats // 2) for event in ensemble.advance(1)]
    failures = [(event.guard, event.step, event.member.index) for event in events if isinstance(event, Failed)]
    end = End([ensemble.packing(member) for member in admitted], dict(ensemble.drain()[Crossing()]), failures)
    ensemble.close()
    return end


def test_members_that_are_read_together_give_the_rows_that_each_gives_alone(monkeypatch):
    scene, how = of_spheres(60), numerics("mixed")
    starts = [falling(scene, how, "cpu"), falling(scene, how.model_copy(update={"skin": 0.2}), "cpu")]
    inside = (Slab(low=-0.02, high=0.03), Zone(0.02, -0.02, 0.02, 0.01, 0.05))
    probes = (Sample(fields=("x", "v", "omega")), *inside, Ledger(every=2))

    def rows() -> dict:
        backend = sharing()
        ensemble = backend.open(backend.specialise(scene, how, probes), 3, "cpu")
        for start in starts:
            ensemble.admit(scene, how, start)
        ensemble.advance(3)
        found = ensemble.drain()
        ensemble.close()
        return dict(found)

    copies, fetch = [], arrays.fetch
    monkeypatch.setattr(arrays, "fetch", lambda *given: copies.append(given) or fetch(*given))
    together = rows()
    few = len(copies)
    monkeypatch.setattr(arrays, "SEVERAL", 10**9)
    alone = rows()
    assert len(copies) - few > few > 0
    for probe in probes:
        assert len(together[probe]["step"])
        assert together[probe].keys() == alone[probe].keys()
        assert all(np.array_equal(together[probe][name], alone[probe][name]) for name in alone[probe])


@pytest.mark.parametrize("scene", [pytest.param(silo(20), marks=pytest.mark.ring), of_spheres(60)], ids=SHAPES)
def test_members_that_are_seated_together_are_as_those_seated_one_by_one(scene, monkeypatch):
    """From packings with springs and from checkpoints, into slots beside others and into larger arrays."""
    how = numerics("mixed")
    starts = [falling(scene, how, "cpu"), falling(scene, how.model_copy(update={"skin": 0.2}), "cpu")]
    assert all(len(start.pairs) and len(start.wall_grain) for start in starts)
    ends = []
    for several in (2, 10**9):
        monkeypatch.setattr(arrays, "SEVERAL", several)
        backend = sharing()
        ensemble = backend.open(backend.specialise(scene, how, [Crossing()]), 1, "cpu")
        members = [ensemble.admit(scene, how, start) for start in starts]
        ensemble.advance(1)
        ensemble.retire(members.pop(0))
        goes_on = ensemble.checkpoint(members[0])
        members += [ensemble.admit(scene, how, start) for start in (starts[1], goes_on, starts[0])]
        ensemble.advance(2)
        ends.append([ensemble.packing(member) for member in members])
        ensemble.close()
    assert all(identical(*both) for both in zip(*ends, strict=True))


@pytest.mark.parametrize("scene", [silo(20), of_spheres(60)], ids=SHAPES)
def test_members_that_end_together_are_read_in_one_copy_of_each_array(scene, monkeypatch):
    how, copies = numerics("mixed"), []
    start = falling(scene, how, "cpu")
    backend = sharing()
    ensemble = backend.open(backend.specialise(scene, how, [Crossing()]), 6, "cpu")
    members = [ensemble.admit(scene, how, start) for _ in range(6)]
    ensemble.advance(1)

    def read(chosen: list) -> list:
        return [(ensemble.packing(member), ensemble.checkpoint(member)) for member in chosen]

    alone = read(members)
    fetch = arrays.fetch
    monkeypatch.setattr(arrays, "fetch", lambda *given: copies.append(given) or fetch(*given))
    counts = []
    for chosen in ([0, 1, 4], [0, 1, 2, 4, 5]):  # some slots are put together on the device, most are copied as a whole
        copies.clear()
        with ensemble.reading([members[k] for k in chosen]):
            together = read([members[k] for k in chosen])
            ends = pickle.loads(pickle.dumps([ensemble.end_state(members[k]) for k in chosen]))
        assert not any("_packing" in vars(end) for end in ends), "it is worked out where it is needed"
        together += [(end.packing, end.checkpoint) for end in ends]
        counts.append(len(copies))
        for k, (packing, checkpoint) in zip([*chosen, *chosen], together, strict=True):
            assert identical(packing, alone[k][0])
            assert {name: np.asarray(array).tobytes() for name, array in checkpoint.arrays.items()} == {
                name: np.asarray(array).tobytes() for name, array in alone[k][1].arrays.items()
            }
    assert counts[0] == counts[1] < 30, "as many copies for five as for three"
    ensemble.close()


def test_grains_come_back_into_several_members_with_the_copies_of_one(monkeypatch):
    scene, how, copies = of_spheres(60), numerics("mixed"), []
    whole = falling(scene, how, "cpu")
    assert whole.ids is not None
    start = Packing(x=whole.x[:57], v=whole.v[:57], omega=whole.omega[:57], ids=whole.ids[:57])
    back = Packing(x=whole.x[57:] + np.array([0, 0, 0.1]), v=whole.v[57:], omega=whole.omega[57:], ids=whole.ids[57:])
    backend = sharing()
    ensemble = backend.open(backend.specialise(scene, how, [Crossing()]), 6, "cpu")
    members = [ensemble.admit(scene, how, start) for _ in range(6)]
    ensemble.advance(1)
    copy = arrays.wp.copy
    counted = {**vars(arrays.wp), "copy": lambda *given: copies.append(given) or copy(*given)}
    monkeypatch.setattr(arrays, "wp", SimpleNamespace(**counted))
    counts = []
    for several in (members[:1], members[1:5]):
        copies.clear()
        ensemble.put_back_all(dict.fromkeys(several, back))
        counts.append(len(copies))
    assert counts[1] <= counts[0] + 20, (
        "arrays are copied once, whatever the number of members; read ones are put together"
    )
    ensemble.advance(2)
    ends = [ensemble.packing(member) for member in members]
    assert [len(end) for end in ends] == [60] * 5 + [57]
    assert all(identical(end, ends[0]) for end in ends[1:5])
    ensemble.close()


def test_grains_that_get_free_rows_move_as_after_rows_were_closed_up(monkeypatch):
    """The quick way to put grains back, the one that moves all of the state, and the quick one after which springs
    found no room in their lists, leave the same bits."""
    scene, how = of_spheres(60), numerics("mixed")
    whole, backend, ends = falling(scene, how, "cpu"), sharing(), []
    assert whole.ids is not None
    start = Packing(x=whole.x[:57], v=whole.v[:57], omega=whole.omega[:57], ids=whole.ids[:57])
    back = Packing(x=whole.x[57:] + np.array([0, 0, 0.1]), v=whole.v[57:], omega=whole.omega[57:], ids=whole.ids[57:])
    closed_up, calls = stage.Stage._close_up_with, []
    monkeypatch.setattr(stage.Stage, "_close_up_with", lambda *given: calls.append(given) or closed_up(*given))
    append, lists = stage.Stage._append, stage.Stage._lists

    def without_room(self, runs) -> tuple[int, int, int]:
        lists(self, runs)
        self.arrays.system.spring.zero_()
        self.arrays.system.held.zero_()
        return 1, 0, 0

    def given_up(self, returning) -> bool:
        with monkeypatch.context() as short:
            short.setattr(stage.Stage, "_lists", without_room)
            return append(self, returning)

    for quick, way in ((True, append), (False, lambda *_: False), (False, given_up)):
        calls.clear()
        monkeypatch.setattr(stage.Stage, "_append", way)
        ensemble = backend.open(backend.specialise(scene, how, [Crossing()]), 2, "cpu")
        member = ensemble.admit(scene, how, start)
        ensemble.advance(1)
        ensemble.put_back(member, back)
        assert len(calls) == (not quick)
        ensemble.advance(2)
        ends.append((ensemble.packing(member), ensemble.checkpoint(member).arrays))
        ensemble.close()
    bits = [{name: np.asarray(array).tobytes() for name, array in state.items()} for _, state in ends]
    assert identical(ends[0][0], ends[1][0])
    assert identical(ends[0][0], ends[2][0])
    assert bits[0] == bits[1] == bits[2]


def test_grains_take_rows_of_those_that_left(monkeypatch):
    """A bed that loses many more grains than it has rows to spare keeps its rows. Its motion and the work of its
    contacts are those of a bed whose rows are closed up at each return."""
    scene, how, ends = of_spheres(60), numerics("mixed", dt=2e-5, steps_per_beat=100), []
    bed, backend, append = falling(scene, how, "cpu"), sharing(), stage.Stage._append
    start = Packing(x=bed.x, v=bed.v - [0, 0, 0.5], omega=bed.omega, ids=bed.ids)
    assert start.ids is not None
    for takes_rows in (True, False):
        monkeypatch.setattr(stage.Stage, "_append", append if takes_rows else lambda *_: False)
        probes = [Crossing(), Ledger(every=2)]
        ensemble = backend.open(backend.specialise(scene, how, probes), 2, "cpu")
        members = [ensemble.admit(scene, how, start) for _ in range(2)]
        returned, rows = 0, []
        for beat in range(60):
            assert not ensemble.advance(1)
            present = ensemble.tops({members[0]: np.inf})[members[0]].present
            away = np.setdiff1d(start.ids, present)[:2]
            x = np.array([[0.016 * k - 0.008, 0.009 * (beat % 3 - 1), 0.1] for k in range(len(away))]).reshape(-1, 3)
            v = np.tile([0.0, 0.0, -1.5], (len(away), 1))
            ensemble.put_back_all({members[0]: Packing(x=x, v=v, omega=0 * x, ids=away)} if len(away) else {})
            returned += len(away)
            rows.append(ensemble._runs[members[0]].rows)
        ledger = ensemble.drain()[probes[1]]
        ends.append((*map(ensemble.packing, members), ledger["contact_work"]))
        assert returned > 25
        assert not takes_rows or max(rows) <= 64, "32 rows more than grains would be the next size"
        ensemble.close()
    (fed, other, work), (closed_up, same, same_work) = ends
    assert identical(fed, closed_up)
    assert identical(other, same)
    assert np.array_equal(work, same_work)


def test_members_that_come_together_are_written_in_one_copy_of_each_array(monkeypatch):
    """Slots that others have left are filled again; the state of those who stay is not touched."""
    scene, how = of_spheres(5), numerics("mixed")
    starts = [place(scene.close(), "gas", seed) for seed in range(1, 14)]
    copies, copy = [], arrays.wp.copy
    counted = SimpleNamespace(**{**vars(arrays.wp), "copy": lambda *given: copies.append(given) or copy(*given)})
    backend, counts, ends = sharing(), {}, {}
    for number, together in ((2, True), (4, True), (4, False)):
        ensemble = backend.open(backend.specialise(scene, how), 12, "cpu")
        members = [ensemble.admit(scene, how, start) for start in starts[:9]]
        ensemble.advance(1)
        for gone in members[2:6]:
            ensemble.retire(gone)
        later = []
        with monkeypatch.context() as patched:
            patched.setattr(arrays, "wp", counted)
            copies.clear()
            for start in starts[9 : 9 + number]:
                later.append(ensemble.admit(scene, how, start))
                if not together:
                    ensemble._stage.seat()
            ensemble._stage.seat()
        counts[number, together] = len(copies)
        ensemble.advance(1)
        ends[number, together] = [ensemble.packing(member) for member in (*members[:2], *members[6:], *later)]
        ensemble.close()
    assert all(map(identical, ends[4, True], ends[4, False]))
    assert counts[2, True] == counts[4, True] > 0, "however many come"


def test_graphs_are_captured_anew_where_the_material_may_be_another():
    """They hold it, if all members share one."""
    scene, how = of_spheres(5), numerics("mixed")
    start = place(scene.close(), "gas", 1)
    backend = sharing()
    ensemble = backend.open(backend.specialise(scene, how), 3, "cpu")
    members = [ensemble.admit(scene, how, start)]
    ensemble.advance(1)
    beats = ensemble._stage.beats
    beats._graphs[(0,)] = "of the first material"
    members.append(ensemble.admit(scene, how, start))
    ensemble.advance(1)
    assert beats is ensemble._stage.beats
    assert beats._graphs
    for member in members:
        ensemble.retire(member)
    ensemble.admit(scene, how.model_copy(update={"dt": how.dt / 2}), start)
    ensemble.advance(1)
    assert not ensemble._stage.beats._graphs
    ensemble.close()


def test_checks_that_became_frequent_become_less_frequent_again(monkeypatch):
    """A list that was late once must not slow all later steps down. When lists are checked decides no bit."""
    monkeypatch.setattr(stage, "CALM", 3)
    scene, how = of_spheres(60), numerics("mixed")
    start, ends, often = falling(scene, how, "cpu"), [], []
    for late in (False, True):
        backend = sharing()
        ensemble = backend.open(backend.specialise(scene, how, [Crossing()]), 1, "cpu")
        member = ensemble.admit(scene, how, start)
        ensemble.advance(1)
        at = ensemble._stage
        usual = at._interval
        if late:
            at.check_more_often()
        for _ in range(7):
            often.append(at._interval / usual)
            ensemble.advance(1)
        assert at._interval == usual
        ends.append(ensemble.packing(member))
        ensemble.close()
    assert identical(*ends)
    assert often[:7] == [1.0] * 7
    assert often[7] == often[9] < 0.5 < often[10] <= 1.0


@pytest.fixture
def a_gpu() -> str:
    """The first GPU, if there is one."""
    if not wp.get_cuda_device_count():
        pytest.skip("there is no CUDA device")
    return GPU


@pytest.mark.parametrize("device", ["cpu", pytest.param(GPU, marks=pytest.mark.gpu)])
def test_beats_that_are_taken_again_give_their_frames_once(device, monkeypatch, request):
    """And all others, with few graphs on a GPU: of two members whose frames lie at other steps of a beat."""
    if device == GPU:
        request.getfixturevalue("a_gpu")
    scene, how = of_spheres(60), numerics("mixed", steps_per_beat=249)
    start, film, collect, ends = falling(scene, how, device), Film(86.72 * how.dt), stage.collect, []
    for sometimes in (False, True):
        beats = iter(range(100))

        def late(*left_behind, beats=beats, sometimes=sometimes):
            report, beat = collect(*left_behind), next(beats)
            slots = [replace(slot, late=sometimes and beat % 3 == k) for k, slot in enumerate(report.slots)]
            return replace(report, slots=slots)

        monkeypatch.setattr(stage, "collect", late)
        monkeypatch.setattr(stage.Stage, "check_more_often", lambda _: None)
        backend = sharing(device)
        ensemble = backend.open(backend.specialise(scene, how, [Crossing(), film]), 3, device)
        members = [ensemble.admit(scene, how, start)]
        ensemble.advance(2)
        members.append(ensemble.admit(scene, how, start))
        ensemble.advance(9)
        tables = ensemble.drain()
        ends.append((tables[film], ensemble.packing(members[0])))
        taken = next(beats)
        for member, count in zip(members, (11, 9), strict=True):
            steps = np.unique(tables[film]["step"][tables[film]["member"] == member.index])
            assert list(steps) == [at for k in range(40) if (at := round(k * 86.72)) <= 249 * count]
        graphs = len(ensemble._stage.beats._graphs)
        assert 0 < graphs < 20 if device == GPU else not graphs
        ensemble.close()
        assert (taken > 11) == sometimes, "some beats were taken again"
    (frames, state), (again, other) = ends
    assert identical(state, other)
    order, others = (np.lexsort((one["id"], one["step"], one["member"])) for one in (frames, again))
    for name, column in frames.items():
        assert np.array_equal(column[order], again[name][others])


def test_a_device_that_fails_in_a_beat_is_named(monkeypatch):
    def fails(*_):
        raise RuntimeError("CUDA error 719")

    monkeypatch.setattr(stage, "collect", fails)
    scene = of_spheres(5)
    with pytest.raises(RuntimeError, match=r"cpu has failed in a beat \(CUDA error 719\).*Multi-Process Service"):
        run(scene, numerics("mixed"), place(scene, "gas", 1), 1)


@pytest.mark.gpu
@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize(
    ("few", "fewer", "lanes"),
    [(silo(300), silo(45), 4), (silo(300), silo(45), 8), *((of_spheres(500), of_spheres(97), n) for n in (2, 4, 8))],
    ids=["rods-4", "rods-8", "spheres-2", "spheres-4", "spheres-8"],
)
def test_steps_taken_in_one_launch_are_those_taken_one_by_one(few, fewer, lanes, precision, a_gpu, monkeypatch):
    """Bit for bit: of members of several sizes, in beats of an odd number of steps, some of which are taken again, and
    beside one that fails within a beat."""
    how = numerics(precision, steps_per_beat=249)
    members = [(scene, falling(scene, how, a_gpu)) for scene in (few, fewer)]
    fit, collect, ends = Beat.all_resident, stage.collect, []
    for allowed in (True, False):
        fitted, beats = [], iter(range(10_000))

        def all_resident(beat, allowed=allowed, fitted=fitted):
            fitted.append(fit(beat))
            return fitted[-1] and allowed

        def late(*left_behind, beats=beats):
            report, beat = collect(*left_behind), next(beats)
            slots = [replace(slot, late=beat % 3 == k) for k, slot in enumerate(report.slots)]
            return replace(report, slots=slots)

        monkeypatch.setattr(Beat, "all_resident", all_resident)
        monkeypatch.setattr(stage, "collect", late)
        monkeypatch.setattr(stage.Stage, "check_more_often", lambda _: None)
        ends.append(together(members, how, lanes, a_gpu, 80))
        assert all(fitted)
    one, other = ends
    assert all(identical(*both) for both in zip(one.packings, other.packings, strict=True))
    assert len(one.crossed["id"]) > 10
    assert all((one.crossed[name] == other.crossed[name]).all() for name in one.crossed)
    assert [guard for guard, _, _ in one.failures] == ["overlap"]
    assert one.failures[0][1:] == other.failures[0][1:]


@pytest.mark.gpu
def test_as_many_threads_as_fit_wait_for_one_another_and_more_do_not(a_gpu, monkeypatch):
    """Up to the last block that has room; beyond it every step has a launch of its own."""
    how, scene = numerics("mixed", steps_per_beat=100), of_spheres(32)
    bed = place(scene.close(), "gas", 1)
    fit, found = Beat.all_resident, []
    monkeypatch.setattr(Beat, "all_resident", lambda beat: found.append((beat, fit(beat))) or found[-1][1])
    alone, _ = run(scene, how, bed, 3, lanes=8, device=a_gpu)
    (first, _), *_ = found
    size, blocks = wp.get_suggested_block_size(first.kernels.step, a_gpu)
    room = size * blocks // (32 * 8)
    for members in (room, room + 1):
        backend = sharing(a_gpu, 8)
        ensemble = backend.open(backend.specialise(scene, how), members, a_gpu)
        admitted = [ensemble.admit(scene, how, bed) for _ in range(members)]
        assert not ensemble.advance(3)
        assert found[-1][1] == (members == room)
        assert all(identical(ensemble.packing(admitted[k]), alone) for k in (0, members // 2, members - 1))
        ensemble.close()


def ends_in_groups(few: Scene, fewer: Scene, how: Numerics, device: str, beats: int) -> End:
    """Five members with a thread a grain, so that groups are of two and of three, one of which fails within a beat."""
    beds = [(scene, falling(scene, how, device)) for scene in (few, fewer)]
    return together([*beds, *beds], how, 1, device, beats)


def check_alike(one: End, other: End) -> None:
    """Bit for bit."""
    assert all(identical(*both) for both in zip(one.packings, other.packings, strict=True))
    assert all(identical(one.packings[k], one.packings[k + 2]) for k in (0, 1))
    assert all((one.crossed[name] == other.crossed[name]).all() for name in one.crossed)
    assert one.failures == other.failures
    assert [guard for guard, _, _ in one.failures] == ["overlap"]


@pytest.mark.parametrize(
    ("few", "fewer"),
    [pytest.param(silo(45), silo(23), marks=pytest.mark.ring), (of_spheres(60), of_spheres(33))],
    ids=SHAPES,
)
def test_groups_of_members_take_the_steps_of_all_together(few, fewer, monkeypatch):
    how = numerics("mixed", steps_per_beat=49)
    whole = ends_in_groups(few, fewer, how, "cpu", 20)
    sizes = set()

    def move(self, first: int, some: int) -> None:
        for slot, slots in ((0, self._slots // 2), (self._slots // 2, self._slots - self._slots // 2)):
            sizes.add(slots)
            self._launch_steps(first, some, slot, slots)

    monkeypatch.setattr(Beat, "_move", move)
    check_alike(whole, ends_in_groups(few, fewer, how, "cpu", 20))
    assert {2, 3} <= sizes


@pytest.mark.gpu
@pytest.mark.parametrize(("few", "fewer"), [(silo(300), silo(45)), (of_spheres(500), of_spheres(97))], ids=SHAPES)
def test_groups_of_members_take_their_steps_side_by_side(few, fewer, a_gpu, monkeypatch):
    how, ends = numerics("mixed", steps_per_beat=249), []
    for fit in (True, False):
        monkeypatch.setattr(Beat, "all_resident", lambda _, fit=fit: fit)
        ends.append(ends_in_groups(few, fewer, how, a_gpu, 80))
    check_alike(*ends)
    assert len(ends[0].crossed["id"]) > 10
