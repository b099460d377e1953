"""Rows of frames as runs keep them, and those of the bed at rest before the opening."""

from dataclasses import dataclass

import numpy as np

from labbook.backend import Backend
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Table, Traction
from labbook.scene import Packing, Scene
from labbook.scene.wall_bins import all_walls

_COLUMN_TYPES = {"id": np.int32, "i": np.int32, "j": np.int32, "wall": np.int16, "step": np.int64, "time": np.float64}
_COLUMN_TYPES |= dict.fromkeys(("bin", "contacts", "sliding"), np.int32)


def frame_rows(table: Table) -> Table:
    """Convert rows to single precision, but for ids, step and time.

    Positions are then known to 1e-8 m and velocities to a relative 1e-7: far below what fields resolve.
    """
    return {name: np.asarray(column).astype(_COLUMN_TYPES.get(name, np.float32)) for name, column in table.items()}


@dataclass(frozen=True)
class BeforeOpening:
    """Forces of walls on a bed at rest, in the scene of its filling: with the lid in place.

    Args:
        backend: Computes the forces.
        closed: Scene of the filling.
        numerics: Numerics of the filling.
        probe: Probe of the forces.
    """

    backend: Backend
    closed: Scene
    numerics: Numerics
    probe: Traction

    def rows(self, packing: Packing, scene: Scene) -> Table | None:
        """Rows of the probe at step 0, without the column `member`; None if the backend cannot compute them.

        Walls are numbered as in `all_walls`: those of the opened `scene` first.
        """
        table = self.backend.tractions(self.closed, self.numerics, packing, self.probe)
        if table is None:
            return None
        wall_index = {wall.name: index for index, wall in enumerate(all_walls(scene.container))}
        number = np.array([wall_index[wall.name] for wall in self.closed.container.walls()], np.int64)
        rows = {name: column for name, column in table.items() if name != "member"}
        return frame_rows({**rows, "wall": number[table["wall"]]})
