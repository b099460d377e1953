"""Two unlike spheres that touch: limits, symmetry, and where the contact is."""

from typing import Any

import numpy as np
import pytest
from labbook_dem import spheres
from labbook_dem.chosen import choose
from labbook_dem.laws import hertz_mindlin
from labbook_dem.words import dot, vec3

from labbook.scene import HertzMindlin, Surface

LAW = hertz_mindlin.coefficients(
    HertzMindlin(shear_modulus=1e8, poisson_ratio=0.25), Surface(friction=0.5, rolling_friction=0.05, restitution=0.5)
)
DT = 1e-6


@pytest.fixture(autouse=True)
def hertz_mindlin_law():
    with choose("hertz-mindlin"):
        yield


def some(seed: int):
    """Radii, masses, branch, overlap2, relative velocities, spins and spring of two spheres that overlap by 1e-5 m."""
    rng = np.random.default_rng(seed)
    ri, rj = rng.uniform(0.5e-3, 3e-3, 2)
    n = rng.normal(size=3)
    n /= np.linalg.norm(n)
    away = vec3(*(n * (ri + rj - 1e-5)))
    u, v, wi, wj, s = (vec3(*(scale * rng.normal(size=3))) for scale in (0.1, 0.1, 50.0, 50.0, 1e-7))
    return (ri, rj, *rng.uniform(1e-5, 4e-5, 2), away, (ri + rj) ** 2 - dot(away, away), u, v, wi, wj, s)


def contact(ri, rj, mi, mj, away, overlap2, u, v, wi, wj, s, rates=(1.0, 2.0)):
    return spheres.sphere_on_sphere(LAW, ri, rj, mi, mj, away, overlap2, u, v, wi, wj, s, DT, *rates)


def array(v: vec3) -> np.ndarray:
    return np.array([v.x, v.y, v.z])


@pytest.mark.parametrize("seed", range(10))
def test_exchanged_spheres_feel_opposite_forces_to_the_last_bit(seed):
    ri, rj, mi, mj, away, overlap2, u, v, wi, wj, s = some(seed)
    force, ti, tj, kept, delta = contact(ri, rj, mi, mj, away, overlap2, u, v, wi, wj, s)
    back = contact(rj, ri, mj, mi, -away, overlap2, -u, -v, wj, wi, -s, (2.0, 1.0))
    assert (-force, tj, ti, -kept, delta) == back


@pytest.mark.parametrize("seed", range(10))
def test_angular_momentum_is_conserved(seed):
    """Torques on both, and that of the pair of forces at the distance of the centres, add up to nothing."""
    given: Any = some(seed)
    force, ti, tj, _, _ = contact(*given)
    total = array(ti) + array(tj) + np.cross(array(given[4]), array(force))
    assert np.abs(total).max() < 1e-12 * np.linalg.norm(array(given[4])) * np.linalg.norm(array(force))


def test_equal_spheres_are_the_case_of_equal_radii(monkeypatch):
    ri, _, mi, _, _, _, u, v, wi, wj, s = some(1)
    away = vec3(0.6 * (2 * ri - 1e-5), 0.0, 0.8 * (2 * ri - 1e-5))
    overlap2 = 4 * ri**2 - dot(away, away)
    unlike = contact(ri, ri, mi, mi, away, overlap2, u, v, wi, wj, s)
    monkeypatch.setattr(spheres, "VARIED", False)
    equal = contact(ri, ri, mi, mi, away, overlap2, u, v, wi, wj, s, (1.0, 1.0))
    for one, other in zip(unlike[:4], equal[:4], strict=True):
        assert array(one) == pytest.approx(array(other), rel=1e-12)


def test_a_very_large_and_heavy_sphere_is_a_wall():
    """At a ratio of 1e6 the error is of its order; the wall's own spin is none."""
    r, _, m, _, _, _, u, v, w, _, s = some(2)
    zero, large, delta = vec3(0.0, 0.0, 0.0), 1e6 * r, 1e-5
    n = vec3(0.0, 0.6, 0.8)
    away = n * (r + large - delta)
    overlap2 = delta * (2 * (r + large) - delta)
    force, torque, _, kept, overlap = contact(r, large, m, 1e6 * m, away, overlap2, u, v, w, zero, s)
    f, t, k = spheres.sphere_on_wall(LAW, r, m, delta, n, u, v, w, zero, s, DT, 1.0)
    assert overlap == pytest.approx(delta, rel=1e-4)  # an overlap2 this large over a radius of kilometres
    for one, other in ((force, f), (torque, t), (kept, k)):
        assert array(one) == pytest.approx(array(other), rel=1e-4)


def test_the_contact_lies_where_the_surfaces_meet():
    """Tangential velocities due to spins vanish for the ratio of levers that the circle of intersection gives."""
    ri, rj, delta = 1e-3, 3e-3, 2e-4
    r = ri + rj - delta
    li = (r**2 + ri**2 - rj**2) / (2 * r)
    lj = r - li
    assert ri**2 - li**2 == pytest.approx(rj**2 - lj**2)  # the square of the circle's radius
    spin = 10.0
    zero = vec3(0.0, 0.0, 0.0)
    wi, wj = vec3(0.0, 0.0, spin), vec3(0.0, 0.0, -spin * li / lj)
    away = vec3(r, 0.0, 0.0)
    overlap2 = (ri + rj) ** 2 - r**2
    elastic = Surface(friction=0.5, rolling_friction=0.0, restitution=1.0)
    free = hertz_mindlin.coefficients(HertzMindlin(shear_modulus=1e8, poisson_ratio=0.25), elastic)
    arguments = (free, ri, rj, 1e-5, 1e-4, away, overlap2, zero, zero)
    _, _, _, kept, _ = spheres.sphere_on_sphere(*arguments, wi, wj, zero, DT, 1.0, 1.0)
    assert np.abs(array(kept)).max() < 1e-12 * spin * li * DT
    _, _, _, kept, _ = spheres.sphere_on_sphere(*arguments, wi, zero, zero, DT, 1.0, 1.0)
    assert np.linalg.norm(array(kept)) == pytest.approx(spin * li * DT)
