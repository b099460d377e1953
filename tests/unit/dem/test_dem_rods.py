"""Contacts of rods: forces and torques against spheres, rigid-body kinematics and their own mirror image."""

import numpy as np
import pytest
from labbook_dem import rods, spheres
from labbook_dem.chosen import choose
from labbook_dem.laws import hertz_mindlin, linear
from labbook_dem.segments import closest
from labbook_dem.words import vec3

from labbook.scene import HertzMindlin, LinearSpringDashpot, Surface

R, M, HALF = 3e-3, 3e-4, 7e-3
SURFACE = Surface(friction=0.5, rolling_friction=0.01, restitution=0.2)
C = hertz_mindlin.coefficients(HertzMindlin(shear_modulus=1e8, poisson_ratio=0.25), SURFACE)
RATE, DT = 1e-4, 1e-6


@pytest.fixture(autouse=True)
def hertz_mindlin_law():
    with choose("hertz-mindlin"):
        yield


def array(v: vec3) -> np.ndarray:
    return np.array([v.x, v.y, v.z])


def on_rod(*given):
    return rods.rod_on_rod(C, R, M, *given, DT, RATE)  # pyright: ignore[reportCallIssue]


def some(seed: int) -> dict[str, vec3]:
    rng = np.random.default_rng(seed)
    sizes = {"u": 0.01, "v": 0.01, "pi": 0.5, "pj": 0.5, "wi": 0.5, "wj": 0.5, "s": 1e-7}
    return {name: vec3(*(size * rng.normal(size=3))) for name, size in sizes.items()}


def touching(seed: int):
    """Closest points of two rods that overlap by 30 micrometres."""
    rng = np.random.default_rng(seed)
    a, b, c = (v / np.linalg.norm(v) for v in rng.normal(size=(3, 3)))
    for _ in range(100):  # move them together along the branch until they touch
        s, t, away = closest(vec3(*c), vec3(*a), vec3(*b), HALF)
        r = np.linalg.norm(array(away))
        c = c + array(away) / r * (2 * R - 3e-5 - r)
    overlap2 = (2 * R) ** 2 - float(array(away) @ array(away))
    return away, overlap2, vec3(*(s * a)), vec3(*(t * b)), c


@pytest.mark.parametrize("seed", range(10))
def test_at_the_contact_it_is_two_spheres_that_move_as_the_surfaces_do(seed):
    """Spheres at the closest points, with the velocities that rigid rods have there, feel the same force."""
    away, overlap2, li, lj, c = touching(seed)
    k = some(seed)
    force, ti, tj, kept, delta = on_rod(away, overlap2, li, lj, *k.values())
    u = array(k["u"]) + np.cross(array(k["pi"]), array(li)) - np.cross(array(k["pj"]), array(lj))
    v = array(k["v"]) + np.cross(array(k["wi"]), array(li)) - np.cross(array(k["wj"]), array(lj))
    f, mi, _, s, d = spheres.sphere_on_sphere(
        C, R, R, M, M, away, overlap2, vec3(*u), vec3(*v), k["wi"], k["wj"], k["s"], DT, RATE, RATE
    )
    assert array(force) == pytest.approx(array(f), rel=1e-12)
    assert array(kept) == pytest.approx(array(s), rel=1e-12)
    assert delta == d == pytest.approx(3e-5, rel=1e-3)
    # torques about the centres: those about the spheres' plus lever times force; together with the force on the branch
    # from one centre to the other they balance
    assert array(ti) == pytest.approx(array(mi) + np.cross(array(li), array(f)), rel=1e-9, abs=1e-18)
    balance = array(ti) + array(tj) + np.cross(c, array(force))
    assert np.abs(balance).max() < 1e-12 * np.linalg.norm(array(force))


@pytest.mark.parametrize("seed", range(10))
def test_exchanged_rods_feel_opposite_forces_to_the_last_bit(seed):
    away, overlap2, li, lj, _ = touching(seed)
    k = some(seed)
    force, ti, tj, kept, _ = on_rod(away, overlap2, li, lj, *k.values())
    back = rods.rod_on_rod(
        C, R, M, -away, overlap2, lj, li, -k["u"], -k["v"], k["pj"], k["pi"], k["wj"], k["wi"], -k["s"], DT, RATE
    )
    assert (-force, tj, ti, -kept) == back[:4]


def test_rods_without_length_are_equal_spheres_to_the_last_bit(monkeypatch):
    monkeypatch.setattr(spheres, "VARIED", False)
    zero = vec3(0.0, 0.0, 0.0)
    away, overlap2, _, _, _ = touching(1)
    k = some(1)
    rod = on_rod(away, overlap2, zero, zero, *k.values())
    sphere = spheres.sphere_on_sphere(
        C, R, R, M, M, away, overlap2, k["u"], k["v"], k["wi"], k["wj"], k["s"], DT, RATE, RATE
    )
    assert rod == sphere
    n, spin = vec3(0.0, 0.6, 0.8), vec3(0.0, 0.0, 3.0)
    rod = rods.rod_on_wall(C, R, M, 3e-5, n, zero, k["u"], k["v"], k["pi"], k["wi"], spin, k["s"], DT, RATE)
    assert rod == spheres.sphere_on_wall(C, R, M, 3e-5, n, k["u"], k["v"], k["wi"], spin, k["s"], DT, RATE)


