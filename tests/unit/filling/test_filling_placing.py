"""Where grains start, and what becomes of their friction springs when the outlet opens."""

import math

import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.stats import kstest

from labbook.filling import PlacingError, place, start_of_discharge
from labbook.filling.placing import no_room
from labbook.filling.room import JAMMED, Room
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

D = 3e-3


def hopper(angle=90.0, orifice=0.03, gap=None, count=3000, **changes) -> Scene:
    container = WedgeHopper(
        width=0.1, height=0.9, thickness=1.01 * D, angle=math.radians(angle), orifice=orifice, gap=gap
    )
    return scene(container, count, **changes)


def scene(container, count=3000, **changes) -> Scene:
    contact = HertzMindlin(shear_modulus=1e8, poisson_ratio=0.25)
    grains = Spheres(diameter=D, density=2500, count=count)
    return Scene(**{"grains": grains, "contact": contact, "container": container, **changes})


def distance(x, start, end):
    """Of points in the x-z plane from a segment."""
    start, end = np.array(start), np.array(end)
    along = end - start
    t = np.clip((x - start) @ along / (along @ along), 0, 1)
    return np.linalg.norm(x - start - t[:, None] * along, axis=1)


@pytest.mark.parametrize("kind", ["gas", "rain", pytest.param("dense", marks=pytest.mark.slow)])
@pytest.mark.parametrize(("angle", "gap"), [(90, None), (90, 0.0), (55, None), (55, 0.0), (15, None)])
def test_grains_start_inside_and_touch_nothing(kind, angle, gap):
    closed = hopper(angle, gap=gap).close()
    x = place(closed, kind, 1).x
    assert x.shape == (3000, 3)
    assert KDTree(x).query(x, k=2)[0][:, 1].min() >= D
    assert np.abs(x[:, 0]).max() <= 0.05 - D / 2
    assert np.abs(x[:, 1]).max() <= 0.505 * D - D / 2
    for wall in closed.container.walls():
        for start, end in wall.shape.section():
            assert distance(x[:, [0, 2]], start, end).min() >= D / 2, wall.name
    floor = np.full(len(x), -np.inf)
    for wall in closed.container.walls():
        for (x0, z0), (x1, z1) in wall.shape.section():
            over = (x[:, 0] >= min(x0, x1)) & (x[:, 0] <= max(x0, x1)) & (x0 != x1)
            floor[over] = z0 + (z1 - z0) * (x[over, 0] - x0) / (x1 - x0)
    assert np.all(x[:, 2] > floor), "above the bottom, not behind it"


@pytest.mark.parametrize("sizes", [None, Uniform(smallest=0.5 * D)])
@pytest.mark.parametrize(
    "container",
    [
        WedgeHopper(width=0.1, height=0.9, thickness=1.01 * D, angle=1.0, orifice=0.03),
        WedgeHopper(width=0.1, height=0.9, thickness=1.9 * D, orifice=0.03),
        Box(width=0.1, depth=1.5 * D, height=0.9),
    ],
)
def test_a_planar_start_is_a_rain_in_the_middle_plane(container, sizes):
    """Nothing has a part across it, and the layer is as dense whatever the thickness: 3/2 of 0.12 by area."""
    closed = scene(container, 500, grains=Spheres(diameter=D, density=2500, count=500, sizes=sizes)).close()
    packing = place(closed, "planar", 1)
    x, reach = packing.x, packing.diameter if packing.diameter is not None else np.full(500, D)
    assert not np.any(x[:, 1])
    assert not np.any(packing.v[:, 1])
    assert np.all(packing.v[:, [0, 2]].std(axis=0) == pytest.approx(0.1 * math.sqrt(9.81 * D), rel=0.1))
    i, j = np.triu_indices(500, 1)
    assert np.all(np.linalg.norm(x[i] - x[j], axis=1) > (reach[i] + reach[j]) / 2)
    area = np.pi / 4 * closed.grains.mean_cube / D * 500 / (0.1 * np.ptp(x[:, 2]))  # pyright: ignore[reportAttributeAccessIssue]
    assert 0.15 < area < 0.25


def test_a_planar_start_needs_one_layer_between_two_walls():
    flat = WedgeHopper(width=0.1, height=0.9, thickness=2.1 * D, orifice=0.03)
    rods = Spherocylinders(diameter=D, length=2 * D, density=2500, count=50)
    for closed, message in (
        (scene(flat).close(), r"container.thickness: .* room for more \(2.1 d\); make it less than 2 d"),
        (scene(CylinderSilo(diameter=0.1, height=0.9, orifice=0.03)).close(), "needs a front and a back wall"),
        (hopper(grains=rods).close(), "takes spheres"),
    ):
        with pytest.raises(PlacingError, match=message):
            place(closed, "planar", 1)


