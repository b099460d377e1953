"""Sums over contacts with walls, in bins; see `labbook_dem.traction`."""

from __future__ import annotations

from labbook_dem.traction import SUMS, WALL_COLUMNS, bin_of, components, friction_of, moment, slides
from labbook_dem.words import wide

from labbook_warp.kernels.bodies import body, wall_coefficients
from labbook_warp.kernels.shape import at_wall, grain, normal_at
from labbook_warp.kernels.system import System, has_bit, material
from labbook_warp.kernels.walls import wall_at
from labbook_warp.kernels.words import PARKED, WALL_PARTS, Longs, Wides, Words, kernel, widen, wp


@kernel
def wall_sums(a: System, p: Words, bins: Wides, units: Wides, fraction: wide, sums: Longs):
    """Add up the contacts with walls of all members as integers: the order of threads decides no bit.

    bins: WALL_COLUMNS numbers of each wall (`BinTable`); units: quanta of forces and torques of each slot; sums: of
    each bin; fraction: see `slides`.
    """
    i = wp.tid()
    s = i // a.cap
    r = i - s * a.cap
    if r < a.rows[s]:
        m = material(a, s)
        g = grain(p, m, i)
        if g.x[2] > wide(0.5) * wide(PARKED):
            force_unit = units[2 * s]
            torque_unit = units[2 * s + 1]
            for k in range(a.seats * WALL_PARTS):
                if has_bit(a.wall_near[i], k):
                    c = at_wall(a, m, s, r, k, a.wall_near[i], a.wall_held[i], g)
                    if c.touches:
                        wall = wall_at(a, s, r, k // WALL_PARTS)
                        count = int(bins[WALL_COLUMNS * wall + 3])
                        if count == 0:  # this probe does not read this member
                            continue
                        normal = normal_at(a, m, s, r, k, wall, a.wall_near[i], g)
                        along = int(bins[WALL_COLUMNS * wall])
                        point = g.x + c.branch
                        force = widen(c.force)
                        torque = moment(point, force)
                        pressed, up, across = components(along, force, normal, point)
                        index = bin_of(
                            along, bins[WALL_COLUMNS * wall + 1], bins[WALL_COLUMNS * wall + 2], count, point
                        )
                        at = SUMS * (int(bins[WALL_COLUMNS * wall + 4]) + index)
                        friction = friction_of(wall_coefficients(a, wall, body(a, m, i)))
                        wp.atomic_add(sums, at, wp.int64(1))
                        wp.atomic_add(sums, at + 1, wp.int64(slides(force, normal, friction, fraction)))
                        for n in range(3):
                            wp.atomic_add(sums, at + 2 + n, wp.int64(wp.rint(force[n] / force_unit)))
                            wp.atomic_add(sums, at + 5 + n, wp.int64(wp.rint(torque[n] / torque_unit)))
                            wp.atomic_add(sums, at + 11 + n, wp.int64(wp.rint(point[n] * pressed / torque_unit)))
                        wp.atomic_add(sums, at + 8, wp.int64(wp.rint(pressed / force_unit)))
                        wp.atomic_add(sums, at + 9, wp.int64(wp.rint(up / force_unit)))
                        wp.atomic_add(sums, at + 10, wp.int64(wp.rint(across / force_unit)))
