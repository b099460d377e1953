"""The report: figures in a folder, and one HTML file that needs nothing beside it."""

import math
import os
import re
from base64 import b64encode
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from labbook import __version__
from labbook.fit import OUTLET_PROFILES
from labbook.fit.outlet import FORMULA, SOURCE
from labbook.report import display, figures, style, tables
from labbook.report.analysis import Analysis, redundant
from labbook.report.comparison import agreement
from labbook.report.series import Series

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FILE = "report.html"


@dataclass(frozen=True)
class Picture:
    """A figure as the page holds it: a data URI, what it shows in words, its caption and its width."""

    uri: str
    alt: str
    caption: str
    width: str


def write(analysis: Analysis, folder: Path) -> Path:
    """Write the report of a study into `folder` (made if missing): report.html and its figures. Path of the page."""
    folder.mkdir(parents=True, exist_ok=True)
    study = analysis.study
    source = study.reference.source if study.reference is not None else ""
    text = _template().render(
        title=study.name,
        about=study.about,
        version=__version__,
        summary=summary(analysis),
        incomplete=bool(analysis.missing or analysis.unreadable) or any(r.precise is False for r in analysis.points),
        source=source,
        comparison=tables.comparison_table(analysis.comparisons) if analysis.comparisons else None,
        overview=_overview(analysis, folder),
        trends=_trends(analysis, folder),
        series=[_series(analysis, k, folder) for k in range(len(analysis.series))],
        flow=tables.flow_table(analysis),
        further=tables.further_table(analysis),
        outcomes=tables.outcomes_table(analysis),
        provenance=tables.provenance_table(analysis),
        runs=tables.runs_table(analysis),
        study_text=study.path.read_text(encoding="utf-8") if study.path.is_file() else "",
    )
    page, partial = folder / FILE, folder / f".{FILE}.{os.getpid()}"
    partial.write_text(text, encoding="utf-8")
    os.replace(partial, page)
    return page


def summary(analysis: Analysis) -> list[str]:
    """What a reader should know first, in plain sentences."""
    study, runs = analysis.study, sum(len(result.runs) for result in analysis.points)
    sentences = [f"{_count(runs, 'run')} of {_count(len(analysis.points), 'point')}."]
    if analysis.missing:
        extra = redundant(study.points)
        names = "; ".join(display.label(point.at, extra) for point in analysis.missing[:5])
        more = f" and {len(analysis.missing) - 5} more" if len(analysis.missing) > 5 else ""
        sentences.append(f"Not finished yet: {names}{more}.")
    if analysis.unreadable:
        sentences.append(f"{_count(len(analysis.unreadable), 'run')} could not be read: {analysis.unreadable[0]}.")
    if study.accuracy.flow_rate is not None:
        short = [result.label for result in analysis.points if result.precise is False]
        asked = f"{100 * study.accuracy.flow_rate:g} %"
        if short:
            sentences.append(f"The asked error of {asked} on the flow rate is not met at {'; '.join(short)}.")
        elif analysis.points:
            sentences.append(f"The flow rate of every point is known to the asked {asked} (95 % interval).")
    trending = [result.label for result in analysis.points if result.trending]
    if trending:
        sentences.append(f"No plateau of W within the window (trending): {'; '.join(trending)}.")
    if analysis.comparisons and study.reference is not None:
        sentences.append(agreement(analysis.comparisons, study.reference.source))
    return sentences


def _count(n: int, noun: str) -> str:
    return f"{n} {noun}{'' if n == 1 else 's'}"


def _overview(analysis: Analysis, folder: Path) -> Picture | None:
    fitted = [one for one in analysis.series if one.used]
    if len(fitted) < 2:
        return None
    return _picture(
        figures.overview(fitted), folder / "overview", "W to the power 2/3 against orifice, all series", _OVERVIEW
    )


