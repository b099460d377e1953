"""Generated modules: made by one thread at a time, and once."""

import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from types import ModuleType

import pytest
from labbook_dem import generated

from labbook.cli.options import told

pytest.importorskip("numba")
pytest.importorskip("warp")

from labbook_numba import build as on_the_processor
from labbook_warp import build as on_the_gpu
from specs import spec


def test_one_thread_at_a_time_makes_kernels_whichever_backend_they_are_for(monkeypatch):
    """Python's parser, which source and compilers call, fails in two threads at once before 3.11.8."""
    busy, most = [], []

    def load(name, text, folder):
        busy.append(name)
        most.append(len(busy))
        time.sleep(0.02)
        busy.remove(name)
        return ModuleType(name)

    monkeypatch.setattr(generated, "load", load)
    try:
        with ThreadPoolExecutor(8) as pool:
            for precision in ("double", "mixed"):
                for build in (on_the_processor, on_the_gpu):
                    for rolling in (0, 1):
                        pool.submit(build.kernels, spec("linear", precision, ROLLING=bool(rolling)))
    finally:
        on_the_processor.kernels.cache_clear()
        on_the_gpu.kernels.cache_clear()
    assert len(most) == 8
    assert max(most) == 1


@pytest.mark.compiles
@pytest.mark.parametrize("build", [on_the_processor, on_the_gpu], ids=["numba", "warp"])
def test_threads_that_ask_for_the_same_kernels_get_the_same(build, monkeypatch, tmp_path):
    """A second import would take the place of the first in Warp's books, while kernels of the first are launched."""
    monkeypatch.setenv("LABBOOK_CACHE", str(tmp_path))
    together = threading.Barrier(4)

    def ask(_):
        together.wait()
        return build.kernels(spec())

    build.kernels.cache_clear()
    try:
        with ThreadPoolExecutor(4) as pool:
            first, *others = pool.map(ask, range(4))
    finally:
        build.kernels.cache_clear()
    assert all(other is first for other in others)


def test_a_generated_module_that_cannot_be_imported_is_not_taken_for_one_that_was(tmp_path):
    for _ in range(2):
        with pytest.raises(ZeroDivisionError):
            generated.load("labbook_broken", "x = 1 / 0\n", tmp_path)
    assert "labbook_broken" not in sys.modules


def test_a_cache_that_cannot_be_written_is_named_with_the_way_out(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OSError, match="LABBOOK_CACHE") as caught:
        generated.load("labbook_test_nowhere", "x = 1", tmp_path / "file" / "cache")
    line = told(caught.value)
    assert line is not None
    assert line.startswith(str(tmp_path / "file" / "cache"))
