"""Reading velocities, energies and contacts without changing the motion."""

from __future__ import annotations

from labbook_dem.spheres import sphere_on_sphere, sphere_on_wall
from labbook_dem.words import FRICTION, dot, func, narrow, real, vec3, wide, wide3

from labbook_warp.kernels.forces import forces
from labbook_warp.kernels.mixed import position, predicted, spin, velocity
from labbook_warp.kernels.system import Material, System, entry, material
from labbook_warp.kernels.walls import wall_distance, wall_velocity
from labbook_warp.kernels.words import (
    ANY_WALLS,
    LANES,
    MOVING,
    PARKED,
    Ints,
    Wides,
    Wides3,
    Words,
    kernel,
    widen,
    wp,
)


@kernel
def look(a: System, p: Words, v_out: Wides3, w_out: Wides3):
    """Velocities and spins at the whole step: half a kick by the forces there, as precise as the state is.

    Grains that have left: zero.
    """
    thread = wp.tid()
    i = thread // LANES
    lane = thread - i * LANES
    s = i // a.cap
    r = i - s * a.cap
    if r < a.rows[s]:
        x = position(p, i)
        v = velocity(p, i)
        w = spin(p, i)
        if x[2] > wide(0.5) * wide(PARKED):
            m = material(a, s)
            f, t, _held, _wall_held, _deepest = forces(a, p, m, s, r, lane, x, v, w, predicted(p, i), False)
            part = wide(0.5) * m.dt
            if a.step[s] == wp.int64(0):
                part = wide(0.0)
            if lane == 0:
                gravity = wide3(wide(0.0), wide(0.0), wide(-1.0)) * m.gravity
                v_out[i] = widen(narrow(widen(v) + (f * m.per_mass + gravity) * part))
                w_out[i] = widen(narrow(widen(w) + t * (m.per_inertia * part)))
        else:
            v_out[i] = wide3(wide(0.0), wide(0.0), wide(0.0))
            w_out[i] = wide3(wide(0.0), wide(0.0), wide(0.0))


@kernel
def kinetic(a: System, v: Wides3, w: Wides3, parts: int, out: Wides):
    """Kinetic energy [J] of every `parts`-th grain of each member; the host adds up in a fixed order."""
    thread = wp.tid()
    s = thread // parts
    first = thread - s * parts
    m = material(a, s)
    twice = wide(0.0)
    for r in range(first, a.rows[s], parts):
        i = s * a.cap + r
        twice += dot(v[i], v[i]) / m.per_mass + dot(w[i], w[i]) / m.per_inertia
    out[thread] = wide(0.5) * twice


@func
def row(out: Wides, at: int, s: int, i: int, j: int, wall: int, force: vec3, branch: wide3):
    """Write one contact."""
    out[at] = wide(s)
    out[at + 1] = wide(i)
    out[at + 2] = wide(j)
    out[at + 3] = wide(wall)
    for c in range(3):
        out[at + 4 + c] = wide(force[c])
        out[at + 7 + c] = branch[c]


@kernel
def contacts(a: System, p: Words, counter: Ints, out: Wides):
    """Rows slot, i, j, wall, force on i [N], branch vector from i [m] of all touching contacts, in any order."""
    i = wp.tid()
    s = i // a.cap
    r = i - s * a.cap
    if r < a.rows[s]:
        x = position(p, i)
        if x[2] > wide(0.5) * wide(PARKED):
            m = material(a, s)
            half_dt = real(wide(0.5) * m.dt)
            of_pairs(a, p, m, s, r, x, half_dt, counter, out)
            if ANY_WALLS:
                of_walls(a, p, m, s, r, x, half_dt, counter, out)


@func
def of_pairs(a: System, p: Words, m: Material, s: int, r: int, x: wide3, half_dt: real, counter: Ints, out: Wides):
    """Contacts of a grain with neighbours of larger id."""
    zero = real(0.0)
    i = s * a.cap + r
    for k in range(a.count[i]):
        at = entry(a, s, a.near, k, r)
        j = s * a.cap + a.nbr[at]
        away = x - position(p, j)
        gap = m.reach2 - dot(away, away)
        if gap > wide(0.0) and a.ids[i] < a.ids[j]:
            last = vec3(zero, zero, zero)
            advance = half_dt
            if FRICTION:
                if (a.held[i] & (wp.uint32(1) << wp.uint32(k))) != wp.uint32(0):
                    last = a.spring[at]
                    advance = half_dt + half_dt
            f, _t, _o, _kept, _delta = sphere_on_sphere(
                m.c, m.radius, m.mass, narrow(away), real(gap), predicted(p, i) - predicted(p, j),
                velocity(p, i) - velocity(p, j), spin(p, i), spin(p, j), last, advance, m.inertia_rate,
            )  # fmt: skip
            row(out, 10 * wp.atomic_add(counter, 0, 1), s, a.ids[i], a.ids[j], -1, f, -away)


@func
def of_walls(a: System, p: Words, m: Material, s: int, r: int, x: wide3, half_dt: real, counter: Ints, out: Wides):
    """Contacts of a grain with walls."""
    zero = real(0.0)
    i = s * a.cap + r
    for q in range(a.walls):
        bit = wp.uint32(1) << wp.uint32(q)
        if (a.wall_near[i] & bit) != wp.uint32(0):
            g = s * a.walls + q
            distance, normal = wall_distance(a, g, x)
            overlap = real(m.reach - distance)
            if overlap > zero:
                last = vec3(zero, zero, zero)
                advance = half_dt
                if FRICTION:
                    if (a.wall_held[i] & bit) != wp.uint32(0):
                        last = a.wall_spring[entry(a, s, a.walls, q, r)]
                        advance = half_dt + half_dt
                surface = vec3(zero, zero, zero)
                turning = vec3(zero, zero, zero)
                if MOVING:
                    surface = narrow(wall_velocity(a, g, x - normal * distance))
                    turning = vec3(zero, zero, real(a.wall_motion[g][3]))
                f, _t, _kept = sphere_on_wall(
                    a.wall_c[g], m.radius, m.mass, overlap, narrow(normal), predicted(p, i) - surface,
                    velocity(p, i) - surface, spin(p, i), turning, last, advance, m.inertia_rate,
                )  # fmt: skip
                row(out, 10 * wp.atomic_add(counter, 0, 1), s, a.ids[i], -1, q, f, -(normal * distance))
