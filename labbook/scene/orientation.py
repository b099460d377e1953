"""Orientations and distances of rods that are about to be placed."""

import numpy as np


def random_turns(rng: np.random.Generator, n: int) -> np.ndarray:
    """Unit quaternions of n random orientations, shape [n, 4]: none is likelier than another."""
    q = rng.normal(size=(n, 4))
    return q / np.linalg.norm(q, axis=1)[:, None]


def axes(q: np.ndarray) -> np.ndarray:
    """Unit vectors [n, 3] to which the rotations q [n, 4] (w, x, y, z) take the z axis."""
    w, x, y, z = q.T
    return np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=1)


def distances(c: np.ndarray, a: np.ndarray, b: np.ndarray, half: float) -> np.ndarray:
    """Shortest distances [m] between segments of half length `half` [m] along unit vectors a and b, shape [n, 3].

    c: branch from the centre of the second to that of the first [m]. A pair of points in the inside of both, or one of
    the four ends and the point nearest to it: the smallest of these is exact, parallel or not.
    """
    ca, cb, ab = (np.sum(u * v, axis=1) for u, v in ((c, a), (c, b), (a, b)))
    across = np.maximum(1 - ab**2, 1e-12)
    s, t = (ab * cb - ca) / across, (cb - ab * ca) / across
    inside = (np.abs(s) <= half) & (np.abs(t) <= half)
    tries = [np.where(inside, _apart(c, a, b, s, t), np.inf)]
    for end in (-half, half):
        tries.append(_apart(c, a, b, np.full(len(c), end), np.clip(cb + end * ab, -half, half)))
        tries.append(_apart(c, a, b, np.clip(end * ab - ca, -half, half), np.full(len(c), end)))
    return np.min(tries, axis=0)


def _apart(c: np.ndarray, a: np.ndarray, b: np.ndarray, s: np.ndarray, t: np.ndarray) -> np.ndarray:
    return np.linalg.norm(c + s[:, None] * a - t[:, None] * b, axis=1)
