"""Clumps on the reference backend: checkpoints, packings, walls, placing and feeding."""

from dataclasses import replace
from typing import Any

import labbook_reference
import numpy as np
import pytest

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Contacts, Crossing, Ledger, Traction
from labbook.checks.verify.clumps import SEED, D
from labbook.checks.verify.mesh import of_triangles, sheet
from labbook.filling.feeding import Feeder, Refill, refill
from labbook.filling.placing import STARTS, PlacingError, place
from labbook.scene import (
    BedTop,
    Box,
    Clumps,
    ConicalSilo,
    CylinderSilo,
    Feed,
    LinearSpringDashpot,
    Packing,
    Primitives,
    Scene,
    Spheres,
)
from labbook.scene.hulls import sphere_centres
from labbook.scene.orientation import random_turns, rotated
from labbook.scene.thick_plate import Lip
from labbook.scene.walls import Plane, Wall

LAW = LinearSpringDashpot(normal_stiffness=400, friction=0.5, rolling_friction=0.05, restitution=0.5)
BACKEND = labbook_reference.Backend()
NUMERICS = Numerics(dt=4e-5, steps_per_beat=40)


def grains(count: int) -> Clumps:
    return SEED.model_copy(update={"count": count})


def at(x, v=(0, 0, 0), omega=(0, 0, 0), q=None) -> Packing:
    """One clump."""
    vectors = (np.array([vector], float) for vector in (x, v, omega))
    return Packing(*vectors, q=None if q is None else np.array(q, float))


