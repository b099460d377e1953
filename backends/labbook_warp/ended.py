"""State of a member at its end, from which packing and checkpoint follow in any process."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from labbook.backend import Checkpoint
from labbook.scene import Packing, Scene
from labbook_warp import transfer
from labbook_warp.arrays import SlotState


@dataclass(frozen=True, eq=False)
class SlotEnd:
    """Arrays of a slot at the end of its member; see `labbook.backend.EndState`.

    Attributes:
        maker: name and version of the backend.
        state: arrays of the slot.
        numbers: numbers of the checkpoint.
        past_work: work [J] of contacts on grains without a row.
        scene: scene of the member.
        v: velocities at the whole step [m/s], by row, shape [n, 3].
        m: reduced angular momenta at the whole step [rad/s], by row, shape [n, 3].
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
