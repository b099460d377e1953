"""Surfaces of triangles: order, welding, flaws, and where points lie."""

import math

import numpy as np
import pytest

from labbook.scene.triangles import Triangles, turn

CUBE = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
SIDES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
FACES = np.array([t for a, b, c, d in SIDES for t in ((a, b, c), (a, c, d))])
RNG = np.random.default_rng(7)


def cube(turned: bool = False) -> Triangles:
    surface, _ = Triangles.welded(CUBE, FACES)
    return surface.moved(lambda places: places @ turn((0.3, 0.7, 1.1)).T) if turned else surface


def solid_angles(surface: Triangles, x: np.ndarray, outward: np.ndarray) -> np.ndarray:
    """Winding number of the surface about points (van Oosterom & Strackee 1983); outward: sign of each normal."""
    a, b, c = (surface.corner_positions[None, :, k] - x[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))

    def dot(u, v):
        return np.einsum("nmk,nmk->nm", u, v)

    triple = dot(a, np.cross(b, c))
    below = la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb
    return (2 * np.arctan2(triple, below) * outward).sum(axis=1) / (4 * math.pi)


def test_files_in_another_order_give_the_same_bits():
    order, names = RNG.permutation(len(FACES)), RNG.permutation(len(CUBE))
    other = np.argsort(names)[np.roll(FACES[order], 1, axis=1)[:, ::-1]]
    one, same = cube(), Triangles.welded(CUBE[names], other)[0]
    assert np.array_equal(one.vertices, same.vertices)
    assert np.array_equal(one.corners, same.corners)


def test_vertices_that_nearly_coincide_are_one_and_what_has_no_area_goes():
    soup = CUBE[FACES].reshape(-1, 3) + RNG.uniform(-1e-8, 1e-8, (36, 3))
    flat = [[0, 0, 0], [0.5, 0, 0], [1, 0, 0]]
    corners = np.arange(39).reshape(-1, 3)
    twice = np.concatenate([corners, corners[:1, ::-1]])
    surface, told = Triangles.welded(np.concatenate([soup, flat]), twice)
    assert len(surface.vertices) == 8
    assert len(surface.corners) == 12
    assert (told.flat, told.repeated) == (1, 1)
    assert surface.closed
    assert surface.area == pytest.approx(6, abs=1e-6)


def test_a_surface_with_a_hole_is_not_closed():
    surface, _ = Triangles.welded(CUBE, FACES[1:])
    assert not surface.closed
    assert surface.area == pytest.approx(5.5)


@pytest.mark.parametrize("turned", [False, True])
def test_distances_and_sides_of_a_cube(turned):
    x = RNG.uniform(-1, 2, (4000, 3))
    beyond = np.maximum(np.maximum(-x, x - 1), 0)
    within = np.minimum(x, 1 - x).min(axis=1)
    inside = within > 0
    expected = np.where(inside, within, np.linalg.norm(beyond, axis=1))
    places = x @ turn((0.3, 0.7, 1.1)).T if turned else x
    assert np.abs(cube(turned).distance(places) - expected).max() < 1e-12
    assert np.array_equal(cube(turned).inside(places), inside)


def test_distances_within_a_reach_are_those_without():
    """Of a mesh of long needles and small triangles, to the bit, as placed grains must not depend on the reach."""
    turns = 2 * np.pi * np.arange(40) / 40
    ring = np.column_stack([0.1 * np.cos(turns), 0.1 * np.sin(turns), np.zeros(40)])
    k, after = np.arange(40), (np.arange(40) + 1) % 40
    sides = np.concatenate([np.column_stack([k, after, after + 40]), np.column_stack([k, after + 40, k + 40])])
    places = np.concatenate([ring, ring + np.array([0.0, 0.0, 1.0]), CUBE / 50])
    tube, _ = Triangles.welded(places, np.concatenate([sides, FACES + 80]))
    x = np.concatenate([RNG.uniform(-0.15, 0.15, (2000, 3)), tube.vertices, RNG.uniform(-9, 9, (50, 3))])
    every = np.arange(len(tube.corners))
    exact = np.min([tube.apart(x, np.full(len(x), triangle)) for triangle in every], axis=0)
    assert np.array_equal(tube.distance(x), exact)
    for reach in (1e-3, 0.02, 0.3):  # by a grid, and for a long reach by a search among all triangles
        near = exact <= reach
        assert near.any()
        assert not near.all()
        assert np.array_equal(tube.distance(x, reach)[near], exact[near])
        assert (tube.distance(x, reach)[~near] > reach).all()
    assert np.array_equal(tube.distance(x, 0.0) <= 0, exact <= 0)


