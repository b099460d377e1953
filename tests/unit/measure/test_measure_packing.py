import math

import numpy as np
import pytest

from labbook.backend.numerics import Numerics
from labbook.measure import MEASURES, MeasureError, RunData
from labbook.measure.order import hexatic
from labbook.measure.packing import area_fraction, packing_fraction
from labbook.measure.region import Annulus, Region, bulk
from labbook.scene import (
    Box,
    Clumps,
    ConicalSilo,
    CylinderSilo,
    HertzMindlin,
    Primitives,
    Scene,
    Spheres,
    Spherocylinders,
    WedgeHopper,
)
from labbook.scene.orientation import random_turns
from labbook.scene.packing import Packing

D = 3e-3
LAW = HertzMindlin(shear_modulus=1e8, poisson_ratio=0.25)


class Window:
    start, end, timed = 0.15, 0.6, False


def packing_of(x):
    x = np.asarray(x, float).reshape(-1, 3)
    return Packing(x, np.zeros_like(x), np.zeros_like(x))


def scene_of(container, count=1000):
    return Scene(grains=Spheres(diameter=D, density=2500, count=count), contact=LAW, container=container)


def hexagonal_layer(columns, rows):
    """Touching spheres in rows along x, between x = -columns d/2 and columns d/2, bottom at z = 0."""
    i, k = np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij")
    x = (i + 0.25 + 0.5 * (k % 2) - columns / 2) * D
    z = (0.5 + k * math.sqrt(3) / 2) * D
    return packing_of(np.column_stack([x.ravel(), np.zeros(x.size), z.ravel()]))


def run_of(scene, packing):
    return RunData(scene, Numerics(dt=1e-6), 1, packing, "finished", 1.0)


def numbers(scene, packing):
    return {m.quantity: m for m in MEASURES["packing"].evaluate(run_of(scene, packing), Window()).numbers}


HOPPER = WedgeHopper(width=0.1, height=0.4, thickness=1.01 * D, orifice=0.03)


def test_a_hexagonal_layer_is_exact_over_whole_periods():
    layer = hexagonal_layer(40, 40)
    period = math.sqrt(3) * D
    region = Region((-10 * D, -0.505 * D, 5 * period), (10 * D, 0.505 * D, 15 * period), True)
    flat, solid = (
        area_fraction(layer, D, region),
        packing_fraction(layer, Spheres(diameter=D, density=1000, count=1600), region),
    )
    assert flat == pytest.approx(math.pi / (2 * math.sqrt(3)), rel=1e-12)
    assert solid == pytest.approx(math.pi / (2 * math.sqrt(3)) / (1.5 * 1.01), rel=1e-4)
    assert solid == pytest.approx(0.599, abs=1e-3)
    assert flat / solid == pytest.approx(1.515, rel=1e-4)


@pytest.mark.parametrize("container", [HOPPER, Box(width=0.1, depth=1.01 * D, height=0.2)])
def test_a_hexagonal_layer_measured(container):
    found = numbers(scene_of(container), hexagonal_layer(33, 40))
    assert found["packing_fraction"].value == pytest.approx(0.599, abs=0.006)
    assert found["packing_fraction_2d"].value == pytest.approx(0.9069, abs=0.01)
    assert found["hexatic_local"].value == pytest.approx(1, abs=1e-9)
    assert found["hexatic_global"].value == pytest.approx(1, abs=1e-9)
    assert found["packing_fraction"].error < 0.01
    assert all(m.unit == "" and "bulk" in m.window for m in found.values())


def test_a_dilute_layer_gives_its_density():
    rng = np.random.default_rng(0)
    x = np.column_stack([rng.uniform(-0.05, 0.05, 1500), np.zeros(1500), rng.uniform(0, 0.2, 1500)])
    found = numbers(scene_of(HOPPER), packing_of(x))["packing_fraction_2d"]
    expected = 1500 * math.pi * D**2 / 4 / (0.1 * 0.2)
    assert abs(found.value - expected) < 5 * found.error
    assert found.error < 0.05 * expected


