"""Error budgets of flow rates: what each source adds, and what was not measured."""

import json
import re
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from scipy import stats
from toy_results import analyse

from labbook.accuracy import Effects, calibration, groups
from labbook.backend.numerics import Numerics
from labbook.report.page import summary
from labbook.report.tables import budget_table
from labbook.results.budget import SOURCES, Budget, Share, _window, budgets, summed_up
from labbook.results.frames import to_json
from labbook.results.points import PointResult
from labbook.results.series import Series
from labbook.stats import pool
from labbook.study.schema import Fill


def found(synthetic, points, seeds=6):
    study = synthetic.study_of(points, replicates=seeds, reference=None, fit=())
    return analyse(study, [synthetic.FinishedDouble(p, s) for p in points for s in range(1, seeds + 1)])


def shares(budget):
    return {share.source: share for share in budget.shares}


def test_seeds_and_window_come_from_the_replicates(synthetic):
    results = found(synthetic, [synthetic.point(0, 0.03)])
    (budget,) = budgets(results)
    rates = np.array([run.measured["flow_rate"].value for run in results.points[0].runs])
    drifts = np.array([run.measured["flow_rate_drift"].value for run in results.points[0].runs])
    half = stats.t.ppf(0.975, len(rates) - 1) * stats.sem(rates)
    assert shares(budget)["seeds"].relative == pytest.approx(half / rates.mean(), rel=1e-9)
    reach = stats.t.ppf(0.975, len(drifts) - 1) * stats.sem(drifts)
    assert shares(budget)["window"].relative == pytest.approx(max(0, abs(drifts.mean()) - reach) / 2, abs=1e-12)
    assert f"{100 * drifts.mean():+.1f} % ± {100 * reach:.1f} %" in shares(budget)["window"].beside
    assert shares(budget)["window"].beside in " ".join(budget_table(results).rows[0])
    assert budget.total == pytest.approx(sum(s.relative for s in budget.shares if s.relative is not None), rel=1e-12)


@pytest.mark.parametrize("replicates", [3, 5])
def test_the_windows_part_is_no_noise_and_finds_a_drift(synthetic, replicates):
    """Drifts that scatter by 15 % about zero: half of their mean size is 3.5 % with 3 replicates (0.15/sqrt(3)
    sqrt(2/pi)/2) and 2.7 % with 5. Their significant part is less than a tenth of that. A drift of 30 % with a scatter
    of 5 % is found."""
    (result,) = found(synthetic, [synthetic.point(0, 0.03)]).points
    rng = np.random.default_rng(replicates)

    def part(mean: float, scatter: float) -> float:
        drift = pool(mean + scatter * rng.standard_normal(replicates))
        return _window(replace(result, pooled={**result.pooled, "flow_rate_drift": drift})).relative or 0.0

    noise = np.mean([part(0.0, 0.15) for _ in range(1000)])
    assert noise < 0.1 * 0.15 / np.sqrt(replicates) * np.sqrt(2 / np.pi) / 2
    real = np.array([part(0.3, 0.05) for _ in range(300)])
    assert np.mean(real > 0) > 0.97
    assert 0.04 < np.mean(real) < 0.15


def test_what_was_not_measured_is_said(synthetic):
    results = found(synthetic, [synthetic.point(0, 0.03)])
    (budget,) = budgets(results)
    assert budget.unmeasured == ("numerics", "filling", "bed")
    assert "not measured: numerics, filling, bed" in budget.line
    assert budget.line in summed_up([budget])


def test_a_line_says_that_its_bounds_are_no_standard_errors(synthetic):
    """The seeds' is the half-width of the interval, by Student's t, not the standard error that stands beside W."""
    results = found(synthetic, [synthetic.point(0, 0.03)])
    (budget,) = budgets(results)
    part = shares(budget)["seeds"].relative
    assert part is not None
    half = 1e3 * budget.value * part
    told = re.match(r"Bounds: W = \S+ ± (\S+) \(seeds, 95 %\) ± \S+ \(window\) g/s; not measured", budget.line)
    assert told, budget.line
    assert float(told[1]) == pytest.approx(half, rel=0.05)


