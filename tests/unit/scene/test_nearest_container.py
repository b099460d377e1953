"""Outlets of meshes, and the built-in containers that meshes are near to, of surfaces made by hand."""

import math

import numpy as np
import pytest

from labbook.plan.meshes import mesh_lines
from labbook.scene import (
    Box,
    ConicalSilo,
    CylinderSilo,
    HertzMindlin,
    Primitives,
    Scene,
    Spheres,
    TriangleMesh,
    Wall,
    WedgeHopper,
)
from labbook.scene.nearest_container import nearest_container, openings, outlets
from labbook.scene.triangles import Triangles


def turned_profile(profile: list[tuple[float, float]], corners: int, at=(0.0, 0.0, 0.0)) -> TriangleMesh:
    """A profile of radii and heights [m], turned about z as a polygon."""
    angle = 2 * math.pi * np.arange(corners) / corners
    rings = [np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full(corners, z)]) for r, z in profile]
    k, after = np.arange(corners), (np.arange(corners) + 1) % corners
    faces = []
    for ring in range(len(profile) - 1):
        low, high = ring * corners, (ring + 1) * corners
        faces += [np.stack([low + k, low + after, high + k], 1), np.stack([low + after, high + after, high + k], 1)]
    return mesh(np.concatenate(rings) + at, np.concatenate(faces))


def wedge(width: float, height: float, thickness: float, rise: float, slot: tuple[float, float]) -> TriangleMesh:
    """A wedge with front and back walls, open above and at its slot."""
    half, (left, right) = width / 2, slot
    outline = [(-half, height), (-half, rise), (left, 0.0), (right, 0.0), (half, rise), (half, height)]
    front, back = (np.array([(x, y, z) for x, z in outline]) for y in (-thickness / 2, thickness / 2))
    faces = [(0, k, k + 1) for k in range(1, 5)] + [(6, 6 + k, 7 + k) for k in range(1, 5)]
    for k in (0, 1, 3, 4):
        faces += [(k, k + 1, k + 7), (k, k + 7, k + 6)]
    return mesh(np.concatenate([front, back]), np.array(faces))


def mesh(vertices: np.ndarray, faces: np.ndarray) -> TriangleMesh:
    return TriangleMesh.of_surface(Triangles.welded(vertices, faces)[0])


CONE = [(0.02, 0.0), (0.05, 0.04), (0.05, 0.3)]


@pytest.mark.parametrize("corners", [24, 64])
def test_the_outlet_of_a_polygon_has_its_area(corners):
    """n/2 sin(2 pi/n) r^2; the hole at the top is no outlet."""
    surface = turned_profile(CONE, corners).surface
    (hole,) = outlets(surface)
    assert len(openings(surface)) == 2
    assert hole.area == pytest.approx(corners / 2 * math.sin(2 * math.pi / corners) * 0.02**2, rel=1e-9)
    assert hole.diameter == pytest.approx(0.04 * math.sqrt(math.sin(2 * math.pi / corners) / (2 * math.pi / corners)))
    assert hole.z == 0


@pytest.mark.parametrize("corners", [24, 96])
def test_a_polygon_is_near_the_cone_that_it_stands_for(corners):
    """By its sagitta, at the middle of the sides of its widest ring."""
    near = nearest_container(turned_profile(CONE, corners, at=(0.1, -0.2, 0.05)))
    assert near is not None
    assert isinstance(near.container, ConicalSilo)
    assert near.container.diameter == pytest.approx(0.1, rel=1e-9)
    assert near.container.orifice == pytest.approx(0.04, rel=1e-9)
    assert near.container.angle == pytest.approx(math.atan2(0.03, 0.04), rel=1e-9)
    assert near.container.height == pytest.approx(0.3, rel=1e-9)
    assert near.origin == pytest.approx((0.1, -0.2, 0.05), abs=1e-9)
    sagitta = 0.05 * (1 - math.cos(math.pi / corners))
    assert near.difference == pytest.approx(sagitta, rel=0.2)


