"""Powers of contacts against the energies that single impacts take, by analysis, and against known motions."""

import math

import numpy as np
import pytest
from labbook_dem.ledger import contact_power
from scipy import integrate

from labbook.scene import HertzMindlin, Plane, Primitives, Scene, Spheres, SurfaceMotion, Wall

SPIN = 7.0


def scene(spin: float = SPIN) -> Scene:
    still = Wall(name="side", shape=Plane(point=(0.0, 0.0, 0.0), normal=(1.0, 0.0, 0.0)))
    turning = Wall(
        name="floor", shape=Plane(point=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0)), motion=SurfaceMotion(spin=spin)
    )
    return Scene(
        grains=Spheres(diameter=4e-3, density=2500, count=3),
        contact=HertzMindlin(shear_modulus=1e7, poisson_ratio=0.25),
        container=Primitives(parts=(still, turning)),
    )


def impact(reduced: float, approach: float, stiffness: float, damping: float, steps: int = 200):
    """Closed solution of a normal impact with a linear spring and dashpot, from touch until the overlap is gone.

    Returns: times [s], overlap [m], its rate [m/s], force [N] and impulse so far [N s], shape [steps + 1].
    """
    decay = damping / (2 * reduced)
    omega = math.sqrt(stiffness / reduced - decay**2)
    time = np.linspace(0, math.pi / omega, steps + 1)
    fade = approach / omega * np.exp(-decay * time)
    overlap = fade * np.sin(omega * time)
    rate = fade * (omega * np.cos(omega * time) - decay * np.sin(omega * time))
    return time, overlap, rate, stiffness * overlap + damping * rate, reduced * (approach - rate)


def integral(time: np.ndarray, power: np.ndarray) -> float:
    """By Simpson's rule."""
    return float(integrate.simpson(power, x=time))


MU, APPROACH, SLIDE = 0.2, 0.3, 1.5
STIFFNESS, DAMPING = 1e8, 4.0
"""So stiff that the overlap is below 1e-3 radii, and levers those of rigid spheres to half of that."""


def kinetic(mass: np.ndarray, radius: np.ndarray, v: np.ndarray, w: np.ndarray) -> float:
    return float(0.5 * mass @ np.sum(v**2, axis=1) + 0.2 * (mass * radius**2) @ np.sum(w**2, axis=1))


def test_powers_of_an_impact_of_unlike_spheres_are_the_energy_that_it_takes():
    """Two spheres that slide on each other throughout. Impulses give the energies before and after; analysis of the
    impact gives both parts: m* u_n^2 (1 - e^2)/2, and mu J (u_t - 7 mu J/(4 m*)), as u_t changes by (7/2) mu J/m*."""
    radius = np.array([2e-3, 1.3e-3])
    mass = 2500 * 4 / 3 * math.pi * radius**3 * [1, 3]
    reduced = mass.prod() / mass.sum()
    time, overlap, rate, force, impulse = impact(reduced, APPROACH, STIFFNESS, DAMPING)
    x = np.array([[0.0, 0.0, 0.0], [radius.sum(), 0.0, 0.0]])
    v0 = np.array([[APPROACH, SLIDE, 0.0], [0.0, 0.0, 0.0]])
    push, spin = np.array([[-1.0, -MU, 0.0], [1.0, MU, 0.0]]), np.array([0.0, 0.0, -MU])
    powers = {"normal_power": [], "tangential_power": [], "elastic": []}
    for depth, f, j in zip(overlap, force, impulse, strict=True):
        v = v0 + j * push / mass[:, None]
        w = j * spin * radius[:, None] / (0.4 * mass * radius**2)[:, None]
        x[1, 0] = radius.sum() - depth
        row = np.array([[0, 1, -1, *(f * push[0]), *(x[1] - x[0])]])
        for name, value in contact_power(scene(), np.arange(2), radius, x, v, w, row).items():
            powers.get(name, []).append(value)
    restitution, total = -rate[-1] / APPROACH, impulse[-1]
    lost = kinetic(mass, radius, v0, np.zeros((2, 3))) - kinetic(mass, radius, v, w)
    normal, tangential = (integral(time, np.array(powers[name])) for name in ("normal_power", "tangential_power"))
    assert normal + tangential == pytest.approx(lost, rel=1e-3)
    assert normal == pytest.approx(0.5 * reduced * APPROACH**2 * (1 - restitution**2), rel=1e-6)
    slowed = 3.5 * MU * total / reduced
    assert slowed < SLIDE, "it slides throughout"
    assert tangential == pytest.approx(MU * total * (SLIDE - slowed / 2), rel=1e-3)
    spring = 0.5 * (force - DAMPING * rate) * overlap
    halves = np.array(powers["elastic"]) - 0.5 * DAMPING * rate * overlap
    assert halves == pytest.approx(spring, abs=1e-9 * spring.max())


