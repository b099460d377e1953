"""Tables of the meshes of an ensemble's members on its device, each once, whichever members have it."""

from collections.abc import Collection
from typing import Any

import numpy as np
import warp as wp
from labbook_dem.features import has_rods, mesh_moves
from labbook_dem.mesh_grid import MeshGrids, first_features, mesh_reach, shapes_of

from labbook.scene import Clumps, TriangleMesh
from labbook_warp.run import Run

Key = tuple[TriangleMesh, float]
"""A mesh, and the distance [m] out to which features are listed."""


class MeshTables:
    """Tables of meshes; see above."""

    def __init__(self, device: wp.Device):
        self._device = device
        self._rows: dict[Key, int] = {}
        self._arrays: dict[str, Any] = {}

    def cover(self, runs: Collection[Run]) -> bool:
        """Make tables of all meshes of these members, unless they are there already; True if they are new."""
        needed = dict.fromkeys(key for run in runs for key in _keys(run) if key)
        if needed.keys() <= self._rows.keys():
            return False
        self._rows = {key: row for row, key in enumerate(needed)}
        shapes = [shape for shape, _ in needed]
        rods = any(has_rods(run.scene) for run in runs)
        grids = MeshGrids.of(shapes, [reach for _, reach in needed], rods)
        wide = {
            "mesh_frame": grids.frame,
            "mesh_features": grids.features,
            "mesh_conditions": grids.conditions,
        }
        whole = {"mesh_begin": first_features(shapes, rods), "mesh_cell": grids.first, "mesh_listed": grids.listed}
        self._arrays = {name: wp.array(table, dtype=wp.float64, device=self._device) for name, table in wide.items()}
        for name, table in whole.items():
            self._arrays[name] = wp.array(table.astype(np.int32), dtype=wp.int32, device=self._device)
        return True

    def put(self, system: Any) -> None:
        """Let kernels that take `system` use these tables."""
        for name, array in self._arrays.items():
            setattr(system, name, array)

    def of(self, run: Run) -> np.ndarray:
        """Row of the mesh of each wall of a member, -1 of other walls."""
        return np.array([self._rows[key] if key else -1 for key in _keys(run)], np.int32)


def _keys(run: Run) -> list[Key | None]:
    """The mesh of each wall of a member."""
    grains = run.scene.grains
    reach = grains.radius if isinstance(grains, Clumps) else grains.reach  # rows of clumps are spheres
    reach = mesh_reach(reach, mesh_moves(run.scene, run.numerics))
    shapes = shapes_of(run.scene.container.walls())
    return [(shape, reach) if isinstance(shape, TriangleMesh) else None for shape in shapes]
