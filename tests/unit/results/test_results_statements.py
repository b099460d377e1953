"""Statements of a paper: when one holds, and the row that tells how it fares at several places."""

import pytest
from toy_results import analyse
from turning_runs import state

from labbook.report.statement_tables import statement_digest
from labbook.results.statements import LACKING, Judged, summed_up
from labbook.study.schema import Reference


def test_a_verdict_needs_the_whole_interval_on_one_side():
    stated = state("rotation.grain_rate", 0.95, 1.05)
    for low, high, verdict in ((0.96, 1.04, "holds"), (0.9, 1.0, "undecided"), (1.06, 1.2, "does not hold")):
        assert Judged(stated, "", (low + high) / 2, 0.01, low, high).verdict == verdict
    assert Judged(stated, "", 1.0).verdict == "undecided"


def test_statements_on_points_that_lack_runs_stay_open(synthetic):
    """Of runs that began together the first to end flow fast. A fit is judged, and a note names the points."""
    stated = (state("flow_rate.flow_rate", 0.001, 1.0, **{}), state("beverloo.k", -100, 100))
    points = [synthetic.point(k, D) for k, D in enumerate(synthetic.DIAMETERS)]
    runs = [synthetic.FinishedDouble(point, seed) for point in points for seed in (1, 2, 3)]
    for replicates, verdict in ((3, "holds"), (10, "undecided")):
        study = synthetic.study_of(points, replicates=replicates, reference=Reference("Them", (), stated))
        rates = [one for one in analyse(study, runs).judged if one.statement is stated[0]]
        assert {one.verdict for one in rates} == {verdict}
        assert {one.why for one in rates} == ({LACKING} if replicates == 10 else {""})
        (fitted,) = [one for one in analyse(study, runs).judged if one.statement is stated[1]]
        assert fitted.verdict == "holds"


@pytest.mark.parametrize(
    ("intervals", "summary"),
    [
        (((0.96, 1.04), (0.97, 1.03)), "1 holds, 0 do not, and 0 are undecided"),
        (((0.96, 1.04), (0.9, 1.0)), "0 hold, 0 do not, and 1 is undecided"),
        (((0.9, 1.0), (0.96, 1.04), (1.06, 1.2)), "0 hold, 1 does not, and 0 are undecided"),
    ],
)
def test_a_statement_on_several_points_counts_once(intervals, summary):
    stated = state("rotation.grain_rate", 0.95, 1.05)
    judged = [Judged(stated, f"f = {k} Hz", 1.0, 0.01, *ends) for k, ends in enumerate(intervals)]
    assert summed_up(judged, "Them") == f"Of 1 statement of Them, {summary}."


def test_of_a_statement_on_several_places_a_row_tells_how_it_fares_there():
    def judged(stated, *places):
        return [Judged(stated, f"f = {k} Hz", one, 0.01, one - 0.02, one + 0.02) for k, one in enumerate(places)]

    low, few, mixed = (state("rotation.grain_rate", *ends) for ends in ((0.5, 0.9), (0.9, 1.1), (0.8, 1.0)))
    table = statement_digest([*judged(low, 0.7, 0.6), *judged(few, 1.0), *judged(mixed, 0.99, 0.9, 0.5)])
    assert table is not None
    assert [row[1:] for row in table.rows] == [
        ("0.5 to 0.9", "0.600 to 0.700", "holds at all 2"),
        ("0.9 to 1.1", "1.000", "holds"),
        ("0.8 to 1", "0.500 to 0.990", "does not hold at 1 of 3"),
    ]
    assert table.marked == {2}
    nothing = [Judged(low, "here", None), Judged(low, "there", None)]
    table = statement_digest(nothing)
    assert table is not None
    assert table.rows[0][1:] == ("0.5 to 0.9", "–", "undecided at all 2")
    assert statement_digest([*judged(low, 0.7), *judged(few, 1.0)]) is None, "the full table says it"
