"""Formulas of parts that move for compiled backends: against the poses that they are made of."""

import math

import numpy as np
import pytest
from labbook_dem import poses
from labbook_dem.words import vec3
from turning_box import MOTION

DT = 1e-4
STEPS = np.arange(40, 43)
TABLE = MOTION.poses(STEPS * DT).table()[:, None, :]
POINT = np.array([0.3, -0.2, 0.7])


def plain(v) -> np.ndarray:
    return np.array([v.x, v.y, v.z])


def test_points_and_springs_go_into_the_frame_of_a_part_and_back():
    pose = MOTION.poses(STEPS * DT)
    body = poses.in_part(TABLE, 1, 0, vec3(*POINT))
    assert pose.positions(1, plain(body)[None])[0] == pytest.approx(POINT, abs=1e-15)
    assert plain(poses.inwards(TABLE, 1, 0, vec3(*POINT))) == pytest.approx(pose.turn[1].T @ POINT, abs=1e-15)
    there = poses.spring_outwards(TABLE, 1, 0, poses.spring_inwards(TABLE, 1, 0, vec3(*POINT)))
    assert plain(there) == pytest.approx(POINT, abs=1e-15)


def test_velocities_are_those_of_the_point_of_the_part():
    """Half a step before by the way of the last step; at the opening that of now. Errors of differences are of dt^2."""
    body = plain(poses.in_part(TABLE, 1, 0, vec3(*POINT)))
    before, now, after = (MOTION.poses(STEPS * DT).positions(k, body[None])[0] for k in range(3))
    v = plain(poses.part_velocity(TABLE, 1, 0, vec3(*POINT)))
    assert v == pytest.approx((after - before) / (2 * DT), abs=1e-3 * float(np.linalg.norm(v)))
    earlier = plain(poses.part_velocity_before(TABLE, 1, 0, vec3(*POINT), DT, 41))
    assert earlier == pytest.approx((now - before) / DT, rel=1e-9, abs=1e-11)
    assert plain(poses.part_velocity_before(TABLE, 1, 0, vec3(*POINT), DT, 0)) == pytest.approx(v)
    assert math.hypot(*plain(poses.part_spin(TABLE, 1, 0))) == pytest.approx(15.0)
