"""Packings as data files of other codes."""

import numpy as np
import pytest

from labbook.export.packing import NotSpheres, around, data_file
from labbook.export.stl import wall_files
from labbook.scene import Scene
from labbook.scene.packing import Packing

CONTACT = {"law": "hertz-mindlin", "shear_modulus": 1e6, "poisson_ratio": 0.25, "friction": 0.5}
BOX = {"kind": "box", "width": 0.1, "depth": 0.1, "height": 0.1}


def scene(**grains):
    given = {"shape": "sphere", "diameter": 3e-3, "density": 2500.0, "count": 3, **grains}
    return Scene.model_validate({"grains": given, "contact": CONTACT, "container": BOX})


def read(text):
    """What both codes make of it: box, atoms and velocities."""
    title, rest = text.split("\n", 1)
    head, rest = rest.split("\nAtoms\n")
    atoms, velocities = rest.split("\nVelocities\n")
    counts = {
        " ".join(line.split()[1:]): int(line.split()[0])
        for line in head.split("\n")
        if line.endswith(("atoms", "types"))
    }
    box = {line.split()[2][0]: tuple(map(float, line.split()[:2])) for line in head.split("\n") if "lo " in line}
    tables = [np.array([[float(word) for word in line.split()] for line in part.strip().split("\n")])
              for part in (atoms, velocities)]  # fmt: skip
    return title, counts, box, *tables


def test_every_number_is_read_back_as_it_was():
    rng = np.random.default_rng(4)
    x, v, omega = (rng.normal(size=(3, 3)) / 3 for _ in range(3))
    packing = Packing(x=x, v=v, omega=omega, ids=np.array([5, 1, 3]))
    title, counts, box, atoms, velocities = read(data_file(packing, scene(), "a title"))
    assert title == "a title"
    assert counts == {"atoms": 3, "atom types": 1}
    order = [1, 2, 0]  # by number
    assert np.array_equal(atoms[:, 0], [2, 4, 6])
    assert np.array_equal(atoms[:, 1], [1, 1, 1])
    assert np.array_equal(atoms[:, 2:4], [[3e-3, 2500.0]] * 3)
    assert np.array_equal(atoms[:, 4:], x[order])
    assert np.array_equal(velocities[:, 0], [2, 4, 6])
    assert np.array_equal(velocities[:, 1:], np.hstack([v, omega])[order])
    for k, axis in enumerate("xyz"):
        assert box[axis][0] <= x[:, k].min() - 6e-3 * (1 - 1e-9)
        assert box[axis][1] >= x[:, k].max() + 6e-3 * (1 - 1e-9)
    assert box["z"][0] <= -0.06


def test_mixtures_keep_diameters_densities_and_kinds():
    kinds = [{"name": "glass", "share": 0.5}, {"name": "steel", "share": 0.5, "diameter": 2e-3, "density": 7800.0}]
    x = np.array([[0.0, 0, 0.01], [0.01, 0, 0.01], [0.02, 0, 0.01]])
    packing = Packing(x=x, v=0 * x, omega=0 * x, kind=np.array([1, 0, 1]), diameter=np.array([2e-3, 3e-3, 2e-3]))
    _, counts, _, atoms, _ = read(data_file(packing, scene(kinds=kinds), "t"))
    assert counts["atom types"] == 2
    assert np.array_equal(atoms[:, 1:4], [[2, 2e-3, 7800], [1, 3e-3, 2500], [2, 2e-3, 7800]])


def test_rods_are_refused_by_name():
    rods = scene(shape="spherocylinder", length=9e-3)
    with pytest.raises(NotSpheres, match="spherocylinder"):
        data_file(Packing(x=np.zeros((3, 3)), v=np.zeros((3, 3)), omega=np.zeros((3, 3))), rods, "t")


def test_walls_are_closed_by_triangles_of_their_size():
    """Of a cone of 45 deg from r = 10 to 20 mm: a frustum of 96 sides, and a cylinder up to two diameters above the
    grains."""
    silo = {"kind": "conical-silo", "diameter": 0.04, "height": 0.2, "angle": np.pi / 4, "orifice": 0.02}
    grains = {"shape": "sphere", "diameter": 3e-3, "density": 2500.0, "count": 2}
    cone = Scene.model_validate({"grains": grains, "contact": CONTACT, "container": silo})
    x = np.array([[0.0, 0, 0.03], [0.01, 0, 0.044]])
    files = wall_files(cone.container, around(cone, Packing(x=x, v=0 * x, omega=0 * x)))
    assert set(files) == {"side", "bottom"}
    area, top = {}, {}
    for name, text in files.items():
        words = [line.split() for line in text.splitlines()]
        corners = np.array([row[1:] for row in words if row[0] == "vertex"], float).reshape(-1, 3, 3)
        normals = np.array([row[2:] for row in words if row[0] == "facet"], float)
        sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area[name], top[name] = np.linalg.norm(sides, axis=1).sum() / 2, corners[..., 2].max()
        assert np.allclose(np.einsum("ni,ni->n", normals, sides), np.linalg.norm(sides, axis=1))
    half = np.pi / 96
    perimeter = 96 * 2 * np.sin(half)  # of a polygon on the unit circle
    slant = np.hypot(0.01 * np.cos(half), 0.01)  # of a trapezium, down the middle of a side
    assert area["bottom"] == pytest.approx(perimeter * 0.015 * slant, rel=1e-9)
    assert area["side"] == pytest.approx(perimeter * 0.02 * (0.05 - 0.01), rel=1e-9)
    assert top == pytest.approx({"side": 0.05, "bottom": 0.01})


def test_walls_without_an_end_are_cut_at_the_box_of_the_data_file():
    x = np.array([[0.0, 0, 0.03], [0.01, 0, 0.044], [0.0, 0.02, 0.03]])
    box = around(scene(), Packing(x=x, v=0 * x, omega=0 * x))
    for text in wall_files(scene().container, box).values():
        corners = np.array([line.split()[1:] for line in text.splitlines() if line.startswith("vertex")], float)
        assert np.isfinite(corners).all()
        assert corners[:, 2].max() <= 0.05 + 1e-12
