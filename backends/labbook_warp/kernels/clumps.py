"""Clumps: their motion, and that of the spheres that they consist of. Pairs and walls are those of spheres.

The spheres of a clump have rows one after another, from a multiple of their number on. The state of the clump itself
is in arrays of its own, in the row of its first sphere.
"""

from __future__ import annotations

from labbook_dem.clumps import first_axis, from_body, sphere_velocity, spin_of_clump, torque_on_clump, turn_clump
from labbook_dem.motion import drift, kick, predict
from labbook_dem.rotation import axis
from labbook_dem.words import dot, func, narrow, real, rounded, struct, vec3, wide, wide3

from labbook_warp.kernels.shown import position, put
from labbook_warp.kernels.spheres import Grain
from labbook_warp.kernels.step import check_speed, record_crossing
from labbook_warp.kernels.system import Material, System, material
from labbook_warp.kernels.words import (
    CROSSING,
    LEDGER,
    MOST_SPHERES,
    OUTLET,
    PARKED,
    Wides3,
    Words,
    int64,
    kernel,
    load_int,
    wide4,
    wp,
)


@func
def lever_of(a: System, s: int, i: int, k: int):
    """Branch from the centre of mass of the clump in row i of slot s to the centre of its sphere k [m]."""
    q = a.turned[i]
    return from_body(q[0], q[1], q[2], q[3], a.clump_spheres[s * MOST_SPHERES + k])


@struct
class Loads:
    """Contact force [N] and torque [N m] on a clump."""

    force: wide3
    torque: wide3


@func
def clump_loads(a: System, s: int, i: int, count: int):
    """Sum of forces and torques on the spheres of the clump in row i, in the order of spheres."""
    zero = wide3(wide(0.0), wide(0.0), wide(0.0))
    loads = Loads()
    loads.force = zero
    loads.torque = zero
    for k in range(count):
        on_sphere = a.sphere_force[i + k]
        loads.force = loads.force + on_sphere
        loads.torque = loads.torque + torque_on_clump(a.sphere_torque[i + k], on_sphere, lever_of(a, s, i, k))
    return loads


@func
def clump_spin(a: System, m: Material, s: int, i: int, w: wide3):
    """Angular velocity [rad/s] of the clump in row i with reduced angular momentum w [rad/s]."""
    q = a.turned[i]
    first = first_axis(q[0], q[1], q[2], q[3])
    return spin_of_clump(w, first, axis(q[0], q[1], q[2], q[3]), a.clump_flat[s], m.slenderness)


@func
def kicked(v: wide3, acc: wide3, dt: wide):
    """Velocity after a kick of dt [s]."""
    return wide3(kick(v[0], acc[0], dt), kick(v[1], acc[1], dt), kick(v[2], acc[2], dt))


@func
def predicted(v: wide3, acc: wide3, dt: wide):
    """Velocity predicted for the time of positions."""
    return wide3(predict(v[0], acc[0], dt), predict(v[1], acc[1], dt), predict(v[2], acc[2], dt))


@func
def park_clump(a: System, q: Words, s: int, i: int, count: int, x: wide3):
    """Put away a clump that is far below the outlet: it touches no grain that is still counted."""
    wp.atomic_add(a.left, s, count)
    away = wide3(x[0], x[1], wide(PARKED))
    zero = vec3(real(0.0), real(0.0), real(0.0))
    for k in range(count):
        # its last contacts no longer count
        a.held[i + k] = wp.uint32(0)
        a.wall_held[i + k] = wp.uint32(0)
        if LEDGER:
            a.deep[i + k] = wide(0.0)
        put(q, i + k, away, zero, zero, zero, real(0.0))
    a.clump_x[i] = away
    a.clump_v[i] = wide3(wide(0.0), wide(0.0), wide(0.0))
    a.clump_m[i] = wide3(wide(0.0), wide(0.0), wide(0.0))


