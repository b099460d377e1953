"""Flow against the rotation of the bottom, and statements of a paper, from made-up runs with known answers."""

import json
import math
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest
from toy_results import analyse
from turning_runs import ROD, RODS, ROUND, SPHERE, STATED, F, Run, point, state

from labbook.papers.pongo2022 import figures
from labbook.papers.pongo2022.pages import sentence
from labbook.papers.pongo2022.rotation import Rotation, rotations_of
from labbook.papers.pongo2022.statements import judged
from labbook.report import page
from labbook.report.against import found_against
from labbook.report.statement_tables import statement_table
from labbook.results.frames import frames, to_json
from labbook.results.statements import summed_up
from labbook.stats import pool
from labbook.study.schema import Reference, Window


@pytest.fixture(scope="module")
def analysis(synthetic):
    places = product((ROD, SPHERE), (0.05, 0.06), F)
    points = [point(k, f, size, D) for k, (size, D, f) in enumerate(places)]
    study = synthetic.study_of(
        points, fit=("power", "exponential"), reference=Reference("Pongó et al. 2022", (), STATED), name="turning"
    )
    return analyse(study, [Run(p, seed) for p in points for seed in range(1, 9)])


def curve(analysis, shape, D) -> Any:
    return next(one for one in rotations_of(analysis) if one.shape.startswith(shape) and one.orifice == D)


def test_points_are_grouped_by_shape_and_outlet_spheres_first(analysis):
    found = [(one.shape, one.label, tuple(one.frequencies)) for one in rotations_of(analysis)]
    assert found == [
        (shape, label, F) for shape in ("spheres", "rods, L/d = 3.33") for label in ("D = 50 mm", "D = 60 mm")
    ]


def test_ratios_are_those_of_equal_seeds_and_far_better_known_than_means(analysis):
    rods = curve(analysis, "rods", 0.06)
    for k, f in enumerate(F):
        ratio = rods.ratio("grain_rate", k)
        assert abs(ratio.value - RODS[f] / 600) < 4 * max(ratio.error, 1e-12)
    means = rods.points[2].pooled["grain_rate"]
    ratio = rods.ratio("grain_rate", 2)
    assert (ratio.n, ratio.confidence) == (8, 0.9)
    assert ratio.error / ratio.value < 0.3 * means.error / means.value
    spheres = curve(analysis, "spheres", 0.06).ratio("grain_rate", 3)
    assert abs(spheres.value - 1.03) < 4 * spheres.error


def test_the_minimum_is_found_and_its_interval_is_as_wide_as_the_doubt(analysis):
    rods = curve(analysis, "rods", 0.06)
    assert rods.lowest() == 2
    found = rods.minimum()
    assert (found.frequency, found.low, found.high) == (0.32, 0.32, 0.32)
    # two frequencies of the same rate cannot be told apart
    level = replace(rods, points=(rods.points[0], rods.points[2], replace_rate(rods.points[2], 0.64)))
    assert (level.minimum().low, level.minimum().high) == (0.32, 0.64)


def test_the_interval_of_the_minimum_holds_the_true_one(analysis):
    """Four seeds of two frequencies whose means differ by a half, one and two of their standard errors: of 400 draws,
    90 % or more intervals hold the lower one (they are discrete, so that more than 90 % may)."""
    rods, rng = curve(analysis, "rods", 0.06), np.random.default_rng(2)
    for apart in (0.5, 1.0, 2.0):
        held = 0
        for _ in range(400):
            drawn = [made_of(rods.points[k], base + 10 * rng.standard_normal(4)) for k, base in enumerate((600, 330))]
            drawn.append(made_of(rods.points[2], 330 + apart * 5 * math.sqrt(2) + 10 * rng.standard_normal(4)))
            found = Rotation(tuple(drawn)).minimum()
            held += found is not None and found.low <= 0.16
        assert held / 400 > 0.9 - 3 * math.sqrt(0.9 * 0.1 / 400)


def test_of_a_negative_quantity_the_smallest_in_size_counts(analysis):
    """As v_z above the orifice, which falls at 0.32 Hz as Q does."""
    rods = curve(analysis, "rods", 0.06)
    speeds = [[-one.runs[k].measured["grain_rate"].value for k in range(8)] for one in rods.points]
    downwards = Rotation(tuple(made_of(one, values) for one, values in zip(rods.points, speeds, strict=True)))
    assert downwards.lowest() == rods.lowest() == 2
    assert downwards.minimum() == rods.minimum()
    (drop,) = judged(state("rotation.grain_rate.drop", 0), [downwards])
    assert drop.ours == pytest.approx(0.5, abs=0.02)


