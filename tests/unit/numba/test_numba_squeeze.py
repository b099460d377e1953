"""What a mask picks out of eight is written side by side, by every kind of processor that code is made for."""

import os
import platform
import subprocess
import sys

import pytest

pytest.importorskip("numba")

WRITES = """
import numpy as np
from numba import njit, uint64
from labbook_numba.lanes import eight_at
from labbook_numba.squeeze import how_many, positive, squeeze, squeeze_numbers, squeeze_indices

@njit
def go(numbers, keep, into, whole, of_whole, places, start):
    picked = positive(eight_at(keep, uint64(0)))
    squeeze(into, uint64(1), eight_at(numbers, uint64(0)), picked)
    squeeze_numbers(of_whole, uint64(1), whole, uint64(2), picked)
    squeeze_indices(places, uint64(1), start, picked)
    return how_many(picked)

rng = np.random.default_rng(1)
for kind in (np.float64, np.float32):
    for mask in range(256):
        keep = np.array([mask >> k & 1 for k in range(8)]) == 1
        numbers, whole = rng.normal(size=8), rng.integers(0, 1 << 31, 12).astype(np.int32)
        into, of_whole, places = np.full(12, -7, kind), np.full(12, -7, np.int32), np.full(12, -7, np.int32)
        many = go(numbers, np.where(keep, 1.0, -1.0), into, whole, of_whole, places, np.uint64(1000))
        assert many == keep.sum()
        for found, wanted in (
            (into, numbers[keep].astype(kind)),
            (of_whole, whole[2:10][keep]),
            (places, 1000 + np.flatnonzero(keep)),
        ):
            assert (found[1 : 1 + many] == wanted).all(), (kind, mask, found, wanted)
            assert found[0] == -7 and (found[9:] == -7).all(), (kind, mask, found)
code = "".join(go.inspect_asm().values())
print("permutes" if "vpermd" in code or "vpermps" in code else "compresses" if "vpcompressd" in code else "neither")
"""


def written(**processor: str) -> str:
    """How the code for a processor does it, once it has written all masks right."""
    environment = {**os.environ, **processor}
    done = subprocess.run([sys.executable, "-c", WRITES], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.compiles
def test_what_is_picked_is_written_on_this_processor():
    assert written() in ("permutes", "compresses", "neither")


@pytest.mark.compiles
@pytest.mark.skipif(platform.machine().lower() not in ("x86_64", "amd64"), reason="of x86-64 processors")
@pytest.mark.parametrize(
    ("name", "features", "how"),
    [("haswell", "+avx2,+fma,+bmi,+bmi2,+popcnt", "permutes"), ("x86-64", "", "neither")],
)
def test_what_is_picked_is_written_on_others(name, features, how):
    assert written(NUMBA_CPU_NAME=name, NUMBA_CPU_FEATURES=features) == how
