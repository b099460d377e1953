"""Generated modules: made by one thread at a time."""

import time
from concurrent.futures import ThreadPoolExecutor
from types import ModuleType

import pytest
from labbook_dem import generated

pytest.importorskip("numba")
pytest.importorskip("warp")

from labbook_numba import build as on_the_processor
from labbook_warp import build as on_the_gpu


def test_one_thread_at_a_time_makes_kernels_whichever_engine_they_are_for(monkeypatch):
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
                        switches = tuple((name, int(name == "ROLLING") * rolling) for name in build.SWITCHES)
                        pool.submit(build.kernels, "linear", precision, switches)
    finally:
        on_the_processor.kernels.cache_clear()
        on_the_gpu.kernels.cache_clear()
    assert len(most) == 8
    assert max(most) == 1
