"""Relaxation of overlapping grains: they are pushed apart until none overlap each other or a wall.

Every overlap moves both grains along the line between their nearest points, and turns rods, by their mobility there
(position-based dynamics: Müller et al., J. Vis. Commun. Image Represent. 18 (2007) 109). Each step repeats a part of
the step before (heavy ball: Polyak, USSR Comput. Math. Math. Phys. 4 (1964) 1). A lid keeps the grains together; it
rises while there are overlaps.
"""

import numpy as np

from labbook.filling.room import Room
from labbook.scene.orientation import axes, nearest, random_turns
from labbook.scene.periodic import nearest_images, tree
from labbook.scene.walls import WallShape

MARGIN = 0.005
"""Target gap, in sums of radii, so that the last overlaps vanish in few steps."""
_PART, _INERTIA = 0.5, 0.85  # of an overlap by which a step moves each grain; of a step that the next one repeats
_LONGEST = 0.25  # step, in radii
_SKIN = 0.25  # of the lists, in largest diameters
_STEPS, _RISES, _RISE = 60, 60, 0.01  # steps before the lid rises, how often it does, by which part of its height
_PATIENCE = 10  # rises, after which grains that still overlap are put elsewhere
_GROWTH = 30  # steps
_KICK = 0.02  # radii
_TRIES = 2000  # places of a grain
_CLEAR = 1e-6  # radii beyond what walls need
_CLASS = 0.6  # grains of this part of the largest radius that is left, and above, share a tree


