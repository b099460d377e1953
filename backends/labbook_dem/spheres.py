"""Contacts of two spheres, or a sphere and a wall: from positions and velocities to forces and torques.

Every expression is odd or even under an exchange of the two spheres, term by term. So a backend that computes a contact
twice, once for each sphere, gets opposite forces to the last bit.
"""

from labbook_dem.chosen import normal, respond
from labbook_dem.coefficients import MU_R
from labbook_dem.contact import rolling, rolling_spring, slip, trial
from labbook_dem.words import FRICTION, ROLLING, TWIST, VARIED, coefs, cross, dot, func, real, sqrt, vec3


@func
def touch(
    c: coefs, rs: real, ms: real, radius: real, delta: real, n: vec3, u: vec3, v: vec3, surface: vec3, turn: vec3,
    s: vec3, dt: real, inertia_rate: real,
):  # fmt: skip
    """Force on i [N], its torque n x f_t on a lever of 1 m, rolling torque on i [N m], and spring [m] of a contact.

    rs, ms: effective radius [m] and mass [kg]; radius: lever of rolling resistance [m]. u, v: relative velocities,
    predicted and half a step old [m/s]. surface: sum of lever times spin [m/s]; turn: difference of the spins [rad/s].
    dt: time to advance the spring by [s]. The rest as in `labbook_dem.contact`.
    """
    zero = real(0.0)
    vn = dot(u, n)
    if FRICTION:
        vt = slip(n, v, surface)
        fn, ft, spring = respond(c, rs, ms, delta, vn, trial(s, n, vt, dt), vt)
        force = n * fn + ft
        unit_torque = cross(n, ft)
    else:
        fn = normal(c, rs, ms, delta, vn)
        force = n * fn
        unit_torque = vec3(zero, zero, zero)
        spring = unit_torque
    if ROLLING:
        roll = rolling(turn, n, c[MU_R] * radius * abs(fn), inertia_rate, TWIST)
    else:
        roll = vec3(zero, zero, zero)
    return force, unit_torque, roll, spring


@func
def effective(a: real, b: real):
    """Effective radius or mass a b/(a + b) of two spheres."""
    return a * b / (a + b) if VARIED else real(0.5) * a


@func
def sphere_on_sphere(
    c: coefs, ri: real, rj: real, mi: real, mj: real, away: vec3, overlap2: real, u: vec3, v: vec3, wi: vec3, wj: vec3,
    s: vec3, dt: real, rate_i: real, rate_j: real,
):  # fmt: skip
    """Force and torque on i, torque on j, spring and overlap [m] of two spheres of radii ri, rj and masses mi, mj.

    away: branch from j to i [m]; overlap2: (ri + rj)^2 less its square [m^2], positive in contact; the overlap follows
    from it without cancellation. rate_i, rate_j: `rolling_rate` of each. The contact lies in the plane through the
    circle in which the surfaces meet, at l_i = (r^2 + ri^2 - rj^2)/(2 r) from the centre of i: at r_i - delta if j is
    as flat as a wall. Rolling resistance acts at the smaller radius, as a wall does, and is limited by the smaller
    inertia.
    """
    half = real(0.5)
    r = sqrt(dot(away, away))
    # (a - b) as (a^2 - b^2)/(a + b): the squares were subtracted in double, so that no digit is lost in single
    delta = overlap2 / (ri + rj + r)
    per_r = real(1.0) / r
    lever = half * r
    lever_i = lever
    lever_j = lever
    surface = (wi + wj) * lever
    if VARIED:
        offset = half * (ri - rj) * (ri + rj) * per_r
        lever_i = lever + offset
        lever_j = lever - offset
        surface = surface + (wi - wj) * offset
    force, unit_torque, roll, spring = touch(
        c, effective(ri, rj), effective(mi, mj), min(ri, rj), delta, away * per_r, u, v, surface, wi - wj,
        s, dt, min(rate_i, rate_j),
    )  # fmt: skip
    return force, roll - unit_torque * lever_i, -roll - unit_torque * lever_j, spring, delta


