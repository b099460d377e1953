"""Scenes: what can be, what cannot, and that every fault is found."""

import math

import pytest
from pydantic import ValidationError

from labbook.scene import HertzMindlin, Scene, Spheres, Strip, SurfaceChange, WedgeHopper


def hopper(**changes) -> WedgeHopper:
    sizes = {"width": 0.1, "height": 0.4, "thickness": 0.00303, "orifice": 0.03}
    return WedgeHopper(**{**sizes, **changes})


def scene(container=None, **changes) -> Scene:
    grains = Spheres(diameter=0.003, density=2500.0, count=3000)
    contact = HertzMindlin(shear_modulus=1e8, poisson_ratio=0.25, friction=0.5)
    return Scene(grains=grains, contact=contact, container=container or hopper(), **changes)


def faults(call) -> dict[str, str]:
    with pytest.raises(ValidationError) as caught:
        call()
    return {f.key: f.reason for e in caught.value.errors() for f in e.get("ctx", {}).get("faults", ())}


def test_all_faults_of_a_hopper_are_found_at_once():
    assert faults(lambda: hopper(angle=math.radians(120), gap=0.04)).keys() == {"angle", "gap"}
    assert faults(lambda: hopper(orifice=0.1)).keys() == {"orifice"}
    assert faults(lambda: hopper(angle=math.radians(2))).keys() == {"height"}
    assert faults(lambda: hopper(angle=0.0)).keys() == {"angle"}


def test_the_largest_gap_is_the_middle():
    assert hopper(gap=0.035).eccentricity == pytest.approx(0.0, abs=1e-17)
    assert faults(lambda: hopper(gap=0.0351)).keys() == {"gap"}


def test_a_scene_whose_parts_do_not_fit():
    walls = {
        "bottom": SurfaceChange(friction=0.1),
        "left": SurfaceChange(friction=0.1),
        "floor": SurfaceChange(friction=0.1),
    }
    found = faults(lambda: scene(hopper(thickness=0.002, orifice=0.0029), walls=walls))
    assert found.keys() == {"container.thickness", "container.orifice", "walls.floor"}


def test_inclined_plates_end_where_the_side_walls_begin():
    shapes = {wall.name: wall.shape for wall in hopper(angle=math.radians(30), gap=0.01).walls()}
    walls = {name: shape for name, shape in shapes.items() if isinstance(shape, Strip)}
    assert walls["bottom-left"].start == walls["left"].start
    assert walls["bottom-right"].end == walls["right"].start
    rise = 0.01 / math.tan(math.radians(30))
    assert walls["bottom-left"].start == pytest.approx((-0.05, rise))
    assert walls["bottom-right"].end == pytest.approx((0.05, 0.06 / math.tan(math.radians(30))))


def test_flat_hoppers_that_differ_in_their_outlet_close_to_the_same():
    first, second = scene(hopper(orifice=0.018)), scene(hopper(orifice=0.06, gap=0.0))
    assert first.close(0.01) == second.close(0.01)
    assert scene(hopper(angle=1.0, orifice=0.018)).close() != scene(hopper(angle=1.0)).close()


def test_closing_keeps_what_walls_have_beside_friction():
    walls = {"left": SurfaceChange(friction=0.3), "right": SurfaceChange(friction=0.3, restitution=0.9)}
    closed = scene(walls=walls).close(0.01)
    assert closed.contact.friction == 0.01
    assert closed.walls == {"right": SurfaceChange(restitution=0.9)}


def test_scenes_survive_storage():
    for each in (scene(), scene().close(0.01), scene(hopper(angle=0.5, gap=0.002))):
        assert Scene.model_validate_json(each.model_dump_json()) == each


def test_a_study_may_not_close_a_container():
    raw = {
        "kind": "wedge-hopper",
        "width": "1 m",
        "height": "1 m",
        "thickness": "3 mm",
        "orifice": "9 mm",
        "closed": False,
    }
    with pytest.raises(ValidationError, match="not for a study"):
        WedgeHopper.model_validate(raw, context={"units": "required"})
