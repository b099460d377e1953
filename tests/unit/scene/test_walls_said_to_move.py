"""Parts that open at the start, and surfaces that move: what a study may say of a wall, and what a plan refuses."""

import json
import math

import labbook_toy
import numpy as np
import pytest
from toy_lab import labbook

from labbook.filling import start_of_discharge
from labbook.lab import Catalogue
from labbook.lab.identity import scene_key
from labbook.plan.demand import Conflict, demands
from labbook.plan.plan import Planner
from labbook.plan.possible import check
from labbook.scene import Packing, Scene, SurfaceMotion
from labbook.scene.walls import Frustum, Plane, Strip
from labbook.study import StudyError, load

HEAD = """
name: moving-walls
grains: {shape: sphere, diameter: 3 mm, density: 2500 kg/m^3, count: 200}
contact: {law: hertz-mindlin, shear_modulus: 2 MPa, poisson_ratio: 0.25, friction: 0.5, restitution: 0.2}
numerics: {dt: 10 us, precision: double}
measure: []
stop: {max_time: 1 s}
"""
SLOT = """
container:
  kind: primitives
  outlet_plane: 0 mm
  parts:
    - {name: front, shape: {kind: plane, point: [0 mm, -1.515 mm, 0 mm], normal: [0, 1, 0]}}
    - {name: back, shape: {kind: plane, point: [0 mm, 1.515 mm, 0 mm], normal: [0, -1, 0]}}
    - {name: left, shape: {kind: plane, point: [-30 mm, 0 mm, 0 mm], normal: [1, 0, 0]}}
    - {name: right, shape: {kind: plane, point: [30 mm, 0 mm, 0 mm], normal: [-1, 0, 0]}}
    - {name: floor-1, MOTIONshape: {kind: strip, start: [-30 mm, 0 mm], end: [-10 mm, 0 mm]}}
    - {name: floor-2, shape: {kind: strip, start: [10 mm, 0 mm], end: [30 mm, 0 mm]}}
"""
LID = "    - {name: lid, opens: start, shape: {kind: strip, start: [-10 mm, 0 mm], end: [10 mm, 0 mm]}}\n"
DISC = "container: {kind: cylinder-silo, diameter: 100 mm, height: 400 mm, orifice: 30 mm, rotation: TURN}\n"


def study(folder, *parts, motion=""):
    path = folder / "s.yaml"
    path.write_text(HEAD + "".join(parts).replace("MOTION", motion and f"motion: {motion}, "))
    return load(path)


def scene_of(folder, *parts, **more) -> Scene:
    return study(folder, *parts, **more).points[0].scene


def planned(asked) -> None:
    backend = labbook_toy.Backend()
    lab = Catalogue(asked.path.parent / "lab")
    check(backend, "cpu", Planner(asked, lab, backend.capabilities).points)


def test_a_part_that_opens_stands_while_filling_only(tmp_path):
    scene, without = scene_of(tmp_path, SLOT, LID), scene_of(tmp_path, SLOT)
    names = [wall.name for wall in without.container.walls()]
    assert [wall.name for wall in scene.container.walls()] == names
    closed = scene.close()
    assert [wall.name for wall in closed.container.walls()] == [*names, "lid"]
    assert (scene.outlet, closed.outlet) == (0.0, None), "the plane does not act where parts close it"
    assert scene_key(scene) == scene_key(without), "an open silo is its walls, however they were closed"
    assert scene_key(closed) != scene_key(without.close())
    assert "lid" in scene.wall_names


def test_it_survives_storage_and_leaves_no_trace_where_it_is_not_used(tmp_path):
    closed = scene_of(tmp_path, SLOT, LID).close()
    again = Scene.model_validate_json(closed.model_dump_json())
    assert again == closed
    assert scene_key(again) == scene_key(closed)
    plain = scene_of(tmp_path, SLOT).model_dump_json()
    assert "opens" not in plain
    assert "closed" not in plain


def test_its_springs_are_gone_with_it(tmp_path):
    scene = scene_of(tmp_path, SLOT, LID)
    x = np.array([[0.0, 0.0, 1.5e-3], [0.02, 0.0, 1.5e-3]])
    zero = np.zeros_like(x)
    bed = Packing(x=x, v=zero, omega=zero, wall_grain=np.arange(2), wall_name=np.array(["lid", "floor-2"], "U40"),
                  wall_spring=np.ones((2, 3)))  # fmt: skip
    start = start_of_discharge(bed, scene.close(), scene)
    assert list(start.wall_name) == ["floor-2"]


def test_other_times_of_opening_are_refused(tmp_path):
    with pytest.raises(StudyError, match=r"container.parts\[6\].opens: at_rest: not a quantity.*\n.*or start"):
        study(tmp_path, SLOT, LID.replace("opens: start", "opens: at_rest"))


def test_a_plan_refuses_an_outlet_that_is_open_while_filling(tmp_path):
    planned(study(tmp_path, SLOT, LID))
    with pytest.raises(Conflict, match=r"s.yaml: container.outlet_plane: .* x, y, z = 0, 0, 0 mm.*\n.*opens: start"):
        planned(study(tmp_path, SLOT))


