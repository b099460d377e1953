"""Contacts with walls in a kernel of their own: one thread for each grain that is near a wall.

A rod at a wall takes many more registers, and more code, than a rod among its neighbours, and few rods are near a wall.
Sums over contacts are exact, so that no bit depends on the kernel that computes them.
"""

from __future__ import annotations

from labbook_dem.words import wide

from labbook_warp.kernels.shape import at_walls, grain
from labbook_warp.kernels.sums import Sums, store_wall_sums
from labbook_warp.kernels.system import System, material
from labbook_warp.kernels.words import EDGES, PARKED, Words, kernel, this_thread, wall_kernel, wp


@kernel
def list_rows_near_walls(a: System):
    """List the rows of grains near a wall; rows of rods near an edge are listed from the end. `beside_count` is zero
    before.

    Edges take long: their threads start first, and threads of one warp should all have one. The order within a list is
    random and decides nothing.
    """
    i = wp.tid()
    s = i // a.cap
    if i - s * a.cap < a.rows[s]:
        near = a.wall_near[i]
        if near != wp.uint32(0):
            if (near & wp.uint32(EDGES)) == wp.uint32(0):
                a.beside[s * a.cap + wp.atomic_add(a.beside_count, 2 * s, 1)] = i - s * a.cap
            else:
                a.beside[(s + 1) * a.cap - 1 - wp.atomic_add(a.beside_count, 2 * s + 1, 1)] = i - s * a.cap


@wall_kernel
def meet_walls(a: System, p: Words, slot: int, slots: int, keep: bool):
    """Sum up the contacts with walls of each listed grain, for the members in `slots` slots from `slot` on.

    keep: store the springs of the next step.
    """
    n = this_thread(wp.tid())
    # edges of all members come first, in groups of 32 of one member: a warp then takes one branch only
    s = slot + (n // 32) % slots
    k = n // 32 // slots * 32 + n % 32
    edges = a.beside_count[2 * s + 1]
    rank = k - (edges + 31) // 32 * 32
    r = int(-1)
    if k < edges:
        r = a.beside[(s + 1) * a.cap - 1 - k]
    elif rank >= 0 and rank < a.beside_count[2 * s]:
        r = a.beside[s * a.cap + rank]
    if r >= 0:
        i = s * a.cap + r
        m = material(a, s)
        g = grain(p, m, i)
        if r < a.rows[s] and g.x[2] > wide(0.5) * wide(PARKED):
            sums, mask = at_walls(a, m, s, r, 0, g, a.wall_near[i], a.wall_held[i], Sums(), keep)
            store_wall_sums(a, i, mask, sums)
            if keep:  # most masks are as before: reading costs less than a scattered store
                if mask != a.wall_held[i]:
                    a.wall_held[i] = mask