def made_of(result, values):
    """The point with these flow rates of its first seeds."""
    like = result.runs[0].measured["grain_rate"]
    runs = tuple(
        replace(run, measured={"grain_rate": replace(like, value=float(value))})
        for run, value in zip(result.runs, values, strict=False)
    )
    return replace(result, runs=runs, pooled={"grain_rate": pool(values)})


def replace_rate(result, f):
    """The point with the flow rates of its seeds in another order, as if measured at f."""
    order = [run.seed for run in result.runs]
    runs = tuple(
        replace(run, run=Run(run.run.point, seed)) for run, seed in zip(result.runs, order[1:] + order[:1], strict=True)
    )
    return replace(result, at={**result.at, "container.rotation": f}, runs=runs)


def test_clogged_and_diverged_runs_take_no_part(synthetic):
    points = [point(k, f) for k, f in enumerate((0.0, 0.32))]
    how = {(1, 2): "clogged", (1, 3): "diverged"}
    runs = [Run(p, seed, how.get((p.index, seed), "finished")) for p in points for seed in (1, 2, 3, 4, 5)]
    (found,) = rotations_of(analyse(synthetic.study_of(points, fit=(), reference=None), runs))
    ratio = found.ratio("grain_rate", 1)
    assert ratio is not None
    assert ratio.n == 3
    assert found.lowest() is None
    assert "of that at rest" in sentence(found)


def test_statements_hold_fail_or_stay_open(analysis):
    found = {(one.statement.quantity, one.statement.low, one.label): one for one in analysis.judged}
    where = "rods, L/d = 3.33, D = 60 mm"
    assert found["rotation.grain_rate.drop", 0, where].verdict == "holds"
    assert found["rotation.grain_rate.drop", 0, where].ours == pytest.approx(0.5, abs=0.02)
    assert found["rotation.grain_rate.minimum", 0.16, where].verdict == "holds"
    assert found["rotation.grain_rate.rise", 1, where].verdict == "holds"
    assert found["rotation.grain_rate.rise", 1, where].ours == pytest.approx(1.3, abs=0.05)
    assert found["rotation.grain_rate.drop", 0.6, where].verdict == "does not hold"
    for f in F[1:]:
        assert found["rotation.grain_rate", 0.95, f"spheres, D = 60 mm, f = {f:g} Hz"].verdict == "holds"
    missing = found["rotation.orifice_O_zz", -math.inf, where]
    assert (missing.verdict, missing.ours) == ("undecided", None)
    assert "not measured" in missing.why
    table = statement_table(analysis.judged)
    assert len(table.rows) == len(analysis.judged) == 2 * 5 + 6
    assert table.rows[2][2] == "0.16 to 0.32 Hz"
    assert [table.rows[k][-1] for k in table.marked] == ["does not hold"] * 2
    assert summed_up(analysis.judged, "Them").startswith("Of 6 statements of Them, 4 hold, 1 does not, and 1 is")


def test_a_flow_that_only_grows_neither_drops_nor_has_its_minimum_where_stated(synthetic):
    """Spheres, held against what is said of rods."""
    stated = [replace(one, at=ROUND) for one in STATED[:3]]
    points = [point(k, f, SPHERE) for k, f in enumerate(F)]
    reference = Reference("Them", (), tuple(stated))
    analysis = analyse(
        synthetic.study_of(points, fit=(), reference=reference), [Run(p, seed) for p in points for seed in range(1, 9)]
    )
    drop, minimum, rise = analysis.judged
    assert drop.ours is not None
    assert drop.ours < 0
    assert drop.verdict != "holds"
    assert minimum.ours == 0
    assert minimum.verdict != "holds"
    assert rise.ours == pytest.approx(1.03 / 1.01, abs=0.02)


def test_where_a_minimum_is_stated_the_study_has_to_look(synthetic):
    """Of 0, 0.32 and 1.28 Hz none lies at 0.1 to 0.2 Hz: whether the minimum does remains open."""
    stated = replace(state("rotation.grain_rate.minimum", 0.1, 0.2), at=ROUND)
    points = [point(k, f, SPHERE) for k, f in enumerate((0.0, 0.32, 1.28))]
    analysis = analyse(
        synthetic.study_of(points, fit=(), reference=Reference("Them", (), (stated,))),
        [Run(p, seed) for p in points for seed in range(1, 9)],
    )
    (judged,) = analysis.judged
    assert judged.verdict == "undecided"
    assert "no frequency" in judged.why
    assert summed_up(analysis.judged, "Them").startswith("Of 1 statement of Them, 0 hold, ")


