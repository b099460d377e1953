"""Parts that move on the GPU backend, on the processor: as by the reference, from checkpoints, beside other members."""

from types import SimpleNamespace
from typing import Any

import labbook_reference
import numpy as np
import pytest
from platforms import identical

pytest.importorskip("warp")

import warp as wp
from labbook_dem.features import part_speed
from labbook_warp import Backend
from labbook_warp.build import module_text
from labbook_warp.poses import NEVER, PoseTables, steps_of_part
from labbook_warp.run import Run
from turning_box import RODS, SPHERES, D, in_the_box, turning_box

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Contacts, Ledger, Sample, Traction
from labbook.checks.verify.mesh import of_triangles, sheet
from labbook.checks.verify.platform import grains_at
from labbook.scene import Primitives

PROBES = (Sample(fields=("x", "v", "omega")), Contacts(every=1), Ledger(every=10), Traction(size=1.0))
STEPS = 50
BEATS = 24
"""In which grains hit walls, and lists are built a few times."""
GRAINS = [pytest.param(SPHERES, id="spheres"), pytest.param(RODS, id="rods")]
ROUNDINGS = 300
"""Allowed differences of positions [d] and velocities [m/s]: some 100 steps round a force three times each."""


def how(precision: str = "double") -> Numerics:
    return Numerics.model_validate({"dt": 2.5e-6, "precision": precision, "steps_per_beat": STEPS})


def ends(members, beats: int, backend=None, numerics: Numerics | None = None):
    """Packings, checkpoints and rows of members side by side."""
    backend, numerics = backend or Backend(), numerics or how()
    ensemble = backend.open(backend.specialise(members[0][0], numerics, PROBES), None, "cpu")
    try:
        admitted = [ensemble.admit(of, numerics, begin) for of, begin in members]
        assert not ensemble.advance(beats)
        tables = ensemble.drain()
        return [(ensemble.packing(member), ensemble.checkpoint(member)) for member in admitted], tables
    finally:
        ensemble.close()


@pytest.mark.parametrize("grains", GRAINS)
def test_kernels_of_meshes_that_stand_still_know_nothing_of_motion(grains):
    still = module_text(Backend().specialise(turning_box(grains, None), how(), PROBES), True, 1, 0, 0, 0)
    moving = module_text(Backend().specialise(turning_box(grains), how(), PROBES), True, 1, 0, 0, 0)
    words = ("def tick", "pose[", "spring_from_part(", "lists_are_due(", "if POSES")
    assert not [word for word in words if word in still]
    assert all(word in moving for word in words)


def test_tables_hold_the_poses_of_the_present_step():
    """From one step before on, of members at other steps and in any slot; what stands still is part 0."""
    of = turning_box(SPHERES)
    runs = [Run(of, how(), PROBES, in_the_box(of)), Run(of, how(), PROBES, in_the_box(of))]
    runs[0].slot, runs[1].slot, runs[1].step = 2, 0, 700
    tables = PoseTables(wp.get_device("cpu"), STEPS)
    assert tables.cover(runs, 3)
    tables.bring(runs, runs)
    runs[0].step += STEPS  # a beat later, before the next
    tables.bring(runs, ())
    system: Any = SimpleNamespace()
    tables.put(system)
    (wall,) = of.container.walls()
    assert wall.moves is not None
    for run in runs:
        assert system.pose_step.numpy()[run.slot] == run.step
        row = int(system.pose_row.numpy()[run.slot])
        expected = wall.moves.poses(np.array([run.step - 1, run.step]) * how().dt).table()
        assert np.array_equal(system.pose.numpy()[row - 1 : row + 1, 1], expected)
        assert np.array_equal(system.pose.numpy()[row, 0].reshape(2, 9)[0], np.eye(3).ravel())
        assert tables.of(run).tolist() == [1]
    assert not tables.cover(runs, 3)


def test_lists_are_built_before_a_part_has_moved_by_half_a_skin():
    of, still = turning_box(SPHERES), turning_box(SPHERES, None)
    run = Run(of, how(), PROBES, in_the_box(of))
    travel = part_speed(of, 0.0) * how().dt * steps_of_part(run)
    half = 0.5 * how().skin * D
    assert 0.3 * half < travel < half
    assert steps_of_part(Run(still, how(), PROBES, in_the_box(still))) == NEVER


@pytest.mark.ring
@pytest.mark.compiles
@pytest.mark.parametrize("precision", ["double", "mixed"])
@pytest.mark.parametrize("grains", GRAINS)
def test_grains_move_as_by_the_reference(grains, precision):
    of, eps = turning_box(grains), float(np.finfo(np.float32 if precision == "mixed" else np.float64).eps)
    members, beats = [(of, in_the_box(of))], 3 if grains is RODS else 1
    ((here, _),), rows = ends(members, beats, numerics=how(precision))
    ((there, _),), expected = ends(members, beats, labbook_reference.Backend())
    assert np.abs(here.x - there.x).max() / D < ROUNDINGS * eps
    assert np.abs(here.v - there.v).max() < ROUNDINGS * eps
    order = [np.lexsort((p.wall_part, p.wall_grain)) for p in (here, there)]
    springs = [p.wall_spring[k] for p, k in zip((here, there), order, strict=True)]
    assert len(springs[0]) == len(springs[1]) >= 1
    assert np.abs(springs[0] - springs[1]).max() / D < ROUNDINGS * eps
    for name in ("fx", "ty"):
        assert rows[PROBES[3]][name].sum() == pytest.approx(expected[PROBES[3]][name].sum(), rel=1e3 * eps, abs=1e-9)


@pytest.mark.ring
@pytest.mark.compiles
@pytest.mark.parametrize("grains", GRAINS)
def test_company_and_checkpoints_change_no_bit(grains):
    """A member that begins again in the middle of a revolution, beside others at other steps."""
    of = turning_box(grains)
    ((alone, _),), _ = ends([(of, in_the_box(of))], BEATS)
    ((_, checkpoint),), _ = ends([(of, in_the_box(of))], BEATS - 9)
    (first, again, _), _ = ends([(of, in_the_box(of)), (of, checkpoint), (of, in_the_box(of))], 9)
    assert identical(again[0], alone)
    ((short, _),), _ = ends([(of, in_the_box(of))], 9)
    assert identical(first[0], short)


@pytest.mark.ring
@pytest.mark.compiles
def test_a_part_vanishes_at_its_time():
    """A sphere at rest on it falls freely from then on."""
    vertices, triangles = sheet(1, 2 * D)
    lid = of_triangles(vertices, triangles).model_copy(update={"opens": 40.5 * how().dt})
    of = turning_box(SPHERES.model_copy(update={"count": 1})).model_copy(update={"container": Primitives(parts=(lid,))})
    stiffness = of.contact.model_dump()["normal_stiffness"]
    level = D / 2 - of.grains.mass * of.gravity / stiffness
    ((end, _),), _ = ends([(of, grains_at([[0.0, 0.0, level]]))], 3)
    steps = 3 * STEPS - 41  # step 41 is the first whose force is without it
    assert level - end.x[0, 2] == pytest.approx(of.gravity * how().dt ** 2 * steps * (steps + 1) / 2, rel=1e-6)
    assert not len(end.wall_name)
