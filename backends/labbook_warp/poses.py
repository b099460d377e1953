"""Poses of the parts that move, of an ensemble's members on its device: for the steps of a beat."""

from collections.abc import Collection
from typing import Any

import numpy as np
import warp as wp
from labbook_dem.features import mesh_moves, part_speed, pose_table
from labbook_dem.mesh_grid import mesh_reach

from labbook.scene.part_motion import POSE_COLUMNS
from labbook_warp.arrays import send
from labbook_warp.run import Run

NEVER = 1 << 40
"""Steps in which a part that stands still moves by half a skin."""
SHARE = 0.8
"""Share of half a skin by which a part may move before lists are built again: the rest is for the steps between two
checks (`labbook_warp.stage.check_interval`)."""


class PoseTables:
    """Poses of moving parts on the device, by slot, step and part. Part 0 of each member stands still.

    Args:
        device: Where they are.
        steps: Steps of a beat.
    """

    def __init__(self, device: wp.Device, steps: int):
        self._device, self._steps = device, steps + 2  # the step before, and the one after
        self._parts, self._slots = 0, 0
        self._first: dict[int, int] = {}
        """Step of the first row of each slot."""
        self._arrays: dict[str, Any] = {}
        self._every = np.zeros(0, np.int64)

    def cover(self, runs: Collection[Run], slots: int) -> bool:
        """Have room for these members among so many slots; True if the arrays are new."""
        parts = 1 + max((len(_moving(run)) for run in runs), default=0)
        if parts <= self._parts and slots == self._slots:
            return False
        self._parts, self._slots, self._first = max(parts, self._parts), slots, {}
        self._every = np.full(slots, NEVER)
        pose = wp.zeros((slots * self._steps, self._parts, POSE_COLUMNS), dtype=wp.float64, device=self._device)
        rows = wp.zeros(slots, dtype=wp.int32, device=self._device)
        steps, every = (wp.zeros(slots, dtype=wp.int64, device=self._device) for _ in range(2))
        self._arrays = {"pose": pose, "pose_row": rows, "pose_step": steps, "pose_every": every}
        return True

    def put(self, system: Any) -> None:
        """Let kernels that take `system` use these tables."""
        for name, array in self._arrays.items():
            setattr(system, name, array)

    def of(self, run: Run) -> np.ndarray:
        """Part of each wall of a member."""
        moving = _moving(run)
        return np.array([1 + moving.index(w) if w in moving else 0 for w in range(len(run.names))], np.int32)

    def bring(self, runs: Collection[Run], stepping: Collection[Run]) -> None:
        """Bring the poses of members to where they are now, and of those that are `stepping` for the next beat."""
        slot_numbers = np.zeros(self._slots, np.int32)
        steps = np.zeros(self._slots, np.int64)
        for run in runs:
            first = self._first.get(run.slot)
            if run in stepping or first is None or not first < run.step < first + self._steps:
                self._write(run)
            slot_numbers[run.slot] = run.slot * self._steps + run.step - self._first[run.slot]
            steps[run.slot] = run.step
        self._arrays["pose_row"].assign(slot_numbers)
        self._arrays["pose_step"].assign(steps)
        self._arrays["pose_every"].assign(self._every)

    def _write(self, run: Run) -> None:
        """Write the poses of a member from the last step on."""
        first = self._first[run.slot] = run.step - 1
        table = pose_table(run.scene, first, run.step + self._steps - 2, run.numerics.dt)
        pose = np.zeros((self._steps, self._parts, POSE_COLUMNS))
        pose[:, 0, [0, 4, 8]] = 1.0
        moving = _moving(run)
        pose[:, 1 : 1 + len(moving)] = table[:, moving]
        size = self._steps * self._parts * POSE_COLUMNS
        send(pose.ravel(), self._arrays["pose"].flatten(), run.slot * size)
        self._every[run.slot] = steps_of_part(run)


def steps_of_part(run: Run) -> int:
    """Steps after which lists are built again because of parts that move, at most."""
    scene, numerics = run.scene, run.numerics
    moves = mesh_moves(scene, numerics)
    grains = scene.grains
    travel = part_speed(scene, mesh_reach(grains.reach, moves)) * numerics.dt
    return max(1, int(SHARE * 0.5 * moves / travel)) if travel > 0 else NEVER


def _moving(run: Run) -> list[int]:
    """Walls of a member that move as a whole, or vanish at a time."""
    return [w for w, wall in enumerate(run.scene.container.walls()) if wall.is_posed]
