"""One running scene: where it stands, and what it was started from."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from labbook_dem.ensemble import UNKNOWN, Failure
from labbook_dem.ledger import kinetic
from labbook_dem.rotation import momenta

from labbook.backend import Checkpoint
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Probe
from labbook.scene import Bodies, Packing, Scene
from labbook_warp.parameters import cell_size, lattice
from labbook_warp.shapes import SHAPES


@dataclass(eq=False)
class Run:
    """A member. `begin`: what it starts from, until it has a slot."""

    scene: Scene
    numerics: Numerics
    probes: Sequence[Probe]
    begin: Packing | Checkpoint | None
    slot: int = -1
    rows: int = 0
    near: int = 0
    """Neighbours a grain for which the lists that it starts with have room."""
    left: int = 0
    step: int = 0
    failure: Failure | None = None
    names: list[str] = field(default_factory=list)
    rebuilds: int = 0
    most: tuple[float, float] = (0.0, 0.0)
    """Largest overlap [m] so far, and square of the largest speed, as it gets its slot."""
    past_work: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """Work [J] of contacts on grains that have no row any more."""
    lattice: tuple[int, ...] = ()
    """Cells along x, y, z."""
    crossed: np.ndarray = field(default_factory=lambda: np.zeros((0, 12)))
    """Rows of crossings of the last beat."""

    def __post_init__(self):
        self.names = [wall.name for wall in self.scene.container.walls()]
        if isinstance(self.begin, Checkpoint):
            self.takes_up(self.begin)
            positions = self.begin.arrays["origin"]
        else:
            assert self.begin is not None
            Bodies.of(self.scene.grains, self.begin)  # an error now, not when it gets a slot
            self.rows = len(self.begin)
            positions = self.begin.x
        self.lattice = lattice(positions, cell_size(self.scene, self.numerics), SHAPES[self.scene.grains.shape].reach)

    def takes_up(self, stored: Checkpoint) -> None:
        """Stand where a checkpoint was taken; grains that had left by then have no row any more."""
        arrays = stored.arrays
        self.rows, self.left, self.past_work = len(arrays["ids"]), 0, arrays["past_work"]
        self.near = len(arrays["nbr"])
        self.step, self.rebuilds = int(arrays["step"]), int(arrays["rebuilds"])
        deep, speed2 = arrays.get("most", (UNKNOWN, UNKNOWN))
        self.most = float(deep), float(speed2)

    @property
    def grains(self) -> int:
        """Grains that have not left."""
        return self.rows - self.left

    @property
    def cells(self) -> int:
        """Cells of its lattice."""
        return math.prod(self.lattice)

    def first_energy(self) -> float:
        """Kinetic energy [J] of the packing it starts from."""
        start = self.begin
        assert isinstance(start, Packing)
        grains = self.scene.grains
        m = momenta(grains, start.omega, start.q)
        return kinetic(Bodies.of(grains, start) if grains.varied else grains, start.v, m, start.q)
