"""A dense start: grains pushed apart until none touches another one."""

import math

import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.spatial.distance import pdist

from labbook.filling import PlacingError, place, room
from labbook.filling.placing import STARTS
from labbook.scene import (
    Box,
    ConicalSilo,
    CylinderSilo,
    Frustum,
    HertzMindlin,
    Packing,
    Plane,
    Primitives,
    Scene,
    Spheres,
    Spherocylinders,
    Strip,
    Uniform,
    Wall,
    WedgeHopper,
)
from labbook.scene.grains import Kind

D = 3e-3


def scene(container, count=300, **grains) -> Scene:
    contact = HertzMindlin(shear_modulus=1e8, poisson_ratio=0.25)
    return Scene(grains=Spheres(diameter=D, density=2500, count=count, **grains), contact=contact, container=container)


def radii(packing: Packing) -> np.ndarray:
    return (np.full(len(packing), D) if packing.diameter is None else packing.diameter) / 2


def gaps(packing: Packing) -> np.ndarray:
    """Of all pairs [m]."""
    i, j = np.triu_indices(len(packing), 1)
    r = radii(packing)
    return pdist(packing.x) - r[i] - r[j]


BOX = Box(width=20 * D, depth=20 * D, height=1.0)
STEEP = WedgeHopper(width=15 * D, height=1.0, thickness=4 * D, angle=math.radians(20), orifice=5 * D)


@pytest.mark.parametrize("count", [1, 2, 40, 400])
@pytest.mark.parametrize(
    "container",
    [BOX, STEEP, CylinderSilo(diameter=8 * D, height=1.0, orifice=4 * D), Box(width=9 * D, depth=1.01 * D, height=1.0)],
)
def test_few_and_many_grains_touch_nothing(container, count):
    """The smallest bed is one grain, and the narrowest box as deep as it, but for a hundredth."""
    closed = scene(container, count).close()
    packing = place(closed, "dense", 1)
    assert len(packing) == count
    assert gaps(packing).min(initial=1.0) >= 0
    assert closed.container.inside(packing.x).all()
    for wall in closed.container.walls():
        assert wall.shape.distance(packing.x).min() >= D / 2, wall.name
    assert not np.any(packing.v)
    assert not np.any(packing.omega)


@pytest.mark.parametrize(
    "grains",
    [
        {"sizes": Uniform(smallest=0.3 * D)},
        {"kinds": (Kind(name="large", share=0.3), Kind(name="small", share=0.7, diameter=0.25 * D))},
    ],
)
def test_grains_of_several_sizes_touch_nothing(grains):
    """Each keeps its own distance from walls and others: small ones come nearer to a wall than large ones fit."""
    closed = scene(STEEP, 600, **grains).close()
    packing = place(closed, "dense", 1)
    assert gaps(packing).min() >= 0
    nearest = np.min([wall.shape.distance(packing.x) for wall in closed.container.walls()], axis=0)
    assert np.all(nearest >= radii(packing))
    assert nearest.min() < 0.45 * D


def test_a_seed_decides_the_start_whatever_was_placed_before():
    closed = scene(STEEP).close()
    first, other = place(closed, "dense", 1), place(closed, "dense", 2)
    room._GRID_RESULTS.clear()
    assert np.array_equal(place(closed, "dense", 1).x, first.x)
    assert not np.isclose(first.x, other.x, rtol=0, atol=1e-6).all(axis=1).any()


def test_the_start_is_nearly_as_dense_as_a_bed():
    """Grains of friction 0.5 settle to a solid fraction of 0.55 to 0.6 far from walls (random loose to random close
    packing: Onoda & Liniger, Phys. Rev. Lett. 64 (1990) 2727). A start below 0.55 has to fall, one above stays."""
    packing = place(scene(BOX, 5000).close(), "dense", 1)
    inner = np.abs(packing.x[:, :2]).max(axis=1) < 7 * D
    low, high = 3 * D, 12 * D
    within = inner & (packing.x[:, 2] > low) & (packing.x[:, 2] < high)
    fraction = within.sum() * math.pi / 6 * D**3 / ((14 * D) ** 2 * (high - low))
    assert 0.52 < fraction < 0.56


