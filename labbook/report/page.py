"""The report: figures in a folder, and one HTML file that needs nothing beside it."""

import math
import re
from pathlib import Path

from labbook import __version__
from labbook.fit import DEFINITIONS
from labbook.lab.folder import write_bytes
from labbook.measure.flow import CUT_SHORT
from labbook.report import figures, tables
from labbook.report.across import outlet_pictures, ratio_sections
from labbook.report.sections import Picture, picture, series_section
from labbook.report.statement_tables import statement_digest, statement_table
from labbook.report.tables import numerical_table
from labbook.report.turning import scaling, turning_section
from labbook.results import display
from labbook.results.numerical import summed_up as numerics_summed_up
from labbook.results.points import redundant
from labbook.results.reference import agreement
from labbook.results.series import PACKING_FRACTION
from labbook.results.statements import summed_up
from labbook.results.study import Results

FILE = "report.html"


def write(results: Results, folder: Path) -> Path:
    """Write the report of a study into `folder` (made if missing): report.html and its figures. Path of the page."""
    folder.mkdir(parents=True, exist_ok=True)
    study = results.study
    text = _template().render(
        title=study.name,
        about=study.about,
        version=__version__,
        summary=summary(results),
        incomplete=bool(results.missing or results.unreadable) or any(r.precise is False for r in results.points),
        source=results.source,
        comparison=tables.comparison_table(results.comparisons) if results.comparisons else None,
        digest=tables.digest_table(results.comparisons),
        statements=statement_table(results.judged) if results.judged else None,
        statement_digest=statement_digest(results.judged),
        turning=turning_section(results, folder),
        overview=_overview(results, folder),
        scaling=None if results.turning else scaling(results, folder),
        trends=_trends(results, folder),
        ratios=ratio_sections(results, folder),
        series=[series_section(results, k, folder) for k in range(len(results.series))],
        flow=tables.flow_table(results),
        numerics=numerical_table(results.numerical) if results.numerical else None,
        further=tables.further_table(results),
        outcomes=tables.outcomes_table(results),
        provenance=tables.provenance_table(results),
        runs=tables.runs_table(results),
        study_text=study.path.read_text(encoding="utf-8") if study.path.is_file() else study.yaml(),
    )
    write_bytes(folder / FILE, text.encode(), durable=False)
    return folder / FILE


def summary(results: Results) -> list[str]:
    """What a reader should know first, in plain sentences."""
    study, runs = results.study, sum(len(result.runs) for result in results.points)
    sentences = [f"{_count(runs, 'run')} of {_count(len(results.points), 'point')}."]
    if results.missing:
        extra = redundant(study.points)
        names = "; ".join(display.label(point.at, extra) for point in results.missing[:5])
        more = f" and {len(results.missing) - 5} more" if len(results.missing) > 5 else ""
        sentences.append(f"Not finished yet: {names}{more}.")
    partial = [f"{one.label} ({len(one.runs)} of {one.asked})" for one in results.points if one.partial]
    if partial:
        listed = "; ".join(partial[:5]) + (f" and {len(partial) - 5} more" if len(partial) > 5 else "")
        sentences.append(f"Runs are lacking at {listed}: the first to end are no fair sample.")
    if results.unreadable:
        sentences.append(f"{_count(len(results.unreadable), 'run')} could not be read: {results.unreadable[0]}.")
    if study.accuracy.flow_rate is not None:
        short = [result.label for result in results.points if result.precise is False]
        asked = f"{100 * study.accuracy.flow_rate:g} %"
        if short:
            sentences.append(f"The asked error of {asked} on the flow rate is not met at {'; '.join(short)}.")
        elif results.points:
            sentences.append(f"The flow rate of every point is known to the asked {asked} (95 % interval).")
    measured = [run.measured for result in results.points for run in result.runs]
    packings = [one[PACKING_FRACTION] for one in measured if PACKING_FRACTION in one]
    if unknown := [one for one in packings if math.isnan(one.value)]:
        sentences.append(f"No packing fraction of {len(unknown)} of {_count(len(packings), 'run')}: {unknown[0].note}.")
    trending = [result.label for result in results.points if result.trending]
    if trending:
        sentences.append(f"No plateau of W within the window (trending): {'; '.join(trending)}.")
    if cut := [result.label for result in results.points if result.notes[CUT_SHORT]]:
        sentences.append(
            f"The bed fell to stop.fill_height before the window ended (window.end, {study.window.end:g}) at "
            f"{'; '.join(cut)}, so that W is a mean over less than the window: lower one of them in {study.path.name}."
        )
    if results.comparisons:
        sentences.append(agreement(results.comparisons, results.source))
    if tested := numerics_summed_up(results.numerical):
        sentences.append(tested)
    if results.judged:
        sentences.append(summed_up(results.judged, results.source))
    return sentences


def _count(n: int, noun: str) -> str:
    return f"{n} {noun}{'' if n == 1 else 's'}"


def _overview(results: Results, folder: Path) -> Picture | None:
    fitted = [one for one in results.series if one.used]
    if len(fitted) < 2 or len({result.orifice for one in fitted for result in one.points}) < 2:
        return None  # against one orifice there is nothing to see
    return picture(figures.overview(fitted), folder / "overview", "a power of W against orifice, all series", _OVERVIEW)


def _trends(results: Results, folder: Path) -> list[Picture]:
    """Fitted parameters of every law against the key that takes most values, if it takes several."""
    values = {
        name: {one.at[name] for one in results.series if name in one.at} for one in results.series for name in one.at
    }
    numbers = {name: len(found) for name, found in values.items() if not any(isinstance(v, str) for v in found)}
    key = max(numbers, key=lambda name: numbers[name], default="")
    pictures = []
    for law in (*dict.fromkeys(law for one in results.series for law in one.fits), *DEFINITIONS):
        places = {one.at[key] for one in results.series if one.parameters(law) and key in one.at}
        if len(places) > 1:
            figure = figures.parameters_against(key, law, results.series, results.comparisons)
            called = law.replace("_", " ")
            caption = f"Parameters of {called.capitalize()} with 95 % intervals; diamonds: the reference."
            name = display.key(key).name
            stem = folder / f"{_slug(called)}-{_slug(name)}"
            pictures.append(picture(figure, stem, f"parameters of {called} against {name}", caption))
    return pictures + outlet_pictures(results, folder)


_OVERVIEW = "Flow rate of all series; lines are the first law fitted."


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
