"""Scenes that backends are timed on."""

import math

import numpy as np

from labbook.backend.numerics import Numerics
from labbook.scene import (
    Box,
    CylinderSilo,
    HertzMindlin,
    Kind,
    LinearSpringDashpot,
    Plane,
    Primitives,
    Scene,
    Spheres,
    Spherocylinders,
    Strip,
    Uniform,
    Wall,
    WedgeHopper,
)
from labbook.scene.packing import Packing

FAN_STEP = Numerics(dt=2.5e-6)
BOX_STEP = Numerics(dt=2e-6, steps_per_beat=200)
GRAVITY = 9.81


def fan(orifice: float = 0.03, grains: int = 3000) -> Scene:
    """Flat-bottomed quasi-2D hopper of Fan et al. 2023: 3 mm spheres, Hertz-Mindlin, `orifice` [m]."""
    return Scene(
        grains=Spheres(diameter=3e-3, density=2500, count=grains),
        contact=HertzMindlin(
            shear_modulus=1e8, poisson_ratio=0.25, friction=0.5, rolling_friction=0.01, restitution=0.2
        ),
        container=WedgeHopper(width=0.1, height=0.4, thickness=3.03e-3, orifice=orifice),
    )


def variants(scene: Scene) -> dict[str, Scene]:
    """The scene without one thing after another that a backend need not compute then; and with grains that may differ,
    though those of a packing without sizes are all alike, and those of both kinds of one material."""

    def law(**changes: float) -> Scene:
        return scene.model_copy(update={"contact": scene.contact.model_copy(update=changes)})

    def grains(**changes: object) -> Scene:
        return scene.model_copy(update={"grains": scene.grains.model_copy(update=changes)})

    sides = tuple(wall for wall in scene.container.walls() if wall.name not in ("front", "back"))
    return {
        "without rolling resistance": law(rolling_friction=0.0),
        "without friction": law(friction=0.0, rolling_friction=0.0),
        "without front and back": scene.model_copy(update={"container": Primitives(parts=sides)}),
        "with the linear law": scene.model_copy(
            update={
                "contact": LinearSpringDashpot(
                    normal_stiffness=2e5 * scene.grains.mass * GRAVITY / scene.grains.diameter,
                    friction=0.5,
                    rolling_friction=0.01,
                    restitution=0.2,
                )
            }
        ),
        "with several sizes": grains(sizes=Uniform(smallest=scene.grains.diameter / 2)),
        "with two kinds": grains(kinds=tuple(Kind(name=name, share=0.5) for name in ("one", "other"))),
    }


def silo(grains: int = 10_000) -> tuple[Scene, Scene, Packing]:
    """A box, 17 grains wide and deep, with a slot of 5.5 grains across its bottom; closed; and a start of its filling.

    Frictional spheres of 9.9 mm with the linear law, stiffness 2e5 m g/d: as dense a flow in three dimensions as that
    of the cylindrical silo of Pongo et al. 2022.
    """
    d, half, edge = 9.9e-3, 0.085, 0.027
    spheres = Spheres(diameter=d, density=620, count=grains)
    law = LinearSpringDashpot(normal_stiffness=2e5 * spheres.mass * GRAVITY / d, friction=0.5, restitution=0.9)
    sides = {
        "left": Plane(point=(-half, 0, 0), normal=(1, 0, 0)),
        "right": Plane(point=(half, 0, 0), normal=(-1, 0, 0)),
        "front": Plane(point=(0, -half, 0), normal=(0, 1, 0)),
        "back": Plane(point=(0, half, 0), normal=(0, -1, 0)),
        "bottom-left": Strip(start=(-half, 0), end=(-edge, 0)),
        "bottom-right": Strip(start=(edge, 0), end=(half, 0)),
    }
    walls = tuple(Wall(name=name, shape=shape) for name, shape in sides.items())
    lid = Wall(name="lid", shape=Strip(start=(-edge, 0), end=(edge, 0)))
    scene = Scene(grains=spheres, contact=law, container=Primitives(parts=walls, outlet_plane=0.0))
    closed = scene.model_copy(update={"container": Primitives(parts=(*walls, lid))})
    across = int((2 * half - 1.1 * d) // (1.15 * d))
    i = np.arange(grains)
    site = np.column_stack([i % across - (across - 1) / 2, i // across % across - (across - 1) / 2, i // across**2])
    v = np.random.default_rng(1).normal(0, 0.2, (grains, 3))
    return scene, closed, Packing(x=site * 1.15 * d + [0, 0, d], v=v, omega=np.zeros_like(v))


def cylinder(rods: bool, grains: int = 10_000) -> Scene:
    """The silo of Pongo et al. 2022 with an orifice of 54 mm, whose bottom turns at 0.32 Hz.

    rods: 20 mm x 6 mm, else spheres of the same volume; linear law, stiffness 2e5 m g/d.
    """
    if rods:
        return _pongo(Spherocylinders(diameter=6e-3, length=20e-3, density=620, count=grains))
    return _pongo(Spheres(diameter=9.9e-3, density=620, count=grains))


def elongated(aspect_ratio: float, grains: int) -> Scene:
    """`cylinder` with grains of the same volume that are so many times as long as thick (spheres where that is 1), and
    narrower where they are fewer than 10 000, so that the bed keeps its shape."""
    silo = max(0.08, 0.19 * min(1.0, (grains / 10_000) ** (1 / 3)))  # the orifice stays as wide
    spheres = Spheres(diameter=9.9e-3, density=620, count=grains)
    if aspect_ratio == 1:
        return _pongo(spheres, silo)
    thick = Spherocylinders(diameter=9.9e-3, length=aspect_ratio * 9.9e-3, density=620, count=grains)
    d = thick.diameter * (spheres.volume / thick.volume) ** (1 / 3)
    return _pongo(thick.model_copy(update={"diameter": d, "length": aspect_ratio * d}), silo)


def _pongo(grains: Spheres | Spherocylinders, diameter: float = 0.19) -> Scene:
    stiffness = 2e5 * grains.mass * 9.8 / grains.diameter
    return Scene(
        grains=grains,
        contact=LinearSpringDashpot(normal_stiffness=stiffness, friction=0.5, restitution=0.9),
        container=CylinderSilo(diameter=diameter, height=2.0, orifice=0.054, rotation=0.32),
        gravity=9.8,
    )


def box(grains: int) -> tuple[Scene, Packing]:
    """Spheres stacked in a box, each above another and beside four, at rest: three contacts a grain.

    More than a random bed has, so that the rate is no better than there. Linear law with friction.
    """
    d = 3e-3
    across = round((grains / 1.25) ** (1 / 3))
    layers = math.ceil(grains / across**2)
    apart = d * (1 - 1e-5)
    sites = np.stack(np.meshgrid(*(np.arange(k) for k in (layers, across, across)), indexing="ij"), -1).reshape(-1, 3)
    x = (sites[:grains, ::-1] + 0.5) * apart - [across * apart / 2, across * apart / 2, 0.0]
    spheres = Spheres(diameter=d, density=2500, count=grains)
    scene = Scene(
        grains=spheres,
        contact=LinearSpringDashpot(
            normal_stiffness=2e5 * spheres.mass * GRAVITY / d, friction=0.5, rolling_friction=0.0, restitution=0.2
        ),
        container=Box(width=across * apart, depth=across * apart, height=2 * layers * d),
    )
    return scene, Packing(x=x, v=np.zeros_like(x), omega=np.zeros_like(x))
