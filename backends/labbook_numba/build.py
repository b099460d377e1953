"""From features to compiled kernels: one generated module a specialisation, cached on disk.

Numba's own cache does not notice an edited law in an imported module, and never hits for closures. So each
specialisation is written as a module of its own. Its folder is named by a hash of the sources of physics and kernels,
the features, and the versions of Python, Numba and llvmlite. Numba caches its compiled code beside it, by type of CPU.
"""

import ctypes
import platform
import re
from functools import lru_cache
from pathlib import Path
from types import ModuleType

import llvmlite
import numba
from labbook_dem import contact, dispatch, generated, mesh, mesh_rods, motion, source
from labbook_dem import poses as formulas_of_poses
from labbook_dem import traction as traction_sums
from labbook_dem.features import constants
from labbook_dem.formulas import hold
from labbook_dem.laws import modules_of
from labbook_dem.shapes import SHAPES as PHYSICS
from labbook_dem.walls import WALLS

from labbook.backend import Spec
from labbook_numba import dialect, lanes, meeting, rows, squeeze, state, vector
from labbook_numba.kernels import (
    blocks,
    bodies,
    cells,
    meet,
    mesh_walls,
    move,
    near,
    neighbours,
    observe,
    pairs,
    poses,
    rod_meshes,
    shape,
    step,
    surfaces,
    traction,
    transfer,
)
from labbook_numba.kernels import features as vocabulary
from labbook_numba.shapes import SHAPES

INDICES = ("BLOCK", "STRIDE", "GRAIN", "LOAD", "SPRING", "ROLL", "BODY")
INDICES += ("X", "V", "W", "U", "P", "Q", "A", "M", "F", "T")

BEFORE = (cells, blocks, bodies, transfer)
AFTER = (pairs, near, move, neighbours, meet, step, observe, traction)
"""Kernels common to all shapes, before and after those of a shape in the generated module."""


_ARENA_MAX = -8  # glibc's M_ARENA_MAX


def share_one_heap() -> None:
    """Let all threads allocate from one heap, with glibc.

    LLVM's memory is returned to the heap of the compiling thread, where another compiling thread cannot use it: two
    threads would need 24 MB more. Kernels allocate nothing, so they do not wait for the heap.
    """
    if platform.libc_ver()[0] == "glibc":
        ctypes.CDLL(None).mallopt(_ARENA_MAX, 1)


share_one_heap()


def module_text(spec: Spec) -> str:
    """Source of the kernel module of one specialisation."""
    kinds, grains = spec.feature("walls"), spec.feature("shape")
    shape_kernels = SHAPES[grains]
    hold(f"the shape {grains} in labbook_numba", shape, shape_kernels.kernels)
    layout = state.MIXTURES if spec.feature("VARIED") else shape_kernels.layout
    layout = layout.with_rolling_springs() if spec.feature("ROLLING_SPRING") else layout
    layout = layout.with_meshes() if spec.feature("MESHES") else layout
    # places and return codes, shared by host and kernels; indices are unsigned, see `_Unsigned`
    shared = _numbers(state) | layout._asdict()
    indices = {name: value for module in (blocks, *shape_kernels.kernels) for name, value in _numbers(module).items()}
    indices |= {name: shared[name] for name in INDICES}
    numbers_by_name: dict[str, object] = {**_numbers(vocabulary), **shared, **constants(spec)}
    numbers_by_name |= {
        name: _Unsigned(value) for name, value in indices.items() if name in INDICES or name not in numbers_by_name
    }
    del numbers_by_name["LANES"]  # the header's
    physics = [
        contact,
        *modules_of(str(spec.feature("law"))),
        motion,
        *(WALLS[kind] for kind in kinds),
        *PHYSICS[grains].physics,
        *([mesh, *([mesh_rods] if layout.ORIENTED else []), formulas_of_poses] if spec.feature("MESHES") else []),
        traction_sums,
    ]
    walls = dispatch.functions(kinds, rods=layout.ORIENTED, at="walls[{k}]", looks_first=True)
    numbers_by_name["WALL_NUMBERS"] = width = max(map(dispatch.how_many, kinds), default=1)
    numbers = f"@func\ndef wall_numbers(walls, w):\n    return {''.join(f'walls[w, {k}], ' for k in range(width))}\n"
    meshes = [poses, mesh_walls, *([rod_meshes] if layout.ORIENTED else [])] if spec.feature("MESHES") else []
    modules = [surfaces, numbers, walls, *BEFORE, *meshes, *shape_kernels.kernels, *AFTER]
    text = source.generate(dialect.header(spec.feature("precision")), numbers_by_name, physics, modules)
    # annotations name the backend's Python types, which compiled code has no use for
    return re.sub(r": (State|Params|Lists|Grid|Numbers)\b", "", text)


class _Unsigned(int):
    """Unsigned offset: a signed index would prevent the vectorisation of the law loop."""

    def __repr__(self) -> str:
        return f"uint64({int(self)})"


def _numbers(module: ModuleType) -> dict[str, int]:
    return {name: value for name, value in vars(module).items() if name.isupper() and type(value) is int}


COMPILED_IN = (vector, lanes, rows, squeeze, meeting, state)
"""Modules that kernel modules import."""


def digest(text: str) -> str:
    """Hash of a kernel module and of all else that decides its compiled code."""
    sources = [Path(str(module.__file__)).read_text(encoding="utf-8") for module in COMPILED_IN]
    return generated.digest(text, numba.__version__, llvmlite.__version__, platform.python_version(), *sources)


@lru_cache(maxsize=64)
@generated.alone
def kernels(spec: Spec) -> ModuleType:
    """Import the kernel module of one specialisation, written if necessary. It is compiled at first use."""
    text = module_text(spec)
    key = digest(text)
    return generated.load(f"labbook_numba_{key}", text, generated.cache_folder("numba") / key)


def compiled(spec: Spec) -> bool:
    """Return True if compiled code of a specialisation is cached."""
    key = digest(module_text(spec))
    return next((generated.cache_folder("numba") / key).glob("__pycache__/*.nbi"), None) is not None
