"""Packing of grains: positions, velocities and springs, free of any backend."""

from dataclasses import dataclass, field, replace

import numpy as np

from labbook.scene.grains import MOST_SPHERES
from labbook.warning import RenamedAttribute

_DOUBLE = ("x", "v", "omega")
_PER_GRAIN = {"diameter": np.float64, "kind": np.int64}
_SPRING_TYPES = {"pairs": "iu", "pair_spring": "f", "wall_grain": "iu", "wall_name": "U", "wall_spring": "f"}
_SPRING_TYPES |= {"wall_part": "iu"}
_ROLLING = {"pair_rolling": "pairs", "wall_rolling": "wall_grain"}
_WALL_PARTS = 1 << 31  # rods touch a wall at 4 points, spheres a mesh at as many features as it has


@dataclass(frozen=True, eq=False)
class Packing:
    """State of n grains, in double precision and SI, portable between backends.

    It has p contacts between grains, and k at walls. No backend can start from shapes that do not fit, indices of
    grains that are not there, numbers that are not finite or quaternions that are not of length one: these raise
    ValueError.

    Attributes:
        x: Positions [m], shape [n, 3].
        v: Velocities [m/s], shape [n, 3].
        omega: Angular velocities [rad/s], shape [n, 3].
        q: Unit quaternions (w, x, y, z), shape [n, 4], whose rotation takes the z axis to the rod's, or the body frame
            of a clump to space; None for spheres.
        ids: Names of the grains in every table, shape [n]; 0..n-1 unless grains have left.
        diameter: Diameters [m], shape [n]; None where all grains are of one diameter d.
        kind: Places in the scene's `grains.kinds`, shape [n]; None where all grains are of one kind.
        pairs: Grains (i, j) of contacts, rows of `x` with i < j, shape [p, 2].
        pair_spring: Friction springs of `pairs` [m], acting on i, shape [p, 3].
        pair_parts: Spheres of clumps that touch in `pairs`, by their places in i and j, shape [p, 2]; None for other
            grains.
        wall_grain: Grains of contacts at walls, rows of `x`, shape [k].
        wall_name: Names of these walls, shape [k].
        wall_spring: Friction springs at walls [m], acting on the grain, shape [k, 3].
        wall_part: Points of a rod at the wall, or features of a mesh; 0 for spheres at other walls, shape [k]. See
            `labbook_dem.walls`. Of clumps 8 times the feature, or 0, plus the place of the sphere.
        pair_rolling: Torques of rolling springs of `pairs` [N m], acting on i, shape [p, 3]; None where there are none.
        wall_rolling: Torques of rolling springs at walls [N m], shape [k, 3]; None where there are none.
        waiting: Mask of grains of a stream that have not entered, shape [n]; None where all have. These have no
            springs, and lie at random in the region of the stream, where they may overlap.
    """

    x: np.ndarray
    v: np.ndarray
    omega: np.ndarray
    q: np.ndarray | None = None
    ids: np.ndarray | None = None
    diameter: np.ndarray | None = None
    kind: np.ndarray | None = None
    pairs: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), np.int64))
    pair_spring: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    wall_grain: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    wall_name: np.ndarray = field(default_factory=lambda: np.zeros(0, "U40"))
    wall_spring: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    wall_part: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    pair_parts: np.ndarray | None = None
    pair_rolling: np.ndarray | None = None
    wall_rolling: np.ndarray | None = None
    waiting: np.ndarray | None = None

    def __post_init__(self):
        n = len(self.x)
        for name in _DOUBLE:
            array = np.ascontiguousarray(getattr(self, name), np.float64)
            if array.shape != (n, 3):
                raise ValueError(f"packing: {name} has shape {array.shape}, not ({n}, 3)")
            object.__setattr__(self, name, array)
        ids = np.arange(n) if self.ids is None else np.ascontiguousarray(self.ids, np.int64)
        object.__setattr__(self, "ids", ids)
        if len(ids) != n:
            raise ValueError(f"packing: {len(ids)} ids for {n} grains")
        for name, dtype in _PER_GRAIN.items():
            if (array := getattr(self, name)) is not None:
                object.__setattr__(self, name, np.ascontiguousarray(array, dtype))
                if np.shape(array) != (n,):
                    raise ValueError(f"packing: {name} has shape {np.shape(array)}, not ({n},)")
        if self.waiting is not None and (np.shape(self.waiting) != (n,) or np.asarray(self.waiting).dtype != bool):
            raise ValueError(f"packing: waiting is no mask of {n} grains")
        if len(self.wall_part) == 0:
            object.__setattr__(self, "wall_part", np.zeros(len(self.wall_grain), np.int64))
        if self.q is not None:
            object.__setattr__(self, "q", _quaternions(self.q, n))
        self._check_springs(n)
        for name in (*_DOUBLE, "pair_spring", "wall_spring", *_ROLLING):
            array = getattr(self, name)
            if array is None:
                continue
            if not np.isfinite(array).all():
                bad = ~np.isfinite(array).all(axis=1)
                raise ValueError(f"packing: {name} is not finite in row {int(np.argmax(bad))}")

    def _check_springs(self, n: int) -> None:
        pairs, walls = len(self.pairs), len(self.wall_grain)
        shapes = {"pairs": (pairs, 2), "pair_spring": (pairs, 3), "wall_grain": (walls,), "wall_name": (walls,)}
        for name, shape in (shapes | {"wall_spring": (walls, 3), "wall_part": (walls,)}).items():
            if np.shape(getattr(self, name)) != shape:
                raise ValueError(f"packing: {name} has shape {np.shape(getattr(self, name))}, not {shape}")
        for name, contacts in _ROLLING.items():
            array = getattr(self, name)
            if array is None:
                continue
            shape = (len(getattr(self, contacts)), 3)
            if np.shape(array) != shape:
                raise ValueError(f"packing: {name} has shape {np.shape(array)}, not {shape}")
            if np.asarray(array).dtype.kind != "f":
                raise ValueError(f"packing: {name} holds {np.asarray(array).dtype}")
        if (parts := self.pair_parts) is not None:
            if np.shape(parts) != (pairs, 2) or np.asarray(parts).dtype.kind not in "iu":
                raise ValueError(f"packing: pair_parts is no array of whole numbers of shape ({pairs}, 2)")
            if pairs and not (parts.min() >= 0 and parts.max() < MOST_SPHERES):
                raise ValueError(f"packing: pair_parts are not from 0 to {MOST_SPHERES - 1}")
        for name, kind in _SPRING_TYPES.items():
            if np.asarray(getattr(self, name)).dtype.kind not in kind:
                raise ValueError(f"packing: {name} holds {np.asarray(getattr(self, name)).dtype}")
        for name, limit in (("pairs", n), ("wall_grain", n), ("wall_part", _WALL_PARTS)):
            array = getattr(self, name)
            if len(array) and not (array.min() >= 0 and array.max() < limit):
                raise ValueError(f"packing: {name} are not from 0 to {limit - 1}")
        if not (self.pairs[:, 0] < self.pairs[:, 1]).all():
            raise ValueError("packing: pairs are not of a grain and a later one")

    def __len__(self) -> int:
        return len(self.x)

    @property
    def rolling(self) -> tuple[np.ndarray, np.ndarray]:
        """Torques [N m] of rolling springs of pairs, shape [p, 3], and at walls, shape [k, 3]; zero without any."""
        pairs, walls = self.pair_rolling, self.wall_rolling
        of_pairs = np.zeros((len(self.pairs), 3)) if pairs is None else pairs
        return of_pairs, np.zeros((len(self.wall_grain), 3)) if walls is None else walls

    def rows(self, ids: np.ndarray) -> np.ndarray:
        """Find grains by their names.

        Args:
            ids: Names of grains, all in the packing.

        Returns:
            Rows of these grains, of the shape of `ids`.
        """
        assert self.ids is not None
        order = np.argsort(self.ids)
        return order[np.searchsorted(self.ids, ids, sorter=order)]

    part = RenamedAttribute("subset")

    def subset(self, rows: np.ndarray) -> "Packing":
        """Select grains.

        Args:
            rows: Rows, or a mask of shape [n].

        Returns:
            Packing of these grains, without springs.
        """
        arrays = {name: getattr(self, name) for name in (*_DOUBLE, "ids", "q", *_PER_GRAIN)}
        return Packing(**{name: array[rows] for name, array in arrays.items() if array is not None})

    @property
    def entered(self) -> "Packing":
        """Packing without the grains that have not entered; itself if all have."""
        if self.waiting is None:
            return self
        present = ~self.waiting
        index = np.cumsum(present) - 1
        arrays = {name: getattr(self, name) for name in (*_DOUBLE, "ids", "q", *_PER_GRAIN)}
        own = {name: array[present] for name, array in arrays.items() if array is not None}
        return replace(self, **own, pairs=index[self.pairs], wall_grain=index[self.wall_grain], waiting=None)

    def mirrored(self) -> "Packing":
        """Mirror the packing in x = 0.

        x and v_x change sign; omega, an axial vector, and the rotation q change sign in y and z. Walls called left and
        right (`left`, `bottom-left` ...) swap names. Clumps have a mirror image in themselves only if they are
        symmetric in the plane x = 0 of their body frame, as those with all centres in a plane are.

        Returns:
            Mirror image.
        """
        mirror, axial = np.array([-1.0, 1, 1]), np.array([1.0, -1, -1])
        swapped = [_swap_sides(str(name)) for name in self.wall_name]
        rolling = {name: getattr(self, name) for name in _ROLLING}
        return replace(
            self,
            x=self.x * mirror,
            v=self.v * mirror,
            omega=self.omega * axial,
            q=None if self.q is None else self.q * [1, *axial],
            pair_spring=self.pair_spring * mirror,
            wall_name=np.array(swapped, "U40"),
            wall_spring=self.wall_spring * mirror,
            wall_part=self.wall_part,
            **{name: array * axial for name, array in rolling.items() if array is not None},
        )

    def renumbered(self, order: np.ndarray) -> "Packing":
        """Reorder the grains.

        Args:
            order: Row k of the result is row `order[k]` of the packing, shape [n].

        Returns:
            Packing in that order; ids go with the grains, springs with their contacts.
        """
        index = np.argsort(order)
        pairs = index[self.pairs]
        turned, parts = (pairs[:, 0] > pairs[:, 1])[:, None], self.pair_parts
        rows = {name: getattr(self, name) for name in (*_DOUBLE, "ids", "q", *_PER_GRAIN)}
        rolling = self.pair_rolling
        return replace(
            self,
            **{name: array[order] for name, array in rows.items() if array is not None},
            pairs=np.where(turned, pairs[:, ::-1], pairs),
            pair_spring=np.where(turned, -self.pair_spring, self.pair_spring),
            pair_parts=None if parts is None else np.where(turned, parts[:, ::-1], parts),
            pair_rolling=None if rolling is None else np.where(turned, -rolling, rolling),
            wall_grain=index[self.wall_grain],
            waiting=None if self.waiting is None else self.waiting[order],
        )

    def arrays(self) -> dict[str, np.ndarray]:
        """List the arrays for storage.

        Returns:
            Arrays by name; those that are None are left out.
        """
        names = (*_DOUBLE, "ids", "pairs", "pair_spring", "wall_grain", "wall_name", "wall_spring", "wall_part")
        arrays = {name: getattr(self, name) for name in names}
        optional = ("q", *_PER_GRAIN, "pair_parts", *_ROLLING, "waiting")
        extras = {name: array for name in optional if (array := getattr(self, name)) is not None}
        return {**arrays, **extras}


def _quaternions(q: np.ndarray, n: int) -> np.ndarray:
    q = np.ascontiguousarray(q, np.float64)
    if q.shape != (n, 4):
        raise ValueError(f"packing: q has shape {q.shape}, not ({n}, 4)")
    bad = ~(np.abs(np.linalg.norm(q, axis=1) - 1) < 1e-6)
    if bad.any():
        raise ValueError(f"packing: q is no unit quaternion in row {int(np.argmax(bad))}")
    return q


def _swap_sides(name: str) -> str:
    if "left" in name:
        return name.replace("left", "right")
    return name.replace("right", "left")
