"""Spheres: state, contacts, motion, and distances for lists.

Only this module and `rods` depend on the shape of grains; sums over contacts, rows of contacts and steps do not.
"""

from __future__ import annotations

from labbook_dem.chosen import wall_distance
from labbook_dem.spheres import rolling_on_sphere, rolling_on_wall, sphere_on_sphere, sphere_on_wall
from labbook_dem.words import (
    ROLLING_SPRING,
    dot,
    func,
    narrow,
    real,
    rounded,
    sqrt,
    struct,
    vec3,
    wide,
    wide3,
)

from labbook_warp.kernels.bodies import body, contact_distance2, pair_coefficients, wall_coefficients
from labbook_warp.kernels.parts import spring_from_part, spring_to_part, turning_of
from labbook_warp.kernels.shown import motion, position, put, rounding_error
from labbook_warp.kernels.sums import Contact, rolling_before, spring_before
from labbook_warp.kernels.system import Material, System
from labbook_warp.kernels.walls import wall_velocity
from labbook_warp.kernels.words import MOVING, POSES, Words, load_int, widen


@struct
class Grain:
    """State of a sphere."""

    x: wide3  # [m]
    v: vec3  # [m/s], half a step before
    w: vec3  # [rad/s], reduced angular momentum half a step before, which is a sphere's spin
    u: vec3  # [m/s], v predicted for now
    spin: vec3  # [rad/s], half a step before
    index: int  # its row among all slots


@func
def grain(p: Words, m: Material, i: int):
    """Load grain i."""
    g = Grain()
    here = position(p, i)
    g.x = here.x
    v, w, u = motion(p, i, here)
    g.v = v
    g.w = w
    g.u = u
    g.spin = g.w
    g.index = i
    return g


@struct
class Private:
    """Per-grain data that only its own thread reads."""

    rounding: real  # rounding error of the vertical velocity [m/s]; see `shown`


@func
def private(a: System, p: Words, i: int):
    """Load the private data of grain i."""
    hidden = Private()
    hidden.rounding = rounding_error(p, i)
    return hidden


@func
def complete(g: Grain, hidden: Private):
    """Grain with its private data: the shared state of a sphere is complete."""
    return g


@func
def store(a: System, q: Words, i: int, g: Grain, rounding: real):
    """Write grain i; rounding: rounding error of its vertical velocity [m/s]."""
    put(q, i, g.x, g.v, g.w, g.u, rounding)


@func
def moved(m: Material, g: Grain, x: wide3, v: vec3, w: wide3, u: vec3, turn_acc: wide3):
    """Grain at its new position x, with new velocities; w is not yet rounded."""
    new = Grain()
    new.x = x
    new.v = v
    new.w = narrow(w)
    new.u = u
    new.spin = new.w
    new.index = g.index
    return new


@func
def max_speed2(m: Material, g: Grain):
    """Square of the grain's speed [m^2/s^2]."""
    return dot(g.v, g.v)


@func
def at_rest(g: Grain, z: wide):
    """Grain at rest at height z [m]."""
    zero = vec3(real(0.0), real(0.0), real(0.0))
    new = Grain()
    new.x = wide3(g.x[0], g.x[1], z)
    new.v = zero
    new.w = zero
    new.u = zero
    return new


@func
def angular_velocity(m: Material, g: Grain, w: wide3):
    """Angular velocity [rad/s] of a grain with reduced angular momentum w [rad/s]."""
    return w


# contacts


