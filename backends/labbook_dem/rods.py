"""Contacts of two rods, or of a rod and a point of a wall: contacts of spheres at the closest points of the segments.

A lever is the branch from the centre of a rod to the closest point on its segment, s a; the contact lies half a branch,
or a radius less the overlap, further on. Relative velocities of centres are converted to those of the closest points
here; the surfaces' part of the motion, spin times radius, is that of spheres.

At a wall a rod may touch at several points, its parts, each with a spring of its own. As an end slides from a plate
over its edge, its contact ends as part 0 and begins as part 2, at the same point. Part 0 is the end at -h and part 1
that at +h; part 2 is the edge nearer to the first, part 3 that nearer to the second.
"""

from labbook_dem.spheres import touch
from labbook_dem.words import coefs, cross, dot, func, real, sqrt, vec3


@func
def rod_on_rod(
    c: coefs, radius: real, mass: real, away: vec3, overlap2: real, lever_i: vec3, lever_j: vec3, u: vec3, v: vec3,
    pi: vec3, pj: vec3, wi: vec3, wj: vec3, s: vec3, dt: real, inertia_rate: real,
):  # fmt: skip
    """Force and torque on i, torque on j, spring and overlap [m] of two equal rods.

    away: branch from the closest point of j to that of i [m]; overlap2: diameter squared less its square [m^2],
    positive where they touch. u, v: relative velocities of the centres, predicted and half a step old [m/s]; pi, pj and
    wi, wj: spins likewise [rad/s].
    """
    half = real(0.5)
    r = sqrt(dot(away, away))
    # as in `sphere_on_sphere`: the squares were subtracted in double
    delta = overlap2 / (real(2.0) * radius + r)
    reach = half * r
    u = u + (cross(pi, lever_i) - cross(pj, lever_j))
    v = v + (cross(wi, lever_i) - cross(wj, lever_j))
    force, unit_torque, roll, spring = touch(
        c, half * radius, half * mass, radius, delta, away * (real(1.0) / r), u, v, (wi + wj) * reach, wi - wj,
        s, dt, inertia_rate,
    )  # fmt: skip
    unit_torque = unit_torque * reach
    return force, roll - unit_torque + cross(lever_i, force), -roll - unit_torque - cross(lever_j, force), spring, delta


@func
def rod_on_wall(
    c: coefs, radius: real, mass: real, delta: real, n: vec3, lever: vec3, u: vec3, v: vec3, p: vec3, w: vec3,
    spin: vec3, s: vec3, dt: real, inertia_rate: real,
):  # fmt: skip
    """Force and torque on a rod, and spring, at a point of a wall with unit normal n that turns with `spin` [rad/s].

    u, v: velocities of the centre relative to the wall at the contact; p, w: spins; predicted and half a step old.
    """
    reach = radius - delta
    force, unit_torque, roll, spring = touch(
        c, radius, mass, radius, delta, n, u + cross(p, lever), v + cross(w, lever), w * reach, w - spin,
        s, dt, inertia_rate,
    )  # fmt: skip
    return force, roll - unit_torque * reach + cross(lever, force), spring


@func
def has(parts: int, part: int):
    """True if a mask of parts contains a part."""
    return ((parts >> part) & 1) == 1


@func
def spring_source(part: int, touched: int, touches: int):
    """Part whose spring `part` inherits: its own, that of a part that ended as it began, or -1 for none.

    touched, touches: masks of the parts that touched at the last step and that touch now. No spring goes to two parts:
    that of a part that ended goes to the part on its own side (0 and 2, 1 and 3), else to the other edge or end across,
    else to its like.
    """
    ended = touched & ~touches
    begun = touches & ~touched
    same_side = part ^ 2
    across = part ^ 3
    opposite = part ^ 1
    takes_across = has(ended, across) and not has(begun, across ^ 2)
    takes_like = has(ended, opposite) and not has(begun, opposite ^ 2) and not has(begun, opposite ^ 3)
    source = across if takes_across else (opposite if takes_like else -1)
    return part if has(touched, part) else (same_side if has(ended, same_side) else source)