def test_a_deep_box_has_a_packing_fraction_only():
    side = np.arange(-9.5, 10) * D
    grid = np.stack(np.meshgrid(side, side, side + 10 * D, indexing="ij"), axis=-1)
    found = numbers(scene_of(Box(width=20 * D, depth=20 * D, height=1.0)), packing_of(grid))
    assert set(found) == {"packing_fraction"}
    assert found["packing_fraction"].value == pytest.approx(math.pi / 6, rel=2e-4)  # simple cubic


def test_the_bulk_keeps_away_from_an_inclined_bottom():
    hopper = WedgeHopper(width=0.1, height=0.4, thickness=1.01 * D, orifice=0.03, angle=math.radians(30))
    region = bulk(scene_of(hopper), hexagonal_layer(33, 100))
    assert isinstance(region, Region)
    assert region.low[2] == pytest.approx(0.035 / math.tan(math.radians(30)) + 3 * D)
    assert region.low[0] == pytest.approx(-0.05 + 3 * D)


def test_the_bulk_keeps_below_the_lowest_part_of_the_surface():
    layer = hexagonal_layer(33, 60).x
    heap = layer[layer[:, 2] < 0.1 - np.abs(layer[:, 0])]
    region = bulk(scene_of(HOPPER), packing_of(heap))
    assert isinstance(region, Region)
    assert 0.05 - 5 * D < region.high[2] < 0.06 - 3 * D


@pytest.mark.parametrize("grains", [np.zeros((0, 3)), hexagonal_layer(33, 6).x])
def test_too_few_grains_give_no_number_and_say_so(grains):
    found = numbers(scene_of(HOPPER), packing_of(grains))
    assert len(found) == 4
    assert all(math.isnan(m.value) and "use more grains" in m.note for m in found.values())


CYLINDER = CylinderSilo(diameter=30 * D, height=1.0, orifice=10 * D)
CONE = ConicalSilo(diameter=30 * D, height=1.0, orifice=10 * D, angle=math.radians(45))


def cubic(spacing, half=16, top=50) -> np.ndarray:
    """A simple cubic lattice of grains about the axis [n, 3], from z = 0 to `top` spacings."""
    side = (np.arange(-half, half) + 0.5) * spacing
    grid = np.stack(np.meshgrid(side, side, (np.arange(top) + 0.5) * spacing, indexing="ij"), axis=-1).reshape(-1, 3)
    return grid


@pytest.mark.parametrize("silo", [CYLINDER, CONE])
def test_a_lattice_in_a_round_silo(silo):
    """pi/6 of simple cubic; the edge of a circle 24 d wide crosses cells of the lattice at random, and what is lost is
    that of some 75 of 450 cells a layer, each known to a third: 0.3 %."""
    x = cubic(D)
    found = numbers(scene_of(silo), packing_of(x[np.hypot(x[:, 0], x[:, 1]) < 14.5 * D]))
    assert set(found) == {"packing_fraction"}
    assert found["packing_fraction"].value == pytest.approx(math.pi / 6, rel=3e-3)
    assert "r = 0 to 36 mm" in found["packing_fraction"].window


def test_the_bulk_of_a_cone_is_above_it():
    x = cubic(D)
    region = bulk(scene_of(CONE), packing_of(x[np.hypot(x[:, 0], x[:, 1]) < 14.5 * D]))
    assert isinstance(region, Annulus)
    assert (region.inner, region.outer) == (0, pytest.approx(12 * D))
    assert region.low == pytest.approx(10 * D + 3 * D)  # (30 - 10)/2 d at 45 deg, and 3 d
    assert region.high == pytest.approx(50 * D - 3 * D)


def test_a_mixture_in_a_round_silo_has_the_fraction_of_its_volumes():
    """A lattice of large and small spheres in turn, column by column."""
    x = cubic(D)
    x = x[np.hypot(x[:, 0], x[:, 1]) < 14.5 * D]
    odd = (np.round(x / D - 0.5).astype(int).sum(axis=1) % 2).astype(bool)
    diameter = np.where(odd, D / 2, D)
    grains = Packing(x, np.zeros_like(x), np.zeros_like(x), diameter=diameter)
    found = numbers(scene_of(CYLINDER), grains)["packing_fraction"].value
    assert found == pytest.approx(math.pi / 6 * (1 + 1 / 8) / 2, rel=4e-3)


