"""Names that a generated module defines as constants; here only so that kernels read and type-check as Python."""

from collections.abc import Callable
from typing import Any, TypeVar

from labbook_dem.coefficients import COEFFICIENTS  # noqa: F401 - part of the vocabulary of kernels
from labbook_dem.walls import MESH_NUMBER  # noqa: F401 - part of the vocabulary of kernels
from labbook_dem.words import FRICTION  # noqa: F401 - part of the vocabulary of kernels

from labbook_numba.state import (  # noqa: F401 - part of the vocabulary of kernels
    BLOCK,
    BODY,
    BORROWED,
    BROKEN,
    CELLS,
    CROSSED,
    DEEPEST,
    DOMAINS,
    FAIL_GRAIN,
    FAIL_VALUE,
    FASTEST2,
    FIRST,
    FIRST_PAIR,
    GHOSTS,
    GRAINS,
    LAST,
    LAST_PAIR,
    LEAVING,
    LOAD,
    MAX_OVERLAP,
    MOVED,
    NUMBER,
    OVERLAP,
    PAD,
    PAIRS,
    REBUILDS,
    RODS,
    ROLL,
    SPARE_CELLS,
    SPEED,
    STEP,
    STRIDE,
    TOUCHING,
    WANT_PAIRS,
    WANT_WALLS,
    WORK,
    A,
    F,
    M,
    P,
    Q,
    T,
    U,
    V,
    W,
    X,
)

Function = TypeVar("Function", bound=Callable)


def kernel(function: Function) -> Function:
    """Marks a function compiled on its own, with arrays as arguments, that other kernels call."""
    return function


def entry(function: Function) -> Function:
    """Marks a kernel that Python calls: the compiled code of those is what is kept on disk."""
    return function


MOVING = True  # some wall's surface moves
ORIENTED = True  # grains have an orientation
GRAIN, WALL_PARTS, SPRING, SPRING_KEPT = RODS.GRAIN, RODS.WALL_PARTS, RODS.SPRING, RODS.SPRING_KEPT
CROSSING = True  # the first passage of grains through a plane is recorded
OUTLET = True  # grains far below the outlet are dropped
LEDGER = True  # contact work and touching contacts are added up
ANY_WALLS = True
MESHES = True  # some wall consists of triangles
POSES = True  # parts move as a whole
PLATE_PARTS = RODS.WALL_PARTS  # parts of a rod at a wall without triangles
KINDS = 1  # kinds of grains
LANES = 16  # contacts that a law is computed for at a time: as many as compilers were seen to take together

DONE, REBUILD, BAD_STATE, BAD_SPEED, BAD_OVERLAP = range(5)

int64: Any = int
uint64: Any = int
