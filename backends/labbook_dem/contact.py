"""From two bodies that touch to forces and torques, whatever the law.

Velocities are those of a leapfrog, half a step before the positions. The normal dashpot, which decides the restitution,
sees them predicted for the time of the positions (`motion.predict`), and so is second order in dt. Tangential dashpots
and rolling resistance see the old ones: in a dense bed each grain's spin is damped at six or more contacts at once, and
a prediction halves the time step up to which that is stable. Friction springs are advanced from position to position by
the velocity half way, exact to second order and as free of drift as the leapfrog itself.
"""

from labbook_dem.words import cross, dot, func, real, sqrt, vec3


@func
def slip(n: vec3, v: vec3, w: vec3):
    """Tangential velocity at the contact [m/s].

    n: unit normal from j to i. v: v_i - v_j. w: lever_i omega_i + lever_j omega_j [m/s].
    """
    return v - n * dot(v, n) - cross(w, n)


@func
def trial(s: vec3, n: vec3, vt: vec3, dt: real):
    """Spring [m] turned into the contact plane by truncation and advanced by dt [s].

    A contact that touches for the first time did so anywhere within the step: its spring is advanced by half of it.
    """
    return s - n * dot(s, n) + vt * dt


@func
def rolling_rate(inertia: real, dt: real):
    """Largest torque per relative rotation [N m s] of rolling resistance: I/(12 dt).

    A grain's contacts, up to twelve, together then never reverse in one step the rotation that they resist.
    """
    return inertia / (real(12.0) * dt)


@func
def rolling(w: vec3, n: vec3, torque: real, inertia_rate: real, full: bool):
    """Torque [N m] on i that resists the relative rotation w = omega_i - omega_j [rad/s] (Fan et al. 2023, eq 8).

    Its size is `torque` = mu_r R |F_n|, but at most `inertia_rate` |w|. `full`: twist about n is resisted too.
    """
    w = w if full else w - n * dot(w, n)
    rate = sqrt(dot(w, w))
    factor = inertia_rate if torque >= inertia_rate * rate else torque / rate
    return w * (-factor)