@func
def advance_clump(a: System, p: Words, q: Words, m: Material, s: int, i: int, now: int64, count: int):
    """Move the clump in row i by one step (leapfrog; `labbook_dem.motion`), and write its spheres to q."""
    kick_dt = m.dt
    if now == wp.int64(0):
        kick_dt = wide(0.5) * m.dt  # the first kick brings velocities from a whole to a half step
    loads = clump_loads(a, s, i, count)
    acc = loads.force * m.inverse_mass + wide3(wide(0.0), wide(0.0), wide(-1.0)) * m.gravity
    turn_acc = loads.torque * m.inverse_inertia
    x0 = a.clump_x[i]
    v0 = a.clump_v[i]
    w0 = a.clump_m[i]
    if LEDGER:
        half_dt = wide(0.5) * kick_dt
        spin_mid = clump_spin(a, m, s, i, w0 + turn_acc * half_dt)
        a.work[i] = a.work[i] + (dot(loads.force, v0 + acc * half_dt) + dot(loads.torque, spin_mid)) * kick_dt
    v = kicked(v0, acc, kick_dt)
    w = kicked(w0, turn_acc, kick_dt)
    x = wide3(drift(x0[0], v[0], m.dt), drift(x0[1], v[1], m.dt), drift(x0[2], v[2], m.dt))
    u = predicted(v, acc, m.dt)
    before = a.turned[i]
    q0, q1, q2, q3 = turn_clump(before[0], before[1], before[2], before[3], w, a.clump_flat[s], m.slenderness, m.dt)
    a.turned[i] = wide4(q0, q1, q2, q3)
    spin = clump_spin(a, m, s, i, w)
    predicted_spin = clump_spin(a, m, s, i, predicted(w, turn_acc, m.dt))
    if CROSSING:
        plane = a.domain[s].plane
        if x[2] < plane:
            if a.gone[i] == 0:
                g = Grain()
                g.x = x
                g.v = narrow(v)
                g.spin = narrow(spin)
                record_crossing(a, plane, m.dt, s, i, now, x0[2], g)
    stays = bool(True)
    if OUTLET:
        if x[2] < a.domain[s].drop:
            stays = bool(False)
            park_clump(a, q, s, i, count, x)
    if stays:
        a.clump_x[i] = x
        a.clump_v[i] = v
        a.clump_m[i] = w
        way2 = wide(0.0)
        for k in range(count):
            lever = lever_of(a, s, i, k)
            centre = x + lever
            way = centre - position(p, i + k).x
            # so written that NaN is the longest way
            if not dot(way, way) <= way2:
                way2 = dot(way, way)
            put(
                q, i + k, centre, narrow(sphere_velocity(v, spin, lever)), narrow(spin),
                narrow(sphere_velocity(u, predicted_spin, lever)), real(0.0),
            )  # fmt: skip
        check_speed(a, m, s, i, now, rounded(way2 / (m.dt * m.dt)), dot(w, w) >= wide(0.0))


@kernel
def move_clumps(a: System, p: Words, q: Words, slot: int, first: int):
    """Take step `first` of this beat with the clumps of the slots from `slot` on, whose spheres have their forces."""
    i = slot * a.cap + wp.tid()
    s = i // a.cap
    r = i - s * a.cap
    if r < load_int(a.rows, s):
        count = load_int(a.clump_size, s)
        if r % count == 0:
            if a.clump_x[i][2] > wide(0.5) * wide(PARKED):
                advance_clump(a, p, q, material(a, s), s, i, a.step[s] + wp.int64(first), count)


@kernel
def whole_step_of_clumps(a: System, v_out: Wides3, w_out: Wides3):
    """Velocities [m/s] and reduced angular momenta [rad/s] at the whole step, in rows of first spheres; else zero."""
    i = wp.tid()
    s = i // a.cap
    r = i - s * a.cap
    v_out[i] = wide3(wide(0.0), wide(0.0), wide(0.0))
    w_out[i] = wide3(wide(0.0), wide(0.0), wide(0.0))
    if r < a.rows[s]:
        count = a.clump_size[s]
        if r % count == 0:
            if a.clump_x[i][2] > wide(0.5) * wide(PARKED):
                m = material(a, s)
                v = a.clump_v[i]
                w = a.clump_m[i]
                if a.step[s] > wp.int64(0):  # else velocities of the start, even where forces are 0/0
                    half_dt = wide(0.5) * m.dt
                    loads = clump_loads(a, s, i, count)
                    gravity = wide3(wide(0.0), wide(0.0), wide(-1.0)) * m.gravity
                    v = v + (loads.force * m.inverse_mass + gravity) * half_dt
                    w = w + loads.torque * (m.inverse_inertia * half_dt)
                v_out[i] = v
                w_out[i] = w
