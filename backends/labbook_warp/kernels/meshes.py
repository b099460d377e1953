"""Grains at walls of triangles: which features are near, and the contacts of now with the indices of their springs.

Each near mesh has all entries of a wall, one for each contact that a grain may have with it. Which of its features a
grain may touch is listed with the neighbours; a grain with more than MESH_LISTED takes all that its cell of the grid
lists. The list decides no bit. Places and normals are in the frame of the mesh.
"""

from __future__ import annotations

from labbook_dem.mesh import (
    K_SPRING,
    MESH_CONTACTS,
    SPRING_KEY,
    mesh_cell,
    mesh_contacts,
    mesh_listed,
    mesh_near,
    mesh_springs,
)
from labbook_dem.mesh_rods import mesh_rod_contacts, mesh_rod_near
from labbook_dem.words import func, wide, wide3

from labbook_warp.kernels.bodies import body
from labbook_warp.kernels.parts import direction_in_part, position_in_part
from labbook_warp.kernels.shape import Grain
from labbook_warp.kernels.system import Material, System, entry, material
from labbook_warp.kernels.walls import wall_at
from labbook_warp.kernels.words import (
    MESH_LISTED,
    MESH_NUMBER,
    ORIENTED,
    POSES,
    SHARED,
    WALL_PARTS,
    Table,
    first_bit,
    kernel,
    load_int,
    uint32,
    wp,
)


@func
def is_mesh(a: System, wall: int):
    """True for a wall of triangles."""
    return load_int(a.wall_kind, wall) == MESH_NUMBER


