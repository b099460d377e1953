"""The contract with rods and clumps in a silo whose bottom turns: probes, checkpoints, packings, members."""

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np
import pytest
from platforms import Bundled, identical

from labbook.backend import Failed, Unsupported
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Contacts, Crossing, Ledger, Probe, Sample, Slab, Table, Traction, Zone, columns
from labbook.checks.verify.clumps import SEED, clumps, clumps_at
from labbook.checks.verify.platform import rows_of
from labbook.checks.verify.rods import rods as rods_alone
from labbook.checks.verify.rods import rods_at
from labbook.checks.verify.symmetry import hopper
from labbook.filling import Feeder, Refill, place, refill, start_of_discharge
from labbook.scene import (
    BedTop,
    Clumps,
    CylinderSilo,
    Feed,
    LinearSpringDashpot,
    Packing,
    Primitives,
    Scene,
    Spherocylinders,
)
from labbook.scene.orientation import axes

DT, STEPS = 1e-5, 200
COUNT, RESTING = 60, 700
"""How many grains there are, and beats until they rest, where a platform takes the whole."""
FALLEN = {"spherocylinder": 100, "clump": 60}
"""Beats until they have fallen: clumps, which are smaller, begin lower."""
SILO = CylinderSilo(diameter=60e-3, height=0.5, orifice=36e-3, rotation=1.0)
ZONE = Zone(radius=20e-3, low=-0.01, high=0.02, core=0.01, top=0.05)
TRACTION = Traction(size=20e-3)
SLAB = Slab(low=-0.01, high=0.02)
SAMPLE, CROSSING, LEDGER, CONTACTS = Sample(("x", "omega", "q")), Crossing(), Ledger(), Contacts()
PROBES = SAMPLE, CROSSING, LEDGER, CONTACTS, ZONE, SLAB, TRACTION


SCALE = 6e-3 / SEED.diameter
GRAINS = {
    "spherocylinder": Spherocylinders(diameter=6e-3, length=20e-3, density=620, count=COUNT),
    "clump": Clumps(
        diameter=6e-3,
        centres=tuple((SCALE * x, SCALE * y, SCALE * z) for x, y, z in SEED.centres),
        diameters=tuple(SCALE * size for size in SEED.diameters),
        density=620,
        count=COUNT,
    ),
}


@dataclass(frozen=True)
class Oriented(Bundled):
    """A platform with grains of a shape that has an orientation."""

    shape: str = "spherocylinder"


def silo(platform: Oriented) -> Scene:
    grains = GRAINS[platform.shape].model_copy(update={"count": round(COUNT * platform.part)})
    law = LinearSpringDashpot(normal_stiffness=200.0, friction=0.5, rolling_friction=0.01, restitution=0.5)
    return Scene(grains=grains, contact=law, container=SILO, gravity=9.81)


@pytest.fixture(scope="module", params=GRAINS)
def oriented(request, platform: Bundled) -> Oriented:
    can = platform.backend.capabilities
    if request.param not in can.shapes or "frustum" not in can.walls:
        pytest.skip(f"the backend {can.name} has no {request.param}s in round silos")
    return Oriented(**{field.name: getattr(platform, field.name) for field in fields(platform)}, shape=request.param)


def numerics(platform: Oriented) -> Numerics:
    return platform.numerics(DT, steps_per_beat=STEPS)


def run(platform: Oriented, scene: Scene, start, splits=(1,) * 10, probes=PROBES, members: int = 1):
    """End and rows of the first of some members."""
    backend = platform.backend
    ensemble = backend.open(backend.specialise(scene, numerics(platform), probes), members, platform.device)
    try:
        first, *_ = [ensemble.admit(scene, numerics(platform), start) for _ in range(members)]
        for beats in splits:
            ensemble.advance(beats)
        tables: Mapping[Probe, Table] = ensemble.drain()
        rows = {probe: rows_of(table, first) for probe, table in tables.items()}
        return ensemble.packing(first), rows, ensemble.checkpoint(first)
    finally:
        ensemble.close()


