"""A grid over each mesh, whose cells list the features that a grain in them may touch."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from labbook.scene import TriangleMesh, Wall
from labbook.scene.cells import Cells
from labbook.scene.wall_shape import WallShape
from labbook_dem.mesh import CONDITION_COLUMNS, F_FIRST, F_LAST, F_VERTICES, FEATURE_COLUMNS, mesh_table
from labbook_dem.mesh_rods import ROD_PARTS, rod_table


class MeshGrids(NamedTuple):
    """The meshes among W shapes of walls.

    Attributes:
        features: Of all meshes, as `labbook_dem.mesh` has them, shape [n, FEATURE_COLUMNS].
        conditions: Of these, shape [c, CONDITION_COLUMNS].
        frame: Of each shape, [W, 8]: lower corner of its grid [m], cells per metre, cells along x, y and z, and
            its first cell.
        first: First entry of each cell in `listed`, and behind the last, shape [cells + 1].
        listed: Features, ascending in each cell.
    """

    features: np.ndarray
    conditions: np.ndarray
    frame: np.ndarray
    first: np.ndarray
    listed: np.ndarray

    @classmethod
    def of(cls, shapes: Sequence[WallShape], reaches: Sequence[float], rods: bool = False) -> "MeshGrids":
        """Grids for grains whose centres are no farther from a feature of each shape than its reach [m]."""
        features, conditions = [np.zeros((0, FEATURE_COLUMNS))], [np.zeros((0, CONDITION_COLUMNS))]
        frame, begin = np.zeros((len(shapes), 8)), first_features(shapes, rods)
        parts = ROD_PARTS if rods else 1
        first, listed = [np.zeros(1, np.int64)], [np.zeros(0, np.int64)]
        for w, (shape, reach) in enumerate(zip(shapes, reaches, strict=True)):
            if not isinstance(shape, TriangleMesh):
                continue
            table = rod_table(shape) if rods else mesh_table(shape)
            grid = Cells.over(table.low[::parts] - reach, table.high[::parts] + reach, 2 * reach)
            frame[w] = *grid.low, 1 / grid.size, *grid.shape, sum(map(len, first)) - 1
            own = table.features.copy()
            own[:, F_FIRST : F_LAST + 1] += sum(map(len, conditions))
            own[:, F_VERTICES:] += 3 * parts * begin[w]  # of no other mesh
            first.append(grid.first[1:] + sum(map(len, listed)))
            listed.append(parts * grid.listed + begin[w])  # of a rod, the first of its parts
            features.append(own)
            conditions.append(table.conditions)
        arrays = map(np.concatenate, (features, conditions, first, listed))
        features, conditions, first, listed = arrays
        return cls(features, conditions, frame, first, listed)


def mesh_reach(reach: float, moves: float) -> float:
    """Distance [m] from a feature out to which a grain may touch it before it has moved by a distance [m]; reach: of
    the grain from its centre [m]."""
    return reach + 1.02 * moves


def shapes_of(walls: Sequence[Wall]) -> list[WallShape]:
    """Shapes of walls."""
    return [wall.shape for wall in walls]


def first_features(shapes: Sequence[WallShape], rods: bool = False) -> np.ndarray:
    """Number of the first feature of each shape among those of all meshes, and behind the last, shape [W + 1]."""
    table = rod_table if rods else mesh_table
    counts = [len(table(shape).features) if isinstance(shape, TriangleMesh) else 0 for shape in shapes]
    return np.cumsum([0, *counts])