@func
def scratch(a: System, s: int, r: int, k: int):
    """Number of the scratch for the contacts of row r with the wall whose first entry is k."""
    number = s * a.cap + r
    if SHARED:
        number = entry(a, s, a.seats, k // WALL_PARTS, r)
    return number


@func
def position_at(a: System, wall: int, x: wide3):
    """A point in space, in the frame of a mesh."""
    if POSES:
        x = position_in_part(a, wall, x)
    return x


@func
def axis_at(a: System, wall: int, axis: wide3):
    """The axis of a rod, in the frame of a mesh."""
    if POSES:
        axis = direction_in_part(a, wall, axis)
    return axis


@func
def radius_of(a: System, m: Material, i: int):
    """Radius [m] of grain i."""
    radius = m.reach
    if not ORIENTED:
        radius = body(a, m, i).reach
    return radius


@func
def touched(a: System, m: Material, s: int, r: int, k: int, wall: int, old: uint32, g: Grain, contacts: Table):
    """Write the contacts of row r with a mesh, whose first entry is k, into `contacts`, with the indices of their
    springs; how many, OVER if there is no room. old: at which springs are held."""
    radius = radius_of(a, m, s * a.cap + r)
    x = position_at(a, wall, g.x)
    at = entry(a, s, a.seats, k // WALL_PARTS, r)
    mesh = load_int(a.mesh_of, wall)
    listed = a.mesh_count[at]
    crowd = listed > MESH_LISTED
    cell = int(0)
    if crowd:
        cell = max(mesh_cell(a.mesh_frame, mesh, x), 0)
    first = wp.where(crowd, a.mesh_cell[cell], at * MESH_LISTED)
    last = wp.where(crowd, a.mesh_cell[cell + 1], at * MESH_LISTED + listed)
    near = wp.where(crowd, a.mesh_listed, a.mesh_near)
    count = int(0)
    if ORIENTED:
        axis = axis_at(a, wall, g.axis)
        count = mesh_rod_contacts(
            a.mesh_features, a.mesh_conditions, near, first, last, x, axis, m.half, radius, contacts
        )  # fmt: skip
    else:
        count = mesh_contacts(a.mesh_features, a.mesh_conditions, near, first, last, x, radius, contacts)
    if count > 0:
        begin = load_int(a.mesh_begin, mesh)
        # rows of contacts that are free by now stand for the springs
        for index in range(MESH_CONTACTS):
            feature = a.wall_feature[entry(a, s, a.seats * WALL_PARTS, k + index, r)]
            contacts[MESH_CONTACTS + index, SPRING_KEY] = wide(begin + feature)
        bits = int((old >> wp.uint32(k)) & wp.uint32((1 << WALL_PARTS) - 1))
        mesh_springs(a.mesh_features, contacts, count, bits, contacts, MESH_CONTACTS)
    return count


# lists


@func
def contact_of_spring(
    a: System, m: Material, s: int, r: int, k: int, wall: int, old: uint32, g: Grain, contacts: Table
):
    """Number of the contact with a mesh whose spring has entry k, of those in `contacts`; -1 if there is none."""
    index = k % WALL_PARTS
    number = int(-1)
    for n in range(touched(a, m, s, r, k - index, wall, old, g, contacts)):
        if int(contacts[n, K_SPRING]) == index:
            number = n
    return number


@func
def list_moves(m: Material):
    """Distance [m] by which a grain may move in the frame of a mesh before its list is built again."""
    moves = m.half_skin
    if POSES:  # and so may the mesh
        moves = moves + m.half_skin
    return moves


@func
def may_touch(a: System, m: Material, f: int, x: wide3, axis: wide3, radius: wide, moves: wide):
    """True if a grain at x, a rod along `axis`, may touch feature f before a point of it has moved by a distance
    [m]."""
    touches = bool(False)
    if ORIENTED:
        touches = mesh_rod_near(a.mesh_features, a.mesh_conditions, f, x, axis, m.half, radius, moves)
    else:
        touches = mesh_near(a.mesh_features, a.mesh_conditions, f, x, radius, moves)
    return touches


@func
def mesh_parts_near(a: System, m: Material, i: int, wall: int, x: wide3, axis: wide3):
    """All entries of a mesh as bits, if grain i at x, a rod along `axis`, may touch it before its list is built again;
    else 0."""
    near = wp.uint32(0)
    radius = radius_of(a, m, i)
    x = position_at(a, wall, x)
    axis = axis_at(a, wall, axis)
    cell = mesh_cell(a.mesh_frame, load_int(a.mesh_of, wall), x)
    if cell >= 0:
        k = a.mesh_cell[cell]
        while k < a.mesh_cell[cell + 1]:
            if may_touch(a, m, a.mesh_listed[k], x, axis, radius, list_moves(m)):
                near = wp.uint32((1 << WALL_PARTS) - 1)
                k = a.mesh_cell[cell + 1]
            k = k + 1
    return near


@kernel
def list_features(a: System):
    """List the features that each grain near a mesh may touch before its list is built again, ascending: of members
    with a flag, by where their grains were as lists were built."""
    i = wp.tid()
    s = i // a.cap
    r = i - s * a.cap
    if a.flag[s] == 1 and r < a.rows[s]:
        m = material(a, s)
        radius = radius_of(a, m, i)
        moves = wide(1.0000001) * list_moves(m)
        near = a.wall_near[i]
        while near != wp.uint32(0):
            seat = first_bit(near) // WALL_PARTS
            near = near & ~(wp.uint32((1 << WALL_PARTS) - 1) << wp.uint32(seat * WALL_PARTS))
            wall = wall_at(a, s, r, seat)
            if is_mesh(a, wall):
                x = position_at(a, wall, a.origin[i])
                axis = x
                if ORIENTED:
                    axis = axis_at(a, wall, a.facing[i])
                at = entry(a, s, a.seats, seat, r)
                cell = max(mesh_cell(a.mesh_frame, load_int(a.mesh_of, wall), x), 0)
                count = int(0)
                for n in range(a.mesh_cell[cell], a.mesh_cell[cell + 1]):
                    f = a.mesh_listed[n]
                    if may_touch(a, m, f, x, axis, radius, moves):
                        if count < MESH_LISTED:
                            entered = int(f)
                            if not ORIENTED:
                                entered = mesh_listed(a.mesh_features, a.mesh_conditions, f, x, moves)
                            a.mesh_near[at * MESH_LISTED + count] = entered
                        count = count + 1
                a.mesh_count[at] = count