def test_points_that_lack_runs_are_shown_hollow_and_judged_by_none(synthetic):
    """Of four seeds three have ended at 0.16 Hz and none at 0.32 Hz: what is said of 1.28 Hz stands."""
    points = [point(k, f) for k, f in enumerate(F)]
    ended = [Run(p, seed) for p, n in zip(points, (4, 3, 0, 4), strict=True) for seed in range(1, n + 1)]
    stated = tuple(state(f"rotation.grain_rate{name}", 0, 1) for name in ("", ".drop", ".minimum"))
    study = synthetic.study_of(points, fit=(), reference=Reference("someone", (), stated), replicates=4)
    found = analyse(study, ended)
    assert [one.remark for one in found.points] == ["", "3 of 4 runs so far", ""]
    assert rotations_of(found)[0].unfinished == (0.16, 0.32)
    slow, fast, drop, minimum = found.judged
    assert (slow.ours, slow.verdict, fast.verdict) == (None, "undecided", "holds")
    assert (drop.ours, minimum.ours) == (None, None)
    assert drop.why.endswith("(f = 0.16, 0.32 Hz)")
    assert "missing at f = 0.16, 0.32 Hz" in sentence(rotations_of(found)[0])
    assert any("(3 of 4)" in text for text in page.summary(found))
    for ax in figures.flow_against_rotation(rotations_of(found)).axes:
        hollow = [line for line in ax.lines if line.get_markerfacecolor() == "white"]
        assert [float(np.asarray(line.get_xdata(), float)[0]) for line in hollow] == [0.16]


def test_rods_that_turn_upright_to_radial_exchange_one_for_the_other(synthetic):
    points = [point(k, f) for k, f in enumerate((0.0, 0.16))]
    study = synthetic.study_of(points, fit=(), reference=None, replicates=2)
    (found,) = rotations_of(analyse(study, [Run(p, s) for p in points for s in (1, 2)]))

    def oriented(result, zz, rr):
        runs = []
        for run in result.runs:
            shift = 0.01 * run.seed
            like = run.measured["grain_rate"]
            more = {
                "orifice_O_zz": replace(like, value=zz + shift),
                "orifice_O_rr": replace(like, value=rr - shift / 2),
            }
            runs.append(replace(run, measured={**run.measured, **more}))
        pooled = {name: result.pooled["grain_rate"] for name in ("orifice_O_zz", "orifice_O_rr", "grain_rate")}
        return replace(result, runs=tuple(runs), pooled=pooled)

    turned = replace(found, points=(oriented(found.points[0], 0.5, 0.3), oriented(found.points[1], 0.4, 0.38)))
    stated = state("rotation.orifice_O_rr.for_O_zz", 0.5, 2)
    (one,) = judged(stated, [turned])
    assert one.ours == pytest.approx(0.8)
    assert one.verdict == "holds"


def test_figures_show_every_curve(analysis):
    flow = figures.flow_against_rotation(rotations_of(analysis))
    assert [ax.get_title(loc="left") for ax in flow.axes[:2]] == ["spheres", "rods, L/d = 3.33"]
    ratios = flow.axes[3].containers[1][0]
    np.testing.assert_allclose(np.asarray(ratios.get_xdata(), float), F)
    np.testing.assert_allclose(np.asarray(ratios.get_ydata(), float), [RODS[f] / 600 for f in F], atol=0.02)
    shapes = figures.drop_and_rise(rotations_of(analysis))
    assert [text.get_text() for text in shapes.legends[0].get_texts()] == ["D = 50 mm", "D = 60 mm"]
    first = shapes.axes[0].containers[1][0]
    np.testing.assert_allclose(np.asarray(first.get_xdata(), float), [1, 20 / 6])
    np.testing.assert_allclose(np.asarray(first.get_ydata(), float), [1, 0.5], atol=0.03)
    scaling = figures.flow_scaling([one for one in analysis.series if one.used])
    assert [ax.get_title(loc="left") for ax in scaling.axes[:4]] == [f"f = {f:g} Hz" for f in F]
    assert [text.get_text() for text in scaling.legends[0].get_texts()] == ["rods, L/d = 3.33", "spheres", "slope 5/2"]


def without(analysis, places):
    """Rotations whose points at these indices have no flow rate."""
    (found,) = rotations_of(analysis)
    points = [
        replace(one, runs=tuple(replace(run, measured={}) for run in one.runs), pooled={}) if k in places else one
        for k, one in enumerate(found.points)
    ]
    return replace(found, points=tuple(points))


