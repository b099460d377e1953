"""Arrays of a member that kernels work on."""

from typing import NamedTuple

import numpy as np
from labbook_dem import mesh  # whose numbers are not among those of this module
from labbook_dem.reading import crossing_columns

from labbook.scene.part_motion import POSE_COLUMNS

# counters, in State.count
GRAINS, PAIRS, STEP, CROSSED, REBUILDS, TOUCHING, FAIL_GRAIN, LEAVING, WANT_PAIRS, WANT_WALLS = range(10)
COUNTERS = 10
# sums and clocks, in State.sums
MOVED, WORK, MAX_OVERLAP, FAIL_VALUE, DEEPEST, FASTEST2 = range(6)
SUMS = 6
# FASTEST2 and DEEPEST: square of the largest speed and largest overlap so far; older checkpoints lack both
OLDER_SUMS = 4
# in State.domain: number of the domain, number of domains; half-open ranges of its rows and of its pairs; number of its
# borrowed pairs
NUMBER, DOMAINS, FIRST, LAST, FIRST_PAIR, LAST_PAIR, BORROWED = range(7)
# columns of State.shared_values
OVERLAP, SPEED = range(2)
CACHE_LINE = 8  # doubles in a cache line: each domain writes to a line of its own, without false sharing
BROKEN = 1 << 62  # value of the counter of arrivals after a domain has failed: no domain waits any more
BLOCK = 384  # contacts that a law works on at a time
CELLS, SPARE_CELLS = 4, 64  # a grid has at most CELLS n + SPARE_CELLS cells for n grains
PAD = 16  # spare places behind lists, which are read eight or LANES at a time
# stride of the columns of a block: not a power of two, whose columns would share cache sets; a multiple of 16, without
# which LLVM expects failed store-to-load forwarding in registers of 16, and uses smaller ones
STRIDE = BLOCK + 16
# first columns in State.grains of position, velocity, spin and predicted velocity; for rods, of predicted spin,
# quaternion, axis and reduced angular momentum; first columns in State.loads of force and torque
X, V, W, U = 0, 4, 8, 12
P, Q, A, M = 16, 20, 24, 28
F, T, LOAD = 0, 4, 8
ROLL = 4  # first column of the rolling spring in a row of springs, if there is one
BODY = 4  # numbers of a row of State.body
GHOSTS = 2  # rows behind the grains that pad blocks: one that collects unused results, and one too far away to touch it
FAR = 1e30


class Layout(NamedTuple):
    """Layout of the arrays for a kind of grains.

    Attributes:
        GRAIN: length of a row of State.grains.
        BLOCK_COLUMNS: columns of a block.
        NEAR_COLUMNS: columns of State.near.
        WALL_PARTS: points (parts of a rod) at which a grain may touch one wall, each with a spring.
        ORIENTED: grains have an orientation.
        VARIED: grains differ.
        SPRING: length of a row of springs.
        SPRING_KEPT: numbers of a row of springs that a rebuild of lists copies.
    """

    GRAIN: int
    BLOCK_COLUMNS: int
    NEAR_COLUMNS: int
    WALL_PARTS: int
    ORIENTED: bool
    VARIED: bool = False
    SPRING: int = 4
    SPRING_KEPT: int = 3

    def with_rolling_springs(self) -> "Layout":
        """Return the layout for contacts with rolling springs too."""
        return self._replace(SPRING=8, SPRING_KEPT=7, BLOCK_COLUMNS=MIXTURES.BLOCK_COLUMNS + 3)

    def with_meshes(self) -> "Layout":
        """Return the layout for walls that are meshes, where a grain may have several contacts, each with its
        feature."""
        return self._replace(WALL_PARTS=mesh.MESH_CONTACTS, SPRING_KEPT=max(self.SPRING_KEPT, mesh.SPRING_KEY + 1))


