"""Time scales that a time step can be stated as a fraction of, and the largest step with which a bed comes to rest."""

import math
from collections.abc import Iterator

from labbook.scene.contact import ContactLaw
from labbook.scene.grains import Spherocylinders
from labbook.scene.scene import Scene


def rayleigh(scene: Scene) -> float:
    """Rayleigh time [s], the shortest of any grain of its own material (`ContactLaw.rayleigh_time`).

    Raises ValueError for a law that has none.
    """
    each = enumerate(scene.grains.smallest())
    return min(scene.law_between(kind, kind).rayleigh_time(one.radius, one.density) for kind, one in each)


def collision(scene: Scene) -> float:
    """Duration [s] of an undamped head-on collision of two grains.

    They meet at v = sqrt(g d), a fall of half a diameter (v = 1 m/s without gravity). Where grains differ: the shortest
    collision, of two of the lightest. Where stiffness does: the shortest of all contacts, those with walls among them.
    """
    speed = math.sqrt(scene.gravity * scene.grains.diameter) or 1.0
    return min(law.collision_time(mass, radius, speed) for law, mass, radius in _contacts(scene))


def _contacts(scene: Scene) -> Iterator[tuple[ContactLaw, float, float]]:
    """Law, effective mass [kg] and radius [m] of contacts of the lightest grains: of like ones, and of others whose
    stiffness is not theirs."""
    lightest = scene.grains.smallest()
    likes = [scene.law_between(kind, kind) for kind in range(len(lightest))]
    for one, (grains, like) in enumerate(zip(lightest, likes, strict=True)):
        yield like, grains.mass / 2, grains.radius / 2
        for other in range(one):
            law, second = scene.law_between(one, other), lightest[other]
            if law not in (like, likes[other]):
                yield law, _reduced(grains.mass, second.mass), _reduced(grains.radius, second.radius)
        for wall in scene.container.walls() if scene.has_own_stiffness else ():
            law = scene.law(wall, one)
            if law != like:
                yield law, grains.mass, grains.radius


def _reduced(one: float, other: float) -> float:
    return one * other / (one + other)


def largest_stable_step(scene: Scene) -> float:
    """The step [s] beyond which deep beds never come to rest, or explode.

    A grain in a bed has several contacts at once. With w = pi dt/t_c (for a linear spring: its frequency times dt) and
    z the damping ratio, the explicit step is unstable where A w^2 + 2 B z w > 1. A and B are the law's, fitted to some
    3000 beds of benchmarks/step_limit.py (results: benchmarks/results/2026-11-22-step-limit-h100.json), the deep ones,
    which are the first to fail.
    """
    law = scene.contact
    a, b = law.stability(isinstance(scene.grains, Spherocylinders))
    bz = b * max(law.damping_ratio(e) for e in _restitutions(scene))
    return (math.sqrt(bz**2 + a) - bz) / a * collision(scene) / math.pi


def _restitutions(scene: Scene) -> Iterator[float]:
    """Of all contacts that the scene has."""
    kinds = range(max(1, len(scene.grains.kinds)))
    for one in kinds:
        for other in kinds[: one + 1]:
            yield scene.surface_between(one, other).restitution
        for wall in scene.container.walls():
            yield scene.surface(wall, one).restitution


TIME_SCALES = {"rayleigh": rayleigh, "collision": collision}
