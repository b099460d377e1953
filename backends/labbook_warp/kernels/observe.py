"""Reading velocities, energies and contacts without changing the motion."""

from __future__ import annotations

from labbook_dem.words import dot, func, narrow, vec3, wide, wide3

from labbook_warp.kernels.bodies import inverse_inertia, inverse_mass
from labbook_warp.kernels.clumps import clump_spin
from labbook_warp.kernels.forces import forces, listed
from labbook_warp.kernels.shape import angular_velocity, at_wall, complete, grain, private, with_neighbour
from labbook_warp.kernels.system import System, clump_row, entry, has_bit, material
from labbook_warp.kernels.walls import wall_at
from labbook_warp.kernels.words import (
    ANY_WALLS,
    CLUMPS,
    LANES,
    PARKED,
    WALL_PARTS,
    Ints,
    Wides,
    Wides3,
    Words,
    kernel,
    widen,
    wp,
)


@kernel
def whole_step(a: System, p: Words, v_out: Wides3, w_out: Wides3):
    """Velocities [m/s] and reduced angular momenta [rad/s] at the whole step: half a kick by the forces there.

    They are rounded as the state is; grains that have left have zero.
    """
    thread = wp.tid()
    i = thread // LANES
    lane = thread - i * LANES
    s = i // a.cap
    r = i - s * a.cap
    if r < a.rows[s]:
        m = material(a, s)
        near = listed(a, s, r, lane)
        g = grain(p, m, i)
        if g.x[2] > wide(0.5) * wide(PARKED):
            force, torque, _springs, _wall_springs, _deepest = forces(a, p, m, s, r, lane, g, near, False)
            half_dt = wide(0.5) * m.dt
            gravity = wide3(wide(0.0), wide(0.0), wide(-1.0)) * m.gravity
            dv = (force * inverse_mass(a, m, i) + gravity) * half_dt
            dw = torque * (inverse_inertia(a, m, i) * half_dt)
            if a.step[s] == wp.int64(0):  # velocities of the start, even where grains in one place have forces of 0/0
                dv = wide3(wide(0.0), wide(0.0), wide(0.0))
                dw = dv
            if lane == 0:
                if CLUMPS:
                    a.sphere_force[i] = force
                    a.sphere_torque[i] = torque
                else:
                    v_out[i] = widen(narrow(widen(g.v) + dv))
                    w_out[i] = widen(narrow(widen(complete(g, private(a, p, i)).w) + dw))
        else:
            v_out[i] = wide3(wide(0.0), wide(0.0), wide(0.0))
            w_out[i] = wide3(wide(0.0), wide(0.0), wide(0.0))


@kernel
def kinetic(a: System, p: Words, v: Wides3, w: Wides3, adders: int, out: Wides):
    """Kinetic energy [J] of every `adders`-th grain of each member, as partial sums in coarse and in fine quanta.

    The sums are exact: the row of a grain decides no bit. A coarse quantum is 2^-48 of the energy of 2^20 grains at the
    limit of speeds, a fine one 2^-48 of a coarse one.
    """
    thread = wp.tid()
    s = thread // adders
    first = thread - s * adders
    m = material(a, s)
    # adding and subtracting a large number rounds to the quantum, the spacing of doubles there
    magic = wide(24.0 * 2.0**20.0) * wide(m.speed_limit2) / m.inverse_mass
    small = magic * wide(2.0**-48.0)
    coarse = wide(0.0)
    fine = wide(0.0)
    for r in range(first, a.rows[s], adders):
        i = s * a.cap + r
        turning = dot(w[i], angular_velocity(m, grain(p, m, i), w[i]))
        energy = wide(0.5) * (dot(v[i], v[i]) / inverse_mass(a, m, i) + turning / inverse_inertia(a, m, i))
        if CLUMPS:
            turning = dot(w[i], clump_spin(a, m, s, i, w[i]))
            energy = wide(0.5) * (dot(v[i], v[i]) / m.inverse_mass + turning / m.inverse_inertia)
        complete = (energy + magic) - magic
        coarse += complete
        fine += ((energy - complete) + small) - small
    out[2 * thread] = coarse
    out[2 * thread + 1] = fine


@kernel
def slab(a: System, p: Words, v: Wides3, low: Wides, high: Wides, counter: Ints, out: Wides):
    """Append rows slot, id, position [m], velocity `v` [m/s] of the grains between the heights `low` and `high` [m] of
    their slots, in any order."""
    i = wp.tid()
    s = i // a.cap
    r = i - s * a.cap
    if r < a.rows[s]:
        m = material(a, s)
        x = grain(p, m, i).x
        if CLUMPS:
            x = a.clump_x[i]
            if clump_row(a, s, r) != i:  # the others of its spheres
                x = wide3(wide(0.0), wide(0.0), wide(PARKED))
        if x[2] > wide(0.5) * wide(PARKED) and x[2] >= low[s] and x[2] <= high[s]:
            at = 8 * wp.atomic_add(counter, 0, 1)
            out[at] = wide(s)
            out[at + 1] = wide(a.ids[i])
            for c in range(3):
                out[at + 2 + c] = x[c]
                out[at + 5 + c] = v[i][c]


@func
def write_contact(out: Wides, at: int, s: int, i: int, j: int, wall: int, force: vec3, branch: wide3):
    """Write one row of `contacts`."""
    out[at] = wide(s)
    out[at + 1] = wide(i)
    out[at + 2] = wide(j)
    out[at + 3] = wide(wall)
    for c in range(3):
        out[at + 4 + c] = wide(force[c])
        out[at + 7 + c] = branch[c]


@kernel
def contacts(a: System, p: Words, counter: Ints, out: Wides):
    """Append rows slot, i, j, wall, force on i [N], branch vector from i [m] of all touching contacts, in any order."""
    i = wp.tid()
    s = i // a.cap
    r = i - s * a.cap
    if r < a.rows[s]:
        m = material(a, s)
        g = grain(p, m, i)
        if g.x[2] > wide(0.5) * wide(PARKED):
            for k in range(a.count[i]):
                at = entry(a, s, a.near, k, r)
                j = s * a.cap + a.nbr[at]
                if a.ids[i] < a.ids[j]:
                    c = with_neighbour(a, p, m, at, j, has_bit(a.held[i], k), g)
                    if c.touches:
                        if CLUMPS:
                            c.branch = a.clump_x[clump_row(a, s, j - s * a.cap)] - a.clump_x[clump_row(a, s, r)]
                        write_contact(
                            out, 10 * wp.atomic_add(counter, 0, 1), s, a.ids[i], a.ids[j], -1, c.force, c.branch
                        )
            if ANY_WALLS:
                for k in range(a.seats * WALL_PARTS):
                    if has_bit(a.wall_near[i], k):
                        c = at_wall(a, m, s, r, k, a.wall_near[i], a.wall_held[i], g)
                        if c.touches:
                            if CLUMPS:
                                c.branch = c.branch + (g.x - a.clump_x[clump_row(a, s, r)])
                            write_contact(
                                out,
                                10 * wp.atomic_add(counter, 0, 1),
                                s,
                                a.ids[i],
                                -1,
                                wall_at(a, s, r, k // WALL_PARTS) - s * a.walls,
                                c.force,
                                c.branch,
                            )
