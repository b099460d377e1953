"""Rods in the GPU backend, on the processor: against spheres, and their bits."""

import math
from dataclasses import replace

import numpy as np
import pytest
from platforms import identical

pytest.importorskip("warp")

import warp as wp
from labbook_warp import Backend, room, stage
from rods_in_silo import DENSITY, PRECISIONS, ROUNDING, D, law, numerics, silo, trough
from rods_on_warp import run, sharing

from labbook.backend import Failed
from labbook.backend.probes import Crossing, Ledger
from labbook.filling.opening import start_of_discharge
from labbook.filling.placing import place
from labbook.scene import (
    Box,
    Primitives,
    Scene,
    Spheres,
    Spherocylinders,
    Strip,
    Wall,
)
from labbook.scene.orientation import random_turns
from labbook.scene.packing import Packing

pytestmark = pytest.mark.compiles
DOUBLE_IN_THE_RING = [pytest.param("double", marks=pytest.mark.ring), "mixed"]
"""Of tests whose kernels no other test needs, and whose host does the same in both precisions."""


@pytest.fixture(scope="module")
def bed() -> Packing:
    """Rods that have fallen into the closed silo and still move."""
    closed, first = silo(40).close(), wp.get_devices()[0].alias  # the processor, where Warp has it
    state, _ = run(closed, numerics("double"), place(closed, "gas", 1), 100, [Ledger()], device=first)
    return state


def planes() -> Scene:
    """A box: a rod touches each wall at two parts at most."""
    return silo(40).model_copy(update={"container": Box(width=0.08, depth=0.08, height=1.0)})


def on_the_floor(scene: Scene, bed: Packing) -> Packing:
    """The bed in another container, or its own opened; without springs at walls, whose names are others there."""
    if scene == silo(40):
        return start_of_discharge(bed, scene.close(), scene)
    none = {"wall_grain": np.zeros(0, np.int64), "wall_name": np.zeros(0, "U40"), "wall_part": np.zeros(0, np.int64)}
    return replace(bed, wall_spring=np.zeros((0, 3)), **none)


def test_rods_as_short_as_thick_are_spheres():
    """To within rounding: the same fall into a box, over a strip's edge and onto one another.

    In double; in mixed it is the verification case rod-without-length.
    """
    rng = np.random.default_rng(4)
    site = np.stack(np.meshgrid(*[np.arange(3)] * 3, indexing="ij"), -1).reshape(-1, 3)
    x = (site - 1) * 1.001 * D + [0, 0, 1.7 * D]
    v, omega = rng.normal(0, 0.3, x.shape), rng.normal(0, 20, x.shape)
    edge = Wall(name="edge", shape=Strip(start=(0.2 * D, 0.1 * D), end=(2 * D, 0.1 * D)))
    walls = (*Box(width=4 * D, depth=3.2 * D, height=20 * D).walls(), edge)
    found = []
    for rods in (False, True):
        kind = {"diameter": D, "density": DENSITY, "count": 27}
        grains = Spherocylinders(length=D, **kind) if rods else Spheres(**kind)
        scene = Scene(grains=grains, contact=law(grains), container=Primitives(parts=walls))
        start = Packing(x=x, v=v, omega=omega, q=random_turns(rng, 27) if rods else None)
        found.append(run(scene, numerics("double"), start, 4, [Ledger()]))
    (sphere, tables), (rod, _) = found
    rounding = ROUNDING["double"]
    assert tables[Ledger()]["contact_work"][-1] < -0.1 * tables[Ledger()]["kinetic"][0]
    assert np.abs(sphere.x - x).max() > D / 10
    assert np.abs(sphere.x - rod.x).max() < rounding * D
    assert np.abs(sphere.omega - rod.omega).max() < 10 * rounding * np.abs(sphere.omega).max()


