"""Rods: state, motion, and distances for lists; as `spheres` for these. Contacts: `rod_contacts`."""

from __future__ import annotations

from labbook_dem.motion import predict
from labbook_dem.rotation import axis, spin, turn
from labbook_dem.segments import closest_from
from labbook_dem.words import cross, dot, func, narrow, real, sqrt, struct, vec3, wide, wide3

from labbook_warp.kernels.shown import motion, position, put
from labbook_warp.kernels.system import Material, System
from labbook_warp.kernels.words import (
    Words,
    load_four,
    load_wide4,
    real4,
    store_four,
    store_wide4,
    wide4,
    widen,
)


@struct
class Grain:
    """State of a rod: the shared part (`shown`), and the private part q, w."""

    x: wide3  # [m]
    axis: wide3  # unit vector
    v: vec3  # [m/s], half a step before
    spin: vec3  # [rad/s], half a step before
    u: vec3  # [m/s], v predicted for now
    predicted_spin: vec3  # [rad/s], spin predicted for now
    q: wide4  # unit quaternion (w, x, y, z)
    w: vec3  # [rad/s], reduced angular momentum half a step before


@func
def grain(p: Words, m: Material, i: int):
    """Load the shared state of grain i; q and w are not set."""
    here = position(p, i)
    v, w, u, y = motion(p, i, here)
    g = Grain()
    g.x = here.x
    g.axis = here.axis
    g.v = v
    g.spin = w
    g.u = u
    g.predicted_spin = y
    return g


@struct
class Private:
    """Per-grain data that only its own thread reads; see `Grain`."""

    q: wide4
    w: vec3
    rounding: real  # rounding error of the vertical velocity [m/s]; see `shown`


@func
def private(a: System, p: Words, i: int):
    """Load the private data of grain i."""
    momentum = load_four(a.momentum, i)
    hidden = Private()
    hidden.q = load_wide4(a.turned, i)
    hidden.w = vec3(momentum[0], momentum[1], momentum[2])
    hidden.rounding = momentum[3]
    return hidden


@func
def complete(g: Grain, hidden: Private):
    """Grain with its private data."""
    new = Grain()
    new.x = g.x
    new.axis = g.axis
    new.v = g.v
    new.spin = g.spin
    new.q = hidden.q
    new.w = hidden.w
    return new


@func
def store(a: System, q: Words, i: int, g: Grain, rounding: real):
    """Write grain i; rounding: rounding error of its vertical velocity [m/s]."""
    store_wide4(a.turned, i, g.q)
    store_four(a.momentum, i, real4(g.w[0], g.w[1], g.w[2], rounding))
    put(q, i, g.x, g.axis, g.v, g.spin, g.u, g.predicted_spin)


@func
def moved(m: Material, g: Grain, x: wide3, v: vec3, w: wide3, u: vec3, turn_acc: wide3):
    """Grain at its new position x, with new velocities and orientation; w is not yet rounded.

    turn_acc: torque over the transverse moment of inertia [rad/s^2].
    """
    new = Grain()
    new.x = x
    q0, q1, q2, q3 = turn(g.q[0], g.q[1], g.q[2], g.q[3], w, m.slenderness, m.dt)
    new.q = wide4(q0, q1, q2, q3)
    new.axis = axis(q0, q1, q2, q3)
    new.v = v
    new.w = narrow(w)
    new.u = u
    y = narrow(
        wide3(predict(w[0], turn_acc[0], m.dt), predict(w[1], turn_acc[1], m.dt), predict(w[2], turn_acc[2], m.dt))
    )
    along = narrow(new.axis)
    new.spin = spin(new.w, along, real(m.slenderness))
    new.predicted_spin = spin(y, along, real(m.slenderness))
    return new


@func
def max_speed2(m: Material, g: Grain):
    """Square of an upper bound of the speed [m^2/s^2] of the ends of the rod."""
    axis_rate = cross(g.spin, narrow(g.axis))
    speed = sqrt(dot(g.v, g.v)) + real(m.half) * sqrt(dot(axis_rate, axis_rate))
    return speed * speed


@func
def at_rest(g: Grain, z: wide):
    """Grain at rest at height z [m]."""
    zero = vec3(real(0.0), real(0.0), real(0.0))
    new = Grain()
    new.x = wide3(g.x[0], g.x[1], z)
    new.q = g.q
    new.axis = g.axis
    new.v = zero
    new.w = zero
    new.u = zero
    new.spin = zero
    new.predicted_spin = zero
    return new


@func
def angular_velocity(m: Material, g: Grain, w: wide3):
    """Angular velocity [rad/s] of a grain with reduced angular momentum w [rad/s] (`labbook_dem.rotation`)."""
    return w + g.axis * (m.slenderness * dot(w, g.axis))


# lists


@func
def displacement_and_speed(a: System, m: Material, i: int, g: Grain):
    """Displacement [m] of grain i since the last rebuild, and its speed [m/s]: bounds for its farthest point."""
    shift = g.x - a.origin[i]
    tilt = g.axis - a.facing[i]
    v = widen(g.v)
    w = cross(widen(g.spin), g.axis)
    return sqrt(dot(shift, shift)) + m.half * sqrt(dot(tilt, tilt)), sqrt(dot(v, v)) + m.half * sqrt(dot(w, w))


@func
def store_origin(a: System, i: int, g: Grain):
    """Store the position of grain i at the rebuild of its list."""
    a.origin[i] = g.x
    a.facing[i] = g.axis


@func
def distance2(p: Words, m: Material, g: Grain, j: int):
    """Square of the distance [m^2] to grain j: of the segments if the centres are close enough, else of the centres."""
    there = position(p, j)
    away = g.x - there.x
    d2 = dot(away, away)
    if d2 < m.centres2:
        s, t = closest_from(away, g.axis, there.axis, m.half, True)
        branch = away + g.axis * wide(s) - there.axis * wide(t)
        d2 = dot(branch, branch)
    return d2
