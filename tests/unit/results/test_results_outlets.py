"""Fits and clogging by outlet, of one silo with three slots: its runs are drawn from known laws."""

import math

import numpy as np
import pytest
from toy_results import RunDouble, analyse

from labbook.backend.numerics import Numerics
from labbook.measure import MEASURES, RunData
from labbook.measure.clogging import Avalanches, transient
from labbook.report.clogging import clogging_sections, clogging_table
from labbook.report.sections import series_sections
from labbook.results.clogging import clogging
from labbook.results.frames import frames
from labbook.results.outlets import OutletResult, by_outlet
from labbook.results.selection import series_at
from labbook.results.series import series_of
from labbook.scene.packing import Packing
from labbook.study import StudyError, load
from labbook.study.schema import Window

D, C, K, DEPTH = 3e-3, 0.6, 1.5, 4.5e-3
SLOTS = {"narrow": (-60e-3, -42e-3), "middle": (-12e-3, 12e-3), "wide": (30e-3, 66e-3)}
"""Widths of 18, 24 and 36 mm: 6, 8 and 12 d."""
STUDY = """
name: slots
grains: {shape: sphere, diameter: 3 mm, density: 2500 kg/m^3, count: 6000}
contact: {law: hertz-mindlin, shear_modulus: 2 MPa, poisson_ratio: 0.25, friction: 0.5, restitution: 0.2}
container:
  kind: primitives
  outlet_plane: 0 mm
  parts:
    - {name: front, shape: {kind: plane, point: [0 mm, -2.25 mm, 0 mm], normal: [0, 1, 0]}}
    - {name: back, shape: {kind: plane, point: [0 mm, 2.25 mm, 0 mm], normal: [0, -1, 0]}}
    - {name: left, shape: {kind: plane, point: [-80 mm, 0 mm, 0 mm], normal: [1, 0, 0]}}
    - {name: right, shape: {kind: plane, point: [80 mm, 0 mm, 0 mm], normal: [-1, 0, 0]}}
    - {name: floor-a, shape: {kind: strip, start: [-80 mm, 0 mm], end: [-60 mm, 0 mm]}}
    - {name: floor-b, shape: {kind: strip, start: [-42 mm, 0 mm], end: [-12 mm, 0 mm]}}
    - {name: floor-c, shape: {kind: strip, start: [12 mm, 0 mm], end: [30 mm, 0 mm]}}
    - {name: floor-d, shape: {kind: strip, start: [66 mm, 0 mm], end: [80 mm, 0 mm]}}
    - {name: narrow, opens: start, shape: {kind: strip, start: [-60 mm, 0 mm], end: [-42 mm, 0 mm]}}
    - {name: middle, opens: start, shape: {kind: strip, start: [-12 mm, 0 mm], end: [12 mm, 0 mm]}}
    - {name: wide, opens: start, shape: {kind: strip, start: [30 mm, 0 mm], end: [66 mm, 0 mm]}}
replicates: 12
window: {start: 0.1, end: 0.8, gap: 20 ms}
measure: [flow_rate, outlets, clogging]
fit: [beverloo]
"""
MASS = 2500 * math.pi / 6 * D**3


def grain_rate(width: float) -> float:
    """Grains per second by Beverloo's law for a slot, as published (Beverloo et al. 1961, n = 3/2)."""
    return C * 2500 * math.sqrt(9.81) * (width - K * D) ** 1.5 * DEPTH / MASS


class ThreeSlots(RunDouble):
    """Grains leave each slot at its rate; the narrow one stops with a probability of 1/150 a grain, and flows again
    after 60 ms. The run ends when 4800 grains have left."""

    def __init__(self, point, seed):
        rng, x, times, self.stops = np.random.default_rng(seed), [], [], 0
        for name, (low, high) in SLOTS.items():
            waits = rng.exponential(1 / grain_rate(high - low), 4800)
            if name == "narrow":
                waits += 0.06 * (rng.random(4800) < 1 / 150)
            times.append(np.cumsum(waits))
            x.append(rng.uniform(low, high, 4800))
        order = np.argsort(np.concatenate(times))[:4800]
        self.times, self.x = np.concatenate(times)[order], np.concatenate(x)[order]
        super().__init__(point, seed)

    def data(self) -> RunData:
        n, start = len(self.times), Packing(*np.zeros((3, 6000, 3)))
        table = {"id": np.arange(n), "time": self.times, "x": self.x, "y": np.zeros(n), "z": np.zeros(n)}
        table["vz"] = np.full(n, -0.3)
        return RunData(
            self.point.scene, Numerics(dt=1e-5), self.seed, start, "finished", self.times[-1], {"crossing": table}
        )


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    path = tmp_path_factory.mktemp("slots") / "slots.yaml"
    path.write_text(STUDY)
    return load(path)


@pytest.fixture(scope="module")
def results(study):
    (point,) = study.points
    return analyse(study, [ThreeSlots(point, seed) for seed in range(1, 13)])


def test_lids_say_form_and_width_of_their_outlets(study):
    outlets = {one.name: one for one in study.points[0].scene.container.outlets}
    assert {name: one.form for name, one in outlets.items()} == dict.fromkeys(SLOTS, "slot")
    for name, (low, high) in SLOTS.items():
        assert (outlets[name].width, outlets[name].centre) == pytest.approx((high - low, (low + high) / 2))


