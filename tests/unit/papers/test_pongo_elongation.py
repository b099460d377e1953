"""Drop and rise of the flow against length and outlet, and kappa against the rotation: made-up runs, known trends."""

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from toy_results import analyse
from turning_runs import LENGTH, ROD, ROUND, SPHERE, F, Run, point, state

from labbook.papers.pongo2022.rotation import along_rotation
from labbook.study.schema import Reference

WIDE, THIN = (8e-3, 20e-3), (5e-3, 20e-3)
SEEDS = (1, 2, 3)
OUTLETS = (0.05, 0.06, 0.07)
DROP, RISE = 0.3, -20.0
"""Slopes of ln(Q(0)/Q_min) by L/d, and of ln(Q(1.28 Hz)/Q_min) by D [1/m]."""


class Trending(Run):
    """A run whose flow is slower while turning, the longer its rods, and rises less, the wider its outlet."""

    def data(self):
        made, scene = super().data(), self.point.scene
        length, f = scene.grains.aspect_ratio, float(self.point.at["container.rotation"])
        faster = -DROP * (length - 2.5) * (f > 0) + RISE * (scene.container.outlets[0].width - 0.06) * (f == F[-1])
        left = made.tables["crossing"]
        return replace(made, tables={"crossing": {**left, "time": left["time"] / math.exp(faster)}})


PLACES = [*product((WIDE, ROD, THIN), OUTLETS, F)]


def found(synthetic, *statements, of: type[Run] = Trending, places=PLACES, fit=(), leave_out=()):
    points = [point(k, f, size, D) for k, (size, D, f) in enumerate(places)]
    study = synthetic.study_of(points, fit=fit, reference=Reference("someone", (), statements), replicates=SEEDS[-1])
    runs = [of(p, seed) for p in points for seed in SEEDS if (p.index, seed) not in leave_out]
    return [[one for one in analyse(study, runs).judged if one.statement is stated] for stated in statements]


def test_one_plane_gives_the_trends_with_length_and_outlet(synthetic):
    known = {"drop_with_length": DROP, "drop_with_orifice": 0.0, "rise_with_length": 0.0, "rise_with_orifice": RISE}
    near = [0.05 if name.endswith("length") else 2.0 for name in known]
    ends = [(truth - one, truth + one) for truth, one in zip(known.values(), near, strict=True)]
    stated = [state(f"rotation.grain_rate.{name}", *two) for name, two in zip(known, ends, strict=True)]
    beyond = [state(one.quantity, one.high) for one in stated]
    judged = found(synthetic, *stated, *beyond)
    for (there,), truth, one in zip(judged[:4], known.values(), near, strict=True):
        assert (there.label, there.verdict) == ("9 of 9 curves", "holds"), there.statement.quantity
        assert there.ours == pytest.approx(truth, abs=min(one / 2, 4 * there.error))
    assert [one.verdict for (one,) in judged[4:]] == ["does not hold"] * 4


def test_a_trend_needs_several_sizes_and_whole_curves(synthetic):
    stated = state("rotation.grain_rate.drop_with_length", 0)
    one_length = [place for place in PLACES if place[0] == ROD]
    ((alone,),) = found(synthetic, stated, places=one_length)
    assert (alone.verdict, alone.ours) == ("undecided", None)
    assert "length does not vary" in alone.why
    ((lacking,),) = found(synthetic, stated, leave_out={(0, 3)})
    assert (lacking.label, lacking.verdict) == ("8 of 9 curves", "holds")
    ((others,),) = found(synthetic, replace(stated, at=ROUND))
    assert others.ours is None


def test_spheres_count_where_the_statement_speaks_of_them(synthetic):
    """Rods drop by a half, spheres by nothing: a plane through both rises with length, one through rods does not."""
    places = [*product((SPHERE, WIDE, ROD), OUTLETS, F)]
    stated = state("rotation.grain_rate.drop_with_length", 0.1)
    ((all_shapes,), (rods,)) = found(synthetic, stated, replace(stated, at=LENGTH), of=Run, places=places)
    assert (all_shapes.verdict, rods.verdict) == ("holds", "does not hold")
    assert rods.ours == pytest.approx(0.0, abs=0.05)


def test_a_parameter_of_a_law_is_compared_along_the_rotation(synthetic):
    """ln Q rises with D by some 50/m, and by 20/m less at the fastest rotation."""
    falls, grows = state("rotation.exponential.kappa", high=1), state("rotation.exponential.kappa", 1)
    (low, high) = found(synthetic, falls, grows, fit=("exponential",))
    assert [one.ours for one in low] == [pytest.approx(0.6, abs=0.05)] * 3
    assert [one.verdict for one in low] == ["holds"] * 3
    assert [one.verdict for one in high] == ["does not hold"] * 3
    assert "d = 8 mm" in low[2].label


def test_the_line_along_the_rotation_gives_the_ratio_with_honest_intervals():
    f, truth, rng = [0.16, 0.32, 0.64, 0.96, 1.28], 0.8, np.random.default_rng(1)
    rate = math.log(truth) / (f[-1] - f[0])
    inside = 0
    for _ in range(2000):
        kappa = 0.09 * np.exp(rate * np.array(f) + 0.05 * rng.standard_normal(5))
        ratio, error, low, high = along_rotation(f, kappa.tolist())
        inside += low <= truth <= high
        assert low < ratio < high
        assert error > 0
    assert inside / 2000 == pytest.approx(0.9, abs=0.02)
