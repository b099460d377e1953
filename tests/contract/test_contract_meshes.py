"""Grains at walls of triangles: as by the reference, alone and beside others, and on from a checkpoint."""

import math

import labbook_reference
import numpy as np
import pytest
from platforms import Bundled, identical

from labbook.backend import Failed
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Contacts, Ledger, Sample, Traction
from labbook.checks.stress.meshes import fan
from labbook.checks.verify.materials import D, G, linear, scene
from labbook.checks.verify.mesh import of_triangles, sheet
from labbook.checks.verify.platform import grains_at, rows_of
from labbook.scene import Box, Primitives, Scene, Wall
from labbook.scene.packing import Packing

R = D / 2
TRACTION = Traction(size=1.0)
PROBES = (Sample(fields=("x", "v", "omega")), Contacts(every=1), Ledger(every=10), TRACTION)
BEATS = 60
"""Of 50 steps, in which grains fall by their overlap and roll off."""
SIDES = 30
"""Triangles at the tip of a cone: more than the list of a grain has room for."""
ROUNDINGS = 300
"""Allowed differences of positions [d] and velocities [m/s]: 100 steps round a force three times each."""


@pytest.fixture(scope="module", autouse=True)
def _compiled(platform: Bundled):
    if platform.part < 1:
        pytest.skip("the others are compared with it")


def floored(floor: Wall) -> Scene:
    """Grains between planes, over a floor of triangles, which is a wall of another number than its own."""
    box = Box(width=16 * R, depth=16 * R, height=40 * R)
    sides = [wall for wall in box.walls() if wall.name != "bottom"]
    law = linear(friction=0.4, restitution=0.1)
    return scene(8, law, Primitives(parts=(*sides[:2], floor, *sides[2:])), G)


def trough() -> Scene:
    """A bent sheet, which meets two planes in its corners."""
    vertices, triangles = sheet(6, 8 * R)
    level = np.zeros(len(vertices))
    return floored(of_triangles(vertices + np.column_stack([level, level, 0.3 * np.abs(vertices[:, 0])]), triangles))


def tip() -> Scene:
    """A flat cone with SIDES sides and its tip in the middle."""
    vertices, triangles = fan(SIDES, 3 * R)
    return floored(of_triangles(vertices, triangles))


def start(of: Scene) -> Packing:
    """Grains that fall onto the floor, touching it soon; the first stands on the middle of it."""
    rng = np.random.default_rng(2)
    x = np.array([[a, b, 0.0] for a in (-6.99, -2.5, 2.5, 6.99) for b in (-2, 2)]) * R
    x[0] = 0.0
    (floor,) = (wall for wall in of.container.walls() if wall.name == "floor")
    heights = np.linspace(-3, 8, 400) * R
    for k in range(len(x)):
        column = np.column_stack([np.tile(x[k, :2], (len(heights), 1)), heights])
        clear = np.abs(floor.shape.distance(column)) >= R
        x[k, 2] = heights[np.flatnonzero(~clear)[-1] + 1]
    v = rng.uniform(-0.3, 0.3, (8, 3)) * [1, 1, 0] - [0, 0, 0.05]
    v[0, :2] *= 0.01
    return grains_at(x, v)


def numerics(platform: Bundled) -> Numerics:
    return platform.numerics(2.5e-6, steps_per_beat=50)


