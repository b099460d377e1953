"""That longer grains drop more: made-up runs with known drops, at the same orifice and at the same D/d*."""

import math
from dataclasses import replace
from itertools import product

import pytest
from toy_results import analyse
from turning_runs import ROD, SPHERE, F, Run, point, state

from labbook.papers.pongo2022.rotation import WITH_LENGTH, aspect_ratio, gained, neighbours, rotations_of
from labbook.study.schema import Reference

WIDE = (8e-3, 20e-3)
LIMITS = ((0.3, math.inf), (0, 0.3), (-0.2, 0.2))


@pytest.fixture(scope="module")
def analysis(synthetic):
    places = [*product((SPHERE, WIDE, ROD), (0.06,), F), *((WIDE, 0.07178, f) for f in F)]
    points = [point(k, f, size, D) for k, (size, D, f) in enumerate(places)]
    stated = tuple(state("rotation.grain_rate.drop_with_length", low, high) for low, high in LIMITS)
    stated = (
        *stated,
        replace(stated[0], at={"grains.length": 9.9e-3}),
        state("rotation.grain_rate.rise_with_length", 0.2),
    )
    study = synthetic.study_of(points, fit=(), reference=Reference("someone", (), stated), replicates=8)
    return analyse(study, [Run(p, seed) for p in points for seed in range(1, 9)])


def test_each_shape_is_held_against_the_next_shorter_one(analysis):
    found = [
        (round(aspect_ratio(short.points[0]), 2), round(aspect_ratio(long.points[0]), 2), short.orifice, where)
        for short, long, where in neighbours(rotations_of(analysis))
    ]
    assert found == [
        (1.0, 2.5, 0.06, "D = 60 mm"),
        (1.0, 2.5, 0.06, "D/d* = 6.06"),
        (2.5, 3.33, 0.06, "D = 60 mm"),
        (2.5, 3.33, 0.07178, "D/d* = 6.06"),
    ]


@pytest.mark.parametrize(("feature", "of_rods"), [("drop_with_length", 0.51), ("rise_with_length", 0.28)])
def test_the_gain_is_the_difference_of_both_with_an_error_of_both(analysis, feature, of_rods):
    """Rods of both lengths drop by a half and rise by 30 %, spheres rise at once by 1 % and then by 2 % more."""
    pairs = list(neighbours(rotations_of(analysis)))
    for short, long, _ in pairs:
        gain = gained(short, long, "grain_rate", feature)
        below, above = (WITH_LENGTH[feature](one, "grain_rate") for one in (short, long))
        assert gain is not None
        assert below is not None
        assert above is not None
        assert gain.value == pytest.approx(above.value - below.value)
        assert gain.error == pytest.approx(math.hypot(below.error, above.error))
        expected = of_rods if short.shape == "spheres" else 0.0
        assert abs(gain.value - expected) < 4 * gain.error
        assert max((below, above), key=lambda one: one.error).half_width < gain.half_width < 3 * gain.error


def test_statements_are_judged_by_each_pair_of_which_the_longer_is_there(analysis):
    above, within, none, of_spheres, rising = (
        [one for one in analysis.judged if one.statement is stated] for stated in analysis.study.reference.statements
    )
    assert [one.verdict for one in above] == ["holds", "holds", "does not hold", "does not hold"]
    assert [one.verdict for one in within] == ["does not hold", "does not hold", "undecided", "undecided"]
    assert [one.verdict for one in none] == ["does not hold", "does not hold", "holds", "holds"]
    assert [one.verdict for one in rising] == ["holds", "holds", "does not hold", "does not hold"]
    assert above[0].label == "rods, L/d = 2.5 less spheres, D = 60 mm"
    (alone,) = of_spheres
    assert (alone.ours, alone.verdict) == (None, "undecided"), "nothing is shorter than a sphere"


def test_runs_that_are_lacking_decide_nothing(synthetic, analysis):
    points = analysis.study.points
    stated = (state("rotation.grain_rate.drop_with_length", 0.3),)
    study = synthetic.study_of(points, fit=(), reference=Reference("someone", (), stated), replicates=8)
    ended = [Run(p, seed) for p in points for seed in range(1, 9) if p.index or seed < 8]
    found = analyse(study, ended).judged
    assert [one.ours is None for one in found] == [True, True, False, False]
    assert "runs are missing" in found[0].why
