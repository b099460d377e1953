"""The report: figures in a folder, and one HTML file that needs nothing beside it.

A page is a box with the result, what was simulated, a list of contents and sections. Each part of a report is a
function that returns sections (`labbook.report.blocks`); `PARTS` is their order.
"""

import os
import re
from collections.abc import Callable, Sequence
from datetime import UTC, date, datetime
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from labbook.campaign import Calibrate
from labbook.lab.folder import write_bytes
from labbook.report import figures, tables
from labbook.report.against import against_sections
from labbook.report.arch import arch_sections
from labbook.report.blocks import Block, Folded, Picture, Section, Verbatim, anchored, picture, slug
from labbook.report.calibrated import calibrated_sections
from labbook.report.clogging import clogging_sections
from labbook.report.composition import composition_sections
from labbook.report.energy import energy_sections
from labbook.report.explored import map_sections
from labbook.report.films import film_sections
from labbook.report.formulas import mathml
from labbook.report.paper import sections_of_all
from labbook.report.residence import residence_sections
from labbook.report.result_box import concerns, result_box, summary
from labbook.report.sections import overview_caption, series_sections
from labbook.report.setting import setting
from labbook.report.starts import start_sections
from labbook.report.statement_tables import statement_digest, statement_table
from labbook.report.velocities import velocity_sections
from labbook.report.walls import wall_sections
from labbook.results import display
from labbook.results.study import StudyResults
from labbook.version import __version__

if TYPE_CHECKING:
    from jinja2 import Environment

__all__ = ["FILE", "PARTS", "environment", "summary", "write"]

FILE = "report.html"

SectionSource = Callable[[StudyResults, Path], Sequence[Section]]
"""Makes sections of what was found; figures go into the folder."""


def write(results: StudyResults, folder: Path, today: date | None = None) -> Path:
    """Write the report of a study into `folder` (made if missing): report.html and its figures. Path of the page.

    today: the date of the report (UTC); None: that of `SOURCE_DATE_EPOCH` if it is set, else of now.
    """
    folder.mkdir(parents=True, exist_ok=True)
    study = results.study
    sections = anchored(
        [section for sections_of in _section_sources(results) for section in sections_of(results, folder)],
        {"result", "contents"},
    )
    text = (
        environment()
        .get_template("report.html.j2")
        .render(
            title=study.name,
            about=study.about,
            version=__version__,
            box=result_box(results),
            concerned=bool(concerns(results)),
            setting=setting(results, today or _today()),
            sections=sections,
        )
    )
    write_bytes(folder / FILE, text.encode(), durable=False)
    return folder / FILE


def _today() -> date:
    """The date, or the one that a reproducible build asks for."""
    epoch = os.environ.get("SOURCE_DATE_EPOCH")
    return (datetime.fromtimestamp(int(epoch), UTC) if epoch else datetime.now(UTC)).date()


def _flow_rates(results: StudyResults, folder: Path) -> list[Section]:
    """The table of all points and every series; a series that is the only one goes first, as its figure shows them."""
    flowing = tables.flowing_table(results)
    clogged = (Folded(tables.CLOGGED, (flowing,)),) if flowing is not None else ()
    table = Section("Flow rates", (tables.flow_table(results), *clogged))
    series = series_sections(results, folder)
    return [*series, table] if len(results.series) == 1 else [table, *series]


def _overview(results: StudyResults, folder: Path) -> list[Section]:
    """All series in one picture, and fitted parameters against what else was swept."""
    pictures: list[Picture] = []
    fitted = [each_series for each_series in results.series if each_series.used]
    if len(fitted) > 1 and len({result.orifice for each_series in fitted for result in each_series.points}) > 1:
        figure = figures.overview(fitted)  # against one orifice there is nothing to see
        alt = "a power of W against orifice, all series"
        pictures.append(picture(figure, folder / "overview", alt, overview_caption(fitted)))
    sections = [Section("Flow rate against orifice, all series", tuple(pictures))] if pictures else []
    if trends := _trends(results, folder):
        sections.append(Section("Fitted parameters against swept keys", tuple(trends)))
    return sections


