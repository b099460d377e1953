import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from labbook.measure.clipped import (
    disc_in_rectangle,
    lens,
    rod_in_box,
    rod_in_ring,
    sphere_in_box,
    sphere_in_ring,
)


def area(x, z, r, low, high):
    return float(disc_in_rectangle(np.array([x]), np.array([z]), r, low, high)[0])


def volume(centre, r, low, high):
    return float(sphere_in_box(np.array([centre]), r, low, high)[0])


def integrated_area(x, z, r, low, high):
    """The chord at each x, clipped, by adaptive quadrature."""

    def chord(t):
        half = math.sqrt(max(r * r - (t - x) ** 2, 0))
        return max(0.0, min(high[1], z + half) - max(low[1], z - half))

    a, b = max(low[0], x - r), min(high[0], x + r)
    if b <= a:
        return 0.0
    kinks = [x + s * math.sqrt(r * r - (e - z) ** 2) for e in (low[1], high[1]) for s in (-1, 1) if abs(e - z) < r]
    # piece by piece, and over the angle t = x + r sin(angle), in which the ends of the disc are smooth
    edges = [math.asin(max(-1.0, min(1.0, (t - x) / r))) for t in (a, *sorted(k for k in kinks if a < k < b), b)]
    pieces = pairwise(edges)
    return sum(
        quad(lambda angle: chord(x + r * math.sin(angle)) * r * math.cos(angle), *piece, epsabs=1e-12)[0]
        for piece in pieces
    )


@pytest.mark.parametrize(
    ("x", "z", "part"), [(0, 0, 1), (-2, 0, 0.5), (2, -2, 0.25), (9, 0, 0), (0, 9, 0), (3.5, 0, 0), (-2, 2, 0.25)]
)
def test_parts_of_a_disc(x, z, part):
    assert area(x, z, 1.0, (-2, -2), (2, 2)) == pytest.approx(part * math.pi, abs=1e-14)


@given(st.floats(-2, 2), st.floats(-2, 2), st.floats(0.05, 2.5), st.floats(-1, 0), st.floats(0.01, 2))
def test_areas_agree_with_quadrature(x, z, r, low, size):
    corners = (low, low / 2), (low + size, low / 2 + 1.3 * size)
    assert area(x, z, r, *corners) == pytest.approx(integrated_area(x, z, r, *corners), abs=1e-7)


def test_a_rectangle_within_the_disc_counts_whole():
    assert area(0.1, 0.2, 5, (-1, -1), (1, 2)) == pytest.approx(6, rel=1e-13)


def test_radius_zero_has_no_area():
    assert area(0, 0, 0, (-1, -1), (1, 1)) == 0


@pytest.mark.parametrize("depth", [0.0, 0.1, 0.5, 1.0, 1.7, 2.0])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_caps(depth, axis):
    """A sphere that reaches `depth` into the box through one face: pi h^2 (3 r - h)/3."""
    centre = np.zeros(3)
    centre[axis] = -10 - 1 + depth
    exact = math.pi * depth**2 * (3 - depth) / 3
    assert volume(centre, 1.0, (-10, -10, -10), (10, 10, 10)) == pytest.approx(exact, abs=1e-4)


def test_octant_and_quarter():
    sphere = 4 / 3 * math.pi
    assert volume((10, 10, 10), 1.0, (-10, -10, -10), (10, 10, 10)) == pytest.approx(sphere / 8, rel=1e-10)
    assert volume((10, 0, 10), 1.0, (-10, -10, -10), (10, 10, 10)) == pytest.approx(sphere / 4, rel=1e-10)


@pytest.mark.slow
def test_volume_at_an_edge_is_within_the_stated_error():
    rng = np.random.default_rng(0)
    for x, z in rng.uniform(-1, 1, (40, 2)):

        def slice_area(y, x=x, z=z):
            return integrated_area(x, z, math.sqrt(1 - y * y), (0, 0), (9, 9))

        kinks = sorted({s * math.sqrt(1 - e * e) for e in (x, z, min(math.hypot(x, z), 1)) for s in (-1, 1)})
        exact = quad(slice_area, -1, 1, points=kinks, limit=200, epsabs=1e-8)[0]
        assert volume((x, 0, z), 1.0, (0, -9, 0), (9, 9, 9)) == pytest.approx(exact, abs=1e-4 * 4 / 3 * math.pi)


def test_a_whole_sphere_in_two_halves():
    both = volume((0.3, 0, 0), 1, (-9, -9, -9), (0, 9, 9)) + volume((0.3, 0, 0), 1, (0, -9, -9), (9, 9, 9))
    assert both == pytest.approx(4 / 3 * math.pi, rel=1e-12)


def random_rods(rng, n, within=3.0):
    axis = rng.standard_normal((n, 3))
    return rng.uniform(-within, within, (n, 3)), axis / np.linalg.norm(axis, axis=1)[:, None]


def drawn_in_rod(rng, centre, axis, r, half, inside, n=200_000):
    """Volume of a rod within `inside` by points at random in it: a standard error of at most 0.12 % of a rod."""
    x = rng.uniform(-1, 1, (n, 3)) * [r, r, half + r]
    x = x[np.hypot(np.hypot(x[:, 0], x[:, 1]), np.maximum(abs(x[:, 2]) - half, 0)) <= r]
    across = np.linalg.svd(axis[None, :])[2][1:]
    points = centre + x[:, :1] * across[0] + x[:, 1:2] * across[1] + x[:, 2:] * axis
    return rod_volume(r, half) * np.mean(inside(points))


