"""Small charts of notebooks: ticks, and places of points, curves and bands."""

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labbook.chart import Chart, ticks


@given(st.floats(-1e6, 1e6), st.floats(1e-6, 1e6))
def test_ticks_are_few_round_and_inside(low, width):
    high = low + width
    if not high - low > 1e-9 * max(abs(low), abs(high)):
        return  # no room for ticks between neighbouring numbers
    found = ticks(low, high)
    assert 2 <= len(found) <= 6
    step = found[1] - found[0]
    slack = 1e-6 * step + 1e-9 * max(abs(low), abs(high))
    assert low - slack <= found[0]
    assert found[-1] <= high + slack
    mantissa = step / 10 ** math.floor(math.log10(step) + 1e-6)
    assert min(abs(mantissa - one) for one in (1, 2, 5, 10)) < 1e-2


def test_an_empty_range_has_one_tick():
    assert ticks(3.0, 3.0) == [3.0]


def test_points_stand_where_their_axes_say():
    """Ticks and points are both drawn in pixels: a point at a tick has the tick's place."""
    chart = Chart("D [mm]", "W [g/s]", (10.0, 30.0), 4.0)
    chart.point(20.0, 3.0, 2.0, 4.0)
    drawn = chart.svg()
    ((x, y),) = re.findall(r'cx="([\d.]+)" cy="([\d.]+)"', drawn)
    places = {text: (at, up) for at, up, text in re.findall(r'<text x="([\d.]+)" y="([\d.]+)"[^>]*>(\d+)<', drawn)}
    assert places["20"][0] == x
    assert float(places["3"][1]) == pytest.approx(float(y) + 4, abs=0.11)  # text stands 4 pixels lower than its tick
    ((bottom, top),) = re.findall(r'd="M[\d.]+ ([\d.]+)V([\d.]+)" stroke="#d55e00"', drawn)
    assert [float(bottom) + 4, float(top) + 4] == pytest.approx([float(places[one][1]) for one in "24"], abs=0.11)


def test_bands_leave_out_what_is_unknown():
    chart = Chart("x", "y", (0.0, 2.0), 1.0)
    chart.band([0.0, 1.0, 2.0], [0.0, 0.1, math.nan], [1.0, math.inf, 1.0])
    (outline,) = re.findall(r'polygon points="([^"]*)"', chart.svg())
    assert len(outline.split()) == 2  # the first only, low and high
    chart = Chart("x", "y", (0.0, 2.0), 1.0)
    chart.band([0.0], [math.nan], [1.0])
    assert "polygon" not in chart.svg()


def test_what_is_above_the_chart_ends_at_its_edge():
    chart = Chart("x", "y", (0.0, 1.0), 1.0)
    chart.curve([0.0, 1.0], [1.0, 7.0])
    first, second = re.findall(r'polyline points="([^"]*)"', chart.svg())[0].split()
    assert first.split(",")[1] == second.split(",")[1]


def test_headings_are_text():
    assert "<b>" not in Chart("<b>", "y", (0.0, 1.0), 1.0).svg()
