"""Forces of walls on grains against statics: a sphere on a plane, in a V, on a belt, a rod, and a packing at rest."""

import math
from dataclasses import replace

import numpy as np
import pytest
from labbook_dem.plain_walls import at_rest
from labbook_reference import Backend

from labbook.backend.probes import Traction
from labbook.checks.verify.materials import D, G, hertz, linear, scene
from labbook.checks.verify.platform import MemberStart, Platform, grains_at
from labbook.scene import (
    CylinderSilo,
    Plane,
    Primitives,
    Spheres,
    Spherocylinders,
    SurfaceMotion,
    Wall,
    WedgeHopper,
)
from labbook.scene.wall_bins import all_walls, areas, bins_of_walls

PLATFORM = Platform(Backend())
PROBE = Traction(size=2 * D)
DT = 1e-5
RESTS = 1e-6
"""Relative difference from rest after the damped fall of DROP."""
DROP = 1e-6


def walls(*normals, **motion) -> Primitives:
    """Planes through the origin with these normals."""
    shapes = [Plane(point=(0.0, 0.0, 0.0), normal=normal) for normal in normals]
    still = SurfaceMotion(**motion)
    return Primitives(parts=tuple(Wall(name=f"w{k}", shape=shape, motion=still) for k, shape in enumerate(shapes)))


def last(here, start, beats: int = 4, steps: int = 500):
    """Rows of the last frame by wall."""
    rows = PLATFORM.run(MemberStart(here, DT, start), beats, steps, [PROBE]).rows(PROBE)
    return {name: np.bincount(rows["wall"], rows[name] * (rows["step"] == rows["step"].max())) for name in rows}


@pytest.mark.parametrize(("left", "right"), [(45.0, 45.0), (20.0, 70.0)])
def test_a_sphere_in_a_v_presses_as_statics_says(left, right):
    """Planes at these angles from the vertical, no friction: N_1 cos l = N_2 cos r, N_1 sin l + N_2 sin r = m g."""
    l, r = math.radians(left), math.radians(right)
    law = linear(friction=0.0)
    here = scene(1, law, walls((math.cos(l), 0.0, math.sin(l)), (-math.cos(r), 0.0, math.sin(r))), G)
    normals = np.array([[math.cos(l), math.sin(l)], [-math.cos(r), math.sin(r)]])
    weight = here.grains.mass * G
    expected = np.linalg.solve(normals.T, [0.0, weight])
    x, z = np.linalg.solve(normals, D / 2 - expected / law.normal_stiffness)
    rows = last(here, grains_at([x, 0.0, z + DROP * D]))
    assert rows["normal"] == pytest.approx(expected, rel=RESTS)
    assert rows["fz"].sum() == pytest.approx(weight, rel=RESTS)
    assert np.abs([rows["along"], rows["across"]]).max() < 1e-6 * weight
    assert not rows["sliding"].any()
    # forces act at the contact points, in line with the centre
    assert rows["ty"].sum() == pytest.approx(-x * weight, abs=1e-6 * weight * D)


@pytest.mark.parametrize("law", [linear, hertz])
def test_a_sphere_on_a_belt_slides_at_the_coulomb_limit(law):
    """On a belt inclined by 30 degrees that runs up: f_t = mu f_n up the wall, f_n = m g cos 30."""
    tilt = math.radians(30)
    up = (math.cos(tilt), 0.0, math.sin(tilt))
    container = walls((-math.sin(tilt), 0.0, math.cos(tilt)), velocity=tuple(20 * part for part in up))
    here = scene(1, law(friction=0.3, rolling_friction=0.0), container, G)
    normal = np.array([-math.sin(tilt), 0.0, math.cos(tilt)])
    rows = last(here, grains_at(normal * D / 2), beats=6)
    pressed = here.grains.mass * G * math.cos(tilt)
    assert rows["normal"] == pytest.approx([pressed], rel=1e-3)
    assert rows["along"] == pytest.approx(0.3 * rows["normal"], rel=1e-6)
    assert rows["across"] == pytest.approx([0.0], abs=1e-6 * pressed)
    assert rows["sliding"] == [1]


