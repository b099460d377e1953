"""The GPU backend compiles what a study will need before its members come."""

import threading
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("warp")

import warp as wp
from labbook_warp import Backend, beat, compiling, room
from toy_lab import carry_out, study

from labbook.filling.placing import place
from labbook.lab import Catalogue, LabFolder
from labbook.lab.index import Index
from labbook.lab.records import Observe
from labbook.plan.plan import Planner
from labbook.run import job_queue
from labbook.run.job import JobContext

pytestmark = pytest.mark.compiles

SMALL = {"count": 60, "orifices": "[18, 24]", "replicates": 1}
FAST = "fill: {settled_below: 0.5, numerics: {dt: 20 us}}"
GPU: Any = SimpleNamespace(is_cuda=True)


@pytest.fixture
def expected(tmp_path):
    """What the board says of a small study: two runs from one packing."""
    return said(tmp_path, SMALL)


def said(tmp_path, of):
    """What the board says of a study before anything runs."""
    asked, backend, lab = study(tmp_path, FAST, **of), Backend(), LabFolder(tmp_path / "board")
    catalogue, index = Catalogue(lab), Index(lab)
    try:
        planner = Planner(asked, catalogue, backend.capabilities)
        observe = Observe(measure=asked.measure, start=0, end=1)
        of_study = job_queue.JobQueue(JobContext(lab, backend, "cpu"), planner, index, observe)
        of_study.load_plan(planner.plan())
        return of_study.expected()
    finally:
        catalogue.close()
        index.close()


@pytest.fixture
def gate(monkeypatch):
    """Modules whose compiling was begun, and an event that it waits for."""
    begun, opened = [], threading.Event()

    def compile_aot_module(module, device):
        begun.append(module)
        assert opened.wait(60)

    monkeypatch.setattr(wp, "compile_aot_module", compile_aot_module)
    monkeypatch.setattr(compiling, "_compiling", {})
    monkeypatch.setattr(compiling, "_workers", threading.Semaphore(2))
    yield SimpleNamespace(begun=begun, open=opened.set)
    opened.set()


def test_the_board_names_fillings_and_runs(expected):
    assert [(one.scene.container.closed, one.count) for one in expected] == [(True, 1), (False, 1), (False, 1)]
    assert expected[1].spec == expected[2].spec != expected[0].spec


def test_all_runs_of_a_point_are_counted(tmp_path, monkeypatch):
    monkeypatch.setattr(job_queue, "_MAX_COMPILED_AHEAD", 1)
    assert [one.count for one in said(tmp_path, {**SMALL, "replicates": 3})] == [3, 3]


def test_modules_are_compiled_once_and_waited_for(expected, gate):
    needed = list(compiling.modules(expected, GPU, None))
    assert len(needed) == len({*needed}) == 2
    compiling.precompile(expected, GPU, None)
    compiling.precompile(expected, GPU, None)
    assert len(compiling._compiling) == 2
    waiting = threading.Thread(target=compiling.wait_for, args=(needed[1],), daemon=True)
    waiting.start()
    waiting.join(0.1)
    assert waiting.is_alive()
    assert compiling.any_running()
    gate.open()
    waiting.join(60)
    assert not waiting.is_alive()
    compiling.wait_for(needed[0])
    assert not compiling.any_running()
    assert sorted(map(id, gate.begun)) == sorted(map(id, needed))


@pytest.mark.filterwarnings("error::pytest.PytestUnhandledThreadExceptionWarning")
def test_an_error_is_left_to_whoever_loads_the_kernels(expected, gate, monkeypatch):
    def fails(module, device):
        gate.begun.append(module)
        raise RuntimeError("no such architecture")

    monkeypatch.setattr(wp, "compile_aot_module", fails)
    compiling.precompile(expected, GPU, None)
    for module in compiling.modules(expected, GPU, None):
        compiling.wait_for(module)
    assert len(gate.begun) == 2


def test_nothing_is_compiled_ahead_on_a_processor(expected, gate):
    gate.open()
    Backend().precompile(expected, "cpu")
    assert not compiling._compiling


@pytest.mark.ring  # compiles all variants of a scene
def test_what_is_foreseen_is_what_is_needed(tmp_path, monkeypatch):
    told, used, waited, made = [], [], [], beat.Beat.__init__

    class Told(Backend):
        def precompile(self, members, device):
            told.extend(compiling.modules(members, wp.get_device(device), None))

    def noted(self, arrays, steps):
        used.append(arrays.module)
        made(self, arrays, steps)

    monkeypatch.setattr(beat.Beat, "__init__", noted)
    monkeypatch.setattr(compiling, "wait_for", waited.append)
    asked = study(tmp_path, FAST, **SMALL)
    assert carry_out(asked, tmp_path / "lab", backend=Told(), workers=1).done == 2
    assert len(told) == 2
    assert {*map(id, used)} == {*map(id, told)}
    assert waited == used


def test_the_first_members_have_the_kernels_of_those_that_will_differ(expected, monkeypatch):
    """Members come one after another: else the first ones would need kernels of their own, and another layout."""
    asked, one = [], expected[1]
    slower = one.numerics.model_copy(update={"dt": 2 * one.numerics.dt})

    def suitable(spec, sizes, uniform, lanes):
        asked.append((uniform, sizes.slots))
        raise StopIteration

    monkeypatch.setattr(compiling, "_mixed", set())
    monkeypatch.setattr(room, "suitable", suitable)
    for members in ([one], [one, replace(one, numerics=slower)]):
        Backend().precompile(members, "cpu")
        ensemble = Backend().open(one.spec, 4)
        ensemble.admit(one.scene, one.numerics, place(one.scene.close(), "rain", 1))
        with pytest.raises(StopIteration):
            ensemble.advance()
    assert asked == [(True, 4), (False, 4)]