def test_the_summary_has_the_budget(synthetic):
    results = found(synthetic, [synthetic.point(0, 0.03)])
    assert any("Error budget" in line or "not measured" in line for line in summary(results))


def test_one_replicate_gives_no_error_of_seeds(synthetic):
    (budget,) = budgets(found(synthetic, [synthetic.point(0, 0.03)], seeds=1))
    assert shares(budget)["seeds"].relative is None
    assert shares(budget)["seeds"].basis == "one replicate"


def test_a_sweep_of_the_study_itself_measures_its_source(synthetic):
    one = synthetic.point(0, 0.03)
    finer = replace(one, index=1, numerics=Numerics(dt=1e-6), at={**one.at, "numerics.dt": 1e-6})
    one = replace(one, at={**one.at, "numerics.dt": one.numerics.dt})
    rougher = replace(one, index=2, fill=Fill(friction=0.2), at={**one.at, "fill.friction": 0.2})
    results = found(synthetic, [replace(one, at={**one.at, "fill.friction": 0.01}), rougher])
    first, other = results.points
    assert first.flow_rate is not None
    assert other.flow_rate is not None
    part = abs(other.flow_rate.value / first.flow_rate.value - 1)
    assert shares(budgets(results)[0])["filling"].relative == pytest.approx(part, rel=1e-12)
    assert shares(budgets(found(synthetic, [one, finer]))[0])["numerics"].relative is not None


def test_the_calibration_gives_the_bias_of_numerics_that_were_not_swept(synthetic, monkeypatch):
    point = synthetic.point(0, 0.03)
    here = groups(point.scene, point.numerics.dt, 1.0)
    assert here is not None
    one = Effects(here, (0.0, 4.0, 0.0), ((0.0,) * 3,) * 3, 100, 0.02, "made up")
    monkeypatch.setattr("labbook.accuracy.choosing.shipped", lambda: calibration([one]))
    (budget,) = budgets(found(synthetic, [point]))
    from labbook.scene.timescales import collision

    step = point.numerics.dt / collision(point.scene)
    assert shares(budget)["numerics"].relative == pytest.approx(4 * step**2, rel=1e-9)
    assert "calibration" in shares(budget)["numerics"].basis


def test_table_and_frame_have_a_row_for_every_point_and_source(synthetic):
    results = found(synthetic, [synthetic.point(0, 0.03), synthetic.point(1, 0.04)])
    table = budget_table(results)
    assert len(table.rows) == 2
    assert [heading for heading in table.headings if heading in ("seeds", "numerics", "window", "filling", "bed")] == [
        "seeds", "numerics", "window", "filling", "bed",
    ]  # fmt: skip
    rows = json.loads(to_json(results))["budget"]
    assert len(rows) == 10
    assert {row["source"] for row in rows} == set(table.headings) & {row["source"] for row in rows}
    assert sum(row["part"] is None for row in rows) == 6


def test_drifts_that_single_runs_cannot_show_are_trending_together(synthetic):
    results = found(synthetic, [synthetic.point(0, 0.03)], seeds=8)
    (result,) = results.points
    drift = result.pooled["flow_rate_drift"]
    steady = replace(result, pooled={**result.pooled, "flow_rate_drift": replace(drift, value=0.04, half_width=0.01)})
    noisy = replace(result, pooled={**result.pooled, "flow_rate_drift": replace(drift, value=0.2, half_width=0.25)})
    moving = replace(result, pooled={**result.pooled, "flow_rate_drift": replace(drift, value=0.2, half_width=0.17)})
    assert [one.trending for one in (steady, noisy, moving)] == [False, False, True]


def test_packing_fractions_have_a_budget_without_a_window(analysis):
    found_of = [one for one in budgets(analysis) if one.quantity == "packing_fraction"]
    assert len(found_of) == len(analysis.points)
    for one in found_of:
        assert isinstance(one.of, PointResult)
        pooled = one.of.pooled["packing_fraction"]
        assert shares(one)["seeds"].relative == pytest.approx(pooled.half_width / pooled.value, rel=1e-12)
        assert "window" not in shares(one)
        assert one.unmeasured == ("numerics", "filling", "bed")
    assert summed_up(budgets(analysis), "packing_fraction").startswith("Of φ: seeds 0 % everywhere")


