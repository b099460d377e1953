"""Rolling springs: their formula against the source of LIGGGHTS, symmetry, limits, and the keys that state them."""

import math
from itertools import product

import numpy as np
import pytest
from labbook_dem import spheres
from labbook_dem.chosen import choose
from labbook_dem.words import dot, vec3

from labbook.checks.verify.materials import hertz, linear, scene
from labbook.checks.verify.materials import spheres as some_spheres
from labbook.scene import Box, HertzLiggghts, LinearSpringDashpot, Scene, Spherocylinders
from labbook.scene.timescales import largest_stable_step

MU_R, ETA, DT = 0.1, 0.3, 1e-6
MATERIALS = {
    "hertz-mindlin": hertz(rolling_friction=MU_R, rolling_model="epsd"),
    "hertz-liggghts": HertzLiggghts(shear_modulus=1e8, poisson_ratio=0.25, friction=0.5, rolling_friction=MU_R),
    "linear": linear(rolling_friction=MU_R, rolling_model="epsd"),
}
FULL = {"full": True, "rolling": False}
BOX = Box(width=0.1, depth=0.1, height=0.1)


def array(v: vec3) -> np.ndarray:
    return np.array([v.x, v.y, v.z])


def contact(seed: int, torque: float):
    """Radii, masses, unit normal, overlap [m], force [N], spins [rad/s] and the spring's torque [N m] so far."""
    rng = np.random.default_rng(seed)
    n = rng.normal(size=3)
    n /= np.linalg.norm(n)
    m = rng.normal(size=3)
    radii, masses = rng.uniform(0.5e-3, 3e-3, 2), rng.uniform(1e-5, 4e-5, 2)
    return radii, masses, n, 1e-6, 0.05 * n + 0.01 * np.cross(n, m), rng.normal(size=(2, 3)) * 2.0, torque * m


def between(law, given, full, dt=DT, damping=ETA):
    (ri, rj), (mi, mj), n, delta, force, (wi, wj), m = given
    with choose(law, twist=full, springs=True) as module:
        c = module.coefficients(MATERIALS[law], scene(1, MATERIALS[law], BOX).surface_of_grains)
        away = vec3(*(n * (ri + rj - delta)))
        of = vec3(*force), vec3(*wi), vec3(*wj), vec3(*m)
        roll, kept = spheres.rolling_on_sphere(c, ri, rj, mi, mj, away, delta, *of, dt, 2.25, damping)
    return array(roll), array(kept)


@pytest.mark.parametrize(("law", "how", "torque"), [*product(MATERIALS, FULL, (1e-9, 1e-4))])
def test_it_is_what_the_source_of_liggghts_computes(law, how, torque):
    """rolling_model_epsd.h of 3.8: kr = 2.25 kn rmu^2 reff^2, r_inertia = 1.4 of the reduced m r^2; its torque is taken
    from i. It does not turn the torque of before into the contact plane, so one is taken that lies there."""
    given = contact(1, torque)
    (ri, rj), (mi, mj), n, delta, force, (wi, wj), m = given
    m = m if FULL[how] else m - n * (m @ n)
    material, reff = MATERIALS[law], ri * rj / (ri + rj)
    if isinstance(material, LinearSpringDashpot):
        kn = material.normal_stiffness
    else:
        kn = 4 / 3 * material.effective_modulus * math.sqrt(reff * delta)
    turning = wi - wj if FULL[how] else wi - wj - n * ((wi - wj) @ n)
    kr = 2.25 * kn * MU_R * MU_R * reff * reff
    r_torque = -m + turning * DT * kr
    limit, size = abs(force @ n) * reff * MU_R, np.linalg.norm(r_torque)
    mobilised = size > limit
    assert mobilised == (torque > 1e-6), "both branches are seen"
    spring = r_torque * (limit / size) if mobilised else r_torque
    one, other = mi * ri * ri, mj * rj * rj
    damping = 0.0 if mobilised else ETA * 2 * math.sqrt(1.4 * one * other / (one + other) * kr)
    roll, kept = between(law, (*given[:6], m), FULL[how])
    np.testing.assert_allclose(kept, -spring, rtol=1e-12, atol=1e-12 * limit)
    np.testing.assert_allclose(roll, -(spring + damping * turning), rtol=1e-12, atol=1e-12 * limit)


@pytest.mark.parametrize(("law", "how", "seed"), [*product(MATERIALS, FULL, range(5))])
def test_exchanged_spheres_feel_opposite_torques_to_the_last_bit(law, how, seed):
    radii, masses, n, delta, force, spins, m = given = contact(seed, 1e-7)
    roll, kept = between(law, given, FULL[how])
    back = between(law, (radii[::-1], masses[::-1], -n, delta, -force, spins[::-1], -m), FULL[how])
    assert np.array_equal(back, [-roll, -kept])