@pytest.mark.parametrize("precision", PRECISIONS)
def test_energy_balances(precision, bed):
    """What contacts have done is what kinetic energy has lost, to round-off; there is no gravity."""
    flying = silo(40).close().model_copy(update={"gravity": 0.0})
    _, tables = run(flying, numerics(precision), bed, 20, [Ledger()])
    rows = tables[Ledger()]
    total = rows["kinetic"] - rows["contact_work"]
    assert np.ptp(rows["contact_work"]) > 0.1 * rows["kinetic"][0]
    # in mixed precision every kick rounds velocities, this way or that
    rounding = 1e-12 if precision == "double" else np.finfo(np.float32).eps * math.sqrt(rows["step"][-1])
    assert np.ptp(total) < rounding * np.abs(total).max()


@pytest.mark.parametrize("precision", DOUBLE_IN_THE_RING)
def test_bits_do_not_depend_on_the_company(precision, bed):
    """Neither on neighbours, nor on the slot, on a checkpoint, or on when lists are built."""
    scene, how, probes = silo(40), numerics(precision), [Crossing(), Ledger()]
    start = start_of_discharge(bed, scene.close(), scene)
    alone, tables = run(scene, how, start, 30, probes)
    assert len(tables[Crossing()]["id"]) > 3
    assert tables[Ledger()]["rebuilds"][-1] > tables[Ledger()]["rebuilds"][0]
    backend = sharing()
    ensemble = backend.open(backend.specialise(scene, how, probes), 1)
    slow = scene.model_copy(update={"gravity": 5.0})
    first = ensemble.admit(slow, how.model_copy(update={"dt": 4e-6}), start)
    ensemble.advance(2)
    ensemble.retire(first)
    ensemble.admit(slow, how, start)
    member = ensemble.admit(scene, how, start)
    thick = ensemble.admit(scene, how.model_copy(update={"skin": 0.4}), start)
    ensemble.drain()
    ensemble.advance(15)
    stored = ensemble.checkpoint(member)
    ensemble.advance(15)
    rows = ensemble.drain()[Crossing()]
    assert identical(ensemble.packing(member), alone)
    assert identical(ensemble.packing(thick), alone)
    mine = rows["member"] == member.index
    assert all(np.array_equal(rows[k][mine], tables[Crossing()][k]) for k in rows if k != "member")
    again = ensemble.admit(scene, how, stored)
    ensemble.advance(15)
    assert identical(ensemble.packing(again), alone)
    ensemble.close()


@pytest.mark.parametrize("precision", DOUBLE_IN_THE_RING)
def test_a_kernel_of_their_own_for_walls_decides_no_bit(precision, bed, monkeypatch):
    """Walls are met in the step itself, or before it, in a bed that flows over a turning edge."""
    scene, how = silo(40), numerics(precision)
    start, kernels, ends = start_of_discharge(bed, scene.close(), scene), room.kernels, []
    for one in (128, 0):
        monkeypatch.setattr(room, "kernels", lambda *key, apart, one=one, **how: kernels(*key, apart=one, **how))
        ends.append(run(scene, how, start, 20)[0])
    assert identical(*ends)
    assert (ends[0].wall_part > 1).any(), "none lies across the edge"


@pytest.mark.parametrize("precision", DOUBLE_IN_THE_RING)
@pytest.mark.parametrize("spin", [1e12, 1e25])
def test_forces_too_large_to_be_counted_are_caught(spin, precision, bed):
    """Rods that spin without bound are damped without bound where they touch; such forces may cancel as integers."""
    scene, how = silo(40).close(), numerics(precision)
    omega = bed.omega.copy()
    omega[np.unique(bed.pairs)] = spin
    backend = sharing()
    ensemble = backend.open(backend.specialise(scene, how, []), 1, "cpu")
    ensemble.admit(scene, how, replace(bed, omega=omega))
    (event,) = ensemble.advance(1)
    ensemble.close()
    assert isinstance(event, Failed)
    assert (event.guard, event.step) == ("state", 0)


