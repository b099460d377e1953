"""Forces and torques of two touching bodies, as far as they do not depend on the law.

Velocities are those of a leapfrog, half a step before the positions. The normal dashpot, which decides the restitution,
takes them predicted for the time of the positions (`motion.predict`), and so is second order in dt. Tangential dashpots
and rolling resistance take the old ones: in a dense bed each grain's spin is damped at six or more contacts at once,
and a prediction halves the largest stable time step. Friction springs are advanced from position to position by the
velocity half way, exact to second order and as free of drift as the leapfrog itself.
"""

from labbook_dem.words import cross, dot, func, real, sqrt, vec3


@func
def length(v: vec3):
    """|v|, at least 3e-19, so that it may be a divisor.

    A square below 1e-38 is subnormal in single precision, and approximate reciprocals of processors treat it as zero: a
    force of 1e-20 N cut to zero would become NaN. The addend changes no length above 1e-15.
    """
    return sqrt(dot(v, v) + real(1e-37))


@func
def cut(v: vec3, limit: real):
    """v, shortened to `limit` if it is longer."""
    size = length(v)
    return v * ((limit / size) if size > limit else real(1.0))


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

    The contacts of a grain, up to twelve, then never together reverse within one step the rotation that they resist.
    """
    return inertia / (real(12.0) * dt)


@func
def rolling(w: vec3, n: vec3, torque: real, inertia_rate: real, full: bool):
    """Torque [N m] on i that resists the relative rotation w = omega_i - omega_j [rad/s] (Fan et al. 2023, eq 8).

    Its size is `torque` = mu_r R |F_n|, but at most `inertia_rate` |w|. `full`: twist about n is resisted too.
    """
    w = w if full else w - n * dot(w, n)
    rate = length(w)
    # the branch of small rates needs no division, so that w = 0 gives zero and not NaN
    factor = inertia_rate if torque >= inertia_rate * rate else torque / rate
    return w * (-factor)


@func
def rolling_spring(
    before: vec3, w: vec3, n: vec3, stiffness: real, limit: real, inertia: real, damping: real, dt: real, full: bool
):  # fmt: skip
    """Torque [N m] on i of an elastic-plastic spring and a dashpot, and the spring's part, which is kept.

    before: the spring's torque so far [N m]; w = omega_i - omega_j [rad/s]; stiffness: k_r [N m]; limit:
    mu_r R_r |F_n| [N m]; inertia: I_r [kg m^2]; damping: eta_r; dt: by how much to advance the spring [s]. `full`:
    twist about n is resisted too, else the spring is turned into the contact plane by truncation, as friction's is.

    Model C of Ai et al. 2011 (Powder Technology 206:269): dM = -k_r w dt, cut at the limit, where the dashpot ends
    (their f = 0); below it the dashpot adds -2 eta_r sqrt(I_r k_r) w, which nothing limits.
    """
    w = w if full else w - n * dot(w, n)
    m = (before if full else before - n * dot(before, n)) - w * (stiffness * dt)
    rolls = length(m) > limit
    m = cut(m, limit)
    drag = real(0.0) if rolls else real(2.0) * damping * sqrt(inertia * stiffness)
    return m - w * drag, m
