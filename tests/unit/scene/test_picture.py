"""Pictures of beds: what is where in them, what hides what, and which colours it has.

Places are checked to a pixel: edges are drawn by 3 x 3 or 2 x 2 finer pixels.
"""

import io
import math

import numpy as np
import pytest
from PIL import Image

from labbook import picture
from labbook.picture import Raster, bed, cut, layers, render
from labbook.scene import (
    Box,
    Clumps,
    Container,
    CylinderSilo,
    Grains,
    HertzMindlin,
    Kind,
    Packing,
    Primitives,
    Scene,
    Spheres,
    Spherocylinders,
    WedgeHopper,
)

D = 3e-3
LAW = HertzMindlin(shear_modulus=5e6, poisson_ratio=0.25, friction=0.5, restitution=0.2)
THIN = Box(width=0.039, depth=0.012, height=0.06)
ALONG_Z = (1.0, 0.0, 0.0, 0.0)


def scene(container: Container = THIN, grains: Grains | None = None) -> Scene:
    return Scene(grains=grains or Spheres(diameter=D, density=2500, count=13), contact=LAW, container=container)


def packing(*x, ids=None, **own) -> Packing:
    at = np.array(x, float).reshape(-1, 3)
    return Packing(x=at, v=0 * at, omega=0 * at, ids=None if ids is None else np.array(ids), **own)


def floor() -> Packing:
    """Thirteen grains beside one another on the floor of the box."""
    return packing(*((k * D, 0, D / 2) for k in range(-6, 7)))


def column(several=32) -> Packing:
    """Grains one above the other."""
    return packing(*((0, 0, (k + 0.5) * D) for k in range(several)))


def turned(*axis) -> np.ndarray:
    """The quaternion that takes the z axis to `axis`."""
    a = np.array(axis, float) / np.linalg.norm(axis)
    q = np.array([1 + a[2], -a[1], a[0], 0.0])
    return q / np.linalg.norm(q)


def pixel(view: Raster, x: float, z: float) -> tuple[int, int]:
    """Row and column of a place [m]."""
    return int((view.z - z) * view.scale + view.down / 2), int((x - view.x) * view.scale + view.across / 2)


def is_blue(colour) -> bool:
    return colour[2] > colour[0] + 20


def is_warm(colour) -> bool:
    return colour[0] > colour[2] + 20