class Crowd:
    """Grains of a room that may overlap: centres `x` [m], shape [n, 3], and axes `a` of rods, shape [n, 3].

    Args:
        room: The room.
        reach: Distance [m] that each grain keeps free around its centre or segment, shape [n].
        half: Half length of the segments of rods [m].
        rods: The grains are rods.
        beside: Distance of centres from walls at first [m].
    """

    def __init__(self, room: Room, reach: np.ndarray, half: float, rods: bool, beside: float):
        n = len(reach)
        self.x, self.a = np.zeros((n, 3)), np.zeros((n, 3)) if rods else None
        self._room, self._reach, self._half = room, reach, half
        self._beside = float(reach.max()) if rods else beside
        self._skin = 2 * _SKIN * float(reach.max())
        self._gyration = half**2 / 3 + 0.4 * float(np.mean(reach)) ** 2  # squared radius [m^2]
        self._step = np.zeros((n, 3)), np.zeros((n, 3))

    def scatter(self, rng: np.random.Generator, lid: float, rows: np.ndarray | None = None) -> int:
        """Put grains at random places below z = `lid` [m], overlapping or not.

        Spheres may overlap walls too, up to `beside` from their centres: otherwise too few would lie in narrow places.

        Args:
            rng: Generator.
            lid: Height of the lid [m].
            rows: Indices of the grains; None: all.

        Returns:
            Number of grains of the crowd that have a place.
        """
        reach, left = self._reach, np.arange(len(self.x)) if rows is None else rows
        self._reach = np.minimum(reach, self._beside)
        for _ in range(_TRIES):
            if not len(left):
                break
            self.x[left] = self._room.draw_each(rng, self._reach[left], lid - float(self._reach.min()))
            if self.a is not None:
                self.a[left] = axes(random_turns(rng, len(left)))
            left = left[~self._inside(left)]
        self._reach = reach
        return len(self.x) - len(left)

    def separate(self, rng: np.random.Generator, lid: float) -> bool:
        """Push the grains apart, below a lid at z = `lid` [m] that rises if necessary.

        Rods grow from their centres meanwhile: two that crossed each other could not separate in a narrow container.

        Returns:
            True if no overlap is left.
        """
        whole = self._half
        for step in range(_GROWTH if whole else 0):
            self._half = whole * step / _GROWTH
            self._list(lid)
            self._push()
        self._half = whole
        for rise in range(_RISES):
            if rise % _PATIENCE == _PATIENCE - 1:
                self.scatter(rng, lid, self._stuck())
            self._list(lid)
            for _ in range(_STEPS):
                if self._strayed():
                    self._list(lid)
                if self._push():
                    continue
                self._list(lid)  # lists tell only roughly how far curved walls are
                if self._push():
                    continue
                lost = np.flatnonzero(~self._inside())
                if not len(lost):
                    return True
                self.scatter(rng, lid, lost)
                self._list(lid)
            lid += _RISE * (lid - self._room.bottom)
            # a row of grains that just fits between two walls stays straight unless it is disturbed
            self._step = _KICK * self._reach[:, None] * rng.normal(size=self.x.shape), self._step[1]
        return False

    def _stuck(self) -> np.ndarray:
        """Find grains that overlap a wall, or a grain of a lower index."""
        overlaps = self._branches(self._i, self._j)[1] < self._least
        later = np.maximum(self._i, self._j)[overlaps]
        return np.unique(np.concatenate([later, self._end[self._gaps() < 0] % len(self.x)]))

    def _inside(self, rows: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Mark the grains in `rows` that are in the room and clear of its walls."""
        ends, reach = self._ends(rows), self._reach[rows]
        return np.all(self._room.holds(ends, np.resize(reach, len(ends))).reshape(-1, len(reach)), axis=0)

    def _ends(self, rows: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Centres of spheres, or one end and then the other of rods' segments [m]; shape [n or 2 n, 3]."""
        x = self.x[rows]
        return x if self.a is None else np.concatenate([x + s * self.a[rows] for s in (self._half, -self._half)])

    def _strayed(self) -> bool:
        """True if an end has moved too far for the lists."""
        away = self._ends() - self._at
        return 4 * float(np.einsum("ij,ij->i", away, away).max()) > self._skin**2

    def _list(self, lid: float) -> None:
        """List near pairs, and ends near walls with their gaps [m] and the normals along which these grow."""
        self.x = nearest_images(self.x, self._room.period)
        i, j = _near(self.x, self._reach + self._half, self._skin, self._room.period)
        if self.a is not None:
            close = self._branches(i, j)[1] < self._reach[i] + self._reach[j] + self._skin
            i, j = i[close], j[close]
        self._i, self._j, self._least = i, j, self._reach[i] + self._reach[j]
        self._at = ends = self._ends().copy()
        reach = np.resize(self._reach, len(ends))
        high = np.flatnonzero(ends[:, 2] + reach + self._skin > lid)
        down = np.tile([0.0, 0.0, -1.0], (len(high), 1))
        walls = [(high, lid - ends[high, 2], down)]
        walls += [_beside(shape, ends, reach + self._skin) for shape in self._room.shapes]
        self._end, gap, self._normal = (np.concatenate(parts) for parts in zip(*walls, strict=True))
        self._wall_reach = reach[self._end]
        self._gap = gap - self._wall_reach

    def _branches(self, i: np.ndarray, j: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Compute branch vectors between the nearest points of grains i and j.

        Returns:
            Branch vectors [m], shape [m, 3], their lengths [m], and for rods the positions [m] of the nearest points on
            both segments, shape [2, m].
        """
        branch = nearest_images(_rows(self.x, i) - _rows(self.x, j), self._room.period)
        if self.a is None:
            return branch, _length(branch), None
        lever_lengths = np.array(nearest(branch, self.a[i], self.a[j], self._half))
        branch += lever_lengths[0][:, None] * self.a[i] - lever_lengths[1][:, None] * self.a[j]
        return branch, _length(branch), lever_lengths

    def _gaps(self) -> np.ndarray:
        """Gaps [m] between the listed ends and walls."""
        away = _rows(self._ends() - self._at, self._end)
        return self._gap + np.einsum("ij,ij->i", away, self._normal)

    def _push(self) -> bool:
        """Take one step if any grains overlap, or a grain and a wall; True if it did."""
        branch, distance, lever_lengths = self._branches(self._i, self._j)
        if (distance >= self._least).all() and (self._gaps() >= 0).all():
            return False
        overlap = self._least * (1 + MARGIN) - distance
        hit = (overlap > 0).nonzero()[0]
        along = _rows(branch, hit) / np.maximum(distance[hit], 1e-3 * self._least[hit])[:, None]
        by = (_PART * overlap[hit])[:, None] * along
        both = np.concatenate([self._i[hit], self._j[hit]])
        lever_lengths = None if lever_lengths is None else lever_lengths[:, hit].ravel()
        dx, da = self._shifts(both, np.concatenate([by, -by]), lever_lengths)
        x, a = self.x, self.a
        dx += _INERTIA * self._step[0]
        dx *= np.minimum(1, _LONGEST * self._reach / np.maximum(_length(dx), 1e-300))[:, None]
        self.x = x + dx
        if a is not None:
            da += _INERTIA * self._step[1]
            da *= np.minimum(1, _LONGEST * self._reach / np.maximum(self._half * _length(da), 1e-300))[:, None]
            self.a = _unit(a + da)
        self._clear_walls()
        self._step = self.x - x, da if a is None or self.a is None else self.a - a
        return True

    def _clear_walls(self) -> None:
        """Move ends that overlap a wall out of it."""
        short = _CLEAR * self._wall_reach - self._gaps()
        out = (short > 0).nonzero()[0]
        end, n = self._end[out], len(self.x)
        lever_lengths = None if self.a is None else np.where(end < n, self._half, -self._half)
        dx, da = self._shifts(end % n, short[out, None] * self._normal[out], lever_lengths)
        self.x = self.x + dx
        if self.a is not None:
            self.a = _unit(self.a + da)

    def _shifts(
        self, grains: np.ndarray, by: np.ndarray, lever_lengths: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Distribute displacements at points of grains over translations and rotations, by mobility.

        Args:
            grains: Indices of the grains, shape [m].
            by: Displacements of the points [m], shape [m, 3].
            lever_lengths: Positions of the points on the segments of rods [m], shape [m]; None for spheres.

        Returns:
            Displacements [m] of all grains and changes of their axes, each of shape [n, 3].
        """
        n = len(self.x)
        if self.a is None or lever_lengths is None:
            return _summed(grains, by, n), self._step[1]
        a = self.a[grains]
        by = by / (1 + lever_lengths**2 / self._gyration)[:, None]
        turns = (lever_lengths / self._gyration)[:, None] * (by - np.einsum("ij,ij->i", by, a)[:, None] * a)
        return _summed(grains, by, n), _summed(grains, turns, n)


def _near(x: np.ndarray, reach: np.ndarray, skin: float, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Find pairs of points x [m], shape [n, 3], closer than the sum of their `reach` [m] and `skin` [m].

    Points of about one size share a tree, so that the largest ones do not set the search radius of small ones. period:
    distance [m] of periodic sides along y.
    """
    classes, left = [], np.argsort(-reach, kind="stable")
    while len(left):
        first = int(np.searchsorted(-reach[left], -_CLASS * reach[left[0]], "right"))
        classes.append((left[:first], tree(x[left[:first]], period)))
        left = left[first:]
    pairs = []
    for k, (larger, larger_tree) in enumerate(classes):
        largest = reach[larger[0]]
        pairs.append(larger[larger_tree.query_pairs(2 * largest + skin, output_type="ndarray")])
        for smaller, second in classes[k + 1 :]:
            near = larger_tree.sparse_distance_matrix(second, largest + reach[smaller[0]] + skin, output_type="ndarray")
            pairs.append(np.column_stack([larger[near["i"]], smaller[near["j"]]]))
    i, j = np.concatenate(pairs).T
    if reach[i].min(initial=np.inf) < reach.max():
        close = _length(nearest_images(x[i] - x[j], period)) < reach[i] + reach[j] + skin
        i, j = i[close], j[close]
    return i, j


def _beside(shape: WallShape, x: np.ndarray, within: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Select the points x [m], shape [n, 3], nearer to a wall than `within` [m], shape [n].

    Returns:
        Their indices, their distances [m] from it, and the unit vectors along which these grow.
    """
    step, widest = 1e-5 * float(within.max()), float(within.max())
    distance = shape.clearance(x, widest)
    near = (distance < within).nonzero()[0]
    if not len(near):
        return near, distance[near], x[near]
    shifted = x[near] + step * np.eye(3)[:, None]
    slope = shape.clearance(shifted.reshape(-1, 3), widest + 2 * step).reshape(3, -1) - distance[near]
    return near, distance[near], _unit(slope.T)


def _length(x: np.ndarray) -> np.ndarray:
    return np.sqrt(np.einsum("ij,ij->i", x, x))


def _unit(x: np.ndarray) -> np.ndarray:
    return x / np.maximum(_length(x), 1e-300)[:, None]


def _summed(rows: np.ndarray, values: np.ndarray, n: int) -> np.ndarray:
    """Sums of `values`, shape [m, 3], by row, shape [n, 3]."""
    sums = np.empty((n, 3))
    for axis in range(3):
        sums[:, axis] = np.bincount(rows, values[:, axis], n)
    return sums


def _rows(values: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Rows of an array, shape [m, 3]; faster than indexing."""
    return values.take(rows, axis=0)
