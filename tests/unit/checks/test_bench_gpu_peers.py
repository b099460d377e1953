"""The benchmark beside other GPU codes, without a GPU: its scene, and rows of a code that only moves grains."""

import sys

import gpu
import gpu_peers
import numpy as np
import pytest

DEME = """
import json, sys
import numpy as np
__version__ = "falling"
class Grains:
    def __init__(self, x): self.x = np.array(x)
    def SetVel(self, v): pass
    def SetFamily(self, family): pass
    def Positions(self): return self.x.tolist()
class DEMSolver:
    def __init__(self, gpus): self.grains = None
    def __getattr__(self, name): return lambda *given: Grains([[0, 0, 0]])
    def AddClumps(self, kind, x):
        self.grains = Grains(x)
        return self.grains
    def Track(self, grains): return grains
    def DoDynamicsThenSync(self, seconds): self.grains.x[:, 2] -= 1.0 * seconds
"""
"""A module in place of DEM-Engine, in which all grains fall at 1 m/s."""


def column() -> np.ndarray:
    """A bed that fills its box evenly from 0.02 m to 0.22 m."""
    x = np.zeros((gpu_peers.FIRST_BED, 3))
    x[:, 2] = np.linspace(0.02, 0.22, len(x), endpoint=False)
    return x


def test_rows_of_a_peer_are_what_its_grains_do(tmp_path, monkeypatch):
    """At 1 m/s the bed has fallen 0.02 m after relaxing and 0.07 m when timing begins; then 50 000 grains pass a
    second, until the bed has passed."""
    (tmp_path / "deme.py").write_text(DEME, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    (row,) = gpu.theirs(sys.executable, "deme", column(), gpu_peers.FIRST_BED, 2, 100.0)
    assert row["version"] == "falling"
    one_grain = 1 / (gpu_peers.STEPS * gpu_peers.DT)
    assert row["outflows"] == pytest.approx([50_000, 50_000], abs=2 * one_grain)
    assert min(row["rates"]) > 0
    assert row["ended"] == ""


def test_a_peer_that_fails_is_an_error_and_one_that_hangs_is_stopped(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    (tmp_path / "deme.py").write_text("raise RuntimeError('no driver')", encoding="utf-8")
    with pytest.raises(SystemExit, match=r"(?s)deme with 10000 grains.*no driver"):
        list(gpu.theirs(sys.executable, "deme", column(), gpu_peers.FIRST_BED, 2, 100.0))
    (tmp_path / "deme.py").write_text("import time; time.sleep(1000)", encoding="utf-8")
    (row,) = gpu.theirs(sys.executable, "deme", column(), gpu_peers.FIRST_BED, 2, 0.2)
    assert (row["rates"], row["ended"]) == ([], "not finished in 0.2 s")


@pytest.mark.parametrize("grains", gpu_peers.SIZES)
def test_larger_boxes_are_filled_by_copies_of_the_first_bed(grains):
    size = gpu_peers.SIZES[grains]
    x = gpu_peers.side_by_side(column(), size)
    assert len(x) == grains
    width, depth, _ = gpu_peers.SIZES[gpu_peers.FIRST_BED].metres
    assert abs(x[:, :2]).max(axis=0) + np.array([width, depth]) / 2 == pytest.approx(np.array(size.metres[:2]) / 2)
    assert len(gpu.box(grains).container.walls()) > 0


def test_the_floor_of_signed_distances_is_that_of_two_plates():
    """Above a plate the height, in the slot the distance to the nearer edge or face; negative within a plate."""
    size = gpu_peers.SIZES[gpu_peers.FIRST_BED]
    values, origin, spacing = gpu_peers._slotted_floor(size, 0.13)
    half = size.metres[2] / 2

    def at(x: float, z: float) -> float:
        return float(values[round((x - origin[0]) / spacing[0]), 0, round((z - origin[2]) / spacing[2])])

    assert at(half + 0.005, 0.01) == pytest.approx(0.01, rel=1e-5)
    assert at(0, -0.01) == pytest.approx(half, rel=1e-5)
    assert at(0, 0.005) == pytest.approx(np.hypot(half, 0.005), rel=1e-5)
    assert at(-half - 0.005, -0.002) == pytest.approx(-0.002, rel=1e-5)


@pytest.mark.parametrize("sign", [-1, 1])
def test_the_faces_of_a_plate_look_up_and_into_the_slot(sign):
    width, depth, slot = gpu_peers.SIZES[gpu_peers.FIRST_BED].metres
    lines = gpu_peers._plate(sign, width, depth, slot).split("\n")
    x = np.array([line.split()[1:] for line in lines if line.startswith("v")], float)
    faces = np.array([line.split()[1:] for line in lines if line.startswith("f")], int) - 1
    a, b, c = (x[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    top = (a[:, 2] == 0) & (b[:, 2] == 0) & (c[:, 2] == 0)
    assert normal[top] == pytest.approx(np.tile([0, 0, 1.0], (top.sum(), 1)))
    assert normal[~top] == pytest.approx(np.tile([-sign, 0, 0.0], ((~top).sum(), 1)))
    assert top.any()
    assert (~top).any()
