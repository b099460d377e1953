"""Materials of kinds and walls: effective moduli, what follows from them, and what cannot be."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from labbook_dem.features import pair_table, wall_tables
from labbook_dem.laws import LAWS
from labbook_dem.words import vec3
from labbook_warp.parameters import DEEP, largest_force
from wrong_study import BASE, problems

from labbook.backend.numerics import Numerics
from labbook.lab.identity import scene_key
from labbook.plan.advice import softer
from labbook.scene import (
    Between,
    ContactLaw,
    HertzMindlin,
    Kind,
    LinearSpringDashpot,
    Scene,
    Spheres,
    SurfaceChange,
    WedgeHopper,
)
from labbook.scene.material import Material
from labbook.scene.timescales import collision, largest_stable_step, rayleigh
from labbook.study import load

D = 3e-3
HERTZ = HertzMindlin(shear_modulus=1e8, poisson_ratio=0.25, friction=0.5)
LINEAR = LinearSpringDashpot(normal_stiffness=1e4, friction=0.5)
HOPPER = WedgeHopper(width=0.1, height=0.4, thickness=1.01 * D, orifice=0.03)
NUMERICS = Numerics(dt=1e-6)
A, B = Material(1e7, 0.45), Material(3e8, 0.1)


def scene(law: ContactLaw = HERTZ, kinds=(), **walls) -> Scene:
    grains = Spheres(diameter=D, density=2500, count=10, kinds=kinds)
    return Scene(grains=grains, contact=law, container=HOPPER, walls=walls)


def kind(name, **given) -> Kind:
    return Kind.model_validate({"name": name, "share": 0.5, **given})


def own(material: Material) -> dict[str, float]:
    return material._asdict()


MODULI = st.floats(1e3, 1e12)
RATIOS = st.floats(-0.9, 0.5)


@given(MODULI, RATIOS, MODULI, RATIOS)
def test_two_bodies_touch_by_their_effective_moduli(g1, nu1, g2, nu2):
    """E* and G* by the formulas, from a law of one material that stands for both, in either order to the last bit."""
    one, two = Material(g1, nu1), Material(g2, nu2)
    assert one.beside(two) == two.beside(one)
    law = HERTZ.model_copy(update=own(one.beside(two)))
    young = [2 * g * (1 + nu) for g, nu in (one, two)]
    effective = 1 / sum((1 - nu**2) / e for e, nu in zip(young, (nu1, nu2), strict=True))
    assert law.effective_modulus == pytest.approx(effective, rel=1e-12)
    shear = 1 / sum((2 - nu) / g for g, nu in (one, two))
    kappa = LAWS["hertz-mindlin"].coefficients(law, scene().surface_of_grains)[3]
    assert kappa == pytest.approx(effective / (4 * shear), rel=1e-12)


@pytest.mark.parametrize("law", ["hertz-mindlin", "hertz-liggghts", "hertz-lammps"])
def test_friction_is_8_g_star_at_first(law):
    """k_t = 8 G* sqrt(R* delta) where nothing has slid."""
    contact = HERTZ.model_copy(update=own(A.beside(B)))
    c = LAWS[law].coefficients(contact, scene().surface_of_grains)
    rs, delta, s = 0.75e-3, 1e-6, 1e-15
    _, ft, _ = LAWS[law].respond(c, rs, 1e-5, delta, 0.0, vec3(s, 0, 0), vec3(0, 0, 0))
    shear = 1 / sum((2 - nu) / g for g, nu in (A, B))
    assert -ft.x / s == pytest.approx(8 * shear * math.sqrt(rs * delta), rel=1e-6)


def test_stiffness_of_each_contact():
    """Kinds, walls by name, and `all`; whoever states nothing is of the material of `contact`."""
    mixed = scene(
        HERTZ, (kind("a", **own(A)), kind("b")), all=SurfaceChange(**own(B)), left=SurfaceChange(shear_modulus=2e9)
    )
    rest = Material(1e8, 0.25)
    assert mixed.law_between(0, 0).material == A
    assert mixed.law_between(1, 1) is HERTZ
    assert mixed.law_between(0, 1) == mixed.law_between(1, 0)
    assert mixed.law_between(0, 1).material == A.beside(rest)
    walls = {wall.name: wall for wall in mixed.container.walls()}
    assert mixed.law(walls["back"], 1).material == rest.beside(B)
    assert mixed.law(walls["left"], 0).material == A.beside(Material(2e9, B.poisson_ratio))
    springs = scene(
        LINEAR.model_copy(update={"between": (Between(kinds=("b", "a"), normal_stiffness=2e4),)}),
        (kind("a"), kind("b")),
        left=SurfaceChange(normal_stiffness=5e4),
    )
    stiffness = [[springs.law_between(a, b).normal_stiffness for b in (0, 1)] for a in (0, 1)]  # pyright: ignore[reportAttributeAccessIssue]
    assert stiffness == [[1e4, 2e4], [2e4, 1e4]]
    table = wall_tables(springs, NUMERICS).c[:, 0].reshape(-1, 2)
    assert [set(row) for row in table.tolist()] == [
        {5e4} if wall.name == "left" else {1e4} for wall in springs.container.walls()
    ]


@pytest.mark.parametrize("law", ["hertz-mindlin", "hertz-printed", "hertz-liggghts", "hertz-lammps", "linear"])
def test_what_is_stated_again_changes_no_bit(law):
    """Coefficients, time steps and the quanta of sums, where kinds and walls state what `contact` has."""
    same = own(Material(1e8, 0.25)) if law != "linear" else {}
    spring = {"normal_stiffness": 1e4} if law == "linear" else {}
    contact = {"law": law, "friction": 0.5, **same, **spring}
    kinds = tuple({"name": name, "share": 0.5} for name in "ab")
    between = [{"kinds": pair, **spring} for pair in (("a", "a"), ("a", "b"), ("b", "b"))] if spring else []
    grains = {"shape": "sphere", "diameter": D, "density": 2500, "count": 10}
    plain = Scene.model_validate({"grains": {**grains, "kinds": kinds}, "contact": contact, "container": HOPPER})
    again = Scene.model_validate(
        {
            "grains": {**grains, "kinds": [{**one, **same} for one in kinds]},
            "contact": {**contact, "between": between},
            "container": HOPPER,
            "walls": {"all": {**same, **spring}},
        }
    )
    assert again != plain
    assert np.array_equal(pair_table(again, NUMERICS), pair_table(plain, NUMERICS))
    assert np.array_equal(wall_tables(again, NUMERICS).c, wall_tables(plain, NUMERICS).c)
    assert collision(again) == collision(plain)
    assert largest_force(again, NUMERICS) == largest_force(plain, NUMERICS)
    assert scene_key(again) == scene_key(plain)
    if law != "linear":  # of two kinds that are alike, and unlike what no grain is made of
        other = plain.model_copy(update={"contact": plain.contact.model_copy(update=own(A))})
        alike = other.model_copy(update={"grains": again.grains, "walls": again.walls})
        assert np.array_equal(pair_table(alike, NUMERICS), pair_table(plain, NUMERICS))
        assert (collision(alike), rayleigh(alike)) == (collision(plain), rayleigh(plain))


def test_a_key_is_of_the_contacts_not_of_their_spelling():
    by_g = scene(left=SurfaceChange(shear_modulus=1e9, poisson_ratio=0.25))
    by_e = scene(left=SurfaceChange(youngs_modulus=2.5e9, poisson_ratio=0.25))
    assert scene_key(by_g) == scene_key(by_e) != scene_key(scene())
    assert scene_key(scene(left=SurfaceChange(shear_modulus=1.1e9))) != scene_key(by_g)
    unlike = scene(kinds=(kind("a", **own(A)), kind("b")))
    assert scene_key(unlike) != scene_key(scene(kinds=(kind("a"), kind("b", **own(A)))))
    assert scene_key(unlike) != scene_key(scene(kinds=(kind("a"), kind("b"))))
    springs = scene(LINEAR, left=SurfaceChange(normal_stiffness=2e4))
    assert scene_key(springs) != scene_key(scene(LINEAR))


def test_steps_go_by_the_stiffest_contact():
    """A rigid wall doubles E*, and mass and radius are twice those of two spheres: t_c by (4/(2 2^2))^{1/5}. A wall
    whose spring is eight times as stiff has t_c by (2/8)^{1/2}."""
    rigid = scene(right=SurfaceChange(shear_modulus=1e15))
    assert collision(rigid) == pytest.approx(collision(scene()) * 0.5**0.2, rel=1e-6)
    assert rayleigh(rigid) == rayleigh(scene())
    assert largest_stable_step(rigid) == pytest.approx(largest_stable_step(scene()) * 0.5**0.2, rel=1e-6)
    springs = scene(LINEAR, right=SurfaceChange(normal_stiffness=8e4))
    assert collision(springs) == pytest.approx(collision(scene(LINEAR)) / 2, rel=1e-12)
    pair = LINEAR.model_copy(update={"between": (Between(kinds=("a", "b"), normal_stiffness=1e6),)})
    assert collision(scene(pair, (kind("a"), kind("b")))) == pytest.approx(collision(scene(LINEAR)) / 10, rel=1e-12)
    stiff = scene(HERTZ, (kind("a"), kind("b", **own(B))))
    one = scene(HERTZ.model_copy(update=own(B)))
    assert rayleigh(stiff) == rayleigh(one) < rayleigh(scene())
    assert collision(stiff) == collision(one) < collision(scene())


@pytest.mark.parametrize("law", [HERTZ, LINEAR])
def test_stiffening_takes_all_that_is_stated(law):
    given = own(B) if law is HERTZ else {"normal_stiffness": 3e4}
    pairs = () if law is HERTZ else (Between(kinds=("a", "b"), normal_stiffness=7e4),)
    kinds = (kind("a", **(own(A) if law is HERTZ else {})), kind("b"))
    made = scene(law.model_copy(update={"between": pairs}), kinds, all=SurfaceChange(**given))
    scaled, stiffer = Numerics(dt=1e-6, stiffness_scale=16.0), made.stiffened(16.0)
    assert np.array_equal(pair_table(stiffer, NUMERICS), pair_table(made, scaled))
    assert np.array_equal(wall_tables(stiffer, NUMERICS).c, wall_tables(made, scaled).c)
    times = (16.0**-0.4) if law is HERTZ else 0.25
    assert collision(stiffer) == pytest.approx(times * collision(made), rel=1e-12)


def test_sums_hold_the_force_of_a_stiff_wall():
    """Forces are counted in quanta of the largest at an overlap of d/4; that of a wall is of the whole radius."""
    plain, stiff = scene(LINEAR), scene(LINEAR, left=SurfaceChange(normal_stiffness=1e8))
    assert largest_force(plain, NUMERICS) == pytest.approx(1e4 * DEEP * D)
    assert largest_force(stiff, NUMERICS) == pytest.approx(1e8 * DEEP * D)


def test_the_stiffest_grains_are_told_to_be_softer():
    mixed = scene(HERTZ.model_copy(update=own(A)), (kind("a"), kind("b", shear_modulus=1e11)))
    told = softer(mixed, 0.2)
    alone = softer(scene(HertzMindlin(shear_modulus=1e11, poisson_ratio=A.poisson_ratio)), 0.2)
    assert told is not None
    assert alone is not None
    assert told[0] == "grains.kinds[].shear_modulus"
    assert alone[0] == "contact.shear_modulus"
    assert told[1:] == alone[1:]
    young = softer(scene(HERTZ.model_copy(update=own(A)), (kind("a"), kind("b", youngs_modulus=2.9e11))), 0.2)
    assert young is not None
    assert young[:2] == ("grains.kinds[].youngs_modulus", pytest.approx(2 * (1 + A.poisson_ratio) * told[1]))
    assert young[2:] == pytest.approx(told[2:])


def test_stiff_walls_are_named_as_stated():
    for name in ("all", "left"):
        told = softer(scene(LINEAR, **{name: SurfaceChange(normal_stiffness=1e8)}), 0.2)
        assert told is not None
        assert told[0] == f"walls.{name}.normal_stiffness"


def test_a_study_may_state_young_s_modulus(tmp_path):
    path = tmp_path / "base.yaml"
    path.write_text(BASE.replace("shear_modulus: 100 MPa", "youngs_modulus: 250 MPa"))
    (point,) = load(path).points
    path.write_text(BASE)
    assert point.scene == load(path).points[0].scene
    assert "youngs_modulus" not in point.scene.model_dump_json()
    swept = BASE.replace("shear_modulus: 100 MPa", "youngs_modulus: 1 MPa")
    path.write_text(f'{swept}sweep: {{contact.youngs_modulus: "[250, 500] MPa", walls.all.youngs_modulus: [1 GPa]}}\n')
    points = load(path).points
    assert [point.at["contact.youngs_modulus"] for point in points] == [2.5e8, 5e8]
    assert points[1].scene.contact.shear_modulus == 2e8  # pyright: ignore[reportAttributeAccessIssue]
    assert points[0].at["walls.all.youngs_modulus"] == 1e9


HERTZIAN = "shear_modulus: 100 MPa, poisson_ratio: 0.25"
WRONG = [
    (HERTZIAN, f"youngs_modulus: 1 GPa, {HERTZIAN}", "contact.youngs_modulus", "E and G are both given"),
    (HERTZIAN, "youngs_modulus: 1, poisson_ratio: 0.25", "contact.youngs_modulus", "the unit is missing"),
    (HERTZIAN, "youngs_modulus: 1 GPa", "contact.poisson_ratio", "this key is missing"),
    (HERTZIAN, "poisson_ratio: 0.25", "contact.shear_modulus", "this key is missing"),
    ("name: base", "name: base\nwalls: {all: {poisson_ratio: 0.3}}", "walls.all.poisson_ratio", "does not define"),
    (
        "name: base",
        "name: base\nwalls: {all: {youngs_modulus: 1 GPa, shear_modulus: 1 GPa}}",
        "walls.all.youngs_modulus",
        "one follows from",
    ),
    (
        "name: base",
        "name: base\nwalls: {all: {normal_stiffness: 1 N/m}}",
        "walls.all.normal_stiffness",
        "the law hertz-mindlin has no normal_stiffness",
    ),
]


@pytest.mark.parametrize(("old", "new", "key", "message"), WRONG)
def test_materials_that_cannot_be(tmp_path, old, new, key, message):
    found = {problem.key: problem.message for problem in problems(tmp_path, BASE.replace(old, new))}
    assert message in found[key]


@pytest.mark.parametrize(
    "where", [{"kinds": (kind("a", **own(A)), kind("b"))}, {"left": SurfaceChange(shear_modulus=1e8)}]
)
def test_a_law_of_springs_has_no_material(where):
    with pytest.raises(ValueError, match="the law linear has no elastic moduli"):
        scene(LINEAR, **where)


def test_printed_damping_is_not_for_walls_of_another_stiffness():
    with pytest.raises(ValueError, match="grain-grain dashpot"):
        scene(LINEAR.model_copy(update={"damping": "printed"}), left=SurfaceChange(normal_stiffness=1e5))
