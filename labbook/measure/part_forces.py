"""Forces, torques and power of parts that move."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Probe
from labbook.measure.data import RunData
from labbook.measure.measure import Evaluation, Measure, MeasureError, Quantity, Window, as_arrays
from labbook.measure.wall_stress import WallStress, steady_part
from labbook.scene import Scene, Wall
from labbook.stats import Measured
from labbook.stats.correlation import block_mean

NAME = "part_forces"
POWER, DRAG, TORQUE = "power.", "drag.", "torque."
"""Beginnings of the names of quantities of a part."""
_BLOCKS = 8
_FEWEST = 16


@dataclass(frozen=True)
class PartForces:
    """Forces of the grains on each of P parts that move, at n times.

    Attributes:
        names: Names of the parts, shape [P].
        time: Times since the opening [s], shape [n].
        force: Forces on the parts [N], shape [n, P, 3].
        torque: Torques on the parts about their origins, which move with them [N m], shape [n, P, 3].
        power: Power that the parts give to the grains [W], shape [n, P].
    """

    names: np.ndarray
    time: np.ndarray
    force: np.ndarray
    torque: np.ndarray
    power: np.ndarray


class MovingPartForces(Measure):
    """Measure forces of grains on moving parts, and the power that these give to the grains.

    Means are over the window of the flow rate, or over the second half of a run without an outlet. Errors are those of
    the means of eight blocks.

    Quantities:
        power.PART: Power that a part gives to the grains [W].
        drag.PART: Force of the grains against its constant velocity [N].
        torque.PART: Torque of the grains against its rotation, about the axis [N m].

    Arrays:
        names, time, force, torque, power: Those of `PartForces`.

    Raises:
        MeasureError: No part moves, or there is no gravity.
    """

    name = NAME
    version = 1
    declared = ()

    def check(self, scene: Scene) -> None:
        if not _moving(scene):
            raise MeasureError(f"{NAME}: no part moves", f"take {NAME} out of measure, or state moves of a part")
        WallStress().check(scene)

    def quantities(self, scene: Scene) -> tuple[Quantity, ...]:
        """List the quantities of each part that moves."""
        return tuple(quantity for part in _moving(scene) for quantity in _of_part(part))

    def probes(self, scene: Scene, numerics: Numerics) -> tuple[Probe, ...]:
        self.check(scene)
        return WallStress().probes(scene, numerics)

    def evaluate(self, run: RunData, window: Window) -> Evaluation:
        self.check(run.scene)
        if "traction" not in run.tables:
            raise MeasureError(f"{NAME}: the run recorded no forces of walls; run it again with this measure")
        record = _forces(run)
        return Evaluation(tuple(_numbers(run, record, window)), as_arrays(record))


def _moving(scene: Scene) -> list[Wall]:
    return [wall for wall in scene.container.walls() if wall.moves is not None]


def _of_part(part: Wall) -> Iterator[Quantity]:
    name, moves = part.name, part.moves
    assert moves is not None
    work = f"power that the part {name} gives to the grains"
    yield Quantity(f"{POWER}{name}", f"power of {name}", "W", work, "mW", 1e3, about_zero=True)
    if moves.velocity is not None and any(moves.velocity):
        against = f"force of the grains against the velocity of {name}"
        yield Quantity(f"{DRAG}{name}", f"drag on {name}", "N", against, "mN", 1e3, about_zero=True)
    if moves.rotation is not None:
        against = f"torque of the grains against the rotation of {name}"
        yield Quantity(f"{TORQUE}{name}", f"torque on {name}", "N m", against, "mN m", 1e3, about_zero=True)


def _forces(run: RunData) -> PartForces:
    """Sum the bins of each part, whose rows are forces and torques of walls on grains about the origin of space."""
    table, walls = run.tables["traction"], run.scene.container.walls()
    parts = [number for number, wall in enumerate(walls) if wall.moves is not None]
    steps, frame = np.unique(table["step"], return_inverse=True)
    time = steps * run.numerics.dt
    sums = np.zeros((len(steps), len(walls), 6))
    for column, name in enumerate(("fx", "fy", "fz", "tx", "ty", "tz")):
        # add.at: several bins of a wall add to one place, of which an assignment would keep the last.
        np.add.at(sums[..., column], (frame, np.asarray(table["wall"])), np.asarray(table[name], float))
    force, torque = sums[:, parts, :3], sums[:, parts, 3:]
    power, about_origin = np.zeros(force.shape[:2]), np.zeros_like(torque)
    for index, number in enumerate(parts):
        moves = walls[number].moves
        assert moves is not None
        poses = moves.poses(time)
        # Force and torque are about the origin of space, and `velocity` is that of the part there: so their sum is the
        # power, wherever the axis of the part is.
        power[:, index] = np.sum(force[:, index] * poses.velocity + torque[:, index] * poses.spin, axis=1)
        about_origin[:, index] = torque[:, index] - np.cross(poses.origin, force[:, index])
    names = np.array([walls[number].name for number in parts], "U40")
    return PartForces(names, time, -force, -about_origin, power)


def _numbers(run: RunData, record: PartForces, window: Window) -> Iterator[Measured]:
    begin, end, words = steady_part(run, window)
    within = (record.time >= begin) & (record.time <= end) & (record.time > 0)
    count = int(within.sum())
    for index, part in enumerate(_moving(run.scene)):
        moves = part.moves
        assert moves is not None
        series = {POWER: record.power[:, index]}
        if moves.velocity is not None and any(moves.velocity):
            series[DRAG] = -record.force[:, index] @ (np.array(moves.velocity) / math.hypot(*moves.velocity))
        if moves.rotation is not None:
            # With the sense of the rotation, so that a torque that resists is positive.
            axis = np.array(moves.rotation.axis) * math.copysign(1.0, moves.rotation.rate)
            series[TORQUE] = -record.torque[:, index] @ (axis / np.linalg.norm(axis))
        for quantity in _of_part(part):
            values = series[quantity.name[: -len(part.name)]][within]
            how, note = f"mean of {count} sampled steps; error from {_BLOCKS} blocks", ""
            value = error = math.nan
            if count < _FEWEST:
                note = f"only {count} samples within the window, fewer than {_FEWEST}"
            else:
                value, error = float(values.mean()), block_mean(values, _BLOCKS).error
            yield Measured(quantity.name, value, error, count, words, how, quantity.unit, note)
