"""Rows of frames as runs keep them, and those of the bed at rest before the opening."""

from dataclasses import dataclass

import numpy as np

from labbook.backend import Backend
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Table, Traction
from labbook.scene import Packing, Scene
from labbook.scene.wall_bins import all_walls

_WHOLE = {"id": np.int32, "i": np.int32, "j": np.int32, "wall": np.int16, "step": np.int64, "time": np.float64}
_WHOLE |= dict.fromkeys(("bin", "contacts", "sliding"), np.int32)


def frame_rows(table: Table) -> Table:
    """Rows of grains, contacts or walls in single precision, but for ids, step and time.

    Positions are then known to 1e-8 m and velocities to 1e-7 of themselves: far below what fields resolve.
    """
    return {name: np.asarray(column).astype(_WHOLE.get(name, np.float32)) for name, column in table.items()}


@dataclass(frozen=True)
class BeforeOpening:
    """Forces of walls on a bed at rest, in the scene of its filling: with the lid in place."""

    backend: Backend
    closed: Scene
    numerics: Numerics
    probe: Traction

    def rows(self, packing: Packing, scene: Scene) -> Table | None:
        """Rows of the probe at step 0, without the column `member`; None of a backend that cannot tell.

        Walls are numbered as `all_walls` does: those of the opened `scene` first.
        """
        table = self.backend.tractions(self.closed, self.numerics, packing, self.probe)
        if table is None:
            return None
        places = {wall.name: place for place, wall in enumerate(all_walls(scene.container))}
        number = np.array([places[wall.name] for wall in self.closed.container.walls()], np.int64)
        rows = {name: column for name, column in table.items() if name != "member"}
        return frame_rows({**rows, "wall": number[table["wall"]]})
