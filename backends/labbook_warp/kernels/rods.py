"""A rod: its state, how it moves, and when it is near; as `spheres` for these. What it meets: `rod_contacts`."""

from __future__ import annotations

from labbook_dem.motion import predict
from labbook_dem.rotation import axis, spin, turn
from labbook_dem.segments import closest_from
from labbook_dem.words import cross, dot, func, narrow, real, sqrt, struct, vec3, wide, wide3

from labbook_warp.kernels.shown import motion, put, spot
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
    """State of a grain: what it shows to others, and what only it knows."""

    x: wide3  # [m]
    axis: wide3  # unit vector
    v: vec3  # [m/s], half a step before
    spin: vec3  # [rad/s], half a step before
    u: vec3  # [m/s], v predicted for now
    soon: vec3  # [rad/s], spin predicted for now
    q: wide4  # unit quaternion (w, x, y, z)
    w: vec3  # [rad/s], reduced angular momentum half a step before


@func
def grain(p: Words, m: Material, i: int):
    """Grain i, as far as it shows: q and w are not known."""
    here = spot(p, i)
    v, w, u, y = motion(p, i, here)
    g = Grain()
    g.x = here.x
    g.axis = here.axis
    g.v = v
    g.spin = w
    g.u = u
    g.soon = y
    return g


@struct
class Own:
    """What a grain does not show: see `Grain`."""

    q: wide4
    w: vec3
    rest: real  # what rounding has kept from the vertical velocity [m/s]; see `shown`


@func
def own(a: System, p: Words, i: int):
    """What grain i does not show."""
    momentum = load_four(a.momentum, i)
    found = Own()
    found.q = load_wide4(a.turned, i)
    found.w = vec3(momentum[0], momentum[1], momentum[2])
    found.rest = momentum[3]
    return found


@func
def whole(g: Grain, o: Own):
    """The grain with what it does not show."""
    new = Grain()
    new.x = g.x
    new.axis = g.axis
    new.v = g.v
    new.spin = g.spin
    new.q = o.q
    new.w = o.w
    return new


@func
def store(a: System, q: Words, i: int, g: Grain, more: real):
    """Write grain i."""
    store_wide4(a.turned, i, g.q)
    store_four(a.momentum, i, real4(g.w[0], g.w[1], g.w[2], more))
    put(q, i, g.x, g.axis, g.v, g.spin, g.u, g.soon)


@func
def moved(m: Material, g: Grain, x: wide3, v: vec3, w: wide3, u: vec3, turn_acc: wide3):
    """The grain at its new place, with new velocities, turned; w is not yet rounded."""
    new = Grain()
    new.x = x
    q0, q1, q2, q3 = turn(g.q[0], g.q[1], g.q[2], g.q[3], w, m.slender, m.dt)
    new.q = wide4(q0, q1, q2, q3)
    new.axis = axis(q0, q1, q2, q3)
    new.v = v
    new.w = narrow(w)
    new.u = u
    y = narrow(
        wide3(predict(w[0], turn_acc[0], m.dt), predict(w[1], turn_acc[1], m.dt), predict(w[2], turn_acc[2], m.dt))
    )
    along = narrow(new.axis)
    new.spin = spin(new.w, along, real(m.slender))
    new.soon = spin(y, along, real(m.slender))
    return new


@func
def pace2(m: Material, g: Grain):
    """Square of the largest speed [m^2/s^2] that an end of the grain may have."""
    turning = cross(g.spin, narrow(g.axis))
    speed = sqrt(dot(g.v, g.v)) + real(m.half) * sqrt(dot(turning, turning))
    return speed * speed


@func
def at_rest(g: Grain, z: wide):
    """The grain at height z [m], where it stays."""
    none = vec3(real(0.0), real(0.0), real(0.0))
    new = Grain()
    new.x = wide3(g.x[0], g.x[1], z)
    new.q = g.q
    new.axis = g.axis
    new.v = none
    new.w = none
    new.u = none
    new.spin = none
    new.soon = none
    return new


@func
def spinning(m: Material, g: Grain, w: wide3):
    """Angular velocity [rad/s] of a grain whose reduced angular momentum is w."""
    return w + g.axis * (m.slender * dot(w, g.axis))


# lists


@func
def strayed(a: System, m: Material, i: int, g: Grain):
    """How far [m] grain i has moved since its list was built, and its speed [m/s] now: of its farthest point."""
    away = g.x - a.origin[i]
    tilt = g.axis - a.facing[i]
    v = widen(g.v)
    w = cross(widen(g.spin), g.axis)
    return sqrt(dot(away, away)) + m.half * sqrt(dot(tilt, tilt)), sqrt(dot(v, v)) + m.half * sqrt(dot(w, w))


@func
def mark(a: System, i: int, g: Grain):
    """Remember where grain i is as its list is built."""
    a.origin[i] = g.x
    a.facing[i] = g.axis


@func
def apart2(p: Words, m: Material, g: Grain, j: int):
    """Square of the distance [m^2] from grain j: of their segments, where their centres are near enough to matter."""
    there = spot(p, j)
    away = g.x - there.x
    d2 = dot(away, away)
    if d2 < m.centres2:
        s, t = closest_from(away, g.axis, there.axis, m.half, True)
        branch = away + g.axis * wide(s) - there.axis * wide(t)
        d2 = dot(branch, branch)
    return d2
