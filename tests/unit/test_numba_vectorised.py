"""The law loops use the widest registers that the compiler uses at all; a change that loses this costs most of the
speed."""

import re

import numpy as np
import pytest

pytest.importorskip("numba")

from numba import njit

pytestmark = pytest.mark.compiles


@njit(error_model="numpy")
def roots(numbers, into):
    """The plainest loop over roots."""
    for k in range(numbers.size):
        into[k] = np.sqrt(numbers[k])


def register() -> str:
    """The widest registers that the compiler takes for roots on this processor: their name in assembly.

    Not on all that have registers of 512 bits does it use them: on some the clock would slow down.
    """
    roots(np.ones(64), np.ones(64))
    text = "\n".join(roots.inspect_asm().values())
    for wide in ("zmm", "ymm"):
        if re.search(rf"\tvsqrtpd\t[^\n]*%{wide}", text):
            return wide
    pytest.skip("the compiler uses no registers of 256 bits or more on this processor")


def assembly(law: str, precision: str, name: str, kinds: int, folder, monkeypatch) -> str:
    """What a law loop compiles to, in a cache of its own (of cached code there is no assembly)."""
    from labbook_numba import build

    monkeypatch.setenv("LABBOOK_CACHE", str(folder))
    build.kernels.cache_clear()
    switches = dict.fromkeys(build.SWITCHES, True) | {"RODS": False, "VARIED": kinds > 1, "KINDS": kinds}
    module = build.kernels(law, precision, tuple(switches.items()))
    real = module.real if precision == "double" else np.float32
    numbers = [np.float32(1) if real is np.float32 else 1.0] * 5
    kernel = getattr(module, name)
    arguments = numbers[:4] if name == "pair_law" else numbers

    @njit
    def caller(b, count, coefficients, numbers):  # kernels are called by kernels only
        kernel(b, count, coefficients, *numbers)

    block = np.ones(20_000, np.float32 if precision == "mixed" else float)
    caller(block, np.uint64(64), (1.0,) * 8, tuple(arguments))
    build.kernels.cache_clear()
    return "\n".join(caller.inspect_asm().values())


ROOTS = {"hertz-mindlin": 7, "linear": 2}
"""Square roots in a law with its geometry and rolling resistance, at least."""


@pytest.mark.parametrize("kinds", [1, 2])
@pytest.mark.parametrize("name", ["pair_law", "wall_law"])
@pytest.mark.parametrize("precision", ["double", "mixed"])
@pytest.mark.parametrize("law", ROOTS)
def test_roots_are_taken_in_wide_registers(law, precision, name, kinds, tmp_path, monkeypatch):
    wide = register()
    text = assembly(law, precision, name, kinds, tmp_path, monkeypatch)
    kind = "d" if precision == "double" else "s"
    found = re.findall(rf"\tvr?sqrt(?:14)?p{kind}\t[^\n]*%{wide}", text)
    assert len(found) >= ROOTS[law], f"{len(found)} square roots in {wide} registers"
    products = re.findall(rf"\tv(?:mul|fn?m\w+)p{kind}\t[^\n]*%{wide}", text)
    assert len(products) > 30