@pytest.mark.gpu
@pytest.mark.parametrize("precision", DOUBLE_IN_THE_RING)
@pytest.mark.parametrize("scene", [silo(40), trough(), planes()], ids=["frustums", "strips and planes", "planes"])
def test_threads_that_share_a_grain_decide_no_bit(scene, precision, bed, monkeypatch):
    """On a GPU, where one thread a grain leaves walls to a kernel of their own, and several meet them in the step; and
    whether lists are asked for beforehand."""
    if not wp.get_cuda_device_count():
        pytest.skip("there is no CUDA device")
    how, start = numerics(precision), on_the_floor(scene, bed)
    ends = [run(scene, how, start, 20, lanes=lanes, device="cuda:0")[0] for lanes in (1, 2, 4, 8)]
    monkeypatch.setattr(room, "CACHE", 0)
    ends.append(run(scene, how, start, 20, lanes=1, device="cuda:0")[0])
    assert all(identical(end, ends[0]) for end in ends[1:])
    assert (ends[0].wall_part > 1).any() or scene == planes(), "none lies across the edge"


@pytest.mark.parametrize("lanes", [0, 3, 16])
def test_a_number_of_threads_that_masks_cannot_name_is_refused(lanes):
    with pytest.raises(ValueError, match="1, 2, 4 or 8"):
        Backend(lanes=lanes)


@pytest.mark.parametrize("precision", DOUBLE_IN_THE_RING)
def test_a_beat_that_is_put_back_leaves_no_trace(precision, bed, monkeypatch):
    """Of some members and not of others, with lists that grow, and beside one that fails within a beat."""
    scene, small, how = silo(40), silo(23), numerics(precision)
    start = start_of_discharge(bed, scene.close(), scene)
    smaller = start_of_discharge(place(small.close(), "gas", 3), small.close(), small)
    alone = [run(scene, how, start, 20)[0], run(small, how, smaller, 20)[0]]
    beats, collect = iter(range(10_000)), stage.collect

    def late(*left_behind):
        report, beat = collect(*left_behind), next(beats)
        if beat % 3 == 2:
            return report
        slots = [replace(slot, late=True) if (k + beat) % 2 else slot for k, slot in enumerate(report.slots)]
        return replace(report, slots=slots)

    monkeypatch.setattr(stage, "collect", late)
    monkeypatch.setattr(stage.Stage, "check_more_often", lambda _: None)
    monkeypatch.setattr(room, "NEAR", 2)
    backend = sharing()
    ensemble = backend.open(backend.specialise(scene, how), 1)
    fails = ensemble.admit(scene, how.model_copy(update={"overlap_limit": 1e-4}), start)
    members = ensemble.admit(scene, how, start), ensemble.admit(small, how, smaller)
    events = []
    for _ in range(20):
        events += ensemble.advance(1)
        ensemble.packing(members[0])  # looked at in between, which changes nothing
    assert [event.member for event in events] == [fails]
    assert all(identical(ensemble.packing(member), end) for member, end in zip(members, alone, strict=True))
    ensemble.close()


def test_threads_that_share_a_grain_find_the_same_neighbours(bed, monkeypatch):
    """On the processor they take turns; only lists are built so, and equally near neighbours may come in any order."""
    found = []
    for lanes in (1, 4):
        monkeypatch.setattr(room, "lanes", lambda *_, lanes=lanes: lanes)
        backend, scene, how = sharing(), silo(40).close(), numerics("double")
        ensemble = backend.open(backend.specialise(scene, how, [Ledger()]))
        ensemble.admit(scene, how, bed)
        ensemble._stage.seat()
        arrays = ensemble._stage.arrays
        count, nbr, held, ids = (arrays.read(name, 0, 40) for name in ("count", "nbr", "held", "ids"))
        assert np.array_equal(np.bitwise_count(held), np.bincount(bed.pairs.ravel(), minlength=40)[ids])
        found.append({ids[row]: set(ids[nbr[:n, row]].tolist()) for row, n in enumerate(count)})
        ensemble.close()
    assert found[0] == found[1]
    assert sum(map(len, found[0].values())) > 2 * len(bed.pairs)