def test_a_seed_gives_the_same_start_and_another_seed_another():
    closed = hopper(count=500).close()
    one, same, other = (place(closed, "gas", seed) for seed in (1, 1, 2))
    assert np.array_equal(one.x, same.x)
    assert np.array_equal(one.v, same.v)
    assert not np.any(np.isclose(one.x, other.x, rtol=0, atol=1e-12).all(axis=1))


def test_the_start_is_random_in_all_directions():
    """No lattice: x and z modulo any spacing near d, and y, are uniform."""
    closed = hopper(count=3000).close()
    x = place(closed, "gas", 3).x
    depth = 0.005 * D
    assert kstest((x[:, 1] + depth) / (2 * depth), "uniform").pvalue > 1e-3
    for spacing in np.linspace(1.0, 2.0, 21) * D:
        for axis in (0, 2):
            phase = np.exp(2j * np.pi * x[:, axis] / spacing).mean()
            assert abs(phase) < 5 / math.sqrt(len(x)), (axis, spacing / D)


def test_a_gas_moves_with_the_stated_speed():
    v = place(hopper().close(), "gas", 1).v
    asked = math.sqrt(9.81 * D)
    assert v.std(axis=0) == pytest.approx([asked] * 3, rel=0.06)
    assert np.abs(v.mean(axis=0)).max() < 5 * asked / math.sqrt(3000)


@pytest.mark.parametrize(("kind", "density"), [("gas", 0.25), ("rain", 0.12)])
@pytest.mark.parametrize("container", [Box(width=0.05, depth=0.04, height=0.1), None])
def test_the_column_is_as_dense_as_stated(kind, density, container):
    closed = (scene(container) if container else hopper(30)).close()
    x = place(closed, kind, 1).x
    volume = 3000 * math.pi / 6 * D**3
    if container:
        room = 0.05 * 0.04 * x[:, 2].max()
    else:
        rise = 0.035 / math.tan(math.radians(30))
        room = 1.01 * D * (0.1 * x[:, 2].max() - 0.035 * rise)
    assert volume / room == pytest.approx(density, rel=0.1)


def test_what_cannot_be_filled_says_why():
    with pytest.raises(PlacingError, match="gravity"):
        place(hopper(gravity=0.0).close(), "gas", 1)
    with pytest.raises(PlacingError, match="walls across x"):
        place(scene(Primitives()), "gas", 1)


def springs(packing: Packing) -> dict[str, list[int]]:
    found: dict[str, list[int]] = {}
    for name, grain in zip(packing.wall_name, packing.wall_grain, strict=True):
        found.setdefault(str(name), []).append(int(grain))
    return found


def resting(xs, names, z=D / 2) -> Packing:
    n = len(xs)
    zs = np.broadcast_to(z, n)
    x = np.column_stack([xs, np.zeros(n), zs])
    spring = np.arange(3 * n, dtype=float).reshape(n, 3) * 1e-9
    zero = np.zeros((n, 3))
    return Packing(
        x=x, v=zero, omega=zero, wall_grain=np.arange(n), wall_name=np.array(names, "U40"), wall_spring=spring
    )


def test_a_flat_bottom_hands_its_springs_to_the_plate_that_is_left_under_the_grain():
    open_ = hopper(orifice=0.03)
    packing = resting([-0.04, -0.0151, -0.0149, 0.0, 0.0149, 0.0151, 0.04], ["bottom"] * 7)
    start = start_of_discharge(packing, open_.close(), open_)
    assert springs(start) == {"bottom-left": [0, 1], "bottom-right": [5, 6]}
    assert np.array_equal(start.wall_spring, packing.wall_spring[[0, 1, 5, 6]])
    assert np.array_equal(start.x, packing.x)


def test_an_outlet_at_the_wall_leaves_no_left_plate():
    open_ = hopper(orifice=0.03, gap=0.0)
    packing = resting([-0.04, 0.0, 0.04], ["bottom", "bottom", "left"])
    assert springs(start_of_discharge(packing, open_.close(), open_)) == {"bottom-right": [1], "left": [2]}


def test_walls_that_stay_keep_their_springs_and_the_lid_loses_them():
    open_ = hopper(55, orifice=0.03)
    packing = resting([-0.04, 0.0, 0.04, 0.0], ["bottom-left", "lid", "right", "front"])
    assert springs(start_of_discharge(packing, open_.close(), open_)) == {
        "bottom-left": [0],
        "right": [2],
        "front": [3],
    }


def funnel(width, count, d=1.0) -> Scene:
    """A wide cone of 24.2 deg above a hole of 4 m, with grains of 1 m."""
    cone = ConicalSilo(diameter=width, height=60, angle=math.radians(24.2), orifice=4)
    return scene(cone, count, grains=Spheres(diameter=d, density=1, count=count))


