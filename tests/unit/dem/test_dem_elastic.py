"""Elastic forces of a bed from overlaps: by hand for two grains, and as the reference backend has them for beds."""

import math

import labbook_reference
import numpy as np
import pytest
from labbook_dem.elastic import elastic_forces
from labbook_reference.member import Run

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Contacts
from labbook.checks.verify.mesh import of_triangles, sheet
from labbook.scene import (
    Box,
    ContactLaw,
    Container,
    CylinderSilo,
    HertzMindlin,
    LinearSpringDashpot,
    Packing,
    PartMotion,
    Primitives,
    Scene,
    Spheres,
    Spherocylinders,
)
from labbook.scene.orientation import random_turns
from labbook.scene.sizes import Uniform

D, G, NU = 4e-3, 3e7, 0.3
HERTZ = HertzMindlin(shear_modulus=G, poisson_ratio=NU, friction=0.5, restitution=0.4)
LINEAR = LinearSpringDashpot(normal_stiffness=500.0, friction=0.5, restitution=0.4)
BOX = Box(width=0.1, depth=0.1, height=0.1)
NUMERICS = Numerics(dt=1e-6)
E_STAR = G / (1 - NU)  # of equal bodies: E/(2 (1 - nu^2)) with E = 2 G (1 + nu)


def scene(law: ContactLaw = HERTZ, grains=None, container: Container = BOX) -> Scene:
    return Scene(grains=grains or Spheres(diameter=D, density=2500, count=2), contact=law, container=container)


def packing(x, **more) -> Packing:
    x = np.array(x, float)
    return Packing(x=x, v=0 * x, omega=0 * x, **more)


def pair(table) -> np.ndarray:
    """Force and branch of the only contact."""
    assert len(table["i"]) == 1
    return np.array([table[name][0] for name in ("fx", "fy", "fz", "bx", "by", "bz")])


@pytest.mark.parametrize(("law", "size"), [
    (HERTZ, lambda deep: 4 / 3 * E_STAR * math.sqrt(D / 4) * deep**1.5),
    (LINEAR, lambda deep: 500.0 * deep),
])  # fmt: skip
@pytest.mark.parametrize("deep", [1e-6, 4e-5])
def test_two_spheres_press_each_other_apart_as_their_law_says(law, size, deep):
    n = np.array([2.0, -1.0, 2.0]) / 3
    here = np.array([0.01, 0.0, 0.05])
    table = elastic_forces(scene(law), NUMERICS, packing([here, here - (D - deep) * n]))
    assert (table["i"][0], table["j"][0], table["wall"][0]) == (0, 1, -1)
    assert pair(table)[:3] == pytest.approx(size(deep) * n, rel=1e-9)
    assert pair(table)[3:] == pytest.approx(-(D - deep) * n, rel=1e-9)


def test_unlike_spheres_have_the_harmonic_mean_of_their_radii():
    grains = Spheres(diameter=D, density=2500, count=2, sizes=Uniform(smallest=D / 4))
    deep, radii = 1e-5, (D / 2, D / 6)
    bed = packing([(0, 0, 0.05), (0, 0, 0.05 + sum(radii) - deep)], diameter=2 * np.array(radii))
    size = 4 / 3 * E_STAR * math.sqrt(radii[0] * radii[1] / sum(radii)) * deep**1.5
    assert pair(elastic_forces(scene(grains=grains), NUMERICS, bed))[2] == pytest.approx(-size, rel=1e-9)


def test_a_sphere_on_the_floor_has_its_own_radius():
    deep = 2e-5
    table = elastic_forces(scene(), NUMERICS, packing([(0, 0, D / 2 - deep)]))
    names = [wall.name for wall in BOX.walls()]
    assert (table["j"][0], names[table["wall"][0]]) == (-1, "bottom")
    size = 4 / 3 * E_STAR * math.sqrt(D / 2) * deep**1.5
    assert pair(table) == pytest.approx([0, 0, size, 0, 0, deep - D / 2], rel=1e-9)


def test_crossed_rods_touch_where_they_are_nearest():
    """One along x, the other along y and d - 30 um above it, 2 mm aside of its middle: the branch joins the centres."""
    rods, deep, side = Spherocylinders(diameter=D, length=3 * D, density=600, count=2), 3e-5, 2e-3
    q = np.array([(math.sqrt(0.5), 0, math.sqrt(0.5), 0), (math.sqrt(0.5), -math.sqrt(0.5), 0, 0)])
    bed = packing([(0, 0, 0.05), (side, 0, 0.05 + D - deep)], q=q)
    found = pair(elastic_forces(scene(LINEAR, rods), NUMERICS, bed))
    assert found == pytest.approx([0, 0, -500.0 * deep, side, 0, D - deep], rel=1e-6, abs=1e-12)


def test_a_part_that_moves_presses_where_it_is():
    """A sheet rises by 1 mm a second from z = 0: after half a second it has reached a sphere at r above 0.49 mm."""
    floor = of_triangles(*sheet(2, 0.02)).model_copy(
        update={"name": "floor", "moves": PartMotion(velocity=(0.0, 0.0, 1e-3))}
    )
    here = scene(LINEAR, container=Primitives(parts=(floor,)))
    bed = packing([(0.003, 0.004, D / 2 + 4.9e-4)])
    assert len(elastic_forces(here, NUMERICS, bed, 0.0)["i"]) == 0
    found = pair(elastic_forces(here, NUMERICS, bed, 0.5))
    assert found[:3] == pytest.approx([0, 0, 500.0 * 1e-5], rel=1e-6)


@pytest.mark.parametrize("kind", ["spheres", "sizes", "rods"])
def test_beds_at_rest_have_the_forces_of_the_reference_backend(kind):
    """Without velocities and springs its forces are elastic. Closest points of rods are found in two ways, whose places
    differ by 1e-9 m: of axes that nearly meet, some micrometres apart, the direction by less than a thousandth."""
    rng, n = np.random.default_rng(5), 60
    grains, container, more = Spheres(diameter=D, density=2500, count=n), Box(width=0.02, depth=0.02, height=0.1), {}
    if kind == "sizes":
        grains = Spheres(diameter=D, density=2500, count=n, sizes=Uniform(smallest=D / 2))
        more = {"diameter": rng.uniform(D / 2, D, n)}
    if kind == "rods":
        grains = Spherocylinders(diameter=D, length=3 * D, density=600, count=n)
        more, container = {"q": random_turns(rng, n)}, CylinderSilo(diameter=0.03, height=0.2, orifice=0.012)
    here = scene(LINEAR, grains, container)
    bed = packing(rng.uniform((-0.008, -0.008, 0.002), (0.008, 0.008, 0.02), (n, 3)), **more)
    table = elastic_forces(here, NUMERICS, bed)
    other = Run.started(labbook_reference.Backend().capabilities, here, NUMERICS, (Contacts(),), bed).contacts()
    mine = np.stack([table[name] for name in ("i", "j", "wall", "fx", "fy", "fz", "bx", "by", "bz")], axis=1)
    mine, other = (rows[np.lexsort(np.round(rows[:, [8, 2, 1, 0]], 6).T)] for rows in (mine, other))
    assert len(mine) > 30
    assert mine[:, :3] == pytest.approx(other[:, :3])
    assert mine[:, 3:6] == pytest.approx(other[:, 3:6], rel=1e-3, abs=1e-5)
    assert mine[:, 6:] == pytest.approx(other[:, 6:], abs=1e-9)
