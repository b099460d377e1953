"""The GPU backend knows what its members take, and how many of them a device can hold."""

from contextlib import closing

import pytest
from platforms import identical

pytest.importorskip("warp")

import warp as wp
from labbook_warp import Backend, copies, devices, room, stage
from labbook_warp.arrays import Arrays
from labbook_warp.layout import memory
from rods_in_silo import DENSITY, D, numerics, silo
from rods_on_warp import run, sharing

from labbook.backend import Unsupported
from labbook.backend.probes import Contacts, Crossing, Ledger, Sample, Slab
from labbook.checks.bench.speed import FAN_STEP, cylinder, fan
from labbook.filling.opening import start_of_discharge
from labbook.filling.placing import place
from labbook.scene import Spheres

pytestmark = pytest.mark.compiles

GIB = 1 << 30
PROBES = (Crossing(),)


def spec_of(scene, precision="mixed", probes=PROBES):
    return Backend().specialise(scene, FAN_STEP.model_copy(update={"precision": precision}), probes)


@pytest.mark.parametrize("scene", [fan(grains=40), cylinder(rods=True, grains=40)], ids=["spheres", "rods"])
@pytest.mark.parametrize("precision", ["mixed", "double"])
def test_memory_is_what_arrays_take(precision, scene):
    spec = spec_of(scene, precision)
    sizes = room.largest(spec, scene)
    module = room.suitable(spec, sizes, False, 1)
    arrays = Arrays(module, sizes, devices.find("cpu"), True)
    held = [arrays.p, arrays.q, *vars(arrays.system).values(), *(copy for _, copy in arrays._saved)]
    taken = sum(array.capacity for array in held if isinstance(array, wp.array))
    assert memory(module, sizes, True) == taken


def capacity(monkeypatch, free, scene, **how):
    monkeypatch.setattr(devices, "free", lambda _device: free)
    fit = Backend().capacity(spec_of(scene, **how), scene, "cpu")
    assert fit is not None
    return fit


def test_as_many_fit_as_memory_has_room_for(monkeypatch):
    scene = fan(grains=3000)
    fit = capacity(monkeypatch, 16 * GIB, scene)
    assert fit == pytest.approx(2 * capacity(monkeypatch, 8 * GIB, scene), abs=1)
    assert fit == pytest.approx(2 * capacity(monkeypatch, 16 * GIB, fan(grains=6000)), rel=0.02)
    assert capacity(monkeypatch, 16 * GIB, scene, precision="double") < fit
    assert capacity(monkeypatch, 16 * GIB, scene, probes=(Crossing(), Contacts())) < fit
    # a grain in mixed has 3 x 64 bytes of state, and 32 neighbours with two springs of 12 bytes at least
    assert fit < 16 * GIB / (3000 * (3 * 64 + 32 * 24))
    assert fit > 100


def test_one_member_is_always_tried(monkeypatch):
    assert capacity(monkeypatch, 1000, fan(grains=3000)) == 1


def test_no_index_in_a_kernel_is_too_large(monkeypatch):
    """48 entries of cells a grain come first, of a device with room for more."""
    fit = capacity(monkeypatch, 10_000 * GIB, fan(grains=3000))
    assert 0.9 * 2**31 < fit * 48 * 3000 < 2**31


def test_more_grains_than_a_failure_can_name_are_refused():
    scene = fan(grains=2**24 + 1)
    with pytest.raises(Unsupported, match=r"grains.count: .* at most 16777216 grains; use fewer, or .* numba"):
        spec_of(scene)
    assert spec_of(fan(grains=2**24))


def test_a_processors_memory_is_not_rationed():
    assert Backend().capacity(spec_of(fan(grains=40)), fan(grains=40), "cpu") is None


@pytest.mark.parametrize("seated", [0, 1])
def test_memory_that_is_not_there_is_an_error_that_says_so(monkeypatch, seated):
    """Also for members that join others."""

    def exhausted(*_args, **_kinds):
        raise RuntimeError("Failed to allocate 99 bytes")

    scene = fan(grains=40).close()
    numerics = FAN_STEP.model_copy(update={"precision": "mixed"})
    backend = sharing()
    ensemble = backend.open(backend.specialise(scene, numerics))
    for seed in range(seated):
        ensemble.admit(scene, numerics, place(scene, "gas", seed))
        ensemble.advance(1)
    ensemble.admit(scene, numerics, place(scene, "gas", seated))
    for made in ("zeros", "empty", "array", "clone"):
        monkeypatch.setattr(wp, made, exhausted)
    with pytest.raises(MemoryError, match=f"cpu has no memory for {seated + 1} members: Failed to allocate 99 bytes"):
        ensemble.advance(1)


