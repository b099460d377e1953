"""Walls of triangles that a study reads from files, and parts of all containers."""

import numpy as np
import pytest
from pydantic import ValidationError

from labbook.scene import (
    Box,
    ConicalSilo,
    CylinderSilo,
    Plane,
    Primitives,
    Scene,
    Spheres,
    TriangleMesh,
    Wall,
    WedgeHopper,
)
from labbook.scene.attached import StudyFolder
from labbook.scene.contact import LinearSpringDashpot
from labbook.scene.triangles import Triangles

STL = "\n".join(
    f"facet normal 0 0 0\nouter loop\n{''.join(f'vertex {x} {y} {z}{chr(10)}' for x, y, z in t)}endloop\nendfacet"
    for t in (
        ((0, 0, 0), (10, 0, 0), (0, 10, 0)),
        ((0, 0, 0), (10, 0, 0), (0, 0, 10)),
        ((0, 0, 0), (0, 10, 0), (0, 0, 10)),
        ((10, 0, 0), (0, 10, 0), (0, 0, 10)),
    )
)
OBJ = "v 0 0 0\nv 10 0 0\nv 0 10 0\nv 0 0 10\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n"
PLY = (
    "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 4\nproperty list uchar int vertex_indices\nend_header\n"
    "0 0 0\n10 0 0\n0 10 0\n0 0 10\n3 0 1 2\n3 0 1 3\n3 0 2 3\n3 1 2 3\n"
)


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "t.stl").write_text(f"solid t\n{STL}\nendsolid t\n")
    (tmp_path / "t.obj").write_text(OBJ)
    (tmp_path / "t.ply").write_text(PLY)
    return tmp_path


def read(folder, **stated) -> TriangleMesh:
    context = {"units": "required", "d": 1e-3, "beside": StudyFolder(folder)}
    return TriangleMesh.model_validate({"kind": "mesh", "file": "t.stl", "unit": "mm", **stated}, context=context)


def block(side: float = 1.0, at: float = 0.0) -> TriangleMesh:
    corners = np.array([[x, y, z] for x in (0, side) for y in (0, side) for z in (0, side)], float) + at
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = np.array([t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))])
    return TriangleMesh.of_surface(Triangles.welded(corners, triangles)[0])


def test_three_formats_give_one_wall(folder):
    pytest.importorskip("trimesh")
    one = read(folder)
    assert one == read(folder, file="t.obj") == read(folder, file="t.ply")
    assert one == read(folder, unit="cm", scale="0.1") == read(folder, unit="m", scale=0.001)
    assert one.surface.closed
    assert one.surface.area == pytest.approx((150 + 50 * 3**0.5) * 1e-6)
    assert one.bounds.high == (0.01, 0.01, 0.01)


def test_it_is_scaled_then_turned_then_moved(folder):
    pytest.importorskip("trimesh")
    placed = read(folder, scale=2, rotate=["90 deg", "0 deg", "0 deg"], at=["0 mm", "0 mm", "5 mm"])
    assert placed.bounds.low == pytest.approx((0, -0.02, 0.005))
    assert placed.bounds.high == pytest.approx((0.02, 0, 0.025))


def test_what_is_stored_needs_no_file(folder):
    pytest.importorskip("trimesh")
    wall = Wall(name="hopper", shape=read(folder, smooth="15 deg"))
    again = Wall.model_validate_json(wall.model_dump_json())
    assert again == wall
    assert "t.stl" not in wall.model_dump_json()


@pytest.mark.parametrize(
    ("stated", "says"),
    [
        ({"file": "../t.stl"}, "not a path within the folder"),
        ({"file": "gone.stl"}, "cannot be read"),
        ({"file": "t.step"}, "none of .stl, .obj, .ply"),
        ({"file": "bad.stl"}, "bad.stl"),
        ({"unit": None}, "unit"),
        ({"vertices": "AAAA"}, "a study cannot set this"),
        ({"encloses": True, "file": "open.obj"}, "not closed"),
        ({"file": "fin.obj"}, "1 edges of more than two triangles, one at x, y, z = 5, 0, 0 mm"),
    ],
)
def test_what_cannot_be_is_refused(folder, stated, says):
    pytest.importorskip("trimesh")
    (folder / "bad.stl").write_bytes(b"\x00" * 50)
    (folder / "open.obj").write_text(OBJ.replace("f 2 3 4\n", ""))
    (folder / "fin.obj").write_text(OBJ + "v 5 -5 -5\nf 1 2 5\n")
    with pytest.raises(ValidationError, match=says):
        read(folder, **stated)


