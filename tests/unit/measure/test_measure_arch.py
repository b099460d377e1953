"""The arch of beds made by hand: a half circle of grains over the slot, with others that press more or less."""

import math

import numpy as np
import pytest

from labbook.backend.numerics import Numerics
from labbook.measure import MEASURES, MeasureError, RunData
from labbook.measure.arch import EVERY, NEAR, REST, StoppedBed, arch, neighbours, planes_of
from labbook.measure.measure import Quantity
from labbook.scene import Box, CylinderSilo, Feed, HertzMindlin, Restart, Scene, Spheres, WedgeHopper
from labbook.scene.container import Container
from labbook.scene.packing import Packing
from labbook.scene.timescales import WAIT, gravity_time
from labbook.study.schema import Window

D = 3e-3
MEASURE = MEASURES["arch"]
HOPPER = WedgeHopper(width=0.06, height=0.2, thickness=1.01 * D, orifice=4 * D)
WEIGHT = 2500 * math.pi / 6 * D**3 * 9.81


def scene_of(container: Container = HOPPER):
    law = HertzMindlin(shear_modulus=1e7, poisson_ratio=0.25)
    scene = Scene(grains=Spheres(diameter=D, density=2500, count=20), contact=law, container=container)
    return scene.model_copy(update={"feed": Feed(kind="reinject"), "restart": Restart(kind="break")})


def half_circle(links=10.0, roof=2.0):
    """Seven grains from floor to floor, each a diameter from the next, and a flat row above them that presses with the
    force `roof`; ids count from 10 in no order."""
    step = math.pi / 6
    radius = D / 2 / math.sin(step / 2)
    angles = math.pi - step * np.arange(7)
    chain = np.column_stack([radius * np.cos(angles), np.zeros(7), D / 2 + radius * np.sin(angles)])
    above = np.column_stack([np.linspace(-2.5 * D, 2.5 * D, 6), np.zeros(6), np.full(6, chain[:, 2].max() + 0.9 * D)])
    x = np.concatenate([chain, above])
    ids = 10 + np.random.default_rng(1).permutation(len(x))
    i, j = [*range(6), *range(7, 12), 0, 6], [*range(1, 7), *range(8, 13), 7, 12]
    force = np.array([links] * 6 + [roof] * 5 + [0.1, 0.1]) * WEIGHT
    rows = {"i": [*ids[i], ids[0], ids[6], ids[3]], "j": [*ids[j], -1, -1, -1]}
    walls, zero = np.full(3, 5.0 * WEIGHT), np.zeros(len(i) + 3)
    rows |= {"fx": np.concatenate([force, walls]), "fy": zero, "fz": zero, "bx": zero}
    rows |= {"by": np.array([0.0] * (len(i) + 2) + [D / 2]), "bz": zero}  # the last is the front wall
    return ids, x, {name: np.asarray(column) for name, column in rows.items()}


def test_the_chain_over_the_outlet_is_found_from_left_to_right():
    ids, x, contacts = half_circle()
    rows, link = arch(ids, x, contacts, HOPPER.outlets[0], D, WEIGHT)
    assert rows.tolist() == list(range(7))
    assert link == pytest.approx(np.full(6, 10.0))


def test_a_chain_that_carries_nothing_is_not_the_arch():
    """With weak links the row above is cheaper, though it is longer: 6 links of 1 + 2 / 0.31 are 45."""
    ids, x, contacts = half_circle(links=0.01, roof=50.0)
    rows, _ = arch(ids, x, contacts, HOPPER.outlets[0], D, WEIGHT)
    assert rows.tolist() == [0, *range(7, 13), 6]


def test_grains_that_do_not_span_the_outlet_are_no_arch():
    ids, x, contacts = half_circle()
    broken = {name: np.delete(column, [2, 8]) for name, column in contacts.items()}
    rows, link = arch(ids, x, broken, HOPPER.outlets[0], D, WEIGHT)
    assert (len(rows), len(link)) == (0, 0)


