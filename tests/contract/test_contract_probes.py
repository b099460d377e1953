"""Probes see what is there, once, and never change it."""

import math

import numpy as np
import pytest
from platforms import identical, specialised

from labbook.backend.probes import (
    SLIDING,
    TRACTION_SUMS,
    Above,
    Contacts,
    Crossing,
    Dissipation,
    Ledger,
    Sample,
    Slab,
    Traction,
    Zone,
)
from labbook.checks.verify.platform import MemberStart, grains_at, rows_of
from labbook.checks.verify.symmetry import DT, difference, hopper
from labbook.scene import Primitives, Spheres
from labbook.scene.wall_bins import bins_of_walls

BEATS = 12
SAMPLE, CONTACTS = Sample(fields=("x", "v", "omega")), Contacts()
SLAB = Slab(low=-0.0015, high=0.0015)
ZONE = Zone(radius=0.012, low=-0.002, high=0.006, core=0.006, top=0.03)
TRACTION = Traction(size=0.006)
ABOVE = Above(planes=(0.0, 0.01))
EVERYTHING = (Crossing(), Ledger(), SAMPLE, SLAB, ZONE, CONTACTS, TRACTION, ABOVE, Dissipation())


def test_declaring_and_reading_them_changes_no_bit(silo):
    """Of the kernels that users' runs have: those of the platforms have all probes in, declared or not."""
    states = []
    for probes in ((), EVERYTHING):
        with silo.ensemble(probes=probes, platform=specialised(silo.platform)) as ensemble:
            member = silo.admit(ensemble)
            for _ in range(BEATS):
                ensemble.advance(1)
                ensemble.drain()
            states.append(ensemble.packing(member))
    assert len(states[0]) < len(silo.start)
    assert identical(*states)


def test_drained_rows_come_once_and_none_is_lost(silo):
    _, whole = silo.discharge(BEATS)
    with silo.ensemble() as ensemble:
        member = silo.admit(ensemble)
        parts = []
        for _ in range(BEATS):
            ensemble.advance(1)
            parts.append(ensemble.drain())
        assert not any(len(table["step"]) for table in ensemble.drain().values())
    for probe, table in whole.items():
        found = [rows_of(part[probe], member) for part in parts]
        assert identical({name: np.concatenate([f[name] for f in found]) for name in table}, table)


def test_a_member_is_read_by_its_own_probes_only(silo):
    """Beside one that is read by all: its rows and its grains are those that it has alone."""
    _, alone = silo.discharge(BEATS)
    with silo.ensemble(probes=EVERYTHING) as ensemble:
        few = silo.admit(ensemble, probes=(Crossing(), Ledger()))
        all_of_them = silo.admit(ensemble)
        ensemble.advance(BEATS)
        tables = ensemble.drain()
        assert identical(ensemble.packing(few), ensemble.packing(all_of_them))
    for probe, table in tables.items():
        assert len(rows_of(table, all_of_them)["step"])
        if isinstance(probe, Crossing | Ledger):
            assert identical(rows_of(table, few), alone[probe])
        else:
            assert not len(rows_of(table, few)["step"])


@pytest.mark.parametrize(
    ("probes", "why"), [((), "kernels are compiled"), ((Crossing(), Ledger(), Sample(every=7)), "Spec lacks")]
)
def test_a_member_that_cannot_be_read_so_is_refused(silo, probes, why):
    with silo.ensemble() as ensemble, pytest.raises(ValueError, match=why):
        silo.admit(ensemble, probes=probes)


COLUMNS = {
    "Crossing": "id time x y z vx vy vz wx wy wz",
    "Sample": "id x y z vx vy vz wx wy wz",
    "Slab": "id x y z vx vy vz",
    "Zone": "id x y z vx vy vz",
    "Contacts": "i j wall fx fy fz bx by bz",
    "Dissipation": "normal_power tangential_power wall_power elastic",
    "Traction": f"wall bin {' '.join(TRACTION_SUMS)}",
    "Above": "plane grains mass",
    "Ledger": "grains kinetic potential contact_work mass max_overlap touching rebuilds px py pz lx ly lz",
}


