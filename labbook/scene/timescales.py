"""Time scales of a scene: of gravity, of contacts as units of a time step, and the largest stable step."""

import math
from collections.abc import Callable, Iterator
from functools import wraps

from labbook.scene.contact import ContactLaw
from labbook.scene.container import Primitives
from labbook.scene.grains import Grains
from labbook.scene.model import once
from labbook.scene.scene import Scene

WAIT = 20.0
"""Time without a leaving grain after which a flow may count as stopped, in sqrt(d*/g), unless `restart.wait` is
stated."""


def _anywhere(time: Callable[[Scene], float]) -> Callable[[Scene], float]:
    """Decorate a time so that it is computed once for all containers.

    It depends on the container only where walls differ from the grains.
    """

    @once(256)
    def of(grains: Grains, contact: ContactLaw, gravity: float) -> float:
        nowhere = {"container": Primitives(), "walls": {}, "feed": None, "restart": None}
        return time(Scene.of(grains=grains, contact=contact, gravity=gravity, **nowhere))

    @wraps(time)
    def cached(scene: Scene) -> float:
        own = scene.walls or scene.has_own_stiffness
        return time(scene) if own else of(scene.grains, scene.contact, scene.gravity)

    return cached


def gravity_time(scene: Scene) -> float:
    """Compute sqrt(d*/g), in which a grain falls half of its equivalent diameter d* from rest.

    Args:
        scene: Scene.

    Returns:
        Time [s]; infinite without gravity.
    """
    return math.sqrt(scene.grains.equivalent_diameter / scene.gravity) if scene.gravity > 0 else math.inf


def stop_time(scene: Scene) -> float:
    """Give the time without a leaving grain after which a flow may count as stopped, if grains at the outlet are still.

    Args:
        scene: Scene.

    Returns:
        Time [s]: `restart.wait`, else WAIT times the gravity time.
    """
    own = None if scene.restart is None else scene.restart.wait
    return own or WAIT * gravity_time(scene)


@_anywhere
def rayleigh(scene: Scene) -> float:
    """Compute the Rayleigh time, the shortest of any grain of its own material (`ContactLaw.rayleigh_time`).

    Args:
        scene: Scene.

    Returns:
        Time [s].

    Raises:
        ValueError: The law has no shear modulus.
    """
    spheres = enumerate(scene.grains.smallest())
    return min(scene.law_between(kind, kind).rayleigh_time(sphere.radius, sphere.density) for kind, sphere in spheres)


@_anywhere
def collision(scene: Scene) -> float:
    """Compute the duration of an undamped head-on collision of two grains.

    They meet at v = sqrt(g d), a fall of half a diameter (v = 1 m/s without gravity). Where grains differ: the shortest
    collision, of two of the lightest. Where stiffness does: the shortest of all contacts, those with walls among them.

    Args:
        scene: Scene.

    Returns:
        Time [s].
    """
    speed = math.sqrt(scene.gravity * scene.grains.diameter) or 1.0
    return min(law.collision_time(mass, radius, speed) for law, mass, radius in _contacts(scene))


def _contacts(scene: Scene) -> Iterator[tuple[ContactLaw, float, float]]:
    """Law, effective mass [kg] and effective radius [m] of contacts of the lightest grains.

    Those of like grains come first, then others with a stiffness of their own, at walls too.
    """
    lightest = scene.grains.smallest()
    likes = [scene.law_between(kind, kind) for kind in range(len(lightest))]
    for kind, (grains, like) in enumerate(zip(lightest, likes, strict=True)):
        yield like, grains.mass / 2, grains.radius / 2
        for second_kind in range(kind):
            law, partner = scene.law_between(kind, second_kind), lightest[second_kind]
            if law not in (like, likes[second_kind]):
                yield law, _reduced(grains.mass, partner.mass), _reduced(grains.radius, partner.radius)
        for wall in scene.container.walls() if scene.has_own_stiffness else ():
            law = scene.law(wall, kind)
            if law != like:
                yield law, grains.mass, grains.radius


def _reduced(first: float, second: float) -> float:
    return first * second / (first + second)


@_anywhere
def largest_stable_step(scene: Scene) -> float:
    """Compute the step beyond which deep beds never come to rest, or explode.

    A grain in a bed has several contacts at once. With w = pi dt/t_c (for a linear spring: its frequency times dt) and
    z the damping ratio, the explicit step is unstable where A w^2 + 2 B z w > 1. A and B are the law's, fitted to some
    3000 beds of benchmarks/step_limit.py (results: benchmarks/results/2026-11-22-step-limit-h100.json), the deep ones,
    which are the first to fail.

    Rolling springs count as those of friction do. Between grains of radius R they turn a grain as a friction spring of
    k_r/R^2 = c mu_r^2 k_n/4 would, with c = k_r/(k_n mu_r^2 R_r^2). For c = 2.25 this exceeds a friction spring of 2/7
    k_n only for mu_r above 0.71, so friction springs are almost always the stiffer ones. They do not add up: neighbours
    that turn in the same sense stretch friction springs only, and neighbours that turn in opposite senses stretch
    rolling springs only. The dashpot 2 eta_r sqrt(I_r k_r) likewise is one of the damping ratio eta_r mu_r sqrt(0.35 c)
    at the distance R. Beds of 300 spheres with mu_r from 0.3 to 2 and eta_r from 0 to 1 came to rest at 0.9 of this
    limit. Those with a dashpot did not at 1.3 of it.

    A clump has the contacts of several spheres and one mass: A and B of rods count once for each sphere, as far as no
    other covers it.

    Args:
        scene: Scene.

    Returns:
        Time step [s].
    """
    law = scene.contact
    a, b = (scene.grains.bare_spheres * value for value in law.stability(scene.grains.oriented))
    ratios = [law.damping_ratio(surface.restitution) for surface in scene.surfaces]
    if law.rolling_model == "epsd":
        stiffness, damping = law.rolling_spring
        rolling = max(surface.rolling_friction for surface in scene.surfaces)
        a *= max(1.0, 3.5 * stiffness * rolling**2 / 4)
        ratios.append(damping * rolling * math.sqrt(0.35 * stiffness))
    bz = b * max(ratios)
    return (math.sqrt(bz**2 + a) - bz) / a * collision(scene) / math.pi


TIME_SCALES = {"rayleigh": rayleigh, "collision": collision}
