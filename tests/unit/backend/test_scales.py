"""Similar scenes give similar numbers: no measure, stop rule or guard has a time or a length of its own.

Lengths are scaled by L and gravity by a factor, with the same density; times then scale by T = sqrt(L/factor) and
masses by M = L^3 (dimensional analysis). All factors are powers of two such that T is one as well: every product is
then exact, and the same decisions are made. Numbers agree to round-off (1e-9).
"""

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from toy_similar import D, G, Similar, asked

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Contacts, Ledger, Sample, Slab, Zone, describe_probe
from labbook.filling.placing import STARTS
from labbook.fit.beverloo import Beverloo2D
from labbook.fit.fitting import fit
from labbook.fit.law import Context
from labbook.lab.evaluations import expected, path_of
from labbook.lab.records import Observe
from labbook.measure import MEASURES, Measure, MeasureError, RunData, scales
from labbook.measure.recorded import FlowMoments, FlowPattern, FreeFall, instant
from labbook.plan.coverage import unobserved
from labbook.plan.demand import PointDemand
from labbook.scene import CylinderSilo, LinearSpringDashpot, Packing, Scene, Spheres, Spherocylinders, WedgeHopper
from labbook.scene.timescales import gravity_time
from labbook.study import keys
from labbook.study.schema import EVERY, FALLS, LONGEST, STALL, Window

RNG = np.random.default_rng(11)
DT, STEPS = 1e-5, 500


SCALES = [Similar(2.0**10, 1.0), Similar(2.0**-10, 1.0), Similar(1.0, 2.0**-16), Similar(2.0**10, 2.0**-16),
          Similar(2.0**-10, 2.0**6)]  # fmt: skip
"""Lengths from 1e-3 to 1e3, gravity from 1.5e-5 to 64."""
_LENGTHS = {"x", "y", "z", "bx", "by", "bz", "max_overlap"}
_SPEEDS = {"vx", "vy", "vz"}


def hopper(by: Similar) -> Scene:
    grains = Spheres(diameter=D * by.L, density=2500, count=900)
    container = WedgeHopper(width=48e-3 * by.L, height=0.3 * by.L, thickness=1.01 * D * by.L, orifice=21e-3 * by.L)
    law = LinearSpringDashpot(normal_stiffness=1e3 * by.L**2 * by.gravity, restitution=0.5)
    return Scene(grains=grains, contact=law, container=container, gravity=G * by.gravity)


def silo(by: Similar) -> Scene:
    grains = Spherocylinders(diameter=D * by.L, length=2 * D * by.L, density=620, count=900)
    container = CylinderSilo(diameter=48e-3 * by.L, height=0.3 * by.L, orifice=24e-3 * by.L)
    law = LinearSpringDashpot(normal_stiffness=1e3 * by.L**2 * by.gravity, restitution=0.5)
    return Scene(grains=grains, contact=law, container=container, gravity=G * by.gravity)


def scaled(table: Mapping[str, np.ndarray], by: Similar) -> dict[str, np.ndarray]:
    """Rows of a similar run."""
    force, energy = by.L**4 / by.T**2, by.L**5 / by.T**2
    factor = {"time": by.T} | dict.fromkeys(_LENGTHS, by.L) | dict.fromkeys(_SPEEDS, by.L / by.T)
    factor |= dict.fromkeys(("fx", "fy", "fz"), force)
    factor |= dict.fromkeys(("kinetic", "potential", "contact_work", "elastic"), energy)
    factor |= dict.fromkeys(("normal_power", "tangential_power", "wall_power"), energy / by.T)
    return {name: column * factor[name] if name in factor else column for name, column in table.items()}


def crossing() -> dict[str, np.ndarray]:
    """Grains leave at random, 400 a second, with arrests of 0.3 to 3 s: some of them are gaps, and some are not."""
    waits = RNG.exponential(1 / 400, 800)
    waits[60::45] += np.linspace(0.3, 3.0, len(waits[60::45]))
    one = {"id": RNG.permutation(800), "time": np.cumsum(waits)}
    zero = dict.fromkeys(("z", "vx", "vy", "wx", "wy", "wz"), np.zeros(800))
    return one | zero | {"x": RNG.uniform(-0.009, 0.009, 800), "vz": -RNG.uniform(0.1, 0.4, 800)}


