"""Random places for spheres of different sizes."""

import numpy as np

from labbook.protocol.room import Room, first_come, full

_ROUNDS = 2000
_NEARLY = 0.9


def place_graded(room: Room, rng: np.random.Generator, top: float, reach: np.ndarray) -> np.ndarray:
    """Centres [m], shape [n, 3], up to z = `top` of grains that keep `reach` [m], shape [n], free around them.

    Large grains come first, as they would find no room among small ones: at a time, those of nearly the largest size
    that is left, each of which tries one place a round. Raises PlacingError.
    """
    x, left = np.empty((len(reach), 3)), np.arange(len(reach))
    placed = left[:0]
    for _ in range(_ROUNDS):
        if len(left) == 0:
            return x
        trying = left[reach[left] >= _NEARLY * reach[left].max()]
        x[trying] = room.draw_each(rng, reach[trying], top)
        free = _free(x, reach, placed, trying[room.holds(x[trying], reach[trying])])
        placed = np.concatenate([placed, free])
        left = np.setdiff1d(left, free, assume_unique=True)
    raise full(len(reach))


def _free(x: np.ndarray, reach: np.ndarray, placed: np.ndarray, trying: np.ndarray) -> np.ndarray:
    """Those of the grains `trying`, in their order, that are in the way of neither grains `placed` nor each other."""
    from scipy.spatial import KDTree

    both = np.concatenate([placed, trying])
    kept = np.ones(len(both), bool)
    pairs = KDTree(x[both]).query_pairs(2 * reach.max(), output_type="ndarray")
    one, other = both[pairs].T
    near = np.linalg.norm(x[one] - x[other], axis=1) < reach[one] + reach[other]
    first_come(kept, pairs[near & (pairs[:, 1] >= len(placed))])
    return trying[kept[len(placed) :]]
