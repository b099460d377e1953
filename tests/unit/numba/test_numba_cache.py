"""Compiled kernels are kept on disk: a second process finds them, an edited law does not."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from specs import spec

pytest.importorskip("numba")

pytestmark = pytest.mark.compiles

ROOT = Path(__file__).parents[3]
COLLISION = """
import json, sys
import numpy as np
from labbook.backend.probes import Ledger
from labbook.backend.numerics import Numerics
from labbook.scene.packing import Packing
from labbook.scene import HertzMindlin, Primitives, Scene, Spheres
from labbook_numba import Backend, build

grains = Spheres(diameter=3e-3, density=2500, count=2)
law = HertzMindlin(shear_modulus=1e6, poisson_ratio=0.25, restitution=0.5)
scene = Scene(grains=grains, contact=law, container=Primitives(), gravity=0)
x = np.array([[0, 0, 0], [3.001e-3, 0, 0]])
v = np.array([[0.1, 0, 0], [-0.1, 0, 0]])
backend, numerics = Backend(), Numerics(dt=1e-5)
spec = backend.specialise(scene, numerics)
cached = backend.compiled(spec)
ensemble = backend.open(spec)
member = ensemble.admit(scene, numerics, Packing(x=x, v=v, omega=np.zeros((2, 3))))
ensemble.advance(1)
assert backend.compiled(spec)
module = build.kernels(spec)
stats = module.advance.stats
print(json.dumps({
    "cached": cached,
    "hits": sum(stats.cache_hits.values()),
    "misses": sum(stats.cache_misses.values()),
    "module": module.__name__,
    "file": module.__file__,
    "v": ensemble.packing(member).v[1, 0],
}))
"""


def collide(sources: Path, cache: Path) -> dict:
    """In a process of its own: the collision, and what Numba's cache did."""
    environment = {**os.environ, "LABBOOK_CACHE": str(cache)}
    environment["PYTHONPATH"] = os.pathsep.join([str(sources), str(ROOT)])
    done = subprocess.run([sys.executable, "-c", COLLISION], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout) | {"said": done.stderr}


@pytest.fixture
def sources(tmp_path) -> Path:
    """A copy of the backend and its physics that may be edited."""
    folder = tmp_path / "sources"
    for package in ("labbook_dem", "labbook_numba"):
        shutil.copytree(ROOT / "backends" / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
    return folder


@pytest.mark.ring
@pytest.mark.slow
def test_a_second_process_hits_and_an_edited_law_misses(sources, tmp_path):
    cache = tmp_path / "cache"
    first = collide(sources, cache)
    assert first["misses"] > 0
    assert not first["cached"]
    assert Path(first["file"]).is_relative_to(cache)
    assert first["v"] == pytest.approx(0.5 * 0.1, rel=0.02), "a seventieth of a collision is a long step"

    second = collide(sources, cache)
    assert second["hits"] > 0
    assert second["cached"]
    assert second["misses"] == 0
    assert second["module"] == first["module"]
    assert second["v"] == first["v"]

    law = sources / "labbook_dem/laws/hertz.py"
    text = law.read_text(encoding="utf-8")
    edited = text.replace("c[MODULUS] * sqrt(rs * delta)", "real(4.0) * c[MODULUS] * sqrt(rs * delta)")
    assert edited != text
    law.write_text(edited, encoding="utf-8")
    third = collide(sources, cache)
    assert third["misses"] > 0
    assert not third["cached"]
    assert third["module"] != first["module"]
    assert third["v"] != first["v"]

    # the old law is still there for whoever has it
    law.write_text(text, encoding="utf-8")
    fourth = collide(sources, cache)
    assert (fourth["misses"], fourth["v"]) == (0, first["v"])

    # damaged code is compiled again
    files = sorted(Path(first["file"]).parent.rglob("*.nbc"))
    for file in files:
        file.write_bytes(file.read_bytes()[:1000])
    fifth = collide(sources, cache)
    assert (fifth["hits"], fifth["v"]) == (0, first["v"])
    wanted = {f"{file}: compiled code is damaged: it is compiled again" for file in files}
    assert set(fifth["said"].splitlines()) <= wanted, "of those that were needed"
    assert len(fifth["said"].splitlines()) > 0
    sixth = collide(sources, cache)
    assert (sixth["misses"], sixth["said"], sixth["v"]) == (0, "", first["v"])


def key_of(**changes) -> str:
    from labbook_numba import build

    return build.digest(build.module_text(spec("hertz-mindlin", **changes)))


def test_features_and_versions_are_part_of_the_key(monkeypatch):
    from labbook_numba import build

    plain = key_of()
    assert key_of() == plain
    assert key_of(FRICTION=True) != plain
    assert build.digest(build.module_text(spec("linear"))) != plain
    monkeypatch.setattr(build.numba, "__version__", "0.0")
    assert key_of() != plain
    monkeypatch.undo()
    monkeypatch.setattr(build.llvmlite, "__version__", "0.0")
    assert key_of() != plain


@pytest.mark.parametrize("name", ["lanes", "meeting", "rows", "squeeze", "vector"])
def test_registers_are_part_of_the_key(name, monkeypatch, tmp_path):
    """Instructions that kernels import are not in their text, and yet decide what they compile to."""
    import importlib

    module = importlib.import_module(f"labbook_numba.{name}")
    plain = key_of()
    edited = tmp_path / f"{name}.py"
    edited.write_text(Path(str(module.__file__)).read_text(encoding="utf-8") + "# edited\n", encoding="utf-8")
    monkeypatch.setattr(module, "__file__", str(edited))
    assert key_of() != plain


def test_where_the_cache_is(monkeypatch, tmp_path):
    from labbook_dem.generated import cache_folder

    monkeypatch.setenv("LABBOOK_CACHE", str(tmp_path / "own"))
    assert cache_folder("numba") == tmp_path / "own"
    monkeypatch.delenv("LABBOOK_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert cache_folder("numba") == tmp_path / "xdg/labbook/numba"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert cache_folder("numba") == tmp_path / "home/.cache/labbook/numba"
