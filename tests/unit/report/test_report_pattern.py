"""How beds flow, from recorded runs whose motion is known."""

import math
import re
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text
from toy_results import analyse

from labbook.fields import GrainRows, Layer, Ring, coarse_grain, orifice_means
from labbook.measure.recorded import FlowPattern
from labbook.report import figures, style, tables
from labbook.report.blocks import Picture
from labbook.report.sections import acceleration_figures
from labbook.results.recorded import acceleration, flow_patterns, pooled_means
from labbook.stats import pool
from labbook.study.schema import Window


@pytest.fixture(scope="module")
def recorded(synthetic):
    """Grains that fall along the axis, the faster the nearer to it and to the outlet."""
    points = [synthetic.point(k, D) for k, D in enumerate((0.03, 0.042))]
    runs = [synthetic.FinishedDouble(p, seed, recorded=seed == 1) for p in points for seed in (1, 2)]
    return analyse(synthetic.study_of(points), runs)


def test_velocities_are_those_of_the_recorded_run(recorded):
    (found,) = flow_patterns(recorded.points[0])
    z, x = found.fields.grid.points
    at = (np.searchsorted(z, 0.03), np.searchsorted(x, 0.0))
    assert found.pattern.bed[at]
    # 0.6 m/s exp(-(x/20 mm)^2 - z0/30 mm) of grains that started z0 high and have fallen since
    assert -0.6 < found.fields.velocity[2][at] < -0.1
    assert abs(found.fields.velocity[0][at]) < 1e-6
    assert 0.05 < found.pattern.fraction < 1
    aside = np.abs(x) > 0.045
    assert found.pattern.stagnant[:, aside].sum() > 0.9 * found.pattern.bed[:, aside].sum()
    assert 8 <= found.frames < 30


def test_points_without_recordings_or_plateau_have_none(recorded, synthetic):
    point = synthetic.point(0, 0.03)
    silent = analyse(synthetic.study_of([point]), [synthetic.FinishedDouble(point, 1)]).points[0]
    assert flow_patterns(silent) == []


def test_each_point_has_its_two_panels(recorded):
    figure = figures.flow_patterns([flow_patterns(result)[0] for result in recorded.points])
    titles = [ax.get_title(loc="left") for ax in figure.axes]
    assert titles[:2] == ["D = 30 mm", "D = 42 mm"]
    assert all(re.fullmatch(r"\d+ % stagnant", title) for title in titles[2:4]), "no name of a flow that it is not"


def test_the_scale_of_the_arrows_is_shown_in_every_format_and_apart_from_the_titles(recorded):
    figure = figures.flow_patterns([flow_patterns(result)[0] for result in recorded.points])
    renderer = FigureCanvasAgg(figure).get_renderer()
    figure.draw(renderer)
    above, below = figure.axes[:2], figure.axes[2:4]
    for upper, lower in zip(above, below, strict=True):
        keys = [text.get_window_extent(renderer) for text in upper.texts]
        title = next(one for one in lower.findobj(Text) if one.get_text() == lower.get_title("left"))
        assert len(keys) == 2
        assert not any(key.overlaps(title.get_window_extent(renderer)) for key in keys)
    svg = style.encode(figure, "svg").decode()
    assert len(re.findall(r"<text [^>]*>[\d.]+ m/s</text>", svg)) == 4
    drawn = ElementTree.fromstring(svg)
    names = {one.get("id", "") for one in drawn.iter()}
    assert sum(name.startswith("PolyCollection") for name in names) >= 4, "arrows of the key are no image"


def test_means_above_the_orifice_are_pooled_over_recorded_runs(synthetic):
    point = synthetic.point(0, 0.03)
    runs = [synthetic.FinishedDouble(point, seed, recorded=True) for seed in (1, 2, 3)]
    (result,) = analyse(synthetic.study_of([point], window=Window(layer=0.01)), runs).points
    found = flow_patterns(result)
    means = pooled_means(found)
    values = [one.orifice["v_z"] for one in found]
    assert means["v_z"].n == 3
    assert means["v_z"].value == pytest.approx(np.mean(values))
    assert -0.6 < means["v_z"].value < -0.2
    table = tables.orifice_table([(result, means)])
    assert table.headings[:5] == ("point", "φ", "v_z [m/s]", "p_k [Pa]", "stagnant [%]")
    assert table.rows[0][-1] == "3"
    assert "±" in table.rows[0][2]
    assert "–" not in table.notes[0]