def spheres_of(packing: Packing) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centres [m] and radii [m] of all spheres of seeds, and the rows of their clumps."""
    assert packing.q is not None
    each = len(SEED.spheres)
    radii = np.tile([sphere.radius for sphere in SEED.spheres], len(packing))
    return sphere_centres(SEED, packing.x, packing.q), radii, np.repeat(np.arange(len(packing)), each)


def least_gap(centres: np.ndarray, radii: np.ndarray, own: np.ndarray) -> float:
    """Smallest gap between spheres of different clumps [m]."""
    apart = np.linalg.norm(centres[:, None] - centres[None], axis=2) - radii[:, None] - radii[None]
    return float(apart[own[:, None] != own[None]].min())


def bed(count: int = 5) -> Scene:
    return Scene(grains=grains(count), contact=LAW, container=Box(width=2.2 * D, depth=2.2 * D, height=0.3))


def fallen(scene: Scene, seed: int = 1) -> Packing:
    """Grains of a start that fall on one another."""
    start = place(scene, "gas", seed)
    return replace(start, v=np.tile([0.0, 0.0, -1.0], (len(start), 1)))


def advanced(scene: Scene, start, beats: int, probes=()):
    """Ensemble and member after some beats."""
    ensemble = BACKEND.open(BACKEND.specialise(scene, NUMERICS, probes))
    member = ensemble.admit(scene, NUMERICS, start)
    events = ensemble.advance(beats)
    assert not events
    return ensemble, member


@pytest.mark.slow
def test_a_checkpoint_goes_on_bit_for_bit_and_a_packing_with_all_its_springs():
    scene = bed()
    ensemble, member = advanced(scene, fallen(scene), 14)
    stored, packing = ensemble.checkpoint(member), ensemble.packing(member)
    assert len(packing.pairs) > 0
    assert packing.pair_parts is not None
    assert packing.pair_parts.shape == (len(packing.pairs), 2)
    assert len(packing.wall_part) > 0
    assert set(packing.wall_part.tolist()) <= {0, 1, 2}
    assert stored.arrays["pair_key"].shape == (len(packing.pairs), 4)
    ensemble.advance(2)
    restored, again = advanced(scene, stored, 2)
    for name, array in ensemble.checkpoint(member).arrays.items():
        assert np.array_equal(array, restored.checkpoint(again).arrays[name]), name
    # springs of a packing are those of the checkpoint, also after a change of the order of its grains
    springs = dict(zip(map(tuple, stored.arrays["pair_key"].tolist()), stored.arrays["pair_spring"], strict=True))
    turned = packing.renumbered(np.arange(len(packing))[::-1])
    for order in (packing, turned):
        begun, first = advanced(scene, order, 0)
        arrays = begun.checkpoint(first).arrays
        assert len(arrays["pair_key"]) == len(springs)
        for key, spring in zip(arrays["pair_key"].tolist(), arrays["pair_spring"], strict=True):
            i, j, a, b = key
            expected = springs[i, j, a, b] if (i, j, a, b) in springs else -springs[j, i, b, a]
            assert np.array_equal(spring, expected)


@pytest.mark.slow
def test_contacts_act_between_spheres_that_overlap_and_elastic_forces_see_the_same():
    scene = bed()
    ensemble, member = advanced(scene, fallen(scene), 14, (Contacts(every=14), Ledger(every=14)))
    rows = {type(probe).__name__: table for probe, table in ensemble.drain().items()}
    packing, contacts = ensemble.packing(member), rows["Contacts"]
    touching = [(int(i), int(j), int(w)) for i, j, w in zip(*(contacts[n] for n in ("i", "j", "wall")), strict=True)]
    centres = spheres_of(packing)[0].reshape(-1, 3, 3)
    radii, expected = np.array([sphere.radius for sphere in SEED.spheres]), []
    for i in range(len(packing)):
        for j in range(i + 1, len(packing)):
            apart = np.linalg.norm(centres[i][:, None] - centres[j][None], axis=2)
            expected += [(i, j, -1)] * int(np.sum(apart < radii[:, None] + radii[None]))
        for w, wall in enumerate(scene.container.walls()):
            expected += [(i, -1, w)] * int(np.sum(wall.shape.distance(centres[i]) < radii))
    assert sorted(touching) == sorted(expected)
    assert float(rows["Ledger"]["touching"][-1]) >= 1
    elastic = BACKEND.elastic_forces(scene, NUMERICS, packing)
    assert sorted(zip(elastic["i"].tolist(), elastic["j"].tolist(), elastic["wall"].tolist(), strict=True)) == sorted(
        expected
    )


def test_a_wall_of_triangles_and_a_plane_act_alike():
    plane = Wall(name="floor", shape=Plane(point=(0, 0, 0), normal=(0, 0, 1)))
    mesh = of_triangles(*sheet(4, 12 * D))
    rng = np.random.default_rng(3)
    q = random_turns(rng, 1)
    lowest = min(rotated(q, s.centre)[0, 2] - s.radius for s in SEED.spheres)
    start = at((0.3 * D, 0.2 * D, -lowest + 1e-6), (0.1, 0.05, -0.3), (3.0, 5.0, -2.0), q)
    ends = []
    for wall in (plane, mesh):
        scene = Scene(grains=grains(1), contact=LAW, container=Primitives(parts=(wall,)))
        ensemble, member = advanced(scene, start, 10)
        ends.append(ensemble.packing(member))
    assert np.abs(ends[0].v - start.v).max() > 0.05
    assert ends[1].v == pytest.approx(ends[0].v, abs=1e-9)
    assert ends[1].omega == pytest.approx(ends[0].omega, abs=1e-6)


def test_forces_on_walls_are_those_of_all_spheres():
    flat = SEED.model_copy(update={"centres": ((-0.5 * D, 0, 0), (0.5 * D, 0, 0)), "diameters": (), "count": 1})
    scene = Scene(grains=flat, contact=LAW, container=Box(width=8 * D, depth=8 * D, height=0.1))
    half = np.sqrt(0.5)
    start = at((0, 0, 0.499 * D), q=[[half, 0, half, 0]])
    table = BACKEND.tractions(scene, NUMERICS, start, Traction(size=2 * D, every=1))
    assert table["contacts"].sum() == 2
    assert table["normal"].sum() == pytest.approx(2 * 400 * 0.001 * D, rel=1e-3)


def test_crossings_have_orientations_and_grains_leave():
    silo = CylinderSilo(diameter=6 * D, height=0.1, orifice=4 * D)
    scene, q = Scene(grains=grains(1), contact=LAW, container=silo), random_turns(np.random.default_rng(1), 1)
    start = at((0, 0, 2 * D), (0, 0, -2.0), q=q)
    probe = Crossing(0.0)
    ensemble = BACKEND.open(BACKEND.specialise(scene, NUMERICS, (probe,)))
    member = ensemble.admit(scene, NUMERICS, start)
    ensemble.advance(12)
    assert ensemble.status(member).grains == 0
    rows = ensemble.drain()[probe]
    assert len(rows["id"]) == 1
    assert [rows[f"q{axis}"][0] for axis in "wxyz"] == pytest.approx(q[0], abs=1e-12)  # nothing turned it


@pytest.mark.parametrize("container", [
    Box(width=8 * D, depth=8 * D, height=0.3),
    CylinderSilo(diameter=8 * D, height=0.4, orifice=4 * D),
    ConicalSilo(diameter=9 * D, height=0.4, orifice=4 * D, angle=np.pi / 3),
])  # fmt: skip
def test_placed_clumps_overlap_neither_walls_nor_each_other(container):
    closed = Scene(grains=grains(120), contact=LAW, container=container).close()
    start = place(closed, "gas", 4)
    centres, radii, own = spheres_of(start)
    for wall in closed.container.walls():
        assert (wall.shape.distance(centres) >= radii).all()
    assert least_gap(centres, radii, own) >= 0


def test_orientations_of_placed_clumps_are_uniform():
    closed = Scene(grains=grains(3000), contact=LAW, container=Box(width=0.2, depth=0.2, height=2.0))
    start = place(closed, "rain", 2)
    assert start.q is not None
    frames = np.stack([rotated(start.q, axis) for axis in np.eye(3)])
    assert np.abs(frames.mean(axis=1)).max() < 5 / np.sqrt(3 * 3000)  # five standard errors of a component
    second = np.einsum("anj,ank->ajk", frames, frames) / 3000
    assert np.abs(second - np.eye(3) / 3).max() < 5 * np.sqrt(4 / 45 / 3000)


def test_clumps_come_back_above_the_bed_without_overlaps():
    silo = CylinderSilo(diameter=8 * D, height=0.5, orifice=4 * D)
    scene = Scene(grains=grains(40), contact=LAW, container=silo, feed=Feed(kind="reinject"))
    start = place(scene.close(), "gas", 1)
    there = start.subset(np.arange(30))
    [back] = refill([Refill(Feeder(scene, start, "gas", 1), BedTop.of(there), 3)])
    assert back is not None
    assert np.array_equal(np.sort(np.asarray(back.ids)), np.arange(30, 40))
    parts = [spheres_of(there), spheres_of(back)]
    centres, radii = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
    assert least_gap(centres, radii, np.repeat(np.arange(40), 3)) >= 0


def test_clumps_that_reach_far_to_one_side_are_fed_clear_of_the_bed():
    """The centre of mass lies near the large sphere: the small one reaches farther than half the length."""
    drop = Clumps(diameter=D, centres=((0, 0, 0), (0, 0, 0.6 * D)), diameters=(D, D / 4), density=2500, count=40)
    assert drop.reach > 1.1 * drop.extent / 2
    silo = CylinderSilo(diameter=8 * D, height=0.5, orifice=4 * D)
    scene = Scene(grains=drop, contact=LAW, container=silo, feed=Feed(kind="reinject"))
    feeder = Feeder(scene, place(scene.close(), "gas", 1), "gas", 1)
    search = feeder.search(np.arange(5), BedTop.of(feeder.start, feeder.floor), 1)
    lowest = min(float(search.draw(k, search.radius)[:, 2].min()) for k in range(50))
    assert lowest - 2 * drop.reach > feeder.floor


def test_a_clump_meets_a_lip_by_its_spheres():
    """A clump of one sphere over the rounded edge of an outlet moves as that sphere does."""
    silo = CylinderSilo(diameter=20 * D, height=0.5, orifice=4 * D, lip=Lip(radius=D))
    start = at([2.6 * D, 0, 0.4 * D], v=(0, 0, -0.3))
    packings = []
    size = {"diameter": D, "density": 2500.0, "count": 1}
    for kind in (Spheres(**size), Clumps(centres=((0, 0, 0),), **size)):
        turned = start if isinstance(kind, Spheres) else replace(start, q=np.array([[1.0, 0, 0, 0]]))
        ensemble, member = advanced(Scene(grains=kind, contact=LAW, container=silo), turned, 20)
        packings.append(ensemble.packing(member))
    sphere, clump = packings
    assert sphere.v[0, 0] < -0.01  # it has met the edge, which pushes it towards the axis
    assert clump.x == pytest.approx(sphere.x, abs=1e-12)
    assert clump.v == pytest.approx(sphere.v, abs=1e-10)


def test_starts_without_clumps_say_so():
    scene = bed()
    for kind in ("dense", "planar"):
        assert any("clumps" in fault.reason for fault in STARTS[kind].obstacles(scene)), kind
    with pytest.raises(PlacingError, match="not clumps"):
        place(scene, "dense", 1)


@pytest.mark.parametrize(("changed", "message"), [
    ({"q": None, "pairs": np.zeros((0, 2), int), "pair_spring": np.zeros((0, 3))}, "without orientations"),
    ({}, "without pair_parts"),
])  # fmt: skip
def test_packings_of_other_grains_are_refused(changed, message):
    q = random_turns(np.random.default_rng(1), 2)
    given: dict[str, Any] = {
        "x": np.array([[0, 0, D], [0, 0, 3 * D]]),
        "v": np.zeros((2, 3)),
        "omega": np.zeros((2, 3)),
        "q": q,
    }
    given |= {"pairs": np.array([[0, 1]]), "pair_spring": np.zeros((1, 3)), **changed}
    with pytest.raises(ValueError, match=message):
        advanced(bed(2), Packing(**given), 0)


@pytest.mark.parametrize("parts", [np.zeros((1, 2)), np.zeros((2, 2), int), np.array([[0, 8]]), np.array([[-1, 0]])])
def test_a_packing_names_spheres_that_clumps_may_have(parts):
    x = np.array([[0, 0, 0], [0, 0, D]])
    with pytest.raises(ValueError, match="pair_parts"):
        Packing(x=x, v=0 * x, omega=0 * x, pairs=np.array([[0, 1]]), pair_spring=np.zeros((1, 3)), pair_parts=parts)