def rods_on_a_lattice(axis, spacing, x):
    """Rods of d = 3 mm and L = 6 mm along `axis` at x."""
    turn = {"z": (1.0, 0, 0, 0), "x": (math.sqrt(0.5), 0, math.sqrt(0.5), 0)}[axis]
    return Packing(x, np.zeros_like(x), np.zeros_like(x), q=np.tile(turn, (len(x), 1)))


def test_clumps_at_random_have_the_fraction_of_their_number():
    """5000 clumps anywhere and in any direction: within 5 standard errors; one that is whole in a box is exact."""
    rng, n = np.random.default_rng(9), 5000
    grains = Clumps(
        diameter=D, centres=((0.0, 0, 0), (0.0, 0, D / 2), (D / 3, 0, 0)), diameters=(D, 0.8 * D, 0.7 * D),
        density=2500, count=n,
    )  # fmt: skip
    x = rng.uniform([-0.045, -0.045, 0], [0.045, 0.045, 0.6], (n, 3))
    clumps = Packing(x, np.zeros_like(x), np.zeros_like(x), q=random_turns(rng, n))
    expected = n * grains.volume / (0.09 * 0.09 * 0.6)
    for container in (CYLINDER, Box(width=0.09, depth=0.09, height=1.0)):
        found = numbers(Scene(grains=grains, contact=LAW, container=container), clumps)["packing_fraction"]
        assert abs(found.value - expected) < 5 * found.error
        assert found.error < 0.04 * expected
    one = Packing(np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 3)), q=random_turns(rng, 1))
    box = Region((-2 * D, -2 * D, -2 * D), (2 * D, 2 * D, 2 * D), False)
    assert packing_fraction(one, grains, box) == pytest.approx(grains.volume / (4 * D) ** 3, rel=1e-6)


@pytest.mark.parametrize("axis", ["x", "z"])
@pytest.mark.parametrize("container", [CYLINDER, Box(width=30 * D, depth=30 * D, height=1.0)])
def test_rods_count_with_their_whole_volume(axis, container):
    """Rods of L = 2 d on a cubic lattice 2.2 d wide; as spheres of d they would count 2/5 of their volume."""
    x = cubic(2.2 * D, half=8, top=22)
    x = x[(np.abs(x[:, :2]) < 14 * D).all(axis=1)]
    if container is CYLINDER:
        x = x[np.hypot(x[:, 0], x[:, 1]) < 13.9 * D]
    grains = Spherocylinders(diameter=D, length=2 * D, density=2500, count=len(x))
    scene = Scene(grains=grains, contact=LAW, container=container)
    found = numbers(scene, rods_on_a_lattice(axis, 2.2 * D, x))
    assert set(found) == {"packing_fraction"}
    # the bulk is no whole number of cells: 24 d of 2.2 d, so that a face is off by up to half a cell in eleven
    assert found["packing_fraction"].value == pytest.approx(grains.volume / (2.2 * D) ** 3, rel=0.05)


def test_rods_at_random_have_the_fraction_of_their_number():
    """20 000 rods in 0.09 m x 0.09 m x 0.6 m, anywhere and in any direction: within 5 standard errors."""
    rng = np.random.default_rng(7)
    n = 20_000
    x = rng.uniform([-0.045, -0.045, 0], [0.045, 0.045, 0.6], (n, 3))
    q = rng.standard_normal((n, 4))
    rods = Packing(x, np.zeros_like(x), np.zeros_like(x), q=q / np.linalg.norm(q, axis=1)[:, None])
    grains = Spherocylinders(diameter=D, length=3 * D, density=2500, count=n)
    expected = n * grains.volume / (0.09 * 0.09 * 0.6)
    for container in (CYLINDER, Box(width=0.09, depth=0.09, height=1.0)):
        found = numbers(Scene(grains=grains, contact=LAW, container=container), rods)["packing_fraction"]
        assert abs(found.value - expected) < 5 * found.error
        assert found.error < 0.02 * expected


