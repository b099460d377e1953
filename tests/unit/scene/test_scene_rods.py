"""Spherocylinders and round silos: what they are, and what cannot be."""

import math

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from labbook.lab.identity import scene_key
from labbook.scene import (
    ConicalSilo,
    CylinderSilo,
    Frustum,
    Grains,
    LinearSpringDashpot,
    Primitives,
    Scene,
    Spherocylinders,
    Wall,
)

ROD = Spherocylinders(diameter=6e-3, length=20e-3, density=620, count=10)


def faults(call) -> dict[str, str]:
    with pytest.raises(ValidationError) as caught:
        call()
    return {f.key: f.reason for e in caught.value.errors() for f in e.get("ctx", {}).get("faults", ())}


def scene(container, grains=ROD, **further) -> Scene:
    return Scene(grains=grains, contact=LinearSpringDashpot(normal_stiffness=200.0), container=container, **further)


def sampled(n: int = 2_000_000) -> np.ndarray:
    """Random points inside the rod, shape [m, 3]."""
    x = np.random.default_rng(1).uniform([-3e-3, -3e-3, -10e-3], [3e-3, 3e-3, 10e-3], (n, 3))
    heart = np.clip(x[:, 2], -ROD.half_length, ROD.half_length)
    return x[x[:, 0] ** 2 + x[:, 1] ** 2 + (x[:, 2] - heart) ** 2 <= ROD.radius**2]


def test_volume_and_inertia_are_those_of_a_body_full_of_points():
    x = sampled()
    box = 6e-3 * 6e-3 * 20e-3
    assert ROD.volume == pytest.approx(box * len(x) / 2_000_000, rel=3e-3)
    assert ROD.mass == pytest.approx(620 * ROD.volume, rel=1e-12)
    squares = (x**2).mean(axis=0)
    assert ROD.inertia == pytest.approx(ROD.mass * (squares[0] + squares[2]), rel=3e-3)
    assert ROD.inertia_axis == pytest.approx(ROD.mass * (squares[0] + squares[1]), rel=3e-3)


def test_the_equivalent_sphere_of_pongo_s_rod_has_9_9_mm():
    assert ROD.equivalent_diameter == pytest.approx(9.9e-3, abs=0.05e-3)


def test_a_length_may_be_given_in_diameters():
    raw = {
        "shape": "spherocylinder", "diameter": "6 mm", "length": "2.5 d", "density": "620 kg/m^3", "count": 5,
    }  # fmt: skip
    read = TypeAdapter(Grains).validate_python(raw, context={"units": "required"})
    assert isinstance(read, Spherocylinders)
    assert read.length == pytest.approx(15e-3)
    assert faults(lambda: Spherocylinders(diameter=6e-3, length=5e-3, density=620, count=1)).keys() == {"length"}


def test_what_cannot_be_a_silo():
    assert faults(lambda: CylinderSilo(diameter=0.19, height=0.5, orifice=0.19)).keys() == {"orifice"}
    for degrees, key in ((5, "height"), (90, "angle")):
        angle = math.radians(degrees)
        assert faults(lambda a=angle: ConicalSilo(diameter=0.19, height=0.5, orifice=0.06, angle=a)).keys() == {key}
    assert faults(lambda: scene(CylinderSilo(diameter=0.19, height=0.5, orifice=5e-3))).keys() == {"container.orifice"}
    assert faults(lambda: Frustum(lower=(0.2, 0), upper=(0.1, 0.1))).keys() == {"upper"}
    assert faults(lambda: Frustum(lower=(-0.1, 0), upper=(0.1, 0.1))).keys() == {"lower"}


def test_flat_silos_that_differ_in_outlet_and_rotation_close_to_the_same():
    silos = [CylinderSilo(diameter=0.19, height=0.5, orifice=o, rotation=f) for o, f in ((0.05, 0.0), (0.06, 0.32))]
    first, second = (scene(silo) for silo in silos)
    assert first.close() == second.close()
    assert scene_key(first) != scene_key(second)
    turning = {wall.name: wall.motion.spin for wall in silos[1].walls()}
    assert turning == {"side": 0.0, "bottom": pytest.approx(2 * math.pi * 0.32)}


def test_the_walls_of_a_conical_silo_meet():
    silo = ConicalSilo(diameter=0.19, height=0.5, orifice=0.06, angle=math.radians(30))
    shapes = {wall.name: wall.shape for wall in silo.close().walls()}
    assert set(shapes) == {"side", "bottom", "lid"}
    side, bottom, lid = (shapes[name] for name in ("side", "bottom", "lid"))
    assert isinstance(side, Frustum)
    assert isinstance(bottom, Frustum)
    assert isinstance(lid, Frustum)
    assert side.lower == bottom.upper == pytest.approx((0.095, 0.065 / math.tan(math.radians(30))))
    assert lid.upper == bottom.lower == (0.03, 0.0)
    assert "lid" not in {wall.name for wall in silo.walls()}


def test_scenes_with_rods_survive_storage():
    parts = (Wall(name="hole", shape=Frustum(lower=(0.1, 0), upper=(0.2, 0))),)
    for each in (scene(Primitives(parts=parts)), scene(CylinderSilo(diameter=0.19, height=0.5, orifice=0.06)).close()):
        assert Scene.model_validate_json(each.model_dump_json()) == each
