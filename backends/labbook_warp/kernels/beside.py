"""Walls met by a kernel of their own, one thread a grain: of the grains that have one near, side by side.

What a rod does at a wall takes many more registers, and more code, than what it does among its neighbours, and few rods
are near one. Sums over contacts are exact, so it decides no bit where they are made.
"""

from __future__ import annotations

from labbook_dem.words import wide

from labbook_warp.kernels.shape import at_walls, grain
from labbook_warp.kernels.sums import Sums, put_aside
from labbook_warp.kernels.system import System, material
from labbook_warp.kernels.words import EDGES, PARKED, Words, kernel, this_thread, wall_kernel, wp


@kernel
def line_up(a: System):
    """List the grains that have a wall near, those by an edge from the end; `beside_count` is zero before.

    Edges take long: they are begun with, and threads side by side should all have one. Order, which is by chance,
    decides nothing.
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
    """Sum up the contacts with walls of each grain that has one near, of the members in `slots` slots from `slot` on.

    keep: whether springs are advanced in memory.
    """
    n = this_thread(wp.tid())
    # first come those by edges of all members, 32 of one side by side, and then the others
    s = slot + (n // 32) % slots
    k = n // 32 // slots * 32 + n % 32
    by_edges = a.beside_count[2 * s + 1]
    other = k - (by_edges + 31) // 32 * 32
    r = int(-1)
    if k < by_edges:
        r = a.beside[(s + 1) * a.cap - 1 - k]
    elif other >= 0 and other < a.beside_count[2 * s]:
        r = a.beside[s * a.cap + other]
    if r >= 0:
        i = s * a.cap + r
        m = material(a, s)
        g = grain(p, m, i)
        if r < a.rows[s] and g.x[2] > wide(0.5) * wide(PARKED):
            sums, held = at_walls(a, m, s, r, 0, g, a.wall_near[i], a.wall_held[i], Sums(), keep)
            put_aside(a, i, held, sums)
            if keep:
                if held != a.wall_held[i]:
                    a.wall_held[i] = held
