"""Orientations of grains, and distances of rods that are about to be placed."""

from collections.abc import Iterator

import numpy as np


def random_turns(rng: np.random.Generator, n: int) -> np.ndarray:
    """Draw unit quaternions of n uniformly distributed random orientations, shape [n, 4]."""
    q = rng.normal(size=(n, 4))
    return q / np.linalg.norm(q, axis=1)[:, None]


def axes(q: np.ndarray) -> np.ndarray:
    """Compute the unit vectors [n, 3] to which the rotations q [n, 4] (w, x, y, z) take the z axis."""
    w, x, y, z = q.T
    return np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=1)


def rotated(q: np.ndarray, v: np.ndarray | tuple[float, float, float]) -> np.ndarray:
    """Rotate a vector of the body frame.

    Args:
        q: Unit quaternions (w, x, y, z), shape [n, 4].
        v: Vector, shape [3], or one for each, shape [n, 3].

    Returns:
        The vector in space for each orientation, shape [n, 3].
    """
    w, x, y, z = q.T
    a, b, c = np.asarray(v, float).T  # np.cross takes five times as long
    tx, ty, tz = 2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)
    turned = (a + w * tx + (y * tz - z * ty), b + w * ty + (z * tx - x * tz), c + w * tz + (x * ty - y * tx))
    return np.stack(turned, axis=1)


def distances(c: np.ndarray, a: np.ndarray, b: np.ndarray, half: float) -> np.ndarray:
    """Compute the shortest distances between segments of equal length.

    The nearest points are a pair in the inside of both, or one of the four ends and the point nearest to it: the
    smallest of these distances is exact, parallel or not.

    Args:
        c: Branches from the centre of the second to that of the first [m], shape [n, 3].
        a: Unit vectors along the first, shape [n, 3].
        b: Unit vectors along the second, shape [n, 3].
        half: Half length of all segments [m].

    Returns:
        Distances [m], shape [n].
    """
    return np.min([_separation(c, a, b, s, t) for s, t in _candidates(c, a, b, half)], axis=0)


def nearest(c: np.ndarray, a: np.ndarray, b: np.ndarray, half: float) -> tuple[np.ndarray, np.ndarray]:
    """Find the nearest points of segments; arguments as of `distances`.

    Returns:
        Places [m] of the points from the centres along a and b, each of shape [n].
    """
    candidates = np.array(list(_candidates(c, a, b, half)))
    index = np.argmin([_separation(c, a, b, s, t) for s, t in candidates], axis=0)
    s, t = candidates[index, :, np.arange(len(c))].T
    return s, t


def _candidates(c: np.ndarray, a: np.ndarray, b: np.ndarray, half: float) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Places s and t [m] along both segments where they may be nearest."""
    ca, cb, ab = (np.sum(u * v, axis=1) for u, v in ((c, a), (c, b), (a, b)))
    across = np.maximum(1 - ab**2, 1e-12)
    s, t = (ab * cb - ca) / across, (cb - ab * ca) / across
    inside = (np.abs(s) <= half) & (np.abs(t) <= half)
    for end in (-half, half):
        yield np.full(len(c), end), np.clip(cb + end * ab, -half, half)
        yield np.clip(end * ab - ca, -half, half), np.full(len(c), end)
    yield np.where(inside, s, -half), np.where(inside, t, np.clip(cb - half * ab, -half, half))


def _separation(c: np.ndarray, a: np.ndarray, b: np.ndarray, s: np.ndarray, t: np.ndarray) -> np.ndarray:
    return np.linalg.norm(c + s[:, None] * a - t[:, None] * b, axis=1)


def turned_to(a: np.ndarray) -> np.ndarray:
    """Compute the shortest rotations that take the z axis to lines, in either sense.

    Args:
        a: Unit vectors along the lines, shape [n, 3].

    Returns:
        Unit quaternions, shape [n, 4].
    """
    a = np.where(a[:, 2:] < 0, -a, a)
    q = np.stack([1 + a[:, 2], -a[:, 1], a[:, 0], np.zeros(len(a))], axis=1)
    return q / np.linalg.norm(q, axis=1)[:, None]
