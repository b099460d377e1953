"""The GPU backend compiles what a study will need before its members come."""

import threading
import time
from types import SimpleNamespace

import pytest

pytest.importorskip("warp")

import warp as wp
from labbook_warp import Backend, ahead, beat
from toy_lab import carry_out, study

from labbook.lab import Catalogue, Lab
from labbook.lab.index import Index
from labbook.lab.records import Observe
from labbook.run.board import Board
from labbook.run.job import Bench
from labbook.run.plan import Planner

pytestmark = pytest.mark.compiles

SMALL = {"count": 60, "orifices": "[18, 24]", "replicates": 1}
FAST = "fill: {settled_below: 0.5, numerics: {dt: 20 us}}"


@pytest.fixture
def expected(tmp_path):
    """What the board says of a small study: two runs from one packing."""
    asked, backend, lab = study(tmp_path, FAST, **SMALL), Backend(), Lab(tmp_path / "lab")
    catalogue, index = Catalogue(lab), Index(lab)
    try:
        planner = Planner(asked, catalogue, backend.capabilities)
        board = Board(Bench(lab, backend, "cpu"), planner, index, Observe(measure=asked.measure, start=0, end=1))
        board.pin(planner.plan())
        return board.expected()
    finally:
        catalogue.close()
        index.close()


def test_the_board_names_fillings_and_runs(expected):
    assert [(one.scene.container.closed, one.count) for one in expected] == [(True, 1), (False, 1), (False, 1)]
    assert expected[1].spec == expected[2].spec != expected[0].spec


def test_modules_are_compiled_together_and_waited_for(expected, monkeypatch):
    begun, go_on = [], threading.Event()

    def compiling(module, device):
        begun.append(module)
        assert go_on.wait(20)
        begun.append("done")

    monkeypatch.setattr(wp, "compile_aot_module", compiling)
    monkeypatch.setattr(ahead, "_going", {})
    gpu = SimpleNamespace(is_cuda=True)
    needed = ahead.modules(expected, gpu, None)
    ahead.foresee(expected, gpu, None)
    for _ in range(200):
        if len(begun) == 2:
            break
        time.sleep(0.1)
    assert set(begun) == set(needed)
    assert len(needed) == 2
    waiting = threading.Thread(target=ahead.wait_for, args=(needed[1],), daemon=True)
    waiting.start()
    waiting.join(0.2)
    assert waiting.is_alive()
    go_on.set()
    waiting.join(20)
    assert not waiting.is_alive()
    assert "done" in begun
    ahead.foresee(expected, gpu, None)  # once is enough
    assert len([module for module in begun if module != "done"]) == 2


def test_nothing_is_compiled_ahead_on_a_processor(expected, monkeypatch):
    monkeypatch.setattr(ahead, "_going", {})
    Backend().foresee(expected, "cpu")
    assert not ahead._going


def test_what_is_foreseen_is_what_is_needed(tmp_path, expected, monkeypatch):
    used, made = [], beat.Beat.__init__

    def noted(self, arrays, steps):
        used.append(arrays.module)
        made(self, arrays, steps)

    monkeypatch.setattr(beat.Beat, "__init__", noted)
    asked = study(tmp_path, FAST, **SMALL)
    assert carry_out(asked, tmp_path / "lab", backend=Backend(), lanes=1).done == 2
    assert set(used) == set(ahead.modules(expected, wp.get_device("cpu"), None))