def moving(beats: np.ndarray, each: int, low: float, high: float, wide: float) -> dict[str, np.ndarray]:
    """`each` grains in frames at `beats`, at random places, which fall at random speeds."""
    n = each * len(beats)
    rows: dict[str, np.ndarray] = {"step": np.repeat(beats * STEPS, each), "time": np.repeat(beats * STEPS * DT, each)}
    rows |= {"id": np.tile(np.arange(each), len(beats))}
    rows |= {"x": RNG.uniform(-wide, wide, n), "y": RNG.uniform(-wide / 2, wide / 2, n), "z": RNG.uniform(low, high, n)}
    rows |= {name: RNG.normal(-0.2 if name == "vz" else 0, 0.1, n) for name in ("vx", "vy", "vz")}
    turns = RNG.normal(size=(n, 4))
    return rows | dict(zip(("qw", "qx", "qy", "qz"), (turns / np.linalg.norm(turns, axis=1)[:, None]).T, strict=True))


def bed(scene: Scene) -> Packing:
    n, c = scene.grains.count, vars(scene.container)
    wide = (c.get("width") or c["diameter"]) / 2
    deep = c.get("thickness", 2 * wide) / 2
    x = np.column_stack([RNG.uniform(-wide, wide, n), RNG.uniform(-deep, deep, n), RNG.uniform(0, 0.15, n)])
    still = np.zeros((n, 3))
    q = None if isinstance(scene.grains, Spheres) else np.tile([1.0, 0, 0, 0], (n, 1))
    return Packing(x=x, v=still, omega=still, q=q)


def run(of: Any) -> RunData:
    """A made-up discharge of a scene."""
    scene, left = of(Similar(1.0, 1.0)), crossing()
    last = int(left["time"][-1] / (STEPS * DT))
    tables: dict[str, dict[str, np.ndarray]] = {"crossing": left}
    tables["slab"] = moving(np.arange(1, last), 4, -D / 2, D / 2, 0.0105)
    pairs = np.arange(0, last, 40)
    tables["zone"] = moving(np.sort(np.concatenate([pairs, pairs + 6])), 60, -0.01, 0.05, 0.02)
    tables["sample"] = moving(np.arange(0, last, 100), 200, 0.0, 0.1, 0.02)
    frames = tables["sample"]
    ends = np.flatnonzero(np.diff(frames["step"], prepend=-1))
    touching = [(at + RNG.integers(0, 200, 200), at + RNG.integers(0, 200, 200)) for at in ends]
    i, j = (np.concatenate(side) for side in zip(*touching, strict=True))
    contacts = {"step": frames["step"][i], "time": frames["time"][i], "i": frames["id"][i], "j": frames["id"][j]}
    contacts |= {f"b{axis}": frames[axis][j] - frames[axis][i] for axis in "xyz"} | {"wall": -np.ones(len(i), int)}
    tables["contacts"] = contacts | {f"f{axis}": RNG.normal(0, 1e-3, len(i)) for axis in "xyz"}
    time = np.arange(1, last, 4) * STEPS * DT
    work = -np.cumsum(RNG.uniform(0, 1e-5, len(time)))
    tables["ledger"] = {"time": time, "kinetic": 1e-4 * time, "potential": 1 - time, "contact_work": work}
    tables["ledger"] |= {"max_overlap": RNG.uniform(1e-6, 1e-5, len(time)), "grains": 900 - np.arange(len(time))}
    powers = {
        name: RNG.uniform(0, 1e-3, len(time)) for name in ("normal_power", "tangential_power", "wall_power", "elastic")
    }
    tables["dissipation"] = {"time": time, **powers}
    return RunData(scene, Numerics(dt=DT, steps_per_beat=STEPS), 1, bed(scene), "finished", last * STEPS * DT, tables)


RUNS = {of: run(of) for of in (hopper, silo)}


def similar(of: Any, by: Similar) -> RunData:
    one = RUNS[of]
    tables = {name: scaled(table, by) for name, table in one.tables.items()}
    start = replace(one.start, x=one.start.x * by.L)
    numerics = one.numerics.model_copy(update={"dt": DT * by.T})
    frames = tables["zone"]
    return RunData(of(by), numerics, 1, start, one.outcome, one.duration * by.T, tables, lambda: frames)


