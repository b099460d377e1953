"""Pooling, series, fits and the comparison with a reference, on runs made from Beverloo's law."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from toy_results import analyse

from labbook.lab import Unreadable
from labbook.report.tables import comparison_table
from labbook.results.frames import to_json
from labbook.results.points import pooled_point, redundant
from labbook.results.reference import Comparison, agreement, of_reference
from labbook.stats import Measured
from labbook.study.schema import Accuracy, Reference, ReferenceEntry


def test_a_point_is_the_mean_over_seeds_with_a_student_interval(analysis):
    for result in analysis.points:
        values = [run.measured["flow_rate"].value for run in result.runs]
        assert len(values) == 3
        assert result.flow_rate is not None
        assert result.flow_rate.value == pytest.approx(np.mean(values), rel=1e-12)
        low, high = stats.t.interval(0.95, 2, np.mean(values), stats.sem(values))
        assert result.flow_rate.low == pytest.approx(low, rel=1e-9)
        assert result.flow_rate.high == pytest.approx(high, rel=1e-9)


def test_pooled_flow_rates_are_those_that_the_runs_were_made_from(analysis, synthetic):
    # Scatter between seeds, and that of the mean of the waits within the window, 0.45 of all grains.
    grains = 0.45 * analysis.points[0].point.scene.grains.count
    error = math.sqrt((synthetic.SCATTER**2 + synthetic.REGULARITY**2 / grains) / 3)
    pulls = [(r.flow_rate.value / synthetic.beverloo(r.point.scene) - 1) / error for r in analysis.points]
    assert np.sum(np.square(pulls)) < stats.chi2.ppf(0.999, len(pulls))


def test_the_fit_gives_back_the_parameters_of_the_law(analysis, synthetic):
    (series,) = analysis.series
    parameters = series.fits["beverloo"].parameters
    for name, truth in (("C_particle", synthetic.C), ("k", synthetic.K)):
        found = parameters[name]
        assert found.low < found.value < found.high
        assert found.value == pytest.approx(truth, abs=4 * found.error)
        assert found.error < 0.03 * truth
    assert set(series.fits) == {"beverloo", "janda"}
    assert series.preferred in {"beverloo", "undecided"}


def test_the_verdict_names_the_laws_that_are_left_and_those_that_are_not(analysis):
    (series,) = analysis.series
    left = replace(series, contenders=("beverloo", "janda"))
    assert left.verdict == "The data do not decide between Beverloo and Janda."
    three = replace(left, fits={**series.fits, "power": series.fits["janda"]})
    assert three.verdict == "The data do not decide between Beverloo and Janda; against Power they do (AICc)."
    assert replace(three, contenders=("janda",)).verdict == "The data prefer Janda to Beverloo and Power (AICc)."
    assert replace(three, contenders=()).verdict == ""


def test_both_normalisations_of_c_differ_by_the_packing_fraction(analysis):
    (series,) = analysis.series
    parameters = series.fits["beverloo"].parameters
    fraction = np.mean([result.pooled["packing_fraction"].value for result in analysis.points])
    assert parameters["C_particle"].value / parameters["C"].value == pytest.approx(fraction, rel=1e-9)


def test_w_of_t_counts_every_grain_and_the_window_lies_within(analysis):
    for result in analysis.points:
        for run in result.runs:
            assert run.trace is not None
            width = run.trace.time[1] - run.trace.time[0]
            mass = result.point.scene.grains.mass
            grains = run.trace.rate.sum() * width / mass
            # All but those of the last bin, which the end of the run cuts off.
            assert result.point.scene.grains.count - 60 <= round(grains) <= result.point.scene.grains.count
            start, end = run.trace.window
            assert 0 < start < end < run.trace.time[-1]


def test_series_are_points_that_differ_in_their_orifice_only(synthetic):
    angles = [math.radians(a) for a in (30, 60, 90)]
    points = [
        synthetic.point(10 * i + k, D, angle)
        for i, angle in enumerate(angles)
        for k, D in enumerate((0.04, 0.02, 0.03))
    ]
    runs = [synthetic.FinishedDouble(point, seed) for point in points for seed in (1, 2)]
    found = analyse(synthetic.study_of(points), runs).series
    assert [series.at for series in found] == [{"container.angle": angle} for angle in angles]
    assert all(series.orifices == [0.02, 0.03, 0.04] for series in found)
    assert found[0].label == "angle = 30 deg"
    # Three orifices are too few for the three parameters of Janda's law: said, not skipped.
    assert all("Janda" in series.problems[0] and "beverloo" in series.fits for series in found)


def test_a_difference_is_told_in_standard_errors_of_both(analysis):
    entry = next(c for c in analysis.comparisons if c.quantity == "flow_rate" and c.ours is not None)
    ours = next(r.flow_rate for r in analysis.points if r.orifice == 0.03)
    assert entry.in_errors == pytest.approx((ours.value - 0.056) / math.sqrt(ours.error**2 + 0.001**2))
    k = next(c for c in analysis.comparisons if c.quantity == "beverloo.k")
    fitted = analysis.series[0].fits["beverloo"].parameters["k"]
    assert k.in_errors == pytest.approx((fitted.value - 1.55) / fitted.error)
    assert k.relative == pytest.approx(fitted.value / 1.55 - 1)


def test_of_several_numbers_for_one_quantity_each_has_its_place_and_the_first_is_drawn(synthetic):
    points = [synthetic.point(k, D) for k, D in enumerate(synthetic.DIAMETERS)]
    entries = tuple(
        ReferenceEntry("beverloo.k", {}, value, says=says) for value, says in ((1.5, "eq 1"), (0.0, "eq 14"))
    )
    study = synthetic.study_of(points, reference=Reference("a paper", entries), fit=("beverloo",))
    found = analyse(study, [synthetic.FinishedDouble(point, seed) for point in points for seed in (1, 2)])
    assert [(c.reference, c.says) for c in found.comparisons] == [(1.5, "eq 1"), (0.0, "eq 14")]
    assert of_reference(found.comparisons, "beverloo", found.series[0]) == {"k": 1.5}
    assert [row[0] for row in comparison_table(found.comparisons).rows] == ["k, eq 1", "k, eq 14"]


def test_a_reference_that_nothing_answers_is_shown_with_the_reason(synthetic):
    points = [synthetic.point(k, D) for k, D in enumerate(synthetic.DIAMETERS)]
    entries = (
        ReferenceEntry("flow_rate.flow_rate", {"container.orifice": 0.099}, 0.1),
        ReferenceEntry("beverloo.kk", {}, 1.5),
        ReferenceEntry("beverloo.k", {"container.angle": math.radians(15)}, 1.5),
        ReferenceEntry("waiting_time", {"container.orifice": 0.03}, 1.5),
    )
    study = synthetic.study_of(points, reference=Reference("nobody", entries), fit=("beverloo",))
    runs = [synthetic.FinishedDouble(point, seed) for point in points for seed in (1, 2)]
    found = analyse(study, runs).comparisons
    assert [c.ours for c in found] == [None] * 4
    assert "no finished point" in found[0].why
    assert "beverloo has no kk" in found[1].why
    assert "no finished point" in found[2].why
    assert "waiting_time was not measured" in found[3].why
    assert agreement(found, "nobody") == "No numbers to compare with nobody yet."


def test_the_sentence_on_agreement_counts_and_names_the_farthest():
    near = Comparison("beverloo.k", {}, "", 1.55, None, 1.56, 0.02, 1.52, 1.60)
    far = Comparison("flow_rate", {}, "D = 60 mm", 0.179, None, 0.165, 0.002, 0.161, 0.169)
    unknown = Comparison("flow_rate", {}, "D = 70 mm", 0.2, None, 0.3, math.nan, -math.inf, math.inf)
    text = agreement([near, far, unknown], "Fan et al. 2023")
    assert "Of 2 numbers of Fan et al. 2023, 1 lie inside our 95 % intervals, and 1 more lie within 10 %." in text
    assert text.endswith("The largest difference is in W at D = 60 mm: −7.8 %, outside the 95 % interval.")


def test_two_seeds_exclude_only_what_lies_outside_students_interval(synthetic):
    """t of one degree of freedom is 12.7: the interval of two seeds holds a reference six standard errors away."""
    points = [synthetic.point(0, 0.03)]
    runs = [synthetic.FinishedDouble(points[0], seed) for seed in (1, 2)]
    pooled = analyse(synthetic.study_of(points), runs).points[0].flow_rate
    assert pooled is not None
    for errors, inside in ((6, True), (13, False)):
        entry = ReferenceEntry("flow_rate.flow_rate", {}, pooled.value + errors * pooled.error)
        found = analyse(synthetic.study_of(points, reference=Reference("a paper", (entry,))), runs)
        (one,) = found.comparisons
        assert (one.inside, one.n) == (inside, 2)
        said = agreement(found.comparisons, "a paper")
        assert f"{'inside' if inside else 'outside'} the 95 % interval (n = 2)" in said
        assert "standard error" not in said


def test_clogged_and_diverged_runs_do_not_enter_the_mean(synthetic):
    point = synthetic.point(0, 0.03)
    outcomes = {1: "emptied", 2: "emptied", 3: "clogged", 4: "diverged"}
    runs = [synthetic.FinishedDouble(point, seed, outcome) for seed, outcome in outcomes.items()]
    (result,) = analyse(synthetic.study_of([point]), runs).points
    assert result.flow_rate is not None
    assert result.flow_rate.n == 2
    assert result.pooled["flow_rate_flowing"].n == 1
    assert "waiting_time" not in result.pooled
    assert result.outcomes == {"emptied": 2, "clogged": 1, "diverged": 1}
    assert result.remark == "1 of 4 clogged, 1 of 4 diverged"


def test_a_run_that_cannot_be_read_is_reported_and_the_others_count(synthetic, monkeypatch):
    point = synthetic.point(0, 0.03)
    runs = [synthetic.FinishedDouble(point, seed) for seed in (1, 2, 3)]

    def data(self):
        if self.seed == 2:
            raise Unreadable("runs/2/crossing.npz: truncated")
        return synthetic.observe(self.point.scene, self.seed)

    monkeypatch.setattr(synthetic.FinishedDouble, "data", data)
    told = []
    analysis = analyse(synthetic.study_of([point, synthetic.point(1, 0.04)]), runs, told.append)
    assert analysis.unreadable == ("runs/2/crossing.npz: truncated",)
    assert [run.seed for run in analysis.points[0].runs] == [1, 3]
    assert [point.index for point in analysis.missing] == [1]
    assert told == [1, 2, 3]


@pytest.mark.parametrize(("tolerance", "met"), [(0.5, True), (1e-4, False)])
def test_whether_the_asked_error_is_met_is_said(column, tolerance, met):
    study, finished = column
    accuracy = Accuracy(flow_rate=tolerance, max_replicates=3)
    changed = type(study)(**{**vars(study), "accuracy": accuracy, "measure": ("flow_rate",)})
    analysis = analyse(changed, finished)
    assert {result.precise for result in analysis.points} == {met}


def test_plain_data_are_strict_json_with_the_same_numbers(analysis):
    back = json.loads(to_json(analysis))
    flows = [row for row in back["points"] if row["quantity"] == "flow_rate"]
    assert [row["container.orifice"] for row in flows] == [result.orifice for result in analysis.points]
    assert flows[0]["value"] == pytest.approx(analysis.points[0].flow_rate.value, rel=1e-14)
    assert flows[0]["unit"] == "kg/s"
    assert (flows[0]["replicates"], flows[0]["runs_emptied"], flows[0]["stale"]) == (3, 3, False)
    (k,) = (row for row in back["fits"] if (row["law"], row["parameter"]) == ("beverloo", "k"))
    assert 0 < k["low"] < k["value"] < k["high"]


def test_points_that_share_a_packing_are_compared_once(synthetic):
    points = [synthetic.point(k, D) for k, D in enumerate((0.02, 0.03, 0.04))]
    entries = (ReferenceEntry("packing.packing_fraction", {}, 0.59), ReferenceEntry("flow_rate", {}, 0.05))
    study = synthetic.study_of(points, reference=Reference("nobody", entries), measure=("flow_rate", "packing"))
    found = analyse(study, [synthetic.FinishedDouble(point, seed) for point in points for seed in (1, 2)]).comparisons
    assert [c.label for c in found] == ["all points", "D = 20 mm", "D = 30 mm", "D = 40 mm"]
    # A hexagonal layer between walls 1.01 d apart: pi / (2 sqrt 3) / 1.515.
    assert found[0].ours == pytest.approx(math.pi / (2 * math.sqrt(3)) / 1.515, rel=1e-2)


def test_a_key_that_follows_from_another_is_not_told(synthetic):
    points = []
    for k, (width, count) in enumerate([(0.1, 1200), (0.1, 1200), (0.15, 1800), (0.15, 1800)]):
        D = (0.02, 0.03)[k % 2]
        point = synthetic.point(k, D, count=count)
        container = point.scene.container.model_copy(update={"width": width})
        at = {"container.width": width, "grains.count": float(count), "container.orifice": D}
        points.append(replace(point, at=at, scene=point.scene.model_copy(update={"container": container})))
    found = analyse(synthetic.study_of(points, fit=()), [synthetic.FinishedDouble(point, 1) for point in points])
    assert [result.label for result in found.points[::2]] == ["width = 100 mm, D = 20 mm", "width = 150 mm, D = 20 mm"]
    assert [series.label for series in found.series] == ["width = 100 mm", "width = 150 mm"]


@pytest.mark.parametrize("making", ["numerics.dt", "fill.friction", "grains.count"])
@pytest.mark.parametrize("first", [True, False])
def test_of_keys_that_follow_from_one_another_the_scenes_own_is_kept(synthetic, making, first):
    """Else a change by the angle would be told, and booked, as one by the time step."""
    order = (making, "container.angle") if first else ("container.angle", making)
    values = {making: (1.0, 2.0), "container.angle": (0.5, 1.5)}
    points = [replace(synthetic.point(0, 0.03), at={key: values[key][k] for key in order}) for k in (0, 1)]
    assert redundant(points) == {making}


def test_times_without_flow_are_not_averaged_over_those_runs_alone_that_had_some(synthetic, analysis):
    (first, *others), point = analysis.points[0].runs, analysis.points[0].point
    gap = Measured("gap_time", 2.0, math.nan, 1, "", "", "s", "")
    runs = (replace(first, measured={**first.measured, "gap_time": gap}), *others)
    pooled = pooled_point(analysis.study, point, frozenset(), runs).pooled
    assert "flow_rate" in pooled
    assert "gap_time" not in pooled


def test_keys_are_kept_where_neither_follows_from_the_other(synthetic):
    points = [replace(synthetic.point(0, 0.03), at={"a": a, "b": b}) for a, b in ((1, 1), (1, 2), (2, 1))]
    assert redundant(points) == frozenset()
    assert redundant(points[:1]) == frozenset()


def test_a_key_that_some_points_leave_out_is_said_to_be_unset(synthetic):
    points = [synthetic.point(k, D) for k, D in enumerate((0.02, 0.03))]
    points[1] = replace(points[1], at={**points[1].at, "container.gap": 0.006})
    found = analyse(synthetic.study_of(points, fit=()), [synthetic.FinishedDouble(point, 1) for point in points]).series
    assert [series.label for series in found] == ["gap not set", "gap = 6 mm"]
