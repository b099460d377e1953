"""Set of placed points, with fast searches for neighbours of others."""

import numpy as np

REBUILT = 0.25
"""Number of added points, as a part of the points in the large tree, above which that tree is built again."""


class PlacedCentres:
    """Set of centres that grows by a few at a time and is searched in between.

    Most centres are in one k-d tree, the latest in another: adding a few to many does not rebuild a tree of all.
    """

    def __init__(self, x: np.ndarray):
        """Start with centres `x` [m], shape [n, 3], or [n, 4] with a coordinate that separates groups."""
        self._x = np.empty((max(len(x), 16), x.shape[1]))
        self._count = 0
        self._trees, self._old = [], 0
        self.add(x)

    @property
    def x(self) -> np.ndarray:
        """All centres [m], shape [n, 3], in the order of their addition."""
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
        """Mark the points `x` [m], shape [m, 3], that are at least `distance` [m] from all centres."""
        far = np.ones(len(x), bool)
        for _, tree in self._trees:
            if len(x):
                far &= np.isinf(tree.query(x, distance_upper_bound=distance)[0])
        return far

    def near(self, x: np.ndarray, distance: float) -> tuple[np.ndarray, np.ndarray]:
        """Find pairs no further apart than `distance` [m]: indices of centres, and of the points `x`, shape [pairs]."""
        from scipy.spatial import KDTree

        if not len(x) or not self._trees:
            return np.empty(0, int), np.empty(0, int)
        of = KDTree(x)
        matrices = [
            (first, tree.sparse_distance_matrix(of, distance, output_type="ndarray")) for first, tree in self._trees
        ]
        return np.concatenate([first + matrix["i"] for first, matrix in matrices]), np.concatenate(
            [matrix["j"] for _, matrix in matrices]
        )
