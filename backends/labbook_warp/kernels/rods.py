"""A rod: its state, how it moves, and when it is near; as `spheres` for these. What it meets: `rod_contacts`."""

from __future__ import annotations

from labbook_dem.motion import predict
from labbook_dem.rotation import axis, spin, turn
from labbook_dem.segments import closest_from
from labbook_dem.words import dot, func, narrow, real, sqrt, struct, vec3, wide, wide3

from labbook_warp.kernels.mixed_rods import motion, put, spot, turning_again
from labbook_warp.kernels.system import Material, System
from labbook_warp.kernels.words import Words, wide4, widen


@struct
class Grain:
    """State of a grain."""

    x: wide3  # [m]
    q: wide4  # unit quaternion (w, x, y, z)
    v: vec3  # [m/s], half a step before
    w: vec3  # [rad/s], reduced angular momentum half a step before
    u: vec3  # [m/s], v predicted for now
    y: vec3  # [rad/s], w predicted for now
    axis: wide3  # unit vector
    spin: vec3  # [rad/s], half a step before
    soon: vec3  # [rad/s], spin predicted for now


@func
def facing(q: wide4):
    """Unit vector along a rod."""
    return axis(q[0], q[1], q[2], q[3])


@func
def grain(p: Words, m: Material, i: int):
    """Grain i."""
    g = Grain()
    here = spot(p, i)
    g.x = here.x
    g.q = here.q
    v, w, u, y = motion(p, i, here)
    g.v = v
    g.w = w
    g.u = u
    g.y = y
    g.axis = facing(g.q)
    g.spin = spin(g.w, narrow(g.axis), real(m.slender))
    g.soon = spin(g.y, narrow(g.axis), real(m.slender))
    return g


@func
def refreshed(p: Words, i: int, g: Grain):
    """The grain with what `forces` need not know of it loaded anew, so that it does not occupy registers meanwhile."""
    q, w = turning_again(p, i)
    new = Grain()
    new.x = g.x
    new.q = q
    new.v = g.v
    new.w = w
    new.axis = g.axis
    return new


@func
def store(q: Words, i: int, g: Grain, more: real):
    """Write grain i."""
    put(q, i, g.x, g.q, g.v, g.w, g.u, g.y, more)


@func
def moved(m: Material, g: Grain, x: wide3, v: vec3, w: wide3, u: vec3, turn_acc: wide3):
    """The grain at its new place, with what it has of new velocities, turned; w is not yet rounded."""
    new = Grain()
    new.x = x
    q0, q1, q2, q3 = turn(g.q[0], g.q[1], g.q[2], g.q[3], w, m.slender, m.dt)
    new.q = wide4(q0, q1, q2, q3)
    new.v = v
    new.w = narrow(w)
    new.u = u
    new.y = vec3(
        real(predict(w[0], turn_acc[0], m.dt)),
        real(predict(w[1], turn_acc[1], m.dt)),
        real(predict(w[2], turn_acc[2], m.dt)),
    )
    new.axis = facing(new.q)
    new.spin = spin(new.w, narrow(new.axis), real(m.slender))
    return new


@func
def at_rest(g: Grain, z: wide):
    """The grain at height z [m], where it stays."""
    none = vec3(real(0.0), real(0.0), real(0.0))
    new = Grain()
    new.x = wide3(g.x[0], g.x[1], z)
    new.q = g.q
    new.v = none
    new.w = none
    new.u = none
    new.y = none
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
    w = widen(g.w)
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
        other = facing(there.q)
        s, t = closest_from(away, g.axis, other, m.half, True)
        branch = away + g.axis * wide(s) - other * wide(t)
        d2 = dot(branch, branch)
    return d2
