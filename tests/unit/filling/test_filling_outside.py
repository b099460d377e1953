"""Walls of another package, of which only the distance is known, are filled, drawn and recorded without a change."""

import math
import re

import numpy as np
import pytest

from labbook import picture
from labbook.export.wall_shapes import TRANSPARENT_COLOUR, WALL_COLOUR, drawn_walls
from labbook.filling import PlacingError
from labbook.filling.bed import outside_container
from labbook.filling.leaks import leak
from labbook.filling.placing import place
from labbook.filling.room import Room
from labbook.scene import HertzMindlin, Plane, Primitives, Scene, Spheres, Wall
from labbook.scene.walls import AT_REST, WallShape

D, R, LENGTH = 3e-3, 12e-3, 0.2


class Tube(WallShape):
    """An upright tube with two round ends that holds grains inside."""

    physics = "elsewhere"
    kind: str = "tube"

    def distance(self, x: np.ndarray) -> np.ndarray:
        axis = np.clip(x[:, 2], R, R + LENGTH)
        return R - np.linalg.norm(x - np.stack([0 * axis, 0 * axis, axis], axis=1), axis=1)


class Ball(WallShape):
    """A ball in the way of grains."""

    physics = "elsewhere"
    kind: str = "ball"

    def distance(self, x: np.ndarray) -> np.ndarray:
        return np.linalg.norm(x - (0, 0, R), axis=1) - R / 2


def wall(shape: WallShape) -> Wall:
    return Wall.of(name=shape.kind, shape=shape, motion=AT_REST, opens=None, moves=None)


def scene(*parts: Wall, count=300, **more) -> Scene:
    law = HertzMindlin(shear_modulus=1e7, poisson_ratio=0.25)
    fields = {"closed": False, "sink": None, "planes": (), "outlet_plane": None, **more}
    container = Primitives.of(kind="primitives", parts=parts, **fields)
    grains = Spheres(diameter=D, density=2500, count=count)
    return Scene.of(grains=grains, contact=law, container=container, walls={}, gravity=9.81, feed=None)


def sides() -> tuple[Wall, ...]:
    planes = {"left": (1, 0), "right": (-1, 0), "front": (0, 1), "back": (0, -1)}
    return tuple(
        Wall(name=name, shape=Plane(point=(-2 * R * nx, -2 * R * ny, 0), normal=(nx, ny, 0)))
        for name, (nx, ny) in planes.items()
    )


def floor(z=0.0) -> Wall:
    return Wall(name="floor", shape=Plane(point=(0, 0, z), normal=(0, 0, 1)))


TUBE, BALL = wall(Tube.of(kind="tube")), wall(Ball.of(kind="ball"))


@pytest.mark.slow
@pytest.mark.parametrize("count", [40, 300])
def test_a_vessel_is_filled(count):
    closed = scene(TUBE, count=count).close()
    start = place(closed, "rain", 1)
    assert len(start) == count
    assert (TUBE.shape.distance(start.x) >= D / 2).all()
    assert not outside_container(closed, start).any()
    assert start.x[:, 2].min() < 3 * R, "from the bottom on"


@pytest.mark.slow
def test_the_volume_of_a_vessel_is_counted_in_space():
    """24 x 24 columns over a circle: the share of those that count is off by less than the part on its edge, 4 %."""
    room = Room(scene(TUBE).close().container, D / 2)
    volume = 2 / 3 * math.pi * R**3 + math.pi * R**2 * 5 * R
    assert room._volume_below(6 * R) == pytest.approx(volume, rel=0.04)
    assert room.x == pytest.approx((D / 2 - R, R - D / 2), abs=1e-7)


def test_an_obstacle_keeps_grains_off_and_holds_none_in():
    closed = scene(*sides(), floor(), BALL).close()
    start = place(closed, "gas", 1)
    assert (BALL.shape.distance(start.x) >= D / 2).all()
    with pytest.raises(PlacingError, match="no walls across x"):
        place(scene(floor(), BALL).close(), "gas", 1)
    with pytest.raises(PlacingError, match="no bottom"):
        place(scene(*sides(), BALL).close(), "gas", 1)


@pytest.mark.slow
def test_grains_leave_past_an_obstacle_and_not_from_a_vessel():
    tray = scene(*sides(), floor(-2 * R), BALL, outlet_plane=-R).close()
    found = leak(tray)
    assert found is not None
    assert found.certain
    assert leak(scene(TUBE, outlet_plane=-R).close()) is None


@pytest.mark.slow
def test_it_is_drawn():
    """The tube is as wide as its picture, and its outline a line of many parts."""
    drawing = scene(TUBE).svg()
    ends = np.array(re.findall(r'<line x1="([\d.]+)" y1="([\d.]+)" x2="([\d.]+)"', drawing), float)
    assert len(ends) > 50
    assert np.ptp(ends[:, 0]) / np.ptp(ends[:, 1]) == pytest.approx(2 * R / (2 * R + LENGTH), rel=0.02)
    start = place(scene(TUBE).close(), "rain", 1)
    start = type(start)(x=start.x, v=start.v, omega=start.omega, ids=np.arange(len(start)))
    pixels = picture.render(scene(TUBE), start, start, 200)
    walls = (pixels[..., :3] == picture.WALL).all(axis=2) & (pixels[..., 3] > 0)
    assert walls[len(pixels) // 2].any(), "both sides are seen"
    assert np.flatnonzero(walls.any(axis=0)).min() < 5


def test_it_is_recorded_as_the_mesh_that_follows_from_its_distance():
    grains = np.array([[0, 0, R], [0, 0, 3 * R]])
    drawn = {one.name: one for one in drawn_walls(scene(*sides(), floor(), BALL, TUBE), grains)}
    assert set(drawn) == {"left", "right", "front", "back", "floor", "ball", "tube"}
    for one in (BALL, TUBE):
        mesh = drawn[one.name].mesh
        assert np.abs(one.shape.distance(mesh.vertices)).max() < 1e-8
    a, b, c = (drawn["ball"].mesh.vertices[drawn["ball"].mesh.triangles[:, k]] for k in range(3))
    assert np.abs((a * np.cross(b, c)).sum()) > 0
    ball = drawn["ball"].mesh.vertices
    assert np.ptp(ball, axis=0) == pytest.approx((R, R, R), rel=0.01)
    top = drawn["tube"].mesh.vertices[:, 2].max()
    assert top < 3 * R + 4 * D, "cut a little above the grains"
    assert (drawn["ball"].colour, drawn["floor"].colour) == (WALL_COLOUR, TRANSPARENT_COLOUR)
