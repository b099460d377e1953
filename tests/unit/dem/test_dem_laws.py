"""Coefficients by hand, and laws against their printed formulas."""

import math

import numpy as np
import pytest
from labbook_dem import contact
from labbook_dem.coefficients import C_N, MU, MU_R
from labbook_dem.laws import hertz_mindlin, linear
from labbook_dem.laws.hertz import C_T, KAPPA, LEAST, MODULUS
from labbook_dem.laws.linear import GAMMA_RATIO, K_N, K_RATIO
from labbook_dem.words import vec3
from pydantic import ValidationError

from labbook.scene import HertzMindlin, LinearSpringDashpot, Surface, SurfaceChange

SURFACE = Surface(friction=0.5, rolling_friction=0.01, restitution=0.2)
SMOOTH = Surface(friction=0.0, rolling_friction=0.0, restitution=1.0)
FAN = HertzMindlin(shear_modulus=1e8, poisson_ratio=0.25)
RS, MS = 0.75e-3, 1.8e-5


def test_coefficients_of_hertz_mindlin_by_hand():
    """E = 2 G (1 + nu) = 2.5e8, 1/E* = 2 (1 - nu^2)/E: E* = 1.3333e8; kappa = (2 - 1/4)/(2 (3/4)) = 7/6."""
    c = hertz_mindlin.coefficients(FAN, SURFACE)
    assert c[MODULUS] == pytest.approx(4 / 3 / (2 * (1 - 0.0625) / 2.5e8), rel=1e-12)
    assert c[C_N] == pytest.approx(0.6675, abs=5e-5)
    assert c[C_T] == c[C_N]
    assert c[KAPPA] == pytest.approx(7 / 6, rel=1e-12)
    assert (c[MU], c[MU_R], c[LEAST]) == (0.5, 0.01, 0.0)
    softer = hertz_mindlin.coefficients(FAN.model_copy(update={"tangential_damping": 2.0}), SURFACE, 0.1)
    assert softer[MODULUS] == pytest.approx(0.1 * c[MODULUS], rel=1e-12)
    assert softer[C_T] == pytest.approx(2 * c[C_N], rel=1e-12)
    textbook = hertz_mindlin.coefficients(FAN.model_copy(update={"damping": "textbook"}), SURFACE)
    assert textbook[C_N] == pytest.approx(0.416, abs=5e-4)


def test_coefficients_of_the_linear_law_by_hand():
    """Textbook: gamma_n = sqrt(4 k_n m*/((pi/ln e)^2 + 1)); c holds it over sqrt(k_n m*)."""
    law = LinearSpringDashpot(normal_stiffness=5e4, tangential_damping=0.5, damping="textbook")
    c = linear.coefficients(law, SURFACE)
    gamma = math.sqrt(4 * 5e4 * MS / ((math.pi / math.log(0.2)) ** 2 + 1))
    assert c[C_N] * math.sqrt(5e4 * MS) == pytest.approx(gamma, rel=1e-12)
    assert (c[K_N], c[GAMMA_RATIO], c[K_RATIO], c[MU], c[MU_R]) == (5e4, 0.5, 2 / 7, 0.5, 0.01)
    stiffer = linear.coefficients(law, SMOOTH, 3.0)
    assert (stiffer[K_N], stiffer[C_N]) == pytest.approx((1.5e5, 0.0))


def test_printed_damping_is_that_of_two_grains_at_walls_too():
    """Pongo et al.: gamma_n = sqrt(2 k_n m / ((pi/ln e)^2 + 1)) everywhere; between two grains m* = m/2."""
    mass, surface = 3e-4, SMOOTH.changed(SurfaceChange(restitution=0.9))
    law = LinearSpringDashpot(normal_stiffness=1e5, damping="printed")
    printed = math.sqrt(2 * 1e5 * mass / ((math.pi / math.log(0.9)) ** 2 + 1))
    pair, wall = (linear.coefficients(law, surface, wall=at_wall)[C_N] for at_wall in (False, True))
    assert pair * math.sqrt(1e5 * mass / 2) == pytest.approx(printed, rel=1e-12)
    assert wall * math.sqrt(1e5 * mass) == pytest.approx(printed, rel=1e-12)
    textbook = law.model_copy(update={"damping": "textbook"})
    assert linear.coefficients(textbook, surface, wall=True)[C_N] == pair


@pytest.mark.parametrize("given", [{"friction": 0.5}, {"restitution": 0.9}, {}])
def test_a_surface_with_something_left_open_is_no_surface(given):
    """Coefficients are made from complete surfaces only; a change of one leaves open what it does not change."""
    with pytest.raises(ValidationError, match="rolling_friction"):
        Surface(**given)
    changed = SURFACE.changed(SurfaceChange(**given))
    assert changed.model_dump() == {**SURFACE.model_dump(), **given}
    for module, law in ((hertz_mindlin, FAN), (linear, LinearSpringDashpot(normal_stiffness=1.0))):
        assert module.coefficients(law, changed)[4:6] == (given.get("friction", 0.5), 0.01)