def test_tables_have_the_columns_of_the_contract(silo):
    with silo.ensemble(probes=EVERYTHING) as ensemble:
        silo.admit(ensemble)
        ensemble.advance(BEATS)
        tables = ensemble.drain()
    assert set(tables) == set(EVERYTHING)
    for probe, table in tables.items():
        assert set(table) == {"member", "step", "time", *COLUMNS[type(probe).__name__].split()}
        assert len({len(column) for column in table.values()}) == 1
        for name, column in table.items():
            whole = name in ("member", "step", "id", "i", "j", "wall", "bin", "contacts", "sliding", "plane", "grains")
            assert not whole or np.issubdtype(column.dtype, np.integer), name


def test_a_probe_that_saw_nothing_gives_an_empty_table_like_its_others(silo):
    slab = Slab(low=-0.0015, high=0.0015, every=5)
    seldom = (Crossing(), Ledger(every=5), Sample(fields=("x", "v", "omega"), every=5), slab, Contacts(every=5))
    with silo.ensemble(probes=seldom) as ensemble:
        assert set(ensemble.drain()) == set(seldom), "also before the first beat"
        scene, start = falling(silo, np.array([0.1]), np.array([0.0]))
    with silo.ensemble(scene=scene, probes=seldom) as ensemble:
        ensemble.admit(scene, silo.numerics(), start)
        ensemble.advance(1)
        nothing = ensemble.drain()
    with silo.ensemble(probes=seldom) as ensemble:
        silo.admit(ensemble)
        ensemble.advance(10)
        rows = ensemble.drain()
    for probe in seldom:
        assert set(nothing[probe]) == {"member", "step", "time", *COLUMNS[type(probe).__name__].split()}
        assert {name: (column.dtype, len(column)) for name, column in nothing[probe].items()} == {
            name: (column.dtype, 0) for name, column in rows[probe].items()
        }
        assert len(rows[probe]["step"])


def test_they_are_read_on_their_beats(silo):
    probes = (Ledger(every=3), Sample(fields=("x",), every=2), Zone(1.0, -1.0, 1.0, 1.0, 1.0, every=5, again=1))
    with silo.ensemble(probes=(*probes, Crossing())) as ensemble:
        silo.admit(ensemble)
        ensemble.advance(7)
        tables = ensemble.drain()
    for probe, beats in zip(probes, ([3, 6], [2, 4, 6], [1, 5, 6]), strict=True):
        steps = np.array(beats) * silo.numerics().steps_per_beat
        assert np.array_equal(np.unique(tables[probe]["step"]), steps)
        assert np.allclose(np.unique(tables[probe]["time"]), steps * DT, rtol=1e-12)
    assert set(tables[probes[1]]) == {"member", "step", "time", "id", "x", "y", "z"}


def test_sample_and_ledger_agree_with_the_packing(silo):
    with silo.ensemble(probes=EVERYTHING) as ensemble:
        member = silo.admit(ensemble)
        ensemble.advance(BEATS)
        packing, tables = ensemble.packing(member), ensemble.drain()
        status = ensemble.status(member)
    grains, last = silo.scene.grains, BEATS * silo.numerics().steps_per_beat
    sample = {name: c[tables[SAMPLE]["step"] == last] for name, c in tables[SAMPLE].items()}
    assert np.array_equal(sample["id"], packing.ids)
    for prefix, array in (("", packing.x), ("v", packing.v), ("w", packing.omega)):
        assert np.array_equal(np.column_stack([sample[prefix + axis] for axis in "xyz"]), array)
    row = {name: column[-1] for name, column in tables[silo.ledger].items()}
    n, m = len(packing), grains.mass
    kinetic = 0.5 * m * np.sum(packing.v**2) + 0.5 * grains.inertia * np.sum(packing.omega**2)
    spin = m * np.cross(packing.x, packing.v).sum(axis=0) + grains.inertia * packing.omega.sum(axis=0)
    assert row["grains"] == n == status.grains
    assert row["mass"] == pytest.approx(n * m, rel=1e-13)
    assert row["kinetic"] == pytest.approx(kinetic, rel=1e-12)
    assert status.kinetic == pytest.approx(kinetic / (n * m * silo.scene.gravity * grains.diameter), rel=1e-12)
    assert row["potential"] == pytest.approx(m * silo.scene.gravity * packing.x[:, 2].sum(), rel=1e-12)
    assert [row[p] for p in ("px", "py", "pz")] == pytest.approx(list(m * packing.v.sum(axis=0)), rel=1e-10)
    assert [row[l] for l in ("lx", "ly", "lz")] == pytest.approx(list(spin), rel=1e-10)