def rod_volume(r, half):
    return math.pi * r**2 * 2 * half + 4 / 3 * math.pi * r**3


def ring(inner, outer, low, high):
    def inside(x):
        off = np.hypot(x[:, 0], x[:, 1])
        return (off >= inner) & (off <= outer) & (x[:, 2] >= low) & (x[:, 2] <= high)

    return inside


def test_whole_rods_and_rods_outside():
    rng = np.random.default_rng(2)
    x, axis = random_rods(rng, 20)
    far = (-9, -9, -9), (9, 9, 9)
    np.testing.assert_allclose(rod_in_box(x, axis, 0.5, 1.5, *far), rod_volume(0.5, 1.5), rtol=1e-12)
    np.testing.assert_allclose(rod_in_ring(x, axis, 0.5, 1.5, 0, 9, -9, 9), rod_volume(0.5, 1.5), rtol=1e-12)
    assert not rod_in_box(x + 20, axis, 0.5, 1.5, *far).any()
    assert not rod_in_ring(x + 20, axis, 0.5, 1.5, 0, 9, -9, 9).any()


@pytest.mark.slow
def test_rods_at_the_edges_of_a_box_and_of_a_ring_agree_with_points_at_random():
    """Within the errors of the points, 4 x 0.12 % of a rod, and of the lines, 1 %."""
    rng, r, half = np.random.default_rng(3), 1.0, 1.5
    x, axis = random_rods(rng, 40)
    low, high = (-1, -2, -1.5), (2, 1, 2.5)
    box, round_ = rod_in_box(x, axis, r, half, low, high), rod_in_ring(x, axis, r, half, 1.2, 3, -1, 2)

    def in_box(p):
        return ((p >= low) & (p <= high)).all(axis=1)

    for k in range(len(x)):
        near = 0.015 * rod_volume(r, half)
        assert box[k] == pytest.approx(drawn_in_rod(rng, x[k], axis[k], r, half, in_box), abs=near)
        assert round_[k] == pytest.approx(drawn_in_rod(rng, x[k], axis[k], r, half, ring(1.2, 3, -1, 2)), abs=near)
    assert np.count_nonzero((box > 0) & (box < 0.99 * rod_volume(r, half))) > 0


@pytest.mark.parametrize("depth", [0.1, 0.5, 1.0, 1.6])
def test_a_rod_cut_lengthwise_by_a_face(depth):
    """The worst case of lines along the rod: segment times length, and the caps, pi h^2 (3 r - h)/3."""
    segment = math.acos(1 - depth) - (1 - depth) * math.sqrt(1 - (1 - depth) ** 2)
    exact = 3 * segment + math.pi * depth**2 * (3 - depth) / 3
    up = np.array([[0.0, 0, 1]])
    found = rod_in_box(np.array([[depth - 1, 0, 0]]), up, 1.0, 1.5, (0, -9, -9), (9, 9, 9))
    assert found[0] == pytest.approx(exact, abs=0.02 * rod_volume(1, 1.5))


def test_lenses():
    """Two unit discs a distance s apart share 2 acos(s/2) - (s/2) sqrt(4 - s^2); one within the other is whole."""
    s = np.array([0.0, 0.5, 1.0, 1.9, 2.0, 3.0])
    exact = 2 * np.arccos(np.minimum(s / 2, 1)) - s / 2 * np.sqrt(np.maximum(4 - s**2, 0))
    np.testing.assert_allclose(lens(s, np.ones(6), 1.0), exact, atol=1e-13)
    np.testing.assert_allclose(lens(np.array([0.5, 0.5]), np.array([0.2, 5.0]), 1.0), [0.04 * math.pi, math.pi])
    assert lens(np.zeros(1), np.ones(1), 0.0)[0] == 0


@pytest.mark.slow
def test_a_sphere_at_the_wall_of_a_cylinder_is_within_the_stated_error():
    rng = np.random.default_rng(4)
    for x in rng.uniform([-3, -3, -2], [3, 3, 3], (40, 3)):
        off = math.hypot(x[0], x[1])

        def disc(z, x=x, off=off):
            r = math.sqrt(max(1 - (z - x[2]) ** 2, 0))
            return float((lens(np.array([off]), np.array([r]), 3) - lens(np.array([off]), np.array([r]), 1.2))[0])

        low, high = max(-1, x[2] - 1), min(2, x[2] + 1)
        exact = quad(disc, low, high, limit=400, epsabs=1e-7)[0] if low < high else 0.0
        assert sphere_in_ring(x[None], 1.0, 1.2, 3, -1, 2)[0] == pytest.approx(exact, abs=1e-4 * 4 / 3 * math.pi)


def test_rods_without_length_are_spheres():
    x, axis = random_rods(np.random.default_rng(5), 50)
    sphere = 4 / 3 * math.pi
    lines, discs = rod_in_ring(x, axis, 1.0, 0.0, 1.2, 3, -1, 2), sphere_in_ring(x, 1.0, 1.2, 3, -1, 2)
    np.testing.assert_allclose(lines, discs, atol=0.02 * sphere)
