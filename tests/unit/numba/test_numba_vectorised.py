"""The law loops use the widest registers that the compiler uses at all; a change that loses this costs most of the
speed."""

import re

import numpy as np
import pytest
from specs import spec

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


def assembly(law: str, precision: str, kinds: int) -> dict[str, str]:
    """What the law loops of one kernel module compile to, by name, each in a caller of its own. That of mixtures has
    rolling springs.

    They are compiled into what calls them, and not kept with the kernels: of cached code there is no assembly.
    """
    from labbook_dem.features import SWITCHES
    from labbook_dem.walls import WALLS
    from labbook_numba import build

    on = dict.fromkeys(SWITCHES, True) | {"ORIENTED": False, "VARIED": kinds > 1, "KINDS": kinds}
    on |= {"ROLLING": kinds == 1, "ROLLING_SPRING": kinds > 1}
    module = build.kernels(spec(law, precision, walls=tuple(WALLS), **on))
    real = module.real if precision == "double" else np.float32
    numbers = [np.float32(1) if real is np.float32 else 1.0] * 7
    block = np.ones(20_000, np.float32 if precision == "mixed" else float)
    found = {}
    pairs, walls, vec3 = module.pair_law, module.wall_law, module.vec3

    @njit
    def of_pairs(b, count, coefficients, numbers):  # kernels are called by kernels only
        pairs(b, count, coefficients, *numbers)

    @njit
    def of_walls(b, count, coefficients, numbers):
        radius, mass, inertia, dt, spin, stiffness, damping = numbers
        spins = vec3(spin, spin, spin)
        walls(b, count, coefficients, radius, mass, inertia, dt, spins, stiffness, damping)

    for name, caller, given in (("pair_law", of_pairs, numbers[:6]), ("wall_law", of_walls, numbers)):
        caller(block, np.uint64(64), (1.0,) * 8, tuple(given))
        found[name] = "\n".join(caller.inspect_asm().values())
    return found


ROOTS = {"hertz-mindlin": 7, "linear": 2}
"""Square roots in a law with its geometry and rolling resistance, at least."""
LAWS = [
    pytest.param("hertz-mindlin", "double", 1),
    pytest.param("hertz-mindlin", "mixed", 2),
    pytest.param("linear", "double", 2),
    pytest.param("linear", "mixed", 1),
    *(pytest.param(*one, marks=pytest.mark.ring) for one in (
        ("hertz-mindlin", "double", 2), ("hertz-mindlin", "mixed", 1), ("linear", "double", 1), ("linear", "mixed", 2),
    )),
]  # fmt: skip
"""A kernel of each law and precision, of equal grains and of mixtures in turn; all others in the ring."""


@pytest.mark.parametrize(("law", "precision", "kinds"), LAWS)
def test_roots_are_taken_in_wide_registers(law, precision, kinds):
    wide = register()
    kind = "d" if precision == "double" else "s"
    for name, text in assembly(law, precision, kinds).items():
        found = re.findall(rf"\tvr?sqrt(?:14)?p{kind}\t[^\n]*%{wide}", text)
        assert len(found) >= ROOTS[law], f"{name}: {len(found)} square roots in {wide} registers"
        products = re.findall(rf"\tv(?:mul|fn?m\w+)p{kind}\t[^\n]*%{wide}", text)
        assert len(products) > 30, name
