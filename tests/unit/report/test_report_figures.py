"""Figures show the numbers of the analysis, and are the same bytes every time."""

# pyright: reportAttributeAccessIssue=false, reportArgumentType=false, reportIndexIssue=false, reportCallIssue=false

import math
import re
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from typing import ClassVar

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.container import ErrorbarContainer
from matplotlib.text import Text
from toy_results import analyse

from labbook.fit import Parameter
from labbook.report import figures, style
from labbook.report.against import found_against
from labbook.report.figures.arrangement import ENTRIES, arranged
from labbook.report.sections import fit_caption
from labbook.report.style import INK
from labbook.results.recorded import acceleration
from labbook.results.series import FurtherFit, Series

ANGLE, FRICTION = "container.angle", "contact.friction"


def test_points_lie_at_d_and_w_to_the_two_thirds(analysis):
    (series,) = analysis.series
    main, below = figures.flow_against_orifice(series).axes
    drawn = np.array([bars[0].get_xydata()[0] for bars in main.containers])
    expected = [[r.orifice * 1e3, (r.flow_rate.value * 1e3) ** (2 / 3)] for r in series.points]
    np.testing.assert_allclose(drawn, expected, rtol=1e-12)
    residuals = np.array([bars[0].get_ydata()[0] for bars in below.containers[:8]])
    fit = series.fits["beverloo"].predict([r.orifice for r in series.points])[0]
    np.testing.assert_allclose(
        residuals, [100 * (r.flow_rate.value / w - 1) for r, w in zip(series.points, fit, strict=True)]
    )
    assert len(below.containers) == 8 * len(series.fits)
    ends = np.array([bars[2][0].get_segments()[0][:, 1] for bars in below.containers[:8]])
    halves = [100 * r.flow_rate.half_width / w for r, w in zip(series.points, fit, strict=True)]
    np.testing.assert_allclose(np.ptp(ends, axis=1) / 2, halves)


def test_a_band_without_bounds_leaves_the_frame_to_points_and_curves(analysis):
    class Boundless:
        law = analysis.series[0].fits["beverloo"].law
        parameters: ClassVar = {}
        D, W, relative_error = (
            getattr(analysis.series[0].fits["beverloo"], name) for name in ("D", "W", "relative_error")
        )

        def band(self, at, *, new_point=False):
            return np.full(len(at), 0.1), np.zeros(len(at)), np.full(len(at), 1e9)

    (series,) = analysis.series
    main, _ = figures.flow_against_orifice(replace(series, fits={"beverloo": Boundless()})).axes
    largest = max(r.flow_rate.high for r in series.points)
    assert (largest * 1e3) ** (2 / 3) < main.get_ylim()[1] < 2 * (max(largest, 0.1) * 1e3) ** (2 / 3)


@pytest.fixture(scope="module")
def clogging(synthetic):
    """6 to 12 mm clog in all of four runs, 15 mm in three; three wider outlets flow."""
    points = [synthetic.point(k, D) for k, D in enumerate((0.006, 0.009, 0.012, 0.015, 0.018, 0.024, 0.03))]
    runs = [
        synthetic.FinishedDouble(one, seed, "clogged" if one.index < 3 or (one.index == 3 and seed < 4) else "emptied")
        for one in points
        for seed in (1, 2, 3, 4)
    ]
    return analyse(synthetic.study_of(points), runs)


def test_clogged_outlets_stay_visible_beside_the_fit(clogging):
    (series,) = clogging.series
    main, _ = figures.flow_against_orifice(series).axes
    crosses = [float(np.asarray(line.get_xdata())[0]) for line in main.lines if line.get_marker() == "x"]
    assert crosses == [6, 9, 12]
    assert [text.get_text() for text in main.texts if text.get_rotation() == 90] == ["4 of 4 clogged"] * 3
    assert "Cross at the foot: no flow rate." in fit_caption(series)
    (all_series,) = figures.overview(clogging.series).axes
    assert sum(line.get_marker() == "x" for line in all_series.lines) == 3


