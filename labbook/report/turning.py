"""What the page shows of a bottom that turns: figures in the order of Pongo et al. (2022), and what they lack."""

import math
from collections.abc import Sequence
from pathlib import Path

from labbook.measure.orifice import INTERVAL
from labbook.report import figures
from labbook.report.blocks import Picture, Prose, Section, picture
from labbook.report.turning_maps import chosen, maps
from labbook.results.recorded import acceleration
from labbook.results.rotation import FLOW, Rotation, aspect_ratio
from labbook.results.study import Results

_MEANS = ("orifice_v_z", "orifice_packing_fraction")


def turning_sections(results: Results, folder: Path) -> list[Section]:
    """Sentences, pictures and what is lacking; nothing if the rotation was not swept."""
    curves = results.turning
    if not curves:
        return []
    pictures, lacking = [_flow(curves, folder)], []
    if len({aspect_ratio(one.points[0]) for one in curves if one.lowest() is not None}) > 1:
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
        shown, without = maps(curves, folder)
    except ImportError as missing:
        shown, without = [], [f"Maps are not shown: {missing}."]
    pictures, lacking = pictures + shown, lacking + without
    if any(one.has(name) for one in curves for name in _MEANS):
        figure = figures.above_orifice([one for one in curves if any(map(one.has, _MEANS))])
        pictures.append(picture(figure, folder / "rotation-orifice", "means above the orifice against f", _ORIFICE))
    else:
        lacking.append("Means above the orifice need `orifice` among the measures.")
    fallen = _falls(curves)
    if fallen:
        figure = figures.acceleration_against_rotation(fallen, curves[0].points[0].point.scene.gravity)
        pictures.append(picture(figure, folder / "rotation-acceleration", "acceleration against height", _FALL))
    else:
        lacking.append("Accelerations need `orifice` among the measures.")
    sentences = [Prose(text[:1].upper() + text[1:]) for one in curves if (text := sentence(one))]
    without = [Prose(text, note=True) for text in lacking]
    return [Section("Against the rotation of the bottom", (*sentences, *pictures, *without))]


def scaling(results: Results, folder: Path) -> Picture | None:
    """Q(D) of holes on logarithmic axes, where the laws of that name are fitted."""
    fitted = [one for one in results.series if {"power", "exponential"} & set(one.fits)]
    if not fitted:
        return None
    return picture(figures.flow_scaling(fitted), folder / "scaling", "flow rate against orifice, logarithmic", _SCALING)


def sentence(curve: Rotation) -> str:
    """What turning does to the flow of one shape and outlet, in plain words; empty without ratios."""
    who = ", ".join(filter(None, (curve.shape, curve.label)))
    if curve.unfinished:
        places = ", ".join(f"{f:g}" for f in curve.unfinished)
        return f"{who}: runs are lacking at f = {places} Hz, so that nothing is said of where Q is smallest."
    lowest = curve.lowest()
    if lowest is None:
        ratio = curve.ratio(FLOW, len(curve.points) - 1)
        return (
            "" if ratio is None else f"{who}: Q at {curve.frequencies[-1]:g} Hz is {_percent(ratio)} of that at rest."
        )
    if lowest == 0:
        changes = [ratio for k in range(1, len(curve.points)) if (ratio := curve.ratio(FLOW, k)) is not None]
        if not changes:
            return ""
        largest = max(changes, key=lambda ratio: abs(ratio.value - 1))
        return f"{who}: Q is smallest at rest and reaches {_percent(largest)} of that when the bottom turns."
    drop, rise = curve.ratio(FLOW, lowest), curve.ratio(FLOW, len(curve.points) - 1, lowest)
    if drop is None:
        return ""
    found = curve.minimum()
    between = f" (90 % interval {found.low:g} to {found.high:g} Hz)" if found is not None else ""
    at = f"{curve.frequencies[lowest]:g} Hz{between}"
    text = f"{who}: Q falls to {_percent(drop)} of that at rest, its smallest, at {at}"
    last = len(curve.points) - 1
    if rise is None or lowest == last:
        return f"{text}."
    return f"{text}, and at {curve.frequencies[last]:g} Hz is {_percent(rise)} of the smallest."


def _percent(ratio) -> str:
    if not math.isfinite(ratio.error):
        return f"{100 * ratio.value:.0f} %"
    digits = 0 if 100 * ratio.error >= 1 else 1
    return f"{100 * ratio.value:.{digits}f} ± {100 * ratio.error:.{digits}f} %"


def _flow(curves: Sequence[Rotation], folder: Path) -> Picture:
    return picture(figures.flow_against_rotation(curves), folder / "rotation-flow", "flow rate against f", _FLOW)


def _falls(curves: Sequence[Rotation]):
    """Accelerations of each curve: at rest, where the flow is smallest, and with the fastest rotation."""
    fallen = []
    for curve in curves:
        wanted = chosen(curve, range(len(curve.points)))
        profiles = [(float(curve.frequencies[k]), acceleration(curve.points[k])) for k in wanted]
        known = [(f, profile) for f, profile in profiles if profile is not None]
        if known:
            fallen.append((curve, known))
    return fallen


_FLOW = (
    "Q and Q(f)/Q(0) (Pongó et al. 2022, Fig. 2). Above: means with one standard error, dots: seeds. Below: ratios of "
    "the means over the seeds that both have, with 90 % intervals from their pairs. Hollow: runs are lacking."
)
_SHAPES_ALT = "drop and rise of the flow rate against the aspect ratio"
_SHAPES = (
    "The smallest flow over that at rest, and that with the fastest rotation over the smallest (Pongó et al. 2022, "
    "Fig. 3), with 90 % intervals from pairs of seeds. Dashed: the same D; full: the same D/d*."
)
_SCALING = (
    "Q against D (Pongó et al. 2022, Figs 4 and 5); bars: one standard error. First: both axes logarithmic, with "
    "fitted powers and, grey, the slope 5/2; second: only Q, with fitted exponentials."
)
_ORIFICE = (
    "Means over the first centimetre above the orifice, weighted by the packing fraction, in the window (Pongó et al. "
    "2022, Figs 8 and 9); p_k is the trace of the kinetic stress of the fluctuations about the mean over azimuth and "
    "window, the free-fall height the area under a_eff/g up to two widths of the outlet. Bars: one standard error over "
    "seeds; hollow: runs are lacking."
)
_FALL = (
    f"Mean change of the vertical velocity within {INTERVAL * 1e3:g} ms of grains that start at this height within D/4 "
    "of the axis (Pongó et al. 2022, Fig. 10); 1 is free fall. Grains that leave meanwhile are continued by free fall. "
    "Bars: one standard error over seeds, of one run over its grains."
)
