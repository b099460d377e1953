"""One running scene: where it stands, and what it was started from."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from labbook_dem.ledger import energy_scale, kinetic

from labbook.backend import Checkpoint, Probe, Status
from labbook.numerics import Numerics
from labbook.protocol.packing import Packing
from labbook.scene import Scene


@dataclass(eq=False)
class Run:
    """A member. `begin`: what it starts from, until it has a slot."""

    scene: Scene
    numerics: Numerics
    probes: Sequence[Probe]
    begin: Packing | Checkpoint | None
    settled_below: float | None = None
    settled_beats: int = 3
    slot: int = -1
    rows: int = 0
    left: int = 0
    step: int = 0
    seen: int = 0
    """Beats on end at which it was settled."""
    failure: tuple[str, int, int, str] | None = None
    names: list[str] = field(default_factory=list)
    rebuilds: int = 0
    past_work: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """Work [J] of contacts on grains that have no row any more."""
    lattice: tuple[int, ...] = ()

    def __post_init__(self):
        self.names = [wall.name for wall in self.scene.container.walls()]
        if isinstance(self.begin, Checkpoint):
            self.takes_up(self.begin)
        elif self.begin is not None:
            self.rows = len(self.begin)

    def takes_up(self, stored: Checkpoint) -> None:
        """Stand where a checkpoint was taken; grains that had left by then have no row any more."""
        arrays = stored.arrays
        self.rows, self.left, self.past_work = len(arrays["ids"]), 0, arrays["past_work"]
        self.step, self.rebuilds = int(arrays["step"]), int(arrays["rebuilds"])

    @property
    def grains(self) -> int:
        """Grains that have not left."""
        return self.rows - self.left

    @property
    def time(self) -> float:
        """Time [s] since step 0."""
        return self.step * self.numerics.dt

    @property
    def going(self) -> bool:
        """Whether it takes steps."""
        return self.failure is None and self.grains > 0

    def status(self, energy: float) -> Status:
        """Where it stands, given its kinetic energy [J]."""
        return Status(self.step, self.time, self.grains, energy / max(self.grains, 1) / energy_scale(self.scene))

    def first_energy(self) -> float:
        """Kinetic energy [J] of the packing it starts from."""
        assert isinstance(self.begin, Packing)
        return kinetic(self.scene.grains, self.begin.v, self.begin.omega)
