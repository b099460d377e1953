"""What a grain meets: the contact with one of its neighbours, and with one of the walls near it.

All that depends on the shape of grains stands here; sums over contacts, rows of contacts and steps do not.
"""

from __future__ import annotations

from labbook_dem.spheres import sphere_on_sphere, sphere_on_wall
from labbook_dem.words import FRICTION, dot, func, narrow, real, struct, vec3, wide, wide3

from labbook_warp.kernels.bodies import Body, at_wall, between, body, touching2
from labbook_warp.kernels.mixed import position, predicted, spin, velocity
from labbook_warp.kernels.system import Material, System
from labbook_warp.kernels.walls import wall_distance, wall_velocity
from labbook_warp.kernels.words import MOVING, Vectors, Words


@struct
class Contact:
    """A contact as one grain sees it; where nothing touches, only `touches` means something."""

    touches: bool
    overlap: real  # [m]
    force: vec3  # [N]
    torque: vec3  # [N m]
    spring: vec3  # [m], to be kept for the next step
    branch: wide3  # [m], from the centre of the grain to that of its neighbour, or to the wall


@func
def spring_before(springs: Vectors, at: int, held: bool, half_dt: real):
    """A contact's spring [m], and by how much to advance it [s]: a new one is half a step old."""
    last = vec3(real(0.0), real(0.0), real(0.0))
    advance = half_dt
    if FRICTION:
        if held:
            last = springs[at]
            advance = half_dt + half_dt
    return last, advance


@func
def with_neighbour(
    a: System, p: Words, m: Material, s: int, one: Body, at: int, j: int, held: bool, x: wide3, v: vec3, w: vec3,
    u: vec3,
):  # fmt: skip
    """The contact of a grain (`one`; x, v, w, u) of slot s with grain j; its spring is at `at`, valid if `held`."""
    c = Contact()
    away = x - position(p, j)
    other = body(a, m, j)
    gap = touching2(m, one, other) - dot(away, away)
    c.touches = gap > wide(0.0)
    if c.touches:
        last, advance = spring_before(a.spring, at, held, real(wide(0.5) * m.dt))
        f, t, _t, kept, delta = sphere_on_sphere(
            between(a, m, s, one, other), one.radius, other.radius, one.mass, other.mass, narrow(away), real(gap),
            u - predicted(p, j), v - velocity(p, j), w, spin(p, j), last, advance, one.rolling_rate, other.rolling_rate,
        )  # fmt: skip
        c.overlap = delta
        c.force = f
        c.torque = t
        c.spring = kept
        c.branch = -away
    return c


@func
def with_wall(
    a: System, m: Material, one: Body, g: int, at: int, held: bool, x: wide3, v: vec3, w: vec3, u: vec3
):  # fmt: skip
    """The contact of a grain (`one`; x, v, w, u) with wall g, whose spring stands at `at` and is valid if `held`."""
    c = Contact()
    distance, normal = wall_distance(a, g, x)
    overlap = real(one.reach - distance)
    c.touches = overlap > real(0.0)
    if c.touches:
        last, advance = spring_before(a.wall_spring, at, held, real(wide(0.5) * m.dt))
        surface = vec3(real(0.0), real(0.0), real(0.0))
        turning = vec3(real(0.0), real(0.0), real(0.0))
        if MOVING:
            surface = narrow(wall_velocity(a, g, x - normal * distance))
            turning = vec3(real(0.0), real(0.0), real(a.wall_motion[g][3]))
        f, t, kept = sphere_on_wall(
            at_wall(a, g, one), one.radius, one.mass, overlap, narrow(normal), u - surface, v - surface, w, turning,
            last, advance, one.rolling_rate,
        )  # fmt: skip
        c.overlap = overlap
        c.force = f
        c.torque = t
        c.spring = kept
        c.branch = -(normal * distance)
    return c
