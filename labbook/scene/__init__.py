"""Scene of a simulation: grains, contact law, container, walls and gravity, as frozen types in SI units."""

from labbook.scene.bed_top import BedTop
from labbook.scene.bodies import Bodies
from labbook.scene.contact import (
    CONTACT_LAWS,
    ContactLaw,
    HertzLammps,
    HertzLiggghts,
    HertzMindlin,
    HertzPrinted,
    LinearSpringDashpot,
)
from labbook.scene.container import Box, Container, Primitives
from labbook.scene.container_shape import ContainerShape, Outlet
from labbook.scene.feed import Feed
from labbook.scene.grains import Clumps, Grains, Kind, Spheres, Spherocylinders
from labbook.scene.mesh import TriangleMesh
from labbook.scene.packing import Packing
from labbook.scene.part_motion import PartMotion, PartRotation, Vibration
from labbook.scene.restart import Restart
from labbook.scene.round_silos import ConicalSilo, CylinderSilo
from labbook.scene.scene import Scene
from labbook.scene.sizes import LogNormal, Normal, SizeList, SizeTable, Uniform
from labbook.scene.surface import Between, Surface, SurfaceChange
from labbook.scene.walls import Frustum, Plane, Strip, SurfaceMotion, Wall
from labbook.scene.wedge_hopper import WedgeHopper

__all__ = [
    "CONTACT_LAWS",
    "BedTop",
    "Between",
    "Bodies",
    "Box",
    "Clumps",
    "ConicalSilo",
    "ContactLaw",
    "Container",
    "ContainerShape",
    "CylinderSilo",
    "Feed",
    "Frustum",
    "Grains",
    "HertzLammps",
    "HertzLiggghts",
    "HertzMindlin",
    "HertzPrinted",
    "Kind",
    "LinearSpringDashpot",
    "LogNormal",
    "Normal",
    "Outlet",
    "Packing",
    "PartMotion",
    "PartRotation",
    "Plane",
    "Primitives",
    "Restart",
    "Scene",
    "SizeList",
    "SizeTable",
    "Spheres",
    "Spherocylinders",
    "Strip",
    "Surface",
    "SurfaceChange",
    "SurfaceMotion",
    "TriangleMesh",
    "Uniform",
    "Vibration",
    "Wall",
    "WedgeHopper",
]
