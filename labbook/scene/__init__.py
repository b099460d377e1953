"""What is simulated: grains, contact law, container, walls and gravity, as frozen types in SI units."""

from labbook.scene.contact import Between, ContactLaw, HertzMindlin, LinearSpringDashpot, Surface
from labbook.scene.container import Box, Container, Primitives, WedgeHopper
from labbook.scene.grains import Grains, Kind, Spheres
from labbook.scene.scene import Scene
from labbook.scene.sizes import Normal, Uniform
from labbook.scene.walls import Plane, Strip, SurfaceMotion, Wall

__all__ = [
    "Between",
    "Box",
    "ContactLaw",
    "Container",
    "Grains",
    "HertzMindlin",
    "Kind",
    "LinearSpringDashpot",
    "Normal",
    "Plane",
    "Primitives",
    "Scene",
    "Spheres",
    "Strip",
    "Surface",
    "SurfaceMotion",
    "Uniform",
    "Wall",
    "WedgeHopper",
]