RECORDED: tuple[Measure, ...] = (FlowPattern(), FlowMoments(), FreeFall())
CASES = [(hopper, name) for name in ("flow_rate", "outlet_profiles", "packing", "ledger", "energy")]
CASES += [(silo, name) for name in ("flow_rate", "orifice", "contact_stress", "packing", "ledger")]


ENDED = [*((*case, "finished") for case in CASES), (silo, "flow_rate", "clogged")]


def told(note: str) -> str:
    """A note without its numbers."""
    return re.sub(r"[\d.]+(e[+-]?\d+)?", "#", note)


@pytest.mark.slow
@pytest.mark.parametrize(("of", "name", "outcome"), ENDED)
def test_every_number_of_a_similar_run_is_the_scaled_number(of, name, outcome):
    whole = replace(similar(of, Similar(1.0, 1.0)), outcome=outcome)
    expected = MEASURES[name].evaluate(whole, Window()).numbers
    assert any(math.isfinite(one.value) for one in expected)
    if name == "flow_rate":
        gaps = {one.quantity: one for one in expected}["gap_time"]
        assert 5 <= gaps.n_effective <= 15, "some arrests are gaps and some are not"
    for by in SCALES:
        found = MEASURES[name].evaluate(replace(similar(of, by), outcome=outcome), Window()).numbers
        assert [one.quantity for one in found] == [one.quantity for one in expected]
        for one, two in zip(expected, found, strict=True):
            factor = by.of(one.unit)
            assert two.value == pytest.approx(one.value * factor, rel=1e-9, nan_ok=True), (one.quantity, by)
            assert two.error == pytest.approx(one.error * factor, rel=1e-9, nan_ok=True), (one.quantity, by)
            assert two.n_effective == pytest.approx(one.n_effective, rel=1e-9, nan_ok=True), (one.quantity, by)
            assert told(two.note) == told(one.note)


@pytest.mark.slow
@pytest.mark.parametrize("measure", RECORDED, ids=lambda measure: measure.name)
def test_maps_and_accelerations_of_a_similar_recording_are_scaled(measure):
    expected = measure.evaluate(similar(silo, Similar(1.0, 1.0)), Window())
    assert expected.arrays
    for by in SCALES:
        found = measure.evaluate(similar(silo, by), Window())
        for one, two in zip(expected.numbers, found.numbers, strict=True):
            assert two.value == pytest.approx(one.value * by.of(one.unit), rel=1e-9), (one.quantity, by)
        assert found.arrays.keys() == expected.arrays.keys()
        for name in ("frames", "count"):
            if name in expected.arrays:
                np.testing.assert_array_equal(found.arrays[name], expected.arrays[name])
        if "acceleration" in expected.arrays:
            np.testing.assert_allclose(
                found.arrays["acceleration"], expected.arrays["acceleration"] * by.gravity, rtol=1e-9
            )


@pytest.mark.parametrize("by", SCALES)
def test_observations_of_similar_scenes_are_similar(by):
    """As many beats lie between two frames, and frames reach as far."""
    for of, name in CASES:
        how = Numerics(dt=DT, steps_per_beat=STEPS)
        one = MEASURES[name].observed(of(Similar(1.0, 1.0)), how, Window())
        two = MEASURES[name].observed(of(by), how.model_copy(update={"dt": DT * by.T}), Window())
        assert list(map(type, one)) == list(map(type, two))
        for a, b in zip(one, two, strict=True):
            if isinstance(a, Sample | Slab | Zone | Contacts | Ledger):
                assert b.every == a.every  # pyright: ignore[reportAttributeAccessIssue]
            if isinstance(a, Zone):
                assert isinstance(b, Zone)
                assert a.again == b.again
                sizes = ("radius", "low", "high", "core", "top")
                assert [getattr(b, size) for size in sizes] == pytest.approx([by.L * getattr(a, k) for k in sizes])