def test_law_and_band_end_at_the_fitted_points_and_dots_go_on_to_the_zero(clogging):
    (series,) = clogging.series
    main, _ = figures.flow_against_orifice(series).axes
    for band in main.collections:
        if band.get_paths() and len(band.get_paths()[0].vertices) > 100:
            assert band.get_paths()[0].vertices[:, 0].min() == pytest.approx(15)
    (law,) = [line for line in main.lines if line.get_label() == "Beverloo"]
    assert np.asarray(law.get_xdata())[[0, -1]] == pytest.approx([15, 30])
    curves = [line for line in main.lines if line.get_color() == law.get_color() and len(line.get_xdata()) > 2]
    dotted = [line for line in curves if line is not law]
    below = min(dotted, key=lambda line: np.asarray(line.get_xdata()).min())
    assert np.asarray(below.get_xdata()).max() == pytest.approx(15)
    assert below.get_linestyle() != "-"


def test_one_survivor_is_hollow_with_an_open_bar_in_every_figure(clogging):
    (series,) = clogging.series
    for figure in (figures.flow_against_orifice(series), figures.overview(clogging.series)):
        assert style.has_open_bars(figure)
        for ax in figure.axes:
            bars = [float(np.asarray(line.get_xdata())[0]) for line in ax.lines if line.get_label() == style.OPEN_BAR]
            assert bars == pytest.approx([15] * len(bars), abs=0.2)
            drawn = [line for line in ax.lines if line.get_marker() in ("o", "s") and len(line.get_xdata()) == 1]
            hollow = {
                round(float(np.asarray(line.get_xdata())[0])) for line in drawn if line.get_markerfacecolor() == "white"
            }
            assert hollow == {15}
    assert "Dashed bar: one run, the interval is unknown." in fit_caption(series)
    notes = series.fits["beverloo"].notes
    assert "1 of 4 points from one run; 3 clogged runs left out: survivors are biased to fast flow" in notes


def test_the_legend_shows_the_marker_of_the_series_and_not_of_its_first_point(clogging):
    (series,) = clogging.series
    main, _ = figures.flow_against_orifice(series).axes
    handles, labels = main.get_legend_handles_labels()
    assert handles[labels.index("labbook")].get_markerfacecolor() == INK


def test_residuals_have_the_errors_of_the_test_within_their_intervals(analysis):
    """chi2 of the thick bars is that of the fit."""
    (series,) = analysis.series
    fit = series.fits["beverloo"]
    residuals = series.residuals("beverloo")
    assert sum((math.log1p(one.value) / (one.error / (1 + one.value))) ** 2 for one in residuals) == pytest.approx(
        fit.chi2
    )
    _, below = figures.flow_against_orifice(series).axes
    thick = [np.asarray(line.get_ydata()) for line in below.lines if line.get_linewidth() > 2]
    np.testing.assert_allclose(
        [np.ptp(ends) / 200 for ends in thick[: len(residuals)]], [one.error for one in residuals]
    )


def test_the_reference_is_drawn_where_it_has_a_flow_rate(analysis):
    (series,) = analysis.series
    main, _ = figures.flow_against_orifice(series, analysis.comparisons, "Fan et al. 2023").axes
    (line,) = [line for line in main.lines if line.get_label() == "Fan et al. 2023"]
    np.testing.assert_allclose(np.asarray(line.get_xydata()), [[30, 56 ** (2 / 3)]])


def test_every_point_has_its_panel_with_window_and_replicates(analysis):
    (series,) = analysis.series
    panels = figures.flow_against_time(series).axes
    assert [ax.get_title(loc="left") for ax in panels] == [f"D = {r.orifice * 1e3:g} mm" for r in series.points]
    for ax, result in zip(panels, series.points, strict=True):
        assert len(ax.lines) == 4  # three replicates and the mean
        window = np.mean([run.trace.window for run in result.runs], axis=0)
        np.testing.assert_allclose(np.asarray(ax.lines[-1].get_xdata()), window)
        np.testing.assert_allclose(np.asarray(ax.lines[-1].get_ydata()), result.flow_rate.value * 1e3)


