"""Clumps: their motion, and that of the spheres that they consist of; as `spheres` and `rods`.

Pairs, walls and readings are those of spheres, whose rows follow from those of the clumps after each step.
"""

from labbook_dem.clumps import first_axis, from_body, sphere_velocity, spin_of_clump, torque_on_clump, turn_clump
from labbook_dem.motion import drift, kick, predict
from labbook_dem.rotation import axis
from labbook_dem.words import dot, func, wide, wide3

from labbook_numba.kernels.features import (
    CLUMP,
    FIRST,
    GRAINS,
    LAST,
    LOAD,
    OUTLET,
    F,
    M,
    P,
    Q,
    T,
    U,
    V,
    W,
    X,
    entry,
    int64,
    kernel,
    uint64,
)
from labbook_numba.kernels.transfer import load, store
from labbook_numba.lanes import put_row, row_at
from labbook_numba.state import Params, State


@func
def lever_of(clumps, i, spheres, k):
    """Branch from the centre of mass of clump i to the centre of its sphere k [m]."""
    centre = wide3(spheres[k, 0], spheres[k, 1], spheres[k, 2])
    return from_body(clumps[i, Q], clumps[i, Q + 1], clumps[i, Q + 2], clumps[i, Q + 3], centre)


@func
def centre_of_clump(st: State, p: Params, row):
    """Centre of mass of the clump of the sphere in a row [m]."""
    return load(st.clumps, row // len(p.spheres), X)


@kernel
def place_spheres(clumps, grains, spheres, i):
    """Write the rows of the spheres of clump i, and return the square of the longest way of one [m^2]."""
    x, v, u = load(clumps, i, X), load(clumps, i, V), load(clumps, i, U)
    w, p = load(clumps, i, W), load(clumps, i, P)
    way2 = wide(0.0)
    for k in range(len(spheres)):
        row = i * len(spheres) + k
        lever = lever_of(clumps, i, spheres, k)
        way = x + lever - load(grains, row, X)
        # so written that NaN is the longest way
        if not dot(way, way) <= way2:
            way2 = dot(way, way)
        store(grains, row, X, x + lever)
        store(grains, row, V, sphere_velocity(v, w, lever))
        store(grains, row, U, sphere_velocity(u, p, lever))
        store(grains, row, W, w)
    return way2


@entry
def place_all_spheres(st: State, p: Params, first, last):
    """Write the rows of the spheres of clumps first..last."""
    for i in range(first, last):
        place_spheres(st.clumps, st.grains, p.spheres, i)


@kernel
def collect_loads(st: State, p: Params):
    """Add the forces and torques on spheres to those on the domain's clumps."""
    clumps, loads, totals, spheres = st.clumps, st.loads, st.clump_loads, p.spheres
    count = len(spheres)
    for i in range(st.domain[FIRST] // count, st.domain[LAST] // count):
        force, torque = load(totals, i, F), load(totals, i, T)
        for k in range(count):
            on_sphere = load(loads, i * count + k, F)
            force = force + on_sphere
            about_sphere = load(loads, i * count + k, T)
            torque = torque + torque_on_clump(about_sphere, on_sphere, lever_of(clumps, i, spheres, k))
        store(totals, i, F, force)
        store(totals, i, T, torque)


@kernel
def move(st: State, p: Params, kick_dt, dt):
    """Kick, drift, turn and predict the domain's clumps, and their spheres with them; replace forces by gravity.

    Writes squares of the speeds of spheres [m^2/s^2], and zero for those of leavers.
    """
    g, loads, spheres = st.clumps, st.clump_loads, p.spheres
    flat, slender = p.flat, p.slender
    inverse_mass, inverse_inertia = wide(1.0) / p.mass, wide(1.0) / p.inertia
    count = len(spheres)
    for i in range(uint64(st.domain[FIRST]) // uint64(count), uint64(st.domain[LAST]) // uint64(count)):
        at = i * CLUMP
        acceleration = row_at(loads, i * LOAD + F) * inverse_mass
        v = kick(row_at(g, at + V), acceleration, kick_dt)
        put_row(g, at + V, v)
        put_row(g, at + X, drift(row_at(g, at + X), v, dt))
        # dashpots take velocities at the time of the positions
        put_row(g, at + U, predict(v, acceleration, dt))
        turn_acc = row_at(loads, i * LOAD + T) * inverse_inertia
        put_row(g, at + M, kick(row_at(g, at + M), turn_acc, kick_dt))
        m = load(g, i, M)
        qw, qx, qy, qz = turn_clump(g[i, Q], g[i, Q + 1], g[i, Q + 2], g[i, Q + 3], m, flat, slender, dt)
        g[i, Q] = qw
        g[i, Q + 1] = qx
        g[i, Q + 2] = qy
        g[i, Q + 3] = qz
        first, third = first_axis(qw, qx, qy, qz), axis(qw, qx, qy, qz)
        store(g, i, W, spin_of_clump(m, first, third, flat, slender))
        put_row(g, at + P, predict(row_at(g, at + M), turn_acc, dt))
        store(g, i, P, spin_of_clump(load(g, i, P), first, third, flat, slender))
        speed2 = place_spheres(g, st.grains, spheres, int64(i)) / (dt * dt)
        if OUTLET and g[i, X + 2] < p.drop:
            # a leaver falls freely and fast: it shall not cause rebuilds or meet the guard
            speed2 = wide(0.0)
        zero = row_at(loads, i * LOAD + F) * wide(0.0)
        put_row(loads, i * LOAD + F, zero)
        put_row(loads, i * LOAD + T, zero)
        loads[i, F + 2] = -p.mass * p.gravity
        for k in range(count):
            row = i * uint64(count) + uint64(k)
            st.speed2[row] = speed2
            put_row(st.loads, row * LOAD + F, zero)
            put_row(st.loads, row * LOAD + T, zero)


@kernel
def drop_clumps(st: State, p: Params, place):
    """Remove clumps whose spheres were removed, and keep the order of the others; place: new rows of spheres, or -1."""
    count = len(p.spheres)
    new_row = 0
    for i in range(st.count[GRAINS] // count):
        if place[i * count] >= 0:
            for c in range(CLUMP):
                st.clumps[new_row, c] = st.clumps[i, c]
            for c in range(LOAD):
                st.clump_loads[new_row, c] = st.clump_loads[i, c]
            new_row += 1


@kernel
def contact_work(st: State, p: Params, kick_dt):
    """Work [J] of the contact forces during the next kick: force times mean velocity of the kick."""
    g, loads = st.clumps, st.clump_loads
    work = wide(0.0)
    half = wide(0.5) * kick_dt
    for i in range(st.count[GRAINS] // len(p.spheres)):
        force = load(loads, i, F)
        torque = load(loads, i, T)
        # mean velocities of the kick, as for spheres; loads hold the weight too, whose work is taken off
        v = load(g, i, V) + force * (half / p.mass)
        m = load(g, i, M) + torque * (half / p.inertia)
        qw, qx, qy, qz = g[i, Q], g[i, Q + 1], g[i, Q + 2], g[i, Q + 3]
        spin = spin_of_clump(m, first_axis(qw, qx, qy, qz), axis(qw, qx, qy, qz), p.flat, p.slender)
        work += dot(force, v) + p.mass * p.gravity * v.z + dot(torque, spin)
    return work * kick_dt


@func
def spin_after(grains, loads, body, i, duration, p: Params):
    """Spin [rad/s] of the clump in row i of `grains`, `duration` [s] later under the torque in `loads`."""
    m = load(grains, i, M) + load(loads, i, T) * (duration / p.inertia)
    qw, qx, qy, qz = grains[i, Q], grains[i, Q + 1], grains[i, Q + 2], grains[i, Q + 3]
    return spin_of_clump(m, first_axis(qw, qx, qy, qz), axis(qw, qx, qy, qz), p.flat, p.slender)
