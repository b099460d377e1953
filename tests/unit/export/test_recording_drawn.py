"""What pictures of recordings show: every grain, in its place, size and colour, and a bottom that turns.

Grains stand apart, so that each is one patch of colour. The scale of colours is one more, wider than half the picture.
"""

from typing import NamedTuple

import numpy as np
import pytest
from scipy import ndimage

from labbook.backend.numerics import Numerics
from labbook.export.colour_bar import KIND_COLOURS
from labbook.export.entities import SPOKE_COLOUR
from labbook.export.recording import RecordedRun, write
from labbook.export.viewer import SIZE, screenshot
from labbook.measure import RunData
from labbook.scene import CylinderSilo, LinearSpringDashpot, Packing, Scene, Spherocylinders, WedgeHopper

pytest.importorskip("rerun")
pytestmark = pytest.mark.render

HOPPER = WedgeHopper(width=0.2, height=0.3, thickness=0.03, orifice=0.05)

_TABS = 28  # pixels: height of the row of tabs above a view


class Patch(NamedTuple):
    """A patch of colour: middle, width and height in pixels, z upwards; mean colour, its area."""

    x: float
    z: float
    width: int
    height: int
    colour: np.ndarray
    area: int


def shown(scene, table, path, at=0.0, start=None):
    """The picture of a recording of these frames, RGB bytes, without the line above it."""
    from matplotlib.image import imread

    if start is None:
        x = np.zeros((scene.grains.count, 3))
        start = Packing(x=x, v=x, omega=x)
    run = RunData(scene, Numerics(dt=1e-5), 1, start, "finished", float(np.max(table["time"])), {})
    write([RecordedRun.of(run, table, "a")], path / "a.rrd", "1" * 16, opens="speed")
    screenshot(path / "a.rrd", path / "a.png", at=at, size=(SIZE[0], SIZE[1] + _TABS))
    return np.round(imread(path / "a.png")[28:, :, :3] * 255).astype(int)


def labelled(drawn):
    """Numbers, from 1, of connected patches; 0 between them."""
    labels = np.zeros(drawn.shape, np.int32)
    ndimage.label(drawn, np.ones((3, 3)), output=labels)
    return labels


def patches(pixels, drawn):
    """Connected patches of the pixels `drawn`, the narrow ones."""
    labels = labelled(drawn)
    found = []
    for k, (rows, columns) in enumerate(ndimage.find_objects(labels), 1):
        mask = labels[rows, columns] == k
        width, height, area = columns.stop - columns.start, rows.stop - rows.start, int(mask.sum())
        if area < 30 or width > pixels.shape[1] / 2:
            continue
        colour = pixels[rows, columns][mask].mean(axis=0)
        found.append(
            Patch((columns.start + columns.stop) / 2, -(rows.start + rows.stop) / 2, width, height, colour, area)
        )
    return found


def coloured(pixels):
    """Where there is a colour: walls and background are grey."""
    return pixels.max(axis=2) - pixels.min(axis=2) > 30


def places(columns, rows):
    """Places [m], shape [n, 3], of a grid in the middle of the hopper."""
    x, z = np.meshgrid(np.linspace(-0.08, 0.08, columns), np.linspace(0.02, 0.14, rows))
    return np.stack([x.ravel(), np.zeros(x.size), z.ravel()], axis=1)


def frames(x, times, counts, **more):
    """Frames of grains at x, the first `counts` of them at each of the `times`; at rest but for what `more` says."""
    which = np.concatenate([np.arange(count) for count in counts])
    table = {"time": np.repeat(times, counts), "id": which, **{name: x[which, k] for k, name in enumerate("xyz")}}
    table |= {name: np.zeros(len(which)) for name in ("vx", "vy", "vz")}
    return table | {name: np.asarray(column)[which] for name, column in more.items()}


def in_place(found, x):
    """One patch for each grain, in their order: their middles are a linear image of the places, within two pixels."""
    order = np.lexsort((x[:, 0], np.round(x[:, 2], 6)))
    assert len(found) == len(x)
    found = sorted(found, key=lambda patch: (round(patch.z / 20), patch.x))
    for seen, place in (([p.x for p in found], x[order, 0]), ([p.z for p in found], x[order, 2])):
        assert np.abs(np.polyval(np.polyfit(place, seen, 1), place) - seen).max() < 2
    return [found[k] for k in np.argsort(order)]


@pytest.mark.parametrize(("at", "count"), [(0.0, 24), (1.0, 17)])
def test_every_rod_is_drawn_where_it_is_as_it_lies_and_as_fast_as_it_is(tmp_path, at, count):
    rods = Spherocylinders(diameter=3e-3, length=12e-3, density=620, count=24)
    scene = Scene(grains=rods, contact=LinearSpringDashpot(normal_stiffness=1.0), container=HOPPER)
    x, half = places(6, 4), np.sqrt(0.5)
    lying, fast = np.arange(24) % 2 == 1, np.arange(24) % 3 == 2
    q = np.where(lying[:, None], (half, 0, half, 0), (1, 0, 0, 0))
    table = frames(x, [0.0, 1.0], [24, 17], vx=0.3 * fast, **dict(zip(("qw", "qx", "qy", "qz"), q.T, strict=True)))
    pixels = shown(scene, table, tmp_path, at)
    found = in_place(patches(pixels, coloured(pixels)), x[:count])
    for patch, flat, quick in zip(found, lying, fast, strict=False):
        assert patch.height / patch.width == pytest.approx(0.25 if flat else 4.0, rel=0.12)  # d/L or L/d
        # Solid: of the box d L around a rod it fills all but corners, 1 - (1 - pi/4) d/L = 0.95 of it, less its rim.
        assert patch.area / (patch.height * patch.width) > 0.85
        red, _, blue = patch.colour
        assert (red > 2 * blue) if quick else (blue > red)  # yellow, or violet


