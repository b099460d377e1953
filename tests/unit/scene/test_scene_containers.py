"""Scenes: what can be, what cannot, and that every fault is found."""

import math

import numpy as np
import pytest
from matplotlib.path import Path
from pydantic import ValidationError

from labbook.scene import (
    Box,
    ConicalSilo,
    CylinderSilo,
    HertzMindlin,
    Plane,
    Primitives,
    Scene,
    Spheres,
    Strip,
    SurfaceChange,
    Wall,
    WedgeHopper,
)


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
    with pytest.raises(ValidationError, match="a study cannot set this"):
        WedgeHopper.model_validate(raw, context={"units": "required"})


def polygon(container) -> np.ndarray:
    """The inside of a section through the axis, above the outlet, from its walls as they are drawn."""
    ends = [end for wall in container.walls() for segment in wall.shape.section() for end in segment]
    right = sorted({(x, z) for x, z in ends if x > 0 and z < 1}, key=lambda end: (end[1], end[0]))
    left = sorted({(x, z) for x, z in ends if x < 0 and z < 1}, key=lambda end: (-end[1], end[0]))
    return np.array([*right, *left])


@pytest.mark.parametrize(
    "container",
    [
        hopper(),
        hopper(angle=math.radians(30)),
        hopper(angle=math.radians(60), gap=0.01),
        CylinderSilo(diameter=0.1, height=0.2, orifice=0.03),
        ConicalSilo(diameter=0.1, height=0.2, orifice=0.03, angle=math.radians(40)),
    ],
)
def test_a_container_holds_what_lies_between_its_walls(container):
    """Against the polygon of its drawn walls, in the plane y = 0."""
    x = np.random.default_rng(1).uniform((-0.07, 0, -0.02), (0.07, 0, 0.15), (4000, 3))
    assert np.array_equal(container.inside(x), Path(polygon(container)).contains_points(x[:, [0, 2]]))
    above = x + np.array([0.0, 0.0, 1.0])
    assert np.array_equal(container.inside(above), np.abs(x[:, 0]) < 0.05)
    across = x[:, [1, 0, 2]]
    if isinstance(container, WedgeHopper):
        assert not container.inside(across)[np.abs(across[:, 1]) > container.thickness / 2].any()
    else:
        assert np.array_equal(container.inside(across), container.inside(x))
    ends = polygon(container)
    out = x[:, 0]
    lowest = ends[ends[:, 1] == 0, 0]
    if container.walls()[-1].shape.section()[0][0][1] == 0:
        first, last = sorted(end for end in lowest if abs(end) < 0.05 * (1 - 1e-9))
        assert np.array_equal(container.lets_out(x), (out > first) & (out < last))


def test_a_box_holds_what_is_below_its_lid_and_has_no_outlet():
    x = np.array([[0, 0, 0.01], [0.051, 0, 0.01], [0, -0.021, 0.01], [0, 0, -0.01], [0, 0, 0.2]])
    box = Box(width=0.1, depth=0.04, height=0.1)
    assert box.inside(x).tolist() == [True, False, False, False, True]
    assert box.model_copy(update={"lid": True}).inside(x).tolist() == [True, False, False, False, False]
    assert not box.lets_out(x).any()


def test_primitives_hold_what_is_behind_no_plane():
    x = np.array([[0, 0, 0.01], [0, 0, -0.01], [-1.0, 0, 0.01]])
    floor = Wall(name="floor", shape=Plane(point=(0, 0, 0), normal=(0, 0, 2)))
    side = Wall(name="side", shape=Plane(point=(-0.5, 0, 0), normal=(1, 0, 0)))
    plate = Wall(name="plate", shape=Strip(start=(0, 0), end=(1, 1)))
    assert Primitives(parts=(floor, side, plate)).inside(x).tolist() == [True, False, False]
    assert Primitives().inside(x).all()


def test_grains_leave_listed_walls_where_their_lids_lay():
    """Between two outlets is a hole without a lid; lids above the plane do not tell where grains cross it."""

    def strip(name: str, first: float, last: float, z: float = 0.0, opens=None) -> Wall:
        return Wall(name=name, opens=opens, shape=Strip(kind="strip", start=(first, z), end=(last, z)))

    floor = strip("left", -0.05, -0.03), strip("middle", -0.01, 0.0), strip("right", 0.04, 0.05)
    front = Wall(name="front", shape=Plane(kind="plane", point=(0, -0.01, 0), normal=(0, 1, 0)))
    lids = strip("a", -0.03, -0.01, opens="start"), strip("b", 0.01, 0.04, opens="start")
    two = Primitives(parts=(*floor, front, *lids), outlet_plane=0.0)
    x = np.array([[at, 0, -1e-5] for at in (-0.0301, -0.0299, -0.02, 0.005, 0.0101, 0.0399)] + [[0.02, -0.02, -1e-5]])
    assert two.lets_out(x).tolist() == [False, True, True, False, True, True, False]
    assert two.lets_out(x, 0.001).tolist() == [True, True, True, False, True, True, False]
    above = strip("a", -0.03, -0.01, 0.01, opens="start"), strip("b", 0.01, 0.04, opens="start")
    assert Primitives(parts=(*floor, front, *above), outlet_plane=0.0).lets_out(x)[:6].all()
