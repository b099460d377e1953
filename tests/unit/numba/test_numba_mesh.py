"""Grains at walls of triangles by the CPU backend: as by the reference, and the same bits after a restart."""

import math
from dataclasses import replace

import labbook_reference
import numpy as np
import pytest

pytest.importorskip("numba")

from labbook_numba import Backend
from turning_box import RODS, SPHERES, in_the_box, turning_box

from labbook.backend import Failed
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Contacts, Ledger, Sample
from labbook.checks.verify.materials import D, G, linear, scene, spheres
from labbook.checks.verify.mesh import of_triangles, sheet
from labbook.checks.verify.platform import grains_at
from labbook.checks.verify.rods import towards
from labbook.scene import (
    Box,
    Primitives,
    Scene,
    Spherocylinders,
    TriangleMesh,
    Wall,
)
from labbook.scene.triangles import Triangles

pytestmark = pytest.mark.compiles

R = D / 2
NUMERICS = Numerics(dt=2.5e-6, steps_per_beat=50)
PROBES = (Sample(fields=("x", "v", "omega")), Contacts(every=1), Ledger(every=10))
"""As the cases of verification, whose kernels these tests share."""


def trough() -> Scene:
    """Grains in a box, whose floor is a bent sheet of triangles, with planes on the sides."""
    vertices, triangles = sheet(6, 8 * R)
    vertices = vertices + np.column_stack([0 * vertices[:, 0], 0 * vertices[:, 0], 0.3 * np.abs(vertices[:, 0])])
    bent = of_triangles(vertices, triangles)
    box = Box(width=16 * R, depth=16 * R, height=40 * R)
    sides = [wall for wall in box.walls() if wall.name != "bottom"]
    return scene(8, linear(friction=0.4), Primitives(parts=(*sides, bent)), G)


def rod_trough() -> Scene:
    """The same with rods of a length of three radii."""
    grains = Spherocylinders(diameter=D, length=1.5 * D, density=2500, count=8)
    return trough().model_copy(update={"grains": grains})


SCENES = [pytest.param(trough(), id="spheres"), pytest.param(rod_trough(), id="rods", marks=pytest.mark.ring)]
"""Kernels of rods at meshes are compiled in the ring only; test_dem_mesh_rods has their contacts."""


def start(of: Scene):
    rng = np.random.default_rng(2)
    x = np.array([[a, b, 3.0] for a in (-5, -1.5, 1.5, 5) for b in (-2, 2)]) * R + rng.uniform(-0.1, 0.1, (8, 3)) * R
    fallen = grains_at(x, rng.uniform(-0.3, 0.3, (8, 3)) - [0, 0, 0.3])
    if isinstance(of.grains, Spherocylinders):
        q = np.array([towards([math.sin(t), 0.0, math.cos(t)]) for t in rng.uniform(1.2, 1.5, 8)])
        fallen = replace(fallen, x=fallen.x + np.array([0, 0, R]), q=q)
    return fallen


def run(backend, of: Scene, packing, beats: int):
    ensemble = backend.open(backend.specialise(of, NUMERICS, PROBES), 1)
    member = ensemble.admit(of, NUMERICS, packing)
    events = ensemble.advance(beats)
    return ensemble, member, events


@pytest.mark.parametrize("of", SCENES)
def test_grains_move_as_by_the_reference_and_go_on_from_its_packing(of):
    numba = Backend(wide=True)
    fallen, member, _ = run(numba, of, start(of), 240)
    packing = fallen.packing(member)
    assert len(packing.wall_part) >= 4
    assert packing.wall_part.max() > 8, "features have numbers of their own"
    fallen.close()
    ends = []
    for backend in (numba, labbook_reference.Backend()):
        ensemble, member, _ = run(backend, of, packing, 2)
        ends.append(ensemble.packing(member))
        ensemble.close()
    one, other = ends
    assert np.abs(one.x - packing.x).max() > 1e-3 * R
    assert np.abs(one.x - other.x).max() < 1e-11 * D
    keys = [set(zip(p.wall_grain.tolist(), p.wall_name.tolist(), p.wall_part.tolist(), strict=True)) for p in ends]
    assert keys[0] == keys[1]
    order = [np.lexsort((p.wall_part, p.wall_name, p.wall_grain)) for p in ends]
    springs = [p.wall_spring[rows] for p, rows in zip(ends, order, strict=True)]
    assert np.abs(springs[0]).max() > 1e-9
    assert np.abs(springs[0] - springs[1]).max() < 1e-11 * D


