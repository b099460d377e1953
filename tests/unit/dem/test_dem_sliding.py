"""Laws that differ in what limits friction, against what the paper prints and what the sources of the codes compute."""

import math

import numpy as np
import pytest
from labbook_dem.laws import LAWS
from labbook_dem.words import vec3

from labbook.backend import load
from labbook.backend.numerics import Numerics
from labbook.checks.verify.materials import room, scene
from labbook.scene import HertzLammps, HertzLiggghts, HertzMindlin, HertzPrinted, Surface
from labbook.scene.packing import Packing

G, NU, E, MU = 1e8, 0.25, 0.2, 0.5
RS, MS = 0.75e-3, 1.8e-5
SURFACE = Surface(friction=MU, rolling_friction=0.0, restitution=E)
MODULUS = 2 * G * (1 + NU)  # Young's
CONTACTS = [
    (1e-6, -0.3, (2e-7, 0.0, 0.0), (0.05, 0.0, 0.0)),  # sticks while grains approach
    (1e-6, 0.02, (3e-6, 1e-6, 0.0), (0.4, -0.1, 0.0)),  # slides
    (3e-6, 0.0, (1e-7, 1e-7, 0.0), (-0.8, 0.2, 0.0)),  # the dashpot alone exceeds the limit
    (2e-7, 0.9, (1e-7, 0.0, 0.0), (0.1, 0.0, 0.0)),  # pulls, as grains part fast
]


def responded(law, contact):
    """Normal and tangential force, and the spring that is left, as arrays."""
    delta, vn, s, vt = contact
    module = LAWS[law.law]
    fn, ft, kept = module.respond(module.coefficients(law, SURFACE), RS, MS, delta, vn, vec3(*s), vec3(*vt))
    return fn, np.array([*ft]), np.array([*kept])


def material(kind, **given):
    return kind(shear_modulus=G, poisson_ratio=NU, friction=MU, restitution=E, **given)


@pytest.mark.parametrize("contact", CONTACTS)
def test_printed_is_equations_6_and_7_to_the_letter(contact):
    """Fan et al. 2023: F_n^v = C_n sqrt(8 m* E* sqrt(R* delta)) v_n;
    F_t^v = C_t sqrt(6 mu m* F_n^e sqrt(1 - x)/s_max) v_t with x = min(s, s_max)/s_max."""
    delta, vn, s, vt = contact
    effective = MODULUS / (2 * (1 - NU**2))
    c_n = math.sqrt(5 / 6) * abs(math.log(E)) / math.hypot(math.pi, math.log(E))
    elastic = 4 / 3 * effective * math.sqrt(RS) * delta**1.5
    s_max = MU * (2 - NU) / (2 * (1 - NU)) * delta
    size = np.linalg.norm(s)
    x = min(size, s_max) / s_max
    spring = -MU * elastic * (1 - (1 - x) ** 1.5) * np.array(s) / size
    dashpot = -c_n * math.sqrt(6 * MU * MS * elastic * math.sqrt(1 - x) / s_max) * np.array(vt)
    fn, ft, kept = responded(material(HertzPrinted), contact)
    assert fn == pytest.approx(elastic - c_n * math.sqrt(8 * MS * effective * math.sqrt(RS * delta)) * vn, rel=1e-12)
    np.testing.assert_allclose(ft, spring + dashpot, rtol=1e-10, atol=1e-14)
    np.testing.assert_array_equal(kept, s)


def gained(law, slid, low=1e-6, high=4e-6, steps=2000):
    """Work [J] of friction on a contact that slides slowly by `slid` [m], is pressed harder, slides back, and is
    relieved; and the normal forces [N]. Elastic normal forces do no work in it, as both ways of pressing are alike."""
    module, spring, work, forces = LAWS[law.law], vec3(0, 0, 0), 0.0, []
    c = module.coefficients(law, SURFACE)
    for delta, step in ((low, slid / steps), (high, -slid / steps)):
        for _ in range(steps):
            _, before, _ = module.respond(c, RS, MS, delta, 0.0, spring, vec3(0, 0, 0))
            fn, after, spring = module.respond(c, RS, MS, delta, 0.0, spring + vec3(step, 0, 0), vec3(0, 0, 0))
            work += (before[0] + after[0]) / 2 * step
        forces.append(fn)
    return work, *forces


def test_the_printed_law_gives_energy_away_and_others_do_not():
    """Its spring is as long as the contact slid. Under a larger load it pushes with mu times that load all the way
    back: W = mu (F_2 - F_1) L for L much longer than a spring. A spring that is cut pushes over its own length only."""
    slid = 1e-3  # 430 sliding distances at the larger load
    work, low, high = gained(material(HertzPrinted), slid)
    assert work == pytest.approx(MU * (high - low) * slid, rel=0.01)
    for kind in (HertzMindlin, HertzLiggghts, HertzLammps):
        work, low, high = gained(material(kind), slid)
        assert work == pytest.approx(-MU * (high + low) * slid, rel=0.01), kind


