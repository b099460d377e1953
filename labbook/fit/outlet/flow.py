"""Flow through a slot from the profiles along it (Fan et al. 2023, eqs 14 and 18), derived again.

A layer of spheres of diameter d whose discs cover the part phi of the outlet line carries the mass
W = (2/3) d rho_p int phi v dx, the integral from -R to R; with x = R u and int (1 - u^2)^p du = beta(1/2, 1 + p).

Centred: v = v_c (1 - u^2)^a and phi = phi_c (1 - u^2)^b give

    W = (2/3) d rho_p phi_c v_c R beta(1/2, 1 + a + b),

which with v_c = sqrt(2 g gamma R) is the printed eq 14 but for one letter: there phi_c is replaced by its limit phi_inf
for wide outlets, so that narrow ones are overestimated.

Eccentric: v = sqrt(2 g R) [delta1 u + eps1 (1 - u^2)^sigma1] and phi = phi_max [delta2 u + eps2 (1 - u^2)^sigma2]. The
mixed terms are odd, int u^2 du = 2/3, and

    W = (2/3) d rho_p phi_max sqrt(2 g R) R [(2/3) delta1 delta2 + eps1 eps2 beta(1/2, 1 + sigma1 + sigma2)].

The printed eq 18 has beta(1, .) in place of beta(1/2, .), which is twice the integral over u^2 instead of u, and `v`
for sqrt(2 g R); with delta = 0, eps1 = sqrt(gamma), eps2 = 1 it would then not give eq 14 back.
"""

from math import sqrt


def centred_flow(d: float, rho_p: float, phi_c: float, v_c: float, R: float, a: float, b: float) -> float:
    """W [kg/s] of centred profiles: d [m], rho_p [kg/m^3], v_c [m/s], R [m]."""
    from scipy.special import beta

    return 2 / 3 * d * rho_p * phi_c * v_c * R * float(beta(0.5, 1 + a + b))


def eccentric_flow(
    d: float,
    rho_p: float,
    g: float,
    R: float,
    phi_max: float,
    velocity: tuple[float, float, float],
    area_fraction: tuple[float, float, float],
) -> float:
    """W [kg/s] of tilted profiles; `velocity` and `area_fraction` are (delta, eps, sigma) of each."""
    from scipy.special import beta

    (delta1, eps1, sigma1), (delta2, eps2, sigma2) = velocity, area_fraction
    integral = 2 / 3 * delta1 * delta2 + eps1 * eps2 * float(beta(0.5, 1 + sigma1 + sigma2))
    return 2 / 3 * d * rho_p * phi_max * sqrt(2 * g * R) * R * integral
