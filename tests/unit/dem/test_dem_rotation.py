"""A rod's turning against Euler's equations integrated by SciPy, and what a free one keeps."""

import math
from itertools import pairwise

import numpy as np
import pytest
from labbook_dem import rotation
from labbook_dem.ledger import kinetic
from labbook_dem.words import vec3
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from labbook.scene import Spheres, Spherocylinders

ROD = Spherocylinders(diameter=6e-3, length=20e-3, density=620, count=1)
SLENDER = rotation.slenderness(ROD)
OMEGA = np.array([30.0, -20.0, 90.0])


def random_q(seed: int) -> np.ndarray:
    q = np.random.default_rng(seed).normal(size=4)
    return q / np.linalg.norm(q)


def matrix(q) -> np.ndarray:
    return Rotation.from_quat([q[1], q[2], q[3], q[0]]).as_matrix()


def parts(q) -> tuple[float, float, float, float]:
    return q[0], q[1], q[2], q[3]


def turned(q, m, dt):
    return np.array(rotation.turn(*parts(q), vec3(*m), SLENDER, dt))


def test_the_axis_is_the_rotated_z_axis():
    for seed in range(5):
        q = random_q(seed)
        a = rotation.axis(*parts(q))
        assert (a.x, a.y, a.z) == pytest.approx(tuple(matrix(q)[:, 2]), abs=1e-15)
        assert rotation.axes(q[None])[0] == pytest.approx(matrix(q)[:, 2], abs=1e-15)


def test_spin_and_momentum_are_those_of_the_inertia_tensor():
    q = random_q(1)
    r = matrix(q)
    tensor = r @ np.diag([ROD.inertia, ROD.inertia, ROD.inertia_axis]) @ r.T
    m = rotation.momenta(ROD, OMEGA[None], q[None])[0]
    assert ROD.inertia * m == pytest.approx(tensor @ OMEGA, rel=1e-12)
    assert rotation.spins(ROD, m[None], q[None])[0] == pytest.approx(OMEGA, rel=1e-12)
    w = rotation.spin(vec3(*m), rotation.axis(*parts(q)), SLENDER)
    assert (w.x, w.y, w.z) == pytest.approx(tuple(OMEGA), rel=1e-12)
    energy = kinetic(ROD, np.zeros((1, 3)), m[None], q[None])
    assert energy == pytest.approx(0.5 * OMEGA @ tensor @ OMEGA, rel=1e-12)


def test_a_free_top_is_where_euler_s_equations_take_it():
    q, time = random_q(2), 0.2
    inertia = np.array([ROD.inertia, ROD.inertia, ROD.inertia_axis])

    def euler(_, s):
        q0, v, w = s[0], s[1:4], s[4:]  # dq/dt = q (0, w)/2, w in the frame of the rod
        return [-0.5 * v @ w, *(0.5 * (q0 * w + np.cross(v, w))), *(np.cross(inertia * w, w) / inertia)]

    w0 = matrix(q).T @ OMEGA
    end = solve_ivp(euler, (0, time), [*q, *w0], method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    m = rotation.momenta(ROD, OMEGA[None], q[None])[0]
    for steps in (2000, 20000):
        found = q
        for _ in range(steps):
            found = turned(found, m, time / steps)
        assert matrix(found) == pytest.approx(matrix(end[:4] / np.linalg.norm(end[:4])), abs=1e-9)


def test_a_free_top_keeps_energy_and_angular_momentum_for_100000_steps():
    q, m = random_q(3), rotation.momenta(ROD, OMEGA[None], random_q(3)[None])[0]
    before = kinetic(ROD, np.zeros((1, 3)), m[None], q[None])
    for dt, steps in ((1e-6, 100_000), (1e-3, 1000)):  # m, the angular momentum, is not even touched
        for _ in range(steps):
            q = turned(q, m, dt)
        assert abs(kinetic(ROD, np.zeros((1, 3)), m[None], q[None]) / before - 1) < 1e-10
        assert abs(np.linalg.norm(q) - 1) < 1e-14


def test_kick_drift_kick_is_of_second_order_under_a_torque():
    """A rod that is pulled towards the vertical, T = k a x z, as a pendulum is."""
    strength, time = 2e3, 0.05  # T / I_t [1/s^2]

    def slope(_, s):
        a = rotation.axes(s[None, :4])[0]
        w = rotation.spins(ROD, s[None, 4:], s[None, :4])[0]
        half = 0.5 * w
        q0, v = s[0], s[1:4]
        dq = [-half @ v, *(q0 * half + np.cross(half, v))]
        return [*dq, *(strength * np.cross(a, [0, 0, 1]))]

    q, m = random_q(4), rotation.momenta(ROD, OMEGA[None] / 10, random_q(4)[None])[0]
    end = solve_ivp(slope, (0, time), [*q, *m], method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    errors = []
    for steps in (100, 200, 400):
        dt, at, momentum = time / steps, q, m
        torque = strength * np.cross(rotation.axes(at[None])[0], [0, 0, 1])
        momentum = momentum + torque * (dt / 2)
        for k in range(steps):
            at = turned(at, momentum, dt)
            torque = strength * np.cross(rotation.axes(at[None])[0], [0, 0, 1])
            momentum = momentum + torque * (dt if k < steps - 1 else dt / 2)
        errors.append(np.linalg.norm(at - end[:4]) + np.linalg.norm(momentum - end[4:]) * time)
    orders = [math.log2(a / b) for a, b in pairwise(errors)]
    assert orders == pytest.approx([2, 2], abs=0.05)


def test_a_sphere_is_a_rod_without_length():
    sphere = Spheres(diameter=6e-3, density=620, count=1)
    rod = Spherocylinders(diameter=6e-3, length=6e-3, density=620, count=1)
    for name in ("mass", "inertia", "inertia_axis", "volume", "half_length", "radius"):
        assert getattr(sphere, name) == getattr(rod, name), name
    assert rod.equivalent_diameter == pytest.approx(6e-3, rel=1e-15)
    assert rotation.slenderness(rod) == 0
