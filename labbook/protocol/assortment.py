"""Which grain is of which kind and size: drawn by the seed, once for all that comes of it."""

import numpy as np

from labbook.scene import Spheres

_STREAM = 1
"""Told from the placing's random numbers by this."""


def assort(grains: Spheres, version: int, seed: int) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Diameters [m] and kinds (places in `grains.kinds`) by id, each of shape [count]; None where all are alike.

    Of each kind there are as many as its share says, to the nearest whole grain; who they are is drawn, and so is each
    diameter. `version`: of the rules that place the grains.
    """
    rng = np.random.default_rng([version, seed, _STREAM])
    numbers = whole_numbers(np.array([part.share for part in grains.parts]), grains.count)
    kind = rng.permutation(np.repeat(np.arange(len(numbers)), numbers))
    diameter = np.full(grains.count, grains.diameter)
    for index, part in enumerate(grains.parts):
        mine = kind == index
        diameter[mine] = part.sizes.draw(rng, int(mine.sum()), grains.diameter)
    return diameter if grains.graded else None, kind if grains.kinds else None


def whole_numbers(shares: np.ndarray, total: int) -> np.ndarray:
    """Whole numbers that add up to `total`, each within one of its share: the largest remainders are rounded up."""
    exact = shares / shares.sum() * total
    numbers = np.floor(exact).astype(int)
    short = total - int(numbers.sum())
    numbers[np.argsort(-(exact - numbers), kind="stable")[:short]] += 1
    return numbers