def _trends(results: StudyResults, folder: Path) -> list[Picture]:
    """Fitted parameters of every law against the key that takes most values, if it takes several."""
    values = {
        name: {each_series.at[name] for each_series in results.series if name in each_series.at}
        for swept_series in results.series
        for name in swept_series.at
    }
    numbers = {name: len(found) for name, found in values.items() if not any(isinstance(v, str) for v in found)}
    key = max(numbers, key=lambda name: numbers[name], default="")
    pictures = []
    for law in dict.fromkeys(
        law for each_series in results.series for law in (*each_series.fits, *each_series.further)
    ):
        points = {
            each_series.at[key]
            for each_series in results.series
            if each_series.parameters(law) and key in each_series.at
        }
        if len(points) > 1:
            figure = figures.parameters_against(key, law, results.series, results.comparisons)
            called = law.replace("_", " ")
            caption = f"Parameters of {called.capitalize()} with 95 % intervals; diamonds: the reference."
            name = display.key(key).name
            stem = folder / f"{slug(called)}-{slug(name)}"
            pictures.append(picture(figure, stem, f"parameters of {called} against {name}", caption))
    return pictures


def _reference(results: StudyResults, folder: Path) -> list[Section]:
    if not results.comparisons:
        return []
    every, digest = tables.comparison_table(results.comparisons), tables.digest_table(results.comparisons)
    blocks: tuple[Block, ...] = (every,) if digest is None else (digest, Folded("Every number", (every,)))
    return [Section(f"Beside {results.source}", blocks)]


def _statements(results: StudyResults, folder: Path) -> list[Section]:
    if not results.judged:
        return []
    every, digest = statement_table(results.judged), statement_digest(results.judged)
    folded = Folded("Statements at every point", (every,))
    blocks: tuple[Block, ...] = (every,) if digest is None else (digest, folded)
    return [Section(f"Statements of {results.source}", blocks)]


def _numerics(results: StudyResults, folder: Path) -> list[Section]:
    return [Section("Do numerics matter?", (tables.numerical_table(results.numerical),))] if results.numerical else []


def _budget(results: StudyResults, folder: Path) -> list[Section]:
    table = tables.budget_table(results)
    return [Section("Error budget", (table,))] if table.rows else []


def _further(results: StudyResults, folder: Path) -> list[Section]:
    table = tables.further_table(results)
    return [Section("Further measurements", (table,))] if table is not None else []


def _outcomes(results: StudyResults, folder: Path) -> list[Section]:
    return [Section("How runs ended", (tables.outcomes_table(results),))]


def _provenance(results: StudyResults, folder: Path) -> list[Section]:
    blocks: list[Block] = [Folded("Versions and machines", (tables.provenance_table(results),))]
    blocks.append(Folded("Keys of all runs", (tables.runs_table(results),)))
    blocks.append(Folded("The study file", (Verbatim(results.study.text),)))
    return [Section("Provenance", tuple(blocks))]


PARTS: tuple[SectionSource, ...] = (
    map_sections,
    against_sections,
    _overview,
    _reference,
    _statements,
    sections_of_all,
    clogging_sections,
    arch_sections,
    _flow_rates,
    film_sections,
    composition_sections,
    residence_sections,
    energy_sections,
    velocity_sections,
    start_sections,
    wall_sections,
    _budget,
    _numerics,
    _further,
    _outcomes,
    _provenance,
)

OF_CALIBRATIONS: tuple[SectionSource, ...] = (calibrated_sections, _outcomes, _provenance)
"""Parts of the report of a calibration, whose points differ in parameters that have no meaning alone."""


def _section_sources(results: StudyResults) -> tuple[SectionSource, ...]:
    return OF_CALIBRATIONS if isinstance(results.study.adapt, Calibrate) else PARTS


@lru_cache(maxsize=8192)
def _typeset(text: str):
    """HTML in which ^(...) is a superscript and a single letter's _index a subscript."""
    from markupsafe import Markup, escape

    raised = re.sub(r"\^\(([^)]*)\)", r"<sup>\1</sup>", str(escape(text)))
    return Markup(re.sub(r"\b(\w)_(\w+|∞)", r"\1<sub>\2</sub>", raised))


def _formula(text: str):
    """A formula as MathML."""
    from markupsafe import Markup

    return Markup(mathml(text))


def environment(*packages: str) -> "Environment":
    """Templates that draw blocks (`blocks.html.j2`): those of the report, and before them those of other packages."""
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined, select_autoescape

    templates = Environment(
        loader=ChoiceLoader([PackageLoader(name) for name in (*packages, "labbook.report")]),
        autoescape=select_autoescape(["j2", "html"]),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    templates.filters["typeset"] = _typeset
    templates.filters["formula"] = _formula
    return templates
