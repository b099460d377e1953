"""How beds flow, from recorded runs whose motion is known."""

import re
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text
from toy_results import analyse

from labbook.report import figures, style, tables
from labbook.results.recorded import acceleration, flow_patterns, pooled_means
from labbook.stats import pool


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
    assert len(re.findall(r"<!-- [\d.]+ m/s -->", svg)) == 4
    drawn = ElementTree.fromstring(svg)
    names = {one.get("id", "") for one in drawn.iter()}
    assert sum(name.startswith("PolyCollection") for name in names) >= 4, "arrows of the key are no image"


def test_means_above_the_orifice_are_pooled_over_recorded_runs(synthetic):
    point = synthetic.point(0, 0.03)
    runs = [synthetic.FinishedDouble(point, seed, recorded=True) for seed in (1, 2, 3)]
    (result,) = analyse(synthetic.study_of([point]), runs).points
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


def test_order_is_that_of_the_mean_tensor_also_where_single_frames_were_measured(synthetic):
    point = synthetic.point(0, 0.03)
    (result,) = analyse(synthetic.study_of([point]), [synthetic.FinishedDouble(point, 1, recorded=True)]).points
    pooled = {name: pool([value]) for name, value in (("orifice_S", 0.42), ("orifice_S_of_mean", 0.36))}
    (found,) = flow_patterns(result)
    measured = replace(found, result=replace(result, pooled=pooled), orifice={"S": 0.37})
    assert pooled_means([measured])["S"].value == 0.36


def test_accelerations_are_those_of_the_recorded_run(recorded, synthetic):
    """Grains whose velocities never change, in frames some 25 ms apart."""
    profile = acceleration(recorded.points[0])
    assert profile is not None
    seen = profile.count > 0
    assert seen.any()
    # those that leave within the interval are continued by free fall
    assert (profile.acceleration[seen] <= 1e-9).all()
    assert (profile.acceleration[seen] >= -9.81).all()
    assert (profile.acceleration[seen] > -1e-9).sum() >= 3, "where none left"
    assert (profile.acceleration[seen] < -1e-3).any() == (profile.left > 0)
    (ax,) = figures.acceleration_against_height([(recorded.points[0], profile)], 9.81).axes
    assert ax.get_xlabel() == "height above the outlet, $z/D$"
    point = synthetic.point(0, 0.03)
    silent = analyse(synthetic.study_of([point]), [synthetic.FinishedDouble(point, 1)]).points[0]
    assert acceleration(silent) is None
