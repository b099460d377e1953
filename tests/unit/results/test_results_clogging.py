"""Clogging of a study whose runs stop with a known probability per grain: from runs to the page."""

import math

import numpy as np
import pytest
from toy_results import RunDouble, analyse

from labbook.backend.numerics import Numerics
from labbook.measure import RunData, scales
from labbook.measure.clogging import transient
from labbook.report.blocks import Picture, Prose, Section
from labbook.report.clogging import clogging_sections, clogging_table, law_tables, memory_table, times_table
from labbook.report.page import PARTS
from labbook.report.result_box import concerns, result_box
from labbook.results.clogging import clogging
from labbook.results.frames import frames
from labbook.scene.packing import Packing
from labbook.stats.rates import PooledRate
from labbook.stats.survival import PowerTail
from labbook.study import load

STUDY = """
name: clogs
grains: {shape: sphere, diameter: 3 mm, density: 2500 kg/m^3, count: 4000}
contact: {law: hertz-mindlin, shear_modulus: 2 MPa, poisson_ratio: 0.25, friction: 0.5, restitution: 0.2}
container: {kind: wedge-hopper, width: 60 mm, height: 300 mm, thickness: 1.01 d, angle: 90 deg, orifice: 24 mm}
sweep: {container.orifice: "[9, 10.5, 12, 13.5, 15, 24] mm"}
replicates: 40
window: {start: 0.1, end: 0.6}
measure: [flow_rate, clogging]
"""
RATE = 200.0


def stops(x: float) -> float:
    """Probability per grain; next to none at D/d = 8."""
    return 1 / (8 * math.expm1(0.19 * (x * x - 1)))


class StoppedRun(RunDouble):
    """Grains leave one after another until one is the last, or 2400 of 4000 have left."""

    def __init__(self, point, seed, discharge=1):
        rng = np.random.default_rng([point.index, seed])
        grains = int(rng.geometric(stops(point.scene.container.orifice / 3e-3)))
        self.times = np.cumsum(rng.exponential(1 / RATE, min(grains, 2500)))
        super().__init__(point, seed, "clogged" if grains < 2500 else "finished", discharge=discharge)

    def data(self) -> RunData:
        left, outcome = len(self.times), self.entry.outcome
        table = {"id": np.arange(left), "time": self.times, "vz": np.full(left, -0.3)}
        start = Packing(*np.zeros((3, 4000, 3)))
        end = self.times[-1] + (3.0 if outcome == "clogged" else 0.0)
        return RunData(self.point.scene, Numerics(dt=1e-5), self.seed, start, outcome, end, {"crossing": table})


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    path = tmp_path_factory.mktemp("clogs") / "clogs.yaml"
    path.write_text(STUDY)
    study = load(path)
    return analyse(study, [StoppedRun(point, seed) for point in study.points for seed in range(1, 41)])


def test_points_have_the_probability_that_runs_were_made_with(results):
    for result in results.points:
        q, true = result.pooled["clogging_probability"], stops(result.orifice / 3e-3)
        assert isinstance(q, PooledRate)
        assert 30 < q.n <= 40, "those that all ended within the transient tell nothing"
        assert abs(q.events - true * q.exposure) <= 4 * math.sqrt(true * q.exposure) + 1
        assert "clogging_stops" not in result.pooled


def test_an_outlet_that_never_clogged_has_a_bound(results):
    (one,) = clogging(results)
    wide = one.points[-1]
    assert wide.probability is not None
    assert wide.probability.bound
    grains = 40 * (2400 - transient(wide.result.point.scene, opening=True))
    assert wide.probability.exposure == grains
    assert clogging_table(one).rows[-1][5] == f"< {3.6889 / grains:.2g}".replace("e-0", "e−0")
    assert wide.mean_avalanche == (math.inf, pytest.approx(grains / 3.689, rel=1e-3), math.inf)


def test_survivors_and_clogged_runs_have_one_flow_rate(results):
    """W of all runs is that of the grains that leave 200 a second, at points where all clogged too."""
    (one,) = clogging(results)
    for point in one.points:
        mass = point.result.point.scene.grains.mass
        assert point.flowing is not None
        assert abs(point.flowing.value / (RATE * mass) - 1) < 4 * point.flowing.error / point.flowing.value + 1e-3
    assert one.points[0].result.flow_rate is None, "every run clogged before 60 grains in the window had left"


def test_avalanches_without_memory_pass_the_tests_and_the_law_is_found(results):
    (one,) = clogging(results)
    assert min(point.hazard.p for point in one.points[:4] if point.hazard is not None) > 1e-3
    assert all(math.isnan(point.within_beds.value) for point in one.points), "one discharge of each bed"
    law = one.fits[-1]
    assert law.parameters["C"].low < 0.19 < law.parameters["C"].high
    assert one.verdict
    assert len(memory_table(one).rows) == 6


