"""Stress on walls: a bed that has come to rest, and frames of known forces."""

import math

import numpy as np
import pytest

pytest.importorskip("numba")

from labbook_numba import Backend

from labbook.backend.numerics import Numerics
from labbook.backend.probes import TRACTION_SUMS, Contacts, Sample, Traction
from labbook.checks.verify.materials import D, G, hertz, scene
from labbook.checks.verify.platform import MemberStart, Platform, grains_at
from labbook.fields import Space, coarse_grain, contacts_of, grains_of
from labbook.filling.placing import place
from labbook.measure import MEASURES, MeasureError, RunData
from labbook.measure.wall_stress import WallStress, WallStresses, bin_width
from labbook.scene import Box, CylinderSilo, Frustum, Primitives, SurfaceChange, Wall
from labbook.scene.feed import Feed
from labbook.scene.stream import Stream
from labbook.scene.wall_bins import all_walls, bins_of_walls, is_upright

SOFT, DT, COUNT = 1e6, 2e-5, 100


CYLINDER = Primitives(
    parts=(
        Wall(name="side", shape=Frustum(lower=(3 * D, 0.0), upper=(3 * D, 0.2))),
        Wall(name="bottom", shape=Frustum(lower=(0.0, 0.0), upper=(3 * D, 0.0))),
    )
)


class Whole:
    """The window of a whole run."""

    start, end, timed = 0.0, 1.0, False


def evaluated(run: RunData) -> tuple[dict[str, float], WallStresses]:
    found = WallStress().evaluate(run, Whole())
    stresses = WallStresses.of(found)
    assert stresses is not None
    declared = {quantity.name for quantity in WallStress().quantities(run.scene)}
    assert {number.quantity for number in found.numbers} <= declared
    return {number.quantity: number.value for number in found.numbers}, stresses


@pytest.fixture(scope="module", params=["box", "smooth box", "cylinder"])
def settled(request):
    """A bed in a closed container, and a run of it: at rest, and twelve frames of it."""
    smooth = {"all": SurfaceChange(friction=0.0)} if request.param == "smooth box" else {}
    container = Box(width=6 * D, depth=4 * D, height=0.2)
    if request.param == "cylinder":
        container = CYLINDER
    here = scene(COUNT, hertz(shear_modulus=SOFT, rolling_friction=0.0, restitution=0.1), container, G, **smooth)
    platform, probe = Platform(Backend(wide=True)), Traction(size=bin_width(here), every=2)
    probes = (probe, Contacts(every=2), Sample(fields=("x", "v"), every=2))
    fallen = platform.run(
        MemberStart(here, DT, place(here, "rain", 1), settled_below=1e-9), 200, 500, probes, until_event=True
    )
    motion = platform.run(MemberStart(here, DT, fallen.end), 48, 100, probes)
    numerics = platform.numerics(DT, steps_per_beat=100)
    rest = platform.backend.tractions(here, numerics, fallen.end, probe)
    assert rest is not None
    table = {name: np.concatenate([rest[name], column]) for name, column in motion.rows(probe).items()}
    run = RunData(here, numerics, 1, fallen.end, "time-limit", 48 * 100 * DT, {"traction": table})
    return request.param, run, motion.rows(probes[1]), motion.rows(probes[2])


@pytest.mark.compiles
def test_walls_carry_the_weight_of_a_bed_at_rest(settled):
    """To 10^-3: the bed keeps some kinetic energy. Walls without friction carry nothing: forces of 6e-8 of a weight in
    each contact are rounding."""
    kind, run, *_ = settled
    numbers, stresses = evaluated(run)
    assert abs(numbers["weight_balance"]) < 1e-3
    assert abs(numbers["weight_balance_flow"]) < 1e-3
    assert sum(value for name, value in numbers.items() if name.startswith("carried.")) == pytest.approx(1, abs=1e-3)
    assert stresses.weight == pytest.approx(COUNT * run.scene.grains.mass * G)
    if kind == "smooth box":
        bottom = stresses.names.tolist().index("bottom")
        assert abs(stresses.flow_force[bottom, 2] / stresses.weight - 1) < 1e-4
        assert np.abs(stresses.rest[stresses.on_upright, 1]).max() < 1e-6 * run.scene.grains.mass * G
        assert numbers["sliding_share"] == 0
    else:
        assert numbers["sliding_share"] > 0
    across = np.abs(stresses.rest[stresses.on_upright, 2].sum())
    assert across < 0.1 * stresses.rest[stresses.on_upright, 0].sum()