@pytest.mark.parametrize("by", SCALES)
def test_what_a_study_leaves_out_follows_from_its_scene(by):
    study = asked(by, record={})
    shared = PointDemand(study, study.points[0])
    tau = math.sqrt(D * by.L / (G * by.gravity))
    assert shared.stop.stall == pytest.approx(STALL * tau)
    assert shared.stop.max_time == shared.longest_filling == pytest.approx(LONGEST * tau)
    assert shared.run(1).recording == pytest.approx(EVERY * tau, abs=shared.numerics.beat / 2)
    own = asked(Similar(1.0, 1.0)).points[0].numerics.speed_limit
    assert shared.numerics.speed_limit == pytest.approx(own * by.L / by.T)
    assert shared.default_names == {"stall", "max_time", "recording", "speed_limit"}


def test_defaults_are_near_the_former_constants_at_the_scale_of_the_papers():
    """3 mm and 9.81 m/s^2 (Fan), and 20 mm rods of 6 mm (Pongó)."""
    fan = asked(Similar(1.0, 1.0), record={})
    shared = PointDemand(fan, fan.points[0])
    assert (shared.stop.stall, shared.stop.max_time) == pytest.approx((2.0, 60.0), rel=0.05)
    assert EVERY * gravity_time(shared.scene) == pytest.approx(0.01, rel=0.01)
    assert scales.gap(shared.scene) == pytest.approx(1.0, rel=0.06)
    assert shared.numerics.speed_limit == pytest.approx(100, rel=0.5)
    rods = silo(Similar(1.0, 1.0)).model_copy(
        update={"grains": Spherocylinders(diameter=6e-3, length=20e-3, density=620, count=10_000), "gravity": 9.8}
    )
    assert scales.moment(rods) == pytest.approx(1.0, rel=0.05)
    assert scales.interval(rods) == pytest.approx(0.05, rel=0.05)
    assert scales.layer(rods) == pytest.approx(0.01, rel=0.01)


def test_what_a_study_states_holds():
    study = asked(
        Similar(1.0, 1.0),
        stop={"stall": "7 s", "max_time": "70 s"},
        fill={"max_time": "8 s"},
        record={"every": "50 ms"},
        accuracy={},
    ).change({"window.gap": "3 s", "window.layer": "2 cm", "numerics.speed_limit": "5 m/s"})
    shared = PointDemand(study, study.points[0])
    assert (shared.stop.stall, shared.stop.max_time, shared.longest_filling) == (7.0, 70.0, 8.0)
    assert shared.numerics.speed_limit == 5.0
    assert shared.default_names == frozenset()
    assert (scales.gap(shared.scene, study.window), scales.layer(shared.scene, study.window)) == (3.0, 0.02)
    assert scales.in_text(study.window) == "gap=3.0 layer=0.02"


def test_the_longest_time_is_not_before_the_end_of_a_window_by_time():
    study = asked(Similar(1.0, 1.0), stop={"discharged": 1}).change({"window": {"after": "1 s", "until": "90 s"}})
    assert PointDemand(study, study.points[0]).stop.max_time == 90.0


@pytest.mark.parametrize("by", [Similar(3333.0, 1.0), Similar(1.0, 1e-6)])
def test_grains_may_fall_freely_through_the_scene(by):
    """From the top of the column in which they start, with the speeds that the fastest start gives them."""
    point = asked(by).points[0]
    closed = point.scene.close()
    starts = [STARTS[kind].place(closed, 1) for kind in ("rain", "gas")]
    top = max(float(one.x[:, 2].max()) for one in starts)
    fastest = max(float(np.linalg.norm(one.v, axis=1).max()) for one in starts)
    assert 5 * math.sqrt(2 * point.scene.gravity * top + fastest**2) < point.numerics.speed_limit


def test_without_gravity_there_are_no_gaps_and_measures_that_need_its_scale_say_so():
    weightless = silo(Similar(1.0, 1.0)).model_copy(update={"gravity": 0.0})
    assert scales.gap(weightless) == math.inf
    assert instant(weightless, Window(), (0.0, 3.0)) == 1.0
    for name in ("orifice", "contact_stress", "ledger"):
        with pytest.raises(MeasureError, match=f"{name}.*gravity"):
            MEASURES[name].check(weightless)


def test_the_page_of_keys_shows_the_multiples():
    shown = {key.name: key.default for key in keys.all_keys()}
    assert shown["stop.stall"] == f"{STALL:g} √(d*/g)"
    assert shown["window.gap"] == f"{scales.GAP:g} √(d*/g)"
    assert shown["window.layer"] == f"{scales.LAYER:g} d*"
    assert shown["numerics.speed_limit"] == f"{FALLS:g} √(2 g H)"


