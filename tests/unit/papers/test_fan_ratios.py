"""Flow rates relative to a plain hopper."""

import gc
import itertools
import math
import weakref
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from toy_results import analyse

from labbook.fit import Parameter
from labbook.measure.outlet import COVERAGE
from labbook.papers import fan2023
from labbook.papers.fan2023 import figures, profiles, ratios
from labbook.papers.fan2023.laws import TERMS, brown, rose_tanaka
from labbook.papers.fan2023.pages import angle_table, approach_table, farthest
from labbook.papers.fan2023.ratios import by_angle, by_position
from labbook.results.frames import frames
from labbook.results.paper import compared
from labbook.results.reference import compare
from labbook.stats import pool
from labbook.study.schema import Reference, ReferenceEntry


def aside(synthetic, index, D, gap):
    """A point whose outlet lies `gap` from the wall; in the middle without one."""
    point = synthetic.point(index, D)
    if gap is None:
        return point
    container = point.scene.container.model_copy(update={"gap": gap})
    scene = point.scene.model_copy(update={"container": container})
    return replace(point, scene=scene, at={**point.at, "container.gap": gap})


def flow(result):
    assert result.flow_rate is not None
    return result.flow_rate


def heights(line):
    return np.asarray(line.get_ydata(), float)


@pytest.fixture(scope="module")
def angles(synthetic):
    points = [
        synthetic.point(10 * i + k, D, math.radians(angle))
        for i, angle in enumerate((30, 60, 90))
        for k, D in enumerate((0.024, 0.03))
    ]
    return analyse(synthetic.study_of(points), [synthetic.FinishedDouble(p, s) for p in points for s in (1, 2, 3)])


def test_angles_are_compared_with_the_flat_bottom_of_the_same_outlet(angles):
    found = by_angle(angles.points)
    assert len(found) == 6
    for one in found:
        flat = next(r for r in angles.points if r.orifice == one.result.orifice and r.point.scene.container.flat)
        assert one.value == pytest.approx(flow(one.result).value / flow(flat).value)
        if one.result is flat:
            assert (one.value, one.error) == (1, 0)
        else:
            relative = [flow(r).error / flow(r).value for r in (one.result, flat)]
            assert one.error == pytest.approx(one.value * math.hypot(*relative))
    assert by_position(angles.points) == []


def test_positions_are_compared_with_the_outlet_in_the_middle(synthetic):
    points = [aside(synthetic, k, 0.03, gap) for k, gap in enumerate((None, 0.0, 0.007, 0.035))]
    runs = [synthetic.FinishedDouble(p, s) for p in points for s in (1, 2)]
    analysis = analyse(synthetic.study_of(points), runs)
    found = by_position(analysis.points)
    assert [one.at for one in found] == pytest.approx([1, 0, 0.2, 1])
    assert found[0].value == 1
    assert (found[0].low, found[0].high) == (1, 1)
    alone = analyse(synthetic.study_of(points[1:]), runs[2:])
    assert by_position(alone.points) == []


def test_the_angle_factors_are_drawn_beside_them(angles):
    ax, from_brown, from_rose = figures.flow_against_angle(by_angle(angles.points)).axes
    assert from_brown.get_ylabel() == "from\nBrown [%]"
    assert from_rose.get_ylabel() == "from\nRose & Tanaka [%]"
    brown, rose = ax.lines[:2]
    assert heights(brown)[-1] == pytest.approx(1)
    assert heights(rose)[-1] == 1
    labels = ax.get_legend_handles_labels()[1]
    assert "Rose & Tanaka, $φ_{d}$ = 26.6°" in labels
    assert {"D = 24 mm", "D = 30 mm"} <= set(labels)


def _seeds(rng, mean, n) -> Any:
    return SimpleNamespace(flow_rate=pool(mean * (1 + 0.02 * rng.standard_normal(n))))


