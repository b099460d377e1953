"""Generated modules: made by one thread at a time, and once."""

import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from types import ModuleType

import pytest
from labbook_dem import generated

from labbook.backend import Unsupported
from labbook.cli.options import explanation

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


@pytest.mark.parametrize("damage", [b"", b"X = ", b"\0\xff\xfe", b"X = 2\n"], ids=["empty", "cut", "bytes", "changed"])
def test_a_damaged_source_is_written_again_in_a_line(tmp_path, damage, caplog):
    name, text = f"labbook_test_damaged_{len(damage)}", "X = 1\n"
    for content, lines in ((damage, 1), (text.encode(), 0)):
        (tmp_path / f"{name}.py").write_bytes(content)
        caplog.clear()
        try:
            assert generated.load(name, text, tmp_path).X == 1
        finally:
            sys.modules.pop(name, None)
        assert len(caplog.messages) == lines
        assert (tmp_path / f"{name}.py").read_text() == text
        assert [path.name for path in tmp_path.iterdir()] == [f"{name}.py"], "neither parts nor bytecode"


@pytest.fixture
def files(tmp_path):
    """Numba's files of one function, with one kernel."""
    from labbook_numba.code_cache import _Files

    made = _Files(cache_path=str(tmp_path), filename_base="kernel", source_stamp=(1, 2))
    made.save("signature", {"code": bytes(range(256)) * 20})
    return made


def damages(content: bytes) -> dict[str, bytes]:
    """A changed bit may be machine code, which nothing else notices."""
    middle = len(content) // 2
    flipped = content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]
    return {"empty": b"", "cut": content[:middle], "random": b"\x93" * len(content), "bit": flipped}


@pytest.mark.parametrize("damage", ["empty", "cut", "random", "bit"])
@pytest.mark.parametrize("file", ["kernel.nbi", "kernel.1.nbc"])
def test_damaged_code_is_not_loaded_and_is_made_again(files, tmp_path, file, damage, caplog):
    whole = files.load("signature")
    assert whole == {"code": bytes(range(256)) * 20}
    path = tmp_path / file
    content = path.read_bytes()
    path.write_bytes(damages(content)[damage])
    assert files.load("signature") is None
    assert caplog.messages == [f"{path}: compiled code is damaged: it is compiled again"]
    files.save("signature", whole)
    assert files.load("signature") == whole
    assert path.read_bytes() == content
    assert len(caplog.messages) == 1


def test_numba_switched_off_is_one_line_with_a_remedy(monkeypatch):
    from labbook_numba import Backend
    from numba import config

    monkeypatch.setattr(config, "DISABLE_JIT", 1)
    with pytest.raises(Unsupported, match=r"NUMBA_DISABLE_JIT: .* unset it, or use --backend reference"):
        Backend().open(spec())


def test_a_cache_that_cannot_be_written_is_named_with_the_way_out(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OSError, match="LABBOOK_CACHE") as caught:
        generated.load("labbook_test_nowhere", "x = 1", tmp_path / "file" / "cache")
    line = explanation(caught.value)
    assert line is not None
    assert line.startswith(str(tmp_path / "file" / "cache"))