def test_a_figure_of_too_few_grains_has_no_window_and_no_mean_in_its_legend(analysis, synthetic):
    point = synthetic.point(0, 0.03, count=80)
    few = analyse(synthetic.study_of([point]), [synthetic.FinishedDouble(point, s) for s in (1, 2)])
    for found, names in ((few, ["replicates"]), (analysis, ["replicates", "pooled mean, 95 % interval", "window"])):
        (legend,) = figures.flow_against_time(found.series[0]).legends
        assert [text.get_text() for text in legend.get_texts()] == names


def bars(ax):
    """Points with error bars."""
    return [found for found in ax.containers if isinstance(found, ErrorbarContainer)]


def test_series_at_the_same_orifice_stand_side_by_side_in_the_overview(synthetic):
    points = [synthetic.point(2 * i + k, D, 0.5 * (i + 1)) for i in range(2) for k, D in enumerate((0.024, 0.03))]
    found = analyse(synthetic.study_of(points), [synthetic.FinishedDouble(p, s) for p in points for s in (1, 2)])
    (ax,) = figures.overview(found.series).axes
    at = sorted(float(np.asarray(bar.lines[0].get_xdata(), float)[0]) for bar in bars(ax))
    np.testing.assert_allclose(at, [24, 24, 30, 30], atol=0.1)
    assert at[1] - at[0] > 0.05
    (alone,) = figures.overview(found.series[:1]).axes
    assert [float(np.asarray(bar.lines[0].get_xdata(), float)[0]) for bar in bars(alone)] == [24, 30]


def test_parameters_are_drawn_against_what_was_swept(synthetic):
    angles = [math.radians(a) for a in (30, 60, 90)]
    points = [synthetic.point(10 * i + k, D, a) for i, a in enumerate(angles) for k, D in enumerate((0.02, 0.03, 0.04))]
    runs = [synthetic.FinishedDouble(point, seed) for point in points for seed in (1, 2)]
    analysis = analyse(synthetic.study_of(points), runs)
    figure = figures.parameters_against("container.angle", "beverloo", analysis.series, analysis.comparisons)
    k = next(ax for ax in figure.axes if ax.get_ylabel() == "k")
    marked = [line for line in k.lines if line.get_marker() not in ("D", "None", "_", "|", "")]
    np.testing.assert_allclose([np.asarray(line.get_xdata())[0] for line in marked], [30, 60, 90])
    ours = [series.fits["beverloo"].parameters["k"].value for series in analysis.series]
    np.testing.assert_allclose([np.asarray(line.get_ydata())[0] for line in marked], ours)
    (reference,) = [line for line in k.lines if line.get_marker() == "D"]
    np.testing.assert_allclose(np.asarray(reference.get_xydata()), [[90, 1.55]])


@pytest.mark.parametrize("kind", style.FORMATS)
def test_a_figure_is_the_same_bytes_whenever_and_wherever_it_is_made(analysis, kind):
    import matplotlib

    (series,) = analysis.series
    first = style.encode(figures.flow_against_orifice(series), kind)
    with matplotlib.rc_context({"font.size": 23, "svg.hashsalt": "other", "axes.facecolor": "red"}):
        second = style.encode(figures.flow_against_orifice(series), kind)
    assert first == second
    assert not re.search(rb"20\d\d-\d\d-\d\d|D:20\d\d", first)


def test_every_series_looks_different():
    looks = [tuple(map(str, style.look(k).values())) for k in range(49)]
    assert len(set(looks)) == 49


