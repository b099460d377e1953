"""Contacts of a sphere with triangles: which there are, how deep, and whose springs they go on with."""

import math

import numpy as np
import pytest
from labbook_dem.mesh import MESH_CONTACTS, PlainMesh, TooManyContacts
from labbook_dem.words import vec3

from labbook.checks.verify.mesh import sheet
from labbook.scene import TriangleMesh
from labbook.scene.triangles import Triangles, turn

RNG = np.random.default_rng(11)


def mesh(vertices, triangles, smooth: float = 0.0) -> PlainMesh:
    surface, _ = Triangles.welded(np.asarray(vertices, float), np.asarray(triangles))
    return PlainMesh(TriangleMesh.of_surface(surface, smooth))


def contacts(of: PlainMesh, x, held=()) -> list:
    """Contacts of a sphere of radius 1 at x."""
    return list(of.contacts(vec3(*map(float, x)), 1.0, sorted(held)))


@pytest.mark.parametrize("cells", [2, 6, 20])
def test_a_plane_is_touched_once_wherever_its_triangles_meet(cells):
    turned = turn((0.3, 0.7, 1.1))
    vertices, triangles = sheet(cells, 10.0)
    plane = mesh(vertices @ turned.T, triangles)
    inner = vertices[np.abs(vertices).max(axis=1) < 8]
    ends = vertices[triangles[np.abs(vertices[triangles]).max(axis=(1, 2)) < 8]]
    on_edges = [ends[:, 0] + part * (ends[:, 1] - ends[:, 0]) for part in (0.5, 0.123)]
    feet = np.concatenate([np.pad(RNG.uniform(-8, 8, (100, 2)), ((0, 0), (0, 1))), inner, *on_edges])[:400]
    for foot in feet:
        overlap = 10 ** RNG.uniform(-4, -1.5)
        side = RNG.choice((-1, 1))
        found = contacts(plane, turned @ (foot + np.array([0, 0, side * (1 - overlap)])))
        assert len(found) == 1, foot
        _, distance, normal, _ = found[0]
        assert abs(1 - distance - overlap) < 1e-9
        assert np.abs(np.array([normal.x, normal.y, normal.z]) - side * turned[:, 2]).max() < 1e-9


def test_a_corner_of_three_planes_is_touched_once_each():
    vertices, triangles = sheet(8, 5.0)
    walls = [(vertices + np.array([5, 5, 0]))[:, axes] for axes in ([0, 1, 2], [0, 2, 1], [2, 0, 1])]
    corner = mesh(np.concatenate(walls), np.concatenate([triangles + len(vertices) * k for k in range(3)]))
    for _ in range(60):
        x = RNG.uniform(0.95, 3, 3)
        near = x < 1
        x = np.where(near, 1 - 10 ** RNG.uniform(-4, -2, 3), x)
        found = contacts(corner, x)
        assert len(found) == near.sum()
        depths = sorted(1 - distance for _, distance, _, _ in found)
        assert depths == pytest.approx(sorted(1 - x[near]), abs=1e-12)


@pytest.mark.parametrize("width", [1e-1, 1e-3, 3e-5])
def test_a_needle_ends_at_its_tip(width):
    """Its sides differ by less than the slack of conditions far beyond the tip."""
    needle = mesh([[0, 0, 0], [-10, width / 2, 0], [-10, -width / 2, 0]], [[0, 1, 2]])
    for beyond in (0.01, 0.3, 0.9, 1.5):
        found = contacts(needle, (beyond, 0.0, 0.6))
        expected = [math.hypot(beyond, 0.6)] if math.hypot(beyond, 0.6) < 1 else []
        assert [distance for _, distance, _, _ in found] == pytest.approx(expected, abs=1e-6), beyond
    for inside in (-0.5, -3.0, -9.0):
        assert [distance for _, distance, _, _ in contacts(needle, (inside, 0.0, 0.6))] == pytest.approx(
            [0.6], abs=1e-9
        )


