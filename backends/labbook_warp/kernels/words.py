"""Names that a generated module defines; here only so that kernels read and type-check as Python."""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

from labbook_dem.walls import MESH_NUMBER as MESH_NUMBER

from labbook.scene.grains import MOST_SPHERES as MOST_SPHERES

F = TypeVar("F", bound=Callable)


class wide4(NamedTuple):
    """Quaternion in double precision."""

    w: float
    x: float
    y: float
    z: float


class quanta3(NamedTuple):
    """Vector of integers."""

    x: int
    y: int
    z: int


class word(tuple):
    """Sixteen bytes: four numbers in single precision, or two in double."""

    def __new__(cls, *numbers: float):
        return super().__new__(cls, numbers)


def kernel(function: F) -> F:
    """Mark a kernel with one thread a grain, a cell or a member."""
    return function


def hot_kernel(function: F) -> F:
    """Mark the kernel of a step. Its registers are capped, so that enough threads are resident."""
    return function


def wall_kernel(function: F) -> F:
    """Mark the kernel of contacts with walls. Its registers are capped less tightly."""
    return function


def rare_func(function: F) -> F:
    """Mark a function that few grains call. It is not inlined, so that it takes no registers from the others."""
    return function


wp: Any = None  # Warp itself
int64 = uint32 = float32 = Any
Words = Vectors = Wides = Wides3 = Wides4 = Reals = Reals4 = Floats = Ints = Longs = Bits = Coefs = Motions = Bodies = (
    Quanta
) = Table = Tables = Any
real4: Any = None
widen: Any = None
load_word: Any = None
store_word: Any = None
load_int: Any = None
load_wide: Any = None
load_bits: Any = None
load_real: Any = None
quotient: Any = None
load_four: Any = None
store_four: Any = None
load_wide4: Any = None
store_wide4: Any = None
load_int_now: Any = None
load_bits_now: Any = None
add_lanes: Any = None
other_of_two: Any = None
prefetch_lists: Any = None
this_thread: Any = None
wait_for_all: Any = None
or_lanes: Any = None
max_lanes: Any = None
first_bit: Any = None
without_first: Any = None
joined: Any = None
halved: Any = None

MOVING = True
ORIENTED = False  # rows of grains have an orientation
CLUMPS = False  # they are the spheres of clumps
CROSSING = True
OUTLET = True
LEDGER = True
ANY_WALLS = True
TOGETHER = True  # a wall finds both edges that a rod may lie across in one search
OTHERS_TOGETHER = False  # a wall that is not a frustum does
FRUSTUM = 2  # number of this kind of walls
WALL_NUMBERS = 6  # numbers of a wall
LISTED = False  # members have more walls than a grain has entries for

FIRST_PARTS = 0x01010101  # bits of the first entry of each wall, where walls of triangles have several

APART = False  # contacts with walls have a kernel of their own
KINDS = 1  # species of grains of a member
LANES = 1  # threads that share a grain: several where grains are few
FINE = False  # forces are computed and summed in double precision
UNIFORM = False  # all members have the same material
SHARED = False  # several threads share a grain
WORDS = 4  # that a grain shows to others
WALL_PARTS = 1  # points, the parts of a rod, at which a grain may touch one wall
PLATE_PARTS = 1  # the same of walls that are no mesh
POSES = False  # whether parts of a container move as a whole
PREFETCH = 0  # entries of lists that the step prefetches
EDGES = 0  # bits of the parts that lie across an edge
LOOKS = 16  # gaps between points of a rod that are looked at to tell how near an edge is
TORQUES = True  # whether contacts turn grains
REACH = 1  # how many cells away a neighbour may be
COLUMNS = 13  # of a row of crossings
REPORTED = 6  # numbers that a beat leaves behind for each slot
PARKED = -1.0e9
"""Height z [m] of the rows of grains that have left."""
BAD_STATE, BAD_SPEED, BAD_FORCE, BAD_OVERLAP = 0, 1, 2, 3
"""Failures in the order of their checks: of motion after a step, of contacts in the next."""
NEVER_LISTED = 1.0e30
"""Square of a distance [m^2] beyond that of any neighbours."""
NO_NUMBER = 1.0e30
"""Overlap [m] that stands for a force that is NaN, or too large for the quanta of sums."""
NO_FAILURE = (1 << 62) - 1
MOST_GRAINS = 1 << 24
"""Largest number of grains of a member: a failure is one word of 24 bits for the grain, 2 for the kind, the rest for
the step."""
CROWDED = 2.0e30
"""An overlap [m] that stands for more contacts with a mesh than there is room for."""
MESH_LISTED = 16
"""Features of a mesh in the list of a grain, at most; one that is near more takes those of a cell."""
MOST_CONTACTS = 32
"""Entries of a grain at walls: bits of a mask."""