def test_an_axis_from_zero_leaves_room_above_values_that_hardly_differ():
    from matplotlib.figure import Figure

    left, right = Figure().subplots(1, 2, sharey=True)
    left.plot([0, 1], [799, 800])
    right.plot([0, 1], [700, 820])
    style.from_zero(left)
    assert right.get_ylim()[0] == 0
    assert right.get_ylim()[1] == pytest.approx(1.05 * 820)


def test_points_without_a_fit_have_no_panel_of_residuals(analysis):
    (series,) = analysis.series
    (main,) = figures.flow_against_orifice(replace(series, fits={})).axes
    assert len(main.containers) == len(series.points)
    assert main.get_xlabel() == "orifice, $D$ [mm]"


def grid_of(synthetic, angles, frictions, replicates=1):
    """One outlet at many angles and frictions."""
    points = []
    for angle in angles:
        for mu in frictions:
            point = synthetic.point(len(points), 0.03, angle)
            points.append(replace(point, at={"container.angle": angle, "contact.friction": mu}))
    runs = [synthetic.FinishedDouble(p, s, recorded=True) for p in points for s in range(1, replicates + 1)]
    return analyse(synthetic.study_of(points, fit=()), runs)


def texts_of(legend):
    return [text.get_text() for text in legend.get_texts()]


def test_sixteen_curves_are_four_panels_with_a_legend_of_four_entries():
    ats = [{ANGLE: angle, FRICTION: mu} for angle in (0.3, 0.6, 1.0, 1.5) for mu in (0.1, 0.3, 0.5, 0.8)]
    found = arranged(ats, [str(at) for at in ats])
    assert [len(members) for members in found.panels.values()] == [4] * 4
    assert len(found.entries) == 4
    for members in found.panels.values():
        assert len({tuple(found.looks[k][name] for name in ("color", "marker", "linestyle")) for k in members}) == 4
    assert found.bar is None


@pytest.mark.parametrize("angles", [1, 5])
def test_more_values_than_a_legend_holds_have_a_colour_bar(angles):
    ats = [{ANGLE: 0.1 * (k + 1), FRICTION: 0.05 * (j + 1)} for k in range(angles) for j in range(9)]
    found = arranged(ats, [str(at) for at in ats])
    assert len(found.panels) == angles
    assert not found.entries
    assert found.bar == (FRICTION, tuple(sorted({at[FRICTION] for at in ats})))
    lightness = [sum(found.looks[k]["color"][:3]) for k in next(iter(found.panels.values()))]
    assert lightness == sorted(lightness), "told apart in grey too"


def test_words_have_panels_and_numbers_colours():
    ats = [{"contact.law": law, FRICTION: mu} for law in ("a", "b") for mu in (0.1, 0.2, 0.3, 0.4)]
    found = arranged(ats, [str(at) for at in ats])
    assert [len(members) for members in found.panels.values()] == [4, 4]
    words = [{"contact.law": str(k)} for k in range(8)]
    assert all(len(members) == 1 for members in arranged(words, [str(at) for at in words]).panels.values())


@pytest.mark.slow
def test_no_legend_lies_over_data_in_a_study_of_many_points(synthetic):
    found = grid_of(synthetic, (0.5, 1.5), (0.1, 0.3, 0.5, 0.8))
    profiles = [(one, profile) for one in found.points if (profile := acceleration(one)) is not None]
    assert len(profiles) == 8
    drawn = [figures.acceleration_against_height(profiles, 9.81), figures.against_key(found_against(found)[1])]
    for figure in drawn:
        FigureCanvasAgg(figure).draw()
        assert not any(ax.get_legend() for ax in figure.axes)
        for legend in figure.legends:
            assert 1 < len(texts_of(legend)) <= ENTRIES
            assert not any(legend.get_window_extent().overlaps(ax.get_window_extent()) for ax in figure.axes)


