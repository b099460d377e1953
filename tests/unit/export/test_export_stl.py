"""Walls as STL files: polygons in place of circles, with the sagitta that their files state."""

import math
from typing import Any

import numpy as np
import pytest

import labbook
from labbook.export.stl import extent_of, sagitta, wall_files, write_walls
from labbook.scene import (
    Box,
    ConicalSilo,
    CylinderSilo,
    LinearSpringDashpot,
    Plane,
    Primitives,
    Scene,
    Spheres,
    Wall,
    WedgeHopper,
)
from labbook.scene.geometry import Bounds

SILO = CylinderSilo(diameter=0.1, height=0.4, orifice=0.03)
BOX = Bounds((-0.05, -0.05, 0.0), (0.05, 0.05, 0.4))
STUDY: dict[str, Any] = {
    "name": "walls",
    "grains": {"shape": "sphere", "diameter": "3 mm", "density": "2500 kg/m^3", "count": 500},
    "contact": {"law": "linear", "normal_stiffness": "2000 N/m", "friction": 0.5, "restitution": 0.5},
}


def corners(text: str) -> np.ndarray:
    """Corners of the triangles of a file, shape [n, 3, 3]."""
    rows = [line.split()[1:] for line in text.splitlines() if line.startswith("vertex")]
    return np.array(rows, float).reshape(-1, 3, 3)


def area(triangles: np.ndarray) -> float:
    sides = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return float(np.linalg.norm(sides, axis=1).sum() / 2)


@pytest.mark.parametrize("facets", [3, 24, 1000])
def test_the_sagitta_is_how_far_the_polygon_lies_inside_the_circle(facets):
    text = wall_files(SILO, BOX, facets)["side"]
    triangles = corners(text)
    assert len(triangles) == 2 * facets
    middles = (triangles[:, [0, 1, 2]] + triangles[:, [1, 2, 0]]) / 2
    depth = 0.05 - np.hypot(middles[..., 0], middles[..., 1])
    assert depth.max() == pytest.approx(sagitta(0.05, facets), rel=1e-6)
    assert np.hypot(triangles[..., 0], triangles[..., 1]) == pytest.approx(0.05)
    stated = float(text.splitlines()[0].split("sagitta")[1].split()[0])
    assert stated == pytest.approx(0.05 * (1 - math.cos(math.pi / facets)), rel=5e-3)


def test_facets_of_a_silo_have_the_areas_of_their_polygons():
    files = wall_files(SILO, BOX, 24)
    polygon = 24 / 2 * math.sin(2 * math.pi / 24)  # of the unit circle
    assert area(corners(files["bottom"])) == pytest.approx(polygon * (0.05**2 - 0.015**2), rel=1e-12)
    assert area(corners(files["side"])) == pytest.approx(24 * 2 * 0.05 * math.sin(math.pi / 24) * 0.4, rel=1e-12)


def _study(container, **more):
    return labbook.define({**STUDY, "container": container, **more})


@pytest.mark.parametrize(
    ("container", "names"),
    [
        (
            {"kind": "cylinder-silo", "diameter": "0.1 m", "height": "0.4 m", "orifice": "30 mm"},
            {"side", "bottom", "closed-bottom"},
        ),
        (
            {"kind": "conical-silo", "diameter": "0.1 m", "height": "0.4 m", "orifice": "30 mm", "angle": "45 deg"},
            {"side", "bottom", "closed-lid"},
        ),
        (
            {"kind": "wedge-hopper", "width": "0.1 m", "height": "0.4 m", "thickness": "10 mm", "orifice": "30 mm"},
            {"front", "back", "left", "right", "bottom-left", "bottom-right", "closed-bottom"},
        ),
    ],
)
def test_every_container_is_written_open_and_closed(tmp_path, container, names):
    study = _study(container)
    paths = write_walls(study, tmp_path, 60)
    assert {path.name for path in paths} == {f"point-1-{name}.stl" for name in names}
    (point,) = study.points
    walls = {wall.name: wall for wall in point.scene.container.walls()}
    walls |= {f"closed-{wall.name}": wall for wall in point.scene.container.close().walls()}
    for path in paths:
        triangles = corners(path.read_text())
        assert np.isfinite(triangles).all()
        assert area(triangles) > 0
        away = np.abs(walls[path.stem.removeprefix("point-1-")].shape.distance(triangles.reshape(-1, 3)))
        assert away.max() < 1e-12
        box = point.scene.container.bounds
        assert (triangles >= np.array(box.low) - 1e-12).all()
        assert (triangles <= np.array(box.high) + 1e-12).all()


def test_points_that_share_a_container_share_the_files(tmp_path):
    container = {"kind": "cylinder-silo", "diameter": "0.1 m", "height": "0.4 m", "orifice": "30 mm"}
    sweep = {"container.orifice": "[30, 40] mm", "contact.friction": [0.3, 0.5]}
    paths = write_walls(_study(container, sweep=sweep), tmp_path)
    assert len({path.name.split("-")[1] for path in paths}) == 2
    assert len(paths) == 6


def test_containers_without_an_end_are_cut_beyond_the_bed():
    floor = Primitives(parts=(Wall(name="floor", shape=Plane(point=(0, 0, 0), normal=(0, 0, 1))),))
    grains = Spheres(diameter=3e-3, density=2500, count=500)
    scene = Scene(grains=grains, contact=LinearSpringDashpot(normal_stiffness=2000), container=floor)
    (text,) = wall_files(scene.container, extent_of(scene)).values()
    side = (500 * math.pi / 6 * 3e-3**3 / 0.5) ** (1 / 3)
    assert area(corners(text)) == pytest.approx((4 * side) ** 2)


def test_a_number_of_facets_out_of_range_is_refused(tmp_path):
    container = {"kind": "cylinder-silo", "diameter": "0.1 m", "height": "0.4 m", "orifice": "30 mm"}
    for facets in (2, 10_001):
        with pytest.raises(ValueError, match=f"facets: {facets} is not from 3 to 10000"):
            write_walls(_study(container), tmp_path, facets)


def test_walls_that_are_not_round_do_not_depend_on_facets():
    hopper = WedgeHopper(width=0.06, height=0.3, thickness=4e-3, angle=1.0, orifice=0.02)
    crate = Box(width=0.1, depth=0.1, height=0.1)
    for container in (hopper, crate):
        assert wall_files(container, BOX, 10) == wall_files(container, BOX, 20)
    cone = ConicalSilo(diameter=0.1, height=0.4, orifice=0.03, angle=1.0)
    assert wall_files(cone, BOX, 10) != wall_files(cone, BOX, 20)