SPHERES = Layout(GRAIN=16, BLOCK_COLUMNS=21, NEAR_COLUMNS=7, WALL_PARTS=1, ORIENTED=False)
MIXTURES = SPHERES._replace(BLOCK_COLUMNS=35, VARIED=True)
RODS = Layout(GRAIN=32, BLOCK_COLUMNS=33, NEAR_COLUMNS=10, WALL_PARTS=4, ORIENTED=True)
LAYOUTS = {"sphere": SPHERES, "spherocylinder": RODS}
"""Layouts of equal grains by shape."""


class State(NamedTuple):
    """State of a member. Grains are rows 0..GRAINS-1; vectors are four doubles, of which the last is zero, for one
    load.

    grains: x [m] at whole steps; v [m/s], w [rad/s] half a step before; u: predicted v. loads: forces [N], torques [N
    m].

    Near pairs: grains pair_i < pair_j, both ascending, each with a spring [m], valid where `held`, which is set if the
    pair touched at the last step; pairs of ghosts follow the last one. Near walls: entries wall_first[w]..wall_first[w
    + 1] are those of wall w, grains ascending; each has as many springs as a grain may have contacts there, and
    `wall_held` has a bit for each. A row of springs has that of friction, and from ROLL on the torque of rolling
    resistance on pair_i [N m].

    At a mesh, mesh_near[mesh_first[k]:mesh_first[k + 1]] are the features that entry k may touch, and column SPRING_KEY
    of a row of springs is the feature of its contact (`labbook_dem.mesh`).

    Rows of rods also have p, the predicted spin; q, the orientation, and a, its axis, at whole steps; m, the reduced
    angular momentum half a step before (`labbook_dem.rotation`), whose spin is w.
    """

    grains: np.ndarray
    loads: np.ndarray
    body: np.ndarray  # where grains differ, of each: radius [m], mass [kg], moment of inertia [kg m^2], kind
    ids: np.ndarray
    gone: np.ndarray  # 1 once the grain has crossed the outlet plane
    pair_i: np.ndarray
    pair_j: np.ndarray
    held: np.ndarray
    spring: np.ndarray
    wall_first: np.ndarray
    wall_grain: np.ndarray
    wall_held: np.ndarray
    wall_spring: np.ndarray
    cross: np.ndarray
    count: np.ndarray
    sums: np.ndarray
    # threads: this thread's domain; pairs borrowed from others, as above; shared values; arrivals at barriers
    domain: np.ndarray
    borrowed_i: np.ndarray
    borrowed_j: np.ndarray
    borrowed_held: np.ndarray
    borrowed_spring: np.ndarray
    shared_values: np.ndarray
    meetings: np.ndarray
    # scratch: a block of contacts, in the precision of laws, the same memory as integers, the grains and the list
    # entries of its contacts; measures of near walls; squares of speeds, and the same memory as integers
    block: np.ndarray
    bits: np.ndarray
    block_i: np.ndarray
    block_j: np.ndarray
    slot: np.ndarray
    near: np.ndarray
    speed2: np.ndarray
    speed_bits: np.ndarray
    # at meshes: features near each entry, which are found again with the lists; contacts of one of them
    mesh_first: np.ndarray
    mesh_near: np.ndarray
    touch: np.ndarray
    # of parts that move: poses of walls at steps from pose_first[0] on (`labbook.scene.part_motion`)
    pose: np.ndarray
    pose_first: np.ndarray

    @property
    def x(self) -> np.ndarray:
        """Positions [m] of all rows but ghosts, shape [n, 3]; a view, as those below."""
        return self.grains[:-GHOSTS, X : X + 3]

    @property
    def v(self) -> np.ndarray:
        """Velocities [m/s] half a step before."""
        return self.grains[:-GHOSTS, V : V + 3]

    @property
    def w(self) -> np.ndarray:
        """Spins [rad/s] half a step before."""
        return self.grains[:-GHOSTS, W : W + 3]

    @property
    def m(self) -> np.ndarray:
        """Reduced angular momenta [rad/s] half a step before; of rods."""
        return self.grains[:-GHOSTS, M : M + 3]

    @property
    def q(self) -> np.ndarray:
        """Orientations, shape [n, 4]; of rods."""
        return self.grains[:-GHOSTS, Q : Q + 4]

    @property
    def u(self) -> np.ndarray:
        """Velocities [m/s] predicted for now."""
        return self.grains[:-GHOSTS, U : U + 3]

    @property
    def f(self) -> np.ndarray:
        """Forces [N]."""
        return self.loads[:-GHOSTS, F : F + 3]


