"""Flow rates relative to a plain hopper."""

import math
from dataclasses import replace

import numpy as np
import pytest

from labbook.report import figures
from labbook.report.analysis import analyse
from labbook.report.ratios import by_angle, by_position


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
    alone = analyse(synthetic.study_of(points[1:]), runs[2:])
    assert by_position(alone.points) == []


def test_the_angle_factors_are_drawn_beside_them(angles):
    (ax,) = figures.flow_against_angle(by_angle(angles.points)).axes
    brown, rose = ax.lines[:2]
    assert heights(brown)[-1] == pytest.approx(1)
    assert heights(rose)[-1] == 1
    labels = ax.get_legend_handles_labels()[1]
    assert "Rose & Tanaka, φ_d = 26.6°" in labels
    assert {"D = 24 mm", "D = 30 mm"} <= set(labels)