def test_ratios_are_drawn_only_where_there_is_a_flow_rate_at_rest(synthetic):
    points = [point(k, f) for k, f in enumerate((0.0, 0.16, 0.32))]
    study = synthetic.study_of(points, fit=(), reference=None, replicates=2)
    analysis = analyse(study, [Run(p, s) for p in points for s in (1, 2)])
    (found,) = rotations_of(analysis)
    assert len(figures.flow_against_rotation([found]).axes) == 2
    turning_only = without(analysis, {0})
    assert (turning_only.flows, turning_only.rated) == (True, False)
    (above,) = figures.flow_against_rotation([turning_only]).axes
    assert above.get_ylabel() == "$Q$ [grains/s]"
    assert not without(analysis, {0, 1, 2}).flows


@pytest.mark.usefixtures("one_format")
def test_without_any_flow_rate_nothing_is_drawn_and_the_reason_is_said(synthetic, tmp_path):
    """Too few grains pass within the window: of 1300 that leave fewer than 60 do between 0.01 and 0.03."""
    points = [point(k, f) for k, f in enumerate((0.0, 0.32))]
    window = Window(start=0.01, end=0.03)
    study = synthetic.study_of(points, fit=(), reference=None, window=window, measure=("flow_rate", "orifice"))
    text = page.write(analyse(study, [Run(p, s, filmed=s == 1) for p in points for s in (1, 2)]), tmp_path).read_text()
    assert not (tmp_path / "rotation-flow.svg").exists()
    few = "fewer than 60 grains flowed out within the window (use more grains or a wider window)."
    for what in (
        "Q against f is not drawn: ",
        "Accelerations are not shown: ",
        "no maps at f = 0 Hz, f = 0.32 Hz, as ",
    ):
        assert what + few in text
    assert f"Means above the orifice are not shown: {few}" in text
    assert "among the measures" not in text
    assert "frames 100 ms apart" not in text


@pytest.mark.slow
@pytest.mark.usefixtures("one_format")
def test_the_page_shows_them_and_says_what_is_lacking(analysis, tmp_path):
    text = page.write(analysis, tmp_path).read_text(encoding="utf-8")
    assert "Against the rotation of the bottom" in text
    assert "Statements of Pongó et al. 2022" in text
    assert "does not hold" in text
    for lacking in ("add `record:", "need `orifice` among the measures", "Q against D needs several outlets"):
        assert lacking in text
    assert (tmp_path / "rotation-flow.svg").exists()
    assert (tmp_path / "rotation-shapes.svg").exists()
    stated = json.loads(to_json(analysis))["statements"]
    assert stated[0]["verdict"] == "holds"
    assert (stated[2]["to"], stated[0]["to"]) == (0.32, 0.7)


def test_both_texts_on_one_ratio_rest_on_the_same_runs(synthetic):
    """A run at rest clogged: the other has one partner at each frequency."""
    points = [point(k, f) for k, f in enumerate((0.0, 0.16, 0.32))]
    runs = [Run(p, s, "clogged" if (p.index, s) == (0, 1) else "finished") for p in points for s in (1, 2)]
    found = analyse(synthetic.study_of(points, fit=(), reference=None, replicates=2), runs)
    (rotation,), (swept,) = rotations_of(found), found_against(found)
    paired = rotation.ratio("grain_rate", 2)
    assert paired is not None
    (place,) = (one for line in swept.lines for one in line.points if one.value == 0.32)
    assert place.ratio is not None
    assert (paired.n, place.pairs) == (1, 1)
    assert place.ratio.value == pytest.approx(paired.value, rel=1e-6)
    assert sentence(rotation).endswith(
        "Each ratio rests on runs of equal seed: 1 pair at 0.32 Hz (at rest: 1 of 2 clogged)."
    )
    for ax in figures.flow_against_rotation([rotation]).axes:
        hollow = [line for line in ax.lines if line.get_markerfacecolor() == "white"]
        assert 0.0 in [float(np.asarray(line.get_xdata(), float)[0]) for line in hollow]


def test_exports_hold_ratios_and_statements(analysis):
    tables = frames(analysis)
    rows = tables["rotation"]
    rows = rows[(rows["quantity"] == "grain_rate") & (rows["container.orifice"] == 0.06) & (rows["shape"] != "spheres")]
    np.testing.assert_allclose(rows["ratio"], [RODS[f] / 600 for f in F[1:]], atol=0.02)
    assert set(rows["pairs"]) == {8}
    assert list(tables["statements"]["verdict"]).count("does not hold") == 2
    assert "accelerations" not in tables


def test_sentences_say_what_turning_does(analysis):
    text = sentence(curve(analysis, "rods", 0.06))
    assert text.startswith("rods, L/d = 3.33, D = 60 mm: Q falls to ")
    assert "at 0.32 Hz (90 % interval 0.32 to 0.32 Hz)" in text
    assert "Q is smallest at rest and reaches" in sentence(curve(analysis, "spheres", 0.06))
