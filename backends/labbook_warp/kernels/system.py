"""All arrays of an ensemble, as one argument of every kernel.

Slot s holds one member in rows s * CAP .. s * CAP + rows[s] - 1 of the arrays of grains. Arrays of several entries a
grain (near neighbours, walls) are blocks of one slot each, entry by entry: entry k of row r of slot s stands at
(s * ENTRIES + k) * CAP + r. Each near wall has WALL_PARTS entries. Neighbours are named by their row in the slot:
nothing depends on which slot it is.
"""

from __future__ import annotations

from labbook_dem.words import coefs, func, real, struct, wide

from labbook_warp.kernels.words import (
    UNIFORM,
    Bits,
    Bodies,
    Coefs,
    Floats,
    Ints,
    Longs,
    Motions,
    Quanta,
    Reals,
    Reals4,
    Table,
    Tables,
    Vectors,
    Wides,
    Wides3,
    Wides4,
    uint32,
    wp,
)


@struct
class Material:
    """Properties of grains, contact law and clock of a member, which all members of a sweep often share.

    In a mixture, values of the largest grain or of the mean; `bodies` has those of each grain.
    """

    c: coefs
    radius: real
    mass: real
    inertia_rate: real
    reach: wide  # radius [m] in double: an overlap is a small difference of large lengths
    reach2: wide  # diameter squared
    half: wide  # half the length of a rod's segment
    slenderness: wide  # I_t/I_a - 1; see `labbook_dem.rotation`
    listed2: wide  # square of the distance up to which neighbours are listed
    centres2: wide  # square of the distance up to which the centres of listed neighbours may be
    half_skin: wide
    inverse_mass: wide
    inverse_inertia: wide
    gravity: wide
    dt: wide
    speed_limit2: real  # square of the limit of speeds [m^2/s^2]
    overlap_limit: real  # limit of overlaps [m]
    quantum_f: wide  # unit of sums of forces [N], a power of two
    quantum_t: wide  # unit of sums of torques [N m]
    per_quantum_f: real
    per_quantum_t: real
    rolling_stiffness: real  # of rolling springs; see `labbook_dem.spheres.rolling_resistance`
    rolling_damping: real


@struct
class MemberDomain:
    """Outlet of a member, its lattice of cells, and its number of walls."""

    plane: wide  # height [m] of the plane of crossings
    drop: wide  # height [m] below which grains leave
    cell: wide  # edge of a cell [m]
    gx: int  # cells along x, y, z
    gy: int
    gz: int
    walls: int


@struct
class System:
    """Arrays of an ensemble; see the head of this module."""

    cap: int  # rows a slot
    near: int  # neighbours a grain
    walls: int  # walls a member, at most
    seats: int  # walls that a grain has entries for: all, or as many as a mask has bits for
    cells: int  # cells a slot
    depth: int  # grains a cell
    rows: Ints
    step: Longs
    common: Material
    material: wp.array(dtype=Material)  # pyright: ignore[reportInvalidTypeForm]
    domain: wp.array(dtype=MemberDomain)  # pyright: ignore[reportInvalidTypeForm]
    pair_c: Coefs  # of kinds a and b of slot s at (s * KINDS + a) * KINDS + b, where grains differ
    wall_c: Coefs  # of wall g = s * walls + w, or of kind k there at g * KINDS + k
    wall_numbers: Wides  # WALL_NUMBERS of each wall (`labbook_dem.dispatch`)
    wall_kind: Ints
    wall_motion: Motions
    body: Bodies  # radius, mass, moment of inertia and kind, where grains differ
    ids: Ints
    gone: Ints  # 1 after the first passage through the plane of crossings
    origin: Wides3  # positions at the last rebuild of lists
    facing: Wides3  # axes of rods at the last rebuild
    turned: Wides4  # orientations of rods
    # of rods: reduced angular momenta [rad/s], and the rounding error of the vertical velocity [m/s]
    momentum: Reals4
    count: Ints
    nbr: Ints
    held: Bits  # bit k: the spring to neighbour k is valid
    spring: Vectors
    rolling: Vectors  # torques of rolling springs [N m], if the law has them; `wall_rolling` likewise
    wall_near: Bits
    wall_held: Bits
    wall_spring: Vectors
    wall_rolling: Vectors
    wall_seat: Ints  # wall of each entry, where members have more walls than a grain has entries for
    # with a separate kernel for walls: rows near a wall, those near an edge at the end; and the number of either
    beside: Ints
    beside_count: Ints
    wall_touching: Bits  # walls, or parts of them, that a grain touches; stale without near walls
    # sums over contacts with walls; an array of records would be copied byte by byte
    wall_force: Quanta
    wall_torque: Quanta
    wall_fine_force: Quanta
    wall_fine_torque: Quanta
    wall_deep: Reals
    work: Wides
    deep: Wides  # largest overlap [m] at the last step
    most_deep: Reals  # largest overlap [m] of each member so far, and square of the largest speed
    most_speed2: Reals
    new_count: Ints  # length of the new list while the threads that share a grain collect it
    new_nbr: Ints
    new_key: Floats
    new_spring: Vectors
    new_rolling: Vectors
    cell_count: Ints
    cell_rows: Ints
    flag: Ints
    any_flag: Ints
    late: Ints
    rebuilds: Ints
    left: Ints
    overflow: Ints  # per slot: needed neighbours, grains in a cell and near walls; 0 where they fit
    fail: Longs
    bad: Wides
    crossed: Ints
    cross: Wides
    # of scenes with a mesh only, from here on (`labbook_warp.meshes`)
    wall_feature: Ints  # of a spring at a mesh, the feature of its contact, counted from the first of this mesh
    mesh_of: Ints  # row of the mesh of each wall, -1 of others
    mesh_count: Ints  # features that a grain may touch at each seat, and which they are, MESH_LISTED each
    mesh_near: Ints
    mesh_contacts: Tables  # scratch for the contacts of each grain, or of each seat where threads share grains
    mesh_begin: Ints  # first feature of each mesh
    mesh_frame: Table  # see `labbook_dem.mesh_grid.MeshGrids`, as for those below
    mesh_features: Table
    mesh_conditions: Table
    mesh_cell: Ints
    mesh_listed: Ints
    # of parts that move (`labbook_warp.poses`): which each wall is, 0 for those that stand still
    pose_of: Ints
    pose: Tables  # poses by step, slot after slot, and part
    pose_row: Ints  # row of the poses of now, of each slot, and the number of this step
    pose_step: Longs
    pose_every: Longs  # steps in which no part moves by half a skin


@func
def material(a: System, s: int):
    """Material of slot s. One that all members share is a kernel argument and takes no register."""
    if UNIFORM:
        return a.common
    else:
        return a.material[s]


@func
def entry(a: System, s: int, entries: int, k: int, r: int):
    """Index of entry k of row r of slot s in an array of `entries` entries a grain."""
    return (s * entries + k) * a.cap + r


@func
def has_bit(mask: uint32, k: int):
    """Test bit k of a mask."""
    return (mask & (wp.uint32(1) << wp.uint32(k))) != wp.uint32(0)