SCRATCH = (
    *("domain", "borrowed_i", "borrowed_j", "borrowed_held", "borrowed_spring", "shared_values", "meetings"),
    *("block", "bits", "block_i", "block_j", "slot", "near", "speed2", "speed_bits"),
    *("mesh_first", "mesh_near", "touch", "pose", "pose_first"),
)
"""Arrays without state of their own from one beat to the next; checkpoints leave them out."""


class Lists(NamedTuple):
    """Lists of a State, under the same names."""

    pair_i: np.ndarray
    pair_j: np.ndarray
    held: np.ndarray
    spring: np.ndarray
    wall_first: np.ndarray
    wall_grain: np.ndarray
    wall_held: np.ndarray
    wall_spring: np.ndarray


class Grid(NamedTuple):
    """Scratch for building lists: cell [n, 3] of each grain, first grain of a cell, next grain in its cell, new
    rows."""

    cell: np.ndarray
    head: np.ndarray
    next_grain: np.ndarray
    new_rows: np.ndarray


class Params(NamedTuple):
    """Parameters that do not change during a run.

    c: coefficients between grains; wall_c: those of each wall [W, 8]. In a mixture radius is the largest; of K kinds,
    pair_c [K K, 8] has kinds a and b in row a K + b, and wall_c is [W K, 8].

    half: half the length of a rod's segment [m]; slender: I_t/I_a - 1; inertia: I_t [kg m^2].

    walls [W, n]: numbers of each wall; wall_kind [W]; wall_motion [W, 4]: velocity and spin of its surface.

    rolling_stiffness, rolling_damping: of rolling springs (`labbook_dem.spheres.rolling_resistance`).

    mesh_...: of walls that are meshes (`labbook_dem.mesh_grid`); mesh_moves: distance [m] by which a grain may move in
    the frame of one before lists are rebuilt; part_speed: largest speed [m/s] of parts that move.
    """

    c: tuple
    pair_c: np.ndarray
    radius: float
    half: float
    slender: float
    mass: float
    inertia: float
    gravity: float
    dt: float
    skin: float
    speed_limit: float
    overlap_limit: float
    plane: float
    drop: float
    wall_c: np.ndarray
    walls: np.ndarray
    wall_kind: np.ndarray
    wall_motion: np.ndarray
    rolling_stiffness: float
    rolling_damping: float
    mesh_features: np.ndarray
    mesh_conditions: np.ndarray
    mesh_frame: np.ndarray
    mesh_cell: np.ndarray
    mesh_listed: np.ndarray
    mesh_moves: float
    part_speed: float


def allocate(
    n: int, pairs: int, walls: int, near_walls: int, crossings: int, precision: str, layout: Layout
) -> State:  # fmt: skip
    """Zeroed arrays for n grains and the given numbers of listed pairs, walls, grains near them, and recorded
    crossings."""
    grains = _aligned((n + GHOSTS) * layout.GRAIN).reshape(-1, layout.GRAIN)
    grains[-1, X] = FAR
    return State(
        grains=grains,
        loads=loads(n),
        body=np.ones((n + GHOSTS if layout.VARIED else 0, BODY)),
        ids=np.zeros(n, np.int64),
        gone=np.zeros(n, np.uint8),
        **lists(pairs + PAD, walls, near_walls + PAD, layout)._asdict(),
        cross=np.zeros((crossings, len(crossing_columns(layout.ORIENTED)))),
        count=np.zeros(COUNTERS, np.int64),
        sums=np.zeros(SUMS),
        borrowed_i=np.zeros(PAD, np.int32),
        borrowed_j=np.zeros(PAD, np.int32),
        borrowed_held=np.zeros(PAD, np.uint8),
        borrowed_spring=np.zeros((PAD, layout.SPRING)),
        domain=np.array([0, 1, 0, 0, 0, 0, 0]),
        shared_values=np.zeros((1, CACHE_LINE)),
        meetings=np.zeros(1, np.int64),
        mesh_first=np.zeros(1, np.int64),
        mesh_near=np.zeros(0, np.int32),
        pose=np.zeros((0, 0, POSE_COLUMNS)),
        pose_first=np.full(1, -1),
        **scratch(n, precision, layout),
    )