def test_a_rod_that_lies_flat_has_two_contacts_that_carry_it():
    rod = Spherocylinders(diameter=D, length=3 * D, density=2500, count=1)
    here = scene(1, linear(friction=0.0), walls((0.0, 0.0, 1.0)), G).model_copy(update={"grains": rod})
    flat = np.array([[math.cos(math.pi / 4), 0.0, math.sin(math.pi / 4), 0.0]])  # along x
    rows = last(here, replace(grains_at([0.0, 0.0, D / 2 * (1 - 1e-5)]), q=flat), beats=3)
    assert rows["contacts"] == [2]
    assert rows["fz"] == pytest.approx([rod.mass * G], rel=1e-3)
    assert rows["mx"] == pytest.approx([0.0], abs=1e-6 * rod.mass * G * D)


def test_unlike_spheres_each_press_with_their_own_weight():
    """A small heavy sphere beside a large light one, each at the overlap that carries it."""
    kinds = ({"name": "light", "share": 0.5}, {"name": "heavy", "share": 0.5, "diameter": D / 2, "density": 9000.0})
    grains = Spheres.model_validate({"diameter": D, "density": 2500.0, "count": 2, "kinds": kinds})
    here = scene(2, linear(), walls((0.0, 0.0, 1.0)), G).model_copy(update={"grains": grains})
    diameter, kind = np.array([D, D / 2]), np.array([0, 1])
    weight = math.pi / 6 * diameter**3 * [2500.0, 9000.0] * G
    law = linear()
    x = np.array([[0.0, 0.0, 0.0], [0.03, 0.0, 0.0]])
    x[:, 2] = diameter / 2 - weight / law.normal_stiffness
    start = replace(grains_at(x), diameter=diameter, kind=kind)
    rows = at_rest(here, PLATFORM.numerics(DT), start, PROBE)
    assert rows["fz"].sum() == pytest.approx(weight.sum(), rel=1e-6)
    assert rows["mx"].sum() == pytest.approx(0.03 * weight[1], rel=1e-6)


def test_a_packing_is_read_as_a_member_at_rest_is():
    """Spheres in a box at rest: the frame after a beat, and the state that it left, read without a backend."""
    here = scene(2, linear(), walls((0.0, 0.0, 1.0), (1.0, 0.0, 0.0)), G)
    x = D / 2 * (1 - 1e-6)
    motion = PLATFORM.run(MemberStart(here, DT, grains_at([[x, 0.0, x], [3 * D, 0.0, x]])), 6, 500, [PROBE])
    rows, numerics = motion.rows(PROBE), PLATFORM.numerics(DT, steps_per_beat=500)
    seen = at_rest(here, numerics, motion.end, PROBE)
    ended = {name: column[rows["step"] == rows["step"].max()] for name, column in rows.items()}
    assert np.array_equal(seen["wall"], ended["wall"])
    assert np.array_equal(seen["bin"], ended["bin"])
    weight = here.grains.mass * G
    for name in ("fx", "fy", "fz", "normal", "along"):
        assert seen[name] == pytest.approx(ended[name], abs=1e-4 * weight)
    assert seen["fz"].sum() == pytest.approx(2 * weight, rel=1e-4)


def test_areas_of_bins_add_up_to_the_walls():
    """Side and bottom of a cylinder; plates and front of a wedge up to the top of its side walls."""
    silo = scene(30000, linear(), CylinderSilo(diameter=0.06, height=0.1, orifice=0.02), G)
    side, bottom = (areas(silo.container, w, b) for w, b in both(silo))
    assert side.sum() == pytest.approx(math.pi * 0.06 * 0.1)
    assert bottom.sum() == pytest.approx(math.pi * (0.03**2 - 0.01**2))
    wedge = WedgeHopper(width=0.1, height=0.2, thickness=0.004, angle=0.6, orifice=0.02)
    hopper = scene(30000, linear(), wedge, G)
    found = {wall.name: (areas(wedge, wall, bins), bins) for wall, bins in both(hopper)}
    plate = math.hypot(0.04, 0.04 / math.tan(0.6)) * 0.004
    assert found["bottom-left"][0].sum() == pytest.approx(plate)
    front, bins = found["front"]
    assert front.sum() == pytest.approx(wedge.volume_below(float(bins.edges[-1])) / 0.004)
    left, bins = found["left"]
    assert left[0] == pytest.approx(0.004 * bins.size)
    assert found["lid"][0].sum() == pytest.approx(0.02 * 0.004)


def both(here):
    """Walls of the container, open and closed, with their bins."""
    every = all_walls(here.container)
    return zip(every, bins_of_walls(here, every, 2 * D), strict=True)
