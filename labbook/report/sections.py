"""What the page shows of one series: its figures with their captions, and its tables."""

import math
from base64 import b64encode
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from labbook.fields.pattern import FUNNEL, SLOW
from labbook.fit.outlet import DEFINITIONS, FORMULA, SOURCE
from labbook.measure.orifice import INTERVAL
from labbook.report import figures, outlet_tables, style, tables
from labbook.report.fitted_tables import fit_table
from labbook.results.recorded import acceleration, flow_patterns, pooled_means
from labbook.results.reference import at_series
from labbook.results.series import Series
from labbook.results.study import Results

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Picture:
    """A figure as the page holds it: a data URI, what it shows in words, its caption and its width."""

    uri: str
    alt: str
    caption: str
    width: str


def series_section(results: Results, index: int, folder: Path) -> dict:
    """Figures, tables and remarks of the series numbered `index`, as the template takes them."""
    series = results.series[index]
    suffix = f"-{index + 1}" if len(results.series) > 1 else ""
    where = f" ({series.label})" if series.label else ""
    fit = None
    if series.fits or len(series.used) > 1:  # a single point shows nothing
        figure = figures.flow_against_orifice(series, results.comparisons, results.source)
        fit = picture(figure, folder / f"fit{suffix}", f"a power of W against orifice{where}", _FIT)
    flow = figures.flow_against_time(series)
    turning = any(set(series.points) & set(curve.points) for curve in results.turning)  # has a section of its own
    problems = [f"Not fitted: {problem}." for problem in series.problems]
    try:
        patterns = None if turning else _patterns(series, folder, suffix, where)
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
                "table": fit_table(law, found, at_series(results.comparisons, law, series), results.source),
            }
            for law, found in series.fits.items()
        ],
        "verdict": series.verdict,
        "problems": problems,
        "flow": picture(flow, folder / f"flow{suffix}", f"W against time{where}", _FLOW),
        "patterns": patterns,
        "acceleration": None if turning else _acceleration(series, folder, suffix, where),
        "profiles": [_profiles(results, series, name, folder, suffix, where) for name in series.profiles],
    }


def _patterns(series: Series, folder: Path, suffix: str, where: str) -> tuple[Picture, tables.Table] | None:
    found = [one for one in map(flow_patterns, series.points) if one]
    if not found:
        return None
    figure = figures.flow_patterns([one[0] for one in found])
    shown = picture(figure, folder / f"patterns{suffix}", f"how the beds flow{where}", PATTERNS)
    return shown, outlet_tables.orifice_table([(one[0].result, pooled_means(one)) for one in found])


def _acceleration(series: Series, folder: Path, suffix: str, where: str) -> Picture | None:
    found = [(result, profile) for result in series.points if (profile := acceleration(result)) is not None]
    if not found:
        return None
    figure = figures.acceleration_against_height(found, found[0][0].point.scene.gravity)
    return picture(figure, folder / f"acceleration{suffix}", f"acceleration against height{where}", _ACCELERATION)


def _profiles(
    results: Results, series: Series, definition: str, folder: Path, suffix: str, where: str
) -> dict[str, Any]:
    name = definition.removeprefix("outlet_")
    along = figures.outlet_profiles(series, definition, results.comparisons, results.source)
    middles = figures.outlet_middles(series, definition, results.comparisons, results.source)
    return {
        "along": picture(along, folder / f"{name}{suffix}", f"{name} along the outlets{where}", _ALONG),
        "middles": picture(middles, folder / f"{name}-middles{suffix}", f"middles of the {name}{where}", _MIDDLES),
        "definition": DEFINITIONS[definition],
        "formula": FORMULA,
        "source": SOURCE,
        "table": outlet_tables.profile_table(series, definition, results.comparisons, results.source),
        "outlets": outlet_tables.outlet_table(series, definition),
    }


_FIT = (
    "Points: pooled mean with its 95 % interval; lines: fits, with the 95 % band of the law "
    "and, fainter, of one more point of as many seeds; below: relative residuals. Hollow points "
    "lie outside a law’s range or have no steady flow; they take part in the fit."
)
_FLOW = (
    "W(t) of every replicate. Shaded: the window, between the asked fractions of mass discharged (mean over "
    "replicates); in it the pooled mean and its 95 % interval."
)

PATTERNS = (
    "First recorded run of each point. Above: velocities of the grains at one moment, in the middle of the window; "
    "arrows are as long as the square root of the speed. Below: mean speed in the window with streamlines; hatched: "
    f"stagnant, that is slower than {SLOW:g} times the speed at which the section at that height sinks as a whole. "
    f"More than {100 * FUNNEL:g} % of the mass stagnant is funnel flow."
)
_ACCELERATION = (
    f"Mean change of the vertical velocity within {INTERVAL * 1e3:g} ms (whole frames), of grains that start at this "
    "height within a quarter of the outlet’s width from its middle, in the window; 1 is free fall. Grains that leave "
    "meanwhile are continued by free fall. Bars: standard errors over grains, a lower bound."
)
_ALONG = (
    "Velocity (left) and area fraction (right) along the outlets: as measured, and divided by their values in the "
    "middle. Points are fitted; bins without points are not. Bands about points: one standard error over seeds; about "
    "the law: 95 %, of the law and, fainter, of a bin of one more outlet. Dashed: the tilted curves of eqs 16 and 17, "
    "where the tilt is significant; the bands are then theirs."
)
_MIDDLES = (
    "Velocity and area fraction in the middle of the outlets, and the flow that the profiles come to, over the flow "
    "counted. Bars: one standard error over seeds; bands: 95 %, of the law and, fainter, of one more outlet; dots: the "
    "law with the parameters of the reference, its φ_∞ being ours where it has only τ₁ and τ₂."
)


def picture(figure: "Figure", stem: Path, alt: str, caption: str) -> Picture:
    """Write a figure in all formats beside the page, and hold it for the page."""
    style.save(figure, stem)
    data = b64encode(stem.with_name(f"{stem.name}.svg").read_bytes()).decode("ascii")
    width = f"{math.ceil(figure.get_figwidth() / style.MILLIMETRE * 1.45)}mm"
    return Picture(f"data:image/svg+xml;base64,{data}", alt, caption, width)