def test_each_stop_has_its_arch_from_the_last_frame_at_rest():
    """Two stops: one restarted, one that ends the run; a frame at a time of flow does not count."""
    ids, x, contacts = half_circle()
    scene = scene_of()
    unit = gravity_time(scene)
    times = np.array([1.0, 2.0]) + 18 * unit
    frames = np.array([0.9, *times])
    n, m = len(ids), len(contacts["i"])
    strength = np.repeat([1.0, 1.0, 2.0], m)
    table = {name: np.tile(column, 3) * (strength if name.startswith("f") else 1) for name, column in contacts.items()}
    table |= {"step": np.repeat([1, 2, 3], m), "time": np.repeat(frames, m)}
    sample = {"id": np.tile(ids, 3), "step": np.repeat([1, 2, 3], n), "time": np.repeat(frames, n)}
    sample |= {axis: np.tile(x[:, k], 3) for k, axis in enumerate("xyz")}
    crossing = {"id": np.array([1, 2]), "time": np.array([1.0, 2.0]), "vz": np.array([-0.3, -0.3])}
    restart = {"stopped": np.array([1.0]), "time": np.array([1.0 + WAIT * unit])}
    start = Packing(*np.zeros((3, 20, 3)))
    tables = {"crossing": crossing, "sample": sample, "contacts": table, "restart": restart}
    run = RunData(scene, Numerics(dt=1e-5), 1, start, "clogged", 2.0 + 40 * unit, tables)
    evaluation = MEASURE.evaluate(run, Window().endless())
    size, force = evaluation.numbers
    assert (size.value, size.n_effective, size.error) == (7, 2, 0)
    assert force.value == pytest.approx(15.0), "10 and 20 weights"
    bed = StoppedBed.of(evaluation.arrays)
    assert bed is not None
    assert bed.ids[bed.rows].tolist() == ids[:7].tolist()
    assert bed.x[bed.rows] == pytest.approx(x[:7])
    assert bed.link == pytest.approx(np.full(6, 20.0)), "of the last stop"
    strong = {frozenset(pair) for pair in bed.ids[bed.pairs[bed.force > 15]].tolist()}
    assert strong == {frozenset(pair) for pair in zip(ids[:6].tolist(), ids[1:7].tolist(), strict=True)}
    censored = RunData(scene, Numerics(dt=1e-5), 1, start, "time-limit", 2.0 + 40 * unit, tables)
    assert MEASURE.evaluate(censored, Window().endless()).numbers[0].n_effective == 1
    assert REST + EVERY < WAIT, "else a stop may have no frame"


def test_near_the_outlet_a_bed_keeps_its_arch_and_the_contacts_between_its_grains():
    ids, x, _ = half_circle()
    far = x.copy()
    far[8, 2] = 1.0
    pairs = np.array([[0, 1], [7, 8], [8, 9], [9, 10]])
    whole = StoppedBed(ids, far, pairs, np.arange(4.0), np.arange(7), np.full(6, 10.0), neighbours(np.arange(7)))
    near = whole.near(scene_of())
    assert set(ids) - set(near.ids) == {ids[8]}, f"it is higher than {NEAR:g} d above the arch"
    assert near.ids[near.pairs].tolist() == ids[[[0, 1], [9, 10]]].tolist()
    assert near.force.tolist() == [0, 3]
    assert near.ids[near.rows].tolist() == ids[:7].tolist()


HOLE = CylinderSilo(diameter=0.05, height=0.4, orifice=2.5 * D)


def dome():
    """Four meridians of three grains and the grain at the top, of which two opposite meridians press with 10 and two
    with 20 weights; on the bottom a ring of eight grains around the hole, four of them the feet of the meridians, that
    press each other with 50; and a grain above the top. All grains on the bottom touch it; others touch the side."""
    step = math.pi / 6
    radius, azimuth = D / 2 / math.sin(step / 2), math.pi / 2 * np.arange(4)
    rows = []
    for k in range(3):  # from the bottom upwards
        rho, z = radius * math.cos(k * step), D / 2 + radius * math.sin(k * step)
        rows += [(rho * math.cos(a), rho * math.sin(a), z) for a in azimuth]
    top = D / 2 + radius
    rows += [(0.0, 0.0, top), (0.0, 0.0, top + D)]
    rows += [(radius * math.cos(a), radius * math.sin(a), D / 2) for a in azimuth + math.pi / 4]
    i, j, force = [], [], []
    for a in range(4):
        press = 10.0 if a % 2 == 0 else 20.0
        for one, other in ((a, 4 + a), (4 + a, 8 + a), (8 + a, 12)):
            i, j, force = [*i, one], [*j, other], [*force, press]
        for other in (14 + a, 14 + (a - 1) % 4):
            i, j, force = [*i, a], [*j, other], [*force, 50.0]
    i, j, force = [*i, 12], [*j, 13], [*force, 1.0]
    on_bottom, beside = [*range(4), *range(14, 18)], [4, 13]
    walls = len(on_bottom) + len(beside)
    contacts = {"i": [*i, *on_bottom, *beside], "j": [*j, *[-1] * walls]}
    contacts |= {"fx": [*force, *[5.0] * walls], "bz": [*[0.0] * len(i), *[-D / 2] * len(on_bottom), 0.0, 0.0]}
    contacts |= dict.fromkeys(("fy", "fz", "bx", "by"), [0.0] * (len(i) + walls))
    table = {name: np.asarray(column) for name, column in contacts.items()}
    table["fx"] = table["fx"] * WEIGHT
    return np.array(rows), table