@pytest.mark.parametrize("contact", CONTACTS)
def test_liggghts_is_what_its_source_computes(contact):
    """normal_model_hertz.h and tangential_model_history.h of 3.8, line by line; its 1/Geff is the sum of
    2 (2 - nu)(1 + nu)/Y over both bodies."""
    delta, vn, s, vt = contact
    young = MODULUS / (2 * (1 - NU**2))
    shear = 1 / (2 * 2 * (2 - NU) * (1 + NU) / MODULUS)
    beta = math.log(E) / math.sqrt(math.log(E) ** 2 + math.pi**2)
    root = math.sqrt(RS * delta)
    gamma_n = -2 * math.sqrt(5 / 6) * beta * math.sqrt(2 * young * root * MS)
    k_t = 8 * shear * root
    gamma_t = -2 * math.sqrt(5 / 6) * beta * math.sqrt(k_t * MS)
    force = 4 / 3 * young * root * delta - gamma_n * vn
    spring, speed = np.array(s), np.array(vt)
    if k_t * np.linalg.norm(spring) > MU * abs(force):
        tangential = -spring * MU * abs(force) / np.linalg.norm(spring)
        spring = -tangential / k_t
    else:
        tangential = -k_t * spring - gamma_t * speed
    fn, ft, kept = responded(material(HertzLiggghts), contact)
    assert fn == pytest.approx(force, rel=1e-12)
    np.testing.assert_allclose(ft, tangential, rtol=1e-12, atol=1e-18)
    np.testing.assert_allclose(kept, spring, rtol=1e-12, atol=1e-24)


@pytest.mark.parametrize("contact", CONTACTS)
def test_lammps_is_what_its_source_computes(contact):
    """pair_granular.cpp: the damping of every model enters as one prefactor, and the history is a displacement."""
    delta, vn, s, vt = contact
    c_n, x_t = 0.294, 0.7
    young = MODULUS / (2 * (1 - NU**2))
    shear = 1 / (2 * 2 * (2 - NU) * (1 + NU) / MODULUS)
    a = math.sqrt(RS * delta)
    prefactor = c_n * math.sqrt(6 * MS * 4 / 3 * young * a)
    force = 4 / 3 * young * a * delta - prefactor * vn
    critical, k_t = MU * abs(force), 8 * shear * a
    spring, speed = np.array(s), np.array(vt)
    tangential = -k_t * spring - x_t * prefactor * speed
    size = np.linalg.norm(tangential)
    if size > critical:
        spring = -(critical * tangential / size + x_t * prefactor * speed) / k_t
        tangential = tangential * critical / size
    fn, ft, kept = responded(material(HertzLammps, normal_damping=c_n, tangential_damping=x_t), contact)
    assert fn == pytest.approx(force, rel=1e-12)
    np.testing.assert_allclose(ft, tangential, rtol=1e-12, atol=1e-18)
    np.testing.assert_allclose(kept, spring, rtol=1e-11, atol=1e-20)


@pytest.mark.parametrize("kind", [HertzPrinted, HertzLiggghts, HertzLammps])
def test_the_normal_force_pulls_unless_that_is_forbidden(kind):
    parting = CONTACTS[3]
    fn, ft, _ = responded(material(kind), parting)
    assert fn < 0
    assert kind is HertzPrinted or np.linalg.norm(ft) <= MU * abs(fn) * (1 + 1e-12) or kind is HertzLiggghts
    fn, ft, _ = responded(material(kind, tension=False), parting)
    assert fn == 0
    assert kind is HertzPrinted or not ft.any()
    with pytest.raises(ValueError, match="never pulls"):
        material(kind, damping="clamped")
    assert material(kind, damping="clamped", tension=False).damping_ratio(E) == pytest.approx(0.6675, abs=5e-5)


def test_todays_law_is_stored_as_it_always_was():
    """What is new is left out, so that no key changes."""
    stored = material(HertzMindlin).model_dump(mode="json")
    assert stored.keys().isdisjoint({"tension", "normal_damping"})
    assert material(HertzMindlin, normal_damping=0.4).model_dump(mode="json")["normal_damping"] == 0.4


@pytest.mark.compiles
@pytest.mark.ring
@pytest.mark.parametrize("kind", [HertzPrinted, HertzLiggghts, HertzLammps])
def test_backends_agree_on_an_oblique_impact(kind):
    """Two spheres that meet off centre, to the end of the contact: momentum and spins of all backends, to round-off."""
    here = scene(2, material(kind), room())
    d, how = 3e-3, Numerics(dt=2e-7, steps_per_beat=100, precision="double")
    x = np.array([[-0.5 * d - 1e-6, 0, 0.5], [0.5 * d + 1e-6, 0.3 * d, 0.5]])
    start = Packing(x=x, v=np.array([[1.0, 0, 0], [-1.0, 0, 0]]), omega=np.zeros((2, 3)))
    ended = {}
    for name in ("reference", "numba", "warp"):
        backend = load(name)
        ensemble = backend.open(backend.specialise(here, how, []), 1, "cpu")
        member = ensemble.admit(here, how, start)
        ensemble.advance(10)
        ended[name] = ensemble.packing(member)
        ensemble.close()
    reference = ended["reference"]
    assert reference.omega[0, 2] > 100, "friction has turned them"
    for other in ("numba", "warp"):
        np.testing.assert_allclose(ended[other].v, reference.v, atol=1e-13)
        np.testing.assert_allclose(ended[other].omega, reference.omega, atol=1e-9)
