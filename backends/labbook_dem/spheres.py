"""Two spheres, or a sphere and a wall, that touch: from where they are and how they move to forces and torques.

Every expression is odd or even under an exchange of the two spheres, term by term, so that an engine that computes a
contact twice, once for each sphere, gets opposite forces to the last bit.
"""

from labbook_dem.contact import rolling, slip, trial
from labbook_dem.laws.hertz_mindlin import normal, respond
from labbook_dem.words import FRICTION, ROLLING, TWIST, coefs, cross, dot, func, real, sqrt, vec3


@func
def touch(
    c: coefs, rs: real, ms: real, radius: real, delta: real, n: vec3, u: vec3, v: vec3, surface: vec3, turn: vec3,
    s: vec3, dt: real, inertia_rate: real,
):  # fmt: skip
    """Force on i [N], its arm n x f_t, rolling torque on i [N m], and the spring [m].

    u, v: relative velocities, predicted and half a step old [m/s]. surface: sum of lever times spin [m/s]; turn:
    difference of the spins [rad/s]. dt: by how much to advance the spring [s]. The rest as in `labbook_dem.contact`.
    """
    zero = real(0.0)
    vn = dot(u, n)
    if FRICTION:
        vt = slip(n, v, surface)
        fn, ft, kept = respond(c, rs, ms, delta, vn, trial(s, n, vt, dt), vt)
        force = n * fn + ft
        arm = cross(n, ft)
    else:
        fn = normal(c, rs, ms, delta, vn)
        force = n * fn
        arm = vec3(zero, zero, zero)
        kept = arm
    if ROLLING:
        roll = rolling(turn, n, c[5] * radius * fn, inertia_rate, TWIST)
    else:
        roll = vec3(zero, zero, zero)
    return force, arm, roll, kept


@func
def sphere_on_sphere(
    c: coefs, radius: real, mass: real, away: vec3, gap: real, u: vec3, v: vec3, wi: vec3, wj: vec3, s: vec3,
    dt: real, inertia_rate: real,
):  # fmt: skip
    """Force and torque on i, torque on j, spring and overlap [m] of two equal spheres.

    away: branch from j to i [m]; gap: diameter squared less its square [m^2], from which the overlap loses no digit.
    """
    half = real(0.5)
    r = sqrt(dot(away, away))
    delta = gap / (real(2.0) * radius + r)
    lever = half * r
    force, arm, roll, kept = touch(
        c, half * radius, half * mass, radius, delta, away * (real(1.0) / r), u, v, (wi + wj) * lever, wi - wj,
        s, dt, inertia_rate,
    )  # fmt: skip
    arm = arm * lever
    return force, roll - arm, -roll - arm, kept, delta


@func
def sphere_on_wall(
    c: coefs, radius: real, mass: real, delta: real, n: vec3, u: vec3, v: vec3, w: vec3, spin: vec3, s: vec3,
    dt: real, inertia_rate: real,
):  # fmt: skip
    """Force and torque on a sphere, and spring, at a wall with unit normal n that turns with `spin` [rad/s]."""
    lever = radius - delta
    force, arm, roll, kept = touch(
        c, radius, mass, radius, delta, n, u, v, w * lever, w - spin, s, dt, inertia_rate
    )  # fmt: skip
    return force, roll - arm * lever, kept
