"""Motion of a whole part: its poses and velocities, what a study may say, and what it changes in keys."""

import math

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.spatial.transform import Rotation as Turned

from labbook.checks.verify.mesh import of_triangles, sheet
from labbook.lab.identity import scene_key
from labbook.scene import (
    LinearSpringDashpot,
    PartMotion,
    PartRotation,
    Primitives,
    Scene,
    Spheres,
    Strip,
    Vibration,
    Wall,
)
from labbook.scene.part_motion import Poses

MOTION = PartMotion(
    velocity=(0.1, 0.0, -0.2),
    rotation=PartRotation(axis=(0.0, 3.0, 4.0), origin=(0.02, 0.0, 0.01), rate=7.0),
    vibration=Vibration(direction=(2.0, 0.0, 0.0), amplitude=1e-3, frequency=30.0, phase=0.7),
)
X = np.random.default_rng(2).normal(0, 0.05, (5, 3))


def place(time: float) -> np.ndarray:
    """Where X is at a time [s], by the words of the docs: turned about the axis, then displaced."""
    turn = Turned.from_rotvec(7.0 * time * np.array([0.0, 0.6, 0.8])).as_matrix()
    origin = np.array([0.02, 0.0, 0.01])
    shaken = 1e-3 * (math.sin(2 * math.pi * 30 * time + 0.7) - math.sin(0.7))
    return (X - origin) @ turn.T + origin + time * np.array([0.1, 0.0, -0.2]) + [shaken, 0.0, 0.0]


def test_a_part_is_turned_and_then_displaced_and_starts_where_it_stands():
    times = np.array([0.0, 0.013, 0.2, 51.7])
    poses = MOTION.poses(times)
    for k, time in enumerate(times.tolist()):
        assert poses.positions(k, X) == pytest.approx(place(time), abs=1e-12)
    assert poses.positions(0, X) == pytest.approx(X, abs=1e-16)


def test_velocities_are_the_derivatives_of_places():
    for time in (0.0, 0.013, 3.2):
        poses, step = MOTION.poses(np.array([time])), 1e-6
        slope = (place(time + step) - place(time - step)) / (2 * step)
        assert poses.velocity[0] + np.cross(poses.spin[0], place(time)) == pytest.approx(slope, abs=1e-7)
        assert np.linalg.norm(slope, axis=1).max() <= MOTION.speed(X, 0.0)


def test_a_pose_has_the_same_bits_wherever_its_time_stands():
    times = np.linspace(0, 3, 37)
    whole = MOTION.poses(times).table()
    for k in (0, 5, 36):
        assert np.array_equal(MOTION.poses(times[k : k + 1]).table()[0], whole[k])


def test_acceleration_of_a_vibration_is_told_in_gravities():
    shaken = Vibration(direction=(0, 0, 1), amplitude=1e-3, frequency=50.0)
    assert shaken.strength(9.81) == pytest.approx(1e-3 * (100 * math.pi) ** 2 / 9.81)


def scene(**moves) -> Scene:
    """A sphere over a sheet, which moves if that is stated."""
    wall = of_triangles(*sheet(1, 0.02))
    if moves:
        wall = wall.model_copy(update={"moves": PartMotion(**moves)})
    law = LinearSpringDashpot(normal_stiffness=1e3)
    return Scene(grains=Spheres(diameter=3e-3, density=2500, count=1), contact=law, container=Primitives(parts=(wall,)))


def test_motion_is_in_the_key_where_there_is_one_and_not_in_that_of_the_packing():
    still, rising, sinking = (scene(), scene(velocity=(0, 0, 0.1)), scene(velocity=(0, 0, -0.1)))
    assert "moves" not in still.model_dump_json()
    assert len({scene_key(each) for each in (still, rising, sinking)}) == 3
    assert {scene_key(each.close()) for each in (still, rising, sinking)} == {scene_key(still)}
    assert Scene.model_validate_json(rising.model_dump_json()) == rising


@pytest.mark.parametrize(
    ("moves", "words"),
    [
        ({}, "states no motion"),
        ({"rotation": {"axis": (0, 0, 0), "rate": 1.0}}, "length zero"),
        ({"vibration": {"direction": (0, 0, 0), "amplitude": 1e-3, "frequency": 1.0}}, "length zero"),
    ],
)
def test_a_motion_that_moves_nothing_is_refused(moves, words):
    with pytest.raises(ValidationError, match=words):
        PartMotion.model_validate(moves)


def test_walls_without_triangles_do_not_move():
    with pytest.raises(ValidationError, match="only walls of triangles"):
        Wall(name="gate", shape=Strip(start=(0, 0), end=(0.01, 0)), moves=PartMotion(velocity=(0.1, 0, 0)))


def vanishing(opens) -> Wall:
    return scene(velocity=(0, 0, 0.1)).container.walls()[0].model_copy(update={"opens": opens})


def test_a_part_that_vanishes_is_out_of_reach_from_then_on():
    wall, moves = vanishing(0.2), PartMotion(velocity=(0, 0, 0.1))
    poses, times = wall.poses(np.array([0.0, 0.19999, 0.2, 1.0])), np.array([0.0, 0.19999, 0.2, 1.0])
    assert np.array_equal(poses.shift[:2], moves.poses(times).shift[:2])
    assert (poses.shift[2:] > 1e5).all()
    assert vanishing("start").removal is None
    assert np.array_equal(Poses.at_rest(2).table(), PartMotion(velocity=(0, 0, 0)).poses(np.zeros(2)).table())


def test_the_time_at_which_a_part_vanishes_is_in_the_key_and_not_in_that_of_the_packing():
    def of(opens) -> Scene:
        wall = of_triangles(*sheet(1, 0.02)).model_copy(update={"opens": opens})
        return scene().model_copy(update={"container": Primitives(parts=(wall,), outlet_plane=0.0)})

    at_start, early, late = of("start"), of(0.1), of(0.2)
    assert [len(each.container.walls()) for each in (at_start, early, late)] == [0, 1, 1]
    assert len({scene_key(each) for each in (at_start, early, late)}) == 3
    assert {scene_key(each.close()) for each in (at_start, early, late)} == {scene_key(late.close())}
    assert late.close().container.walls()[0].opens == "start"
    assert Scene.model_validate_json(late.model_dump_json()) == late


def test_only_walls_of_triangles_vanish_at_a_time():
    with pytest.raises(ValidationError, match="vanishes at the start or never"):
        Wall(name="lid", shape=Strip(start=(0, 0), end=(0.01, 0)), opens=0.2)