# kernels of its own; the host's code is the same for both shapes
@pytest.mark.parametrize("rods", [False, pytest.param(True, marks=pytest.mark.ring)], ids=["spheres", "rods"])
def test_a_member_brings_along_how_long_its_lists_had_to_be(monkeypatch, rods):
    """Lists that have grown are taken up by an ensemble that has not met a crowd yet; also beside another member."""
    scene = cylinder(rods=rods, grains=40)
    backend, how = sharing(), FAN_STEP.model_copy(update={"precision": "mixed"})
    spec = backend.specialise(scene, how, PROBES)
    bed = place(scene.close(), "gas", 1)
    monkeypatch.setattr(room, "NEAR", 21)
    with closing(backend.open(spec, 1, "cpu")) as grown:
        member = grown.admit(scene, how, bed)
        grown.advance(1)
        checkpoint = grown.checkpoint(member)
        grown.advance(2)
        end = grown.packing(member)
    assert len(checkpoint.arrays["nbr"]) == 21
    monkeypatch.setattr(room, "NEAR", 16)
    with closing(backend.open(spec, 2, "cpu")) as fresh:
        fresh.admit(scene, how, bed)
        fresh.advance(1)
        member = fresh.admit(scene, how, checkpoint)
        fresh.advance(2)
        assert identical(fresh.packing(member), end)


def wide(**changes):
    """A silo that keeps few grains on its plate."""
    scene = silo(100)
    return scene.model_copy(update={"container": scene.container.model_copy(update={"orifice": 0.07}), **changes})


SPHERES = Spheres(diameter=D, density=DENSITY, count=150)


@pytest.mark.parametrize(
    ("precision", "scene"),
    # 15 s to compile kernels of their own; rods in mixed precision, which share theirs, have the same rows
    [pytest.param("double", wide(grains=SPHERES), marks=pytest.mark.ring), ("mixed", wide())],
)
def test_rows_of_grains_that_have_left_are_closed_up_and_leave_no_trace(precision, scene, monkeypatch):
    how = numerics(precision)
    closed = scene.close()
    bed = start_of_discharge(run(closed, how, place(closed, "gas", 1), 100)[0], closed, scene)
    probes = (Crossing(), Ledger(every=3), Sample(fields=("x", "v", "omega"), every=2), Slab(low=-0.01, high=0.02))
    made, resize = [], stage.Stage._resize

    def resized(self, sizes, *more):
        made[-1].append(sizes.cap)
        resize(self, sizes, *more)

    monkeypatch.setattr(stage.Stage, "_resize", resized)
    ends = []
    for large in (1 << 30, 64):
        monkeypatch.setattr(room, "LARGE", large)
        made.append([])
        ends.append(run(scene, how, bed, 130, probes))
    one, other = ends
    assert 0 < len(one[0]) < scene.grains.count / 2
    assert min(made[1]) < min(made[0]) / 1.5, "rows were not closed up"
    assert identical(one[0], other[0])
    for probe in probes:
        assert all((one[1][probe][name] == other[1][probe][name]).all() for name in one[1][probe]), probe


def test_a_processor_has_no_copy_bandwidth_that_would_limit_it():
    assert Backend().bandwidth("cpu") is None


@pytest.mark.gpu
def test_the_copy_bandwidth_of_a_gpu_is_measured_once(monkeypatch):
    """It lies between those of a small card and of stacked memory to come; not where little memory is free."""
    if not wp.is_cuda_available():
        pytest.skip("no CUDA device was found")
    copies.present_bandwidth.cache_clear()
    measured = Backend().bandwidth("cuda:0")
    assert measured is not None
    assert 1e11 < measured < 4e13
    assert Backend().bandwidth("cuda:0") == measured
    copies.present_bandwidth.cache_clear()
    monkeypatch.setattr(devices, "free", lambda _device: GIB)
    assert Backend().bandwidth("cuda:0") is None
    copies.present_bandwidth.cache_clear()