def test_a_flat_bottom_is_a_cylinder_silo():
    near = nearest_container(turned_profile([(0.015, 0.0), (0.05, 0.0), (0.05, 0.2)], 48))
    assert near is not None
    assert isinstance(near.container, CylinderSilo)
    assert (near.container.diameter, near.container.orifice) == pytest.approx((0.1, 0.03))


@pytest.mark.parametrize(("slot", "gap"), [((-0.01, 0.01), None), ((-0.02, 0.0), 0.02)])
def test_a_wedge_is_found_with_its_slot(slot, gap):
    near = nearest_container(wedge(0.08, 0.2, 0.01, 0.03 if gap is None else 0.0, slot))
    assert near is not None
    container = near.container
    assert isinstance(container, WedgeHopper)
    assert (container.width, container.thickness, container.orifice) == pytest.approx((0.08, 0.01, 0.02))
    assert container.angle == pytest.approx(math.pi / 4 if gap is None else math.pi / 2)
    assert container.gap == (None if gap is None else pytest.approx(gap))
    assert near.difference < 1e-9


def test_a_wedge_along_y_is_turned():
    across = wedge(0.08, 0.2, 0.01, 0.03, (-0.01, 0.01))
    surface = across.surface.moved(lambda x: x[:, [1, 0, 2]])
    near = nearest_container(TriangleMesh.of_surface(surface))
    assert near is not None
    assert near.turned
    assert near.difference < 1e-9


def test_what_is_like_none_is_not_named():
    """An hourglass, a hopper with a square outlet below a round side, and one without an outlet."""
    assert nearest_container(turned_profile([(0.05, -0.1), (0.01, 0.0), (0.05, 0.1)], 32)) is None
    twisted = turned_profile([(0.02, 0.0), (0.08, 0.02), (0.05, 0.1), (0.09, 0.2)], 32)
    assert nearest_container(twisted) is None
    assert nearest_container(turned_profile([(0.0, 0.0), (0.05, 0.05)], 32)) is None


def test_a_plan_says_so():
    part = Wall(name="hopper", shape=turned_profile(CONE, 24))
    grains = Spheres(diameter=3e-3, density=2500, count=10)
    container = Primitives(parts=(part,), outlet_plane=0.0)
    law = HertzMindlin(shear_modulus=1e7, poisson_ratio=0.25)
    lines = mesh_lines([Scene(grains=grains, contact=law, container=container)] * 2)
    assert len(lines) == 3
    assert "as a circle of 39.77 mm" in lines[1]
    assert "{kind: conical-silo, diameter: 100 mm, height: 300 mm, orifice: 40 mm, angle: 36.87 deg}" in lines[2]
    assert "within 0.428 mm of" in lines[2]


def test_a_plan_says_how_full_a_closed_container_is():
    """A drum of 24 sides, radius 50 mm and length 40 mm, with 1000 grains of 4 mm: volumes by their formulas."""
    drum = turned_profile([(0.0, 0.0), (0.05, 0.0), (0.05, 0.04), (0.0, 0.04)], 24)
    assert drum.surface.closed
    part = Wall(name="drum", shape=TriangleMesh.of_surface(drum.surface, encloses=True))
    grains = Spheres(diameter=4e-3, density=2500, count=1000)
    law = HertzMindlin(shear_modulus=1e7, poisson_ratio=0.25)
    (*_, line) = mesh_lines([Scene(grains=grains, contact=law, container=Primitives(parts=(part,)))])
    volume = 24 / 2 * math.sin(2 * math.pi / 24) * 0.05**2 * 0.04
    share = 1000 * math.pi / 6 * 4e-3**3 / volume
    assert f"Grains take {100 * share:.3g} % of the {1e3 * volume:.4g} l within drum" in line
    assert f"packing fraction 0.55 takes {100 * share / 0.55:.3g} %" in line
    box = Scene(grains=grains, contact=law, container=Box(width=0.1, depth=0.1, height=0.1, lid=True))
    assert "Grains take 3.35 % of the 1 l within the box" in mesh_lines([box])[0]
