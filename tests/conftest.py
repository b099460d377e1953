"""How tests are shared out among processes, and that no clock decides one.

Tests that need the same compiled kernels go to one process: each kernel is compiled once then; two processes that need
it at the same time would both compile it. All other tests go to a process by files, so that what the fixtures of a file
make is made once. (Marks for pytest-xdist's own `--dist loadgroup` do nothing with pytest 9.2.)

Hypothesis by itself fails a test whose examples take long, which on a loaded machine, or in a fresh checkout that has
yet to build its table of characters, says nothing of the test.
"""

import gc
import os
import re
import sys
from functools import cache
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from labbook_dem import generated

os.environ.pop("COLUMNS", None)  # of the terminal that the suite runs in; pytest-xdist hands it to its processes

settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("untimed")

PLATFORM = re.compile(r"(numba|warp)-(double|mixed)-(cpu|cuda:\d+)")
"""In the name of a test that is repeated for every platform."""
FILES = {
    "numba-double-cpu": (
        *("test_bench_elongation", "test_fields_packing"),
        *("test_numba_guards", "test_numba_mesh", "test_numba_plain", "test_numba_threads"),
    ),
    "warp-mixed-cpu": (
        *("test_warp_guards", "test_warp_meshes", "test_warp_moving"),
        *("test_warp_rods", "test_warp_room", "test_warp_several"),
    ),
    "studies": ("test_api_tutorial", "test_bench_backend", "test_compare_backends"),
}
"""Further files that share kernels with one another, or with tests of a platform."""


def group(test: str) -> str:
    """Name of the group that a test belongs to; of most, the file that they are in."""
    if found := PLATFORM.search(test):
        return found[0]
    for name, files in FILES.items():
        if any(f"/{file}.py" in test for file in files):
            return name
    return test.partition("::")[0]


@cache
def compiles(name: str) -> bool:
    """Whether tests of a group make kernels: few may take long."""
    file = Path(__file__).parents[1] / name
    return not file.is_file() or "mark.compiles" in file.read_text(encoding="utf-8")


def can_render() -> bool:
    """Whether the viewer has a Vulkan driver to draw with: a GPU's, or the software rasteriser. Elsewhere than on Linux
    it needs none."""
    folders = ("/usr/share/vulkan/icd.d", "/usr/local/share/vulkan/icd.d", "/etc/vulkan/icd.d")
    named = os.environ.get("VK_DRIVER_FILES") or os.environ.get("VK_ICD_FILENAMES")
    return sys.platform != "linux" or bool(named) or any(list(Path(folder).glob("*.json")) for folder in folders)


def pytest_collection_modifyitems(items):
    """Tests on a platform of a backend compile; tests marked `render` need a Vulkan driver."""
    for item in items:
        if PLATFORM.search(item.nodeid):
            item.add_marker("compiles")
    if can_render():
        return
    skip = pytest.mark.skip(reason="no Vulkan driver is installed (Debian: apt-get install mesa-vulkan-drivers)")
    for item in items:
        if item.get_closest_marker("render"):
            item.add_marker(skip)


def pytest_collection_finish():
    """What was imported to collect tests stays to the end: the garbage collector need not go through it each time."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Groups that make kernels first, then large ones, each to whoever is free: no long one is left for the end."""
    from xdist.scheduler import LoadScopeScheduling

    class ByKernels(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return group(nodeid)

        def _assign_work_unit(self, node) -> None:
            self.workqueue.move_to_end(next(filter(compiles, self.workqueue), next(iter(self.workqueue))), last=False)
            super()._assign_work_unit(node)

    return ByKernels(config, log) if config.getoption("dist") == "load" else None


@pytest.fixture(autouse=True)
def kernels_are_asked_for(request, monkeypatch):
    """A test that makes kernels says so by the mark `compiles`: compiling takes most of the time of the suite."""
    if request.node.get_closest_marker("compiles"):
        return
    load = generated.load

    def loaded(name: str, text: str, folder: Path):
        assert not name.startswith(("labbook_numba_", "labbook_warp_")), (
            "mark this test with `compiles`: it makes kernels"
        )
        return load(name, text, folder)

    monkeypatch.setattr(generated, "load", loaded)


@pytest.fixture(autouse=True)
def the_disk_is_not_waited_for(monkeypatch):
    """No test pulls the plug; waiting until the disk has what was written takes long."""
    monkeypatch.setattr(os, "fsync", lambda _: None)


@pytest.fixture
def one_format(monkeypatch):
    """Figures of pages are written as SVG only, which pages need: the other formats take most of the time."""
    monkeypatch.setattr("labbook.report.style.FORMATS", ("svg",))
