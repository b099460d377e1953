"""From features to compiled kernels: one generated module per specialisation, cached on disk.

Numba's own cache does not notice when an imported law was edited, and never hits for closures. So each
specialisation is written out as a module of its own, whose folder is named by a hash of all that it is made of: the
sources of physics and kernels, the features, and the versions of Python, Numba and llvmlite. Numba keeps its compiled
code beside it, told apart by CPU.
"""

import ctypes
import platform
from functools import lru_cache
from pathlib import Path
from types import ModuleType

import llvmlite
import numba
from labbook_dem import contact, generated, motion, rotation, segments, source
from labbook_dem import rods as rod_physics
from labbook_dem import spheres as sphere_physics
from labbook_dem.laws import LAWS
from labbook_dem.walls import frustum, plane, strip

from labbook_numba import dialect, lanes, meeting, rows, squeeze, state, vector
from labbook_numba.kernels import (
    blocks,
    bodies,
    cells,
    meet,
    move,
    near,
    neighbours,
    pairs,
    rod_observe,
    rod_pairs,
    rod_walls,
    rods,
    sphere_observe,
    sphere_pairs,
    sphere_walls,
    spheres,
    step,
    surfaces,
    transfer,
)
from labbook_numba.kernels import features as vocabulary

PLACES = ("BLOCK", "STRIDE", "GRAIN", "LOAD", "SPRING", "BODY", "X", "V", "W", "U", "P", "Q", "A", "M", "F", "T")

SHARED = [
    contact,
    motion,
    plane,
    strip,
    frustum,
    sphere_physics,
    cells,
    surfaces,
    blocks,
    bodies,
    transfer,
]
OF_SPHERES = [sphere_pairs, sphere_walls, spheres, sphere_observe]
OF_RODS = [segments, rotation, rod_physics, rod_pairs, rod_walls, rods, rod_observe]
OF_ALL = [pairs, near, move, neighbours, meet, step]


_ARENA_MAX = -8  # glibc's M_ARENA_MAX


def share_one_heap() -> None:
    """Let all threads allocate from one heap, where the C library is glibc.

    LLVM's memory is given back to the heap of the thread that compiled, where another thread that compiles cannot use
    it: with two threads the process would grow by 24 MB more. Kernels allocate nothing, so they do not wait for it.
    """
    if platform.libc_ver()[0] == "glibc":
        ctypes.CDLL(None).mallopt(_ARENA_MAX, 1)


share_one_heap()


def module_text(law: str, precision: str, switches: dict[str, int]) -> str:
    """Source of the kernel module of one specialisation."""
    layout, kind = (state.RODS, OF_RODS) if switches["RODS"] else (state.SPHERES, OF_SPHERES)
    layout = state.MIXTURES if switches["VARIED"] else layout
    # the numbers by which host and kernels agree on places and return codes; those that kernels index with are unsigned
    shared = _numbers(state) | layout._asdict()
    places = {name: value for module in (blocks, *kind) for name, value in _numbers(module).items()}
    places |= {name: shared[name] for name in PLACES}
    constants: dict[str, object] = {**_numbers(vocabulary), **shared, **switches}
    constants |= {name: _Unsigned(value) for name, value in places.items() if name in PLACES or name not in constants}
    del constants["LANES"]  # the header's
    modules = [LAWS[law], *SHARED, *kind, *OF_ALL]
    text = source.generate(dialect.header(precision), constants, modules)
    # annotations name the backend's Python types, which compiled code has no use for
    return text.replace(": State", "").replace(": Params", "").replace(": Lists", "").replace(": Grid", "")


class _Unsigned(int):
    """An offset: a signed one in its place would undo the vectorisation of the law loop."""

    def __repr__(self) -> str:
        return f"uint64({int(self)})"


def _numbers(module: ModuleType) -> dict[str, int]:
    return {name: value for name, value in vars(module).items() if name.isupper() and type(value) is int}


COMPILED_IN = (vector, lanes, rows, squeeze, meeting, state)
"""Modules that a kernel module imports."""


def digest(text: str) -> str:
    """Hash of a kernel module and of everything else that decides what it compiles to."""
    sources = [Path(str(module.__file__)).read_text(encoding="utf-8") for module in COMPILED_IN]
    return generated.digest(text, numba.__version__, llvmlite.__version__, platform.python_version(), *sources)


@lru_cache(maxsize=64)
@generated.alone
def kernels(law: str, precision: str, switches: tuple[tuple[str, int], ...]) -> ModuleType:
    """The kernel module of one specialisation, written if it is not there yet. Compiling happens at first use."""
    text = module_text(law, precision, dict(switches))
    key = digest(text)
    return generated.load(f"labbook_numba_{key}", text, generated.cache_folder("numba") / key)