def test_a_flaw_may_be_allowed(folder):
    pytest.importorskip("trimesh")
    (folder / "fin.obj").write_text(OBJ + "v 5 -5 -5\nf 1 2 5\n")
    assert len(read(folder, file="fin.obj", allow=["non-manifold"]).surface.corners) == 5


def test_a_link_is_not_followed(folder):
    pytest.importorskip("trimesh")
    (folder / "link.stl").symlink_to(folder / "t.stl")
    with pytest.raises(ValidationError, match="link"):
        read(folder, file="link.stl")


CONTAINERS = (
    WedgeHopper(width=4, height=8, thickness=4, orifice=1),
    CylinderSilo(diameter=4, height=8, orifice=1),
    ConicalSilo(diameter=4, height=8, orifice=1, angle=1.2),
    Box(width=4, depth=4, height=8),
)


@pytest.mark.parametrize("container", CONTAINERS, ids=lambda c: c.kind)
def test_every_container_takes_parts(container):
    insert = Wall(name="insert", shape=block(0.5, at=1.0))
    plug = Wall(name="plug", shape=Plane(point=(0, 0, 0.5), normal=(0, 0, 1)), opens="start")
    fitted = type(container)(**container.model_dump(exclude={"parts"}), parts=(insert, plug))
    assert fitted.walls() == (*container.walls(), insert)
    assert fitted.close().walls() == (*container.close().walls(), insert, plug)
    within = np.array([[1.2, 1.2, 1.2], [0.2, 0.2, 2.0]])
    assert container.inside(within).tolist() == [True, True]
    assert fitted.inside(within).tolist() == [False, True]
    assert type(container).model_validate_json(fitted.model_dump_json()) == fitted
    assert "parts" not in container.model_dump()


def test_a_part_may_not_have_the_name_of_a_wall():
    part = Wall(name="bottom", shape=Plane(point=(0, 0, 0.5), normal=(0, 0, 1)))
    with pytest.raises(ValidationError, match="same name"):
        CylinderSilo(diameter=4, height=8, orifice=1, parts=(part,))


@pytest.mark.parametrize(("size", "says"), [(1e-6, "smaller than a grain"), (100.0, "more than 10000")])
def test_a_mesh_in_another_unit_is_noticed(size, says):
    container = Primitives(parts=(Wall(name="insert", shape=block(size)),))
    with pytest.raises(ValidationError, match=says):
        Scene(
            grains=Spheres(diameter=1e-3, density=2500, count=1),
            contact=LinearSpringDashpot(normal_stiffness=1e3),
            container=container,
        )


def test_grains_are_outside_of_a_closed_surface_or_within_it():
    around, within = block(), block().model_copy(update={"encloses": True})
    x = np.array([[0.5, 0.5, 0.4], [0.5, 0.5, 1.2]])
    assert around.distance(x) == pytest.approx([-0.4, 0.2])
    assert within.distance(x) == pytest.approx([0.4, -0.2])
    assert around.carries(x).tolist() == [True, True]
    assert around.covers(x).tolist() == [True, False]


def test_the_mirror_image_is_that():
    mirrored = block(at=1.0).mirrored()
    assert mirrored.bounds.low == (-2.0, 1.0, 1.0)
    assert mirrored.mirrored() == block(at=1.0)


def test_meshes_are_outlined_by_their_free_and_sharp_edges():
    """Of a cube open above: 4 free edges and 8 of a right angle; diagonals of its sides are none."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * 1e-3
    faces = [
        (0, 2, 6),
        (0, 6, 4),
        (0, 1, 3),
        (0, 3, 2),
        (4, 5, 7),
        (4, 7, 6),
        (0, 1, 5),
        (0, 5, 4),
        (2, 3, 7),
        (2, 7, 6),
    ]
    cube = TriangleMesh.of_surface(Triangles.welded(corners, np.array(faces))[0])
    lines = np.array(cube.mesh(cube.bounds).outlines)
    assert np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1) == pytest.approx(1e-3)
    assert len(lines) == 12
    assert len(cube.surface.free_edges) == 4
    bent = np.array([[0, 0, 0], [0, 1, 0], [1, 0, 0], [-1, 0, 0.5]])
    roof = Triangles.welded(bent, np.array([[0, 1, 2], [0, 1, 3]]))[0]
    lean = np.arctan(0.5)
    assert [len(roof.creases(angle)) for angle in (lean - 0.01, lean + 0.01)] == [5, 4]