def test_every_sphere_of_a_mixture_is_drawn_in_the_size_and_colour_of_its_kind(synthetic, tmp_path):
    grains = synthetic.scene(count=18).grains.model_validate(
        {
            "diameter": 6e-3,
            "density": 2500,
            "count": 18,
            "kinds": [
                {"name": "large", "share": 2 / 3},
                {"name": "small", "share": 1 / 3, "diameter": 4e-3, "density": 7800},
            ],
        }
    )
    scene = synthetic.scene().model_copy(update={"grains": grains, "container": HOPPER})
    x, kind = places(6, 3), (np.arange(18) % 3 == 1).astype(int)  # every third is small
    start = Packing(x=x, v=0 * x, omega=0 * x, diameter=np.where(kind, 4e-3, 6e-3), kind=kind)
    pixels = shown(scene, frames(x, [0.0, 1.0], [18, 18]), tmp_path, start=start)
    found = in_place(patches(pixels, coloured(pixels)), x)
    widths = np.array([patch.width for patch in found])
    assert widths[kind == 0].mean() / widths[kind == 1].mean() == pytest.approx(1.5, rel=0.05)
    hues = KIND_COLOURS[:2] / KIND_COLOURS[:2].sum(axis=1)[:, None]
    for patch, which in zip(found, kind, strict=True):
        hue = patch.colour / patch.colour.sum()
        assert np.abs(hues - hue).sum(axis=1).argmin() == which


def test_a_turning_bottom_is_seen_to_turn(tmp_path):
    """Of its eight spokes one has a colour. It starts at the right in front, 45 degrees from the line of sight; after a
    sixteenth of a turn to the left it is farther right, at sin(67.5 deg) of the radius, not at sin(45 deg)."""
    rods = Spherocylinders(diameter=6e-3, length=20e-3, density=620, count=1)
    silo = CylinderSilo(diameter=0.19, height=0.5, orifice=0.06, rotation=0.25)
    scene = Scene(grains=rods, contact=LinearSpringDashpot(normal_stiffness=1.0), container=silo)
    q = {"qw": np.ones(1), "qx": np.zeros(1), "qy": np.zeros(1), "qz": np.zeros(1)}
    table = frames(np.array([[0, 0, 0.15]]), [0.0, 0.25], [1, 1], **q)
    spokes, dark = [], []
    for at in (0.0, 1.0):
        pixels = shown(scene, table, tmp_path, at)
        red, green, blue = np.moveaxis(pixels, 2, 0)  # of a spoke behind glass, or at its rim, mixed with grey
        (spoke,) = patches(pixels, (red > blue + 60) & (red > green + 40))
        assert np.abs(spoke.colour - SPOKE_COLOUR).max() < 90
        spokes.append(spoke)
        dark.append((pixels.max(axis=2) < 110) & (pixels.max(axis=2) - pixels.min(axis=2) < 40))
    middle = pixels.shape[1] / 2
    right = [spoke.x - middle + spoke.width / 2 for spoke in spokes]  # of its outer end
    # What is nearer is drawn larger: the end moves away from the eye, by less than a tenth of its distance.
    assert right[1] / right[0] == pytest.approx(np.sin(np.radians(67.5)) / np.sin(np.radians(45)), rel=0.12)
    assert spokes[1].z > spokes[0].z + 10  # seen from above, farther back is higher up
    moved = (dark[0] ^ dark[1]).sum() / dark[0].sum()
    assert moved > 0.1


def test_a_picture_has_views_and_their_scale_and_nothing_of_the_window(synthetic, tmp_path):
    from matplotlib.image import imread

    scene = synthetic.scene()
    run = synthetic.observe(scene, seed=1, recorded=True)
    write([RecordedRun.of(run, run.tables["sample"], "a")], tmp_path / "a.rrd", "1" * 16, opens="speed")
    screenshot(tmp_path / "a.rrd", tmp_path / "a.png", at=0.0)
    pixels = np.round(imread(tmp_path / "a.png")[..., :3] * 255).astype(int)
    labels = labelled(coloured(pixels))
    wide = [found for found in ndimage.find_objects(labels) if found[1].stop - found[1].start > pixels.shape[1] / 2]
    heights = sorted(rows.stop - rows.start for rows, _ in wide)
    # The scale, the line of W(t), the bed of grains.
    assert len(wide) == 3
    assert 5 < heights[0] < 30
    # The window's bars are at most (13, 13, 13), its notices (33, 33, 33). Only W(t) is on such black, below all else.
    black = (pixels.max(axis=2) <= 40).mean(axis=1)
    assert black[: int(0.8 * len(black))].max() < 0.1
    orange = (np.abs(pixels - (255, 122, 26)).sum(axis=2) < 60).sum()  # "Software rasterizer"
    assert orange == 0
