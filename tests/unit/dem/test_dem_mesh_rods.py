"""Contacts of a rod with triangles: which there are, how deep, and whose springs they go on with."""

import math
from typing import Any

import numpy as np
import pytest
from labbook_dem.chosen import choose
from labbook_dem.mesh import OVER, TooManyContacts
from labbook_dem.mesh_rods import BETWEEN, ROD_PARTS, PlainRodMesh, mesh_rod_contacts, mesh_rod_near
from labbook_dem.plain_walls import NONE, GrainState, PlainWalls
from labbook_dem.words import vec3
from scipy.optimize import minimize_scalar

from labbook.backend.numerics import Numerics
from labbook.checks.verify.mesh import of_triangles, sheet
from labbook.checks.verify.rods import rods
from labbook.scene import Primitives, Strip, TriangleMesh, Wall
from labbook.scene.triangles import Triangles, turn

RNG = np.random.default_rng(13)
HALF = 2.5


def mesh(vertices, triangles, smooth: float = 0.0) -> PlainRodMesh:
    surface, _ = Triangles.welded(np.asarray(vertices, float), np.asarray(triangles))
    return PlainRodMesh(TriangleMesh.of_surface(surface, smooth))


def contacts(of: PlainRodMesh, x, a, held=()) -> list:
    """Contacts of a rod of radius 1 at x along a."""
    a = np.asarray(a, float) / np.linalg.norm(a)
    at, axis = (vec3(*vector.tolist()) for vector in (np.asarray(x, float), a))
    return list(of.rod_contacts(at, axis, HALF, 1.0, sorted(held)))


def part(feature: int) -> int:
    return feature % ROD_PARTS


def test_on_a_plane_of_triangles_its_two_ends_touch_wherever_they_lie():
    turned = turn((0.3, 0.7, 1.1))
    vertices, triangles = sheet(6, 12.0)
    plane = mesh(vertices @ turned.T, triangles)
    for _ in range(150):
        tilt, direction = RNG.choice((0.0, RNG.uniform(-0.02, 0.02))), RNG.uniform(0, 2 * math.pi)
        a = np.array([math.cos(direction) * math.cos(tilt), math.sin(direction) * math.cos(tilt), math.sin(tilt)])
        centre = np.array([*RNG.uniform(-8, 8, 2), 1 - RNG.uniform(-0.01, 0.03)])
        heights = {k: centre[2] + s * a[2] for k, s in enumerate((-HALF, HALF))}
        found = contacts(plane, turned @ centre, turned @ a)
        assert sorted(part(one[0]) for one in found) == [k for k, z in heights.items() if z < 1]
        for feature, distance, normal, s, _ in found:
            assert abs(distance - heights[part(feature)]) < 1e-9
            assert s == (-HALF, HALF)[part(feature)]
            assert np.abs(np.array([normal.x, normal.y, normal.z]) - turned[:, 2]).max() < 1e-9


def block(cells: int, half: float) -> tuple[np.ndarray, np.ndarray]:
    """A cube around the origin, whose faces are divided."""
    vertices, triangles = sheet(cells, half)
    ticks = np.linspace(-half, half, cells + 1)
    flat = np.stack(np.meshgrid(ticks, ticks, indexing="ij"), axis=-1).reshape(-1, 2)  # the rims of faces have to meet
    vertices[:, :2] = flat
    sides = []
    for axes in ([0, 1, 2], [0, 2, 1], [2, 0, 1]):
        for sign in (-1, 1):
            sides.append((vertices + np.array([0, 0, sign * half]))[:, axes])
    return np.concatenate(sides), np.concatenate([triangles + len(vertices) * k for k in range(6)])


def apart(x: np.ndarray, half: float) -> float:
    return float(np.linalg.norm(np.maximum(np.abs(x) - half, 0)))