def lists(pairs: int, walls: int, near_walls: int, layout: Layout) -> Lists:
    """Empty lists with room for `pairs` pairs and `near_walls` entries at `walls` walls, PAD places of each
    included."""
    return Lists(
        pair_i=np.zeros(pairs, np.int32),
        pair_j=np.zeros(pairs, np.int32),
        held=np.zeros(pairs, np.uint8),
        spring=_aligned(pairs * layout.SPRING).reshape(-1, layout.SPRING),
        wall_first=np.zeros(walls + 1, np.int64),
        wall_grain=np.zeros(near_walls, np.int32),
        wall_held=np.zeros(near_walls, np.uint8),
        wall_spring=_aligned(near_walls * layout.WALL_PARTS * layout.SPRING).reshape(-1, layout.SPRING),
    )


def grid(n: int) -> Grid:
    """Scratch for building lists of n grains in at most CELLS n + SPARE_CELLS cells."""
    return Grid(
        cell=np.empty((n, 3), np.int32),
        head=np.empty(CELLS * n + SPARE_CELLS, np.int32),
        next_grain=np.empty(n, np.int32),
        new_rows=np.empty(n, np.int32),
    )


def loads(n: int) -> np.ndarray:
    """Zero loads of n grains and the ghosts."""
    return _aligned((n + GHOSTS) * LOAD).reshape(-1, LOAD)


def borrowed(state: State, pairs: np.ndarray) -> dict[str, np.ndarray]:
    """Copies of listed pairs, padded."""
    return {
        "borrowed_i": _padded(state.pair_i[pairs]),
        "borrowed_j": _padded(state.pair_j[pairs]),
        "borrowed_held": _padded(state.held[pairs]),
        "borrowed_spring": _padded(state.spring[pairs]),
    }


def _padded(array: np.ndarray) -> np.ndarray:
    return np.concatenate([array, np.zeros((PAD, *array.shape[1:]), array.dtype)])


def scratch(n: int, precision: str, layout: Layout) -> dict[str, np.ndarray]:
    """Scratch of one thread, for n grains."""
    real, whole = (np.float32, np.int32) if precision == "mixed" else (np.float64, np.int64)
    block, speed2 = _aligned(layout.BLOCK_COLUMNS * STRIDE, real), _aligned(n + 1)
    return {
        "block": block,
        "bits": block.view(whole),
        "block_i": np.zeros(BLOCK + PAD, np.int32),
        "block_j": np.zeros(BLOCK + PAD, np.int32),
        "slot": np.zeros(BLOCK + PAD, np.int32),
        "near": _aligned(layout.NEAR_COLUMNS * STRIDE),
        "touch": np.zeros((mesh.CONTACT_ROWS, mesh.CONTACT_COLUMNS)),
        "speed2": speed2,
        "speed_bits": speed2.view(np.int64),
    }


def _aligned(n: int, kind: type = np.float64) -> np.ndarray:
    """Zeros that start on a cache line: wide loads across two lines cost more."""
    raw = np.zeros(n * np.dtype(kind).itemsize + 64, np.uint8)
    start = -raw.ctypes.data % 64
    return raw[start : start + n * np.dtype(kind).itemsize].view(kind)