def level_in(cone: ConicalSilo, volume: float) -> float:
    """Height below which the cone holds a volume: pi ((r + s z)^3 - r^3) / (3 s), s = tan(angle)."""
    r, s = cone.orifice / 2, math.tan(cone.angle)
    return ((3 * s * volume / math.pi + r**3) ** (1 / 3) - r) / s


@pytest.mark.parametrize(("width", "count"), [(40, 500), (40, 2000)])
@pytest.mark.parametrize("sizes", [None, Uniform(smallest=0.5)])
def test_a_low_bed_in_a_wide_cone_is_placed_where_its_volume_is(width, count, sizes):
    """The tip of a cone holds little: rain has a solid fraction of 0.12 by volume of the room for centres, which begins
    half a grain from walls."""
    closed = funnel(width, count)
    closed = closed.model_copy(update={"grains": closed.grains.model_copy(update={"sizes": sizes})}).close()
    packing = place(closed, "rain", 1)
    assert len(packing.x) == count
    assert closed.container.inside(packing.x).all()
    assert isinstance(closed.container, ConicalSilo)
    cube = 1.0 if sizes is None else (1 - 0.5**4) / (4 * 0.5)  # mean of d^3 between d/2 and d
    level = level_in(closed.container, count * math.pi / 6 * cube / 0.12)
    assert level < packing.x[:, 2].max() < level + 4.5, "a grain from the walls: 0.5/sin(24.2 deg), then both ends"
    d = np.ones(count) if packing.diameter is None else packing.diameter
    i, j = KDTree(packing.x).query_pairs(1.0, output_type="ndarray").T
    assert (np.linalg.norm(packing.x[i] - packing.x[j], axis=1) >= (d[i] + d[j]) / 2).all()


def test_a_start_that_found_room_before_is_where_it_was():
    """Positions of a narrower cone, which the quicker estimate of the height fits, are part of the keys of packings."""
    room = Room(funnel(12, 2000).close().container, 0.5)
    volume = 2000 * math.pi / 6 / 0.12
    assert next(room.tops(volume, 0.12 * volume, JAMMED)) == room.height_for(volume)


@pytest.mark.parametrize("angle", [5, 20, 60])
@pytest.mark.parametrize("count", [1, 30])
def test_few_grains_in_a_v_of_two_strips(angle, count):
    """A grain touches both plates at the height r/sin(angle)."""
    a = math.radians(angle)
    high = 0.2
    ends = [(sign * high * math.tan(a), high) for sign in (-1, 1)]
    parts = [Wall(name=f"plate-{k}", shape=Strip(start=(0, 0), end=end)) for k, end in enumerate(ends)]
    for name, side in (("front", -1), ("back", 1)):
        shape = Plane(point=(0, side * 0.505 * D, 0), normal=(0, -side, 0))
        parts.append(Wall(name=name, shape=shape))
    x = place(scene(Primitives(parts=tuple(parts)), count).close(), "rain", 1).x
    assert len(x) == count
    assert (x[:, 2] >= D / 2 / math.sin(a)).all()


def test_grains_that_find_no_room_are_told_which_key_makes_it():
    roof = Plane(point=(0, 0, 5 * D), normal=(0, 0, -1))
    box = (*Box(width=5 * D, depth=5 * D, height=1).walls(), Wall(name="roof", shape=roof))
    with pytest.raises(PlacingError, match=r"only (\d+) of 300 .* use grains.count: \1 or fewer, or widen container"):
        place(scene(Primitives(parts=box), 300).close(), "rain", 1)
    rods = Spherocylinders(diameter=D, length=10 * D, density=2500, count=20)
    thin = WedgeHopper(width=0.1, height=0.9, thickness=1.01 * D, orifice=0.03)
    told = str(no_room(scene(thin, grains=rods).close(), 0, 0.1))
    assert "0 of 20 grains" in told
    assert "widen container.thickness (3.03 mm) to 30 mm, the length of a rod" in told


def test_what_a_part_that_opens_lets_out_starts_empty():
    """An hourglass: grains start above the lid at its neck, and none below its upper plates."""
    parts = (
        Wall(name="side", shape=Frustum(lower=(0.03, 0.02), upper=(0.03, 0.3))),
        Wall(name="cone", shape=Frustum(lower=(0.008, 0.0), upper=(0.03, 0.02))),
        Wall(name="lid", shape=Frustum(lower=(0.0, 0.0), upper=(0.008, 0.0)), opens="start"),
        Wall(name="bin", shape=Frustum(lower=(0.03, -0.1), upper=(0.03, -0.005))),
        Wall(name="floor", shape=Frustum(lower=(0.0, -0.1), upper=(0.03, -0.1))),
    )
    x = place(scene(Primitives(parts=parts, outlet_plane=-0.02), 400).close(), "rain", 1).x
    off = np.hypot(x[:, 0], x[:, 1])
    assert (x[:, 2] > np.maximum(0, (off - 0.008) / 0.022 * 0.02)).all()