@func
def with_neighbour(a: System, p: Words, m: Material, at: int, j: int, has_spring: bool, g: Grain):
    """Contact with grain j, whose spring is entry `at`; has_spring: it is valid."""
    c = Contact()
    there = position(p, j)
    branch = g.x - there.x
    first = body(a, m, g.index)
    second = body(a, m, j)
    # most contacts of the last step persist: their velocities are loaded before the overlap is known
    last, advance = spring_before(a.spring, at, has_spring, real(wide(0.5) * m.dt))
    v = vec3(real(0.0), real(0.0), real(0.0))
    w = vec3(real(0.0), real(0.0), real(0.0))
    u = vec3(real(0.0), real(0.0), real(0.0))
    if has_spring:
        v, w, u = motion(p, j, there)
    overlap2 = contact_distance2(m, first, second) - dot(branch, branch)
    c.touches = overlap2 > wide(0.0)
    if c.touches:
        if not has_spring:
            v, w, u = motion(p, j, there)
        f, t, _t, spring, delta = sphere_on_sphere(
            pair_coefficients(a, m, j // a.cap, first, second), first.radius, second.radius, first.mass, second.mass,
            narrow(branch), rounded(overlap2), g.u - u, g.v - v, g.w, w, last, advance, first.rolling_rate,
            second.rolling_rate,
        )  # fmt: skip
        if ROLLING_SPRING:
            rolling, rolling_torque = rolling_on_sphere(
                pair_coefficients(a, m, j // a.cap, first, second), first.radius, second.radius, first.mass,
                second.mass, narrow(branch), delta, f, g.w, w, rolling_before(a.rolling, at, has_spring), advance,
                m.rolling_stiffness, m.rolling_damping,
            )  # fmt: skip
            t = t + rolling
            c.rolling = rolling_torque
        c.overlap = delta
        c.force = f
        c.torque = t
        c.spring = spring
        c.branch = -branch
    return c


@func
def with_wall(a: System, m: Material, wall: int, at: int, has_spring: bool, g: Grain):
    """Contact with a wall, whose spring is entry `at`; has_spring: it is valid."""
    distance, normal = wall_distance(a.wall_numbers, wall, load_int(a.wall_kind, wall), g.x)
    overlap = rounded(body(a, m, g.index).reach - distance)
    return at_surface(a, m, wall, at, has_spring, g, overlap, distance, normal)


@func
def at_surface(
    a: System, m: Material, wall: int, at: int, older: bool, g: Grain, overlap: real, distance: wide, normal: wide3
):  # fmt: skip
    """Contact with a wall at a distance [m] along a unit normal; older: it touched before, with a spring at `at`."""
    c = Contact()
    b = body(a, m, g.index)
    c.touches = overlap > real(0.0)
    if c.touches:
        last, advance = spring_before(a.wall_spring, at, older, real(wide(0.5) * m.dt))
        surface = vec3(real(0.0), real(0.0), real(0.0))
        turning = vec3(real(0.0), real(0.0), real(0.0))
        if MOVING:
            surface = narrow(wall_velocity(a, wall, g.x - normal * distance))
            turning = vec3(real(0.0), real(0.0), real(a.wall_motion[wall][3]))
        if POSES:
            turning = turning + turning_of(a, wall)
            last = spring_from_part(a, wall, last)
        f, t, spring = sphere_on_wall(
            wall_coefficients(a, wall, b), b.radius, b.mass, overlap, narrow(normal), g.u - surface, g.v - surface, g.w,
            turning, last, advance, b.rolling_rate,
        )  # fmt: skip
        if ROLLING_SPRING:
            if POSES:
                before = spring_from_part(a, wall, rolling_before(a.wall_rolling, at, older))
                roll, turned = rolling_on_wall(
                    wall_coefficients(a, wall, b), b.radius, b.mass, overlap, narrow(normal), f, g.w, turning,
                    before, advance, m.rolling_stiffness, m.rolling_damping,
                )  # fmt: skip
                turned = spring_to_part(a, wall, turned)
            else:
                roll, turned = rolling_on_wall(
                    wall_coefficients(a, wall, b), b.radius, b.mass, overlap, narrow(normal), f, g.w, turning,
                    rolling_before(a.wall_rolling, at, older), advance, m.rolling_stiffness, m.rolling_damping,
                )  # fmt: skip
            t = t + roll
            c.rolling = turned
        c.overlap = overlap
        c.force = f
        c.torque = t
        c.spring = spring
        if POSES:
            c.spring = spring_to_part(a, wall, spring)
        c.branch = -(normal * distance)
    return c


# lists


@func
def displacement_and_speed(a: System, m: Material, i: int, g: Grain):
    """Displacement [m] of grain i since the last rebuild, and its speed [m/s]: bounds for its farthest point."""
    shift = g.x - a.origin[i]
    v = widen(g.v)
    return sqrt(dot(shift, shift)), sqrt(dot(v, v))


@func
def store_origin(a: System, i: int, g: Grain):
    """Store the position of grain i at the rebuild of its list."""
    a.origin[i] = g.x


@func
def distance2(p: Words, m: Material, g: Grain, j: int):
    """Square of the distance [m^2] from the centre of grain j."""
    away = g.x - position(p, j).x
    return dot(away, away)