@pytest.mark.parametrize("of", SCENES)
def test_a_restart_changes_no_bit(of):
    numba = Backend(wide=True)
    whole, member, _ = run(numba, of, start(of), 200)
    end = whole.packing(member)
    parts, member, _ = run(numba, of, start(of), 120)
    checkpoint = parts.checkpoint(member)
    assert checkpoint.arrays["wall_held"].max() > 0
    again = parts.admit(of, NUMERICS, checkpoint)
    parts.advance(80)
    for name, array in end.arrays().items():
        assert np.array_equal(array, parts.packing(again).arrays()[name]), name
    damaged = dict(checkpoint.arrays)
    spring = damaged["wall_spring"].copy()
    spring[:, 3] = 1e7
    with pytest.raises(ValueError, match="not of its features"):
        parts.admit(
            of,
            NUMERICS,
            type(checkpoint)(checkpoint.backend, checkpoint.cache_version, damaged | {"wall_spring": spring}),
        )


BOXES = [
    pytest.param(turning_box(SPHERES), id="spheres"),
    pytest.param(turning_box(RODS), id="rods", marks=pytest.mark.ring),
]


@pytest.mark.parametrize("of", BOXES)
def test_in_a_part_that_moves_grains_move_as_by_the_reference(of):
    ends = []
    for backend in (Backend(wide=True), labbook_reference.Backend()):
        ensemble, member, _ = run(backend, of, in_the_box(of), 3 if isinstance(of.grains, Spherocylinders) else 1)
        ends.append(ensemble.packing(member))
        ensemble.close()
    one, other = ends
    assert len(one.wall_spring) >= 2
    assert np.abs(one.wall_spring).max() > 1e-9
    assert np.abs(one.x - other.x).max() < 1e-11 * D
    assert np.abs(one.v - other.v).max() < 1e-9
    order = [np.lexsort((p.wall_part, p.wall_grain)) for p in ends]
    springs = [p.wall_spring[rows] for p, rows in zip(ends, order, strict=True)]
    assert np.abs(springs[0] - springs[1]).max() < 1e-11 * D


@pytest.mark.parametrize("of", BOXES)
def test_with_a_part_that_moves_a_restart_and_reading_change_no_bit(of):
    numba = Backend(wide=True)
    whole, member, _ = run(numba, of, in_the_box(of), 60)
    parts, again, _ = run(numba, of, in_the_box(of), 23)
    parts.packing(again)
    checkpoint = parts.checkpoint(again)
    assert not {"pose", "pose_first"} & {*checkpoint.arrays}
    later = parts.admit(of, NUMERICS, checkpoint)
    parts.advance(37)
    end = whole.packing(member).arrays()
    for name, array in parts.packing(later).arrays().items():
        assert np.array_equal(array, end[name]), name


def test_a_part_vanishes_at_its_time():
    """A sphere at rest on it falls freely from then on; one beside, on a part that stays, rests."""
    vertices, triangles = sheet(1, 2 * R)
    shift = np.array([3 * D, 0.0, 0.0])
    stays = of_triangles(vertices, triangles)
    opens = of_triangles(vertices + shift, triangles).model_copy(update={"name": "lid", "opens": 40.5 * NUMERICS.dt})
    law = linear(friction=0.4, restitution=0.6)
    level = R - spheres(1).mass * G / law.model_dump()["normal_stiffness"]
    of = Scene(grains=spheres(2), contact=law, container=Primitives(parts=(stays, opens)), gravity=G)
    start = grains_at(np.array([[0.0, 0.0, level], [3 * D, 0.0, level]]), np.zeros((2, 3)))
    for backend in (Backend(wide=True), labbook_reference.Backend()):
        ensemble, member, _ = run(backend, of, start, 3)
        end = ensemble.packing(member)
        ensemble.close()
        fallen = level - end.x[:, 2]
        # from step 41 on, whose force is the first without it: 109 kicks
        steps = 150 - 41
        assert fallen[0] == pytest.approx(0, abs=1e-12)
        assert fallen[1] == pytest.approx(G * NUMERICS.dt**2 * steps * (steps + 1) / 2, rel=1e-6)
        assert end.wall_name.tolist() == ["floor"]


def test_the_deepest_contact_with_too_many_sides_fails_with_the_remedy():
    angles = 2 * np.pi * np.arange(24) / 24
    ends = np.array([(0.999 * R * np.cos(t), 0.999 * R * np.sin(t), z) for t in angles for z in (-9 * R, 9 * R)])
    pairs = [(2 * k, 2 * ((k + 1) % 24)) for k in range(24)]
    tube, _ = Triangles.welded(ends, np.array([t for a, b in pairs for t in ((a, b, b + 1), (a, b + 1, a + 1))]))
    wall = Wall(name="tube", shape=TriangleMesh.of_surface(tube))
    of = Scene(grains=spheres(1), contact=linear(friction=0.4), container=Primitives(parts=(wall,)), gravity=0.0)
    for backend in (Backend(wide=True), labbook_reference.Backend()):
        ensemble, _, events = run(backend, of, grains_at([0.0, 0.0, 0.3 * R]), 1)
        ensemble.close()
        failure = next(event for event in events if isinstance(event, Failed))
        assert "smooth" in failure.message
