"""A large scene may be stepped by several threads; how many there are changes no bit of anything."""

import threading
import time
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import rods_in_silo
from platforms import identical

pytest.importorskip("numba")

from labbook_numba import Backend, domains

from labbook.backend import Failed
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Contacts, Crossing, Sample
from labbook.checks.verify.symmetry import DT, hopper
from labbook.filling.opening import start_of_discharge
from labbook.filling.placing import place
from labbook.scene import Packing, Scene

pytestmark = pytest.mark.compiles

GRAINS = 400
BEATS = 16
PROBES = (Crossing(), Sample(), Contacts(every=4))


@pytest.fixture(autouse=True)
def every_scene_is_large(monkeypatch):
    monkeypatch.setattr(domains, "LARGE", 8)
    monkeypatch.setattr(domains, "LARGE_RODS", 8)
    monkeypatch.setattr(domains, "LAYERED", 8)
    monkeypatch.setattr(domains, "cores", lambda: 8)


SPRUNG = {"rolling_model": "epsd", "rolling_friction": 0.1}
"""Rolling springs, which pairs that another thread has borrowed keep too."""


def silo(**law: Any) -> Scene:
    here = hopper()
    grains, contact = here.grains.model_copy(update={"count": GRAINS}), here.contact.model_copy(update=law)
    return here.model_copy(update={"grains": grains, "contact": contact})


def numerics(precision: str) -> Numerics:
    return Numerics.model_validate({"dt": DT, "precision": precision, "steps_per_beat": 250})


@pytest.fixture(scope="module")
def start():
    backend, closed = Backend(wide=True), silo().close()  # its kernels are those of the contract's tests
    ensemble = backend.open(backend.specialise(closed, numerics("double")), 1)
    member = ensemble.admit(closed, numerics("double"), place(closed, "gas", 1))
    ensemble.advance(8)
    fallen = ensemble.packing(member)
    ensemble.close()
    return start_of_discharge(fallen, closed, silo())


def discharged(threads: int, precision: str, start, scene: Scene, beats: int = BEATS, dt: float = DT):
    """Rows, checkpoint and packing after a discharge; the arrays of the checkpoint without what lies behind lists."""
    backend, how = Backend(threads=threads), numerics(precision).model_copy(update={"dt": dt})
    ensemble = backend.open(backend.specialise(scene, how, PROBES), 1)
    member = ensemble.admit(scene, how, start)
    assert not ensemble.advance(beats)
    found = ensemble.drain(), ensemble.checkpoint(member).arrays, ensemble.packing(member)
    ensemble.close()
    return found


def used(arrays) -> dict[str, np.ndarray]:
    lengths = {name: len(arrays["pair_i"]) - 8 for name in ("pair_i", "pair_j", "held", "spring")}
    lengths |= {name: int(arrays["wall_first"][-1]) for name in ("wall_grain", "wall_held", "wall_spring")}
    lengths |= dict.fromkeys(("grains", "loads"), len(arrays["ids"]))
    return {name: array[: lengths.get(name, len(array))] for name, array in arrays.items()}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("precision", "law"),
    [
        ("double", {}),
        pytest.param("mixed", {}, marks=pytest.mark.ring),
        pytest.param("mixed", SPRUNG, marks=pytest.mark.ring),
    ],
)
def test_bits_do_not_depend_on_threads(start, precision, law):
    packing = discharged_by_any_number_of_threads(precision, start, silo(**law))
    assert len(packing.pairs) > 200
    assert (packing.pair_rolling is not None and packing.pair_rolling.any()) == bool(law)


@pytest.mark.ring  # two minutes to compile; spheres, above, share a scene among threads by the same code
@pytest.mark.parametrize("precision", ["double", "mixed"])
def test_bits_of_rods_do_not_depend_on_threads(precision):
    """They fall onto a bottom that turns, and touch one another, the wall, the bottom and its rim on their way out."""
    scene = rods_in_silo.silo(200)
    packing = discharged_by_any_number_of_threads(precision, place(scene, "gas", 1), scene, beats=110, dt=1e-5)
    assert len(packing.pairs) > 60
    assert set(packing.wall_name) == {wall.name for wall in scene.container.walls()}
    assert packing.wall_part.max() > 0