def test_a_bed_is_shown_also_where_no_grain_is_above_the_orifice(recorded):
    """The lowest grains leave first and those above hardly follow: none comes within two diameters of the lowest 3 mm,
    which are one diameter."""
    (result, _) = recorded.points
    found = result.runs[0].evaluation(FlowPattern())
    (v_z,) = (one for one in found.numbers if one.quantity == "orifice.v_z")
    assert math.isnan(v_z.value)
    assert v_z.note == "no grain is above the orifice"
    (shown,) = flow_patterns(result)
    assert set(shown.orifice) == {"stagnant_fraction"}
    means = pooled_means([shown, replace(shown, orifice={"v_z": -0.3, "stagnant_fraction": 0.5})])
    assert means["v_z"].value == -0.3
    assert (means["v_z"].n, means["stagnant_fraction"].n) == (1, 2)
    table = tables.orifice_table([(result, means), (result, pooled_means([shown]))])
    assert table.rows[1][table.headings.index("v_z [m/s]")] == "–"
    assert "(–) where no grain was in this layer" in table.notes[0]


@pytest.mark.parametrize("grid", [Layer((-0.01, 0.01), (0, 0.02), 10, 10, 3e-3), Ring(0.01, (0, 0.02), 10, 10)])
def test_all_means_of_rods_are_declared(grid):
    """One that is not would be an error of the measure, and its pattern would be missing from pages."""
    x, upright = np.array([[0.0, 0.0, 0.005]]), np.array([[0.0, 0.0, 1.0]])
    fields = coarse_grain(grid, 2e-3, GrainRows(x, -upright, 1e-5, 1e-8, 1, upright))
    means = {f"orifice.{name}" for name in orifice_means(fields, 0.01, 0.01)}
    assert "orifice.O_zz" in means
    assert means <= {one.name for one in FlowPattern.declared}


def test_order_is_that_of_the_mean_tensor_also_where_single_frames_were_measured(synthetic):
    point = synthetic.point(0, 0.03)
    (result,) = analyse(synthetic.study_of([point]), [synthetic.FinishedDouble(point, 1, recorded=True)]).points
    pooled = {name: pool([value]) for name, value in (("orifice_S", 0.42), ("orifice_S_of_mean", 0.36))}
    (found,) = flow_patterns(result)
    measured = replace(found, result=replace(result, pooled=pooled), orifice={"S": 0.37})
    assert pooled_means([measured])["S"].value == 0.36


@pytest.mark.usefixtures("one_format")
def test_accelerations_are_those_of_the_recorded_run(recorded, synthetic, tmp_path):
    """Grains whose velocities never change, in frames some 27 ms apart: 1.5 sqrt(d/g) are 26.2 ms."""
    profile = acceleration(recorded.points[0])
    assert profile is not None
    frames = recorded.points[0].runs[0].frames()
    assert frames is not None
    assert profile.interval == pytest.approx(np.unique(frames["time"])[1])
    (shown,) = acceleration_figures(recorded.points[:1], tmp_path, "", "")
    assert isinstance(shown, Picture)
    assert "velocity within 26.8 ms, of grains" in shown.caption
    seen = profile.count > 0
    assert seen.any()
    # those that leave within the interval are continued by free fall
    assert (profile.acceleration[seen] <= 1e-9).all()
    assert (profile.acceleration[seen] >= -9.81 - 1e-9).all()
    assert (profile.acceleration[seen] > -1e-9).sum() >= 3, "where none left"
    assert (profile.acceleration[seen] < -1e-3).any() == (profile.left > 0)
    (ax,) = figures.acceleration_against_height([(recorded.points[0], profile)], 9.81).axes
    assert ax.get_xlabel() == "height above the outlet, $z/D$"
    point = synthetic.point(0, 0.03)
    silent = analyse(synthetic.study_of([point]), [synthetic.FinishedDouble(point, 1)]).points[0]
    assert acceleration(silent) is None