def test_powers_of_an_impact_on_a_moving_floor_and_its_work_are_the_change_of_energy():
    """A sphere falls on a floor that rises and moves sideways. In the frame of the floor it loses what a floor at rest
    takes; the floor's work is the impulse times its velocity."""
    belt, radius, mass = np.array([0.4, 0.0, 0.1]), 2e-3, 2500 * 4 / 3 * math.pi * 8e-9
    time, overlap, rate, force, impulse = impact(mass, APPROACH, STIFFNESS, DAMPING)
    v0, push = belt + np.array([SLIDE, 0.0, -APPROACH]), np.array([-MU, 0.0, 1.0])
    powers = {"normal_power": [], "tangential_power": [], "wall_power": []}
    floor = Wall(name="floor", shape=Plane(point=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0)),
                 motion=SurfaceMotion(velocity=tuple(belt.tolist())))  # fmt: skip
    here = scene().model_copy(update={"container": Primitives(parts=(floor,))})
    for depth, f, j in zip(overlap, force, impulse, strict=True):
        v, w = v0 + j * push / mass, np.array([0.0, j * MU * radius / (0.4 * mass * radius**2), 0.0])
        place = np.array([[0.01, 0.02, radius - depth]])
        row = np.array([[0, -1, 0, *(f * push), 0.0, 0.0, depth - radius]])
        found = contact_power(here, np.arange(1), np.array([radius]), place, v[None], w[None], row)
        for name, values in powers.items():
            values.append(found[name])
    normal, tangential, work = (integral(time, np.array(values)) for values in powers.values())
    one = np.array([mass]), np.array([radius])
    gained = kinetic(*one, v[None], w[None]) - kinetic(*one, v0[None], np.zeros((1, 3)))
    assert work == pytest.approx(impulse[-1] * float(push @ belt), rel=1e-6)
    assert work - normal - tangential == pytest.approx(gained, rel=1e-3)
    assert normal == pytest.approx(0.5 * mass * APPROACH**2 * (1 - (rate[-1] / APPROACH) ** 2), rel=1e-6)
    slowed = 3.5 * MU * impulse[-1] / mass
    assert tangential == pytest.approx(MU * impulse[-1] * (SLIDE - slowed / 2), rel=1e-3)


def test_a_sphere_that_rides_on_a_turning_floor_takes_the_work_of_the_floor():
    """Its contact point moves with the floor: no part is dissipated, and f.(Omega x r) is what it gains."""
    turn, x = np.array([0.0, 0.0, SPIN]), np.array([[0.01, 0.02, 1.9e-3]])
    force, branch = np.array([0.3, -0.7, 1.1]), np.array([0.0, 0.0, -1.9e-3])
    row = np.array([[4, -1, 1, *force, *branch]])
    found = contact_power(scene(), np.array([4]), np.array([2e-3]), x, np.cross(turn, x), turn[None], row)
    assert found["wall_power"] == pytest.approx(float(force @ np.cross(turn, x[0])))
    assert found["normal_power"] == pytest.approx(0, abs=1e-15)
    assert found["tangential_power"] == pytest.approx(0, abs=1e-15)
    assert found["elastic"] == pytest.approx(0.5 * 1.1 * 1e-4)


def test_a_pair_that_moves_as_a_whole_dissipates_nothing():
    """A common translation and rotation leaves the contact points together, whatever the forces."""
    x, radius = np.array([[0.0, 0.0, 0.01], [3e-3, 1e-3, 0.011]]), np.array([2e-3, 1.4e-3])
    turn = np.array([20.0, -5.0, 8.0])
    v = np.array([0.1, 0.2, -0.3]) + np.cross(turn, x)
    row = np.array([[0, 1, -1, 1.0, -2.0, 0.5, *(x[1] - x[0])]])
    found = contact_power(scene(), np.arange(2), radius, x, v, np.tile(turn, (2, 1)), row)
    assert found["normal_power"] == pytest.approx(0, abs=1e-15)
    assert found["tangential_power"] == pytest.approx(0, abs=1e-15)


def test_no_contact_has_no_power():
    zero = np.zeros((1, 3))
    found = contact_power(scene(), np.arange(1), np.array([1e-3]), zero, zero, zero, np.zeros((0, 9)))
    assert found == {"normal_power": 0, "tangential_power": 0, "wall_power": 0, "elastic": 0}
