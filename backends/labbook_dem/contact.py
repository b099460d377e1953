"""From two bodies that touch to forces and torques, whatever the law.

All velocities are those predicted for the end of the step (see `motion`), springs live at half steps like velocities of
a leapfrog: the force sees s + v_t dt/2, and v_t dt/2 more is kept for the next step. That makes friction second order
in dt without a second set of velocities.
"""

from labbook_dem.words import cross, dot, func, real, sqrt, vec3


@func
def slip(n: vec3, v: vec3, w: vec3):
    """Normal approach and tangential velocity at the contact [m/s].

    n: unit normal from j to i. v: v_i - v_j. w: lever_i omega_i + lever_j omega_j [m/s].
    """
    vn = dot(v, n)
    return vn, v - n * vn - cross(w, n)


@func
def trial(s: vec3, n: vec3, vt: vec3, half: real):
    """Spring [m] turned into the contact plane by truncation and advanced by half a step `half` [s]."""
    return s - n * dot(s, n) + vt * half


@func
def rolling(w: vec3, n: vec3, torque: real, inertia_rate: real, full: bool):
    """Torque [N m] on i that resists the relative rotation w = omega_i - omega_j [rad/s] (Fan et al. 2023, eq 8).

    Its size is `torque` = mu_r R F_n, but at most `inertia_rate` |w|: with inertia_rate = I/(8 dt), a grain's six to
    eight contacts together never reverse in one step the rotation that they resist. `full`: twist about n is resisted
    too.
    """
    w = w if full else w - n * dot(w, n)
    rate = sqrt(dot(w, w))
    factor = inertia_rate if torque >= inertia_rate * rate else torque / rate
    return w * (-factor)
