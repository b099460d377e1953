"""Sections on a rotating bottom: figures and maps in the order of Pongo et al. (2022), and reasons for missing ones."""

import math
from collections.abc import Sequence
from pathlib import Path

from labbook.fields import Fields
from labbook.measure.orifice import OrificeMeans
from labbook.measure.recorded import FEWEST, instant
from labbook.papers.pongo2022 import figures
from labbook.papers.pongo2022.rotation import FLOW, Rotation, aspect_ratio, rotations_of, turning_at
from labbook.report.blocks import Picture, Prose, Section, picture
from labbook.report.figures.pattern import flow_patterns as draw_patterns
from labbook.report.sections import PATTERNS
from labbook.results.points import PointResult
from labbook.results.recorded import Flowing, acceleration, flow_patterns, moments
from labbook.results.series import Series
from labbook.results.study import StudyResults
from labbook.scene.quantities import percent, value_range
from labbook.stats import Pooled

_MEANS = ("orifice_v_z", "orifice_packing_fraction")


def turning_sections(results: StudyResults, folder: Path) -> list[Section]:
    """Sections with sentences, pictures and reasons for missing ones; Q(D) alone if no rotation was swept."""
    curves = rotations_of(results)
    if not curves:
        alone = scaling(results, folder)
        return [] if alone is None else [Section("Flow rate against orifice, logarithmic", (alone,))]
    pictures, lacking = _flow(curves, folder)
    if len({aspect_ratio(curve.points[0]) for curve in curves if curve.lowest() is not None}) > 1:
        pictures.append(picture(figures.drop_and_rise(curves), folder / "rotation-shapes", _SHAPES_ALT, _SHAPES))
    else:
        lacking.append(
            "The drop against the aspect ratio needs three frequencies of grains of several L/d: sweep them."
        )
    against = scaling(results, folder)
    if against is None:
        lacking.append("Q against D needs several outlets, and `fit: [power, exponential]`: sweep container.orifice.")
    else:
        pictures.append(against)
    try:
        map_pictures, remarks = maps(curves, folder)
    except ImportError as missing:
        map_pictures, remarks = [], [f"Maps are not shown: {missing}."]
    pictures, lacking = pictures + map_pictures, lacking + remarks
    if any(curve.has(name) for curve in curves for name in _MEANS):
        figure = figures.above_orifice([curve for curve in curves if any(map(curve.has, _MEANS))])
        above = value_range((point.layer for curve in curves for point in curve.points), "mm", 1e3)
        caption = f"{_ORIFICE.format(above)}{_hollow(curves)}"
        pictures.append(picture(figure, folder / "rotation-orifice", "means above the orifice against f", caption))
    else:
        lacking.append(_lacks("Means above the orifice", results, curves))
    fallen = _falls(curves)
    if fallen:
        figure = figures.acceleration_against_rotation(fallen, curves[0].points[0].point.scene.gravity)
        caption = _FALL.format(
            value_range((point.acceleration_interval for curve in curves for point in curve.points), "ms", 1e3)
        )
        pictures.append(picture(figure, folder / "rotation-acceleration", "acceleration against height", caption))
    else:
        lacking.append(_lacks("Accelerations", results, curves))
    sentences = [Prose(_capitalised(text)) for curve in curves if (text := sentence(curve))]
    remarks = [Prose(_capitalised(text), note=True) for text in lacking]
    return [Section("Against the rotation of the bottom", (*sentences, *pictures, *remarks))]


def scaling(results: StudyResults, folder: Path) -> Picture | None:
    """Picture of Q(D) of holes on logarithmic axes, if the power or exponential law is fitted; else None."""
    fitted = scaled(results)
    if not fitted:
        return None
    return picture(figures.flow_scaling(fitted), folder / "scaling", "flow rate against orifice, logarithmic", SCALING)


def scaled(results: StudyResults) -> list[Series]:
    """List the series with a fitted power or exponential law."""
    return [series for series in results.series if {"power", "exponential"} & set(series.fits)]


