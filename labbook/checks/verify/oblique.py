"""Impacts of spheres after Chung & Ooi 2011 (Granular Matter 13:643), by every contact law, against SciPy.

Their spheres: aluminium oxide at 3.9 m/s at a wall, straight and under several angles, and an alloy of aluminium at
0.2 m/s with several spins. Their walls are rigid or of the material of the sphere; here they are of its material. How
errors depend on the time step, also for rods, is measured by `labbook.checks.bench.contacts`.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from functools import partial

import numpy as np

from labbook.checks.verify.case import Case, limited
from labbook.checks.verify.materials import EVERY_LAW, LAWS, floor
from labbook.checks.verify.planar import PlanarBody, PlanarImpact
from labbook.checks.verify.platform import MemberStart, Platform
from labbook.scene import ContactLaw, Kind, Plane, Primitives, Scene, Spheres, Wall
from labbook.scene.material import shear_modulus

OXIDE = Spheres(diameter=5e-3, density=4000, count=1), (3.8e11, 0.23), 3.9, {"friction": 0.092, "restitution": 0.98}
ALLOY = Spheres(diameter=0.2, density=2700, count=1), (7e10, 0.33), 0.2, {"friction": 0.4, "restitution": 0.5}
"""Sphere, Young's modulus [Pa] and Poisson's ratio, speed of impact [m/s], surface."""
ANGLES = (5, 20, 45, 60, 85)
"""Of incidence, from the normal [degrees]."""
SPINS = (0.175, 0.7, 3.0, 12.0)
"""Angular velocities [rad/s]."""
STEPS = 4000
"""Of a collision."""
AHEAD = 2.5
"""Steps before the first touch."""

BELOW = Wall(name="floor", shape=Plane(point=(0.0, 0.0, -10.0), normal=(0.0, 0.0, 1.0)))
"""Out of reach of two spheres, which so need the kernels that one at a wall has."""

Material = tuple[Spheres, tuple[float, float], float, dict[str, float]]


def _law(law: str, of: Material, **parameters: float) -> ContactLaw:
    grains, (young, nu), speed, surface = of
    values = {**surface, "rolling_friction": 0.0, **parameters}
    if law != "linear":
        return EVERY_LAW[law](shear_modulus=shear_modulus(young, nu), poisson_ratio=nu, **values)
    # as stiff as to collide as long as by Hertz's law
    lasts = EVERY_LAW["hertz-mindlin"](shear_modulus=shear_modulus(young, nu), poisson_ratio=nu).collision_time(
        grains.mass / 2, grains.radius / 2, speed
    )
    return EVERY_LAW["linear"](normal_stiffness=grains.mass / 2 * (math.pi / lasts) ** 2, **values)


def _scene(law: ContactLaw, grains: Spheres, *walls: Wall) -> Scene:
    return Scene(grains=grains, contact=law, container=Primitives(parts=walls), gravity=0.0)


def _at_wall(law: ContactLaw, of: Material, motions: Iterable[tuple[float, float, float]]) -> list[PlanarImpact]:
    """Motions: velocities along the wall and towards it [m/s], and spins [rad/s]."""
    grains, scene = of[0], _scene(law, of[0], floor())
    position = (0.0, grains.radius)
    return [
        PlanarImpact.of(scene, (PlanarBody.sphere(grains, position, (along, -v), spin),), "floor", v, follow=3.0)
        for along, v, spin in motions
    ]


def _angles(law: str) -> list[PlanarImpact]:
    speed, angles = OXIDE[2], np.radians(ANGLES)
    return _at_wall(_law(law, OXIDE), OXIDE, [(speed * math.sin(a), speed * math.cos(a), 0.0) for a in angles])


def _spins(law: str) -> list[PlanarImpact]:
    return _at_wall(_law(law, ALLOY), ALLOY, [(0.0, ALLOY[2], spin) for spin in SPINS])


def _normal(law: str, e: float) -> list[PlanarImpact]:
    return _at_wall(_law(law, OXIDE, restitution=e), OXIDE, [(0.0, OXIDE[2], 0.0)])


def _two(law: str, spins: Iterable[float] = SPINS, **parameters: float) -> list[PlanarImpact]:
    grains, _, v, _ = ALLOY
    scene = _scene(_law(law, ALLOY, **parameters), grains.model_copy(update={"count": 2}), BELOW)
    r = grains.radius
    pairs = [
        (PlanarBody.sphere(grains, (0, 2 * r), (0, -v), w), PlanarBody.sphere(grains, (0, 0), (0, v), w)) for w in spins
    ]
    return [PlanarImpact.of(scene, pair, "none", 2 * v, follow=3.0) for pair in pairs]


def _unlike(law: str) -> list[PlanarImpact]:
    """The other sphere is five times as large."""
    grains, _, v, _ = ALLOY
    r, big = grains.radius, Spheres(diameter=5 * grains.diameter, density=grains.density, count=1)
    kinds = tuple(
        Kind(name=name, share=0.5, diameter=sphere.diameter, density=sphere.density)
        for name, sphere in (("small", grains), ("large", big))
    )
    scene = _scene(_law(law, ALLOY), big.model_copy(update={"count": 2, "kinds": kinds}), BELOW)
    still = PlanarBody.sphere(big, (0, 0), (0, 0))
    pairs = [(PlanarBody.sphere(grains, (0, 6 * r), (0, -v), w), still) for w in SPINS]
    return [PlanarImpact.of(scene, pair, "none", v, follow=3.0) for pair in pairs]


KINDS: Mapping[str, Callable[[str], list[PlanarImpact]]] = {
    "1: two, elastic": lambda law: _two(law, (0.0,), restitution=1.0),
    "2: at a wall, elastic": partial(_normal, e=1.0),
    "3: at a wall, e = 0.4": partial(_normal, e=0.4),
    "4: angles at a wall": _angles,
    "5: spins at a wall": _spins,
    "6: two with spins": _two,
    "7: unlike with spins": _unlike,
}


def _kinds(law: str) -> list[str]:
    """Names of the impacts for a law. Unlike spheres need kernels of their own, so only the laws of LAWS run them."""
    return [name for name in KINDS if law in LAWS or "unlike" not in name]


def _errors(platform: Platform, law: str) -> Mapping[str, float]:
    return {name: max(_error(platform, impact) for impact in KINDS[name](law)) for name in _kinds(law)}


def _error(platform: Platform, impact: PlanarImpact) -> float:
    dt = impact.lasts / STEPS
    start = MemberStart(impact.scene, dt, impact.packing(AHEAD * dt))
    end = platform.run(start, 1, round(impact.follow * STEPS)).end
    return float(np.abs(impact.error(end, impact.parted())).max())


# First order in the step where dashpots act: Mindlin's errors are those of t_c/40, 9e-3, in proportion. A contact that
# LIGGGHTS' law lets slide and stick by turns, or whose spring LAMMPS' law makes at first touch, has larger ones.
LIMITS = {"hertz-mindlin": 2e-4, "hertz-printed": 2e-4, "hertz-liggghts": 2e-3, "hertz-lammps": 1e-3, "linear": 2e-4}

CASES = [
    Case(
        name=f"impacts-{law}",
        statement="velocities and spins after impacts of spheres with and without spin, at walls and with one another",
        source="SciPy DOP853; impacts of Chung & Ooi 2011",
        # elastic impacts along the normal are of second order and more
        measures={
            kind: limited(1e-5 if "elastic" in kind else LIMITS[law], roundings=16, steps=3 * STEPS)
            for kind in _kinds(law)
        },
        run=partial(_errors, law=law),
    )
    for law in EVERY_LAW
]