@pytest.mark.parametrize(
    ("shape", "motion", "off"),
    [
        (Plane(point=(0, 0, 0), normal=(0, 0, 2)), {"velocity": (1, 2, 0)}, 0),
        (Plane(point=(0, 0, 0), normal=(0, 0, 2)), {"velocity": (1, 0, -3)}, 3),
        (Plane(point=(0, 0, 0), normal=(0, 0, 2)), {"spin": 3}, 0),
        (Plane(point=(0, 0, 0), normal=(1, 0, 0)), {"spin": 3}, math.inf),
        (Plane(point=(0, 0, 0), normal=(1, 0, 1)), {"velocity": (1, 5, -1)}, 0),
        (Plane(point=(0, 0, 0), normal=(1, 0, 1)), {"velocity": (1, 0, 0)}, math.sqrt(0.5)),
        (Strip(start=(0, 0), end=(3, 4)), {"velocity": (0.3, 7, 0.4)}, 0),
        (Strip(start=(0, 0), end=(3, 4)), {"velocity": (-4, 0, 3)}, 5),
        (Strip(start=(0, 0), end=(3, 0)), {"spin": 1}, 0),
        (Strip(start=(0, 0), end=(0, 3)), {"spin": 1}, math.inf),
        (Frustum(lower=(1, 0), upper=(1, 5)), {"velocity": (0, 0, 2), "spin": 9}, 0),
        (Frustum(lower=(1, 0), upper=(1, 5)), {"velocity": (3, 4, 0)}, 5),
        (Frustum(lower=(0, 0), upper=(1, 0)), {"velocity": (3, 4, 0), "spin": 9}, 0),
        (Frustum(lower=(0, 0), upper=(1, 0)), {"velocity": (0, 0, 2)}, 2),
        (Frustum(lower=(1, 0), upper=(4, 4)), {"spin": 9}, 0),
        (Frustum(lower=(1, 0), upper=(4, 4)), {"velocity": (0, 0, 1)}, 0.6),
        (Frustum(lower=(1, 0), upper=(4, 4)), {"velocity": (1, 0, 0)}, 0.8),
    ],
)
def test_the_speed_along_the_normal_is_that_of_the_geometry(shape, motion, off):
    """Normals by hand: of the strip and the cone with sides 3, 4, 5 they are (-4, 3)/5 in their section."""
    assert shape.normal_speed(SurfaceMotion(**motion)) == pytest.approx(off, rel=1e-12)


def test_a_wall_that_would_leave_its_place_is_refused(tmp_path):
    motion = "{velocity: [0.1 m/s, 0 m/s, 0.05 m/s]}"
    with pytest.raises(StudyError, match=r"parts\[4\].motion.velocity: .*surface only.* 0.05 m/s along"):
        study(tmp_path, SLOT, LID, motion=motion)
    study(tmp_path, SLOT, LID, motion="{velocity: [0.1 m/s, 0.2 m/s, 0 m/s]}")


def test_a_stored_run_of_such_a_wall_stays_readable(tmp_path):
    scene = scene_of(tmp_path, SLOT, LID, motion="{velocity: [0.1 m/s, 0.2 m/s, 0 m/s]}")
    stored = json.loads(scene.model_dump_json())
    stored["container"]["parts"][4]["motion"]["velocity"] = [0, 0, 1.0]
    assert Scene.model_validate(stored).container.walls()[4].motion.velocity == (0, 0, 1)


@pytest.mark.parametrize(
    ("parts", "motion", "still"),
    [((SLOT, LID), "{velocity: [0.1 m/s, 0 m/s, 0 m/s]}", (0, 0, 0)), ((DISC.replace("TURN", "2 Hz"),), "", (0, 0, 0))],
)
def test_surfaces_move_during_filling_only_if_asked(tmp_path, parts, motion, still):
    def motions(*more):
        (demand,) = demands(study(tmp_path, *parts, *more, motion=motion), 1)
        walls = demand.shared.closed.container.walls()
        return [wall.motion for wall in walls if wall.motion != SurfaceMotion()], demand

    at_rest, plain = motions()
    assert at_rest == []
    (moving,), asked = motions("fill: {surface_motion: true}\n")
    opened_ = [wall.motion for wall in asked.shared.scene.container.walls()]
    assert moving in opened_
    assert plain.shared.scene_key == asked.shared.scene_key
    assert plain.shared.closed_key != asked.shared.closed_key
    _, same = motions("fill: {surface_motion: false}\n")
    assert same.shared.closed_key == plain.shared.closed_key


@pytest.mark.parametrize(
    ("parts", "motion", "said"),
    [
        # 2 pi 0.05 m 1000 Hz = 314 m/s; 100 m/s is 318.309 Hz
        (DISC.replace("TURN", "1000 Hz"), "", r"container.rotation: .* 314 m/s.*\(100 m/s\).*\n.*at most 318.309 Hz"),
        (SLOT + LID, "{velocity: [200 m/s, 0 m/s, 0 m/s]}", r"motion: the surface of floor-1 moves at 200 m/s"),
    ],
)
def test_a_plan_refuses_surfaces_beyond_the_speed_limit(tmp_path, parts, motion, said):
    asked = study(tmp_path, parts, motion=motion).change({"numerics.speed_limit": "100 m/s"})
    with pytest.raises(Conflict, match=said):
        planned(asked)


def test_plan_says_it_in_words(tmp_path):
    study(tmp_path, DISC.replace("TURN", "1000 Hz"))
    ended = labbook("plan", tmp_path / "s.yaml", "--lab", tmp_path / "lab", "--backend", "toy", check=False)
    assert ended.exit_code == 1
    assert "faster than numerics.speed_limit" in " ".join(ended.output.split())