def across_an_edge() -> tuple[np.ndarray, np.ndarray, float, float]:
    """Centre and axis of a rod whose ends are clear of the cube of half width 3; distance and place of its nearest
    point by minimisation."""
    while True:
        x, a = RNG.normal(0, 3.5, 3), RNG.normal(0, 1, 3)
        a /= np.linalg.norm(a)
        if min(apart(x - HALF * a, 3.0), apart(x + HALF * a, 3.0)) < 1:
            continue
        nearest: Any = minimize_scalar(
            lambda s, x=x, a=a: apart(x + s * a, 3.0), bounds=(-HALF, HALF), method="bounded", options={"xatol": 1e-11}
        )
        if 0.5 < nearest.fun < 1.1 and abs(nearest.fun - 1) > 1e-6:
            return x, a, float(nearest.fun), float(nearest.x)


def test_between_its_ends_it_touches_a_cube_at_the_nearest_point_only():
    """The distance from a convex body is convex along the rod, and so has one minimum."""
    vertices, triangles = block(4, 3.0)
    order = RNG.permutation(len(triangles))
    shuffled = np.roll(triangles[order], 1, axis=1)[:, ::-1]
    cube, again = mesh(vertices, triangles), mesh(vertices, shuffled)
    touching, kinds = 0, set()
    for _ in range(120):
        x, a, distance, place = across_an_edge()
        found = contacts(cube, x, a)
        assert found == contacts(again, x, a), "the order of triangles counts"
        assert len(found) == (distance < 1), (x, a)
        if found:
            touching += 1
            feature, away, _, s, _ = found[0]
            kinds.add(cube.table.features[feature, 0])
            assert part(feature) == BETWEEN
            assert away == pytest.approx(distance, abs=1e-9)
            assert s == pytest.approx(place, abs=1e-4)
    assert touching > 40
    assert kinds == {1, 2}, "edges and vertices"