@pytest.mark.parametrize("seed", range(5))
def test_at_a_wall_the_contact_moves_as_the_rod_s_surface_does(seed):
    n, lever, k = vec3(0.0, 0.6, 0.8), vec3(5e-3, 1e-3, -2e-3), some(seed)
    zero = vec3(0.0, 0.0, 0.0)
    force, torque, _ = rods.rod_on_wall(
        C, R, M, 3e-5, n, lever, k["u"], k["v"], k["pi"], k["wi"], zero, k["s"], DT, RATE
    )
    u = array(k["u"]) + np.cross(array(k["pi"]), array(lever))
    v = array(k["v"]) + np.cross(array(k["wi"]), array(lever))
    f, t, _ = spheres.sphere_on_wall(C, R, M, 3e-5, n, vec3(*u), vec3(*v), k["wi"], zero, k["s"], DT, RATE)
    assert array(force) == pytest.approx(array(f), rel=1e-12)
    assert array(torque) == pytest.approx(array(t) + np.cross(array(lever), array(f)), rel=1e-9)


RUBBING = Surface(friction=0.5, rolling_friction=0.01, restitution=0.9)
COEFFICIENTS = {
    "linear": linear.coefficients(LinearSpringDashpot(normal_stiffness=200.0), RUBBING),
    # without the tangential dashpot, which ends with infinite slope as the spring reaches its limit
    "hertz-mindlin": hertz_mindlin.coefficients(
        HertzMindlin(shear_modulus=1e10, poisson_ratio=0.25, tangential_damping=0.0), RUBBING
    ),
}
RATE_OF_TURN, LASTS = 0.02, 2e-4
"""At which one rod turns through parallel [rad/s], and for how long [s]."""


def through_parallel(c, velocity, n: int) -> np.ndarray:
    """Force, torque on i, torque on j and friction spring at n times: shape [n, 4, 3].

    Rods of 20 mm x 6 mm that overlap by 3e-8 m, as one that lies on another. The lower turns up by 4 microradians, and
    half as fast across; the upper slides over it at `velocity` [m/s] and rolls. The spring goes on from step to step.
    """
    dt, s, found = LASTS / (n - 1), vec3(1e-8, -5e-9, 0.0), []
    u, wi, wj = vec3(*velocity), vec3(0.1 * RATE_OF_TURN, 0.0, 0.0), vec3(0.0, -RATE_OF_TURN, 0.5 * RATE_OF_TURN)
    for time in np.linspace(-LASTS / 2, LASTS / 2, n):
        b = np.array([1.0, 0.5 * RATE_OF_TURN * time, RATE_OF_TURN * time])  # whose rate is wj x b
        a, b = vec3(1.0, 0.0, 0.0), vec3(*(b / np.linalg.norm(b)))
        p, q, away = closest(vec3(1e-3, 0.0, 2 * R - 3e-8) + u * time, a, b, HALF)
        overlap2 = (2 * R) ** 2 - (away.x**2 + away.y**2 + away.z**2)
        *forces, s, _ = rods.rod_on_rod(
            c, R, M, away, overlap2, a * p, b * q, u, u, wi, wj, wi, wj, s, dt, RATE
        )  # fmt: skip
        found.append([array(part) for part in (*forces, s)])
    return np.array(found)


@pytest.mark.parametrize("law", COEFFICIENTS)
@pytest.mark.parametrize(
    ("velocity", "slides"), [((0.0, 0.0, 0.0), False), ((1.5e-4, 1e-4, 0.0), True), ((4e-4, -2e-4, 0.0), True)]
)
def test_force_torques_and_spring_stay_continuous_as_rods_turn_through_parallel(law, velocity, slides):
    """What changes from one time to the next falls with the time between them: by 10 where that does."""
    with choose(law):
        coarse, fine = (through_parallel(COEFFICIENTS[law], velocity, n) for n in (401, 4001))
    force, torques = fine[:, 0], fine[:, 1:3, 1]
    # the contact runs from end to end, and takes both torques along
    assert np.all(np.ptp(torques, axis=0) > 0.5 * HALF * np.abs(force[:, 2]).max())
    assert bool(np.any(np.hypot(force[:, 0], force[:, 1]) > 0.5 * force[:, 2] * (1 - 1e-4))) == slides
    jump = [np.abs(np.diff(found, axis=0)).max(axis=0) for found in (coarse, fine)]
    assert np.all(jump[1] <= 0.12 * jump[0] + 1e-15)