def sentence(curve: Rotation) -> str:
    """Describe the effect of rotation on the flow of one shape and outlet in a sentence; empty without ratios."""
    name = _curve_name(curve)
    if curve.unfinished:
        rotations = ", ".join(f"{f:g}" for f in curve.unfinished)
        return f"{name}: runs are missing at f = {rotations} Hz, so the minimum of Q is not determined."
    lowest = curve.lowest()
    if lowest is None:
        ratio = curve.ratio(FLOW, len(curve.points) - 1)
        if ratio is None:
            return ""
        text = f"{name}: Q at {curve.frequencies[-1]:g} Hz is {_percent(ratio)} of that at rest."
        return text + _pairs(curve, (len(curve.points) - 1, ratio))
    if lowest == 0:
        changes = [(k, ratio) for k in range(1, len(curve.points)) if (ratio := curve.ratio(FLOW, k)) is not None]
        if not changes:
            return ""
        largest = max(changes, key=lambda change: abs(change[1].value - 1))
        text = f"{name}: Q is smallest at rest and reaches {_percent(largest[1])} of that when the bottom turns."
        return text + _pairs(curve, largest)
    drop, rise = curve.ratio(FLOW, lowest), curve.ratio(FLOW, len(curve.points) - 1, lowest)
    if drop is None:
        return ""
    minimum = curve.minimum()
    between = f" (90 % interval {minimum.low:g} to {minimum.high:g} Hz)" if minimum is not None else ""
    at = f"{curve.frequencies[lowest]:g} Hz{between}"
    text = f"{name}: Q falls to {_percent(drop)} of that at rest, its smallest, at {at}"
    last = len(curve.points) - 1
    if rise is None or lowest == last:
        return f"{text}.{_pairs(curve, (lowest, drop))}"
    text = f"{text}, and at {curve.frequencies[last]:g} Hz is {_percent(rise)} of the smallest."
    return text + _pairs(curve, (lowest, drop), (last, rise))


def _pairs(curve: Rotation, *ratios: tuple[int, Pooled]) -> str:
    """State the number of pairs of runs behind ratios at these points, and the remark on runs at rest."""
    counts = [f"{ratio.n} pair{'' if ratio.n == 1 else 's'} at {curve.frequencies[k]:g} Hz" for k, ratio in ratios]
    remark = curve.points[0].remark
    at_rest = f" (at rest: {remark})" if remark else ""
    return f" Each ratio rests on runs of equal seed: {' and '.join(counts)}{at_rest}."


def _capitalised(sentence: str) -> str:
    """Capitalise a sentence."""
    return sentence[:1].upper() + sentence[1:]


def _percent(ratio) -> str:
    if not math.isfinite(ratio.error):
        return percent(ratio.value, ".0f")
    digits = 0 if 100 * ratio.error >= 1 else 1
    return f"{100 * ratio.value:.{digits}f} ± {100 * ratio.error:.{digits}f} %"


def _flow(curves: Sequence[Rotation], folder: Path) -> tuple[list[Picture], list[str]]:
    """Picture Q and its ratio to that at rest against f, and list the reasons for missing curves."""
    flowing = [curve for curve in curves if curve.flows]
    lacking = dict.fromkeys(f"Q against f is not drawn: {_no_flow(curve)}." for curve in curves if not curve.flows)
    for curve in flowing:
        if not curve.rated:
            why = curve.points[0].no_flow or "no seed gave Q both at rest and with the bottom turning"
            lacking[f"{_curve_name(curve)}: Q(f)/Q(0) is not drawn: {why}."] = None
    if not flowing:
        return [], list(lacking)
    figure = figures.flow_against_rotation(flowing)
    return [picture(figure, folder / "rotation-flow", "flow rate against f", flow_caption(flowing))], list(lacking)


def flow_caption(curves: Sequence[Rotation]) -> str:
    """Caption of Q against f."""
    below = _BELOW if any(curve.rated for curve in curves) else ""
    return f"{_FLOW if below else _FLOW_ALONE}{below}{_hollow(curves)}"


def _curve_name(curve: Rotation) -> str:
    """Name a curve by shape and outlet."""
    return ", ".join(filter(None, (curve.shape, curve.label)))


def _no_flow(curve: Rotation) -> str:
    reasons = dict.fromkeys(point.no_flow for point in curve.points if point.no_flow)
    return " and ".join(reasons) or "no run has a flow rate"


def _hollow(curves: Sequence[Rotation]) -> str:
    """Caption on hollow markers; empty without remarks."""
    any_one = any(point.remark for curve in curves for point in curve.points)
    return " Hollow: see the remarks in the table of flow rates." if any_one else ""


