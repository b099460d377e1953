"""Maps of a bed over a turning bottom, from made-up recordings with known answers."""

import re
from dataclasses import replace

import numpy as np
import pytest
from toy_results import analyse
from turning_runs import SINKING, Run, point

from labbook.backend.numerics import Numerics
from labbook.measure.bed import omega_of
from labbook.papers.pongo2022 import figures
from labbook.papers.pongo2022.pages import closer, maps_of
from labbook.papers.pongo2022.rotation import rotations_of
from labbook.report import page
from labbook.results.recorded import flow_patterns, moments
from labbook.study.schema import Window


@pytest.fixture(scope="module")
def analysis(synthetic):
    """Two speeds of the bottom, two runs each, of which one is filmed."""
    points = [point(k, f) for k, f in enumerate((0.0, 0.32))]
    runs = [Run(p, seed, filmed=seed == 1) for p in points for seed in (1, 2)]
    return analyse(synthetic.study_of(points, fit=(), reference=None), runs)


@pytest.mark.slow
@pytest.mark.usefixtures("one_format")
def test_maps_are_of_three_instants_of_the_window(analysis, tmp_path):
    result = analysis.points[1]
    trace = result.runs[0].trace
    assert trace is not None
    assert trace.window is not None
    begin, end = trace.window
    found = moments(result)
    middles = [sum(one.window) / 2 for one in found]
    assert middles == pytest.approx([begin + (end - begin) * part for part in (1 / 6, 1 / 2, 5 / 6)])
    assert all(one.window[1] - one.window[0] <= 1 for one in found)
    for one, t in zip(found, middles, strict=True):
        r, z = one.fields.grid.points
        inside = np.ix_(r < 0.05, (z > 0.03) & (z < 0.1))
        assert one.fields.velocity[2][inside] == pytest.approx(-SINKING)
        assert np.nanmax(z[one.pattern.bed.any(axis=0)]) == pytest.approx(0.3 - SINKING * t, abs=0.015)
        assert one.pattern.fraction < 0.05
    speed = figures.speed_maps([moments(one) for one in analysis.points])
    titles = [ax.get_title(loc="left") for ax in speed.axes[:6]]
    assert [title.split(",")[0] for title in titles] == ["f = 0 Hz"] * 3 + ["f = 0.32 Hz"] * 3
    text = page.write(analysis, tmp_path).read_text(encoding="utf-8")
    assert "(Pongó et al. 2022, Fig. 6)" in text
    assert "add `record:" not in text
    kinds = ("packing", "speed", "patterns", "order")
    assert {f"rotation-{kind}.svg" for kind in kinds} <= {p.name for p in tmp_path.iterdir()}


@pytest.mark.slow
@pytest.mark.usefixtures("one_format")
def test_few_frames_make_maps_of_packing_but_not_of_speed(synthetic, tmp_path):
    points = [point(k, f) for k, f in enumerate((0.0, 0.32))]
    runs = [Run(p, 1, filmed=True, every=0.15) for p in points]
    analysis = analyse(synthetic.study_of(points, fit=(), reference=None), runs)
    assert all(4 <= one.frames < 8 for one in moments(analysis.points[1]))
    text = page.write(analysis, tmp_path).read_text(encoding="utf-8")
    made = {p.name for p in tmp_path.iterdir()}
    assert "rotation-packing.svg" in made
    assert "rotation-speed.svg" not in made
    assert "Maps of speed at instants need frames 60 ms apart or closer: `record: {every: 60 ms}`." in text


@pytest.mark.slow
@pytest.mark.usefixtures("one_format")
def test_how_close_frames_must_be_follows_from_the_window_alone(synthetic):
    """The window lasts 0.6 s or more at 390 grains/s: instants of 0.2 s need 8 frames."""
    points = [point(k, f) for k, f in enumerate((0.0, 1.28))]
    study = synthetic.study_of(points, fit=(), reference=None, window=Window(start=0.15, end=0.25))
    (curve,) = rotations_of(analyse(study, [Run(p, 1, filmed=True) for p in points]))
    _, lacking = maps_of(curve, curve.points)
    windows = [trace.window for one in curve.points if (trace := one.runs[0].trace) is not None]
    shortest = min(end - begin for begin, end in filter(None, windows)) / 3
    (said,) = (one for one in lacking if one.startswith("Maps of speed"))
    (every,) = (float(ms) * 1e-3 for ms in re.findall(r"every: ([\d.]+) ms", said))
    assert 0.5 * shortest / 8 < every <= shortest / 8
    assert "steps_per_beat" not in said
    slow = [replace(one, point=replace(one.point, numerics=Numerics(dt=1e-4))) for one in curve.points]
    assert said.endswith(closer(slow))


def test_maps_of_orientation_are_those_of_the_rods(analysis):
    """All are upright: O_zz and S are 1 in the bed, and nothing is drawn above it."""
    patterns = [flow_patterns(one)[0] for one in analysis.points]
    figure = figures.order_maps(patterns)
    for one in patterns:
        assert [one.orifice[name] for name in ("O_rr", "O_tt", "O_zz", "S")] == pytest.approx([0, 0, 1, 1])
    panels = [ax for ax in figure.axes if ax.get_title(loc="left")]
    assert [ax.get_title(loc="left") for ax in panels] == ["f = 0 Hz", "f = 0.32 Hz"] * 2
    for ax in panels:
        values = ax.collections[0].get_array()
        assert values is not None
        assert np.ma.compressed(values) == pytest.approx(1)
        assert 0.5 < np.ma.count(values) / values.size < 1


def test_maps_leave_out_the_axis_within_the_width_of_the_coarse_graining(analysis):
    (pattern, *_) = flow_patterns(analysis.points[0])
    (panel, *_) = figures.order_maps([pattern]).axes
    values = panel.collections[0].get_array()
    assert values is not None
    values = np.ma.filled(values, np.nan).reshape(len(pattern.fields.grid.points[1]), -1)
    radius = np.abs(pattern.section().x)
    drawn = radius[np.isfinite(values).any(axis=0)]
    omega = omega_of(pattern.result.point.scene)
    assert omega <= drawn.min() < 1.6 * omega