def test_a_feature_is_near_before_a_rod_that_moves_touches_it():
    vertices, triangles = block(2, 3.0)
    cube = mesh(vertices, triangles)
    features, conditions = cube.table[:2]
    every = np.arange(0, len(features), ROD_PARTS)
    room, moves, touched = np.zeros_like(cube.rows), 0.2, 0
    for _ in range(60):
        x, a, _, _ = across_an_edge()
        ends = np.array([x - HALF * a, x + HALF * a]) + moves / math.sqrt(3) * RNG.uniform(-1, 1, (2, 3))
        later, axis = ends.mean(axis=0), (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        count = mesh_rod_contacts(
            features, conditions, every, 0, len(every), vec3(*later), vec3(*axis), HALF, 1.0, room
        )  # fmt: skip
        assert count != OVER
        for feature in room[:count, 0].astype(int):
            touched += 1
            first = feature - part(feature)
            assert mesh_rod_near(features, conditions, first, vec3(*x), vec3(*a), HALF, 1.0, 1.01 * moves)
    assert touched > 20


def plates() -> tuple[PlainWalls, PlainWalls]:
    """The plate x < 0 of triangles, and as a strip, for rods of the verification."""
    far = 0.1
    ends = np.array([[-far, -far, 0], [-far, far, 0], [0, -far, 0], [0, 0, 0], [0, far, 0]])
    triangles = of_triangles(ends, np.array([[0, 2, 3], [0, 3, 1], [1, 3, 4]]))
    strip = Wall(name="floor", shape=Strip(start=(-far, 0.0), end=(0.0, 0.0)))
    both = (rods(1, Primitives(parts=(wall,)), friction=0.3) for wall in (triangles, strip))
    one, other = (PlainWalls(of, Numerics(dt=1e-5)) for of in both)
    return one, other


def load(on: PlainWalls, x: float, z: float, tilt: float, direction: float = 0.4) -> np.ndarray:
    """Force and torque on a rod over the plate."""
    grains = on.scene.grains
    flat = math.cos(tilt)
    axis = vec3(math.cos(direction) * flat, math.sin(direction) * flat, math.sin(tilt))
    own = grains.radius, grains.mass, grains.inertia_axis, 0
    grain = GrainState(0, vec3(x, 1e-3, z), axis, NONE, NONE, NONE, NONE, *own)
    total = np.zeros(6)
    with choose("linear", twist=True, springs=False):
        for one in on.contacts(0, grain, {}, {}):
            total += (one.force.x, one.force.y, one.force.z, one.torque.x, one.torque.y, one.torque.z)
    return total


def test_over_the_edge_of_a_plate_it_is_carried_as_by_a_strip():
    triangles, strip = plates()
    radius, half = triangles.scene.grains.radius, triangles.scene.grains.overhang
    for place in np.linspace(-1.2, 1.2, 13):
        for tilt in (-3e-6, -1e-6, 0.0, 1e-6, 2e-6):
            x, z = place * half, radius * (1 - 1e-5)
            one, other = load(triangles, x, z, tilt), load(strip, x, z, tilt)
            assert np.abs(one - other).max() < 2e-3 * np.abs(other).max() + 1e-12, (place, tilt)


def test_the_force_is_continuous_as_a_rod_slides_off_and_tips_over():
    triangles, _ = plates()
    radius, half = triangles.scene.grains.radius, triangles.scene.grains.overhang
    k = triangles.scene.contact.model_dump()["normal_stiffness"]
    largest = k * 1e-5 * radius
    passes = math.cos(0.4)  # half lengths from the edge at which an end passes it
    # the overlap of an end falls off within sqrt(2 R delta), or 2e-3 half lengths
    off = [load(triangles, (x - passes) * half, radius * (1 - 1e-5), 0.0)[2] for x in np.linspace(-0.001, 0.004, 150)]
    away = [load(triangles, (x + passes) * half, radius * (1 - 1e-5), 0.0)[2] for x in np.linspace(-0.001, 0.004, 150)]
    tips = [load(triangles, -0.2 * half, radius * (1 - 1e-5), t)[2] for t in np.linspace(-1e-5, 1e-5, 150)]
    for forces in (off, away, tips):
        assert max(forces) > 0.9 * largest
        assert 0 < np.abs(np.diff(forces)).max() < 0.05 * largest


def test_springs_stay_with_their_ends_from_triangle_to_triangle():
    vertices, triangles = sheet(5, 9.0)
    plane = mesh(vertices, triangles)
    held: list[int] = []
    seen = set()
    for at in np.linspace(-5, 5, 201):
        found = contacts(plane, (at, 0.37 * at, 0.99), (math.cos(at / 5), math.sin(at / 5), 0), held)
        assert sorted(part(one[0]) for one in found) == [0, 1]
        for feature, _, _, _, older in found:
            assert at == -5 or part(older) == part(feature), "the spring of the last step is lost, or another's"
        held = [one[0] for one in found]
        seen |= {*held}
    assert len(seen) > 12


def test_in_a_corner_each_end_touches_each_plane():
    vertices, triangles = sheet(2, 9.0)
    shifted = vertices + np.array([9, 0, 0])
    corner = mesh(np.concatenate([shifted, shifted[:, [2, 1, 0]]]), np.concatenate([triangles, triangles + 9]))
    found = contacts(corner, (0.99, 0.3, 0.98), (0, 1, 0))
    assert sorted((part(one[0]), round(one[1], 9)) for one in found) == [(0, 0.98), (0, 0.99), (1, 0.98), (1, 0.99)]


def test_more_contacts_than_there_is_room_for_are_an_error():
    angles = 2 * math.pi * np.arange(18) / 18
    ends = [(0.99 * math.cos(t), 0.99 * math.sin(t), z) for t in angles for z in (-9.0, 9.0)]
    pairs = [(2 * k, 2 * ((k + 1) % 18)) for k in range(18)]
    tube = mesh(ends, [t for a, b in pairs for t in ((a, b, b + 1), (a, b + 1, a + 1))])
    with pytest.raises(TooManyContacts, match="smooth"):
        contacts(tube, (0, 0, 0.2), (0, 0, 1))