@pytest.mark.parametrize(("x", "z"), [(-0.0113, 0.0107), (0, 0.0171), (0.0082, 0.0049)])
def test_a_sphere_is_where_it_stands_and_nowhere_else(x, z):
    start = packing(*floor().x, (0.018, 0, 0.03))
    seen = render(scene(), start, packing((x, 0, z), ids=[4]))[..., 3] / 255
    # by the walls alone: the side walls are 39 mm apart, half of each line is on either side of its wall
    top = seen[: seen.shape[0] // 8].mean(axis=0)
    columns, middle = np.arange(seen.shape[1]) + 0.5, seen.shape[1] / 2
    left, right = ((columns * side * top).sum() / (side * top).sum() for side in (columns < middle, columns > middle))
    low = seen[:, 4 : seen.shape[1] // 8].mean(axis=1)
    rows = np.arange(seen.shape[0]) + 0.5
    bottom = (rows * low).sum() / low.sum()
    scale = (right - left) / THIN.width
    away = np.hypot(columns - (left + right) / 2 - x * scale, (bottom - rows[:, None]) - z * scale)
    beside = (columns > left + 2) & (columns < right - 2) & (rows[:, None] < bottom - 2)
    assert (seen[away < D / 2 * scale - 1] == 1).all()
    assert (seen[beside & (away > D / 2 * scale + 1)] == 0).all()
    assert seen[beside].sum() == pytest.approx(math.pi / 4 * (D * scale) ** 2, rel=0.03)


def test_walls_are_the_section_of_the_container():
    hopper = WedgeHopper(width=0.04, height=0.3, thickness=1.01 * D, angle=math.radians(60), orifice=0.012)
    start = packing(*((x, 0, z) for x in (-0.018, 0, 0.018) for z in (0.02, 0.03, 0.04)))
    nothing = packing()
    view, seen = Raster.of(scene(hopper), start, nothing), render(scene(hopper), start, nothing)
    for x, z in ((-0.02, 0.03), (0.02, 0.03), (0.006, 0), (-0.013, 0.007 / math.tan(math.radians(60)))):
        assert seen[pixel(view, x, z)][3] > 100, (x, z)
        assert tuple(seen[pixel(view, x, z)][:3]) == picture.WALL
    for x, z in ((0, 0.001), (0.01, 0.02), (-0.01, -0.001), (0.015, 0.001)):
        assert seen[pixel(view, x, z)][3] == 0, (x, z)


def test_the_nearer_grain_hides_the_farther_one():
    start = column()
    layer = layers(scene(), start)
    blue, warm = int(np.flatnonzero(layer == 0)[0]), int(np.flatnonzero(layer == 1)[0])
    for near, far, told in ((blue, warm, is_blue), (warm, blue, is_warm)):
        for order in (slice(None), slice(None, None, -1)):
            rows = [((0, -0.002, 0.03), near), ((0.0005, 0.002, 0.0305), far)][order]
            now = packing(*(x for x, _ in rows), ids=[grain for _, grain in rows])
            view = Raster.of(scene(), start, now)
            assert told(render(scene(), start, now)[pixel(view, 0, 0.03)])


def test_of_crossing_rods_the_nearer_one_hides_the_farther_one():
    """Their centres say nothing of it: the rod in front has the farther centre, and leans towards the eye."""
    rods = Spherocylinders(diameter=D, length=6 * D, density=1000, count=40)
    z = np.linspace(0, 0.15, 40)
    start = packing(*((0, 0, h) for h in z), q=np.tile(ALONG_Z, (40, 1)))
    layer = layers(scene(THIN, rods), start)
    blue, warm = int(np.flatnonzero(layer == 0)[0]), int(np.flatnonzero(layer == 1)[0])
    for front, told in (((blue, warm), is_blue), ((warm, blue), is_warm)):
        # at x = 0.005 the leaning rod is at y = 0.004 - 0.005, a diameter and more before the upright one
        now = packing((0, 0.004, 0.05), (0.005, 0.0025, 0.05), ids=front, q=np.array([turned(1, -1, 0), ALONG_Z]))
        view = Raster.of(scene(THIN, rods), start, now)
        assert told(render(scene(THIN, rods), start, now)[pixel(view, 0.005, 0.05)])


def test_of_a_round_silo_the_half_behind_the_axis_is_seen():
    silo = scene(CylinderSilo(diameter=0.04, height=0.2, orifice=0.012))
    start = packing(*((x, y, z) for x in (-0.01, 0.01) for y in (-0.01, 0.01) for z in (0.002, 0.01)))
    assert cut(silo, start)
    nothing = render(silo, start, packing())
    before = render(silo, start, packing((0.01, -0.001, 0.01), (-0.01, -0.01, 0.01), ids=[0, 1]))
    assert (before == nothing).all()
    now = packing((0.01, 0.001, 0.01), ids=[0])
    behind = render(silo, start, now)
    place = pixel(Raster.of(silo, start, now), 0.01, 0.01)
    assert (behind[place][3], nothing[place][3]) == (255, 0)


def test_deep_boxes_are_cut_and_thin_ones_are_not():
    grid = packing(*((0, y * D, (z + 0.5) * D) for y in range(-4, 5) for z in range(4)))
    assert cut(scene(Box(width=0.03, depth=0.03, height=0.1)), grid)
    assert not cut(scene(), floor())
    assert not cut(scene(WedgeHopper(width=0.04, height=0.3, thickness=1.01 * D, orifice=0.01)), floor())


def test_what_is_farther_behind_the_cut_is_darker():
    silo = scene(CylinderSilo(diameter=0.04, height=0.2, orifice=0.012))
    start = packing(*((x, y, z) for x in (-0.01, 0.01) for y in (-0.01, 0.01) for z in (0.002, 0.01)))
    now = packing((-0.01, 0.002, 0.01), (0.01, 0.015, 0.01), ids=[0, 2])
    view, seen = Raster.of(silo, start, now), render(silo, start, now)
    near, far = (seen[pixel(view, x, 0.01)][:3].sum() for x in (-0.01, 0.01))
    assert far < 0.8 * near


@pytest.mark.parametrize("axis", [(0, 0, 1), (1, 0, 0), (0, 1, 0), (1, 0, 1), (-2, 1, 0.5), (0.2, 3, -0.4)])
def test_a_rod_covers_the_area_of_its_capsule(axis):
    """Seen from the front it is the disc of its end, moved along the axis as seen: 4 h r + pi r^2 with its half h."""
    rod = Spherocylinders(diameter=D, length=5 * D, density=1000, count=1)
    free = scene(Primitives(), rod)
    now = packing((0.1, 0, 0.3), q=np.array([turned(*axis)]))
    view, alpha = Raster.of(free, now, now), render(free, now, now)[..., 3] / 255
    a = np.array(axis) / np.linalg.norm(axis)
    half = rod.half_length * math.hypot(a[0], a[2])
    assert alpha.sum() / view.scale**2 == pytest.approx(4 * half * D / 2 + math.pi / 4 * D**2, rel=0.03)
    for part, covered in ((0.0, 1), (0.97, 1), (-0.97, 1), (1.04, 0), (-1.04, 0)):
        reach = part * (half + D / 2) / math.hypot(a[0], a[2]) if half > 1e-9 else part * D / 2
        ax, az = (a[0], a[2]) if half > 1e-9 else (1, 0)
        row, col = pixel(view, 0.1 + reach * ax, 0.3 + reach * az)
        inside = 0 <= row < view.down and 0 <= col < view.across
        assert (alpha[row, col] if inside else 0) == pytest.approx(covered, abs=0.5)


def test_a_clump_covers_the_area_of_all_its_spheres():
    """Two discs of diameter d whose centres are 0.6 d apart: 2 pi r^2 less their lens."""
    pair = Clumps(diameter=D, centres=((0.0, 0, -0.3 * D), (0.0, 0, 0.3 * D)), density=1000, count=1)
    free = scene(Primitives(), pair)
    r, apart = D / 2, 0.6 * D
    lens = 2 * r**2 * math.acos(apart / D) - apart / 2 * math.sqrt(4 * r**2 - apart**2)
    for axis, area in (((1, 0, 0), 2 * math.pi * r**2 - lens), ((0, 1, 0), math.pi * r**2)):
        now = packing((0.1, 0, 0.3), q=np.array([turned(*axis)]))
        view, alpha = Raster.of(free, now, now), render(free, now, now)[..., 3] / 255
        assert alpha.sum() / view.scale**2 == pytest.approx(area, rel=0.03)


def test_layers_are_equally_thick_and_neighbours_differ_in_colour():
    start = column()
    found = layers(scene(), start)
    assert list(found) == [k // 4 for k in range(32)], "32 grains high, at most 8 layers"
    assert list(layers(scene(), column(6))) == [0, 0, 1, 1, 2, 2], "and two grains at least"
    assert list(layers(scene(), column(1))) == [0]
    view, seen = Raster.of(scene(), start, start), render(scene(), start, start)
    rows = [(pixel(view, 0, (k + 0.9) * D)[0], pixel(view, 0, (k + 0.1) * D)[0] + 1) for k in range(32)]
    middle = pixel(view, 0, 0)[1]
    colours = [seen[top:bottom, middle, :3].mean(axis=0) for top, bottom in rows]
    for k in range(31):
        apart = np.abs(colours[k + 1] - colours[k]).sum()
        assert apart > 90 if found[k + 1] != found[k] else apart < 60, k
    assert [is_blue(colour) for colour in colours] == [layer % 2 == 0 for layer in found]


def test_grains_keep_the_colour_of_their_layer_wherever_they_go():
    start = column()
    now = packing((0, 0, 0.09), (0, 0, 0.03), ids=[0, 5])
    view, seen = Raster.of(scene(), start, now), render(scene(), start, now)
    assert is_blue(seen[pixel(view, 0, 0.09)])
    assert is_warm(seen[pixel(view, 0, 0.03)])


def test_kinds_have_their_own_colours_and_sizes():
    kinds = (Kind(name="large", share=0.5), Kind(name="small", share=0.5, diameter=D / 2))
    mixed = scene(THIN, Spheres(diameter=D, density=2500, count=12, kinds=kinds))
    kind = np.array([0, 1] * 6)
    x = [(k * D - 0.0165, 0, (k % 4 + 0.5) * 3 * D) for k in range(12)]
    start = packing(*x, kind=kind, diameter=np.where(kind == 0, D, D / 2))
    view, seen = Raster.of(mixed, start, start), render(mixed, start, start)
    for k, (across, _, up) in enumerate(x):
        colour = seen[pixel(view, across, up)]
        assert (is_warm if kind[k] == 0 else is_blue)(colour)
        beside = seen[pixel(view, across + 0.35 * D, up)]
        assert (beside[3] == 255) == (kind[k] == 0), "the small ones end at a quarter of d"


def crowd(seed: int, several: int, deep: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Places and orientations at random in the hopper of `hopper`."""
    rng = np.random.default_rng(seed)
    x = rng.uniform((-0.019, -deep, 0.002), (0.019, deep, 0.06), (several, 3)) * (1, D, 1)
    q = rng.normal(size=(several, 4))
    return x, q / np.linalg.norm(q, axis=1)[:, None]


@pytest.mark.parametrize("length", [1, 3])
def test_a_mirrored_bed_gives_the_mirrored_picture(length):
    grains = Spherocylinders(diameter=D, length=length * D, density=1000, count=150)
    hopper = scene(WedgeHopper(width=0.04, height=0.3, thickness=2 * D, orifice=0.012), grains)
    x, q = crowd(1, 150)
    start = packing(*x, q=q)
    one, other = render(hopper, start, start), render(hopper, start.mirrored(), start.mirrored())
    apart = np.abs(one.astype(int) - other[:, ::-1].astype(int)).max(axis=2)
    assert (one[..., 3] > 0).mean() > 0.3
    # rounding may give a fine pixel on the line between two grains to the other one
    assert (apart > 8).mean() < 0.005


def test_grains_are_left_out_only_if_others_hide_them(monkeypatch):
    """Grains behind others are sorted out in bulk; one by one, all are drawn."""
    deep = scene(
        Box(width=0.04, depth=0.06, height=0.1), Spherocylinders(diameter=D, length=2 * D, density=1, count=900)
    )
    x, q = crowd(2, 900, deep=10)
    start = packing(*x, q=q)
    monkeypatch.setattr(picture, "_CHUNK", 10**9)
    whole = render(deep, start, start)
    monkeypatch.setattr(picture, "_CHUNK", 5_000)
    assert (render(deep, start, start) == whole).all()


def test_below_the_outlet_a_little_is_shown_and_no_grain_in_part():
    hopper = scene(WedgeHopper(width=0.04, height=0.3, thickness=1.01 * D, orifice=0.012))
    start = packing(*((x * D, 0, (z + 0.5) * D) for x in range(-6, 7) for z in range(12)))
    for z in np.linspace(0.002, -0.02, 45):
        now = packing((0, 0, z), ids=[0])
        view, alpha = Raster.of(hopper, start, now), render(hopper, start, now)[..., 3] / 255
        row, col = pixel(view, 0, 0)
        seen = alpha[:, col - 20 : col + 20].sum() / view.scale**2
        whole = math.pi / 4 * D**2
        assert seen == pytest.approx(whole if z > -0.003 else 0 if z < -0.008 else seen, rel=0.05)
        assert seen == 0 or seen == pytest.approx(whole, rel=0.05)
    assert row < alpha.shape[0] - 10, "some room below the outlet"


def test_empty_height_above_the_bed_is_cropped():
    tall = scene(WedgeHopper(width=0.04, height=3, thickness=1.01 * D, orifice=0.012))
    start = packing(*((x * D, 0, (z + 0.5) * D) for x in range(-6, 7) for z in range(12)))
    view = Raster.of(tall, start, start)
    assert view.z + view.down / view.scale / 2 == pytest.approx(12 * D, abs=3 * D)
    assert max(view.down, view.across) == picture.SIZE


def test_a_png_is_small_indexed_and_transparent():
    start = packing(*((x * D, 0, (z + 0.5) * D) for x in range(-6, 7) for z in range(30)))
    hopper = scene(WedgeHopper(width=0.04, height=0.3, thickness=1.01 * D, orifice=0.012))
    stored = bed(hopper, start, start)
    assert stored == bed(hopper, start, start)
    assert len(stored) < 20_000
    image = Image.open(io.BytesIO(stored))
    assert (image.format, image.mode, max(image.size)) == ("PNG", "P", picture.SIZE)
    reduced, right = np.asarray(image.convert("RGBA")).astype(int), render(hopper, start, start).astype(int)
    assert reduced.shape == right.shape
    solid = right[..., 3] == 255
    # 256 colours stand for all colours and opacities: a few solid pixels share one with those of edges
    assert (reduced[solid][:, 3] == 255).mean() > 0.95
    assert reduced[solid][:, 3].min() > 180
    assert (reduced[right[..., 3] == 0][:, 3] == 0).all()
    assert np.abs(reduced - right)[solid].mean() < 8, "of 255 levels: 256 colours are enough"


def test_beds_of_other_grains_and_empty_ones_are_refused():
    with pytest.raises(ValueError, match="not those of the settled bed"):
        render(scene(), floor(), packing((0, 0, 0), ids=[77]))
    with pytest.raises(ValueError, match="has no grains"):
        render(scene(), packing(), packing())
    rods = scene(THIN, Spherocylinders(diameter=D, length=2 * D, density=1000, count=13))
    with pytest.raises(ValueError, match="no orientations"):
        render(rods, floor(), floor())


def test_free_grains_are_followed_within_reason():
    free = scene(Primitives())
    start = floor()
    now = packing(*(start.x + np.array([0.02, 0, 0.01])))
    view = Raster.of(free, start, now)
    assert view.x + view.across / view.scale / 2 > now.x[:, 0].max()
    gone = packing(*(start.x + np.array([1e3, 0, 0])))
    assert Raster.of(free, start, gone).across / Raster.of(free, start, gone).scale < 0.1


def test_an_outlet_far_below_leaves_the_bed_in_sight():
    view = Raster.of(scene(Primitives(outlet_plane=-10)), floor(), floor())
    assert view.across > picture.SIZE / 2