def test_intervals_of_ratios_cover():
    """Two independent means of three and six seeds each: 95 % intervals of 2000 ratios cover 92 to 98 % of the time."""
    rng = np.random.default_rng(3)
    hits = 0
    for _ in range(2000):
        above, below = (_seeds(rng, mean, n) for mean, n in ((3.0, 3), (2.0, 6)))
        one = ratios.ratio_of_points(above, below, 0.5)
        hits += one.low <= 1.5 <= one.high
    assert 0.92 <= hits / 2000 <= 0.98


def test_distances_from_the_laws_are_told(angles):
    found = by_angle(angles.points)
    table = angle_table(found)
    assert table.headings[3::3] == ("Brown", "Rose & Tanaka")
    by_label = {row[0]: row for row in table.rows}
    for one in found:
        row = by_label[one.result.label]
        assert float(row[3]) == pytest.approx(brown(one.at), abs=6e-4)
        if one.error > 0:
            assert row[5] == ("yes" if one.low <= brown(one.at) <= one.high else "no")
    worst = max(found, key=lambda one: abs(one.value / brown(one.at) - 1))
    side = "inside" if worst.low <= brown(worst.at) <= worst.high else "outside"
    runs = f"n = {len(worst.result.runs)}"
    assert f"({side} the 95 % interval, {runs}) at {worst.result.label}" in farthest(found)
    assert "standard errors" not in farthest(found)


def test_each_point_is_compared_with_the_law_of_its_own_friction(synthetic):
    points = []
    for k, (friction, angle) in enumerate(itertools.product((0.0, 0.2, 0.8), (math.radians(20), math.pi / 2))):
        point = synthetic.point(k, 0.03, angle)
        contact = point.scene.contact.model_copy(update={"friction": friction})
        scene = point.scene.model_copy(update={"contact": contact})
        points.append(replace(point, scene=scene, at={**point.at, "contact.friction": friction}))
    runs = [synthetic.FinishedDouble(p, s) for p in points for s in (1, 2, 3)]
    found = by_angle(analyse(synthetic.study_of(points), runs).points)
    laws = {one.result.at["contact.friction"]: one for one in found if one.at < 1}
    rows = {row[0]: row for row in angle_table(found).rows}
    for friction, one in laws.items():
        theirs = rows[one.result.label][6]
        if friction == 0:
            assert theirs == "–"
        else:
            assert float(theirs) == pytest.approx(rose_tanaka(one.at, math.atan(float(friction))), abs=6e-4)
    ax, *_ = figures.flow_against_angle(found).axes
    labels = ax.get_legend_handles_labels()[1]
    assert labels[:2] == ["Brown", "Rose & Tanaka"]
    points = {label: bars[0].get_color() for bars, label in zip(ax.containers, labels[2:], strict=True)}
    curves = [line.get_color() for line in ax.lines[1:3]]
    assert curves == [points["D = 30 mm, friction = 0.2"], points["D = 30 mm, friction = 0.8"]]
    assert "Rose & Tanaka" in farthest(found)


def test_ratios_have_their_laws_beside_them(synthetic):
    points = [synthetic.point(k, 0.03, angle) for k, angle in enumerate((0.5, np.pi / 2))]
    runs = [synthetic.FinishedDouble(point, seed) for point in points for seed in (1, 2)]
    found = frames(analyse(synthetic.study_of(points), runs))["ratios"].set_index("container.angle")
    assert found.loc[np.pi / 2, "value"] == 1
    assert found.loc[0.5, "brown"] == pytest.approx(brown(0.5))
    assert found.loc[0.5, "rose_tanaka"] == pytest.approx(rose_tanaka(0.5, np.arctan(0.5)))


