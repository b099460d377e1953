"""Powers of contacts against the motion of the contact points, contact by contact, and against known motions."""

import numpy as np
import pytest
from labbook_dem.ledger import contact_power

from labbook.scene import HertzMindlin, Plane, Primitives, Scene, Spheres, SurfaceMotion, Wall

RNG = np.random.default_rng(3)
SPIN = 7.0


def scene(spin: float = SPIN) -> Scene:
    still = Wall(name="side", shape=Plane(point=(0.0, 0.0, 0.0), normal=(1.0, 0.0, 0.0)))
    turning = Wall(
        name="floor", shape=Plane(point=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0)), motion=SurfaceMotion(spin=spin)
    )
    return Scene(
        grains=Spheres(diameter=4e-3, density=2500, count=3),
        contact=HertzMindlin(shear_modulus=1e7, poisson_ratio=0.25),
        container=Primitives(parts=(still, turning)),
    )


def test_powers_are_those_of_the_contact_points():
    """Three unlike spheres: two pairs, one with the ids in the other order, and a contact at the turning floor."""
    ids, radius = np.array([2, 5, 9]), np.array([2e-3, 1e-3, 1.5e-3])
    x = np.array([[0.02, 0.01, 1.9e-3], [0.0226, 0.0112, 2.3e-3], [0.018, 0.0075, 3e-3]])
    v, w = RNG.normal(0, 0.3, (3, 3)), RNG.normal(0, 100, (3, 3))
    force = RNG.normal(0, 1, (3, 3))
    floor = np.array([0, 0, -1.9e-3])
    rows = np.array([
        [2, 5, -1, *force[0], *(x[1] - x[0])],
        [9, 2, -1, *force[1], *(x[0] - x[2])],
        [2, -1, 1, *force[2], *floor],
    ])  # fmt: skip
    found = contact_power(scene(), ids, radius, x, v, w, rows)

    normal = tangential = elastic = 0.0
    for i, j, f in ((0, 1, force[0]), (2, 0, force[1])):
        d = x[j] - x[i]
        r = np.linalg.norm(d)
        n = -d / r
        # the plane of the circle in which the surfaces meet
        lever = (r**2 + radius[i] ** 2 - radius[j] ** 2) / (2 * r)
        at = x[i] - n * lever
        u = v[i] + np.cross(w[i], at - x[i]) - v[j] - np.cross(w[j], at - x[j])
        normal -= f @ n * (u @ n)
        tangential -= (f - f @ n * n) @ (u - u @ n * n)
        elastic += 0.5 * (f @ n) * (radius[i] + radius[j] - r)
    n, f, at = np.array([0.0, 0.0, 1.0]), force[2], x[0] + floor
    surface = np.cross([0, 0, SPIN], at)
    u = v[0] + np.cross(w[0], floor) - surface
    normal -= f[2] * u[2]
    tangential -= (f - f @ n * n) @ (u - u @ n * n)
    elastic += 0.5 * f[2] * (radius[0] - 1.9e-3)
    assert found["normal_power"] == pytest.approx(normal, rel=1e-12)
    assert found["tangential_power"] == pytest.approx(tangential, rel=1e-12)
    assert found["wall_power"] == pytest.approx(f @ surface, rel=1e-12)
    assert found["elastic"] == pytest.approx(elastic, rel=1e-12)


def test_a_pair_that_moves_as_a_whole_dissipates_nothing():
    """A common translation and rotation leaves the contact points together, whatever the forces."""
    x, radius = np.array([[0.0, 0.0, 0.01], [3e-3, 1e-3, 0.011]]), np.array([2e-3, 1.4e-3])
    turn = np.array([20.0, -5.0, 8.0])
    v = np.array([0.1, 0.2, -0.3]) + np.cross(turn, x)
    row = np.array([[0, 1, -1, 1.0, -2.0, 0.5, *(x[1] - x[0])]])
    found = contact_power(scene(), np.arange(2), radius, x, v, np.tile(turn, (2, 1)), row)
    assert found["normal_power"] == pytest.approx(0, abs=1e-15)
    assert found["tangential_power"] == pytest.approx(0, abs=1e-15)


def test_no_contact_has_no_power():
    zero = np.zeros((1, 3))
    found = contact_power(scene(), np.arange(1), np.array([1e-3]), zero, zero, zero, np.zeros((0, 9)))
    assert found == {"normal_power": 0, "tangential_power": 0, "wall_power": 0, "elastic": 0}
