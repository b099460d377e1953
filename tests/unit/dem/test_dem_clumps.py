"""Motion of free clumps and contacts of their spheres, as pure functions."""

import math

import numpy as np
import pytest
from labbook_dem.chosen import choose
from labbook_dem.clumps import first_axis, from_body, sphere_velocity, spin_of_clump, torque_on_clump, turn_clump
from labbook_dem.rods import rod_on_rod
from labbook_dem.rotation import axis, flatness, momenta, slenderness, spins, turn
from labbook_dem.spheres import sphere_on_sphere
from labbook_dem.words import vec3

from labbook.checks.verify.clumps import SEED, euler, frame_of, tensors
from labbook.scene import Box, LinearSpringDashpot, Scene, Spherocylinders
from labbook.scene.orientation import random_turns, rotated

Q = random_turns(np.random.default_rng(5), 4)


def turned(q, m, dt: float, steps: int):
    flat, slender = flatness(SEED), slenderness(SEED)
    w, x, y, z = q
    for _ in range(steps):
        w, x, y, z = turn_clump(w, x, y, z, m, flat, slender, dt)
    return w, x, y, z


def test_body_vectors_and_axes_turn_with_the_clump():
    for q, frame in zip(Q.tolist(), frame_of(Q), strict=True):
        w, x, y, z = q
        v = from_body(w, x, y, z, vec3(1.0, -2.0, 0.5))
        assert (v.x, v.y, v.z) == pytest.approx(tuple(frame @ [1.0, -2.0, 0.5]), abs=1e-14)
        first, third = first_axis(*q), axis(*q)
        assert (first.x, first.y, first.z) == pytest.approx(tuple(frame[:, 0]), abs=1e-14)
        assert (third.x, third.y, third.z) == pytest.approx(tuple(frame[:, 2]), abs=1e-14)


def test_spins_follow_from_momenta_by_the_tensor_of_inertia():
    m = np.random.default_rng(3).normal(size=(4, 3)) * 50
    expected = np.linalg.solve(tensors(SEED, Q), (m * SEED.inertia)[..., None])[..., 0]
    omega = spins(SEED, m, Q)
    assert omega == pytest.approx(expected, rel=1e-12)
    assert momenta(SEED, omega, Q) == pytest.approx(m, rel=1e-12)
    for q, m_i, w in zip(Q.tolist(), m.tolist(), omega.tolist(), strict=True):
        spin = spin_of_clump(vec3(*m_i), first_axis(*q), axis(*q), flatness(SEED), slenderness(SEED))
        assert (spin.x, spin.y, spin.z) == pytest.approx(tuple(w), rel=1e-12)


def free_error(steps: int) -> tuple[float, float]:
    """Largest errors of the spin in the body frame, and of the energy, relative, over a flip of the middle axis."""
    least, largest, time = 100.0, 260.0, 0.06
    q = Q[0].tolist()
    omega = frame_of(Q[:1])[0] @ [largest, 0.0, least]
    m = vec3(*momenta(SEED, omega[None], Q[:1])[0].tolist())
    states = [q]
    for _ in range(20):
        states.append(turned(states[-1], m, time / steps, steps // 20))
    turns, fixed = np.array(states), np.tile([[m.x, m.y, m.z]], (21, 1))
    omega = spins(SEED, fixed, turns)
    body = np.einsum("nji,nj->ni", frame_of(turns), omega)
    energy = np.sum(fixed * omega, axis=1)
    error = np.abs(body - euler(SEED, largest, least, np.linspace(0, time, 21))).max() / largest
    return float(error), float(np.abs(energy / energy[0] - 1).max())


def test_free_motion_is_right_to_second_order_in_the_step():
    (coarse, energy), (fine, finer_energy) = free_error(400), free_error(800)
    assert coarse < 1e-2
    assert coarse / fine == pytest.approx(4, rel=0.05)
    assert energy / finer_energy == pytest.approx(4, rel=0.05)
    m = 260 * SEED.largest_inertia / SEED.inertia
    assert energy < abs(flatness(SEED)) * slenderness(SEED) * (m * 0.06 / 400) ** 2  # as the docstring states


def test_symmetric_tops_turn_as_rods_do():
    (w, x, y, z), m = Q[1].tolist(), vec3(30.0, -20.0, 50.0)
    assert turn_clump(w, x, y, z, m, 0.0, 0.8, 1e-3) == pytest.approx(turn(w, x, y, z, m, 0.8, 1e-3), abs=1e-15)
    # with the axis of symmetry along x, the same motion of a clump whose frame is turned by a quarter about y
    half = math.sqrt(0.5)
    onto_x = (half * (w - y), half * (x - z), half * (y + w), half * (z + x))  # q times the quarter turn: its x is -z
    first, third = first_axis(*onto_x), axis(w, x, y, z)
    assert (first.x, first.y, first.z) == pytest.approx((-third.x, -third.y, -third.z), abs=1e-14)
    a, b = turn_clump(*onto_x, m, 0.8, 0.0, 1e-3), turn(w, x, y, z, m, 0.8, 1e-3)
    assert rotated(np.array([a]), (1.0, 0, 0)) == pytest.approx(-rotated(np.array([b]), (0, 0, 1.0)), abs=1e-12)


def test_a_contact_of_equal_spheres_on_levers_is_that_of_rods():
    rng = np.random.default_rng(9)

    def vector(size: float) -> vec3:
        return vec3(*(size * rng.normal(size=3)).tolist())

    law = LinearSpringDashpot(normal_stiffness=500, friction=0.5, rolling_friction=0.1, restitution=0.6)

    rods = Spherocylinders(diameter=4e-3, length=8e-3, density=1000, count=2)
    scene = Scene(grains=rods, contact=law, container=Box(width=0.1, depth=0.1, height=0.1))
    with choose("linear") as formulas:
        c = formulas.coefficients(law, scene.surface_of_grains)
        r, mass, rate = 2e-3, 1e-4, 1e-6
        away = vec3(0.0, 3.9e-3, 0.0)
        overlap2 = 4 * r * r - 3.9e-3**2
        lever_i, lever_j, u, v = vector(3e-3), vector(3e-3), vector(0.1), vector(0.1)
        spins = vector(10.0), vector(10.0), vector(10.0), vector(10.0)
        spring = vec3(1e-6, 0.0, 2e-6)
        rest = vec3(0.0, 0.0, 0.0)
        u_of_spheres, v_of_spheres = (
            sphere_velocity(relative, spin_i, lever_i) - sphere_velocity(rest, spin_j, lever_j)
            for relative, spin_i, spin_j in ((u, *spins[:2]), (v, *spins[2:]))
        )
        force, on_i, on_j, new_spring, overlap = sphere_on_sphere(
            c, r, r, mass, mass, away, overlap2, u_of_spheres, v_of_spheres, *spins[2:], spring, 1e-5, rate, rate
        )
        ours = force, torque_on_clump(on_i, force, lever_i), torque_on_clump(on_j, -force, lever_j), new_spring
        theirs = rod_on_rod(c, r, mass, away, overlap2, lever_i, lever_j, u, v, *spins, spring, 1e-5, rate)
    for mine, other in zip(ours, theirs[:4], strict=True):
        assert (mine.x, mine.y, mine.z) == pytest.approx((other.x, other.y, other.z), rel=1e-12)
    assert overlap == pytest.approx(theirs[4], rel=1e-12)
