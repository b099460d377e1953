"""Grains are placed in a hopper of triangles, and do not leak over its rim in the eyes of `leak`."""

import math

import numpy as np
import pytest

from labbook.filling.leaks import leak
from labbook.filling.placing import place
from labbook.scene import Frustum, LinearSpringDashpot, Primitives, Scene, Spheres, TriangleMesh, Wall
from labbook.scene.triangles import Triangles

D, RADIUS, SIDES = 4e-3, 12e-3, 8


def tube() -> TriangleMesh:
    """An upright tube of eight sides, open above and below."""
    angles = 2 * math.pi * np.arange(SIDES) / SIDES
    ends = np.array([(RADIUS * math.cos(t), RADIUS * math.sin(t), z) for t in angles for z in (0.0, 60e-3)])
    pairs = [(2 * k, 2 * ((k + 1) % SIDES)) for k in range(SIDES)]
    sides = np.array([t for a, b in pairs for t in ((a, b, b + 1), (a, b + 1, a + 1))])
    return TriangleMesh.of_surface(Triangles.welded(ends, sides)[0])


def scene(lid: float) -> Scene:
    plate = Wall(name="lid", opens="start", shape=Frustum(lower=(0.0, 0.0), upper=(lid, 0.0)))
    container = Primitives(outlet_plane=0.0, parts=(Wall(name="tube", shape=tube()), plate))
    law = LinearSpringDashpot(normal_stiffness=1e3)
    return Scene(grains=Spheres(diameter=D, density=2500, count=30), contact=law, container=container).close()


def test_grains_start_within_a_tube_of_triangles():
    start = place(scene(RADIUS), "gas", 1)
    apothem = RADIUS * math.cos(math.pi / SIDES)
    directions = 2 * math.pi * (np.arange(SIDES) + 0.5) / SIDES
    outward = np.column_stack([np.cos(directions), np.sin(directions)])
    assert len(start.x) == 30
    assert (start.x[:, :2] @ outward.T).max() <= apothem - D / 2 + 1e-12
    assert start.x[:, 2].min() >= D / 2


@pytest.mark.slow
def test_a_way_over_the_rim_is_no_leak_and_a_hole_is_one():
    closed = leak(scene(RADIUS))
    assert closed is None or not closed.certain
    hole = leak(scene(RADIUS / 4))
    assert hole is not None
    assert math.hypot(*hole.at[:2]) < RADIUS