def test_a_slab_has_the_rows_of_the_sample_between_its_heights(silo):
    with silo.ensemble(probes=EVERYTHING) as ensemble:
        silo.admit(ensemble)
        ensemble.advance(BEATS)
        tables = ensemble.drain()
    sample, slab = tables[SAMPLE], tables[SLAB]
    inside = abs(sample["z"]) <= SLAB.high
    assert 0 < inside.sum() < len(inside) / 4
    for name, column in slab.items():
        assert np.array_equal(column, sample[name][inside])


def test_a_zone_has_the_rows_of_the_sample_around_and_above_the_outlet(silo):
    with silo.ensemble(probes=EVERYTHING) as ensemble:
        silo.admit(ensemble)
        ensemble.advance(BEATS)
        tables = ensemble.drain()
    sample, zone = tables[SAMPLE], tables[ZONE]
    off, z = np.hypot(sample["x"], sample["y"]), sample["z"]
    around, above = (off <= 0.012) & (z >= -0.002) & (z <= 0.006), (off <= 0.006) & (z > 0.006) & (z <= 0.03)
    assert around.any()
    assert above.any()
    assert (around | above).sum() < len(z) / 2
    for name, column in zone.items():
        assert np.array_equal(column, sample[name][around | above])


def test_the_mass_above_a_plane_is_that_of_the_grains_of_the_sample_there(silo):
    with silo.ensemble(probes=EVERYTHING) as ensemble:
        silo.admit(ensemble)
        ensemble.advance(BEATS)
        tables = ensemble.drain()
    sample, above = tables[SAMPLE], tables[ABOVE]
    for place, plane in enumerate(ABOVE.planes):
        mine = above["plane"] == place
        steps, grains = above["step"][mine], above["grains"][mine]
        assert len(steps) == BEATS
        assert list(grains) == [int((sample["z"][sample["step"] == step] > plane).sum()) for step in steps]
        assert 0 < grains[-1] < grains[0]
        assert np.allclose(above["mass"][mine], grains * silo.scene.grains.mass, rtol=1e-14)


def test_touching_and_overlap_of_the_ledger_are_those_of_the_contacts(silo):
    """The ledger counts at the step whose forces were last computed: the one before."""
    numerics = silo.numerics(steps_per_beat=1)
    with silo.ensemble(numerics=numerics, probes=EVERYTHING) as ensemble:
        ensemble.admit(silo.scene, numerics, silo.start)
        ensemble.advance(40)
        tables = ensemble.drain()
    contacts, ledger = tables[CONTACTS], tables[silo.ledger]
    branch = np.sqrt(contacts["bx"] ** 2 + contacts["by"] ** 2 + contacts["bz"] ** 2)
    d = silo.scene.grains.diameter
    overlap = np.where(contacts["wall"] < 0, d, d / 2) - branch
    steps = ledger["step"][:-1]
    assert [np.sum(contacts["step"] == s) for s in steps] == list(ledger["touching"][1:])
    deepest = [overlap[contacts["step"] == s].max() for s in steps]
    assert np.allclose(deepest, ledger["max_overlap"][1:], rtol=max(1e-9, 8 * silo.rounding), atol=1e-12 * d)


def test_contact_forces_add_up_to_accelerations(silo):
    """x_{n+1} - 2 x_n + x_{n-1} = dt^2 (sum of contact forces / m + g), in any leapfrog or Verlet scheme."""
    numerics = silo.numerics(steps_per_beat=1)
    with silo.ensemble(numerics=numerics, probes=EVERYTHING) as ensemble:
        ensemble.admit(silo.scene, numerics, silo.start)
        ensemble.advance(6)
        tables = ensemble.drain()
    sample, contacts, n = tables[SAMPLE], tables[CONTACTS], len(silo.start)
    x = np.stack([sample[axis].reshape(6, n) for axis in "xyz"], axis=-1)
    found = (x[2:] - 2 * x[1:-1] + x[:-2]) / DT**2
    expected = np.zeros((4, n, 3))
    expected[..., 2] = -silo.scene.gravity
    mass = silo.scene.grains.mass
    for row in range(4):
        now = contacts["step"] == row + 2
        force = np.column_stack([contacts["f" + axis][now] for axis in "xyz"]) / mass
        pair = contacts["j"][now] >= 0
        np.add.at(expected[row], contacts["i"][now], force)
        np.add.at(expected[row], contacts["j"][now][pair], -force[pair])
    assert np.abs(expected).max() > 5 * silo.scene.gravity
    # second differences of positions lose ten digits, and velocities are rounded at each step
    fastest = np.abs(np.diff(x, axis=0)).max() / DT
    lost = 20 * np.spacing(np.abs(x).max()) / DT**2 + 2 * silo.rounding * fastest / DT
    assert np.abs(found - expected).max() < max(1e-8, 16 * silo.rounding) * np.abs(expected).max() + lost


