"""State of a member on the host: its progress and its start."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from labbook_dem.clump_rows import rows_of_grain
from labbook_dem.ensemble import NOT_RECORDED, Failure
from labbook_dem.ledger import kinetic
from labbook_dem.rotation import momenta

from labbook.backend import Checkpoint
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Probe
from labbook.scene import Bodies, Clumps, Packing, Scene
from labbook.scene.hulls import sphere_centres
from labbook_warp.parameters import cell_size, lattice
from labbook_warp.shapes import SHAPES


@dataclass(eq=False)
class Run:
    """A member of an ensemble.

    Attributes:
        begin: packing or checkpoint to start from, until the member has a slot.
        slot: number of its slot, -1 without one.
        rows: rows of its slot, including grains that have left.
        left: those of these rows whose grain has left.
        names: names of its walls.
    """

    scene: Scene
    numerics: Numerics
    probes: Sequence[Probe]
    begin: Packing | Checkpoint | None
    slot: int = -1
    rows: int = 0
    near: int = 0
    """Capacity of the neighbour lists of its checkpoint, 0 for a packing."""
    left: int = 0
    step: int = 0
    failure: Failure | None = None
    names: list[str] = field(default_factory=list)
    rebuilds: int = 0
    start_extremes: tuple[float, float] = (0.0, 0.0)
    """Largest overlap [m] and square of the largest speed [m^2/s^2] at the time it gets a slot."""
    past_work: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """Work [J] of contacts on grains without a row."""
    lattice: tuple[int, ...] = ()
    """Numbers of cells along x, y, z."""
    ids: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    """Ids of the rows (`labbook_dem.clump_rows`); shorter than `rows` until they are read from the device."""
    free: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    """Rows whose grain left before the last beat: no list refers to them any more, and another grain may take them."""
    empty: np.ndarray = field(default_factory=lambda: np.zeros(0, bool))
    """Mask of the rows whose grain had left when they were last read, at the step `read_at`."""
    read_at: int = -1
    crossed: np.ndarray = field(default_factory=lambda: np.zeros((0, 12)))
    """Rows of crossings of the last beat."""

    def __post_init__(self):
        """Set names of walls, number of grains, counters of a checkpoint, and lattice of cells."""
        self.names = [wall.name for wall in self.scene.container.walls()]
        if isinstance(self.begin, Checkpoint):
            self.takes_up(self.begin)
            positions = self.begin.arrays["origin"]
        else:
            assert self.begin is not None
            grains, q = self.scene.grains, self.begin.q
            Bodies.of(grains, self.begin)  # an error now, not when it gets a slot
            self.rows = len(self.begin) * self.per_grain
            positions = self.begin.x
            if isinstance(grains, Clumps) and q is not None:
                positions = sphere_centres(grains, positions, q)
        cell, reach = cell_size(self.scene, self.numerics), SHAPES[self.scene.grains.shape].reach
        self.lattice = lattice(positions, cell, reach, self.scene.container.period)

    def takes_up(self, stored: Checkpoint) -> None:
        """Take over the counters of a checkpoint, which has no rows of grains that had left."""
        arrays = stored.arrays
        self.rows, self.left, self.past_work = len(arrays["ids"]), 0, arrays["past_work"]
        self.ids = arrays["ids"].astype(np.int64)
        self.free, self.empty, self.read_at = np.zeros(0, np.int64), np.zeros(0, bool), -1
        self.near = len(arrays["nbr"])
        self.step, self.rebuilds = int(arrays["step"]), int(arrays["rebuilds"])
        deep, speed2 = arrays.get("most", (NOT_RECORDED, NOT_RECORDED))
        self.start_extremes = float(deep), float(speed2)

    def note_empty(self, empty: np.ndarray) -> None:
        """Note the rows whose grain has left by now, a mask of shape [rows]."""
        if self.step != self.read_at:
            self.free = np.flatnonzero(empty[: len(self.empty)] & self.empty)
            self.empty, self.read_at = empty.copy(), self.step

    def takes(self, grains: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Give rows to these grains: free ones, then some behind the others.

        Args:
            grains: ids of the rows, shape [n].

        Returns:
            All their rows, shape [n], and those of them that other grains had.
        """
        again, self.free = self.free[: len(grains)], self.free[len(grains) :]
        behind = self.rows + np.arange(len(grains) - len(again))
        rows = np.concatenate([again, behind])
        self.ids = np.concatenate([self.ids, np.zeros(len(behind), np.int64)])
        self.ids[rows] = grains
        self.empty[again] = False
        self.rows, self.left = self.rows + len(behind), self.left - len(again)
        return rows, again

    @property
    def per_grain(self) -> int:
        """Rows of a grain: its spheres, if it is a clump."""
        return rows_of_grain(self.scene)

    @property
    def grains(self) -> int:
        """Number of grains that have not left."""
        return (self.rows - self.left) // self.per_grain

    @property
    def cells(self) -> int:
        """Number of cells of its lattice."""
        return math.prod(self.lattice)

    def first_energy(self) -> float:
        """Kinetic energy [J] of the packing it starts from."""
        start = self.begin
        assert isinstance(start, Packing)
        grains = self.scene.grains
        m = momenta(grains, start.omega, start.q)
        return kinetic(Bodies.of(grains, start) if grains.varied else grains, start.v, m, start.q)
