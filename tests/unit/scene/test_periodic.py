"""Periodic sides: what a container says, what it refuses, and what crosses its sides."""

import math
from dataclasses import replace

import labbook_reference
import numpy as np
import pytest
from labbook_dem.images import image, nearest
from labbook_dem.words import vec3
from pydantic import ValidationError
from scipy.spatial import KDTree

from labbook.backend import Unsupported
from labbook.backend.numerics import Numerics
from labbook.filling.placing import place
from labbook.lab.identity import scene_key
from labbook.measure.packing import packing_fraction
from labbook.measure.region import Region
from labbook.scene import (
    Box,
    Clumps,
    Frustum,
    LinearSpringDashpot,
    PartMotion,
    Plane,
    Scene,
    Spheres,
    Spherocylinders,
    Strip,
    TriangleMesh,
    Wall,
    WedgeHopper,
)
from labbook.scene.orientation import axes, distances
from labbook.scene.packing import Packing
from labbook.scene.periodic import nearest_images, tree, tree_places, with_images
from labbook.scene.sizes import Uniform
from labbook.scene.triangles import Triangles
from labbook.scene.wall_shape import SurfaceMotion

D = 3e-3
PERIOD = 3.3 * D


def box(depth: float = PERIOD, **further) -> Box:
    return Box(width=5 * D, depth=depth, height=60 * D, periodic="y", **further)


def scene(container=None, grains=None) -> Scene:
    grains = grains or Spheres(diameter=D, density=2500, count=150)
    return Scene(
        grains=grains,
        contact=LinearSpringDashpot(normal_stiffness=1e3, restitution=0.5),
        container=container or box(),
    )


def test_a_container_has_no_front_and_back_and_its_key_changes_only_with_periodic_sides():
    hopper = WedgeHopper(width=10 * D, height=30 * D, thickness=PERIOD, orifice=4 * D, periodic="y")
    for container in (box(), hopper, hopper.close(), box().close()):
        assert {"front", "back"}.isdisjoint(wall.name for wall in container.walls())
        assert container.period == container.front_to_back == PERIOD
    walled = box().model_copy(update={"periodic": None})
    assert math.isinf(walled.period)
    assert "periodic" not in walled.model_dump()
    assert box().model_dump()["periodic"] == "y"


def test_a_backend_without_them_refuses_them_before_anything_runs():
    backend = labbook_reference.Backend()
    numerics = Numerics(dt=1e-5)
    assert backend.specialise(scene(), numerics).feature("PERIODIC")
    backend.capabilities = replace(backend.capabilities, periodic=False)
    with pytest.raises(Unsupported, match="no periodic sides") as refused:
        backend.specialise(scene(), numerics)
    assert refused.value.key == "container.periodic"


def test_keys_tell_periods_apart_which_no_wall_does():
    hopper = WedgeHopper(width=5 * D, height=60 * D, thickness=PERIOD, orifice=2 * D, periodic="y").close()
    scenes = [scene(container) for container in (box(), box(1.1 * PERIOD), box().model_copy(update={"periodic": None}))]
    assert len({scene_key(of) for of in (*scenes, scene(hopper))}) == 4
    assert scenes[0].container.walls() == scenes[1].container.walls()


@pytest.mark.parametrize("grains", [Spheres(diameter=D, density=1, count=1),
                                    Spherocylinders(diameter=D, length=3 * D, density=1, count=1)])  # fmt: skip
def test_sides_closer_than_two_grain_lengths_are_refused(grains):
    assert scene(box(2.001 * grains.extent), grains).container.period > 2 * grains.extent
    with pytest.raises(ValidationError, match=r"container\.depth.*two grain lengths"):
        scene(box(2 * grains.extent), grains)


def sheet(half: float, **further) -> Wall:
    ends = np.array([(x, y, 5 * D) for x in (-D, D) for y in (-half, half)])
    surface, _ = Triangles.welded(ends, np.array([[0, 1, 2], [1, 2, 3]]))
    return Wall(name="sheet", shape=TriangleMesh.of_surface(surface), **further)


@pytest.mark.parametrize(
    ("part", "fits"),
    [
        (Wall(name="a", shape=Strip(start=(-D, 5 * D), end=(D, 6 * D))), True),
        (Wall(name="a", shape=Plane(point=(0, 0, 30 * D), normal=(0.3, 0, -1))), True),
        (Wall(name="a", shape=Plane(point=(0, 0, 30 * D), normal=(0, 0.1, -1))), False),
        (Wall(name="a", shape=Plane(point=(0, 0, 0), normal=(0, 1, 0))), False),
        (Wall(name="a", shape=Frustum(lower=(2.9 * D, 4 * D), upper=(2.9 * D, 6 * D))), True),
        (Wall(name="a", shape=Frustum(lower=(3.1 * D, 4 * D), upper=(3.1 * D, 6 * D))), False),
        (sheet(2.9 * D), True),
        (sheet(3.1 * D), False),
        (sheet(2.9 * D, moves=PartMotion(velocity=(1, 0, 1))), True),
        (sheet(2.9 * D, moves=PartMotion(velocity=(1, 0.1, 1))), False),
        (sheet(2.9 * D, moves=PartMotion.model_validate({"rotation": {"axis": (0, 2, 0), "rate": 1}})), True),
        (sheet(2.9 * D, moves=PartMotion.model_validate({"rotation": {"axis": (1, 2, 0), "rate": 1}})), False),
    ],
)  # fmt: skip
def test_parts_keep_a_grain_length_from_periodic_sides_or_have_no_end(part, fits):
    wide = box(8 * D, parts=(part,))
    if fits:
        scene(wide)
    else:
        with pytest.raises(ValidationError, match=r"container\.parts.*periodic side"):
            scene(wide)