def test_no_lattice_is_left_in_the_start():
    """Close-packed lattices have second neighbours at sqrt(2) d, six of them in a shell that holds none of the others;
    random packings have a minimum there (Finney, Proc. R. Soc. A 319 (1970) 479). And no plane is preferred."""
    x = place(scene(BOX, 5000).close(), "dense", 2).x
    inner = x[(np.abs(x[:, :2]).max(axis=1) < 7 * D) & (x[:, 2] > 3 * D) & (x[:, 2] < 11 * D)]
    tree, width = KDTree(x), 0.05 * D
    counts = [tree.query_ball_point(inner, math.sqrt(2) * D + s * width, return_length=True) for s in (-1, 1)]
    density = 0.54 / (math.pi / 6 * D**3)
    uniform = density * 4 * math.pi * 2 * D**2 * 2 * width
    assert np.mean(counts[1] - counts[0]) < uniform
    for spacing in np.linspace(0.7, 1.1, 9) * D:
        for axis in range(3):
            phase = np.exp(2j * np.pi * inner[:, axis] / spacing).mean()
            assert abs(phase) < 5 / math.sqrt(len(inner)), (axis, spacing / D)


def test_rods_lie_in_a_layer_as_thin_as_they_are():
    grains = Spherocylinders(diameter=D, length=3 * D, density=2500, count=60)
    container = WedgeHopper(width=20 * D, height=1.0, thickness=1.1 * D, orifice=6 * D)
    closed = Scene(grains=grains, contact=scene(BOX).contact, container=container).close()
    packing = place(closed, "dense", 1)
    assert packing.q is not None
    assert np.linalg.norm(packing.q, axis=1) == pytest.approx(1, abs=1e-12)
    assert np.abs(packing.x[:, 1]).max() <= 0.05 * D


def test_grains_start_above_a_part_that_opens():
    parts = (
        Wall(name="side", shape=Frustum(lower=(0.03, 0.02), upper=(0.03, 0.3))),
        Wall(name="cone", shape=Frustum(lower=(0.008, 0.0), upper=(0.03, 0.02))),
        Wall(name="lid", shape=Frustum(lower=(0.0, 0.0), upper=(0.008, 0.0)), opens="start"),
        Wall(name="bin", shape=Frustum(lower=(0.03, -0.1), upper=(0.03, -0.005))),
        Wall(name="floor", shape=Frustum(lower=(0.0, -0.1), upper=(0.03, -0.1))),
    )
    packing = place(scene(Primitives(parts=parts, outlet_plane=-0.02), 1000).close(), "dense", 1)
    off = np.hypot(packing.x[:, 0], packing.x[:, 1])
    assert (packing.x[:, 2] > np.maximum(0, (off - 0.008) / 0.022 * 0.02)).all()
    assert gaps(packing).min() >= 0


@pytest.mark.parametrize("angle", [5, 60])
def test_grains_in_a_v_of_two_strips(angle):
    """A grain touches both plates at the height r/sin(angle)."""
    a, high = math.radians(angle), 0.2
    ends = [(sign * high * math.tan(a), high) for sign in (-1, 1)]
    parts = [Wall(name=f"plate-{k}", shape=Strip(start=(0, 0), end=end)) for k, end in enumerate(ends)]
    for name, side in (("front", -1), ("back", 1)):
        parts.append(Wall(name=name, shape=Plane(point=(0, side * 2 * D, 0), normal=(0, -side, 0))))
    x = place(scene(Primitives(parts=tuple(parts)), 30).close(), "dense", 1).x
    assert (x[:, 2] >= D / 2 / math.sin(a)).all()


def test_more_grains_than_there_is_room_for_are_refused():
    """A closed box of 5 d holds 176 spheres even in the closest packing, pi/sqrt(18), without walls' effects."""
    roof = Plane(point=(0, 0, 5 * D), normal=(0, 0, -1))
    parts = (*Box(width=5 * D, depth=5 * D, height=1).walls(), Wall(name="roof", shape=roof))
    assert len(place(scene(Primitives(parts=parts), 80).close(), "dense", 1)) == 80
    for count in (180, 300):
        with pytest.raises(PlacingError, match=r"grains.count: only .* widen container"):
            place(scene(Primitives(parts=parts), count).close(), "dense", 1)


def test_a_dense_start_has_to_rest_less_and_falls_less():
    dense, rain = STARTS["dense"], STARTS["rain"]
    assert dense.settled_below > rain.settled_below
    closed = scene(ConicalSilo(diameter=8 * D, height=1.0, angle=0.6, orifice=4 * D)).close()
    assert dense.drop * dense.volume(closed) < 0.1 * rain.drop * rain.volume(closed)