@pytest.fixture(scope="module")
def bed(oriented: Oriented) -> Packing:
    """Grains that have fallen into the closed silo and still move."""
    closed = silo(oriented).close()
    end, _, _ = run(
        oriented, closed, place(closed, "gas", 1), (round(FALLEN[oriented.shape] * oriented.part),), (LEDGER,)
    )
    return start_of_discharge(end, closed, silo(oriented))


@pytest.fixture(scope="module")
def discharge(oriented: Oriented, bed: Packing):
    return run(oriented, silo(oriented), bed, (40,))


def test_tables_have_orientations(discharge):
    packing, rows, _ = discharge
    for probe in PROBES:
        assert set(rows[probe]) == set(columns(probe, rods=True))
    for table in (rows[SAMPLE], rows[CROSSING]):
        q = np.stack([table[name] for name in ("qw", "qx", "qy", "qz")], axis=1)
        assert len(q) > 3
        assert np.abs(np.linalg.norm(q, axis=1) - 1).max() < 1e-6
    # a packing is without the grains far below the outlet
    last = (rows[SAMPLE]["step"] == rows[SAMPLE]["step"].max()) & np.isin(rows[SAMPLE]["id"], packing.ids)
    q = np.stack([rows[SAMPLE][name][last] for name in ("qw", "qx", "qy", "qz")], axis=1)
    assert axes(q) == pytest.approx(axes(np.asarray(packing.q)), abs=1e-6)


def test_a_zone_has_the_orientations_of_the_sample(discharge):
    _, rows, _ = discharge
    sample, zone = rows[SAMPLE], rows[ZONE]
    inside = ZONE.holds(np.column_stack([sample[axis] for axis in "xyz"]))
    assert 0 < inside.sum() < len(inside)
    for name in ("step", "id", "x", "z", "qw", "qx", "qy", "qz"):
        assert np.array_equal(zone[name], sample[name][inside])


def test_a_slab_has_the_grains_of_the_sample(discharge):
    _, rows, _ = discharge
    sample, slab = rows[SAMPLE], rows[SLAB]
    inside = SLAB.holds(sample["z"])
    assert 0 < inside.sum() < len(inside)
    of_sample, of_slab = (
        np.lexsort((table["id"][mask], table["step"][mask]))
        for table, mask in ((sample, inside), (slab, np.ones(len(slab["id"]), bool)))
    )
    for name in ("step", "id", "x", "y", "z"):
        assert np.array_equal(slab[name][of_slab], sample[name][inside][of_sample]), name


def test_traction_adds_up_the_contacts_with_walls(oriented, discharge):
    """Forces are rounded to 2^-24 of a rod's weight in each contact; kernels in single agree to their precision."""
    _, rows, _ = discharge
    contacts, sums = rows[CONTACTS], rows[TRACTION]
    walls = contacts["wall"] >= 0
    rounding = 1e-12 if oriented.precision == "double" else 1e-5
    unit = silo(oriented).grains.mass * silo(oriented).gravity * 2.0**-24
    for wall in range(2):
        mine, row = walls & (contacts["wall"] == wall), sums["wall"] == wall
        assert sums["contacts"][row].sum() == mine.sum() > 100
        for name in ("fx", "fy", "fz"):
            allowed = mine.sum() * unit + rounding * np.abs(contacts[name][mine]).sum()
            assert sums[name][row].sum() == pytest.approx(contacts[name][mine].sum(), abs=allowed)
    bottom = sums["wall"] == 1
    assert sums["normal"][bottom].sum() > 0.9 * sums["fz"][bottom].sum(), "but for the rim, normals are upright"


def test_a_crossing_that_saw_no_grain_has_the_columns_too(oriented, bed):
    _, rows, _ = run(oriented, silo(oriented), bed, (1,))
    assert len(rows[CROSSING]["id"]) == 0
    assert set(rows[CROSSING]) == set(columns(CROSSING, rods=True))


def test_bits_depend_on_neither_splits_nor_neighbours(oriented, bed, discharge):
    assert identical(run(oriented, silo(oriented), bed, (1,) * 40)[0], discharge[0])
    assert identical(run(oriented, silo(oriented), bed, (40,), members=3)[0], discharge[0])


