"""The end of a member: what its slot held, from which packing and checkpoint follow in any process."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from labbook.backend import Checkpoint
from labbook.scene import Packing, Scene
from labbook_warp import transfer
from labbook_warp.arrays import SlotState


@dataclass(frozen=True, eq=False)
class SlotEnd:
    """See `labbook.backend.EndState`.

    Attributes:
        maker: Name and version of the backend.
        state: Arrays of the slot.
        numbers: Numbers that belong to the checkpoint.
        past_work: Work [J] of contacts on grains that have no row any more.
        scene: Scene of the member.
        v: Velocities at the whole step [m/s], by row, shape [n, 3].
        m: Reduced angular momenta at the whole step [rad/s], by row, shape [n, 3].
    """

    maker: tuple[str, int]
    state: SlotState
    numbers: dict[str, np.ndarray]
    past_work: np.ndarray
    scene: Scene
    v: np.ndarray
    m: np.ndarray

    @property
    def checkpoint(self) -> Checkpoint:
        """The exact state."""
        return self._checkpoint

    @property
    def packing(self) -> Packing:
        """The portable state."""
        return self._packing

    @cached_property
    def _checkpoint(self) -> Checkpoint:
        return Checkpoint(*self.maker, transfer.checkpoint(self.state, self.past_work) | self.numbers)

    @cached_property
    def _packing(self) -> Packing:
        return transfer.packing(self.state, self.scene, self.v, self.m)