def test_sides_are_those_of_the_winding_number():
    """A torus-like surface of 24 triangles; points straight above and below edges and vertices are among them."""
    frame, _ = Triangles.welded(*_frame())
    up = np.array([0, 0, 2.5])
    x = np.concatenate([RNG.uniform(-2.5, 2.5, (500, 3)), frame.vertices + up, frame.vertices - up])
    middle = frame.corner_positions.mean(axis=1)
    normal = np.cross(
        frame.corner_positions[:, 1] - frame.corner_positions[:, 0],
        frame.corner_positions[:, 2] - frame.corner_positions[:, 0],
    )
    step = middle + 1e-6 * normal / np.linalg.norm(normal, axis=1)[:, None]
    outward = np.where(frame.inside(step), -1.0, 1.0)
    winding = solid_angles(frame, x, outward)
    assert np.abs(winding - winding.round()).max() < 1e-9
    assert set(np.abs(winding.round()).astype(int)) == {0, 1}
    assert np.array_equal(frame.inside(x), np.abs(winding) > 0.5)


def _frame() -> tuple[np.ndarray, np.ndarray]:
    """A square frame: rings of four corners, outer and inner, at two heights."""
    rings = [(2, -1), (1, -1), (1, 1), (2, 1)]
    corners = np.array([[r * x, r * y, z] for r, z in rings for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))], float)
    triangles = []
    for ring in range(4):
        for k in range(4):
            a, b = 4 * ring + k, 4 * ring + (k + 1) % 4
            c, d = 4 * ((ring + 1) % 4) + k, 4 * ((ring + 1) % 4) + (k + 1) % 4
            triangles += [(a, b, d), (a, d, c)]
    return corners, np.array(triangles)


def test_flaws_are_told_with_their_place():
    fin = np.array([[-1.0, -1.0, 0.5]])
    crowded, _ = Triangles.welded(np.concatenate([CUBE, fin]), np.concatenate([FACES, [[0, 1, 8]]]))
    flaw = next(crowded.flaws())
    assert (flaw.kind, flaw.count, flaw.at) == ("non-manifold", 1, (0.0, 0.0, 0.5))

    t = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0], [1, 0, 0], [1, -1, 0], [2, -1, 0]], float)
    junction, _ = Triangles.welded(t, np.array([[0, 1, 2], [3, 4, 5]]))
    flaw = next(junction.flaws())
    assert (flaw.kind, flaw.count, flaw.at) == ("t-junctions", 1, (1.0, 0.0, 0.0))

    through = np.array([[0.2, 0.2, -1], [0.2, 0.2, 1], [3, 3, 1]], float)
    cut, _ = Triangles.welded(np.concatenate([t[:3], through]), np.array([[0, 1, 2], [3, 4, 5]]))
    flaw = next(cut.flaws())
    assert flaw.kind == "intersections"
    assert flaw.at == pytest.approx((0.2, 0.2, 0.0)) or flaw.at[0] + flaw.at[1] == pytest.approx(2.0)

    assert not list(cube(turned=True).flaws())


def test_volumes_of_closed_surfaces():
    """A cube of 1 m, in any orientation and far away, and a square frame of 4 x 4 x 2 m with a hole of 2 x 2 m."""
    assert cube().volume == pytest.approx(1, rel=1e-12)
    assert cube(turned=True).moved(lambda places: places + 50).volume == pytest.approx(1, rel=1e-9)
    assert Triangles.welded(*_frame())[0].volume == pytest.approx(4 * 4 * 2 - 2 * 2 * 2, rel=1e-12)
    assert math.isnan(Triangles.welded(CUBE, FACES[:-1])[0].volume)
