"""The map of two swept keys in reports: what is drawn where, and what is said beside it."""

import math

import numpy as np
import pytest
from matplotlib.collections import PathCollection
from toy_results import analyse

from labbook.report import figures, gallery
from labbook.report.blocks import Picture, Prose
from labbook.report.explored import map_sections, mapped
from labbook.report.tables import Table
from labbook.results.explore import explore
from labbook.results.surface import NoSurface

ORIFICES, ANGLES = (0.018, 0.024, 0.03, 0.045), (math.pi / 6, math.pi / 3, math.pi / 2)


@pytest.fixture(scope="module")
def plane(synthetic):
    """Four outlets and three angles with two beds; the smallest outlet clogs over the flat bottom."""
    points = [synthetic.point(k, D, a) for k, (D, a) in enumerate((D, a) for D in ORIFICES for a in ANGLES)]
    runs = [synthetic.FinishedDouble(one, seed, "clogged" if one.index == 2 else "emptied")
            for one in points for seed in (1, 2)]  # fmt: skip
    return analyse(synthetic.study_of(points, reference=None), runs)


def test_points_have_their_own_colour_and_the_surface_ends_at_them(plane):
    surface = explore(plane)
    figure = figures.design_map(surface)
    ax = figure.axes[0]
    field, (used, _, left) = ax.collections[0], [one for one in ax.collections if isinstance(one, PathCollection)]
    assert np.asarray(used.get_offsets()).shape == (11, 2)
    assert np.asarray(used.get_array()) == pytest.approx(
        [1e3 * one.pooled["flow_rate"].value for one in surface.points]
    )
    assert np.asarray(left.get_offsets()) == pytest.approx(np.array([[-1.0, 1.0]]))
    empty = np.ma.getmaskarray(np.ma.asarray(field.get_array())).reshape(121, 121)
    assert empty[-1, 0], "the corner that clogged"
    assert not empty[0, 0]
    assert not empty[60, 60]
    assert [one.get_text() for one in ax.get_xticklabels()] == ["18", "24", "30", "45"]


def test_a_report_has_the_map_and_what_matters(plane, tmp_path):
    (section,) = map_sections(plane, tmp_path)
    assert section.title == "Flow rate over orifice D and angle"
    image, method, table = section.blocks
    assert isinstance(image, Picture)
    assert isinstance(method, Prose)
    assert isinstance(table, Table)
    assert "drawn only within their hull" in image.caption
    assert "11 points, with 22 beds" in method.text
    assert [row[0] for row in table.rows] == ["orifice D", "angle", "only together"]
    assert (tmp_path / "map.pdf").exists()
    assert "map" in gallery.of_results(plane)


def test_one_key_or_too_few_points_have_none(analysis, plane, synthetic, tmp_path):
    assert not mapped(analysis)
    assert map_sections(analysis, tmp_path) == []
    points = [synthetic.point(k, D, a) for k, (D, a) in enumerate((D, a) for D in (0.02, 0.03) for a in ANGLES[:2])]
    alone = analyse(synthetic.study_of(points, reference=None), [synthetic.FinishedDouble(one, 1) for one in points])
    with pytest.raises(NoSurface, match="one bed"):
        explore(alone)
    assert map_sections(alone, tmp_path) == []
    with pytest.raises(gallery.NothingToShow, match="one bed"):
        gallery.of_results(alone)["map"]()