PONGO = sorted((Path(__file__).parents[3] / "studies").glob("pongo2022-*.yaml"))
PONGO = [file for file in PONGO if "clogging" not in file.stem]  # it asks for times between grains alone


@pytest.mark.parametrize("file", PONGO, ids=lambda file: file.stem)
def test_the_studies_of_pongo_state_the_times_and_lengths_of_the_paper(file):
    stated = Window.model_validate(yaml.safe_load(file.read_text())["window"], context={"units": "required"})
    assert (stated.gap, stated.moment, stated.interval, stated.layer) == (1.0, 1.0, 0.05, 0.01)


def test_observations_of_pongos_older_runs_are_those_that_the_studies_ask_for():
    """Their zones were rounded up to 5 mm: at D = 60 mm a radius of 30 + 20 mm, from -20 to 10 + 20 mm, and 25 mm wide
    up to two widths of the outlet. Of 2.92 s that a window takes there was a pair of frames every sixteenth, rounded to
    0.18 s, and contacts every fifth, rounded to 0.6 s."""
    rods = Spherocylinders(diameter=6e-3, length=20e-3, density=620, count=10_000)
    container = CylinderSilo(diameter=0.19, height=0.6, orifice=0.06)
    scene = silo(Similar(1.0, 1.0)).model_copy(update={"grains": rods, "container": container, "gravity": 9.8})
    window = Window(start=0.15, end=0.6, gap=1.0, moment=1.0, interval=0.05, layer=0.01)
    numerics = Numerics(dt=1e-6)
    (_, zone), (_, _, contacts) = (MEASURES[n].observed(scene, numerics, window) for n in ("orifice", "contact_stress"))
    older = [Zone(0.05, -0.02, 0.03, 0.025, 0.12, every=180, again=50), Contacts(every=600)]
    assert not unobserved(map(describe_probe, (zone, contacts)), map(describe_probe, older))
    assert isinstance(zone, Zone)
    assert zone.again == 50
    low = replace(older[0], high=0.02)
    assert unobserved([describe_probe(zone)], [describe_probe(low)]), "it does not reach high enough"
    apart = replace(older[0], again=100)
    assert unobserved([describe_probe(zone)], [describe_probe(apart)]), "its frames are too far apart"


def test_evaluations_by_other_times_are_kept_apart(tmp_path):
    measure = MEASURES["flow_rate"]
    paths = {path_of(tmp_path, measure, Window(start=0.15, end=0.6, gap=gap)) for gap in (None, 1.0, 2.0)}
    assert len(paths) == 3
    plain, stated = (Observe.of(["flow_rate"], Window(start=0.15, end=0.6, gap=gap)) for gap in (None, 1.0))
    assert expected(plain) != expected(stated)
    assert "gap" not in plain.model_dump_json(), "records of studies that state none stay as they were"
    assert Observe.model_validate_json(stated.model_dump_json()) == stated


@pytest.mark.parametrize("length", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("gravity", [1e-5, 1e2])
def test_fits_of_similar_silos_give_the_same_dimensionless_parameters(length, gravity):
    """W of a slot goes as rho sqrt(g) L^(5/2): C and k, their intervals and p do not change."""
    D = np.array([18.0, 21, 24, 27, 30]) * 1e-3
    W = np.array([18.75, 25.64, 34.14, 42.37, 50.0]) * 1e-3
    errors = np.array([0.5, 0.42, 0.72, 0.73, 1.1]) * 1e-3

    def fitted(scale: float, g: float):
        context = Context(d=3e-3 * scale, rho_p=2500, rho_b=1476, Z=3.03e-3 * scale, g=g)
        flow = scale**2.5 * math.sqrt(g / 9.81)
        return fit(Beverloo2D(), D * scale, W * flow, errors * flow, context, [3] * 5)

    plain, scaled = fitted(1.0, 9.81), fitted(length, 9.81 * gravity)
    assert scaled.p_value == pytest.approx(plain.p_value, rel=1e-6)
    for name in ("C", "C_particle", "k"):
        mine, theirs = scaled.parameters[name], plain.parameters[name]
        assert (mine.value, mine.low, mine.high) == pytest.approx((theirs.value, theirs.low, theirs.high), rel=1e-5)
