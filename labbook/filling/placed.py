"""Points that have found a place, and which of others come near them."""

import numpy as np

REBUILT = 0.25
"""Points that were added since the large tree was made, in parts of those in it, from which on it is made anew."""


class Placed:
    """Centres that are added a few at a time, and looked up between.

    Most of them are in one k-d tree, the latest in another one, so that adding few to many does not make a tree of all.
    """

    def __init__(self, x: np.ndarray):
        """x: the first [m], shape [n, 3], or [n, 4] with a coordinate that keeps groups apart."""
        self._x = np.empty((max(len(x), 16), x.shape[1]))
        self._count = 0
        self._trees, self._old = [], 0
        self.add(x)

    @property
    def x(self) -> np.ndarray:
        """All of them [m], shape [n, 3], in the order in which they were added."""
        return self._x[: self._count]

    def __len__(self) -> int:
        return self._count

    def add(self, x: np.ndarray) -> None:
        """Add centres [m], shape [n, 3]."""
        from scipy.spatial import KDTree

        if not len(x):
            return
        total = self._count + len(x)
        if total > len(self._x):
            grown = np.empty((max(total, 2 * len(self._x)), x.shape[1]))
            grown[: self._count] = self.x
            self._x = grown
        self._x[self._count : total] = x
        self._count = total
        if total - self._old > REBUILT * self._old:
            self._trees, self._old = [(0, KDTree(self.x))], total
        else:
            self._trees = [self._trees[0], (self._old, KDTree(self._x[self._old : total]))]

    def keep(self, x: np.ndarray, distance: float) -> np.ndarray:
        """Which of the points `x` [m], shape [m, 3], are at least `distance` from all of these."""
        kept = np.ones(len(x), bool)
        for _, tree in self._trees:
            if len(x):
                kept &= np.isinf(tree.query(x, distance_upper_bound=distance)[0])
        return kept

    def near(self, x: np.ndarray, distance: float) -> tuple[np.ndarray, np.ndarray]:
        """Pairs no further apart than `distance` [m]: places of these, and of the points `x`, each of shape [pairs]."""
        from scipy.spatial import KDTree

        if not len(x) or not self._trees:
            return np.empty(0, int), np.empty(0, int)
        of = KDTree(x)
        found = [
            (first, tree.sparse_distance_matrix(of, distance, output_type="ndarray")) for first, tree in self._trees
        ]
        return np.concatenate([first + one["i"] for first, one in found]), np.concatenate(
            [one["j"] for _, one in found]
        )
