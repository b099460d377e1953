"""Flow rates against a swept key: on made-up runs whose ratio is known, and whose scatter is that of their packings."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from toy_results import RunDouble

from labbook.backend.numerics import Numerics
from labbook.report import figures
from labbook.report.against import against_table, changes
from labbook.results.against import Against, against, rows
from labbook.results.points import FLOW_RATE, PointResult, RunResult
from labbook.scene import HertzMindlin, Scene, Spheres, WedgeHopper
from labbook.stats import Measured, pool
from labbook.study import Point
from labbook.study.schema import Fill, Window

FRICTION, LENGTH, LAW, D = "contact.friction", "grains.length", "contact.damping", "container.orifice"
COMMON, OWN = 0.08, 0.004  # standard deviations: of what a packing does to W, and of what is a run's own


def one_packing(index: int, seed: int) -> str:
    return f"packing {seed}"


def packing_of_its_own(index: int, seed: int) -> str:
    return f"packing {index}, {seed}"


def result(
    index: int,
    at: Mapping[str, float | str],
    flows: Mapping[int, float],
    packing: Callable[[int, int], str] = one_packing,
    outcomes: Mapping[int, str] | None = None,
    asked: int = 1,
) -> PointResult:
    """A point with the flow rate [kg/s] of each seed."""
    scene = Scene(
        grains=Spheres(diameter=0.003, density=2500, count=400),
        contact=HertzMindlin(shear_modulus=1e8, poisson_ratio=0.25, friction=0.5, restitution=0.2),
        container=WedgeHopper(width=0.1, height=0.4, thickness=0.00303, orifice=0.03),
    )
    point = Point(index, scene, Fill(), Numerics(dt=1e-5), at, "")
    ended = dict.fromkeys(flows, "finished") | dict(outcomes or {})
    doubles = [RunDouble(point, seed, how, packing(index, seed)) for seed, how in ended.items()]
    runs = tuple(
        RunResult(run, measured(flows.get(run.seed)), ("flow_rate",), Window(), run.entry.outcome != "diverged")
        for run in doubles
    )
    kept = [flow for seed, flow in flows.items() if (outcomes or {}).get(seed) != "diverged"]
    pooled = {FLOW_RATE: pool(kept)} if kept else {}
    return PointResult(point, at, runs, pooled, None, asked)


def measured(flow: float | None) -> dict[str, Measured]:
    if flow is None:
        return {}
    return {FLOW_RATE: Measured(FLOW_RATE, flow, math.nan, math.nan, "the window", "counted", "kg/s")}


def flows(rng: np.random.Generator, mean: float, packings: np.ndarray) -> dict[int, float]:
    """W of seeds 1 ... of runs that start from packings with these factors."""
    own = 1 + OWN * rng.standard_normal(len(packings))
    return {seed: float(w) for seed, w in enumerate(mean * packings * own, start=1)}


def two(rng: np.random.Generator, ratio: float, packing: Callable[[int, int], str], n: int = 5) -> Against:
    """Two frictions of n seeds; those that share packings also share what these do to W."""
    factors = [1 + COMMON * rng.standard_normal(n) for _ in range(2)]
    mine = factors[0] if packing is one_packing else factors[1]
    first = result(0, {FRICTION: 0.1}, flows(rng, 0.03, factors[0]), packing)
    other = result(1, {FRICTION: 0.5}, flows(rng, 0.03 * ratio, mine), packing)
    (found,) = against([first, other])
    return found


def ratio_of(found: Against, line: int = 0, place: int = 1):
    one = found.lines[line].points[place]
    assert one.ratio is not None
    return one.ratio, one.pairs


def test_runs_that_share_a_packing_are_paired_and_what_it_does_divides_out():
    """Own scatter 0.4 % of both in 5 pairs: a standard error of about 0.8 * 0.4 % * sqrt(2/5) = 0.002."""
    ratio, pairs = ratio_of(two(np.random.default_rng(1), 0.8, one_packing))
    assert pairs == 5
    assert ratio.value == pytest.approx(0.8, abs=0.008)
    assert 0.0005 < ratio.error < 0.005
    assert ratio.low < 0.8 < ratio.high


def test_runs_from_packings_of_their_own_are_not_paired_though_their_seeds_are_equal():
    """Scatter 8 % of both in 5 runs each: a standard error of about 0.8 * 8 % * sqrt(2/5) = 0.04."""
    ratio, pairs = ratio_of(two(np.random.default_rng(1), 0.8, packing_of_its_own))
    assert pairs == 0
    assert 0.01 < ratio.error < 0.1
    assert ratio.low < 0.8 < ratio.high


@pytest.mark.parametrize("packing", [one_packing, packing_of_its_own])
def test_intervals_hold_the_ratio_in_95_percent(packing):
    """1000 draws: 0.95 +- 0.007 at one standard error. Welch's degrees of freedom and the linearised ratio are
    approximations, which with 8 % scatter in 5 runs may add a percent."""
    rng, held, draws = np.random.default_rng(7), 0, 1000
    for _ in range(draws):
        ratio, _ = ratio_of(two(rng, 0.7, packing))
        held += ratio.low <= 0.7 <= ratio.high
    assert 0.925 < held / draws < 0.975


def test_seeds_without_a_partner_are_left_out_and_few_pairs_among_many_are_no_pairs():
    seeds = {seed: 0.02 + 0.001 * seed for seed in range(1, 7)}
    first = result(0, {FRICTION: 0.1}, seeds)
    short = result(1, {FRICTION: 0.3}, {s: 0.9 * seeds[s] for s in (2, 4, 6)})
    some = result(2, {FRICTION: 0.5}, seeds, lambda index, seed: f"{seed}" if seed > 2 else f"packing {seed}")
    (found,) = against([first, short, some])
    assert ratio_of(found, place=1)[1] == 3
    assert ratio_of(found, place=1)[0].value == pytest.approx(0.9)
    assert ratio_of(found, place=2)[1] == 0  # two of six


def test_one_run_that_both_share_a_packing_with_is_a_pair_and_the_text_says_so():
    """Of two runs at rest one clogged: a ratio to the other has no interval, so its own packing alone is compared."""
    rest = result(0, {FRICTION: 0.1}, {2: 0.040}, outcomes={1: "clogged"})
    turning = result(1, {FRICTION: 0.5}, {1: 0.020, 2: 0.032})
    (found,) = against([rest, turning])
    ratio, pairs = ratio_of(found)
    assert (pairs, ratio.value) == (1, pytest.approx(0.8))
    assert math.isnan(ratio.error)
    assert changes(found) == [
        "W at friction = 0.5 is 80 % of that at 0.1 (1 pair: no interval; at 0.1: 1 of 2 clogged)."
    ]
    assert "1 pair" in against_table(found).rows[1]
    main, below = figures.against_key(found).axes
    hollow = [[line.get_markerfacecolor() == "white" for line in markers(ax)] for ax in (main, below)]
    assert hollow == [[True, False], [True, True]], "a ratio to a point with a remark is hollow too"
    assert below.get_ylim() == pytest.approx((0.8, 1), abs=0.02), "what has no interval takes no room for one"


def markers(ax) -> list[Any]:
    """Marked points from left to right."""
    marked = [line for line in ax.lines if line.get_marker() == "o" and len(line.get_xdata()) == 1]
    return sorted(marked, key=lambda line: float(np.asarray(line.get_xdata())[0]))


def test_the_value_listed_first_is_what_others_are_compared_with():
    points = [result(k, {FRICTION: mu}, {1: w, 2: w}) for k, (mu, w) in enumerate(((0.5, 2.0), (0.1, 4.0), (0.9, 1.0)))]
    (found,) = against(points)
    (line,) = found.lines
    assert found.values == (0.1, 0.5, 0.9)
    assert [place.ratio.value if place.ratio else None for place in line.points] == [2.0, None, 0.5]
    assert line.first is line.points[1]
    assert [row["over"] for row in rows([found])] == [0.5, 0.5]
    (stated,) = against(points, references={FRICTION: 0.9})
    assert [place.ratio.value if place.ratio else None for place in stated.lines[0].points] == [4.0, 2.0, None]


def test_every_value_of_another_key_has_a_line_and_the_orifice_no_section():
    points = [
        result(2 * k + i, {FRICTION: mu, D: orifice}, {1: 0.01 * (k + 1), 2: 0.011 * (k + 1)})
        for k, mu in enumerate((0.1, 0.3, 0.5))
        for i, orifice in enumerate((0.02, 0.03))
    ]
    (found,) = against(points)
    assert found.key == FRICTION
    assert [dict(line.at) for line in found.lines] == [{D: 0.02}, {D: 0.03}]
    assert [len(line.points) for line in found.lines] == [3, 3]


def test_words_keep_the_order_of_the_study():
    points = [result(k, {LAW: word}, {1: 1.0 + k, 2: 1.1 + k}) for k, word in enumerate(("textbook", "clamped"))]
    (found,) = against(points)
    assert found.words
    assert found.values == ("textbook", "clamped")
    below = figures.against_key(found).axes[1]
    assert [tick.get_text() for tick in below.get_xticklabels()] == ["textbook", "clamped"]


def test_a_point_that_gave_no_flow_is_shown_as_such_and_is_no_reference():
    points = [
        result(0, {FRICTION: 0.9}, {}, outcomes={1: "clogged", 2: "clogged"}),
        result(1, {FRICTION: 0.5}, {1: 2.0, 2: 2.2}),
        result(2, {FRICTION: 0.1}, {1: 4.0, 2: 4.4}),
    ]
    (found,) = against(points)
    assert found.lines[0].first is not None
    assert found.lines[0].first.value == 0.5
    table = against_table(found)
    assert [row[0] for row in table.rows] == ["0.1", "0.5", "0.9"]
    assert table.rows[2][1:4] == ("–", "–", "–")
    assert "2 of 2 clogged" in table.rows[2][-1]
    (crossed,) = [line for line in figures.against_key(found).axes[0].lines if line.get_marker() == "x"]
    assert list(np.asarray(crossed.get_xdata())) == [0.9]


def test_a_diverged_run_does_not_count():
    first = result(0, {FRICTION: 0.1}, {1: 2.0, 2: 2.2, 3: 2.1})
    other = result(1, {FRICTION: 0.5}, {1: 1.0, 2: 1.1, 3: 99.0}, outcomes={3: "diverged"})
    (found,) = against([first, other])
    ratio, pairs = ratio_of(found)
    assert pairs == 2
    assert ratio.value == pytest.approx(0.5)


def test_a_key_that_never_varies_alone_is_shown_with_what_changes_along():
    points = [
        result(k, {LENGTH: length, D: 5 * length}, {1: length, 2: length}) for k, length in enumerate((0.004, 0.006))
    ]
    (found,) = against(points)
    assert found.along == (D,)
    assert len(found.lines) == 1
    assert ratio_of(found)[0].value == pytest.approx(1.5)


def test_what_was_run_at_one_value_only_has_no_line():
    settings = [("full", 0.0), ("full", 0.01), ("full", 0.1), ("rolling", 0.01)]
    points = [result(k, {LAW: law, FRICTION: friction}, {1: 1.0, 2: 1.1}) for k, (law, friction) in enumerate(settings)]
    found = {one.key: one for one in against(points)}
    assert [dict(line.at) for line in found[LAW].lines] == [{FRICTION: 0.01}]
    assert [dict(line.at) for line in found[FRICTION].lines] == [{LAW: "full"}]


def test_points_at_which_the_key_has_no_value_are_named():
    points = [result(k, {LENGTH: length}, {1: 1.0, 2: 1.1}) for k, length in enumerate((0.004, 0.006))]
    points.append(result(2, {}, {1: 1.0, 2: 1.1}))  # spheres have no length
    (found,) = against(points)
    assert found.unset == (points[2],)


def test_one_value_is_no_sweep_and_one_run_has_no_interval():
    assert against([result(0, {FRICTION: 0.1}, {1: 1.0})]) == ()
    (found,) = against([result(k, {FRICTION: mu}, {1: 1.0 + k}) for k, mu in enumerate((0.1, 0.2))])
    ratio, _ = ratio_of(found)
    assert ratio.value == 2
    assert math.isnan(ratio.error)
    assert "(1 pair: no interval)" in changes(found)[0]
    (found,) = against([result(k, {FRICTION: mu}, {1: 1.0 + k}, packing_of_its_own) for k, mu in enumerate((0.1, 0.2))])
    assert "(one run: no interval)" in changes(found)[0]
    assert figures.against_key(found).axes


def bars(container) -> Any:
    """Markers, caps and lines of error bars."""
    return container.lines


def test_what_is_drawn_is_what_was_found():
    rng = np.random.default_rng(3)
    factors = 1 + COMMON * rng.standard_normal(4)
    points = [result(k, {FRICTION: mu}, flows(rng, w, factors)) for k, (mu, w) in enumerate(((0.1, 0.03), (0.4, 0.02)))]
    (found,) = against(points)
    main, below = figures.against_key(found).axes
    drawn = [bars(container)[0] for container in main.containers]
    values = [point.pooled[FLOW_RATE] for point in points]
    np.testing.assert_allclose([np.asarray(one.get_ydata())[0] for one in drawn], [w.value * 1e3 for w in values])
    np.testing.assert_allclose([np.asarray(one.get_xdata())[0] for one in drawn], [0.1, 0.4], atol=0.01)
    (bar,) = below.containers  # the first is 1 without an error
    segment = bars(bar)[2][0].get_segments()[0][:, 1]
    ratio, _ = ratio_of(found)
    np.testing.assert_allclose(segment, [ratio.low, ratio.high])
    assert main.get_ylabel() == "W [g/s]"
    assert below.get_ylabel() == "W / W at 0.1"


def test_intervals_are_whole_or_marked_where_they_are_cut():
    """Two pairs whose ratios scatter by 2 % are shown whole; by 40 %, beside 1 %, an arrowhead tells of the rest."""
    base = {1: 1.0, 2: 1.0}
    for scatter, cuts in ((0.02, 0), (0.4, 2)):
        points = [result(0, {FRICTION: 0.1}, base), result(1, {FRICTION: 0.3}, {1: 0.9 - scatter, 2: 0.9 + scatter})]
        (found,) = against(points)
        ratio, _ = ratio_of(found)
        figure = figures.against_key(found)
        low, high = figure.axes[1].get_ylim()
        assert (low < ratio.low and ratio.high < high) == (cuts == 0)
        marks = [str(line.get_marker()) for line in figure.axes[1].lines if line.get_label() == "_cut"]
        assert sorted(marks) == ["^", "v"][:cuts]
        assert figures.has_cuts(figure) == bool(cuts)


def test_many_lines_of_two_other_keys_are_parted_into_panels():
    points, index = [], 0
    for orifice in (0.02, 0.03, 0.04, 0.05):
        for law in ("clamped", "textbook"):
            for mu in (0.1, 0.5):
                high = 5.0 if law == "textbook" else 1.0
                points.append(result(index, {D: orifice, LAW: law, FRICTION: mu}, {1: high + mu, 2: high + mu}))
                index += 1
    found = {one.key: one for one in against(points)}[FRICTION]
    assert len(found.lines) == 8
    shown = figures.against_key(found)
    assert [ax.get_title(loc="left") for ax in shown.axes[:2]] == ["damping = clamped", "damping = textbook"]
    assert {ax.get_ylim()[1] > 5.5e3 for ax in shown.axes[:2]} == {True}, "both show the largest of all, in g/s"
    assert [text.get_text() for text in shown.legends[0].get_texts()] == [f"D = {mm} mm" for mm in (20, 30, 40, 50)]


def test_many_lines_are_told_by_their_changes_and_not_by_ratios():
    """W falls by 41, 35, 30 and 28 % from 20 to 90 deg: the largest and the smallest fall, each with its error."""
    falls = {0.1: 0.41, 0.2: 0.35, 0.4: 0.30, 0.8: 0.28}
    points = []
    for mu, fall in falls.items():
        for angle, part in ((20, 1.0), (90, 1 - fall)):
            at = {"container.angle": math.radians(angle), FRICTION: mu}
            points.append(
                result(len(points), at, {s: part * (1 + 0.02 * (s - 2)) for s in (1, 2, 3)}, packing_of_its_own)
            )
    found = {one.key: one for one in against(points)}["container.angle"]
    # standard errors: 2 %/sqrt(3) of both, so 59 % and 72 % times 1.63 %
    assert changes(found) == [
        "W falls by 41.00 ± 0.96 % from 20 to 90 deg at friction = 0.1, by 28.0 ± 1.2 % at friction = 0.8."
    ]
    assert "Largest" not in changes(found)[0]


def test_a_line_that_rests_on_one_run_does_not_lead():
    points = []
    for k, mu in enumerate((0.1, 0.2, 0.4, 0.8)):
        points.append(
            result(len(points), {D: 0.02, FRICTION: mu, LENGTH: 0.004}, {1: 1.0, 2: 1.02}, packing_of_its_own)
        )
        last = {1: 0.2} if k == 3 else {1: 0.9, 2: 0.91}
        points.append(result(len(points), {D: 0.02, FRICTION: mu, LENGTH: 0.006}, last, packing_of_its_own))
    found = {one.key: one for one in against(points)}[LENGTH]
    (said,) = changes(found)
    assert said.startswith("W falls by 10.4")
    assert said.endswith("1 of 4 lines rest on one run and have no interval.")


def test_keys_that_vary_together_are_all_named():
    """Spheres against rods of equal volume: length and diameter, which follow from one another."""
    sizes = ((0.004071, 0.004071), (0.006, 0.003))
    points = [
        replace(
            result(k, {LENGTH: length}, {1: 1.0 + k, 2: 1.1 + k}),
            along={"grains.diameter": d, "grains.count": 100.0 + k},
        )
        for k, (length, d) in enumerate(sizes)
    ]
    assert points[1].label == "L = 6 mm, d = 3 mm"
    (found,) = against(points)
    assert found.along == ("grains.diameter", "grains.count")
    (said,) = changes(found)
    assert said.startswith("W at L = 6 mm, d = 3 mm is ")
    assert " % of that at L = 4.071 mm, d = 4.071 mm (" in said
    table = against_table(found)
    assert table.headings[:3] == ("L [mm]", "d [mm]", "count")
    assert table.rows[1][:3] == ("6", "3", "101")
    assert figures.against_key(found).axes[1].get_xlabel() == "L [mm] (with d)"


def test_sentences_say_where_the_change_is_largest_and_whether_there_is_one():
    seeds = (0.98, 1.0, 1.02)
    points = [
        result(k, {FRICTION: mu}, {s: w * one for s, one in enumerate(seeds)}, packing_of_its_own)
        for k, (mu, w) in enumerate(((0.1, 1.0), (0.3, 0.8), (0.5, 0.7)))
    ]
    (said,) = changes(against(points)[0])
    assert said.startswith("W at friction = 0.5 is 70.0 ± 1.1 % of that at 0.1 (95 %: ")
    assert said.endswith(", independent runs).")
    (same,) = changes(against([points[0], result(1, {FRICTION: 0.3}, {1: 0.97, 2: 1.03}, packing_of_its_own)])[0])
    assert same.endswith("; no change is shown.")
