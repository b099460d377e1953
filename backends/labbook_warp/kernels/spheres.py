"""A sphere: its state, what it meets, how it moves, and when it is near.

All that depends on the shape of grains stands here, and in `rods` for these; sums over contacts, rows of contacts and
steps do not.
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

from labbook_warp.kernels.bodies import between, body, touching2, with_plate
from labbook_warp.kernels.parts import spring_from_part, spring_to_part, turning_of
from labbook_warp.kernels.shown import motion, put, rest, spot
from labbook_warp.kernels.sums import Contact, rolling_before, spring_before
from labbook_warp.kernels.system import Material, System
from labbook_warp.kernels.walls import wall_velocity
from labbook_warp.kernels.words import MOVING, POSES, Words, load_int, widen


@struct
class Grain:
    """State of a grain."""

    x: wide3  # [m]
    v: vec3  # [m/s], half a step before
    w: vec3  # [rad/s], reduced angular momentum half a step before: of a sphere, its spin
    u: vec3  # [m/s], v predicted for now
    spin: vec3  # [rad/s], half a step before
    index: int  # which it is


@func
def grain(p: Words, m: Material, i: int):
    """Grain i."""
    g = Grain()
    here = spot(p, i)
    g.x = here.x
    v, w, u = motion(p, i, here)
    g.v = v
    g.w = w
    g.u = u
    g.spin = g.w
    g.index = i
    return g


@struct
class Own:
    """What a grain does not show to others."""

    rest: real  # what rounding has kept from the vertical velocity [m/s]; see `shown`


@func
def own(a: System, p: Words, i: int):
    """What grain i does not show."""
    found = Own()
    found.rest = rest(p, i)
    return found


@func
def whole(g: Grain, o: Own):
    """The grain: it shows all that moves it."""
    return g


@func
def store(a: System, q: Words, i: int, g: Grain, more: real):
    """Write grain i."""
    put(q, i, g.x, g.v, g.w, g.u, more)


@func
def moved(m: Material, g: Grain, x: wide3, v: vec3, w: wide3, u: vec3, turn_acc: wide3):
    """The grain at its new place, with what it has of new velocities; w is not yet rounded."""
    new = Grain()
    new.x = x
    new.v = v
    new.w = narrow(w)
    new.u = u
    new.spin = new.w
    new.index = g.index
    return new


@func
def pace2(m: Material, g: Grain):
    """Square of the grain's speed [m^2/s^2]."""
    return dot(g.v, g.v)


@func
def at_rest(g: Grain, z: wide):
    """The grain at height z [m], where it stays."""
    none = vec3(real(0.0), real(0.0), real(0.0))
    new = Grain()
    new.x = wide3(g.x[0], g.x[1], z)
    new.v = none
    new.w = none
    new.u = none
    return new


@func
def spinning(m: Material, g: Grain, w: wide3):
    """Angular velocity [rad/s] of a grain whose reduced angular momentum is w."""
    return w


# what it meets


@func
def with_neighbour(a: System, p: Words, m: Material, at: int, j: int, held: bool, g: Grain):
    """The contact with grain j, whose spring stands at `at` and is valid if `held`."""
    c = Contact()
    there = spot(p, j)
    away = g.x - there.x
    one = body(a, m, g.index)
    other = body(a, m, j)
    # what touched a step ago mostly still does: the rest is asked for before it is known
    last, advance = spring_before(a.spring, at, held, real(wide(0.5) * m.dt))
    v = vec3(real(0.0), real(0.0), real(0.0))
    w = vec3(real(0.0), real(0.0), real(0.0))
    u = vec3(real(0.0), real(0.0), real(0.0))
    if held:
        v, w, u = motion(p, j, there)
    overlap2 = touching2(m, one, other) - dot(away, away)
    c.touches = overlap2 > wide(0.0)
    if c.touches:
        if not held:
            v, w, u = motion(p, j, there)
        f, t, _t, kept, delta = sphere_on_sphere(
            between(a, m, j // a.cap, one, other), one.radius, other.radius, one.mass, other.mass, narrow(away),
            rounded(overlap2), g.u - u, g.v - v, g.w, w, last, advance, one.rolling_rate,
            other.rolling_rate,
        )  # fmt: skip
        if ROLLING_SPRING:
            roll, turned = rolling_on_sphere(
                between(a, m, j // a.cap, one, other), one.radius, other.radius, one.mass, other.mass, narrow(away),
                delta, f, g.w, w, rolling_before(a.rolling, at, held), advance, m.rolling_stiffness, m.rolling_damping,
            )  # fmt: skip
            t = t + roll
            c.rolling = turned
        c.overlap = delta
        c.force = f
        c.torque = t
        c.spring = kept
        c.branch = -away
    return c


@func
def with_wall(a: System, m: Material, wall: int, at: int, held: bool, g: Grain):
    """The contact with a wall, whose spring stands at `at` and is valid if `held`."""
    distance, normal = wall_distance(a.wall_numbers, wall, load_int(a.wall_kind, wall), g.x)
    overlap = rounded(body(a, m, g.index).reach - distance)
    return at_surface(a, m, wall, at, held, g, overlap, distance, normal)


@func
def at_surface(
    a: System, m: Material, wall: int, at: int, older: bool, g: Grain, overlap: real, distance: wide, normal: wide3
):  # fmt: skip
    """The contact with a wall at a distance [m] along a unit normal; older: whether it has a spring at `at`."""
    c = Contact()
    one = body(a, m, g.index)
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
        f, t, kept = sphere_on_wall(
            with_plate(a, wall, one), one.radius, one.mass, overlap, narrow(normal), g.u - surface, g.v - surface, g.w,
            turning, last, advance, one.rolling_rate,
        )  # fmt: skip
        if ROLLING_SPRING:
            if POSES:
                before = spring_from_part(a, wall, rolling_before(a.wall_rolling, at, older))
                roll, turned = rolling_on_wall(
                    with_plate(a, wall, one), one.radius, one.mass, overlap, narrow(normal), f, g.w, turning,
                    before, advance, m.rolling_stiffness, m.rolling_damping,
                )  # fmt: skip
                turned = spring_to_part(a, wall, turned)
            else:
                roll, turned = rolling_on_wall(
                    with_plate(a, wall, one), one.radius, one.mass, overlap, narrow(normal), f, g.w, turning,
                    rolling_before(a.wall_rolling, at, older), advance, m.rolling_stiffness, m.rolling_damping,
                )  # fmt: skip
            t = t + roll
            c.rolling = turned
        c.overlap = overlap
        c.force = f
        c.torque = t
        c.spring = kept
        if POSES:
            c.spring = spring_to_part(a, wall, kept)
        c.branch = -(normal * distance)
    return c


# lists


@func
def strayed(a: System, m: Material, i: int, g: Grain):
    """How far [m] grain i has moved since its list was built, and its speed [m/s] now: of its farthest point."""
    away = g.x - a.origin[i]
    v = widen(g.v)
    return sqrt(dot(away, away)), sqrt(dot(v, v))


@func
def mark(a: System, i: int, g: Grain):
    """Remember where grain i is as its list is built."""
    a.origin[i] = g.x


@func
def apart2(p: Words, m: Material, g: Grain, j: int):
    """Square of the distance [m^2] from grain j: of their centres."""
    away = g.x - spot(p, j).x
    return dot(away, away)