def test_parameters_move_with_numerics_as_the_flow_rates_do(synthetic):
    """At the other step there are six seeds instead of three, so that the fit is another."""
    plain = [synthetic.point(at, D) for at, D in enumerate(synthetic.DIAMETERS)]
    finer = [replace(one, index=one.index + 8, numerics=Numerics(dt=5e-6)) for one in plain]
    every = [replace(one, at={**one.at, "numerics.dt": one.numerics.dt}) for one in (*plain, *finer)]
    study = synthetic.study_of(every, reference=None, fit=("beverloo",))
    runs = [synthetic.FinishedDouble(one, seed) for one in every for seed in (1, 2, 3)]
    runs += [synthetic.FinishedDouble(run.point, run.seed + 3) for run in runs if run.point.numerics.dt == 5e-6]
    results = analyse(study, runs)
    first, other = (series.fits["beverloo"].parameters for series in results.series)
    assert first["k"].value != other["k"].value
    (of_first, of_other) = [one for one in budgets(results) if one.quantity == "beverloo.k"]
    assert shares(of_first)["numerics"].relative == pytest.approx(
        abs(other["k"].value / first["k"].value - 1), rel=1e-9
    )
    assert shares(of_other)["numerics"].relative == pytest.approx(
        abs(first["k"].value / other["k"].value - 1), rel=1e-9
    )
    half = (first["k"].high - first["k"].low) / 2
    assert shares(of_first)["seeds"].relative == pytest.approx(half / first["k"].value, rel=1e-9)
    assert of_first.unmeasured == ("filling", "bed")
    assert of_first.name == "k, beverloo"
    named = [row[0] for row in budget_table(results).rows]
    assert named.count("W") == 16
    assert named.count("k, beverloo") == named.count("C (grain density), beverloo") == 2


def test_series_may_differ_in_the_parameters_that_they_have(synthetic, monkeypatch):
    """C of the bulk density needs a packing fraction, which a small bed may lack."""
    points = [
        synthetic.point(8 * k + at, D, angle)
        for k, angle in enumerate((1.0, 1.5))
        for at, D in enumerate(synthetic.DIAMETERS)
    ]
    runs = [synthetic.FinishedDouble(one, seed) for one in points for seed in (1, 2, 3)]
    results = analyse(synthetic.study_of(points, reference=None, fit=("beverloo",)), runs)
    whole, (first, _) = Series.parameters, results.series
    monkeypatch.setattr(
        Series, "parameters",
        lambda self, law: {name: one for name, one in whole(self, law).items() if self is not first or name != "k"},
    )  # fmt: skip
    quantities = [one.quantity for one in budgets(results)]
    assert quantities.count("beverloo.k") == 1
    assert quantities.count("beverloo.C_particle") == 2


def test_without_another_setting_numerics_of_a_parameter_are_not_measured(analysis):
    of_fits = [one for one in budgets(analysis) if "." in one.quantity]
    assert of_fits
    assert all(one.unmeasured == ("numerics", "filling", "bed") for one in of_fits)


def test_what_is_the_same_at_all_points_has_one_row_and_nothing_known_is_no_error_of_nothing(synthetic, analysis):
    rows = budget_table(analysis).rows
    assert [row[:2] for row in rows if row[0] == "φ"] == [("φ", "all")]
    assert [row[0] for row in rows].count("W") == len(analysis.points)
    (row,) = budget_table(found(synthetic, [synthetic.point(0, 0.03)], seeds=1)).rows
    assert row[-1] == row[4], "the window alone is known"
    nothing = [row for row in rows if set(row[2:-1]) == {"–"}]
    assert all(row[-1] == "–" for row in nothing)


def test_a_budget_of_which_nothing_is_known_says_what_was_not_measured():
    """Of several points: it began with a semicolon."""
    shares = tuple(Share(source, None, "not measured") for source in SOURCES)
    found = [Budget("packing_fraction", cast(Any, None), 0.6, shares) for _ in range(2)]
    assert summed_up(found, "packing_fraction").startswith("Of φ: not measured: ")
