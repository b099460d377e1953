"""Sweeps over numerics: every value against the first one, by a test of equivalence."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from toy_results import analyse

from labbook.backend.numerics import Numerics
from labbook.report.page import summary, write
from labbook.report.tables import numerical_table
from labbook.results.frames import to_json
from labbook.results.numerical import summed_up
from labbook.study import Point
from labbook.study.schema import Accuracy, Fill

STEPS = (5e-6, 2.5e-6, 1e-6)


def swept(synthetic, orifices=(0.03, 0.0302, 0.035), angle=None) -> list[Point]:
    """Points that differ in their time step, and flow as through outlets of these widths."""
    at = {} if angle is None else {"container.angle": angle}
    return [
        Point(k, synthetic.scene(orifice), Fill(), Numerics(dt=dt), {**at, "numerics.dt": dt}, f"dt = {dt}")
        for k, (dt, orifice) in enumerate(zip(STEPS, orifices, strict=True))
    ]


def found(synthetic, points, margin, seeds=8, lacking=()):
    study = synthetic.study_of(points, accuracy=Accuracy(numerics=margin), replicates=seeds, reference=None, fit=())
    runs = [synthetic.FinishedDouble(p, s) for p in points for s in range(1, seeds + 1) if (p.index, s) not in lacking]
    return analyse(study, runs)


def test_every_step_is_tested_against_the_first_one_listed(synthetic):
    analysis = found(synthetic, swept(synthetic), 0.05)
    one, other = analysis.numerical
    first = [run.measured["flow_rate"].value for run in analysis.points[0].runs]
    for told, point in ((one, analysis.points[1]), (other, analysis.points[2])):
        assert told.first is analysis.points[0]
        assert told.second is point
        rates = np.array([run.measured["flow_rate"].value for run in point.runs])
        margin = 0.05 * np.mean(first)
        _, below = stats.ttest_ind(rates - margin, first, equal_var=False, alternative="less")
        _, above = stats.ttest_ind(rates + margin, first, equal_var=False, alternative="greater")
        assert told.test is not None
        assert told.test.p == pytest.approx(np.max([below, above]), rel=1e-6)
        assert told.test.difference == pytest.approx(np.mean(rates) / np.mean(first) - 1, rel=1e-12)
        assert told.test.margin == pytest.approx(0.05, rel=1e-12)
    assert [told.finding for told in (one, other)] == ["equivalent", "different"]
    assert summed_up(analysis.numerical) == (
        "Numerics: the same flow rate within ±5 % is shown in 1 of 2 comparisons, a larger difference in 1."
    )
    assert summed_up(analysis.numerical) in summary(analysis)


def test_a_wider_scatter_than_the_margin_decides_nothing(synthetic):
    analysis = found(synthetic, swept(synthetic, (0.03, 0.0302, 0.03)), 0.004, seeds=3)
    assert {told.finding for told in analysis.numerical} == {"undecided"}
    notes = " ".join(numerical_table(analysis.numerical).notes)
    assert "dt = 2.5 µs instead of 5 µs: " in notes
    assert "replicates of each would decide" in notes


def test_without_a_margin_differences_are_told_but_not_tested(synthetic):
    analysis = found(synthetic, swept(synthetic), None)
    table = numerical_table(analysis.numerical)
    assert "Equivalence is not tested: no margin is stated" in " ".join(table.notes)
    assert [row[-1] for row in table.rows] == ["–", "–"]
    assert all(row[5].endswith(" %") for row in table.rows)
    assert summed_up(analysis.numerical) == ""
    assert "p" not in json.loads(to_json(analysis))["numerics"][0]


def test_points_are_compared_only_with_those_that_are_alike_otherwise(synthetic):
    flat = swept(synthetic, angle=math.pi / 2)
    steep = [replace(p, index=p.index + 3) for p in swept(synthetic, (0.04, 0.0402, 0.045), angle=1.0)]
    analysis = found(synthetic, [*flat, *steep], 0.05, seeds=3)
    assert [(told.first.point.index, told.second.point.index) for told in analysis.numerical] == [
        (0, 1), (0, 2), (3, 4), (3, 5),
    ]  # fmt: skip
    assert [told.where for told in analysis.numerical] == ["angle = 90 deg"] * 2 + ["angle = 57.2958 deg"] * 2


def test_a_point_without_the_key_is_compared_with_none(synthetic):
    first, *others = swept(synthetic)
    analysis = found(synthetic, [replace(first, at={"container.orifice": 0.03}), *others], 0.05, seeds=3)
    assert [(told.first.point.index, told.second.point.index) for told in analysis.numerical] == [(1, 2)]


def test_points_that_lack_runs_are_not_tested(synthetic):
    lacking = {(1, 8), *((2, seed) for seed in range(1, 9))}
    (told,) = found(synthetic, swept(synthetic), 0.05, lacking=lacking).numerical
    assert told.test is None
    assert told.why == "runs are missing"
    assert numerical_table([told]).rows[0][-1] == told.why
    assert not found(synthetic, swept(synthetic), 0.05, lacking={(0, s) for s in range(1, 9)}).numerical


@pytest.mark.usefixtures("one_format")
def test_the_page_and_plain_data_show_it(synthetic, tmp_path):
    analysis = found(synthetic, swept(synthetic), 0.05)
    page = write(analysis, tmp_path).read_text(encoding="utf-8")
    assert "Do numerics matter?" in page
    assert "dt = 2.5 µs instead of 5 µs" in page
    first, second = json.loads(to_json(analysis))["numerics"]
    assert (first["finding"], second["finding"]) == ("equivalent", "different")
    assert second["low"] > 0.05


def test_runs_from_the_same_packings_are_compared_seed_by_seed(synthetic):
    shared = [replace(p, fill=Fill(numerics=Numerics(dt=5e-6))) for p in swept(synthetic)]
    analysis = found(synthetic, shared, 0.05)
    told = analysis.numerical[0]
    assert told.paired
    one, other = ({r.seed: r.measured["flow_rate"].value for r in p.runs} for p in (told.first, told.second))
    change = [other[seed] - one[seed] for seed in other]
    assert told.test is not None
    assert told.test.error == pytest.approx(stats.sem(change) / np.mean([one[seed] for seed in other]), rel=1e-9)
    assert not found(synthetic, swept(synthetic), 0.05).numerical[0].paired
