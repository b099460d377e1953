"""The picture of a container of single walls: its sides, its sizes, and grains where there is room for them."""

import re

import numpy as np

from labbook.scene import Frustum, HertzMindlin, Plane, Primitives, Scene, Spheres, Strip, TriangleMesh, Wall
from labbook.scene.triangles import Triangles

D = 3e-3


def scene(*parts, count=300, outlet=None) -> Scene:
    grains = Spheres(diameter=D, density=2500, count=count)
    law = HertzMindlin(shear_modulus=1e7, poisson_ratio=0.25)
    return Scene(grains=grains, contact=law, container=Primitives(parts=parts, outlet_plane=outlet))


def slot():
    sides = (("y", -0.5, 1), ("y", 0.5, -1), ("x", -12, 1), ("x", 12, -1))
    for k, (axis, at, sense) in enumerate(sides):
        x, y = axis == "x", axis == "y"
        shape = Plane(point=(x * at * D, y * at * D, 0), normal=(x * sense, y * sense, 0))
        yield Wall(name=f"side-{k}", shape=shape)
    yield Wall(name="a", shape=Strip(start=(-12 * D, 0), end=(-4 * D, 0)))
    yield Wall(name="lid", shape=Strip(start=(-4 * D, 0), end=(4 * D, 0)), opens="start")
    yield Wall(name="b", shape=Strip(start=(4 * D, 0), end=(12 * D, 0)))
    yield Wall(name="roof", shape=Strip(start=(-3 * D, 5 * D), end=(3 * D, 5 * D)))


def places(picture: str) -> np.ndarray:
    """Of the grains, in pixels, by the moves of their strokes."""
    return np.array([[float(x), float(y)] for x, y in re.findall(r"M([\d.-]+) ([\d.-]+)h0", picture)])


def lines(picture: str) -> list[list[float]]:
    found = re.findall(r'<line x1="([\d.-]+)" y1="([\d.-]+)" x2="([\d.-]+)" y2="([\d.-]+)"', picture)
    return [[float(value) for value in one] for one in found]


def test_upright_planes_are_its_sides_and_grains_stand_between_them():
    picture = scene(*slot(), outlet=0.0).svg()
    drawn, seen = lines(picture), places(picture)
    upright = sorted({one[0] for one in drawn if one[0] == one[2]})
    assert len(upright) == 2
    assert len(seen) > 200
    left, right = upright
    assert ((seen[:, 0] > left) & (seen[:, 0] < right)).all()
    scale = (right - left) / (24 * D)
    foot = max(one[1] for one in drawn)
    bed = 300 * np.pi / 6 * D**3 / 0.58 / (24 * D * D)
    assert abs(foot - seen[:, 1].min() - scale * bed) < 4 * D * scale, "within the roof's height and a row"
    under = (np.abs(seen[:, 0] - (left + right) / 2) < 2.5 * D * scale) & (seen[:, 1] > foot - 5 * D * scale)
    assert not under.any(), "under the roof"
    assert "72 mm wide" in picture
    assert "300 grains" in picture


def test_round_parts_hold_grains_above_the_cone_only():
    parts = (
        Wall(name="side", shape=Frustum(lower=(0.03, 0.03), upper=(0.03, 0.1))),
        Wall(name="cone", shape=Frustum(lower=(0.006, 0.0), upper=(0.03, 0.03))),
        Wall(name="lid", shape=Frustum(lower=(0.0, 0.0), upper=(0.006, 0.0)), opens="start"),
    )
    picture = scene(*parts, count=500, outlet=0.0).svg()
    seen, drawn = places(picture), np.array(lines(picture))
    scale = (drawn[:, [0, 2]].max() - drawn[:, [0, 2]].min()) / 0.06
    x = (seen[:, 0] - drawn[:, [0, 2]].mean()) / scale
    z = (drawn[:, [1, 3]].max() - seen[:, 1]) / scale
    assert (z > (np.abs(x) - 0.006) * 0.03 / 0.024).all()
    assert 20 < len(seen) < 250, "a section shows a part of 500 grains"


def test_a_lying_vessel_of_triangles_has_grains_at_its_lower_side():
    angles, half = 2 * np.pi * np.arange(24) / 24, 3 * D
    ring = np.array([(12 * D * np.cos(t), y, 12 * D * np.sin(t)) for t in angles for y in (-half, half)])
    middle = np.array([[0.0, -half, 0.0], [0.0, half, 0.0]])
    pairs = [(2 * k, 2 * ((k + 1) % 24)) for k in range(24)]
    triangles = [t for a, b in pairs for t in ((a, b, b + 1), (a, b + 1, a + 1), (b, a, 48), (a + 1, b + 1, 49))]
    surface, _ = Triangles.welded(np.concatenate([ring, middle]), np.array(triangles))
    drum = Wall(name="drum", shape=TriangleMesh.of_surface(surface, encloses=True))
    picture = scene(drum, count=300).svg()
    seen, drawn = places(picture), np.array(lines(picture))
    scale = (drawn[:, [0, 2]].max() - drawn[:, [0, 2]].min()) / (24 * D)
    x, z = (seen - [drawn[:, [0, 2]].mean(), drawn[:, [1, 3]].mean()]).T / scale
    assert len(seen) > 30
    assert (np.hypot(x, z) < 12 * D).all()
    assert (z > 0).mean() > 0.9, "pixels count downwards"


def test_walls_that_enclose_nothing_are_no_picture():
    assert scene().svg() == ""
    assert scene(Wall(name="floor", shape=Plane(point=(0, 0, 0), normal=(0, 0, 1)))).svg() == ""
