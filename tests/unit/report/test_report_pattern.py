"""How beds flow, from recorded runs whose motion is known."""

import numpy as np
import pytest

from labbook.report import figures
from labbook.report.analysis import analyse
from labbook.report.pattern import flow_pattern


@pytest.fixture(scope="module")
def recorded(synthetic):
    """Grains that fall along the axis, the faster the nearer to it and to the outlet."""
    points = [synthetic.point(k, D) for k, D in enumerate((0.03, 0.042))]
    runs = [synthetic.FinishedDouble(p, seed, recorded=seed == 1) for p in points for seed in (1, 2)]
    return analyse(synthetic.study_of(points), runs)


def test_velocities_are_those_of_the_recorded_run(recorded):
    found = flow_pattern(recorded.points[0])
    assert found is not None
    z, x = found.fields.grid.points
    at = (np.searchsorted(z, 0.03), np.searchsorted(x, 0.0))
    assert found.pattern.bed[at]
    # 0.6 m/s exp(-(x/20 mm)^2 - z0/30 mm) of grains that started z0 high and have fallen since
    assert -0.6 < found.fields.velocity[2][at] < -0.1
    assert abs(found.fields.velocity[0][at]) < 1e-6
    assert found.pattern.kind == "funnel flow"
    aside = np.abs(x) > 0.045
    assert found.pattern.stagnant[:, aside].sum() > 0.9 * found.pattern.bed[:, aside].sum()
    assert 8 <= found.frames < 30


def test_points_without_recordings_or_plateau_have_none(recorded, synthetic):
    point = synthetic.point(0, 0.03)
    silent = analyse(synthetic.study_of([point]), [synthetic.FinishedDouble(point, 1)]).points[0]
    assert flow_pattern(silent) is None


def test_each_point_has_its_two_panels(recorded):
    found = [flow_pattern(result) for result in recorded.points]
    figure = figures.flow_patterns([one for one in found if one is not None])
    titles = [ax.get_title(loc="left") for ax in figure.axes]
    assert titles[:2] == ["D = 30 mm", "D = 42 mm"]
    assert all("funnel flow" in title for title in titles[2:4])