def test_a_reference_can_name_a_ratio(synthetic):
    points = [aside(synthetic, k, 0.03, gap) for k, gap in enumerate((None, 0.0, 0.007))]
    runs = [synthetic.FinishedDouble(p, s) for p in points for s in (1, 2, 3)]
    reference = Reference("a paper", (ReferenceEntry("flow_ratio.position", {"container.gap": 0.0}, 1.3),))
    analysis = analyse(synthetic.study_of(points, reference=reference), runs)
    (compared,) = analysis.comparisons
    (ours,) = (one for one in by_position(analysis.points) if one.at == 0)
    assert (compared.ours, compared.error, compared.low) == (ours.value, ours.error, ours.low)
    ax = figures.flow_against_position(by_position(analysis.points), analysis.comparisons, "a paper").axes[0]
    (theirs,) = (line for line in ax.lines if line.get_label() == "a paper")
    assert heights(theirs) == pytest.approx([1.3])


def test_a_reference_can_name_how_a_shape_approaches_the_middle(monkeypatch, synthetic):
    """Points whose sigma1 is Fan's law: limit, depth and rate come out beside his, and in the table of it."""
    places = np.array([0, 0.1, 0.3, 0.6, 1.0])
    points = [synthetic.point(k, 0.03) for k in range(len(places))]
    runs = [synthetic.FinishedDouble(p, s) for p in points for s in (1, 2)]
    results = analyse(synthetic.study_of(points, reference=None), runs)
    found = results.points
    sigma = {id(r): v for r, v in zip(found, 0.39 - 0.12 * np.exp(-3.74 * places), strict=True)}

    def own(result, definition):
        values = {name: sigma[id(result)] if name == "sigma1" else 0.0 for name in profiles.SHAPE}
        return SimpleNamespace(parameters={name: Parameter(v, v, v, 0.01, "") for name, v in values.items()})

    aside = [ratios.Ratio(r, found[-1], s, 1.0, 0.1, 0.8, 1.2) for r, s in zip(found, places, strict=True)]
    monkeypatch.setattr(profiles, "fit_of_point", own)
    monkeypatch.setattr(fan2023, "by_position", lambda points: aside)
    stated = [ReferenceEntry(f"outlet_profiles.sigma1.{term}", {}, v) for term, v in zip(TERMS, FAN, strict=True)]
    made = compare(Reference("a paper", tuple(stated)), found, (), partial(compared, results))
    assert [c.ours for c in made] == pytest.approx(FAN, rel=0.01)
    table = approach_table(aside, COVERAGE, made, "a paper")
    assert table is not None
    rows = {row[0]: row for row in table.rows}
    assert rows["rate of σ₁(s*)"][3] == "3.74"
    assert rows["rate of δ₁(s*)"][3] == "–"
    monkeypatch.setattr(fan2023, "by_position", lambda points: aside[:3])
    (few,) = compare(Reference("a paper", tuple(stated[:1])), found, (), partial(compared, results))
    assert few.ours is None
    assert "4 distances from the wall" in few.why


def test_a_point_is_fitted_once_and_its_fit_goes_with_it(monkeypatch, synthetic):
    fits = []

    def fitted(seeds, context):
        zero = Parameter(0.0, 0.0, 0.0, 0.0, "")
        fits.append(profiles.ProfileFit(dict.fromkeys(profiles.SHAPE, zero)))
        return fits[-1]

    monkeypatch.setattr(profiles, "fit_profiles", fitted)
    point = synthetic.point(0, 0.03)
    results = analyse(synthetic.study_of([point]), [synthetic.FinishedDouble(point, s) for s in (1, 2)])
    one = ratios.Ratio(results.points[0], results.points[0], 0.0, 1.0, 0.1, 0.8, 1.2)
    for _ in range(2):
        assert profiles.approaches([one], COVERAGE)["sigma1"].of == (results.points[0],)
    assert len(fits) == 1
    kept, held = weakref.ref(fits.pop()), weakref.ref(results.points[0])
    del results, one
    gc.collect()
    assert held() is None
    assert kept() is None


FAN = (0.39, 0.12, 3.74)