def discharged_by_any_number_of_threads(precision, start, scene: Scene, **how: Any) -> Packing:
    """The packing after a discharge, which is the same in every bit by one, two and five threads, as all else is."""
    rows, arrays, packing = discharged(1, precision, start, scene, **how)
    assert len(rows[PROBES[0]]["id"]) > 40, "grains leave, so that rows and domains move"
    for threads in (2, 5):
        other_rows, other_arrays, other = discharged(threads, precision, start, scene, **how)
        assert identical(other, packing), threads
        assert all(identical(other_rows[probe], rows[probe]) for probe in PROBES), threads
        ours, theirs = used(arrays), used(other_arrays)
        assert [name for name in ours if not np.array_equal(ours[name], theirs[name])] == []
    return packing


@pytest.mark.slow
@pytest.mark.parametrize("change", [{"speed_limit": 0.5}, {"overlap_limit": 1e-4}])
def test_guards_blame_the_same_grain(start, change):
    messages = set()
    for threads in (1, 3):
        backend, how = Backend(threads=threads), numerics("double").model_copy(update=change)
        ensemble = backend.open(backend.specialise(silo(), how, PROBES), 1)
        ensemble.admit(silo(), how, start)
        (event,) = ensemble.advance(BEATS)
        assert isinstance(event, Failed)
        messages.add(event.message)
        ensemble.close()
    assert len(messages) == 1


def test_a_member_gets_its_share_of_the_cores():
    with domains.threads_for(1000, 8, 8) as alone:
        assert alone == 8
        with domains.threads_for(1000, 3, 8) as second:
            assert second == 3, "no more than it may"
        with domains.threads_for(1000, 8, 8) as second, domains.threads_for(1000, 8, 8) as third:
            assert (second, third) == (4, 2)
        with domains.threads_for(7, 8, 8) as small:
            assert small == 1
    with domains.threads_for(9, 8, 8) as few:
        assert few == 4, "a domain has some grains"


def test_large_scenes_are_put_in_layers():
    grains = silo().grains
    gas = place(silo().close(), "gas", 3)
    sorted_ = domains.in_layers(gas, grains.diameter)
    assert (np.diff(np.floor(sorted_.x[:, 2] / grains.diameter)) >= 0).all()
    assert np.array_equal(sorted_.x, gas.x[sorted_.ids])


class Broken(Exception):
    pass


def test_a_domain_that_fails_does_not_keep_the_others_waiting(start):
    """All domains leave and the caller is told why, the member as it was; were they to wait, the test lets them go."""
    backend = Backend(threads=3)
    ensemble = backend.open(backend.specialise(silo(), numerics("double"), PROBES), 1)
    member = ensemble.admit(silo(), numerics("double"), start)
    run, before = ensemble._runs[member], ensemble.checkpoint(member)
    states, left, raised = [], [], []

    def advance(domain, params, target):
        states.append(domain)
        if domain.domain[domains.S.NUMBER] != 1:
            left.append(kernels.advance(domain, params, target))
            return left[-1]
        kernels.advance(domain, params, 10)  # the others go on to their next meeting
        time.sleep(0.1)
        raise Broken

    kernels = run.kernels
    run.kernels = ModuleType("failing")
    vars(run.kernels).update(vars(kernels) | {"advance": advance})

    def beat():
        try:
            ensemble.advance(1)
        except Broken as error:
            raised.append(error)

    thread = threading.Thread(target=beat)
    thread.start()
    thread.join(60)
    waits = thread.is_alive()
    for domain in states:
        domain.meetings[0] = 1 << 62
    thread.join()
    after = ensemble.checkpoint(member)
    ensemble.close()
    assert not waits
    assert len(left) == 2
    assert len(raised) == 1
    assert [name for name, array in before.arrays.items() if not np.array_equal(array, after.arrays[name])] == []
