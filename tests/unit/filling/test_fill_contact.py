"""Beds that are filled by another contact law than that of the flow: `fill.contact`."""

import pytest

from labbook.plan.demand import PointDemand
from labbook.scene import HertzMindlin
from labbook.study import define
from labbook.study.load import StudyError

MINDLIN = {"law": "hertz-mindlin", "shear_modulus": "1 MPa", "poisson_ratio": 0.25, "friction": 0.5,
           "rolling_friction": 0.01, "restitution": 0.2}  # fmt: skip


def study(**keys):
    stated = {
        "name": "laws",
        "grains": {"shape": "sphere", "diameter": "3 mm", "density": "2500 kg/m^3", "count": 100},
        "contact": {**MINDLIN, "law": "hertz-liggghts"},
        "container": {"kind": "wedge-hopper", "width": "30 mm", "height": "60 mm", "thickness": "1.01 d",
                      "orifice": "20 mm"},
        "sweep": {"contact.law": ["hertz-liggghts", "hertz-lammps", "hertz-printed"]},
    }  # fmt: skip
    return define({key: value for key, value in (stated | keys).items() if value is not None})


def filled(one):
    return [PointDemand(one, point).closed_key for point in one.points]


def test_studies_of_several_laws_start_from_the_same_beds():
    assert len(set(filled(study()))) == 3
    same = study(fill={"contact": MINDLIN})
    assert len(set(filled(same))) == 1
    of_the_law_itself = study(contact=MINDLIN, sweep=None)
    assert filled(same)[0] == filled(of_the_law_itself)[0]
    assert [point.scene.contact.law for point in same.points] == ["hertz-liggghts", "hertz-lammps", "hertz-printed"]


def test_friction_while_filling_is_that_of_the_other_law_too():
    slippery = study(fill={"contact": MINDLIN, "friction": 0.01})
    law = PointDemand(slippery, slippery.points[0]).closed.contact
    assert isinstance(law, HertzMindlin)
    assert (law.friction, law.rolling_friction) == (0.01, 0.01)


def test_a_filling_that_states_no_law_is_stored_as_before():
    one = study().points[0].fill
    assert "contact" not in one.model_dump(mode="json")


def test_the_step_is_stable_in_the_filling_too():
    stiff = {**MINDLIN, "shear_modulus": "400 MPa"}
    alone = study().points[0].numerics.dt
    chosen = study(fill={"contact": stiff}).points[0].numerics.dt
    assert chosen < 0.25 * alone
    with pytest.raises(StudyError, match="beds do not come to rest"):
        study(fill={"contact": stiff}, numerics={"dt": f"{alone * 1e6} us"})


def test_kinds_that_do_not_exist_are_refused():
    pairs = [{"kinds": ["glass", "steel"], "friction": 0.1}]
    with pytest.raises(StudyError, match=r"fill\.contact\.between"):
        study(fill={"contact": {**MINDLIN, "between": pairs}})


def test_a_sweep_may_vary_the_law_of_the_filling():
    both = study(
        contact={**MINDLIN, "law": "hertz-liggghts"},
        sweep={"fill.contact.law": ["hertz-mindlin", "hertz-lammps"]},
        fill={"contact": MINDLIN},
    )
    assert len(set(filled(both))) == 2
    assert [point.at["fill.contact.law"] for point in both.points] == ["hertz-mindlin", "hertz-lammps"]
