"""What the page shows of one series: its figures with their captions, and its tables."""

import math
from base64 import b64encode
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from labbook.fields.pattern import FUNNEL, SLOW
from labbook.fit.outlet import FORMULA, SOURCE
from labbook.report import figures, style, tables
from labbook.report.analysis import Analysis
from labbook.report.pattern import flow_pattern
from labbook.report.series import Series

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Picture:
    """A figure as the page holds it: a data URI, what it shows in words, its caption and its width."""

    uri: str
    alt: str
    caption: str
    width: str


def series_section(analysis: Analysis, index: int, folder: Path) -> dict:
    """Figures, tables and remarks of the series numbered `index`, as the template takes them."""
    series, reference = analysis.series[index], analysis.study.reference
    suffix = f"-{index + 1}" if len(analysis.series) > 1 else ""
    where = f" ({series.label})" if series.label else ""
    fit = None
    if series.used:
        source = reference.source if reference is not None else ""
        figure = figures.flow_against_orifice(series, analysis.comparisons, source)
        fit = picture(figure, folder / f"fit{suffix}", f"W to the power 2/3 against orifice{where}", _FIT)
    flow = figures.flow_against_time(series)
    problems = [f"Not fitted: {problem}." for problem in series.problems]
    try:
        patterns = _patterns(series, folder, suffix, where)
    except ImportError as missing:
        patterns, problems = None, [*problems, f"How the beds flow is not shown: {missing}."]
    return {
        "label": series.label,
        "figure": fit,
        "fits": [
            {
                "name": law.capitalize(),
                "formula": found.law.formula,
                "source": found.law.source,
                "table": tables.fit_table(law, found),
            }
            for law, found in series.fits.items()
        ],
        "verdict": series.verdict,
        "problems": problems,
        "flow": picture(flow, folder / f"flow{suffix}", f"W against time{where}", _FLOW),
        "patterns": patterns,
        "profiles": _profiles(series, folder, suffix, where) if series.profiles else None,
    }


def _patterns(series: Series, folder: Path, suffix: str, where: str) -> Picture | None:
    found = [one for one in map(flow_pattern, series.points) if one is not None]
    if not found:
        return None
    return picture(figures.flow_patterns(found), folder / f"patterns{suffix}", f"how the beds flow{where}", _PATTERNS)


def _profiles(series: Series, folder: Path, suffix: str, where: str) -> dict:
    along, middles = figures.outlet_profiles(series), figures.outlet_middles(series)
    return {
        "along": picture(along, folder / f"profiles{suffix}", f"profiles along the outlets{where}", _ALONG),
        "middles": picture(middles, folder / f"middles{suffix}", f"middles of the profiles{where}", _MIDDLES),
        "formula": FORMULA,
        "source": SOURCE,
        "table": tables.profile_table(series),
        "outlets": tables.outlet_table(series),
    }


_FIT = (
    "Points: pooled mean with its 95 % interval; lines: fits with 95 % bands; below: relative residuals. Hollow points "
    "lie outside a law’s range or have no steady flow; they take part in the fit."
)
_FLOW = (
    "W(t) of every replicate. Shaded: the window, between the asked fractions of mass discharged (mean over "
    "replicates); in it the pooled mean and its 95 % interval."
)

_PATTERNS = (
    f"Recorded run of each point. Above: velocities of the grains at one moment, in the middle of the window. Below: "
    f"mean speed in the window with streamlines; hatched: stagnant, that is slower than {SLOW:g} times the speed at "
    f"which the section at that height sinks as a whole. More than {100 * FUNNEL:g} % of the mass stagnant is funnel "
    "flow."
)
_ALONG = (
    "Velocity (left) and area fraction (right) along the outlets: as measured, and divided by their values in the "
    "middle. Points are fitted; bins without points lie nearer to the edges than centres of grains come. Bands: one "
    "standard error over seeds. Dashed: the tilted curves of eqs 16 and 17, where the tilt is significant."
)
_MIDDLES = (
    "Velocity and area fraction in the middle of the outlets, and the flow that the profiles come to, over the flow "
    "counted. Bars: one standard error over seeds."
)


def picture(figure: "Figure", stem: Path, alt: str, caption: str) -> Picture:
    """Write a figure in all formats beside the page, and hold it for the page."""
    style.save(figure, stem)
    data = b64encode(stem.with_name(f"{stem.name}.svg").read_bytes()).decode("ascii")
    width = f"{math.ceil(figure.get_figwidth() / style.MILLIMETRE * 1.45)}mm"
    return Picture(f"data:image/svg+xml;base64,{data}", alt, caption, width)