def test_the_normal_turns_continuously_over_a_ridge():
    slope = 0.5
    roof = mesh(
        [[-5, -5, -5 * slope], [0, -5, 0], [5, -5, -5 * slope], [-5, 5, -5 * slope], [0, 5, 0], [5, 5, -5 * slope]],
        [[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]],
    )
    tilt, last = math.atan(slope), None
    for turned in np.linspace(-1.5 * tilt, 1.5 * tilt, 801):
        along = max(abs(turned) - tilt, 0.0) * np.sign(turned)
        angle = np.clip(turned, -tilt, tilt)
        foot = np.array([along * math.cos(tilt), 0.3, -abs(along) * math.sin(tilt)])
        normal = np.array([math.sin(angle), 0, math.cos(angle)])
        found = contacts(roof, foot + 0.99 * normal)
        assert len(found) == 1
        assert 1 - found[0][1] == pytest.approx(0.01, abs=1e-9)
        of = np.array([found[0][2].x, found[0][2].y, found[0][2].z])
        assert np.abs(of - normal).max() < 1e-6
        assert last is None or np.abs(of - last).max() < 0.01
        last = of


def trough(sides: int, smooth: float) -> PlainMesh:
    angles = np.linspace(-2.0, -1.0, sides)
    ends = [(19 * math.cos(t), y, 19 * math.sin(t)) for t in angles for y in (-9.0, 9.0)]
    return mesh(ends, [t for k in range(0, 2 * sides - 2, 2) for t in ((k, k + 2, k + 3), (k, k + 3, k + 1))], smooth)


def test_flat_sides_of_a_smooth_surface_are_touched_once():
    several = [0, 0]
    for k, smooth in enumerate((0.0, math.radians(15))):
        surface = trough(40, smooth)
        for angle in np.linspace(-1.6, -1.4, 101):
            found = contacts(surface, 18.01 * np.array([math.cos(angle), 0, math.sin(angle)]))
            several[k] += len(found) > 1
            if smooth:
                x, z = found[0][2].x, found[0][2].z  # within half a side of that of the round surface
                assert abs(x * math.sin(angle) - z * math.cos(angle)) < 0.6 / 39
    assert several[0] > 3
    assert several[1] == 0


def around(sides: int) -> list[tuple[int, int, int]]:
    """Triangles of a tube of so many sides, whose corners are listed side by side, below and above."""
    pairs = [(2 * k, 2 * ((k + 1) % sides)) for k in range(sides)]
    return [t for a, b in pairs for t in ((a, b, b + 1), (a, b + 1, a + 1))]


def test_opposite_sides_of_a_smooth_tube_stay_two_contacts():
    angles = 2 * math.pi * np.arange(24) / 24
    ends = [(0.99 * math.cos(t), 0.99 * math.sin(t), z) for t in angles for z in (-9.0, 9.0)]
    ends = [(x * 1.0, y * 1.4, z) for x, y, z in ends]  # so that only two sides are near
    sides = [
        t for k in range(24) for a, b in ((2 * k, 2 * ((k + 1) % 24)),) for t in ((a, b, b + 1), (a, b + 1, a + 1))
    ]
    found = contacts(mesh(ends, sides, math.radians(25)), (0, 0, 0.2))
    assert len(found) == 2
    assert found[0][2].x == pytest.approx(-found[1][2].x)


def test_a_spring_goes_on_to_the_next_triangle_and_stays_with_its_own():
    vertices, triangles = sheet(6, 6.0)
    plane = mesh(vertices, triangles)
    held: list[int] = []
    seen = set()
    for at in np.linspace(-5, 5, 401):
        found = contacts(plane, (at, 0.37 * at, 0.99), held)
        assert len(found) == 1
        feature, _, _, older = found[0]
        assert at == -5 or older == held[0], "the spring of the last step is lost"
        held = [feature]
        seen.add(feature)
    assert len(seen) > 6


def test_a_contact_elsewhere_begins_without_a_spring():
    """On the floor and then, away from it, on the ceiling: no triangle of the two has a vertex in common."""
    vertices, triangles = sheet(2, 6.0)
    places = np.concatenate([vertices, vertices + np.array([0, 0, 1.9])])
    both = mesh(places, np.concatenate([triangles, triangles + len(vertices)]))
    on_floor, on_ceiling = contacts(both, (0.3, 0.1, 0.95))
    assert [on_floor[3], on_ceiling[3]] == [None, None]
    assert [found[3] for found in contacts(both, (0.3, 0.1, 0.95), [on_floor[0]])] == [on_floor[0], None]


def test_more_contacts_than_there_is_room_for_are_an_error():
    sides = 2 * MESH_CONTACTS + 2
    angles = 2 * math.pi * np.arange(sides) / sides
    ends = [(0.99 * math.cos(t), 0.99 * math.sin(t), z) for t in angles for z in (-9.0, 9.0)]
    with pytest.raises(TooManyContacts, match="smooth"):
        contacts(mesh(ends, around(sides)), (0, 0, 0.2))