def printed(delta, vn, s, vt, mu=0.5, nu=0.25):
    """Fan's eqs 6 and 7 as printed, with the elastic part and the damping apart, but with the total normal force in
    place of its elastic part, and at most Coulomb's friction; and how far the spring may be stretched."""
    e_star, c_n = 1e8 / (1 - nu), hertz_mindlin.coefficients(FAN, SURFACE)[1]
    elastic = 4 / 3 * e_star * math.sqrt(RS) * delta**1.5
    fn = max(elastic - c_n * math.sqrt(8 * MS * e_star * math.sqrt(RS * delta)) * vn, 0.0)
    s_max = mu * (2 - nu) / (2 * (1 - nu)) * delta * fn / elastic
    part = min(s, s_max) / s_max if s_max else 1.0
    spring = mu * fn * (1 - (1 - part) ** 1.5)
    damping = c_n * math.sqrt(6 * mu * MS * fn * math.sqrt(1 - part) / s_max) * vt if s_max else 0.0
    ft = -(spring + damping)
    return fn, math.copysign(min(abs(ft), mu * fn), ft), s_max


@pytest.mark.parametrize("delta", [1e-7, 3e-6])
@pytest.mark.parametrize("vn", [-0.1, 0.0, 0.02, 5.0])
@pytest.mark.parametrize("part", [0.05, 0.5, 0.99, 1.7])
@pytest.mark.parametrize("vt", [0.0, 1e-3, 0.1])
def test_hertz_mindlin_is_the_printed_law(delta, vn, part, vt):
    c = hertz_mindlin.coefficients(FAN, SURFACE)
    s = part * 0.5 * 7 / 6 * delta
    fn, ft, kept = hertz_mindlin.respond(c, RS, MS, delta, vn, vec3(s, 0, 0), vec3(vt, 0, 0))
    expected = printed(delta, vn, s, vt)
    assert fn == pytest.approx(expected[0], rel=1e-12, abs=1e-15)
    assert ft.x == pytest.approx(expected[1], rel=1e-9, abs=1e-15)
    assert (ft.y, ft.z) == (0, 0)
    assert kept.x == pytest.approx(min(s, expected[2]), rel=1e-12)


@pytest.mark.parametrize("vn", [-0.3, 0.0, 0.02])
@pytest.mark.parametrize("vt", [-0.4, 0.0, 0.4])
def test_a_sliding_contact_has_coulomb_s_friction_whatever_the_normal_dashpot_does(vn, vt):
    """|F_t| = mu F_n with the total normal force, which exceeds F_n^e while grains approach; opposite to the spring."""
    c = hertz_mindlin.coefficients(FAN, SURFACE)
    delta = 2e-6
    elastic = hertz_mindlin.normal(c, RS, MS, delta, 0.0)
    fn, ft, kept = hertz_mindlin.respond(c, RS, MS, delta, vn, vec3(3e-4, -4e-4, 0), vec3(vt, 0.1, 0))
    assert (fn > elastic) == (vn < 0)
    assert (ft.x, ft.y, ft.z) == pytest.approx((-0.6 * 0.5 * fn, 0.8 * 0.5 * fn, 0), rel=1e-12)
    assert math.hypot(kept.x, kept.y) == pytest.approx(0.5 * 7 / 6 * delta * fn / elastic, rel=1e-12)


@pytest.mark.parametrize("vn", [-0.3, 0.0, 0.02])
def test_friction_does_not_jump_where_a_contact_begins_to_slide(vn):
    """A force that jumps there lets contacts of inelastic grains alternate between two values of friction."""
    c = hertz_mindlin.coefficients(FAN, SURFACE)
    *_, kept = hertz_mindlin.respond(c, RS, MS, 2e-6, vn, vec3(1e-3, 0, 0), vec3(0, 0, 0))
    _, before, _ = hertz_mindlin.respond(c, RS, MS, 2e-6, vn, vec3(kept.x * (1 - 1e-8), 0, 0), vec3(0, 0, 0))
    _, after, _ = hertz_mindlin.respond(c, RS, MS, 2e-6, vn, vec3(kept.x * (1 + 1e-8), 0, 0), vec3(0, 0, 0))
    assert before.x == pytest.approx(after.x, rel=1e-9)


@pytest.mark.parametrize(
    ("vn", "spring", "mu"),
    [(5.0, 3e-6, 0.5), (-0.3, 0.0, 0.5), (-0.3, 0.0, 0.0), (-0.3, 3e-6, 0.0)],
    ids=["no normal force", "no spring", "neither spring nor friction", "no friction"],
)
def test_a_contact_without_force_or_spring_or_friction_has_no_tangential_force(vn, spring, mu):
    c = hertz_mindlin.coefficients(FAN, SURFACE.changed(SurfaceChange(friction=mu)))
    fn, ft, kept = hertz_mindlin.respond(c, RS, MS, 2e-6, vn, vec3(spring, 0, 0), vec3(0, 0, 0))
    assert (ft.x, ft.y, ft.z) == (0, 0, 0)
    assert kept.x == pytest.approx(spring if mu * fn * spring else 0.0, abs=1e-15)


