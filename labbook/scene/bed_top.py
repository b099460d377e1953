"""Top of a bed, where grains enter."""

import math
from dataclasses import dataclass

import numpy as np

from labbook.scene.packing import Packing
from labbook.warning import RenamedAttribute


@dataclass(frozen=True, eq=False)
class BedTop:
    """Grains of a bed above a height, and the ids of all its grains.

    Attributes:
        present: Ids of all grains of the bed, in any order, shape [n].
        ids: Ids of the grains above the height, in any order, shape [m].
        x: Their centres [m], shape [m, 3].
        q: Their orientations, shape [m, 4]; None for spheres.
    """

    present: np.ndarray
    ids: np.ndarray
    x: np.ndarray
    q: np.ndarray | None = None

    @classmethod
    def of(cls, bed: Packing, height: float = -math.inf) -> "BedTop":
        """Select the grains of a bed whose centres are above `height` [m]."""
        assert bed.ids is not None
        return cls(bed.ids, bed.ids, bed.x, bed.q).subset(bed.x[:, 2] > height)

    part = RenamedAttribute("subset")

    def subset(self, mask: np.ndarray) -> "BedTop":
        """Select some of the grains above the height, by a mask of shape [m]."""
        return BedTop(self.present, self.ids[mask], self.x[mask], None if self.q is None else self.q[mask])