@pytest.mark.parametrize("how", FULL)
def test_twist_is_resisted_only_if_asked_for(how):
    radii, masses, n, delta, force, *_ = contact(2, 0.0)
    roll, kept = between("linear", (radii, masses, n, delta, force, [3.0 * n, 1.0 * n], 1e-9 * n), FULL[how])
    assert (np.abs(roll @ n) > 1e-10, np.abs(kept @ n) > 1e-10) == (FULL[how], FULL[how])
    assert FULL[how] or np.abs([roll, kept]).max() < 1e-20


def test_a_very_large_and_heavy_sphere_is_a_wall():
    """At a ratio of 1e6 the error is of its order."""
    (r, _), (m, _), n, delta, force, (w, _), torque = contact(3, 1e-9)
    large = between("linear", ((r, 1e6 * r), (m, 1e6 * m), n, delta, force, (w, 0 * w), torque), True)
    with choose("linear", springs=True) as law:
        c = law.coefficients(MATERIALS["linear"], scene(1, MATERIALS["linear"], BOX).surface_of_grains)
        spin = vec3(0.0, 0.0, 0.0)
        wall = spheres.rolling_on_wall(
            c, r, m, delta, vec3(*n), vec3(*force), vec3(*w), spin, vec3(*torque), DT, 2.25, ETA
        )
    np.testing.assert_allclose(large, [array(one) for one in wall], rtol=1e-5)


def test_where_there_are_springs_no_torque_acts_against_the_rotation():
    n, none, turn = vec3(0.0, 0.0, 1.0), vec3(0.0, 0.0, 0.0), vec3(5.0, 0.0, 0.0)
    for springs in (False, True):
        with choose("linear", springs=springs) as law:
            c = law.coefficients(MATERIALS["linear"], scene(1, MATERIALS["linear"], BOX).surface_of_grains)
            _, _, roll, _ = spheres.touch(c, 1e-3, 1e-5, 1e-3, 1e-6, n, none, none, none, turn, none, DT, 1e-3)
            assert (dot(roll, roll) > 0) != springs


def test_keys_of_springs_belong_to_the_model_that_has_them():
    for key in ("rolling_stiffness", "rolling_damping"):
        with pytest.raises(ValueError, match=f"leave {key} out, or use rolling_model: epsd"):
            linear(**{key: 0.5})
    assert linear(rolling_model="epsd").rolling_spring == (2.25, 0.3)
    assert linear(rolling_model="epsd", rolling_stiffness=1.0, rolling_damping=0.0).rolling_spring == (1.0, 0.0)
    with pytest.raises(ValueError, match="rolling_stiffness"):
        linear(rolling_model="epsd", rolling_stiffness=0.0)


def test_what_has_no_springs_is_stored_as_it_always_was():
    stored = linear().model_dump(mode="json")
    assert stored.keys().isdisjoint({"rolling_model", "rolling_stiffness", "rolling_damping"})
    assert linear(rolling_model="cdt").model_dump(mode="json") == stored
    assert linear(rolling_model="epsd", rolling_damping=0.0).model_dump(mode="json") == {
        **stored, "rolling_model": "epsd", "rolling_damping": 0.0,
    }  # fmt: skip


def test_rods_have_none():
    rods = Spherocylinders(diameter=3e-3, length=6e-3, density=2500, count=10)
    with pytest.raises(ValueError, match=r"contact\.rolling_model: rods have no rolling springs"):
        Scene(grains=rods, contact=MATERIALS["linear"], container=BOX)


def test_stiff_and_damped_springs_ask_for_smaller_steps():
    """As friction springs do: k_r/R^2 = 9/16 mu_r^2 k_n exceeds 2/7 k_n beyond mu_r = 0.713, and then counts in
    proportion; the dashpot likewise, which for elastic grains is the only one."""

    def step(mu, damping, model="epsd"):
        more = {"rolling_damping": damping} if model == "epsd" else {}
        law = linear(rolling_friction=mu, restitution=1.0, rolling_model=model, **more)
        return largest_stable_step(Scene(grains=some_spheres(10), contact=law, container=BOX))

    free = step(0.7, 0.0, "cdt")
    assert step(0.7, 0.0) == free
    assert step(1.0, 0.0) == pytest.approx(free * math.sqrt(2 / 7 / (9 / 16)), rel=1e-12)
    a, bz = 1.8, 5.7 * 0.3 * 0.5 * math.sqrt(0.35 * 2.25)
    assert step(0.5, 0.3) == pytest.approx(free * (math.sqrt(bz**2 + a) - bz) / math.sqrt(a), rel=1e-12)