def ends(platform: Bundled, members, beats: int, later=(), device: str | None = None):
    """Packing, checkpoint and rows of members side by side, of which those of `later` join half way."""
    how = numerics(platform)
    spec = platform.backend.specialise(members[0][0], how, PROBES)
    ensemble = platform.backend.open(spec, None, device or platform.device)
    try:
        admitted = [ensemble.admit(of, how, begin) for of, begin in members]
        assert not ensemble.advance(beats - beats // 2)
        admitted += [ensemble.admit(of, how, begin) for of, begin in later]
        assert not ensemble.advance(beats // 2)
        tables = ensemble.drain()
        return [
            (
                ensemble.packing(member),
                ensemble.checkpoint(member),
                {probe: rows_of(table, member) for probe, table in tables.items()},
            )
            for member in admitted
        ]
    finally:
        ensemble.close()


@pytest.fixture(scope="module")
def alone(platform: Bundled):
    """Of both scenes, the end of a member by itself."""
    return {of: ends(platform, [(of(), start(of()))], BEATS)[0] for of in (trough, tip)}


def keys(packing: Packing) -> dict:
    """Springs by grain, wall and feature."""
    each = zip(packing.wall_grain.tolist(), packing.wall_name.tolist(), packing.wall_part.tolist(), strict=True)
    return dict(zip(each, packing.wall_spring, strict=True))


@pytest.mark.parametrize("of", [trough, tip])
def test_they_move_as_by_the_reference(platform: Bundled, alone, of):
    packing = alone[of][0]
    assert packing.wall_part.max() > 8, "features have numbers of their own"
    plain = Bundled(labbook_reference.Backend(), "double", "cpu")
    (here, _, rows), (there, _, expected) = (
        ends(s, [(of(), packing)], 2, device=s.device)[0] for s in (platform, plain)
    )
    limit = ROUNDINGS * float(np.finfo(np.float32 if platform.precision == "mixed" else np.float64).eps)
    assert np.abs(there.x - packing.x).max() > 0.01 * R
    assert np.abs(here.x - there.x).max() / D < limit
    assert np.abs(here.v - there.v).max() < limit
    springs, others = keys(here), keys(there)
    assert springs.keys() == others.keys()
    assert len(springs) > 5
    assert max(np.abs(spring).max() for spring in others.values()) > 1e-8
    assert max(np.abs(springs[key] - others[key]).max() for key in others) / D < limit
    for table in (rows, expected):
        sums, touching = table[TRACTION], table[PROBES[1]]
        for name in ("fx", "fy", "fz"):
            of_step = touching["step"] == touching["step"].max()
            at_walls = touching[name][of_step & (touching["wall"] >= 0)].sum()
            assert sums[name][sums["step"] == sums["step"].max()].sum() == pytest.approx(at_walls, rel=1e-4, abs=1e-9)


def test_a_grain_at_a_tip_touches_it_once(platform: Bundled, alone):
    """Its 30 faces and edges have the vertex in common."""
    rows = alone[tip][2][PROBES[1]]
    mine = (rows["i"] == 0) & (rows["wall"] == 2)
    steps, counts = np.unique(rows["step"][mine], return_counts=True)
    assert len(steps) > 10
    assert (counts == 1).all()


@pytest.mark.parametrize("of", [trough, tip])
def test_they_go_on_from_a_checkpoint_bit_for_bit(platform: Bundled, alone, of):
    checkpoint = ends(platform, [(of(), start(of()))], BEATS // 2)[0][1]
    again = ends(platform, [(of(), checkpoint)], BEATS - BEATS // 2)[0][0]
    assert identical(again, alone[of][0])


def test_other_meshes_beside_a_member_change_no_bit(platform: Bundled, alone):
    """Side by side, and where one comes when the other is under way."""
    pairs = [(of(), start(of())) for of in (tip, trough)]
    beside = ends(platform, [*pairs, pairs[0]], BEATS)
    joined = ends(platform, pairs[:1], BEATS, later=pairs[1:])[0]
    for of, end in ((tip, beside[0]), (trough, beside[1]), (tip, beside[2]), (tip, joined)):
        assert identical(end[0], alone[of][0])
        for probe in PROBES:
            assert identical(end[2][probe], alone[of][2][probe])


def test_a_tube_narrower_than_a_grain_fails_with_the_remedy(platform: Bundled):
    angles = 2 * math.pi * np.arange(24) / 24
    ring = np.array([(0.999 * R * np.cos(t), 0.999 * R * np.sin(t), z) for t in angles for z in (-9 * R, 9 * R)])
    pairs = [(2 * k, 2 * ((k + 1) % 24)) for k in range(24)]
    of = floored(of_triangles(ring, np.array([t for a, b in pairs for t in ((a, b, b + 1), (a, b + 1, a + 1))])))
    how = numerics(platform)
    ensemble = platform.backend.open(platform.backend.specialise(of, how, PROBES), None, platform.device)
    ensemble.admit(of, how, grains_at([[0.0, 0.0, 0.3 * R]]))
    (failure,) = ensemble.advance(1)
    ensemble.close()
    assert isinstance(failure, Failed)
    assert "smooth" in failure.message
