"""Time scales that a time step can be stated as a fraction of, and the largest step with which a bed comes to rest."""

import math
from collections.abc import Iterator

from labbook.scene.grains import Grains, Spherocylinders
from labbook.scene.scene import Scene


def rayleigh(scene: Scene) -> float:
    """Rayleigh time [s], the shortest of any grain (`ContactLaw.rayleigh_time`). Raises ValueError for a law that has
    none."""
    return min(scene.contact.rayleigh_time(grains.radius, grains.density) for grains in scene.grains.smallest())


def collision(scene: Scene) -> float:
    """Duration [s] of an undamped head-on collision of two grains.

    They meet at v = sqrt(g d), a fall of half a diameter (v = 1 m/s without gravity). Where grains differ: the shortest
    collision, of two of the lightest.
    """
    return min(_collision(scene, grains) for grains in scene.grains.smallest())


def _collision(scene: Scene, grains: Grains) -> float:
    speed = math.sqrt(scene.gravity * scene.grains.diameter) or 1.0
    return scene.contact.collision_time(grains.mass / 2, grains.radius / 2, speed)


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
