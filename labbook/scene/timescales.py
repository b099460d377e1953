"""Time scales that a time step can be stated as a fraction of, and the largest step with which a bed comes to rest."""

import math
from collections.abc import Iterator

from labbook.scene.contact import HertzMindlin, LinearSpringDashpot
from labbook.scene.damping import damping_ratio
from labbook.scene.grains import Grains, Spherocylinders
from labbook.scene.scene import Scene


def rayleigh(scene: Scene) -> float:
    """Rayleigh time [s]: pi r sqrt(rho/G) / (0.163 nu + 0.8766) (Fan et al. 2023, eq 9); the shortest of any grain.

    Raises ValueError for a law other than Hertz-Mindlin.
    """
    law = scene.contact
    if not isinstance(law, HertzMindlin):
        raise ValueError("the Rayleigh time needs a shear modulus: it belongs to the law hertz-mindlin")
    return min(_rayleigh(law, grains) for grains in scene.grains.smallest())


def _rayleigh(law: HertzMindlin, grains: Grains) -> float:
    speed = math.sqrt(law.shear_modulus / grains.density)
    return math.pi * grains.radius / speed / (0.163 * law.poisson_ratio + 0.8766)


def collision(scene: Scene) -> float:
    """Duration [s] of an undamped head-on collision of two grains.

    Linear law: pi sqrt(m_eff/k_n). Hertz: 2.868 (m_eff^2 / (R_eff E*^2 v))^{1/5} at v = sqrt(g d), a fall of
    half a diameter (v = 1 m/s without gravity); 2.868 is 4/5 B(2/5, 1/2) (15/16)^{2/5} (Hertz 1882). Where grains
    differ: the shortest collision, of two of the lightest.
    """
    return min(_collision(scene, grains) for grains in scene.grains.smallest())


def _collision(scene: Scene, grains: Grains) -> float:
    law, mass = scene.contact, grains.mass / 2
    if isinstance(law, LinearSpringDashpot):
        return math.pi * math.sqrt(mass / law.normal_stiffness)
    speed = math.sqrt(scene.gravity * scene.grains.diameter) or 1.0
    modulus = effective_modulus(law)
    return HERTZ_DURATION * (mass**2 / (grains.radius / 2 * modulus**2 * speed)) ** 0.2


def effective_modulus(law: HertzMindlin) -> float:
    """E* [Pa] of two equal bodies: 1/E* = 2 (1 - nu^2)/E with E = 2 G (1 + nu)."""
    return law.shear_modulus / (1 - law.poisson_ratio)


# Twice the integral of dx / sqrt(1 - x^{5/2}) from 0 to 1, times (15/16)^{2/5}: the duration in units of
# (m_eff^2 / (R_eff E*^2 v))^{1/5}.
HERTZ_DURATION = 0.8 * math.gamma(0.4) * math.gamma(0.5) / math.gamma(0.9) * (15 / 16) ** 0.4

_SPRINGS = {"hertz-mindlin": 2.5, "linear": 1.8}
_DASHPOTS = {"hertz-mindlin": (3.5, 3.5), "linear": (5.7, 6.5)}
"""A and B of `largest_stable_step`; of B the second is of rods. Fitted to some 3000 beds of benchmarks/step_limit.py
(results: benchmarks/results/2026-11-22-step-limit-h100.json), the deep ones, which are the first to fail."""


def largest_stable_step(scene: Scene) -> float:
    """The step [s] beyond which deep beds never come to rest, or explode.

    A grain in a bed has several contacts at once. With w = pi dt/t_c (for a linear spring: its frequency times dt) and
    z the damping ratio, the explicit step is unstable where A w^2 + 2 B z w > 1. A and B were measured with friction
    springs of 2/7 of the normal stiffness and tangential dashpots as strong as normal ones. Stiffer springs and
    stronger dashpots are taken to count in proportion.
    """
    law = scene.contact
    a, b = _SPRINGS[law.law], _DASHPOTS[law.law][isinstance(scene.grains, Spherocylinders)]
    if isinstance(law, LinearSpringDashpot):
        a *= max(1.0, 3.5 * law.tangential_stiffness)
    bz = b * max(1.0, law.tangential_damping) * max(damping_ratio(law, e) for e in _restitutions(scene))
    return (math.sqrt(bz**2 + a) - bz) / a * collision(scene) / math.pi


def _restitutions(scene: Scene) -> Iterator[float]:
    """Of all contacts that the scene has."""
    kinds = range(max(1, len(scene.grains.kinds)))
    for one in kinds:
        for other in kinds[: one + 1]:
            yield scene.surface_between(one, other).restitution or 1.0
        for wall in scene.container.walls():
            yield scene.surface(wall, one).restitution or 1.0


TIME_SCALES = {"rayleigh": rayleigh, "collision": collision}
