"""Points whose beds were discharged several times: every mean and every error is over beds."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
import pytest
from toy_lab import study
from toy_results import RunDouble

from labbook.measure.acceleration import AccelerationProfile
from labbook.measure.outlet import COVERAGE, ProfileAcross
from labbook.report.tables import flow_table, runs_table
from labbook.results.against import ratio_of
from labbook.results.calibrating import _observed as observed
from labbook.results.calibrating import flow_and_filling
from labbook.results.frames import _along as along
from labbook.results.points import FLOW_RATE, PointResult, RunResult, by_seed, pooled_point
from labbook.results.recorded import acceleration
from labbook.results.study import StudyResults
from labbook.stats import Measured, pool
from labbook.stats.ratio import paired_ratio
from labbook.study import Point, Study

BEDS = {1: (1.0, 1.2, 1.1), 2: (1.4, 1.3, 1.5), 3: (0.9, 1.0, 1.1)}
MEANS = [1.1, 1.4, 1.0]


class OfOneBed(RunResult):
    """A run whose profiles are given with it."""

    outlets: Mapping[str, ProfileAcross]
    acceleration: AccelerationProfile | None


def measured(value: float) -> Measured:
    return Measured(FLOW_RATE, value, math.nan, 100, "", "", "kg/s")


@pytest.fixture
def asked(tmp_path) -> Study:
    return study(tmp_path, "discharges_per_bed: 3", replicates=3)


def point_of(asked: Study, point: Point, beds: Mapping[int, Sequence[float]], clogged: Sequence = ()) -> PointResult:
    runs = []
    for seed, values in beds.items():
        for number, value in enumerate(values, 1):
            how = "clogged" if (seed, number) in clogged else "finished"
            double = RunDouble(point, seed, how, f"packing {seed}", discharge=number)
            numbers = {} if how == "clogged" else {FLOW_RATE: measured(value)}
            runs.append(OfOneBed(double, numbers, ("flow_rate",), asked.window, counted=True))
    return pooled_point(asked, point, frozenset(), tuple(runs))


def test_the_mean_is_over_beds(asked):
    found = point_of(asked, asked.points[0], BEDS)
    assert by_seed(found, FLOW_RATE) == pytest.approx(dict(zip(BEDS, MEANS, strict=True)))
    expected = pool(MEANS)
    assert found.flow_rate is not None
    for name in ("value", "error", "half_width", "n"):
        assert getattr(found.flow_rate, name) == pytest.approx(getattr(expected, name))
    assert found.beds == (1, 2, 3)
    assert (found.requested, found.partial) == (9, False)


def test_a_bed_of_which_a_discharge_clogged_counts_by_the_others(asked):
    found = point_of(asked, asked.points[0], BEDS, clogged=[(1, 2), (2, 1), (2, 2), (2, 3)])
    assert by_seed(found, FLOW_RATE) == pytest.approx({1: 1.05, 3: 1.0})
    assert found.flow_rate is not None
    assert found.flow_rate.n == 2
    assert found.remark == "4 of 9 clogged"


def test_ratios_pair_beds(asked):
    other = {seed: tuple(1.1 * value + 0.01 * seed for value in values) for seed, values in BEDS.items()}
    first, second = (point_of(asked, asked.points[k], beds) for k, beds in enumerate((BEDS, other)))
    found, pairs = ratio_of(second, first, FLOW_RATE)
    assert pairs == 3
    expected = paired_ratio([1.1 * mean + 0.01 * seed for seed, mean in enumerate(MEANS, 1)], MEANS)
    assert (found.value, found.error, found.n) == pytest.approx((expected.value, expected.error, 3))


def test_profiles_are_means_of_beds(asked):
    found = point_of(asked, asked.points[0], BEDS)
    edges = np.linspace(-1, 1, 3)
    for run in found.runs:
        value = run.measured[FLOW_RATE].value
        profile = ProfileAcross(0.01, edges, np.full(2, value), np.full(2, value**2), 1.0, value)
        vars(run)["outlets"] = {COVERAGE: profile}
    outlets = found.outlets(COVERAGE)
    assert [one.area_fraction[0] for one in outlets] == pytest.approx(MEANS)
    (row, _) = along(outlets)
    assert row["area_fraction"] == pytest.approx(np.mean(MEANS))
    assert row["area_fraction_error"] == pytest.approx(np.std(MEANS, ddof=1) / math.sqrt(3))


def test_accelerations_are_means_of_beds(asked):
    found = point_of(asked, asked.points[0], BEDS)
    for run in found.runs:
        value = np.full(2, run.measured[FLOW_RATE].value)
        vars(run)["acceleration"] = AccelerationProfile(np.arange(3.0), value, 0 * value, np.ones(2), 0.01, 0.0)
    profile = acceleration(found)
    assert profile is not None
    assert profile.acceleration == pytest.approx(np.full(2, np.mean(MEANS)))
    assert profile.error == pytest.approx(np.full(2, np.std(MEANS, ddof=1) / math.sqrt(3)))
    assert list(profile.count) == [9, 9]


def test_a_calibration_takes_every_discharge_as_one_of_its_bed(asked):
    found = point_of(asked, asked.points[0], BEDS)
    runs = observed(found, *flow_and_filling(found.point))
    assert [(run.bed, run.rate) for run in runs] == [(f"packing {s}", value) for s, of in BEDS.items() for value in of]


def test_tables_count_beds_and_name_discharges(asked):
    point = point_of(asked, asked.points[0], BEDS, clogged=[(2, 1), (2, 2), (2, 3)])
    results = StudyResults(asked, (point,), (), (), ())
    table = flow_table(results)
    assert table.rows[0][table.headings.index("n")] == "2 of 3 (9 runs)"
    assert any("Beds are the replicates" in note for note in table.notes)
    assert [row[1] for row in runs_table(results).rows[:4]] == ["1", "1, discharge 2", "1, discharge 3", "2"]


def test_frames_have_a_column_for_the_discharge_where_beds_have_several(asked, tmp_path):
    from labbook.results.frames import frames

    results = StudyResults(asked, (point_of(asked, asked.points[0], BEDS),), (), (), ())
    made = frames(results, ("points", "runs"))
    assert list(made["runs"]["discharge"]) == [1, 2, 3] * 3
    assert list(made["points"]["replicates"]) == [3]
    plain = study(tmp_path, replicates=3)
    alone = {seed: values[:1] for seed, values in BEDS.items()}
    results = StudyResults(plain, (point_of(plain, plain.points[0], alone),), (), (), ())
    assert "discharge" not in frames(results, ("runs",))["runs"]