def test_a_layer_of_rods_has_no_order_of_discs():
    layer = hexagonal_layer(33, 40)
    rods = rods_on_a_lattice("x", D, layer.x)
    grains = Spherocylinders(diameter=D, length=1.5 * D, density=2500, count=len(layer))
    assert set(numbers(Scene(grains=grains, contact=LAW, container=HOPPER), rods)) == {"packing_fraction"}


def test_a_narrow_silo_says_that_its_bulk_is_too_small():
    narrow = CylinderSilo(diameter=9 * D, height=1.0, orifice=5 * D)
    (found,) = numbers(scene_of(narrow), packing_of(cubic(D, half=4))).values()
    assert math.isnan(found.value)
    assert "smaller than 4 d" in found.note
    assert found.window.endswith("mm")


@pytest.mark.parametrize(
    "container",
    [
        CylinderSilo(diameter=20 * D, height=1.0, orifice=5 * D),
        CylinderSilo(diameter=5 * D, height=1.0, orifice=2 * D),
        WedgeHopper(width=20 * D, height=0.4, thickness=1.01 * D, orifice=5 * D),
        WedgeHopper(width=5 * D, height=0.4, thickness=1.01 * D, orifice=2 * D),
    ],
)
def test_a_bed_without_a_bulk_has_no_range_that_ends_before_it_begins(container):
    found = numbers(scene_of(container), packing_of([[0.0, 0.0, D / 2], [D, 0.0, D / 2]]))["packing_fraction"]
    assert math.isnan(found.value)
    assert found.window == "bulk, 3 d from walls, bottom and surface: nothing is left"


def test_quantities_are_those_that_are_measured():
    for scene in (scene_of(HOPPER), scene_of(CYLINDER), scene_of(Box(width=0.1, depth=0.1, height=1))):
        found = numbers(scene, packing_of(cubic(D)))
        stated = {one.name: one.unit for one in MEASURES["packing"].quantities(scene)}
        assert stated == {name: m.unit for name, m in found.items()}


def test_unknown_walls_are_refused():
    with pytest.raises(MeasureError, match="container of the kind primitives; use a hopper"):
        numbers(scene_of(Primitives()), hexagonal_layer(10, 10))


def test_packing_needs_no_probes():
    assert MEASURES["packing"].probes(scene_of(HOPPER), Numerics(dt=1e-6)) == ()


def test_hexatic_of_random_points():
    rng = np.random.default_rng(1)
    x, z = rng.uniform(0, 1, (2, 20_000))
    inside = (abs(x - 0.5) < 0.45) & (abs(z - 0.5) < 0.45)
    psi = hexatic(x, z)[inside]
    # Six random directions alone would give sqrt(pi)/(2 sqrt(6)) = 0.362; neighbours avoid each other a little.
    assert np.mean(abs(psi)) == pytest.approx(0.37, abs=0.02)
    assert abs(psi.mean()) < 0.02


def test_hexatic_turns_with_the_layer():
    layer = hexagonal_layer(20, 20).x
    c, s = math.cos(0.2), math.sin(0.2)
    x, z = c * layer[:, 0] - s * layer[:, 2], s * layer[:, 0] + c * layer[:, 2]
    middle = np.hypot(x - x.mean(), z - z.mean()) < 5 * D
    np.testing.assert_allclose(hexatic(x, z)[middle], np.exp(6j * 0.2), atol=1e-9)


def test_two_crystals_are_ordered_locally_only():
    layer = hexagonal_layer(30, 30).x
    a = layer[:, [0, 2]] - layer[:, [0, 2]].mean(axis=0)
    turn = math.radians(30)
    b = a @ np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    points = np.concatenate([a[a[:, 0] < -0.5 * D], b[b[:, 0] > 0.5 * D]])
    psi = hexatic(*points.T)
    middle = np.hypot(*points.T) < 9 * D
    assert np.mean(abs(psi[middle])) > 0.85
    assert abs(psi[middle].mean()) < 0.1


@pytest.mark.parametrize("n", [0, 1, 3])
def test_hexatic_of_almost_nothing_is_nan(n):
    assert np.isnan(hexatic(np.arange(n), np.arange(n) ** 2)).all()


def test_hexatic_of_a_line_is_nan():
    assert np.isnan(hexatic(np.arange(9.0), np.zeros(9))).all()