def test_a_dome_is_the_union_of_chains_through_the_axis():
    """Neither the ring round the hole nor what lies on the dome is a part of it, and no chain ends at the side."""
    x, contacts = dome()
    ids = np.arange(len(x))
    scene = scene_of(HOLE)
    assert [plane.along for plane in planes_of(scene)][2] == pytest.approx((0, 1)), "four planes, 45 degrees apart"
    frame = {"step": 1, "time": 2.0}
    sample = {"id": ids, **{axis: x[:, k] for k, axis in enumerate("xyz")}}
    tables = {"sample": sample, "contacts": contacts}
    tables = {name: {**rows, **{key: np.full(len(next(iter(rows.values()))), value) for key, value in frame.items()}}
              for name, rows in tables.items()}  # fmt: skip
    tables["crossing"] = {"id": np.array([1]), "time": np.array([1.0]), "vz": np.array([-0.3])}
    run = RunData(scene, Numerics(dt=1e-5), 1, Packing(*np.zeros((3, 20, 3))), "clogged", 2.0, tables)
    evaluation = MEASURE.evaluate(run, Window().endless())
    size, force = evaluation.numbers
    assert size.value == 13
    assert force.value == pytest.approx(15), "six contacts of 10 and six of 20 weights"
    bed = StoppedBed.of(evaluation.arrays)
    assert bed is not None
    assert sorted(bed.ids[bed.rows].tolist()) == list(range(13))
    pairs = {tuple(sorted(pair)) for pair in bed.ids[bed.links].tolist()}
    meridians = [(a + k, 4 + a + k) for a in range(4) for k in (0, 4)] + [(8 + a, 12) for a in range(4)]
    assert pairs == set(meridians)


def test_across_a_deep_slot_arches_stand_beside_each_other():
    """Two arches, 2 d apart, in a hopper 3 d deep: the chains of three planes give both."""
    ids, x, contacts = half_circle()
    n, deep = len(x), WedgeHopper(width=0.06, height=0.2, thickness=3 * D, orifice=4 * D)
    both = np.concatenate([x + np.array([0, y, 0]) for y in (-D, D)])
    planes = planes_of(scene_of(deep))
    assert [plane.centre[1] for plane in planes] == pytest.approx([-D, 0, D])
    ids = np.concatenate([ids, 100 + ids])
    rows = {name: np.concatenate([column, column + 100 * (name in "ij") * (column >= 0)])
            for name, column in contacts.items()}  # fmt: skip
    chains = [arch(ids, both, rows, deep.outlets[0], D, WEIGHT, plane)[0].tolist() for plane in planes]
    assert chains == [list(range(7)), [], list(range(n, n + 7))]


def test_a_plane_beside_periodic_sides_looks_across_them():
    deep = WedgeHopper(width=0.06, height=0.2, thickness=3 * D, orifice=4 * D, periodic="y")
    first = planes_of(scene_of(deep))[0]
    side, off = first.side(np.array([[0.01, 1.4 * D, 0.0], [0.01, -1.4 * D, 0.0]]))
    assert side == pytest.approx([0.01, 0.01])
    assert off == pytest.approx([0.6 * D, 0.4 * D])


def test_beds_of_older_evaluations_of_layers_have_links_along_the_arch():
    ids, x, _ = half_circle()
    bed = StoppedBed(ids, x, np.zeros((0, 2), int), np.zeros(0), np.arange(7), np.ones(6), neighbours(np.arange(7)))
    older = {name: array for name, array in bed.arrays().items() if name != "bed_links"}
    again = StoppedBed.of(older)
    assert again is not None
    assert again.links.tolist() == bed.links.tolist()


def test_other_scenes_are_refused_and_quantities_are_means():
    with pytest.raises(MeasureError, match="one slot or one round outlet"):
        MEASURE.check(scene_of(Box(width=0.05, depth=0.05, height=0.1)))
    MEASURE.check(scene_of(HOLE))
    assert all(isinstance(one, Quantity) and one.estimator == "mean" for one in MEASURE.declared)