@pytest.mark.compiles
def test_bins_add_up_to_the_walls_and_forces_act_where_contacts_are(settled):
    _, run, *_ = settled
    _, stresses = evaluated(run)
    for number, name in enumerate(stresses.names.tolist()):
        local = stresses.rest[stresses.of_wall(name)]
        force = stresses.rest_force[number]
        if not force.any():
            continue
        if stresses.upright[number]:
            assert local[:, 1].sum() == pytest.approx(force[2], abs=1e-9 * stresses.weight)
        else:
            assert local[:, 0].sum() == pytest.approx(force[2], rel=1e-6)
            assert stresses.rest_point[number][2] == pytest.approx(0, abs=1e-6)
    area = stresses.area[stresses.on_upright]
    assert np.isfinite(area).all()
    side = {"box": 2 * (6 + 4) * D, "smooth box": 2 * (6 + 4) * D}.get(settled[0], math.pi * 6 * D)
    assert stresses.section == pytest.approx({False: 24 * D**2, True: math.pi * 9 * D**2}[settled[0] == "cylinder"])
    assert stresses.perimeter == pytest.approx(0.0 if settled[0] == "smooth box" else side)


@pytest.mark.compiles
@pytest.mark.parametrize("settled", ["smooth box"], indirect=True)
def test_the_stress_of_the_bulk_is_that_of_its_walls(settled):
    """The virial of a bed at rest: the sum of f_x b_x over all contacts, those with walls included, is that of f_x x
    over walls. Without friction these are the side walls alone: the mean stress of the bulk is their normal stress."""
    _, run, contacts, _ = settled
    _, stresses = evaluated(run)
    last = contacts["step"] == contacts["step"].max()
    for axis in "xy":
        virial = -np.sum(contacts[f"f{axis}"][last] * contacts[f"b{axis}"][last])
        half = {"x": 3 * D, "y": 2 * D}[axis]
        pair = {"x": ["left", "right"], "y": ["front", "back"]}[axis]
        pressed = sum(stresses.flow[stresses.of_wall(name), 0].sum() for name in pair)
        assert virial == pytest.approx(half * pressed, rel=1e-2)


@pytest.mark.compiles
@pytest.mark.parametrize("settled", ["smooth box"], indirect=True)
def test_the_field_of_the_contact_stress_ends_at_the_stress_of_the_walls(settled):
    """Through each plane x or y = const. that no kernel of a contact with a side wall reaches, the field of the bulk
    presses as that wall is pressed; through each height with the force of the bottom less the weight below. Balance of
    momentum makes this exact but for the sum over cells and for what still moves."""
    _, run, contacts, sample = settled
    _, stresses = evaluated(run)
    omega, h, last = D / 4, D / 6, float(contacts["time"].max())
    grains = grains_of(sample, run.scene.grains.mass, run.scene.grains.volume, last, last)
    top = float(grains.x[:, 2].max()) + 2 * D
    counts = [math.ceil((high - low) / h) for low, high in ((-4 * D, 4 * D), (-3 * D, 3 * D), (-D, top))]
    grid = Space((-4 * D, 4 * D), (-3 * D, 3 * D), (-D, top), *counts)
    fields = coarse_grain(grid, omega, grains, contacts_of(contacts, sample, last, last))
    stress = fields.contact_stress
    assert stress is not None
    z, y, x = grid.points
    cell = [(points[1] - points[0]).item() for points in (x, y, z)]
    for axis, points, wall, half in ((0, x, "left", 3 * D), (1, y, "front", 2 * D)):
        others = tuple(k for k in range(3) if k != 2 - axis)
        area = math.prod(cell) / cell[axis]
        through = stress[axis, axis].sum(axis=others)[np.abs(points) < half - 4 * omega] * area
        assert len(through) > 10
        assert through == pytest.approx(stresses.flow[stresses.of_wall(wall), 0].sum(), rel=0.01)
    vertical, area = stress[2, 2].sum(axis=(1, 2)) * cell[0] * cell[1], cell[0] * cell[1]
    below = (np.cumsum(fields.density.sum(axis=(1, 2))) - fields.density.sum(axis=(1, 2)) / 2) * area * cell[2] * G
    inside = z > 4 * omega
    bottom = stresses.flow_force[stresses.names.tolist().index("bottom"), 2]
    assert vertical[inside] == pytest.approx((bottom - below)[inside], abs=0.005 * stresses.weight)


