"""What is simulated: grains, contact law, container, walls and gravity, as frozen types in SI units."""

from labbook.scene.contact import ContactLaw, HertzMindlin, LinearSpringDashpot, Surface
from labbook.scene.container import Box, Container, Primitives, WedgeHopper
from labbook.scene.grains import Grains, Spheres
from labbook.scene.scene import Scene
from labbook.scene.walls import Plane, Strip, SurfaceMotion, Wall

__all__ = [
    "Box",
    "ContactLaw",
    "Container",
    "Grains",
    "HertzMindlin",
    "LinearSpringDashpot",
    "Plane",
    "Primitives",
    "Scene",
    "Spheres",
    "Strip",
    "Surface",
    "SurfaceMotion",
    "Wall",
    "WedgeHopper",
]
