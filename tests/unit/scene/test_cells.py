"""Grids over boxes."""

import numpy as np
import pytest

from labbook.scene.cells import Cells

RNG = np.random.default_rng(5)


@pytest.mark.parametrize("axes", [2, 3])
@pytest.mark.parametrize("size", [0.03, 0.2, 5.0])
def test_a_point_has_all_boxes_that_hold_it(axes, size):
    low = RNG.uniform(-1, 1, (60, axes))
    high = low + RNG.uniform(0, 0.5, (60, axes)) * RNG.integers(0, 2, (60, axes))  # some are flat
    x = np.concatenate([RNG.uniform(-1.5, 2, (500, axes)), low, high])
    point, box = Cells.over(low, high, size).near(x)
    holding = ((x[:, None] >= low) & (x[:, None] <= high)).all(axis=2)
    listed = np.zeros_like(holding)
    listed[point, box] = True
    assert not (holding & ~listed).any()
    assert len(np.unique(point * 60 + box)) == len(point)
    assert (np.diff(point) >= 0).all()


def test_a_cell_lists_each_owner_of_boxes_once():
    low = RNG.uniform(0, 1, (40, 3))
    owners = np.arange(40) // 4
    grid = Cells.over(low, low + 0.4, 0.1, owners)
    cells = np.repeat(np.arange(len(grid.first) - 1), np.diff(grid.first))
    pairs = np.column_stack([cells, grid.listed])
    assert len(np.unique(pairs, axis=0)) == len(pairs)
    assert set(grid.listed) == set(range(10))
    same = np.diff(cells) == 0
    assert (np.diff(grid.listed)[same] > 0).all()
