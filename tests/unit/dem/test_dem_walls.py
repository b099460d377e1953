"""Distances from walls against brute force."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from labbook_dem.walls import frustum, plane, strip
from labbook_dem.words import vec3
from scipy.spatial import KDTree

from labbook.scene import Frustum, Plane, Strip

coordinate = st.floats(-1, 1, allow_subnormal=False)
point2 = st.tuples(coordinate, coordinate)
point3 = st.tuples(coordinate, coordinate, coordinate)


def from_strip(start, end, x):
    p = strip.parameters(Strip(start=start, end=end))
    assert len(p) == 5
    return strip.strip_distance(vec3(p[0], 0.0, p[1]), vec3(p[2], 0.0, p[3]), p[4], vec3(*x))


@settings(max_examples=200)
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


@settings(max_examples=100)
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


# frustums, and rods at edges


def from_frustum(lower, upper, x):
    p = frustum.parameters(Frustum(lower=lower, upper=upper))
    assert len(p) == 5
    return frustum.frustum_distance(vec3(p[0], 0.0, p[1]), vec3(p[2], 0.0, p[3]), p[4], vec3(*x))


def turned_round(lower, upper, around=721, along=401) -> np.ndarray:
    """Points of a frustum, shape [around * along, 3]."""
    part, angle = np.linspace(0, 1, along)[:, None], np.linspace(0, 2 * math.pi, around)[None]
    r, z = (lower[k] + part * (upper[k] - lower[k]) for k in (0, 1))
    return np.stack(np.broadcast_arrays(r * np.cos(angle), r * np.sin(angle), z), -1).reshape(-1, 3)


FRUSTUMS = {
    "plate": ((0.4, 0.0), (1.0, 0.0)),
    "disc": ((0.0, 0.1), (1.0, 0.1)),
    "cylinder": ((0.8, -0.5), (0.8, 0.5)),
    "cone": ((0.3, 0.0), (0.9, 0.7)),
    "roof": ((0.3, 0.7), (0.9, 0.0)),
}


@pytest.mark.parametrize("kind", FRUSTUMS)
def test_a_frustum_s_distance_is_that_of_its_nearest_point(kind):
    points = KDTree(turned_round(*FRUSTUMS[kind]))
    for x in np.random.default_rng(2).uniform(-1.2, 1.2, (60, 3)):
        distance, normal = from_frustum(*FRUSTUMS[kind], x)
        brute, _ = points.query(x)
        assert distance - 1e-12 <= brute <= distance + 8e-3
        n = np.array([normal.x, normal.y, normal.z])
        assert np.linalg.norm(n) == pytest.approx(1, rel=1e-12)
        assert points.query(x - distance * n)[0] < 8e-3


def rod_at(kind: str, x, a, half, radius, part):
    """Distance, normal, s of a part of a rod at a wall of this kind."""
    x, a = vec3(*map(float, x)), vec3(*map(float, a))
    if kind == "strip":
        p = strip.parameters(Strip(start=(-1.0, 0.2), end=(0.5, -0.1)))
        return strip.strip_rod(vec3(p[0], 0.0, p[1]), vec3(p[2], 0.0, p[3]), p[4], x, a, half, radius, part)
    p = frustum.parameters(Frustum(lower=FRUSTUMS[kind][0], upper=FRUSTUMS[kind][1]))
    place = vec3(p[0], 0.0, p[1]), vec3(p[2], 0.0, p[3]), p[4], x, a, half
    return frustum.frustum_rod(*place, part, *frustum.frustum_edges(*place, radius))


def bare(kind: str, points: np.ndarray) -> np.ndarray:
    """Distances of points [n, 3] from the wall, seen in its section."""
    start, end = map(np.array, FRUSTUMS.get(kind, ((-1.0, 0.2), (0.5, -0.1))))
    across = points[:, 0] if kind == "strip" else np.hypot(points[:, 0], points[:, 1])
    at = np.stack([across, points[:, 2]], axis=1) - start
    part = np.clip(at @ (end - start) / ((end - start) @ (end - start)), 0, 1)
    return np.linalg.norm(at - part[:, None] * (end - start), axis=1)


def outside(kind: str, points: np.ndarray) -> bool:
    """Whether some of these are outside the cone, where grains never are and rods would touch it by their sides."""
    (r, z), (r1, z1) = FRUSTUMS.get(kind, ((0, 0), (0, 0)))
    return kind == "cone" and bool(np.any((np.hypot(*points.T[:2]) - r) * (z1 - z) > (points[:, 2] - z) * (r1 - r)))


@pytest.mark.parametrize("kind", ["plate", "cone", "strip"])
def test_the_nearest_of_a_rod_s_parts_is_the_nearest_point_of_its_segment(kind):
    """Thin rods anywhere round an edge: ends, and minima at the edge, against a finely sampled segment."""
    rng = np.random.default_rng(3)
    edges = 0
    for _ in range(300):
        angle, half = rng.uniform(0, 2 * math.pi), rng.uniform(0.05, 0.4)
        r = FRUSTUMS[kind][0][0] if kind != "strip" else 0.5
        centre = [r * math.cos(angle), r * math.sin(angle), 0.0] if kind != "strip" else [0.5, 0.0, -0.1]
        x = np.array(centre) + rng.normal(size=3) * 0.1
        a = rng.normal(size=3)
        a /= np.linalg.norm(a)
        s = np.linspace(-half, half, 2001)
        sampled = bare(kind, x + s[:, None] * a)
        if sampled.min() < 2e-3 or outside(kind, x + s[:, None] * a):
            continue  # the segment cuts the wall, or is where no grain is
        parts = [rod_at(kind, x, a, half, 1e-9, part) for part in range(4)]
        there = [(d, n, where) for d, n, where in parts if d < 1e8]
        for d, n, where in there:
            point = x + where * a
            assert d == pytest.approx(bare(kind, point[None])[0], abs=1e-12)
            assert math.hypot(n.x, n.y, n.z) == pytest.approx(1, rel=1e-9)
        nearest = min(there, key=lambda part: part[0])
        over = np.abs(np.diff(sampled)).max()  # of the sampling
        assert nearest[0] - over <= sampled.min() <= nearest[0] + over
        edges += nearest in parts[2:]
    assert edges > 10


@pytest.mark.parametrize("kind", ["plate", "cone", "strip"])
def test_a_rod_without_length_has_the_one_contact_of_a_sphere(kind):
    rng = np.random.default_rng(4)
    for x in np.array([0.4, 0.0, 0.0]) + rng.normal(size=(50, 3)) * 0.1:
        found = [rod_at(kind, x, (0, 0.6, 0.8), 0.0, 1.0, part) for part in range(4)]
        (only,) = [part for part in found if part[0] < 1e8]
        assert only[0] == pytest.approx(bare(kind, x[None])[0], rel=1e-12)
        assert only[2] == 0


def overlaps(kind, x, a, half, radius) -> np.ndarray:
    return np.array([max(0.0, radius - rod_at(kind, x, a, half, radius, part)[0]) for part in range(4)])


@pytest.mark.parametrize("kind", ["plate", "strip"])
@pytest.mark.parametrize("dip", [-1e-4, 0.0, 1e-4])
def test_the_force_stays_continuous_as_a_rod_slides_over_an_edge(kind, dip):
    """A rod lying (nearly) flat on a plate slides across its edge end first: the sum of overlaps has no jumps."""
    half, radius, deep = 0.15, 0.05, 1e-3
    slide = np.linspace(-0.25, 0.25, 2001)
    if kind == "plate":
        edge, out, up = np.array([0.4, 0.0, 0.0]), np.array([-1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    else:
        edge, out = np.array([0.5, 0.0, -0.1]), np.array([1.5, 0.0, -0.3]) / math.hypot(1.5, 0.3)
        up = np.array([-out[2], 0.0, out[0]])
    a = out * math.cos(dip) - up * math.sin(dip)
    found = np.array([overlaps(kind, edge + out * u + up * (radius - deep), a, half, radius) for u in slide])
    total = found.sum(axis=1)
    assert np.abs(np.diff(total)).max() < 0.1 * deep  # as steep as where a sphere rolls off the edge
    assert total[0] == pytest.approx(2 * deep, rel=0.05)  # both ends lie on the plate
    assert total[-1] == 0
    assert np.all(np.count_nonzero(found[(slide > -half) & (slide < half - 0.01)][:, 2:], axis=1) >= 1)


def test_a_rod_over_a_chord_of_the_hole_is_carried_by_its_ends():
    a, x = (0, 1, 0), (0.35, 0.0, 0.049)
    found = overlaps("plate", x, a, 0.25, 0.05)
    assert found[:2] == pytest.approx([1e-3, 1e-3], rel=1e-6)
    assert found[2:] == pytest.approx([0, 0], abs=1e-12)


def test_an_end_that_passes_the_rim_hands_its_contact_to_the_rim():
    """A rod across the hole's edge, its one end just before and just behind the rim."""
    half, radius = 0.15, 0.05
    before, after = (
        overlaps("plate", (0.4 + shift - half, 0.0, radius - 1e-3), (1, 0, 0), half, radius) for shift in (1e-6, -1e-6)
    )
    assert before == pytest.approx([0, 1e-3, 0, 0], abs=1e-7)
    assert after.sum() == pytest.approx(1e-3, abs=1e-7)
    assert after[1] == 0


def test_a_rod_s_ends_on_a_plane():
    p = plane.parameters(Plane(point=(0, 0, 1), normal=(0, 0, 2)))
    point, normal = vec3(*p[:3]), vec3(*p[3:])
    found = [plane.plane_rod(point, normal, vec3(0, 0, 2), vec3(0.6, 0, 0.8), 0.5, part) for part in (0, 1)]
    assert np.array([(d, s) for d, _, s in found]) == pytest.approx(np.array([(0.6, -0.5), (1.4, 0.5)]))
    alone = [plane.plane_rod(point, normal, vec3(0, 0, 2), vec3(0.6, 0, 0.8), 0.0, part)[0] for part in (0, 1)]
    assert alone == [1.0, 1e9]
