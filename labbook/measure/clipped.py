"""How much of a disc or a sphere lies within a rectangle or a box: exact areas, volumes by quadrature."""

import numpy as np

_ORDER = 48


def disc_in_rectangle(
    x: np.ndarray,
    z: np.ndarray,
    radius: np.ndarray | float,
    low: tuple[float, float],
    high: tuple[float, float],
) -> np.ndarray:
    """Area [m^2] of discs at (x, z) within the rectangle from `low` to `high` [m]; shape as x. Exact."""
    radius = np.asarray(radius, float)
    safe = np.where(radius > 0, radius, 1.0)

    def quadrant(right: float, top: float) -> np.ndarray:
        return _unit_disc_below((right - x) / safe, (top - z) / safe)

    whole = quadrant(high[0], high[1]) - quadrant(low[0], high[1]) - quadrant(high[0], low[1])
    return np.where(radius > 0, radius**2, 0.0) * np.clip(whole + quadrant(low[0], low[1]), 0, np.pi)


def _unit_disc_below(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Area of the part of the unit disc with x < a and y < b."""
    a, b = np.clip(a, -1, 1), np.clip(b, -1, 1)
    c = np.sqrt(1 - b**2)  # the line y = b cuts the circle at x = -c, c
    hi = np.clip(a, -c, c)
    under_line = b * (hi + c) + _half_segment(hi) + _half_segment(c)
    beside = 2 * (_half_segment(a) + np.pi / 4) - 2 * (_half_segment(hi) + _half_segment(c))
    return under_line + np.where(b > 0, beside, 0.0)


def _half_segment(x: np.ndarray) -> np.ndarray:
    """Integral of sqrt(1 - t^2) from 0 to x."""
    return (x * np.sqrt(1 - x**2) + np.arcsin(x)) / 2


def sphere_in_box(
    centre: np.ndarray, radius: np.ndarray | float, low: tuple[float, float, float], high: tuple[float, float, float]
) -> np.ndarray:
    """Volume [m^3] of spheres at `centre` [m], shape [n, 3], of `radius` [m], within the box from `low` to `high`
    [m]; shape [n].

    Discs clipped in x and z are exact; they are summed along y by Gauss-Legendre quadrature of order 48 in the
    polar angle. The error is below 1e-4 of a sphere where faces cut it, and round-off for whole ones.
    """
    x, y, z = np.asarray(centre, float).T
    start = np.arcsin(np.clip((low[1] - y) / radius, -1, 1))
    stop = np.arcsin(np.clip((high[1] - y) / radius, -1, 1))
    nodes, weights = np.polynomial.legendre.leggauss(_ORDER)
    middle, half = (start + stop) / 2, (stop - start) / 2
    volume = np.zeros(len(x))
    for node, weight in zip(nodes, weights, strict=True):
        angle = middle + half * node
        area = disc_in_rectangle(x, z, radius * np.cos(angle), (low[0], low[2]), (high[0], high[2]))
        volume += weight * half * area * radius * np.cos(angle)
    return volume
