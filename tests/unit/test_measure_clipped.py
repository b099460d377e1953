import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from labbook.measure.clipped import disc_in_rectangle, sphere_in_box


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
