"""Grains and scenes that the cases share: Fan's glass beads, their linear likeness, a roomy box."""

from collections.abc import Callable
from functools import partial
from typing import Any

from labbook.scene import Box, ContactLaw, HertzMindlin, LinearSpringDashpot, Plane, Scene, Spheres, SurfaceChange, Wall
from labbook.scene.contact import Hertz, HertzLammps, HertzLiggghts, HertzPrinted
from labbook.scene.container import Container

D = 3e-3
"""Diameter of the grains [m]."""
G = 9.81
"""Gravity of the cases that have it [m/s^2]."""


def spheres(count: int) -> Spheres:
    """Build Fan's glass beads."""
    return Spheres(diameter=D, density=2500, count=count)


def hertzian(law: type[Hertz], **parameters: Any) -> Hertz:
    """Build Fan's material with a law after Hertz; `parameters` replace its values."""
    values = {"shear_modulus": 1e8, "poisson_ratio": 0.25, "friction": 0.5, "rolling_friction": 0.01}
    return law.model_validate({**values, "restitution": 0.2, **parameters})


def hertz(**parameters: Any) -> HertzMindlin:
    """Build Fan's material with labbook's own law; `parameters` replace its values."""
    law = hertzian(HertzMindlin, **parameters)
    assert isinstance(law, HertzMindlin)
    return law


def linear(**parameters: Any) -> LinearSpringDashpot:
    """Build linear springs of k_n = 2e5 m g/d; `parameters` replace their values."""
    values = {"normal_stiffness": 2e5 * spheres(1).mass * G / D, "friction": 0.5, "rolling_friction": 0.01}
    return LinearSpringDashpot.model_validate({**values, "restitution": 0.2, **parameters})


LAWS = {"hertz-mindlin": hertz, "linear": linear}
"""The two laws of most cases."""
EVERY_LAW: dict[str, Callable[..., ContactLaw]] = {
    "hertz-mindlin": hertz,
    "hertz-printed": partial(hertzian, HertzPrinted),
    "hertz-liggghts": partial(hertzian, HertzLiggghts),
    "hertz-lammps": partial(hertzian, HertzLammps),
    "linear": linear,
}


def scene(count: int, law: Any, container: Container, gravity: float = 0.0, **walls: SurfaceChange) -> Scene:
    """A scene of `count` grains; `walls` are surfaces by wall name."""
    return Scene(grains=spheres(count), contact=law, container=container, gravity=gravity, walls=walls)


def room(size: float = 1.0) -> Box:
    """A closed cube of `size` [m] around (0, 0, size/2)."""
    return Box(width=size, depth=size, height=size, lid=True)


def floor(normal: tuple[float, float, float] = (0.0, 0.0, 1.0)) -> Wall:
    """A plane through the origin."""
    return Wall(name="floor", shape=Plane(point=(0.0, 0.0, 0.0), normal=normal))
