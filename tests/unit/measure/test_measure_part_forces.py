"""Forces, torques and power of parts that move, from frames of known forces."""

import math

import numpy as np
import pytest

from labbook.backend.numerics import Numerics
from labbook.checks.verify.materials import G, floor, linear, scene
from labbook.checks.verify.mesh import of_triangles, sheet
from labbook.checks.verify.platform import grains_at
from labbook.measure import MEASURES, MeasureError, RunData
from labbook.measure.part_forces import MovingPartForces
from labbook.scene import PartMotion, PartRotation, Primitives, Scene

DT, STEPS = 1e-4, 400
RATE, VELOCITY = 3.0, (0.3, 0.0, 0.4)


class Whole:
    """The window of a whole run."""

    start, end, timed = 0.0, 1.0, False


def stirred() -> Scene:
    """A floor at rest, and a part that is lowered along an axis aside, about which it turns."""
    motion = PartMotion(
        velocity=VELOCITY, rotation=PartRotation(axis=(0.0, 0.0, 2.0), origin=(0.1, 0.0, 0.0), rate=-RATE)
    )
    part = of_triangles(*sheet(1, 0.02)).model_copy(update={"name": "paddle", "moves": motion})
    return scene(1, linear(), Primitives(parts=(floor(), part)), G)


def observed() -> RunData:
    """A force of (1, 2, 3) N on grains at the middle of the axis's plane, 0.05 m along x from the axis, in every frame;
    half of it in each of two bins. The floor takes another."""
    rows, force = [], np.array([1.0, 2.0, 3.0])
    for step in range(0, STEPS, 10):
        time = step * DT
        point = np.array([0.1, 0.0, 0.0]) + time * np.array(VELOCITY) + [0.05, 0.0, 0.0]
        torque = np.cross(point, force)
        for wall, bin_, part in ((0, 0, 7.0), (1, 0, 0.5), (1, 1, 0.5)):
            numbers = dict(
                zip(("fx", "fy", "fz", "tx", "ty", "tz"), part * np.concatenate([force, torque]), strict=True)
            )
            rows.append({"step": step, "wall": wall, "bin": bin_, **numbers})
    table = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    start = grains_at([0.0, 0.0, 0.01])
    return RunData(stirred(), Numerics(dt=DT), 1, start, "time-limit", STEPS * DT, {"traction": table})


def test_force_torque_and_power_are_those_of_a_force_at_a_known_place():
    evaluation = MovingPartForces().evaluate(observed(), Whole())
    numbers = {number.quantity: number.value for number in evaluation.numbers}
    unit = np.array(VELOCITY) / math.hypot(*VELOCITY)
    # the axis goes along; at 0.05 m from it the part moves at -RATE x 0.05 along y
    assert numbers["drag.paddle"] == pytest.approx(np.array([1.0, 2.0, 3.0]) @ unit)
    assert numbers["torque.paddle"] == pytest.approx(-0.05 * 2.0)
    assert numbers["power.paddle"] == pytest.approx(1 * 0.3 + 3 * 0.4 - 2 * RATE * 0.05)
    assert set(numbers) == {quantity.name for quantity in MovingPartForces().quantities(stirred())}
    arrays = evaluation.arrays
    assert arrays["names"].tolist() == ["paddle"]
    assert arrays["force"].shape == (STEPS // 10, 1, 3)
    assert arrays["force"][3, 0] == pytest.approx([-1, -2, -3])
    assert arrays["torque"][-1, 0] == pytest.approx(-np.cross([0.05, 0, 0], [1.0, 2.0, 3.0]), abs=1e-12)
    assert arrays["time"][2] == pytest.approx(20 * DT)


def test_a_scene_without_parts_that_move_is_refused():
    here = scene(1, linear(), Primitives(parts=(floor(),)), G)
    with pytest.raises(MeasureError, match="no part moves"):
        MEASURES["part_forces"].check(here)
