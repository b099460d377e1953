"""What is simulated: grains, contact law, container, walls and gravity, as frozen types in SI units."""

from labbook.scene.contact import ContactLaw, HertzMindlin, LinearSpringDashpot, Surface
from labbook.scene.container import Box, ConicalSilo, Container, CylinderSilo, Primitives, Silo, WedgeHopper
from labbook.scene.grains import Grains, Spheres, Spherocylinders
from labbook.scene.scene import Scene
from labbook.scene.walls import Frustum, Plane, Strip, SurfaceMotion, Wall

__all__ = [
    "Box",
    "ConicalSilo",
    "ContactLaw",
    "Container",
    "CylinderSilo",
    "Frustum",
    "Grains",
    "HertzMindlin",
    "LinearSpringDashpot",
    "Plane",
    "Primitives",
    "Scene",
    "Silo",
    "Spheres",
    "Spherocylinders",
    "Strip",
    "Surface",
    "SurfaceMotion",
    "Wall",
    "WedgeHopper",
]
