"""Restitution has no default in a study, and a bed that keeps its energy is refused: it cannot settle.

A filling loses energy by impacts (e < 1, or a normal dashpot), by sliding, and, for rods, by rolling friction, since
normal forces turn rods but not spheres.
"""

import labbook_toy
import pytest

import labbook
from labbook.lab import Catalogue
from labbook.plan.advice import advice
from labbook.plan.plan import Planner
from labbook.scene import HertzMindlin, LinearSpringDashpot
from labbook.study import StudyError

GRAINS = {"shape": "sphere", "diameter": "3 mm", "density": "2500 kg/m^3", "count": 800}
RODS = {**GRAINS, "shape": "spherocylinder", "length": "6 mm"}
SLOT = {"kind": "wedge-hopper", "width": "48 mm", "height": "400 mm", "thickness": "4 d", "orifice": "30 mm"}
HERTZ = {"law": "hertz-mindlin", "shear_modulus": "2 MPa", "poisson_ratio": 0.25, "friction": 0.5}
LINEAR = {"law": "linear", "normal_stiffness": "2000 N/m", "friction": 0.5}
RESTLESS = "neither impacts nor friction lose energy"


def study(contact, grains=GRAINS, **keys):
    return labbook.define(name="x", grains=grains, contact=contact, container=SLOT, replicates=2, **keys)


@pytest.mark.parametrize(("law", "other"), [(HERTZ, ", or state normal_damping"), (LINEAR, "")])
def test_restitution_has_to_be_stated(law, other):
    with pytest.raises(StudyError, match=rf"contact\.restitution: this key is missing\n.*for example 0\.5{other};"):
        study(law)
    with pytest.raises(StudyError, match=r"fill\.contact\.restitution: this key is missing"):
        study({**HERTZ, "restitution": 0.5}, fill={"contact": law})
    swept = study(law, sweep={"contact.restitution": [0.2, 0.5]})
    assert [point.scene.contact.restitution for point in swept.points] == [0.2, 0.5]


def test_a_normal_damping_is_enough():
    assert study({**HERTZ, "normal_damping": 0.3}).points[0].scene.contact.restitution == 1


def test_a_misspelled_restitution_is_one_problem():
    with pytest.raises(StudyError) as caught:
        study({**HERTZ, "cor": 0.5})
    assert [problem.key for problem in caught.value.problems] == ["contact.cor"]
    with pytest.raises(StudyError) as caught:
        study({**HERTZ, "restitution": 1.5})
    assert len(caught.value.problems) == 1


def test_laws_made_in_python_and_stored_ones_keep_their_default():
    for law in (HertzMindlin(shear_modulus=1e8, poisson_ratio=0.25), LinearSpringDashpot(normal_stiffness=1e3)):
        stored = law.model_dump()
        assert stored["restitution"] == 1
        del stored["restitution"]
        assert type(law).model_validate(stored) == law


@pytest.mark.parametrize(
    ("contact", "more", "key"),
    [
        ({**HERTZ, "friction": 0, "restitution": 1}, {}, "contact.restitution"),
        ({**LINEAR, "friction": 0, "restitution": 1}, {}, "contact.restitution"),
        ({**HERTZ, "friction": 0, "restitution": 1, "rolling_friction": 0.1}, {}, "contact.restitution"),
        ({**HERTZ, "friction": 0, "normal_damping": 0, "restitution": 0.5}, {}, "contact.normal_damping"),
        ({**HERTZ, "restitution": 1}, {"fill": {"friction": 0}}, "contact.restitution"),
        (
            {**HERTZ, "restitution": 0.5},
            {"fill": {"contact": {**LINEAR, "restitution": 1, "friction": 0}}},
            "fill.contact.restitution",
        ),
    ],
)
def test_a_bed_that_cannot_lose_energy_is_refused(contact, more, key):
    with pytest.raises(StudyError, match=RESTLESS) as caught:
        study(contact, **more)
    (problem,) = caught.value.problems
    assert problem.key == key
    assert problem.remedy.startswith("use a ")


@pytest.mark.parametrize(
    ("contact", "more"),
    [
        ({**HERTZ, "friction": 0, "restitution": 0.9}, {}),
        ({**HERTZ, "friction": 0, "restitution": 1}, {"walls": {"front": {"restitution": 0.9}}}),
        ({**HERTZ, "friction": 0, "restitution": 1}, {"walls": {"all": {"friction": 0.1}}}),
        ({**HERTZ, "friction": 0, "restitution": 1}, {"fill": {"friction": 0.1}}),
        (
            {**HERTZ, "friction": 0, "restitution": 1},
            {"fill": {"contact": {**LINEAR, "restitution": 0.5, "friction": 0}}},
        ),
        ({**HERTZ, "friction": 0, "restitution": 1, "rolling_friction": 0.1}, {"grains": RODS}),
    ],
)
def test_one_way_to_lose_energy_is_enough(contact, more):
    assert study(contact, **more).points


def warnings(study, tmp_path):
    plan = Planner(study, Catalogue(tmp_path / "lab"), labbook_toy.Backend().capabilities).plan()
    return [line for line in advice(plan) if "impacts lose no energy" in line]


def test_a_filling_that_loses_energy_by_friction_alone_is_warned_of(tmp_path):
    """Sliding dissipates, but not the collinear vibrations of a bed: it hovers (measured, see `advice`)."""
    (warning,) = warnings(study({**HERTZ, "restitution": 1}), tmp_path)
    assert "contact.restitution" in warning
    assert not warnings(study({**HERTZ, "restitution": 0.5}), tmp_path)
    assert not warnings(study({**HERTZ, "restitution": 1}, fill={"contact": {**LINEAR, "restitution": 0.5}}), tmp_path)