def test_a_checkpoint_continues_bit_for_bit(oriented, bed, discharge):
    _, before, stored = run(oriented, silo(oriented), bed, (15,))
    end, after, _ = run(oriented, silo(oriented), stored, (25,))
    assert identical(end, discharge[0])
    for probe in (SAMPLE, CROSSING, CONTACTS):
        for name, column in discharge[1][probe].items():
            assert np.array_equal(np.concatenate([before[probe][name], after[probe][name]]), column), name


def test_a_packing_holds_all_there_is(oriented, bed, discharge):
    """Started again from a packing, grains go where they would have gone, but for the half steps of the leapfrog."""
    middle, _, _ = run(oriented, silo(oriented), bed, (15,))
    again, _, _ = run(oriented, silo(oriented), middle, (1,))
    straight, _, _ = run(oriented, silo(oriented), bed, (16,))
    assert np.array_equal(np.asarray(again.ids), np.asarray(straight.ids))
    # a beat is 2 ms; grains fall 20 um in it from rest, and move by some 1 mm
    assert np.abs(again.x - straight.x).max() < 2e-5
    assert middle.wall_part.max() > 0
    assert len(middle.pairs) > 10


def test_a_resting_bed_s_walls_carry_its_weight(oriented):
    closed, beats = silo(oriented).close(), round(RESTING * oriented.part)
    start, grains = place(closed, "gas", 2), closed.grains
    seldom = contacts, ledger = Contacts(every=beats), Ledger(every=beats)
    end, rows, _ = run(oriented, closed, start, (beats,), seldom)
    contacts, ledger = rows[contacts], rows[ledger]
    weight = grains.count * grains.mass * closed.gravity
    assert ledger["kinetic"][-1] < 1e-7 * weight * grains.diameter
    walls = contacts["wall"] >= 0
    assert contacts["fz"][walls].sum() == pytest.approx(weight, rel=1e-4)
    assert np.abs([contacts[name][walls].sum() for name in ("fx", "fy")]).max() < 1e-4 * weight
    rest = oriented.backend.tractions(closed, numerics(oriented), end, TRACTION)
    assert rest is not None
    assert rest["contacts"].sum() == walls.sum()
    assert rest["fz"].sum() == pytest.approx(weight, rel=1e-4)
    at = list(zip(contacts["i"][walls].tolist(), contacts["wall"][walls].tolist(), strict=True))
    assert len(at) > len(set(at)), "some lie on the bottom with both ends, or several spheres"


def test_energy_is_accounted_for(oriented, bed):
    _, rows, _ = run(oriented, silo(oriented).close(), bed, (1,) * 20, (LEDGER,))
    table = rows[LEDGER]
    balance = table["kinetic"] + table["potential"] - table["contact_work"]
    # closed to second order in the step, and in `mixed` to the rounding of forces
    limit = 1e-7 if oriented.precision == "double" else 1e-5
    assert np.ptp(balance) < limit * np.abs(table["contact_work"]).max()


def fed(oriented: Oriented, start, feeder: Feeder, beats: range):
    """End, crossings and checkpoint of a member whose grains return after each beat, and the number of these."""
    backend, returned = oriented.backend, 0
    spec = backend.specialise(silo(oriented), numerics(oriented), PROBES)
    ensemble = backend.open(spec, 1, oriented.device)
    try:
        member = ensemble.admit(silo(oriented), numerics(oriented), start)
        for beat in beats:
            ensemble.advance(1)
            top = ensemble.tops({member: feeder.floor})[member]
            expected = BedTop.of(ensemble.packing(member), feeder.floor)
            places = [np.argsort(of.ids) for of in (top, expected)]
            assert np.array_equal(top.ids[places[0]], expected.ids[places[1]])
            assert np.array_equal(np.asarray(top.q)[places[0]], np.asarray(expected.q)[places[1]])
            (back,) = refill([Refill(feeder, top, beat)])
            if back is not None:
                ensemble.put_back(member, back)
                returned += len(back)
        rows = rows_of(ensemble.drain()[CROSSING], member)
        return ensemble.packing(member), rows, ensemble.checkpoint(member), returned
    finally:
        ensemble.close()


