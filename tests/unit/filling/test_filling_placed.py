"""Points that are added a few at a time are found as if all had been there at once."""

import numpy as np
import pytest

from labbook.filling import placed_centres as module
from labbook.filling.placed_centres import PlacedCentres

DISTANCE = 0.15


def gaps(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """All distances, shape [len(x), len(y)]."""
    return np.linalg.norm(x[:, None] - y[None], axis=-1)


@pytest.mark.parametrize("steps", [[300], [1] * 40, [100, 1, 30, 0, 5, 200, 2], []])
def test_nothing_that_is_near_is_missed(steps):
    rng = np.random.default_rng(len(steps))
    there, asked = PlacedCentres(np.empty((0, 3))), rng.random((60, 3))
    known = np.empty((0, 3))
    for count in steps:
        new = rng.random((count, 3))
        there.add(new)
        known = np.concatenate([known, new])
        assert np.array_equal(there.x, known)
        assert len(there) == len(known)
        apart = gaps(known, asked)
        assert np.array_equal(there.keep(asked, DISTANCE), (apart >= DISTANCE).all(axis=0))
        pairs = set(zip(*map(np.ndarray.tolist, there.near(asked, DISTANCE)), strict=True))
        assert pairs == set(map(tuple, np.argwhere(apart <= DISTANCE).tolist()))
    assert there.keep(asked[:0], DISTANCE).shape == (0,)


def test_few_more_do_not_make_a_tree_of_all(monkeypatch):
    from scipy import spatial

    made, tree = [], spatial.KDTree
    monkeypatch.setattr(spatial, "KDTree", lambda x: made.append(len(x)) or tree(x))
    rng = np.random.default_rng(0)
    there = PlacedCentres(rng.random((10_000, 3)))
    for _ in range(100):
        there.add(rng.random((10, 3)))
    assert made[0] == 10_000
    assert max(made[1:]) <= 10_000 * module.REBUILT


def test_a_point_at_the_distance_is_not_in_the_way():
    there = PlacedCentres(np.zeros((1, 3)))
    asked = np.array([[1.0, 0, 0], [np.nextafter(1.0, 0), 0, 0]])
    assert there.keep(asked, 1.0).tolist() == [True, False]
