"""The contract with rods in a silo whose bottom turns: probes, checkpoints, packings, members."""

from collections.abc import Mapping

import numpy as np
import pytest
from platforms import Bundled, identical

from labbook.backend import Failed, Unsupported
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Contacts, Crossing, Ledger, Probe, Sample, Table, Traction, Zone, columns
from labbook.checks.verify.platform import rows_of
from labbook.checks.verify.rods import rods as rods_alone
from labbook.checks.verify.rods import rods_at
from labbook.checks.verify.symmetry import hopper
from labbook.filling import place, start_of_discharge
from labbook.scene import CylinderSilo, LinearSpringDashpot, Packing, Primitives, Scene, Spherocylinders
from labbook.scene.orientation import axes

DT, STEPS = 1e-5, 200
RODS, FALLEN, RESTING = 60, 100, 700
"""How many rods there are, beats until they have fallen and until they rest, where a platform takes the whole."""
SILO = CylinderSilo(diameter=60e-3, height=0.5, orifice=36e-3, rotation=1.0)
ZONE = Zone(radius=20e-3, low=-0.01, high=0.02, core=0.01, top=0.05)
TRACTION = Traction(size=20e-3)
SAMPLE, CROSSING, LEDGER, CONTACTS = Sample(("x", "omega", "q")), Crossing(), Ledger(), Contacts()
PROBES = SAMPLE, CROSSING, LEDGER, CONTACTS, ZONE, TRACTION


def silo(platform: Bundled) -> Scene:
    grains = Spherocylinders(diameter=6e-3, length=20e-3, density=620, count=round(RODS * platform.part))
    law = LinearSpringDashpot(normal_stiffness=200.0, friction=0.5, rolling_friction=0.01, restitution=0.5)
    return Scene(grains=grains, contact=law, container=SILO, gravity=9.81)


@pytest.fixture(scope="module")
def rods(platform: Bundled) -> Bundled:
    can = platform.backend.capabilities
    if not {"spherocylinder"} <= can.shapes or "frustum" not in can.walls:
        pytest.skip(f"the backend {can.name} has no rods in round silos")
    return platform


def numerics(platform: Bundled) -> Numerics:
    return platform.numerics(DT, steps_per_beat=STEPS)


def run(platform: Bundled, scene: Scene, start, splits=(1,) * 10, probes=PROBES, members: int = 1):
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
def bed(rods: Bundled) -> Packing:
    """Rods that have fallen into the closed silo and still move."""
    closed = silo(rods).close()
    end, _, _ = run(rods, closed, place(closed, "gas", 1), (round(FALLEN * rods.part),), (LEDGER,))
    return start_of_discharge(end, closed, silo(rods))


@pytest.fixture(scope="module")
def discharge(rods: Bundled, bed: Packing):
    return run(rods, silo(rods), bed, (40,))


def test_tables_of_rods_have_orientations(discharge):
    packing, rows, _ = discharge
    for probe in PROBES:
        assert set(rows[probe]) == set(columns(probe, rods=True))
    for table in (rows[SAMPLE], rows[CROSSING]):
        q = np.stack([table[name] for name in ("qw", "qx", "qy", "qz")], axis=1)
        assert len(q) > 3
        assert np.abs(np.linalg.norm(q, axis=1) - 1).max() < 1e-6
    last = rows[SAMPLE]["step"] == rows[SAMPLE]["step"].max()
    q = np.stack([rows[SAMPLE][name][last] for name in ("qw", "qx", "qy", "qz")], axis=1)
    assert axes(q) == pytest.approx(axes(np.asarray(packing.q)), abs=1e-6)


def test_a_zone_has_the_orientations_of_the_sample(discharge):
    _, rows, _ = discharge
    sample, zone = rows[SAMPLE], rows[ZONE]
    inside = ZONE.holds(np.column_stack([sample[axis] for axis in "xyz"]))
    assert 0 < inside.sum() < len(inside)
    for name in ("step", "id", "x", "z", "qw", "qx", "qy", "qz"):
        assert np.array_equal(zone[name], sample[name][inside])


def test_traction_adds_up_the_contacts_with_walls(rods, discharge):
    """Forces are rounded to 2^-24 of a rod's weight in each contact; kernels in single agree to their precision."""
    _, rows, _ = discharge
    contacts, sums = rows[CONTACTS], rows[TRACTION]
    walls = contacts["wall"] >= 0
    rounding = 1e-12 if rods.precision == "double" else 1e-5
    unit = silo(rods).grains.mass * silo(rods).gravity * 2.0**-24
    for wall in range(2):
        mine, row = walls & (contacts["wall"] == wall), sums["wall"] == wall
        assert sums["contacts"][row].sum() == mine.sum() > 100
        for name in ("fx", "fy", "fz"):
            allowed = mine.sum() * unit + rounding * np.abs(contacts[name][mine]).sum()
            assert sums[name][row].sum() == pytest.approx(contacts[name][mine].sum(), abs=allowed)
    bottom = sums["wall"] == 1
    assert sums["normal"][bottom].sum() > 0.9 * sums["fz"][bottom].sum(), "but for the rim, normals are upright"


