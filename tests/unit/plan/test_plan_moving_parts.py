"""Parts that move, in a study: its words, and what a plan refuses."""

from dataclasses import replace

import labbook_reference
import numpy as np
import pytest

from labbook.backend import Unsupported
from labbook.lab import Catalogue
from labbook.plan.demand import Conflict
from labbook.plan.plan import Planner
from labbook.plan.possible import check, moves_out
from labbook.study import load

TEXT = """
name: blade
grains: {shape: sphere, diameter: 3 mm, density: 2500 kg/m^3, count: 200}
contact: {law: linear, normal_stiffness: 1000 N/m, friction: 0.5, restitution: 0.5}
container:
  kind: box
  width: 60 mm
  depth: 60 mm
  height: 100 mm
  parts:
    - name: blade
      moves: MOVES
      shape: {kind: mesh, file: blade.stl, unit: mm}
numerics: {dt: 10 us, speed_limit: 10 m/s}
measure: []
stop: {max_time: 1 s}
"""
FACET = "facet normal 0 0 0\nouter loop\nvertex -10 0 5\nvertex 10 0 5\nvertex 0 0 25\nendloop\nendfacet\n"


def study(folder, moves: str):
    pytest.importorskip("trimesh")
    (folder / "blade.stl").write_text(f"solid blade\n{FACET}endsolid blade\n")
    (folder / "blade.yaml").write_text(TEXT.replace("MOVES", moves))
    return load(folder / "blade.yaml")


def planned(folder, moves: str, backend=None) -> None:
    backend, loaded = backend or labbook_reference.Backend(), study(folder, moves)
    check(backend, "cpu", Planner(loaded, Catalogue(folder / "lab"), backend.capabilities).points)


def test_a_motion_has_units_as_everywhere(tmp_path):
    (point,) = study(
        tmp_path,
        "{velocity: [1 cm/s, 0 m/s, 0 m/s], rotation: {axis: [0, 0, 1], rate: 30 rpm}, "
        "vibration: {direction: [0, 1, 0], amplitude: 0.5 d, frequency: 20 Hz, phase: 90 deg}}",
    ).points
    moves = point.scene.container.walls()[-1].moves
    assert moves is not None
    assert moves.rotation is not None
    assert moves.vibration is not None
    assert moves.velocity == pytest.approx((0.01, 0, 0))
    assert moves.rotation.rate == pytest.approx(np.pi)
    assert moves.vibration.amplitude == pytest.approx(1.5e-3)
    assert moves.vibration.phase == pytest.approx(np.pi / 2)
    assert point.scene.close().container.walls()[-1].moves is None


@pytest.mark.parametrize(
    ("moves", "words"),
    [
        ("{velocity: [30 m/s, 0 m/s, 0 m/s]}", r"moves at up to 30 m/s, faster than numerics.speed_limit"),
        ("{rotation: {axis: [0, 0, 1], rate: 2000 rad/s}}", r"moves at up to 20 m/s"),
        (
            "{vibration: {direction: [0, 0, 1], amplitude: 0.01 mm, frequency: 2500 Hz}}",
            r"vibrates with a period of 0.4 ms; .* more than 1/50 of it",
        ),
        ("{velocity: [40 mm/s, 0 m/s, 0 m/s]}", r"part blade leaves the container at x = 30 mm, 0.5 s after"),
        ("{velocity: [0 m/s, 0 m/s, -10 mm/s]}", r"part blade leaves the container at z = 0 mm, 0.5 s after"),
        ("{rotation: {axis: [0, 0, 1], origin: [25 mm, 0 mm, 0 mm], rate: 3 rad/s}}", "container at y = -30 mm"),
    ],
)
def test_what_no_part_may_do_is_refused_with_the_place(tmp_path, moves, words):
    with pytest.raises(Conflict, match=words):
        planned(tmp_path, moves)


def test_a_part_may_go_up_and_out_and_turn_within(tmp_path):
    planned(tmp_path, "{velocity: [0 m/s, 0 m/s, 0.3 m/s]}")
    planned(tmp_path, "{rotation: {axis: [0, 0, 1], rate: 5 rad/s}}")


def test_the_time_at_which_a_part_leaves_is_found(tmp_path):
    (point,) = study(tmp_path, "{velocity: [40 mm/s, 0 m/s, 0 m/s]}").points
    wall = point.scene.container.walls()[-1]
    outside = moves_out(point.scene, wall, 10.0)
    assert outside is not None
    assert outside.time == pytest.approx(0.5, rel=1e-3)
    assert moves_out(point.scene, wall, 0.49) is None


def test_a_backend_without_parts_that_move_refuses_them(tmp_path):
    backend = labbook_reference.Backend()
    backend.capabilities = replace(backend.capabilities, moving_parts=False)
    with pytest.raises(Unsupported, match=r"no parts that move; use --backend numba"):
        planned(tmp_path, "{velocity: [0 m/s, 0 m/s, 0.3 m/s]}", backend)


def test_a_part_that_vanishes_after_the_end_of_runs_is_refused(tmp_path):
    pytest.importorskip("trimesh")

    def of(opens: str):
        (tmp_path / "blade.stl").write_text(f"solid blade\n{FACET}endsolid blade\n")
        (tmp_path / "blade.yaml").write_text(TEXT.replace("moves: MOVES", f"opens: {opens}"))
        backend = labbook_reference.Backend()
        check(
            backend,
            "cpu",
            Planner(load(tmp_path / "blade.yaml"), Catalogue(tmp_path / "lab"), backend.capabilities).points,
        )

    of("0.5 s")
    with pytest.raises(Conflict, match="end at 1 s"):
        of("1.5 s")
