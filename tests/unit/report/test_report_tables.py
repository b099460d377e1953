"""Tables say no more than the numbers allow."""

import json
import math
from dataclasses import replace

import pytest
from toy_results import analyse

from labbook.fit import Parameter
from labbook.measure import flow
from labbook.report import tables
from labbook.report.fitted_tables import parameter_row
from labbook.results.frames import to_json
from labbook.results.reference import Comparison


@pytest.mark.parametrize(
    ("parameter", "row"),
    [
        (Parameter(1.612, 1.03, 2.10, 0.22, ""), ("k", "1.61 ± 0.22", "1.03 to 2.10")),
        (Parameter(1000.0, 1.9, math.inf, 5e5, ""), ("k", "not determined", "1.9 to ∞")),
        (Parameter(0.1, -40.0, 60.0, 20.0, ""), ("k", "not determined", "−40 to 60")),
        (Parameter(2.0, 1.0, 3.0, 1e5, ""), ("k", "2.00", "1.00 to 3.00")),
    ],
)
def test_a_parameter_that_the_data_do_not_set_is_not_quoted(parameter, row):
    assert parameter_row("beverloo.k", parameter) == row


def test_tables_and_exports_agree_on_what_is_not_determined(analysis):
    (series,) = analysis.series
    open_ended = replace(series.fits["beverloo"].parameters["k"], high=math.inf)
    parameters = {**series.fits["beverloo"].parameters, "k": open_ended}
    fit = replace(series.fits["beverloo"], parameters=parameters)
    changed = replace(analysis, series=(replace(series, fits={**series.fits, "beverloo": fit}),))
    exported = {(row["law"], row["parameter"]): row["determined"] for row in json.loads(to_json(changed))["fits"]}
    shown = {
        (law, name): parameter_row(f"{law}.{name}", parameter)[1] != "not determined"
        for law, fit in changed.series[0].fits.items()
        for name, parameter in fit.parameters.items()
    }
    assert exported == shown
    assert not exported["beverloo", "k"]
    assert exported["beverloo", "C_particle"]


def test_rows_far_from_the_reference_are_marked():
    near = Comparison("beverloo.k", {}, "", 1.55, None, 1.56, 0.02, 1.5, 1.6)
    far = Comparison("beverloo.k", {}, "", 1.55, None, 1.65, 0.02, 1.6, 1.7)
    missing = Comparison("beverloo.k", {}, "angle = 15 deg", 1.55, None, None, why="it clogged")
    table = tables.comparison_table([near, far, missing])
    assert table.marked == {1}
    assert [row[-1] for row in table.rows] == ["yes", "no", "–"]
    assert table.rows[2][3] == "–"
    assert table.notes[-1] == "k at angle = 15 deg: it clogged."


def test_flow_and_packing_are_shown_for_every_point(analysis):
    rates, packing = tables.flow_table(analysis), tables.further_table(analysis)
    assert packing is not None
    assert rates.headings[:3] == ("D [mm]", "W [g/s]", "95 % interval")
    assert packing.headings == ("D [mm]", "φ", "φ in 2D", "ψ₆ local", "ψ₆ global")
    assert [row[0] for row in rates.rows] == ["18", "21", "24", "30", "36", "45", "52.5", "60"]
    assert all(len(row) == len(rates.headings) for row in rates.rows)


def test_points_with_the_same_further_numbers_stand_in_one_row(analysis, monkeypatch):
    """Points that share packings have one packing fraction; many values are named by the first and the last. Points
    that are not all combinations of their keys keep a row each."""
    places = [("15", "0.1"), ("15", "0.5"), ("18", "0.1"), ("18", "0.5"), ("21", "0.5")]
    assert tables._together(places[:4]) == [("15, 18", "0.1, 0.5")]
    assert tables._together(places) == places
    assert tables._together([(str(one),) for one in range(9)]) == [("0 to 8 (9 values)",)]
    monkeypatch.setattr(tables, "_cells", lambda result, measured: tuple("1" for _ in measured))
    table = tables.further_table(analysis)
    assert table is not None
    assert [row[0] for row in table.rows] == ["18 to 60 (8 values)"]


def test_too_few_grains_are_told_once_a_point_and_w_keeps_its_column(synthetic):
    """Of 80 grains fewer than 60 pass within the window."""
    points = [synthetic.point(0, 0.03, count=80), synthetic.point(1, 0.036, count=80)]
    runs = [synthetic.FinishedDouble(p, s) for p in points for s in (1, 2)]
    (first, second) = analyse(synthetic.study_of(points), runs).points
    notes = {f"too few grains: {n} of 300 left, fewer than 60 in the window": 1 for n in (113, 105, 117)}
    once = "too few grains: 105 to 117 of 300 left, fewer than 60 in the window: use more grains or a wider window"
    assert flow.merge_notes({**notes, "trending": 2}) == {once: 3, "trending": 2}
    gaps = {"1 gap without flow left out, 1.5 s together": 2, "3 gaps without flow left out, 4.02 s together": 1}
    assert flow.merge_notes(gaps) == {"1 to 3 gaps without flow left out, 1.5 to 4.02 s together": 3}
    for result in (first, second):
        assert list(result.notes.values()) == [2]
    table = tables.flow_table(analyse(synthetic.study_of(points), runs))
    assert table.headings[:3] == ("D [mm]", "W [g/s]", "95 % interval")
    for row in table.rows:
        assert row[1:3] == ("–", "–")
        assert row[-1].count("too few grains") == 1
        assert "use more grains or a wider window (2)" in row[-1]


def test_facts_on_which_runs_agree_are_told_once(synthetic):
    point = synthetic.point(0, 0.03)
    runs = [synthetic.FinishedDouble(point, seed) for seed in (1, 2, 3)]
    table = tables.provenance_table(analyse(synthetic.study_of([point]), runs))
    facts = {row[0]: row[1] for row in table.rows}
    assert facts["backend"] == "double"
    assert facts["wall time"] == "2.5 to 4.5 s, 10.5 s in all"
    assert "seed" not in facts


def test_many_numbers_of_a_reference_have_a_digest():
    def compared(quantity, ours):
        return Comparison(quantity, {}, "", 2.0, None, ours, 0.1, ours - 0.2, ours + 0.2)

    few = [compared("beverloo.k", ours) for ours in (2.1, 2.4, 1.0)]
    assert tables.digest_table(few) is None
    many = [*few * 4, compared("power.n", 2.0), Comparison("power.n", {}, "", 2.0, None, None)]
    table = tables.digest_table(many)
    assert table is not None
    assert table.rows == (("k", "12", "4", "20 %", "50 %"), ("n", "1", "1", "0 %", "0 %"))