def test_fed_grains_continue_from_a_checkpoint_bit_for_bit(oriented, bed):
    feeder = Feeder(silo(oriented).model_copy(update={"feed": Feed(kind="reinject")}), bed, "gas", 1)
    end, rows, _, returned = fed(oriented, bed, feeder, range(1, 81))
    assert returned > 2
    assert np.array_equal(np.sort(np.asarray(end.ids)), np.arange(len(bed)))
    _, before, stored, first = fed(oriented, bed, feeder, range(1, 61))
    again, after, _, then = fed(oriented, stored, feeder, range(61, 81))
    assert identical(again, end)
    assert first + then == returned
    assert 0 < first < returned
    for name, column in rows.items():
        assert np.array_equal(np.concatenate([before[name], after[name]]), column), name


def test_checkpoints_and_packings_of_other_clumps_are_refused(oriented, bed):
    """Of clumps of three spheres, where clumps have two: they have springs of a sphere that is not there."""
    scene = silo(oriented)
    if not isinstance(scene.grains, Clumps):
        pytest.skip("rods have no spheres")
    pair = scene.grains.model_copy(
        update={"centres": scene.grains.centres[:2], "diameters": scene.grains.diameters[:2]}
    )
    other = scene.model_copy(update={"grains": pair})
    packing, _, stored = run(oriented, scene, bed, (1,))
    assert np.asarray(packing.pair_parts).max() == 2
    for start in (stored, packing):
        with pytest.raises(ValueError, match=r"(grains of|do not have)"):
            run(oriented, other, start, (1,))


def test_spheres_have_no_orientation_to_sample(oriented):
    with pytest.raises(Unsupported, match="orientation"):
        oriented.backend.specialise(hopper(), numerics(oriented), [SAMPLE])


def test_a_packing_of_spheres_is_no_start(oriented, bed):
    spheres = Packing(x=bed.x, v=bed.v, omega=bed.omega)
    with pytest.raises(ValueError, match="without orientations"):
        run(oriented, silo(oriented), spheres, (1,))


def fastest_of(platform: Oriented) -> tuple[Scene, Packing, float]:
    """A grain alone that flies and turns, and the largest speed of any part of it [m/s].

    For rods |v| + h |omega x axis|, h half the distance of both centres; for clumps the speed of a sphere.
    """
    spin, v = 100.0, 0.2
    if platform.shape == "clump":
        start = clumps_at([[0.0, 0.0, 0.0]], [[1.0, 0.0, 0.0, 0.0]], [[v, 0.0, 0.0]], [[0.0, spin, 0.0]])
        # the middle axis, about which it turns uniformly for some time: by `turned` in the 20 steps of a beat
        turned = spin * DT * np.arange(21)
        x, z = np.array([sphere.centre[::2] for sphere in SEED.spheres]).T
        way_x = v * DT + np.diff(np.outer(x, np.cos(turned)) + np.outer(z, np.sin(turned)))
        way_z = np.diff(np.outer(z, np.cos(turned)) - np.outer(x, np.sin(turned)))
        return clumps(SEED, 1, Primitives()), start, float(np.hypot(way_x, way_z).max() / DT)
    free = rods_alone(1, Primitives())
    start = rods_at([[0.0, 0.0, 0.0]], [[1.0, 0.0, 0.0, 0.0]], [[v, 0.0, 0.0]], [[0.0, spin, 0.0]])
    along = np.linalg.norm(np.cross([0.0, spin, 0.0], axes(np.asarray(start.q))[0]))
    return free, start, v + free.grains.overhang * float(along)


def test_a_turning_grain_is_as_fast_as_its_fastest_part(oriented):
    """The guard on speeds sees the same."""
    free, start, fastest = fastest_of(oriented)
    assert fastest > 1.3 * np.linalg.norm(start.v)
    for limit, stopped in ((1.001 * fastest, False), (0.999 * fastest, True)):
        how = oriented.numerics(DT, steps_per_beat=20, speed_limit=limit)
        ensemble = oriented.backend.open(oriented.backend.specialise(free, how, ()), 1, oriented.device)
        try:
            member = ensemble.admit(free, how, start)
            failures = [event for event in ensemble.advance(1) if isinstance(event, Failed)]
            assert [event.guard for event in failures] == ["speed"] * stopped
            if not stopped:
                assert ensemble.status(member).fastest == pytest.approx(fastest, rel=1e-5)
        finally:
            ensemble.close()