def test_springs_survive_rebuilds(silo):
    """With a thin skin lists are rebuilt many times as often; if that lost springs, grains would slide apart."""
    states, rebuilds = [], []
    for skin in (0.02, 0.5):
        numerics = silo.numerics(skin=skin)
        with silo.ensemble(numerics=numerics) as ensemble:
            member = ensemble.admit(silo.scene, numerics, silo.start)
            ensemble.advance(4)
            states.append(ensemble.packing(member))
            rebuilds.append(ensemble.drain()[silo.ledger]["rebuilds"][-1])
    assert rebuilds[0] > 10 * rebuilds[1] or not silo.platform.lists
    assert len(states[0].pair_spring) > 20
    assert difference(*states) < 1e-9


# crossings


def test_every_grain_crosses_once_and_the_bookkeeping_agrees(silo):
    beats = 80
    with silo.ensemble() as ensemble:
        member = silo.admit(ensemble)
        ensemble.advance(beats)
        rows, left = ensemble.drain()[silo.crossing], ensemble.packing(member)
    assert len(set(rows["id"])) == len(rows["id"]) > 0.8 * len(silo.start)
    assert left.ids is not None
    still_above = left.ids[left.x[:, 2] >= 0]
    assert set(rows["id"]) == set(range(len(silo.start))) - set(still_above)
    assert np.all((rows["step"] - 1) * DT <= rows["time"])
    assert np.all(rows["time"] <= rows["step"] * DT)
    assert np.all(rows["z"] < 0)
    assert np.all(rows["z"] >= rows["vz"] * DT * (1 + 1e-6))
    assert np.all(np.diff(rows["step"]) >= 0)


VAST = hopper(300.0).container
"""Its outlet reaches from x = -3.6 to 2.2 m; its kinds of walls are those of all these tests, which share kernels."""


def falling(silo, heights, speeds):
    """Grains that fall freely, far apart, through an outlet whose walls are beyond their reach."""
    grains = Spheres(diameter=3e-3, density=2500, count=len(heights))
    scene = silo.scene.model_copy(update={"grains": grains, "container": VAST})
    x = np.column_stack([0.1 * np.arange(len(heights)), np.zeros(len(heights)), heights])
    v = np.column_stack([np.zeros((len(heights), 2)), speeds])
    return scene, grains_at(x, v)


def test_times_of_crossings_are_interpolated(silo):
    heights, speeds = np.linspace(0.01, 0.05, 9), np.linspace(0.5, -0.5, 9)
    scene, start = falling(silo, heights, speeds)
    motion = silo.platform.run(MemberStart(scene, DT, start), 10, 1000, [silo.crossing])
    rows = motion.rows(silo.crossing)
    assert sorted(rows["id"]) == list(range(9))
    expected = (speeds + np.sqrt(speeds**2 + 2 * scene.gravity * heights)) / scene.gravity
    assert np.abs(rows["time"] - expected[rows["id"]]).max() < 0.02 * DT
    assert np.abs(rows["vz"] + np.sqrt(speeds**2 + 2 * scene.gravity * heights)[rows["id"]]).max() < 10 * DT


def test_a_grain_that_starts_below_does_not_cross(silo):
    scene, start = falling(silo, np.array([-1e-3, 1e-3]), np.array([0.3, 0.0]))
    rows = silo.platform.run(MemberStart(scene, DT, start), 5, 1000, [silo.crossing]).rows(silo.crossing)
    assert list(rows["id"]) == [1]


def test_grains_fall_on_below_the_outlet_as_far_as_the_sink(silo):
    """Two lengths below the sink they are dropped, in the next beat at the latest; the outlet counts them as ever."""
    scene, start = falling(silo, np.array([0.01]), np.array([0.0]))
    deep = scene.model_copy(update={"container": VAST.model_copy(update={"sink": -0.06})})
    crossed, low = [], []
    for one in (scene, deep):
        motion = silo.platform.run(MemberStart(one, DT, start), 20, 250, [silo.crossing, SAMPLE])
        crossed.append(motion.rows(silo.crossing))
        low.append(motion.rows(SAMPLE)["z"].min())
    assert identical(*crossed)
    beat, size = 250 * DT * math.sqrt(2 * scene.gravity * 0.08), 2 * scene.grains.diameter
    for end, lowest in zip((0.0, -0.06), low, strict=True):
        assert end - size - beat < lowest < end - size + beat, "the way within a beat"


