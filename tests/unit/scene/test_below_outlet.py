"""Containers that go on below their outlets: where grains leave, and what of them counts in keys."""

import pytest
from pydantic import ValidationError

from labbook.lab import identity
from labbook.scene import ConicalSilo, Frustum, HertzMindlin, Plane, Primitives, Scene, Spheres, Wall, WedgeHopper
from labbook.scene.container_shape import CountingPlane

CONE = {"diameter": 0.1, "height": 0.4, "angle": 0.6, "orifice": 0.03}
PIPE = Wall(name="pipe", shape=Frustum(lower=(0.015, -0.1), upper=(0.015, 0.0)))
FLOOR = Wall(name="floor", shape=Plane(point=(0, 0, -0.3), normal=(0, 0, 1)))
SIDE = Wall(name="aside", shape=Plane(point=(-0.5, 0, 0), normal=(1, 0, 0)))
SLOPE = Wall(name="slope", shape=Plane(point=(0, 0, -0.3), normal=(1, 0, 1)))
LID = Wall(name="lid", shape=Frustum(lower=(0.0, 0.0), upper=(0.015, 0.0)), opens="start")
TUBE = Wall(name="tube", shape=Frustum(lower=(0.015, 0.0), upper=(0.015, 0.3)))


def scene(container) -> Scene:
    grains = Spheres(diameter=3e-3, density=2500, count=10)
    return Scene(grains=grains, contact=HertzMindlin(shear_modulus=1e7, poisson_ratio=0.25), container=container)


def cone(*parts: Wall, **more) -> ConicalSilo:
    return ConicalSilo(**CONE, parts=parts, **more)


@pytest.mark.parametrize(("parts", "lowest"), [((PIPE,), -0.1), ((PIPE, FLOOR), -0.3), ((SIDE,), 0.0), ((), 0.0)])
def test_the_sink_is_found_below_the_lowest_part(parts, lowest):
    """Upright planes have no end, and count for nothing."""
    assert cone(*parts, sink="below-parts").sink == lowest


@pytest.mark.parametrize(
    ("container", "key", "why"),
    [
        (lambda: cone(SLOPE, sink="below-parts"), "sink", "the part slope has no lowest point"),
        (lambda: cone(sink=0.1), "sink", "lies above the outlet"),
        (lambda: Primitives(parts=(FLOOR,), sink=-1.0), "sink", "without an outlet"),
        (lambda: Primitives(planes=(CountingPlane(name="a", z=0.0),)), "planes", "without an outlet"),
        (lambda: cone(planes=(CountingPlane(name="a", z=0.0), CountingPlane(name="a", z=0.1))), "planes", "same name"),
        (lambda: cone(planes=(CountingPlane(name="outlet", z=0.1),)), "planes", "name of an outlet"),
    ],
)
def test_what_cannot_be_is_refused_with_its_key(container, key, why):
    with pytest.raises(ValidationError, match=f"{key}: .*{why}"):
        container()


def test_what_lies_below_the_outlet_does_not_change_the_packing():
    """Hoppers that differ only in what lies below share their beds, and have runs of their own."""
    plain, below = scene(cone()), scene(cone(PIPE, FLOOR, sink="below-parts"))
    assert identity.scene_key(plain.close()) == identity.scene_key(below.close())
    assert [wall.name for wall in below.container.walls()] == ["side", "bottom", "pipe", "floor"]
    keys = {identity.scene_key(scene(cone(PIPE, sink=sink))) for sink in (None, -0.1, -0.2)}
    assert len(keys) == 3
    named = scene(cone(planes=(CountingPlane(name="a", z=0.1),)))
    assert identity.scene_key(named) != identity.scene_key(plain)


def test_parts_at_and_above_the_outlet_stay_while_it_is_filled():
    insert = Wall(name="insert", shape=Frustum(lower=(0.0, 0.1), upper=(0.01, 0.08)))
    walls = cone(insert, PIPE, sink=-0.2).close().walls()
    assert {wall.name for wall in walls} == {"side", "bottom", "lid", "insert"}
    listed = Primitives(parts=(TUBE, LID, PIPE), outlet_plane=0.0, sink=-0.2).close()
    assert [wall.name for wall in listed.walls()] == ["tube", "lid"]


def test_without_a_sink_all_parts_stand_while_it_is_filled():
    """As containers of older versions do."""
    assert "pipe" in {wall.name for wall in cone(PIPE).close().walls()}


def test_a_wedge_takes_a_sink_too():
    assert WedgeHopper(width=0.1, height=0.3, thickness=0.01, orifice=0.03, sink=-0.2).sink == -0.2
    assert scene(WedgeHopper(width=0.1, height=0.3, thickness=0.01, orifice=0.03, sink=-0.2)).close().sink is None
