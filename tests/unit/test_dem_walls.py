"""Distances from walls against brute force."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from labbook_dem.walls import plane, strip
from labbook_dem.words import vec3

from labbook.scene import Plane, Strip

coordinate = st.floats(-1, 1, allow_subnormal=False)
point2 = st.tuples(coordinate, coordinate)
point3 = st.tuples(coordinate, coordinate, coordinate)


def from_strip(start, end, x):
    p = strip.parameters(Strip(start=start, end=end))
    assert len(p) == 6
    return strip.strip_distance(vec3(p[0], 0.0, p[1]), vec3(p[2], 0.0, p[3]), p[4], vec3(*x))


@settings(max_examples=200, deadline=None)
@given(start=point2, end=point2, x=point3)
def test_no_point_of_a_strip_is_nearer_than_its_distance(start, end, x):
    if math.dist(start, end) < 1e-6:
        return
    distance, normal = from_strip(start, end, x)
    along = np.linspace(0, 1, 2001)[:, None]
    points = (1 - along) * np.array(start) + along * np.array(end)
    brute = np.linalg.norm(points - [x[0], x[2]], axis=1).min()
    assert brute - math.dist(start, end) / 2000 - 1e-12 <= distance <= brute + 1e-12
    assert normal.y == 0
    if distance > 1e-9:
        assert math.hypot(normal.x, normal.z) == pytest.approx(1, rel=1e-9)
        foot = (x[0] - distance * normal.x, x[2] - distance * normal.z)
        assert np.linalg.norm(points - foot, axis=1).min() < math.dist(start, end) / 2000 + 1e-9


def test_a_strip_by_hand():
    """From (0, 0) to (4, 3): above its middle, beyond its end, and on either side."""
    start, end = (0.0, 0.0), (4.0, 3.0)
    distance, normal = from_strip(start, end, (2.0 - 0.6, 7.0, 1.5 + 0.8))
    assert (distance, normal.x, normal.z) == pytest.approx((1.0, -0.6, 0.8))
    distance, normal = from_strip(start, end, (2.0 + 0.6, 7.0, 1.5 - 0.8))
    assert (distance, normal.x, normal.z) == pytest.approx((1.0, 0.6, -0.8))
    distance, normal = from_strip(start, end, (4.0, 0.0, 5.0))
    assert (distance, normal.x, normal.z) == pytest.approx((2.0, 0.0, 1.0))
    distance, normal = from_strip(start, end, (-3.0, 0.0, -4.0))
    assert (distance, normal.x, normal.z) == pytest.approx((5.0, -0.6, -0.8))


def test_distance_and_normal_are_continuous_where_the_edge_begins():
    for side in (-1e-9, 1e-9):
        distance, normal = from_strip((-1.0, 0.0), (0.0, 0.0), (side, 0.0, 0.5))
        assert distance == pytest.approx(0.5, rel=1e-12)
        assert (normal.x, normal.z) == pytest.approx((0.0, 1.0), abs=1e-8)


def test_on_the_strip_itself_there_is_no_normal_and_no_division_by_zero():
    distance, normal = from_strip((0.0, 0.0), (1.0, 0.0), (0.5, 0.0, 0.0))
    assert distance == 0
    assert (normal.x, normal.y, normal.z) == (0, 0, 0)


@settings(max_examples=100, deadline=None)
@given(point=point3, normal=point3, x=point3)
def test_a_plane_s_distance_is_the_projection_on_its_normal(point, normal, x):
    size = math.hypot(*normal)
    if size < 1e-3:
        return
    p = plane.parameters(Plane(point=point, normal=normal))
    distance, unit = plane.plane_distance(vec3(*p[:3]), vec3(*p[3:]), vec3(*x))
    expected = sum((a - b) * c for a, b, c in zip(x, point, normal, strict=True)) / size
    assert distance == pytest.approx(expected, abs=1e-12)
    assert math.hypot(unit.x, unit.y, unit.z) == pytest.approx(1, rel=1e-12)
    assert math.isclose(unit.x * size, normal[0], abs_tol=1e-12)