def test_a_law_goes_through_the_outlets_of_one_silo(results):
    (series,) = results.series
    assert [one.label for one in series.points] == ["narrow", "middle", "wide"]
    assert series.orifices == pytest.approx([18e-3, 24e-3, 36e-3])
    fit = series.fits["beverloo"]
    for one in series.points:  # pauses longer than window.gap are left out of W, as in every flow rate
        assert one.flow_rate is not None
        expected = grain_rate(one.orifice) * MASS
        assert abs(one.flow_rate.value - expected) < 4 * one.flow_rate.error + 0.002 * expected
    assert fit.parameters["C_particle"].low < C < fit.parameters["C_particle"].high
    assert fit.parameters["k"].low < K < fit.parameters["k"].high
    assert len(series.used) == 3
    assert len(series.whole_points) == 1


def test_outlets_are_expanded_once(results):
    """A law that the study does not fit goes through the same three outlets, each once."""
    points = by_outlet(results.points)
    assert by_outlet(points) == points
    (series,) = series_of(results.series[0].points, ("janda",))
    assert [one.label for one in series.points] == ["narrow", "middle", "wide"]


def test_each_outlet_has_its_avalanches(results):
    (series,) = clogging(results)
    narrow, middle, wide = series.points
    q = narrow.probability
    assert q is not None
    assert q.low < 1 / 150 < q.high
    assert middle.probability is not None
    assert middle.probability.bound
    assert wide.probability is not None
    assert wide.probability.bound
    assert narrow.flowing is not None
    expected = grain_rate(18e-3) * MASS
    assert abs(narrow.flowing.value - expected) < 4 * narrow.flowing.error, "mass over time of flow, without pauses"
    assert narrow.width_ratio == pytest.approx(6)
    assert [row[0] for row in clogging_table(series).rows] == ["narrow", "middle", "wide"]


def test_counts_of_an_outlet_are_those_of_its_pauses(results):
    """All pauses of 60 ms within the window are stops, and grains beyond the transients count."""
    run = results.points[0].runs[0]
    here = run.avalanches_of(0)
    times = run.run.data().tables["crossing"]["time"]
    x = run.run.data().tables["crossing"]["x"]
    of_narrow = np.sort(times[x < -30e-3])
    assert int(here.stopped.sum()) == int((np.diff(of_narrow) > 0.05).sum())
    assert int(here.grains.sum()) == len(of_narrow)
    assert here.counted[0] == max(0, here.grains[0] - transient(run.run.point.scene, opening=True, outlet_index=0))


def test_an_outlet_that_stops_for_good_is_told_from_an_end(study):
    """Left: its last grain leaves at 1 s of 6 s; right: it flows to the end, so that it is censored."""
    scene = study.points[0].scene
    left, right = np.arange(1, 101) * 0.01, np.arange(1, 601) * 0.01
    x = np.concatenate([np.full(100, -50e-3), np.full(600, 50e-3)])
    times = np.concatenate([left, right])
    n = len(times)
    table = {"id": np.arange(n), "time": times, "x": x, "y": np.zeros(n), "z": np.zeros(n), "vz": np.full(n, -0.3)}
    start = Packing(*np.zeros((3, 6000, 3)))
    run = RunData(scene, Numerics(dt=1e-5), 1, start, "finished", 6.0, {"crossing": table})
    arrays = MEASURES["clogging"].evaluate(run, Window(start=0.0, end=1.0)).arrays
    narrow, middle, wide = (Avalanches.of(arrays, place) for place in range(3))
    assert narrow is not None
    assert middle is not None
    assert wide is not None
    assert (narrow.grains.tolist(), narrow.stopped.tolist(), narrow.end.tolist()) == ([100], [True], [1.0])
    assert (wide.grains.tolist(), wide.stopped.tolist()) == ([600], [False])
    assert (middle.grains.tolist(), middle.stopped.tolist()) == ([0], [True]), "never flowed"
    assert run.rows("crossing")["outlet"].tolist() == ["narrow"] * 100 + ["wide"] * 600


def test_reports_and_tables_have_the_outlets(results, tmp_path):
    pytest.importorskip("matplotlib")
    (section,) = series_sections(results, tmp_path)
    assert section.title == "Flow rate against orifice"
    assert clogging_sections(results, tmp_path)
    table = frames(results, ("clogging",))["clogging"]
    assert table["outlet"].tolist() == ["narrow", "middle", "wide"]
    assert table["width_ratio"].tolist() == pytest.approx([6, 8, 12])


def test_studies_that_ask_too_much_of_outlets_are_refused(tmp_path):
    path = tmp_path / "slots.yaml"
    path.write_text(STUDY.replace("fit: [beverloo]", "fit: [beverloo_3d]"))
    with pytest.raises(StudyError, match="a law for a hole, but the outlet is a slot"):
        load(path)
    path.write_text(STUDY.replace("measure: [flow_rate, outlets, clogging]", "measure: [flow_rate, clogging]"))
    with pytest.raises(StudyError, match=r"measure: \[flow_rate, outlets\]"):
        load(path)
    path.write_text(STUDY + "accuracy: {clogging: 20 %}\n")
    with pytest.raises(StudyError, match="several outlets, each with its own probability"):
        load(path)


def test_slots_and_holes_of_one_silo_are_two_series(results, monkeypatch):
    """They have the same swept values: the label has the form, and `at={"outlet": ...}` says which."""

    def form(result: OutletResult) -> str:
        return "hole" if result.outlet.name == "wide" else "slot"

    monkeypatch.setattr(OutletResult, "outlet_form", property(form))
    series, point = series_of(results.points, ()), results.study.points[0]
    assert sorted(one.label for one in series) == ["holes", "slots"]
    assert [result.label for result in series_at(series, {"outlet": "hole"}, point).points] == ["wide"]
    with pytest.raises(LookupError, match="'outlet': 'slot'"):
        series_at(series, None, point)
