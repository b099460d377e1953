"""Names that a generated module defines as constants; they exist here so that kernels read and type-check as Python."""

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
    CLUMP,
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
    """Mark a function that is compiled on its own, takes arrays and is called by other kernels."""
    return function


def entry(function: Function) -> Function:
    """Mark a kernel that Python calls: only the compiled code of these is cached on disk."""
    return function


MOVING = True  # some wall's surface moves
ORIENTED = True  # rows of grains have an orientation
CLUMPS = True  # they are the spheres of clumps
GRAIN, WALL_PARTS, SPRING, SPRING_KEPT = RODS.GRAIN, RODS.WALL_PARTS, RODS.SPRING, RODS.SPRING_KEPT
CROSSING = True  # the first passage of grains through a plane is recorded
OUTLET = True  # grains far below the outlet are dropped
LEDGER = True  # contact work and numbers of contacts are recorded
ANY_WALLS = True
MESHES = True  # some wall consists of triangles
POSES = True  # parts move as a whole
PLATE_PARTS = RODS.WALL_PARTS  # parts of a rod at a wall without triangles
KINDS = 1  # kinds of grains
LANES = 16  # contacts a pass of the law loop: the largest number that compilers were seen to combine

DONE, REBUILD, BAD_STATE, BAD_SPEED, BAD_OVERLAP = range(5)

int64: Any = int
uint64: Any = int