@func
def sphere_on_wall(
    c: coefs, radius: real, mass: real, delta: real, n: vec3, u: vec3, v: vec3, w: vec3, spin: vec3, s: vec3,
    dt: real, inertia_rate: real,
):  # fmt: skip
    """Force and torque on a sphere, and spring, at a wall with unit normal n that turns with `spin` [rad/s]."""
    lever = radius - delta
    force, unit_torque, roll, spring = touch(
        c, radius, mass, radius, delta, n, u, v, w * lever, w - spin, s, dt, inertia_rate
    )  # fmt: skip
    return force, roll - unit_torque * lever, spring


@func
def rolling_resistance(
    c: coefs, rs: real, ms: real, delta: real, n: vec3, fn: real, turn: vec3, before: vec3, inertia: real, dt: real,
    stiffness: real, damping: real,
):  # fmt: skip
    """Torque on i [N m] and its spring's part, where rolling resistance has a spring (`contact.rolling_spring`).

    rs, ms: effective radius R_r [m] and mass [kg]. fn: normal force [N]; turn: difference of the spins [rad/s]; before:
    the spring's torque so far [N m]; inertia: I_r [kg m^2]. stiffness, damping: k_r/(k_n mu_r^2 R_r^2) and eta_r.

    k_n is the force without damping over the overlap: that of a linear law, and two thirds of the slope of Hertz's. The
    same is k_n in LIGGGHTS 3.8 (rolling_model_epsd.h), as are the limit, R_r, I_r and the dashpot. There new contacts
    are advanced by a whole step, and the spring's torque is not turned into the contact plane.
    """
    zero = real(0.0)
    k_n = max(normal(c, rs, ms, delta, zero), zero) / delta
    reach = c[MU_R] * rs
    return rolling_spring(
        before, turn, n, stiffness * k_n * reach * reach, reach * abs(fn), inertia, damping, dt, TWIST
    )


@func
def about_contact(radius: real, mass: real):
    """Moment of inertia [kg m^2] of a sphere about a point of its surface: m r^2 (1 + 2/5)."""
    return real(1.4) * mass * radius * radius


@func
def rolling_on_sphere(
    c: coefs, ri: real, rj: real, mi: real, mj: real, away: vec3, delta: real, force: vec3, wi: vec3, wj: vec3,
    before: vec3, dt: real, stiffness: real, damping: real,
):  # fmt: skip
    """Torque [N m] on i, its opposite on j, of the rolling spring of two spheres, and the spring's part of it.

    delta, force: what `sphere_on_sphere` gave. before: the spring's torque so far [N m]; stiffness, damping: see
    `rolling_resistance`. R_r = ri rj/(ri + rj), and I_r likewise of the moments of inertia about the contact (Ai et al.
    2011).
    """
    n = away * (real(1.0) / sqrt(dot(away, away)))
    inertia = effective(about_contact(ri, mi), about_contact(rj, mj))
    return rolling_resistance(
        c, effective(ri, rj), effective(mi, mj), delta, n, dot(force, n), wi - wj, before, inertia, dt, stiffness,
        damping,
    )  # fmt: skip


@func
def rolling_on_wall(
    c: coefs, radius: real, mass: real, delta: real, n: vec3, force: vec3, w: vec3, spin: vec3, before: vec3, dt: real,
    stiffness: real, damping: real,
):  # fmt: skip
    """Torque [N m] on a sphere of the rolling spring at a wall with unit normal n that turns with `spin` [rad/s], and
    the spring's part of it; as `rolling_on_sphere`, with R_r the radius."""
    return rolling_resistance(
        c, radius, mass, delta, n, dot(force, n), w - spin, before, about_contact(radius, mass), dt, stiffness, damping
    )  # fmt: skip