def test_a_turntable_is_refused():
    """The velocity of its surface jumps at the sides; that of a belt does not."""
    floor = Plane(point=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0))
    belt = Wall(name="floor", shape=floor, motion=SurfaceMotion(velocity=(0.0, 0.1, 0.0)))
    assert scene(box(parts=(belt,)))
    with pytest.raises(ValidationError, match="meets a periodic side"):
        scene(box(parts=(Wall(name="floor", shape=floor, motion=SurfaceMotion(spin=1.0)),)))


def test_clumps_are_refused():
    clumps = Clumps(diameter=D, centres=((0.0, 0.0, -D / 4), (0.0, 0.0, D / 4)), density=2500, count=50)
    with pytest.raises(ValidationError, match="clumps have no periodic sides"):
        scene(box(10 * D), clumps)


def test_one_convention_of_nearest_images():
    y = np.random.default_rng(1).uniform(-3, 3, 200)
    vectors = np.column_stack([y, y, y])
    images = nearest_images(vectors, 0.7)
    assert np.abs(images[:, 1]).max() <= 0.35
    assert np.array_equal(images[:, [0, 2]], vectors[:, [0, 2]])
    turns = (vectors[:, 1] - images[:, 1]) / 0.7
    assert turns == pytest.approx(np.round(turns), abs=1e-12)
    assert [nearest(value, 0.7) for value in y] == images[:, 1].tolist()
    assert image(vec3(1.0, 0.5, 2.0), 0.7) == vec3(1.0, 0.5 - 0.7, 2.0)
    assert nearest_images(vectors, math.inf) is vectors
    assert np.array_equal(nearest_images(-vectors, 0.7), -images), "forces are opposite to the bit"


def copies(x: np.ndarray, period: float) -> np.ndarray:
    return np.concatenate([x + np.array([0, k * period, 0]) for k in (-1, 0, 1)])


def test_a_tree_finds_the_neighbours_among_images():
    x = np.random.default_rng(2).uniform(-0.5, 0.5, (300, 3))
    x[0, 1], x[1, 1] = -0.5, 0.5
    expected = {
        tuple(sorted((i % 300, j % 300))) for i, j in KDTree(copies(x, 1.0)).query_pairs(0.1) if i % 300 != j % 300
    }
    assert tree(x, 1.0).query_pairs(0.1) == expected
    assert tree_places(np.array([[0.0, -1e-20, 0.0]]), 1.0)[0, 1] < 1.0


def test_images_of_what_reaches_across():
    x, rows = with_images(np.array([[0.0, 0.45, 1.0], [0.0, -0.3, 1.0], [0.0, -0.48, 1.0]]), 1.0, 0.1)
    assert rows.tolist() == [0, 1, 2, 0, 2]
    assert x[3:, 1] == pytest.approx([-0.55, 0.52])


GRAINS = [
    Spheres(diameter=D, density=2500, count=150),
    Spheres(diameter=D, density=2500, count=150, sizes=Uniform(smallest=0.5 * D)),
    Spherocylinders(diameter=D / 3, length=D, density=620, count=100),
]


@pytest.mark.parametrize("grains", GRAINS)
@pytest.mark.parametrize("start", ["gas", "dense"])
def test_a_start_fills_the_box_up_to_its_sides_and_no_image_overlaps(grains, start):
    packing = place(scene(grains=grains), start, 1)
    x, n = packing.x, len(packing)
    assert np.abs(x[:, 1]).max() <= PERIOD / 2
    assert np.abs(x[:, 1]).max() > PERIOD / 2 - 0.2 * D, "centres lie next to the sides"
    every = copies(x, PERIOD)
    i, j = KDTree(every).query_pairs(1.01 * D, output_type="ndarray").T
    branch = every[i] - every[j]
    if packing.q is None:
        radius = np.full(n, D / 2) if packing.diameter is None else packing.diameter / 2
        gap = np.linalg.norm(branch, axis=1) - radius[i % n] - radius[j % n]
    else:
        a = axes(packing.q)
        gap = distances(branch, a[i % n], a[j % n], grains.half_length) - grains.diameter
    across = (i // n) != (j // n)
    assert across.any()
    assert gap.min() >= 0


def test_the_packing_fraction_of_a_lattice_counts_what_reaches_across():
    n, cell = 4, 1.2 * D
    places = (np.stack(np.meshgrid(*[np.arange(n)] * 3, indexing="ij"), -1).reshape(-1, 3) + 0.1) * cell
    x = nearest_images(places, n * cell)
    rest = np.zeros_like(x)
    packing = Packing(x=x, v=rest, omega=rest)
    region = Region((0.6 * cell, -n * cell / 2, 0.6 * cell), (2.6 * cell, n * cell / 2, 2.6 * cell), False)
    fraction = packing_fraction(packing, Spheres(diameter=D, density=1, count=n**3), region, n * cell)
    assert fraction == pytest.approx(math.pi / 6 / 1.2**3, rel=1e-12)