def test_tangential_stiffness_at_first_is_mindlin_s():
    """dF_t/ds at s = 0 is (3/2) K_t with K_t = mu F_n/delta_max, whatever mu: no division by the spring."""
    c = hertz_mindlin.coefficients(FAN, SURFACE)
    delta, s = 1e-6, 1e-15
    fn, ft, _ = hertz_mindlin.respond(c, RS, MS, delta, 0.0, vec3(s, 0, 0), vec3(0, 0, 0))
    assert -ft.x / s == pytest.approx(1.5 * fn / (7 / 6 * delta), rel=1e-6)
    still, rest, _ = hertz_mindlin.respond(c, RS, MS, delta, 0.0, vec3(0, 0, 0), vec3(0, 0, 0))
    assert still == fn
    assert (rest.x, rest.y, rest.z) == (0, 0, 0)


@pytest.mark.parametrize("shear", [1e-8, 1e-6, 1e-5])
@pytest.mark.parametrize("vt", [0.0, 0.01, -0.3])
def test_the_linear_law_is_the_printed_law_and_keeps_the_spring_at_the_limit(shear, vt):
    law = LinearSpringDashpot(normal_stiffness=5e4, friction=0.5)
    c = linear.coefficients(law, SURFACE)
    gamma = c[C_N] * math.sqrt(5e4 * MS)
    delta, vn = 2e-6, -0.05
    fn, ft, kept = linear.respond(c, RS, MS, delta, vn, vec3(0, shear, 0), vec3(0, vt, 0))
    assert fn == pytest.approx(5e4 * delta - gamma * vn, rel=1e-12)
    k_t = 2 / 7 * 5e4
    free = -k_t * shear - gamma * vt
    assert ft.y == pytest.approx(math.copysign(min(abs(free), 0.5 * fn), free), rel=1e-12)
    # so shortened that spring and dashpot together give the limited force
    assert -k_t * kept.y - gamma * vt == pytest.approx(ft.y, rel=1e-9)


@pytest.mark.parametrize(("module", "law"), [(hertz_mindlin, FAN), (linear, LinearSpringDashpot(normal_stiffness=5e4))])
def test_forces_are_never_attractive_and_never_beyond_coulomb(module, law):
    c = module.coefficients(law, SURFACE)
    rng = np.random.default_rng(6)
    for _ in range(500):
        delta, vn = rng.uniform(0, 5e-6), rng.normal() * 0.3
        s, vt = (vec3(*(rng.normal(size=3) * size)) for size in (2e-6, 0.1))
        fn, ft, _ = module.respond(c, RS, MS, delta, vn, s, vt)
        assert fn >= 0
        assert math.hypot(ft.x, ft.y, ft.z) <= 0.5 * fn * (1 + 1e-12)
        assert module.normal(c, RS, MS, delta, vn) == pytest.approx(fn, rel=1e-12)


# from bodies to contacts


def test_slip_by_hand():
    """Grain i above j, both turning the same way about y: their surfaces meet at v + 2 omega x lever."""
    n = vec3(0.0, 0.0, 1.0)
    lever, spin = 1e-3, 10.0
    vt = contact.slip(n, vec3(0.3, 0.0, -0.2), vec3(0.0, 2 * lever * spin, 0.0))
    # at the bottom of i, omega x (-lever n) = -lever omega along x; at the top of j the opposite
    assert (vt.x, vt.y, vt.z) == pytest.approx((0.3 - 2 * lever * spin, 0.0, 0.0))


def test_a_spring_is_truncated_into_the_contact_plane_and_advanced():
    n = vec3(0.6, 0.0, 0.8)
    s = contact.trial(vec3(1.0, 2.0, 3.0), n, vec3(0.8, 0.0, -0.6), 0.5)
    along = 0.6 * 1 + 0.8 * 3
    assert (s.x, s.y, s.z) == pytest.approx((1 - 0.6 * along + 0.4, 2.0, 3 - 0.8 * along - 0.3))


@pytest.mark.parametrize("full", [True, False])
def test_rolling_resistance_opposes_and_is_limited(full):
    n = vec3(0.0, 0.0, 1.0)
    fast = contact.rolling(vec3(3.0, 0.0, 4.0), n, 1e-6, 1.0, full)
    expected = (-0.6e-6, 0, -0.8e-6) if full else (-1e-6, 0, 0)
    assert (fast.x, fast.y, fast.z) == pytest.approx(expected)
    slow = contact.rolling(vec3(3e-9, 0.0, 4e-9), n, 1e-6, 2.0, full)
    assert (slow.x, slow.y, slow.z) == pytest.approx((-6e-9, 0, -8e-9 if full else 0))
    rest = contact.rolling(vec3(0.0, 0.0, 0.0), n, 1e-6, 2.0, full)
    assert (rest.x, rest.y, rest.z) == (0, 0, 0)
    unloaded = contact.rolling(vec3(1.0, 0.0, 0.0), n, 0.0, 2.0, full)
    assert (unloaded.x, unloaded.y, unloaded.z) == (0, 0, 0)