def test_known_forces_give_known_numbers():
    """Frames made by hand: the side carries 30 % at rest, is pressed twice as hard for a time after the opening, and
    half as hard in the steady part."""
    here = scene(100, hertz(), CYLINDER, G)
    weight = 100 * here.grains.mass * G
    every = all_walls(here.container)
    assert [is_upright(wall) for wall in every] == [True, False]
    numerics = Numerics(dt=1e-4, steps_per_beat=50)
    count, rows = 400, []
    for frame in range(count):
        factor = 1.0 if frame == 0 else 2.0 if frame < 40 else 0.5
        for wall, normal, up in ((0, weight, 0.3 * weight), (1, 0.7 * weight, 0.0)):
            side = wall == 0
            values = dict.fromkeys(TRACTION_SUMS, 0.0)
            values |= {"contacts": 10, "sliding": 4 if side else 0, "fz": up if side else normal}
            values |= {"normal": normal * (factor if side else 1), "along": up, "mz": 0.01 * normal * factor * side}
            rows.append({"step": 100 * frame, "time": 0.01 * frame, "wall": wall, "bin": 1, **values})
    table = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    rng = np.random.default_rng(1)
    start = grains_at(rng.uniform(0, 3 * D, (100, 3)))
    numbers, stresses = evaluated(RunData(here, numerics, 1, start, "time-limit", 4.0, {"traction": table}))
    assert numbers["weight_balance"] == pytest.approx(0, abs=1e-12)
    assert numbers["carried.side"] == pytest.approx(0.3)
    assert numbers["wall_friction"] == pytest.approx(0.3)
    assert numbers["sliding_share"] == pytest.approx(0.4)
    assert numbers["wall_overshoot"] == pytest.approx(2)
    assert numbers["wall_switch"] == pytest.approx(0.5)
    assert numbers["wall_friction_flow"] == pytest.approx(0.6)
    assert stresses.rest_point[0][2] == pytest.approx(0.01)
    bins = bins_of_walls(here, every, bin_width(here))[0]
    assert stresses.low[1] == pytest.approx(bins.size)
    assert np.nanmax(stresses.flow_error) == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("entering", [0.0, -0.2])
def test_the_weight_of_a_fed_bed_is_that_of_the_grains_inside(entering):
    """Two of 100 grains leave in each beat and return at its end, one after a quarter of the beat and one after a half.

    So 98 + 1/4 + 1/2 grains are inside in the mean. Walls carry them, less the momentum of the outflow, and the
    momentum of a stream beside it."""
    silo = CylinderSilo(diameter=8 * D, height=0.3, orifice=4 * D)
    poured = Stream(rate=1.0, velocity=(0.0, 0.0, entering), low=(-D, -D, 0.2), high=(D, D, 0.25))
    stream = poured if entering else None
    feed = Feed(kind="rate" if entering else "reinject", stream=stream)
    here = scene(100, hertz(), silo, G).model_copy(update={"feed": feed})
    mass, numerics, beats = here.grains.mass, Numerics(dt=1e-4, steps_per_beat=100), 200
    start = grains_at(np.random.default_rng(1).uniform(0, 3 * D, (100, 3)))
    ends, speed = numerics.beat * np.arange(1, beats + 1), 0.3
    force = mass * (98.75 * G - 2 * (speed + entering) / numerics.beat)
    frames = {
        "step": 100 * np.arange(1, beats + 1),
        "time": ends,
        "wall": 0 * ends.astype(int),
        "bin": 0 * ends.astype(int),
    }
    traction = frames | {name: np.zeros(beats) for name in TRACTION_SUMS} | {"fz": np.full(beats, force)}
    left = np.sort(np.concatenate([ends - 0.75 * numerics.beat, ends - 0.5 * numerics.beat]))
    crossing = {"time": left, "id": np.arange(len(left)) % 100, "vz": np.full(len(left), -speed)}
    above = {
        "step": frames["step"],
        "plane": frames["wall"],
        "grains": 0 * frames["step"] + 98,
        "mass": 98 * mass + 0 * ends,
    }
    tables = {"traction": traction, "crossing": crossing, "above": above}
    run = RunData(here, numerics, 1, start, "time-limit", float(ends[-1]), tables)
    assert evaluated(run)[0]["weight_balance_flow"] == pytest.approx(0, abs=1e-3)
    del tables["above"]
    (lacking,) = (n for n in WallStress().evaluate(run, Whole()).numbers if n.quantity == "weight_balance_flow")
    assert math.isnan(lacking.value)
    assert "did not record the mass inside" in lacking.note


def test_it_says_what_is_lacking():
    here = scene(10, hertz(), Box(width=5 * D, depth=5 * D, height=0.1), 0.0)
    with pytest.raises(MeasureError, match="no gravity"):
        MEASURES["wall_stress"].check(here)
    falling = scene(10, hertz(), Box(width=5 * D, depth=5 * D, height=0.1), G)
    run = RunData(falling, Numerics(dt=1e-6), 1, place(falling, "rain", 1), "time-limit", 1.0, {})
    with pytest.raises(MeasureError, match="recorded no forces of walls"):
        WallStress().evaluate(run, Whole())
