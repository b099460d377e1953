"""Closest points of two segments against SciPy's bounded least squares, and their continuity through parallel."""

import math

import numpy as np
import pytest
from labbook_dem.segments import closest
from labbook_dem.words import vec3
from scipy.optimize import lsq_linear

HALF, D = 7e-3, 6e-3  # a rod of 20 mm x 6 mm
EPS = 2e-7


def points(c, a, b, half=HALF):
    s, t, away = closest(vec3(*c), vec3(*a), vec3(*b), half)
    return s, t, np.array([away.x, away.y, away.z])


def unit(v):
    return np.asarray(v, float) / np.linalg.norm(v)


def scipy_distance(c, a, b, half=HALF):
    """By a least-squares solver with bounds, in units of the half length."""
    found = lsq_linear(np.column_stack([a, -b]), -np.asarray(c) / half, bounds=(-1, 1), method="bvls", tol=1e-15)
    return half * math.sqrt(2 * found.cost)


def cases():
    """Random, nearly parallel, antiparallel, crossing, perpendicular and collinear rods, some touching."""
    rng = np.random.default_rng(1)
    for _ in range(150):
        a, b = unit(rng.normal(size=3)), unit(rng.normal(size=3))
        yield rng.normal(size=3) * 8e-3, a, b
    for tilt in (0.0, 1e-9, 1e-7, EPS * HALF / D, 1e-6, 1e-4, 1e-3, 1e-2):
        for sign in (1, -1):
            for _ in range(10):
                a = unit(rng.normal(size=3))
                across = unit(np.cross(a, rng.normal(size=3)))
                b = sign * unit(a + tilt * unit(rng.normal(size=3)))
                yield D * across + rng.uniform(-3, 3) * HALF * a, a, b
    x, y, z = np.eye(3)
    yield 1e-9 * z, x, y
    yield D * z, x, y
    yield 3 * HALF * x, x, x
    yield 1.5 * HALF * x + D * y, x, -x


def test_distances_are_those_of_a_constrained_minimisation():
    """As long as the rods are not deep in one another, the regularised distance is right to 1e-9 m."""
    for c, a, b in cases():
        s, t, away = points(c, a, b)
        assert max(abs(s), abs(t)) <= HALF
        assert away == pytest.approx(c + s * a - t * b, abs=1e-16)
        exact, found = scipy_distance(c, a, b), float(np.linalg.norm(away))
        if exact > 0.5 * D:
            assert -1e-12 <= found - exact <= 1e-9, (c, a, b)
        else:  # nothing that a guard lets pass; still the points are near
            assert abs(found - exact) <= 1e-5


def test_the_regularised_minimum_is_found_exactly():
    """Karush-Kuhn-Tucker: the gradient of |away|^2 + EPS (s^2 + t^2) vanishes, or points out of the limits."""
    for c, a, b in cases():
        s, t, away = points(c, a, b)
        for u, slope in ((s, away @ a + EPS * s), (t, -away @ b + EPS * t)):
            if abs(u) < HALF * (1 - 1e-12):
                assert abs(slope) < 1e-13
            else:
                assert slope * u <= 1e-16


@pytest.mark.parametrize("shift", [(0, 0, D), (3e-3, 0, D), (-5e-3, 1e-3, 0.9 * D)])
@pytest.mark.parametrize("range_", [5e-3, 5e-6, 5e-8])
def test_contact_points_are_continuous_as_rods_turn_through_parallel(shift, range_):
    """Bare closest points jump by the length of the overlap; these move by |c|/(2 EPS) a radian at most."""
    angles = np.linspace(-range_, range_, 4001)
    turned = [(math.cos(f), math.sin(f) * 0.6, math.sin(f) * 0.8) for f in angles]
    found = np.array([points(shift, (1, 0, 0), b)[:2] for b in turned])
    step = np.abs(np.diff(found, axis=0)).max()
    assert step <= np.linalg.norm(shift) * (angles[1] - angles[0]) / (2 * EPS)
    levers = np.ptp(found, axis=0)
    assert np.all(levers > HALF) or range_ < 1e-6  # it is from one end to the other that the point moves


def test_parallel_rods_touch_in_the_middle_of_where_they_lie_side_by_side():
    s, t, _ = points((4e-3, 0, D), (1, 0, 0), (1, 0, 0))
    assert (s, t) == pytest.approx((-2e-3, 2e-3), abs=1e-8)


def test_a_rod_of_no_length_is_a_sphere():
    c = (1e-3, 2e-3, 3e-3)
    s, t, away = points(c, unit((1, 2, 3)), unit((3, 1, 2)), 0.0)
    assert (s, t) == (0, 0)
    assert np.array_equal(away, c)


def test_either_rod_may_come_first():
    for c, a, b in cases():
        s, t, away = points(c, a, b)
        r, u, back = points(-np.asarray(c), b, a)
        assert (s, t) == (u, r)
        assert np.array_equal(away, -back)
