"""Where a rod touches a round rim: all minima of the distance between segment and circle, against brute force."""

import math

import numpy as np
import pytest
from labbook_dem.walls import frustum
from labbook_dem.words import vec3
from scipy.optimize import brentq

from labbook.scene import Frustum

RIM = 0.4
SHAPES = {
    "hole": ((RIM, 0.0), (1.0, 0.0)),
    "funnel": ((RIM, 0.0), (0.9, 0.7)),
    "tube": ((RIM, 0.0), (RIM, -0.5)),
}
"""Lower end and upper end in radius and z [m]: a plate with a hole, a cone, a tube whose open end is the rim."""


def segments(seed: int, count: int):
    """Middles, axes and half lengths [m] of segments about the rim: any, chords across the hole, upright ones."""
    rng = np.random.default_rng(seed)
    for k in range(count):
        angle, half = rng.uniform(0, 2 * math.pi), rng.uniform(0.05, 0.6)
        out, along = np.array([math.cos(angle), math.sin(angle), 0]), np.array([-math.sin(angle), math.cos(angle), 0])
        if k % 2 == 0:
            offset = RIM * math.sqrt(rng.uniform())
            a = along + rng.normal(size=3) * [0, 0, 0.1]
            x = out * offset + along * rng.normal() * 0.1 + [0, 0, abs(rng.normal()) * 0.05]
            half = math.sqrt(RIM**2 - offset**2) * rng.uniform(0.8, 1.5)
        else:
            a = rng.normal(size=3) if k % 20 > 1 else np.array([*rng.normal(size=2) * 10 ** rng.uniform(-9, -5), 1.0])
            x = out * RIM + rng.normal(size=3) * 0.1
        yield x, a / np.linalg.norm(a), half


def root(f, low, high) -> float:
    return float(np.real(brentq(f, low, high, xtol=1e-15)))  # pyright: ignore[reportArgumentType, reportCallIssue]


def minima(shape: str, x: np.ndarray, a: np.ndarray, half: float) -> np.ndarray | None:
    """Where on the segment the distance from the rim is least, near and far: all minima of its part beyond the rim.

    By a fine grid, and by bisection of the slope of the distance between its points. None where the grid is too coarse
    to tell: where the segment is beyond the rim by a hair only.
    """
    (r, z), (r1, z1) = SHAPES[shape]
    up = np.array([r1 - r, z1 - z]) / math.hypot(r1 - r, z1 - z)

    def beyond(s) -> np.ndarray:
        p = x + np.multiply.outer(s, a)
        return -(np.hypot(p[..., 0], p[..., 1]) - r) * up[0] - (p[..., 2] - z) * up[1]

    def slope(s) -> np.ndarray:
        """Half the derivative of the square of the distance: branch from the nearest point of the circle, along a."""
        p = x + np.multiply.outer(s, a)
        q = p * [1, 1, 0] * (r / np.hypot(p[..., 0], p[..., 1]))[..., None] + [0, 0, z]
        return (p - q) @ a

    s = np.linspace(-half, half, 4001)
    there = beyond(s)
    if abs(there.max()) < 1e-5:
        return None
    if there.max() < 0:
        return np.zeros(0)
    inside = np.flatnonzero(there > 0)
    first = -half if inside[0] == 0 else root(beyond, s[inside[0] - 1], s[inside[0]])
    last = half if inside[-1] == 4000 else root(beyond, s[inside[-1]], s[inside[-1] + 1])
    s = np.linspace(first, last, 4001)
    g = slope(s)
    found = [first] if g[0] >= 0 else []
    found += [root(slope, s[k], s[k + 1]) for k in np.flatnonzero((g[:-1] < 0) & (g[1:] >= 0))]
    return np.array([*found, last] if g[-1] < 0 else found, float)


def met(shape: str, x, a, half: float, radius: float) -> list[tuple[float, float]]:
    """The backend's points on the segment and their distances [m], in the order in which they lie on it."""
    p = frustum.parameters(Frustum(lower=SHAPES[shape][0], upper=SHAPES[shape][1]))
    rim, along, middle, axis = vec3(p[0], 0.0, p[1]), vec3(p[2], 0.0, p[3]), vec3(*map(float, x)), vec3(*map(float, a))
    near, s, far, t = frustum.frustum_edges(rim, along, p[4], middle, axis, half, radius)
    return [(at, distance) for at, distance in ((s, near), (t, far)) if distance < 1e8]


@pytest.mark.parametrize("shape", SHAPES)
def test_a_rod_touches_the_rim_at_every_minimum_of_its_distance(shape):
    numbers, kinds = [], set()
    for x, a, half in segments(5, 1500):
        expected = minima(shape, x, a, half)
        if expected is None or (len(expected) == 2 and expected[1] - expected[0] < 2e-3 * half):
            continue  # too near to tell; two within a thousandth of half a rod count as one
        found = met(shape, x, a, half, 1e-9)
        assert len(found) == len(expected)
        numbers.append(len(found))
        if len(expected):
            # sought to a millionth of half a rod, which counts to second order in the distance
            assert np.array([s for s, _ in found]) == pytest.approx(expected, abs=1e-6 * half)
            points = x + np.multiply.outer(expected, a)
            distances = np.hypot(np.hypot(points[:, 0], points[:, 1]) - RIM, points[:, 2])
            assert np.array([d for _, d in found]) == pytest.approx(distances, abs=1e-12)
            kinds.add(tuple(abs(s) == half for s in expected))
    assert np.bincount(numbers).min() > 100
    assert kinds == {(end,) for end in (False, True)} | {(s, t) for s in (False, True) for t in (False, True)}