def _lacks(subject: str, results: StudyResults, curves: Sequence[Rotation]) -> str:
    """Give the reason why means above the orifice or accelerations are not shown."""
    if OrificeMeans.name not in results.study.measure:
        return f"{subject} need `orifice` among the measures."
    points = [point for curve in curves for point in curve.points]
    reasons = dict.fromkeys(point.no_flow for point in points if point.no_flow)
    measured = (run.measured.get(_MEANS[0]) for point in points for run in point.runs)
    reasons = reasons or dict.fromkeys(number.note for number in measured if number is not None and number.note)
    return f"{subject} are not shown: {' and '.join(reasons) or 'fewer than two frequencies have them'}."


def _falls(curves: Sequence[Rotation]):
    """Collect accelerations of each curve: at rest, at the smallest flow, and at the fastest rotation."""
    fallen = []
    for curve in curves:
        indices = select_indices(curve, range(len(curve.points)))
        profiles = [(float(curve.frequencies[k]), acceleration(curve.points[k])) for k in indices]
        available = [(f, profile) for f, profile in profiles if profile is not None]
        if available:
            fallen.append((curve, available))
    return fallen


_FLOW = "Q and Q(f)/Q(0) (Pongó et al. 2022, Fig. 2). Above: means with one standard error, dots: seeds."
_FLOW_ALONE = "Q (Pongó et al. 2022, Fig. 2): means with one standard error, dots: seeds."
_BELOW = " Below: ratios of the means over the seeds that both have, with 90 % intervals from their pairs."
_SHAPES_ALT = "drop and rise of the flow rate against the aspect ratio"
_SHAPES = (
    "The smallest flow over that at rest, and that with the fastest rotation over the smallest (Pongó et al. 2022, "
    "Fig. 3), with 90 % intervals from pairs of seeds. Dashed: the same D; full: the same D/d*."
)
SCALING = (
    "Q against D (Pongó et al. 2022, Figs 4 and 5); bars: one standard error. First: both axes logarithmic, with "
    "fitted powers and, grey, the slope 5/2; second: only Q, with fitted exponentials."
)
_ORIFICE = (
    "Means over the first {} above the orifice, weighted by the packing fraction, in the window (Pongó et al. "
    "2022, Figs 8 and 9); p_k is the trace of the kinetic stress of the fluctuations about the mean over azimuth and "
    "window, the free-fall height the area under a_eff/g up to two widths of the outlet. Bars: one standard error over "
    "seeds."
)
_FALL = (
    "Mean change of the vertical velocity within {} of grains that start at this height within D/4 "
    "of the axis (Pongó et al. 2022, Fig. 10); 1 is free fall. Grains that leave meanwhile are continued by free fall. "
    "Bars: one standard error over seeds, of one run over its grains."
)


_FEW = 3


def maps(curves: Sequence[Rotation], folder: Path) -> tuple[list[Picture], list[str]]:
    """Picture recorded runs, and list sentences on missing maps. Raises ImportError without Numba."""
    pictures: list[Picture] = []
    lacking: set[str] = set()
    for number, curve in enumerate(curves, start=1):
        filmed = [k for k, point in enumerate(curve.points) if _filmed(point)]
        rendered, remarks = maps_of(curve, [curve.points[k] for k in select_indices(curve, filmed)])
        suffix = f"-{number}" if len(curves) > 1 else ""
        where = ", ".join(filter(None, (curve.shape, curve.label)))
        for name, alt, caption, figure in rendered:
            whole = f"{where[:1].upper()}{where[1:]}. {caption}"
            pictures.append(picture(figure, folder / f"rotation-{name}{suffix}", f"{alt}, {where}", whole))
        lacking |= set(remarks)
    if not pictures and not lacking:
        lacking.add("Maps need recorded runs: add `record: {every: 100 ms, replicates: 1}`.")
    return pictures, sorted(lacking)


def select_indices(curve: Rotation, indices: Sequence[int]) -> list[int]:
    """Select the points at rest, of the smallest flow and of the fastest rotation; all if there are at most _FEW."""
    if len(indices) <= _FEW:
        return list(indices)
    return sorted({indices[0], next((k for k in indices[1:] if k == curve.lowest()), indices[1]), indices[-1]})