def _trends(analysis: Analysis, folder: Path) -> list[Picture]:
    """Fitted parameters of every law against the key that takes most values, if it takes several."""
    values = {
        name: {one.at[name] for one in analysis.series if name in one.at} for one in analysis.series for name in one.at
    }
    numbers = {name: len(found) for name, found in values.items() if not any(isinstance(v, str) for v in found)}
    key = max(numbers, key=lambda name: numbers[name], default="")
    pictures = []
    for law in (*dict.fromkeys(law for one in analysis.series for law in one.fits), OUTLET_PROFILES):
        places = {one.at[key] for one in analysis.series if one.parameters(law) and key in one.at}
        if len(places) > 1:
            figure = figures.parameters_against(key, law, analysis.series, analysis.comparisons)
            called = law.replace("_", " ")
            caption = f"Parameters of {called.capitalize()} with 95 % intervals; diamonds: the reference."
            name = display.key(key).name
            stem = folder / f"{_slug(called)}-{_slug(name)}"
            pictures.append(_picture(figure, stem, f"parameters of {called} against {name}", caption))
    return pictures


def _series(analysis: Analysis, index: int, folder: Path) -> dict:
    series, reference = analysis.series[index], analysis.study.reference
    suffix = f"-{index + 1}" if len(analysis.series) > 1 else ""
    where = f" ({series.label})" if series.label else ""
    fit = None
    if series.used:
        source = reference.source if reference is not None else ""
        figure = figures.flow_against_orifice(series, analysis.comparisons, source)
        fit = _picture(figure, folder / f"fit{suffix}", f"W to the power 2/3 against orifice{where}", _FIT)
    flow = figures.flow_against_time(series)
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
        "problems": [f"Not fitted: {problem}." for problem in series.problems],
        "flow": _picture(flow, folder / f"flow{suffix}", f"W against time{where}", _FLOW),
        "profiles": _profiles(series, folder, suffix, where) if series.profiles else None,
    }


def _profiles(series: Series, folder: Path, suffix: str, where: str) -> dict:
    along, middles = figures.outlet_profiles(series), figures.outlet_middles(series)
    return {
        "along": _picture(along, folder / f"profiles{suffix}", f"profiles along the outlets{where}", _ALONG),
        "middles": _picture(middles, folder / f"middles{suffix}", f"middles of the profiles{where}", _MIDDLES),
        "formula": FORMULA,
        "source": SOURCE,
        "table": tables.profile_table(series),
        "outlets": tables.outlet_table(series),
    }


_OVERVIEW = "Flow rate of all series; lines are the first law fitted."
_FIT = (
    "Points: pooled mean with its 95 % interval; lines: fits with 95 % bands; below: relative residuals. Hollow points "
    "lie outside a law’s range or have no steady flow; they take part in the fit."
)
_FLOW = (
    "W(t) of every replicate. Shaded: the window, between the asked fractions of mass discharged (mean over "
    "replicates); in it the pooled mean and its 95 % interval."
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


def _picture(figure: "Figure", stem: Path, alt: str, caption: str) -> Picture:
    style.save(figure, stem)
    data = b64encode(stem.with_name(f"{stem.name}.svg").read_bytes()).decode("ascii")
    width = f"{math.ceil(figure.get_figwidth() / style.MILLIMETRE * 1.45)}mm"
    return Picture(f"data:image/svg+xml;base64,{data}", alt, caption, width)


def _slug(text: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")


def _raised(text: str):
    """HTML in which what is written ^(...) is a superscript."""
    from markupsafe import Markup, escape

    return Markup(re.sub(r"\^\(([^)]*)\)", r"<sup>\1</sup>", str(escape(text))))


def _template():
    from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape

    environment = Environment(
        loader=PackageLoader("labbook.report"),
        autoescape=select_autoescape(["j2", "html"]),
        undefined=StrictUndefined,
        trim_blocks=True,
    )
    environment.filters["raised"] = _raised
    return environment.get_template("report.html.j2")
