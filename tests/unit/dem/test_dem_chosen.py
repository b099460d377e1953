"""In plain Python, contacts follow the law that was chosen, and none if none was."""

from concurrent.futures import ThreadPoolExecutor

import pytest
from labbook_dem.chosen import choose, normal
from labbook_dem.laws import LAWS
from labbook_dem.spheres import sphere_on_wall
from labbook_dem.words import vec3

from labbook.scene import HertzLammps, HertzLiggghts, HertzMindlin, HertzPrinted, LinearSpringDashpot, Surface

NONE = vec3(0.0, 0.0, 0.0)
ELASTIC = Surface(friction=0.0, rolling_friction=0.0, restitution=1.0)
RADIUS, OVERLAP = 1.5e-3, 1e-5
HERTZ, LINEAR = HertzMindlin(shear_modulus=1e8, poisson_ratio=0.25), LinearSpringDashpot(normal_stiffness=5e4)
OTHERS = [kind(shear_modulus=1e8, poisson_ratio=0.25) for kind in (HertzPrinted, HertzLiggghts, HertzLammps)]
FORCES = {
    # (4/3) E* sqrt(R) delta^(3/2) with E* = G/(1 - nu)
    **{law.law: (law, 4 / 3 * 1e8 / 0.75 * RADIUS**0.5 * OVERLAP**1.5) for law in (HERTZ, *OTHERS)},
    "linear": (LINEAR, 5e4 * OVERLAP),
}


def at_wall(c) -> float:
    """Force [N] on a sphere at rest that overlaps with a wall."""
    force, _, _ = sphere_on_wall(
        c, RADIUS, 3e-5, OVERLAP, vec3(0.0, 0.0, 1.0), NONE, NONE, NONE, NONE, NONE, 1e-6, 1.0
    )  # fmt: skip
    return force.z


@pytest.mark.parametrize("name", LAWS)
def test_a_contact_follows_the_chosen_law(name):
    contact, expected = FORCES[name]
    with choose(name) as law:
        assert at_wall(law.coefficients(contact, ELASTIC, wall=True)) == pytest.approx(expected, rel=1e-12)


def test_without_a_choice_there_is_no_law():
    c = LAWS["linear"].coefficients(LINEAR, ELASTIC)
    with pytest.raises(RuntimeError, match="no contact law is chosen"):
        at_wall(c)
    with choose("linear"):
        pass
    with pytest.raises(RuntimeError, match="no contact law is chosen"):
        normal(c, RADIUS, 3e-5, OVERLAP, 0.0)


def test_a_choice_holds_in_its_block_and_thread():
    linear, hertz = (LAWS[name].coefficients(FORCES[name][0], ELASTIC) for name in ("linear", "hertz-mindlin"))
    with choose("linear"):
        with choose("hertz-mindlin"):
            assert at_wall(hertz) == pytest.approx(FORCES["hertz-mindlin"][1], rel=1e-12)
        assert at_wall(linear) == pytest.approx(FORCES["linear"][1], rel=1e-12)
        with ThreadPoolExecutor(1) as pool, pytest.raises(RuntimeError, match="no contact law is chosen"):
            pool.submit(at_wall, linear).result()


def test_an_unknown_law_is_refused():
    with (
        pytest.raises(ValueError, match=r"no contact law is called adhesive; there are hertz-mindlin, .*, linear"),
        choose("adhesive"),
    ):
        pass
