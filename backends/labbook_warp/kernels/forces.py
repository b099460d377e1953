"""Forces and torques on one grain, by its neighbours and the walls near it.

Sums are exact, so that they do not depend on order: each contribution is rounded to a multiple of a quantum far below
a grain's weight, and sums of such multiples lose nothing in double precision. (Contributions in double are split in
two: what the rounding leaves over is summed likewise, in quanta finer by 2^48.) Hence neither the order of a list, nor
when it was built, nor how many threads share a grain decides a bit of the result.
"""

from __future__ import annotations

from labbook_dem.spheres import sphere_on_sphere, sphere_on_wall
from labbook_dem.words import FRICTION, dot, func, narrow, real, vec3, wide, wide3

from labbook_warp.kernels.mixed import position, predicted, spin, velocity
from labbook_warp.kernels.system import Material, System, entry
from labbook_warp.kernels.walls import wall_distance, wall_velocity
from labbook_warp.kernels.words import (
    ANY_WALLS,
    FINE,
    LANES,
    MOVING,
    SHARED,
    Words,
    add_lanes,
    first_bit,
    load_int,
    most_lanes,
    or_lanes,
    widen,
    without_first,
    wp,
)


@func
def on_grid(v: vec3, magic: wide):
    """v rounded to multiples of a quantum: `magic` is 1.5 * 2^52 of them."""
    m = wide3(magic, magic, magic)
    return (widen(v) + m) - m


@func
def fine(v: vec3, magic: wide):
    """What `on_grid` leaves over, on a grid finer by 2^48."""
    return on_grid(narrow(widen(v) - on_grid(v, magic)), magic * wide(2.0**-48.0))


@func
def all_lanes(v: wide3):
    """Sum over the threads that share a grain."""
    return wide3(add_lanes(v[0], LANES), add_lanes(v[1], LANES), add_lanes(v[2], LANES))


@func
def forces(
    a: System, p: Words, m: Material, s: int, r: int, lane: int, x: wide3, v: vec3, w: vec3, u: vec3, keep: bool
):  # fmt: skip
    """Contact force [N] and torque [N m], which springs are held, at neighbours and at walls, the largest overlap [m].

    keep: whether springs are advanced in memory.
    """
    zero = real(0.0)
    none = wp.uint32(0)
    i = s * a.cap + r
    force = wide3(wide(0.0), wide(0.0), wide(0.0))
    torque = wide3(wide(0.0), wide(0.0), wide(0.0))
    more_force = wide3(wide(0.0), wide(0.0), wide(0.0))
    more_torque = wide3(wide(0.0), wide(0.0), wide(0.0))
    held = wp.uint32(0)
    wall_held = wp.uint32(0)
    deepest = real(0.0)
    half_dt = real(wide(0.5) * m.dt)
    old = a.held[i]
    count = a.count[i]
    following = int(0)  # neighbours are looked up one ahead: the store of a spring would hold the next load back
    if lane < count:
        following = load_int(a.nbr, entry(a, s, a.near, lane, r))
    for k in range(lane, count, LANES):
        at = entry(a, s, a.near, k, r)
        j = s * a.cap + following
        if k + LANES < count:
            following = load_int(a.nbr, at + LANES * a.cap)
        away = x - position(p, j)
        gap = m.reach2 - dot(away, away)
        if gap > wide(0.0):
            bit = wp.uint32(1) << wp.uint32(k)
            last = vec3(zero, zero, zero)
            advance = half_dt
            if FRICTION:
                if (old & bit) != none:
                    last = a.spring[at]
                    advance = half_dt + half_dt
            f, t, _t, kept, delta = sphere_on_sphere(
                m.c, m.radius, m.mass, narrow(away), real(gap), u - predicted(p, j), v - velocity(p, j), w, spin(p, j),
                last, advance, m.inertia_rate,
            )  # fmt: skip
            force = force + on_grid(f, m.grid_f)
            if FINE:
                more_force = more_force + fine(f, m.grid_f)
            if FRICTION:
                torque = torque + on_grid(t, m.grid_t)
                if FINE:
                    more_torque = more_torque + fine(t, m.grid_t)
                if keep:
                    a.spring[at] = kept
            held = held | bit
            deepest = max(deepest, delta)
    if ANY_WALLS:
        # each grain by its own first, second, ... near wall: side by side, whichever walls these are
        near = without_first(a.wall_near[i], lane)
        old = a.wall_held[i]
        while near != none:
            q = first_bit(near)
            near = without_first(near, LANES)
            bit = wp.uint32(1) << wp.uint32(q)
            g = s * a.walls + q
            distance, normal = wall_distance(a, g, x)
            overlap = real(m.reach - distance)
            if overlap > zero:
                at = entry(a, s, a.walls, q, r)
                last = vec3(zero, zero, zero)
                advance = half_dt
                if FRICTION:
                    if (old & bit) != none:
                        last = a.wall_spring[at]
                        advance = half_dt + half_dt
                surface = vec3(zero, zero, zero)
                turning = vec3(zero, zero, zero)
                if MOVING:
                    surface = narrow(wall_velocity(a, g, x - normal * distance))
                    turning = vec3(zero, zero, real(a.wall_motion[g][3]))
                f, t, kept = sphere_on_wall(
                    a.wall_c[g], m.radius, m.mass, overlap, narrow(normal), u - surface, v - surface, w, turning,
                    last, advance, m.inertia_rate,
                )  # fmt: skip
                force = force + on_grid(f, m.grid_f)
                if FINE:
                    more_force = more_force + fine(f, m.grid_f)
                if FRICTION:
                    torque = torque + on_grid(t, m.grid_t)
                    if FINE:
                        more_torque = more_torque + fine(t, m.grid_t)
                    if keep:
                        a.wall_spring[at] = kept
                wall_held = wall_held | bit
                deepest = max(deepest, overlap)
    if SHARED:
        force = all_lanes(force)
        deepest = most_lanes(deepest, LANES)
        held = or_lanes(held, LANES)
        wall_held = or_lanes(wall_held, LANES)
        if FRICTION:
            torque = all_lanes(torque)
        if FINE:
            more_force = all_lanes(more_force)
            more_torque = all_lanes(more_torque)
    if FINE:
        force = force + more_force
        torque = torque + more_torque
    return force, torque, held, wall_held, deepest