def test_exported_rows_are_the_numbers_of_points_and_laws(results):
    tables = frames(results, ("clogging", "clogging_laws"))
    points, laws = tables["clogging"], tables["clogging_laws"]
    q = results.points[1].pooled["clogging_probability"]
    second = points.iloc[1]
    assert (second["point"], second["width_ratio"]) == (2, pytest.approx(3.5))
    assert second[["stops", "grains", "probability", "low", "high"]].tolist() == pytest.approx(
        [q.events, q.exposure, q.events / q.exposure, q.low, q.high]
    )
    assert points.iloc[-1]["probability"] == 0
    assert points.iloc[-1]["high"] > 0
    (one,) = clogging(results)
    found = laws.set_index(["law", "parameter"]).loc[("no critical size", "C")]
    assert found["value"] == one.fits[-1].parameters["C"].value
    assert found["low"] < 0.19 < found["high"]
    assert found["outlets"] == 6
    assert "alpha" not in points, "no wall moves"


def test_discharges_that_repeat_their_bed_and_a_start_that_stops_at_once_are_told(results):
    """Three discharges of a bed give what the first gave, and half of all beds stop after the transient at once."""
    study = results.study.change({"discharges_per_bed": 3})
    first = study.points[0]
    runs = []
    for seed in range(1, 31):
        for number in (1, 2, 3):
            run = StoppedRun(first, seed, number)
            run.times = run.times[: transient(first.scene, opening=True) + (1 if seed % 2 else 20 + seed)]
            runs.append(run)
    (series,) = clogging(analyse(study, runs))
    hazards, alike = series.doubts
    assert "hazard is not constant at D = 9 mm" in hazards
    assert "use more replicates instead of discharges_per_bed" in alike
    assert clogging(results)[0].doubts == []


class TurningRun(RunDouble):
    """Times between grains of a power law above 50 ms, and the run ends within one of them."""

    def data(self) -> RunData:
        rng = np.random.default_rng(self.seed)
        waits = np.concatenate([rng.uniform(0, 0.05, 300), 0.05 * rng.random(300) ** (-1 / 0.6)])
        times = np.cumsum(rng.permutation(waits))
        table = {"id": np.arange(600), "time": times, "vz": np.full(600, -0.3)}
        start = Packing(*np.zeros((3, 4000, 3)))
        crossing = {"crossing": table}
        return RunData(self.point.scene, Numerics(dt=1e-5), self.seed, start, "time-limit", times[-1] + 3.0, crossing)


def test_times_of_an_agitated_silo_have_a_tail_and_those_of_others_have_none(results, tmp_path):
    """alpha = 1.6: the mean time diverges. The last time of each run is censored."""
    path = tmp_path / "turns.yaml"
    silo = "container: {kind: cylinder-silo, diameter: 60 mm, height: 300 mm, orifice: 12 mm, rotation: 0.5 Hz}"
    lines = [silo if line.startswith("container:") else line for line in STUDY.splitlines()]
    path.write_text("\n".join(line for line in lines if not line.startswith("sweep:")))
    study = load(path)
    (series,) = clogging(analyse(study, [TurningRun(study.points[0], seed) for seed in (1, 2, 3)]))
    (point,) = series.points
    tail = point.tail
    assert isinstance(tail, PowerTail)
    assert tail.low < 1.6 < tail.high
    assert (tail.censored, tail.verdict) == (3, "clogs")
    assert point.times is not None
    gaps = point.times[0] > scales.gap(point.result.point.scene)
    assert point.flowing_fraction == pytest.approx(1 - point.times[0][gaps].sum() / point.times[0].sum())
    assert tail.stretched > -4, "a power law is no worse than a stretched exponential"
    assert point.tail_goodness > 0.1
    assert (point.row["alpha"], point.row["goodness"]) == (tail.alpha, point.tail_goodness)
    table = times_table(series)
    assert table is not None
    assert table.rows[0][-1] == "clogs"
    assert times_table(clogging(results)[0]) is None
    assert clogging(results)[0].points[0].tail == "no wall moves, so that a stop never ends"


@pytest.mark.slow
def test_the_page_tells_of_clogging_and_gives_no_advice_against_it(results, tmp_path):
    assert clogging_sections in PARTS
    (section,) = clogging_sections(results, tmp_path)
    table, drawn, memory, *laws, verdict = section.blocks
    assert (table, memory) == (clogging_table(clogging(results)[0]), memory_table(clogging(results)[0]))
    assert isinstance(drawn, Picture)
    assert [law.title for law in laws if isinstance(law, Section)] == ["Critical size", "No critical size"]
    assert law_tables(clogging(results)[0])[1].notes[0].endswith("alpha = 2, the dimension.")
    assert isinstance(verdict, Prose)
    assert "none is better by 4" in verdict.text or "prefer the law" in verdict.text
    assert (tmp_path / "clogging.svg").exists()
    assert not any("wider outlet" in sentence for sentence in concerns(results))
    told = dict(result_box(results).rows)["Clogging"]
    assert "at D = 9 mm and < " in told
    assert "at D = 24 mm stops per grain" in told