def maps_of(curve: Rotation, points: Sequence[PointResult]):
    """Draw the maps of some points: file name, description, caption and figure of each; and remarks on missing maps."""
    rendered, lacking = [], []
    instants = [(result, moments(result)) for result in points]
    rows = [row for _, row in instants if row]
    # grains hardly move within an instant, but the bed shakes: velocities take more frames than positions
    quick = [row for row in rows if all(flowing.frames >= FEWEST for flowing in row)]
    if rows:
        rendered.append(("packing", "packing fraction", _PACKING, figures.packing_maps(rows)))
    if quick:
        rendered.append(("speed", "speed", _SPEED, figures.speed_maps(quick)))
    slow = [result for result, row in instants if not row or any(flowing.frames < FEWEST for flowing in row)]
    without = {result: why for result in slow if (why := _no_window(result))}
    for why in dict.fromkeys(without.values()):
        rotations = ", ".join(turning_at(result) for result in slow if without.get(result) == why)
        lacking.append(f"{_curve_name(curve)}: no maps at {rotations}, as {why}.")
    if rare := [result for result in slow if result not in without]:
        lacking.append(closer(rare))
    patterns = [every[0] for result in points if (every := flow_patterns(result))]
    if patterns:
        titles = [turning_at(flowing.result) for flowing in patterns]
        rendered.append(("patterns", "how the beds flow", PATTERNS, draw_patterns(patterns, titles)))
        if all(flowing.fields.axes is not None for flowing in patterns):
            rendered.append(("order", "orientation", _ORDER, figures.order_maps(patterns)))
        if pressed := [(flowing, stress) for flowing in patterns if (stress := _stress(flowing)) is not None]:
            rendered.append(("pressure", "contact pressure", _PRESSURE, figures.pressure_maps(pressed)))
    return rendered, lacking


def _filmed(result: PointResult) -> bool:
    return any(run.recorded for run in result.runs)


def _windows(result: PointResult) -> list[tuple[float, float]]:
    """Windows [s] of the recorded runs that have one."""
    traces = (run.trace for run in result.runs if run.recorded and run.counted)
    return [trace.window for trace in traces if trace is not None and trace.window is not None]


def _no_window(result: PointResult) -> str:
    """Give the reason why no recorded run has a window; empty if one has."""
    if _windows(result):
        return ""
    ended = dict.fromkeys(run.outcome for run in result.runs if run.recorded and run.outcome in ("clogged", "diverged"))
    if ended:
        return f"the recorded run {' or '.join(ended)} (record more: `record.replicates`)"
    return result.no_flow or "no recorded run has a window"


def closer(results: Sequence[PointResult]) -> str:
    """State the interval of frames that maps of speed need, and the key that sets it."""
    shortest = min(
        instant(result.point.scene, result.runs[0].window, times) for result in results for times in _windows(result)
    )
    needed = _rounded_down(shortest / FEWEST)
    return (
        f"Maps of speed at instants need frames {needed * 1e3:g} ms apart or closer: "
        f"`record: {{every: {needed * 1e3:g} ms}}`."
    )


def _rounded_down(time: float) -> float:
    """Round down to one significant digit."""
    digit = 10.0 ** math.floor(math.log10(time))
    return float(f"{math.floor(time / digit) * digit:.1g}")


def _stress(pattern: Flowing) -> Fields | None:
    """Find the fields with the contact stress of the first run of a point that has them."""
    return next((run.stress for run in pattern.result.runs if run.stress is not None), None)


_AXIS = "White along the axis: within the width of the coarse-graining function few grains are averaged."
_PACKING = (
    "Packing fraction in a plane through the axis, mean over the azimuth and 1 s (or a third of the window of the flow "
    "rate, if that is shorter) about three instants, of the first recorded run (Pongó et al. 2022, Fig. 6). "
    f"{_AXIS}"
)
_SPEED = (
    f"Speed in that plane at the same instants, of {FEWEST} frames and more each, with streamlines (Pongó et al. 2022, "
    "Fig. 7); hatched: stagnant, as in the next figure."
)
_ORDER = (
    "Orientation of rods in the window, mean over the azimuth: above O_zz, the mean square of the cosine to the "
    "vertical, below the order S; of directions at random both are 1/3. "
    f"{_AXIS}"
)
_PRESSURE = (
    f"Contact pressure, a third of the trace of the contact stress, mean over the azimuth and the window. {_AXIS}"
)