def test_only_the_first_passage_counts(silo):
    """A grain thrown up again from below the plane would pass it twice."""
    bottom = Primitives(parts=VAST.close().walls(), outlet_plane=-1.0)
    contact = silo.scene.contact.model_copy(update={"restitution": 1.0, "shear_modulus": 1e7})
    grains = Spheres(diameter=3e-3, density=2500, count=1)
    scene = silo.scene.model_copy(update={"grains": grains, "contact": contact, "container": bottom})
    passing, sample = Crossing(plane=0.05), Sample()
    motion = silo.platform.run(MemberStart(scene, DT / 4, grains_at([0, 0, 0.07])), 100, 1000, [passing, sample])
    above = motion.by_beat(sample, ("z",))[:, 0, 0] - passing.plane
    assert np.sum((above[1:] < 0) & (above[:-1] >= 0)) > 2
    rows = motion.rows(passing)
    assert len(rows["time"]) == 1
    assert rows["time"][0] == pytest.approx(math.sqrt(2 * 0.02 / scene.gravity), abs=0.02 * DT)


def test_traction_adds_up_the_contacts_with_walls(silo):
    """Against rows of contacts with positions. Sums are rounded to 2^-24 of a grain's weight in each contact; forces
    and normals of a backend in single precision to its precision."""
    with silo.ensemble(probes=EVERYTHING) as ensemble:
        silo.admit(ensemble)
        ensemble.advance(BEATS)
        tables = ensemble.drain()
    scene, step = silo.scene, BEATS * silo.numerics().steps_per_beat
    contacts, sample, sums = (
        {name: column[tables[probe]["step"] == step] for name, column in tables[probe].items()}
        for probe in (CONTACTS, SAMPLE, TRACTION)
    )
    at_wall = contacts["wall"] >= 0
    force, branch = (np.column_stack([contacts[f"{of}{axis}"][at_wall] for axis in "xyz"]) for of in "fb")
    x = np.column_stack([sample[axis] for axis in "xyz"])
    point = x[np.searchsorted(sample["id"], contacts["i"][at_wall])] + branch
    normal = -branch / np.linalg.norm(branch, axis=1)[:, None]
    pressed = np.sum(force * normal, axis=1)
    up = np.array([0.0, 0.0, 1.0]) - normal * normal[:, 2:]
    up /= np.linalg.norm(up, axis=1)[:, None]
    local = pressed, np.sum(force * up, axis=1), np.sum(force * np.cross(normal, up), axis=1)
    expected = [*force.T, *np.cross(point, force).T, *local, *(point.T * pressed)]
    wall = contacts["wall"][at_wall]
    unit = scene.grains.mass * scene.gravity * (2.0**-24 + 4 * silo.rounding)
    assert sums["contacts"].sum() == len(wall) > 10
    for w, bins in enumerate(bins_of_walls(scene, scene.container.walls(), TRACTION.size)):
        assert bins.along == "height"
        place = np.floor((point[:, 2] - bins.low) / bins.size).astype(int).clip(0, bins.count - 1)
        for k in range(bins.count):
            mine, row = (wall == w) & (place == k), (sums["wall"] == w) & (sums["bin"] == k)
            assert sums["contacts"][row].sum() == mine.sum()
            allowed = (1 + mine.sum()) * unit + 16 * silo.rounding * np.abs(force[mine]).sum()
            for name, values in zip(TRACTION_SUMS[2:], expected, strict=True):
                lever = 1.0 if name[0] in "fna" else max(scene.grains.diameter, np.abs(point).max())
                assert sums[name][row].sum() == pytest.approx(values[mine].sum(), abs=allowed * lever), name
    tangential = np.sqrt(np.maximum(np.sum(force**2, axis=1) - pressed**2, 0))
    share = tangential / (scene.contact.friction * pressed)
    clear = np.abs(share - SLIDING) > 1e-4
    assert abs(sums["sliding"].sum() - np.sum(share > SLIDING)) <= np.sum(~clear)