def test_flow_over_two_keys_is_a_grid_with_one_scale_a_row_and_names_at_its_margins(synthetic):
    found = grid_of(synthetic, (0.5, 1.0), (0.1, 0.3, 0.5))
    whole = Series({}, found.points, {}, frozenset(), frozenset(), (), ())
    figure = figures.flow_against_time(whole)
    axes = np.array(figure.axes).reshape(2, 3)
    titles = [[ax.get_title(loc="left") for ax in row] for row in axes]
    assert titles == [["friction = 0.1", "friction = 0.3", "friction = 0.5"], [""] * 3]
    sides = [row[-1].texts[-1].get_text() for row in axes]
    assert sides == ["angle = 28.6479 deg", "angle = 57.2958 deg"]
    for row in axes:
        assert len({ax.get_ylim() for ax in row}) == 1
    for (row, column), ax in np.ndenumerate(axes):
        result = found.points[3 * row + column]
        np.testing.assert_allclose(np.asarray(ax.lines[-1].get_ydata()), result.flow_rate.value * 1e3)


def test_the_line_of_beverloo_goes_down_to_k_d_on_the_axis(analysis):
    (series,) = analysis.series
    fit = series.fits["beverloo"]
    expected = fit.parameters["k"].value * fit.context.d * 1e3
    figure = figures.flow_against_orifice(series)
    main = figure.axes[0]
    (mark,) = [line for line in main.lines if line.get_marker() == "|"]
    assert (mark.get_xdata()[0], mark.get_ydata()[0]) == pytest.approx((expected, 0))
    assert f"= {expected:.3g} mm" in texts_of(figure.legends[0])[-1]
    curve = [line for line in main.lines if line.get_color() == mark.get_color() and len(line.get_xdata()) > 10]
    lowest = min(curve, key=lambda line: line.get_xdata().min())
    assert lowest.get_xdata().min() == pytest.approx(expected, rel=1e-6)
    assert "Bar on the axis: k d" in fit_caption(series)


def test_both_bands_are_named_at_their_right_end(analysis):
    (series,) = analysis.series
    figure = figures.flow_against_orifice(series)
    FigureCanvasAgg(figure).draw()
    main = figure.axes[0]
    names = {text.get_text(): text for text in main.texts}
    assert names.keys() == {"law", "one more\npoint"}
    assert names["law"].xy[0] == pytest.approx(60)
    boxes = [Text.get_window_extent(text) for text in names.values()]  # without the lines that lead to them
    assert not boxes[0].overlaps(boxes[1])
    assert all(box.x0 > main.get_window_extent().x1 for box in boxes)


def test_text_of_svg_is_text_in_the_fonts_of_journals(analysis):
    (series,) = analysis.series
    drawn = style.encode(figures.flow_against_orifice(series), "svg").decode()
    tree = ElementTree.fromstring(drawn)
    texts = ["".join(one.itertext()).strip() for one in tree.iter("{http://www.w3.org/2000/svg}text")]
    assert {"Beverloo", "Janda", "labbook", "(W − fit) / fit [%]"} <= set(texts)
    assert "Arial, Helvetica" in drawn


def test_parameters_at_many_values_of_another_key_have_a_colour_bar():
    class Fit(FurtherFit):
        formula, source, version = "", "", 1

    frictions = [0.1 * (k + 1) for k in range(8)]
    series = []
    for angle in (0.5, 1.0):
        for mu in frictions:
            fit = Fit({"k": Parameter(1 + mu, 0.9 + mu, 1.1 + mu, 0.05, "")})
            at = {ANGLE: angle, FRICTION: mu}
            series.append(Series(at, (), {}, frozenset(), frozenset(), (), (), further={"law": fit}))
    for some, entries in ((series, 0), ([one for one in series if one.at[FRICTION] < 0.35], 3)):
        figure = figures.parameters_against(ANGLE, "law", some, ())
        assert sum(len(texts_of(legend)) for legend in figure.legends) == entries
        assert len(figure.axes) == (1 if entries else 2)