def test_a_crossing_that_saw_no_rod_has_the_columns_too(rods, bed):
    _, rows, _ = run(rods, silo(rods), bed, (1,))
    assert len(rows[CROSSING]["id"]) == 0
    assert set(rows[CROSSING]) == set(columns(CROSSING, rods=True))


def test_bits_depend_on_neither_splits_nor_neighbours(rods, bed, discharge):
    assert identical(run(rods, silo(rods), bed, (1,) * 40)[0], discharge[0])
    assert identical(run(rods, silo(rods), bed, (40,), members=3)[0], discharge[0])


def test_a_checkpoint_continues_bit_for_bit(rods, bed, discharge):
    _, before, stored = run(rods, silo(rods), bed, (15,))
    end, after, _ = run(rods, silo(rods), stored, (25,))
    assert identical(end, discharge[0])
    for probe in (SAMPLE, CROSSING, CONTACTS):
        for name, column in discharge[1][probe].items():
            assert np.array_equal(np.concatenate([before[probe][name], after[probe][name]]), column), name


def test_a_packing_holds_all_there_is(rods, bed, discharge):
    """Started again from a packing, rods go where they would have gone, but for the half steps of the leapfrog."""
    middle, _, _ = run(rods, silo(rods), bed, (15,))
    again, _, _ = run(rods, silo(rods), middle, (1,))
    straight, _, _ = run(rods, silo(rods), bed, (16,))
    assert np.array_equal(np.asarray(again.ids), np.asarray(straight.ids))
    # a beat is 2 ms; grains fall 20 um in it from rest, and move by some 1 mm
    assert np.abs(again.x - straight.x).max() < 2e-5
    assert middle.wall_part.max() > 0
    assert len(middle.pairs) > 20


def test_a_resting_bed_s_walls_carry_its_weight(rods):
    closed, beats = silo(rods).close(), round(RESTING * rods.part)
    start, rod = place(closed, "gas", 2), closed.grains
    seldom = contacts, ledger = Contacts(every=beats), Ledger(every=beats)
    end, rows, _ = run(rods, closed, start, (beats,), seldom)
    contacts, ledger = rows[contacts], rows[ledger]
    weight = rod.count * rod.mass * closed.gravity
    assert ledger["kinetic"][-1] < 1e-7 * weight * rod.diameter
    walls = contacts["wall"] >= 0
    assert contacts["fz"][walls].sum() == pytest.approx(weight, rel=1e-4)
    assert np.abs([contacts[name][walls].sum() for name in ("fx", "fy")]).max() < 1e-4 * weight
    rest = rods.backend.tractions(closed, numerics(rods), end, TRACTION)
    assert rest is not None
    assert rest["contacts"].sum() == walls.sum()
    assert rest["fz"].sum() == pytest.approx(weight, rel=1e-4)
    at = list(zip(contacts["i"][walls].tolist(), contacts["wall"][walls].tolist(), strict=True))
    assert len(at) > len(set(at)), "some rods lie on the bottom with both ends"


def test_energy_is_accounted_for(rods, bed):
    _, rows, _ = run(rods, silo(rods).close(), bed, (1,) * 20, (LEDGER,))
    table = rows[LEDGER]
    balance = table["kinetic"] + table["potential"] - table["contact_work"]
    # closed to second order in the step, and in `mixed` to the rounding of forces
    limit = 1e-7 if rods.precision == "double" else 1e-5
    assert np.ptp(balance) < limit * np.abs(table["contact_work"]).max()


def test_spheres_have_no_orientation_to_sample(rods):
    with pytest.raises(Unsupported, match="orientation"):
        rods.backend.specialise(hopper(), numerics(rods), [SAMPLE])


def test_rods_cannot_start_from_a_packing_of_spheres(rods, bed):
    spheres = Packing(x=bed.x, v=bed.v, omega=bed.omega)
    with pytest.raises(ValueError, match="without orientations"):
        run(rods, silo(rods), spheres, (1,))


def test_a_turning_rod_is_as_fast_as_its_ends(rods):
    """|v| + h |omega x axis|, h half the distance of its two centres; the guard on speeds sees the same."""
    free = rods_alone(1, Primitives())
    spin, v = 100.0, 0.2
    start = rods_at([[0.0, 0.0, 0.0]], [[1.0, 0.0, 0.0, 0.0]], [[v, 0.0, 0.0]], [[0.0, spin, 0.0]])
    assert start.q is not None
    along = np.linalg.norm(np.cross([0.0, spin, 0.0], axes(start.q)[0]))
    fastest = v + free.grains.overhang * along
    assert fastest > 2 * v
    for limit, stopped in ((1.001 * fastest, False), (0.999 * fastest, True)):
        how = rods.numerics(DT, steps_per_beat=20, speed_limit=limit)
        ensemble = rods.backend.open(rods.backend.specialise(free, how, ()), 1, rods.device)
        try:
            member = ensemble.admit(free, how, start)
            failures = [event for event in ensemble.advance(1) if isinstance(event, Failed)]
            assert [event.guard for event in failures] == ["speed"] * stopped
            if not stopped:
                assert ensemble.status(member).fastest == pytest.approx(fastest, rel=1e-5)
        finally:
            ensemble.close()
