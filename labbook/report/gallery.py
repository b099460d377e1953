"""The figures of a report by name, for whoever wants one of them and not the page."""

from typing import TYPE_CHECKING, Literal, TypeAlias

from labbook.measure.composition import Composition
from labbook.measure.residence import Residence
from labbook.report import figures
from labbook.report.against import found_against
from labbook.report.blocks import slug
from labbook.report.composition import compositions
from labbook.report.energy import balanced
from labbook.report.explored import mapped
from labbook.report.paper import Draw, figures_of_all
from labbook.report.residence import residence_of
from labbook.results.explore import explore
from labbook.results.recorded import acceleration, flow_patterns
from labbook.results.series import Series
from labbook.results.study import StudyResults
from labbook.results.surface import NoSurface

if TYPE_CHECKING:
    from matplotlib.figure import Figure


FILES = {"fit": "flow_rate", "orifice": "flow_rate", "flow": "flow_over_time", "residence-map": "residence_map"}
"""Names of figures whose files in a report are called otherwise, by the name of the file."""


FigureName: TypeAlias = Literal[
    "flow_rate",
    "flow_over_time",
    "patterns",
    "acceleration",
    "overview",
    "map",
    "composition",
    "energy",
    "residence",
    "residence_map",
    "residence-map",
    "fit",
    "orifice",
    "flow",
]
"""Names that editors complete: figures of any study, and names of their files. Papers and swept keys add others."""


class NothingToShow(LookupError):
    """There is no such figure of these results; the message says why and what to do."""


def of_results(results: StudyResults) -> dict[str, Draw]:
    """Figures that show several series at once, by name, as functions that draw them."""
    found: dict[str, Draw] = {}
    fitted = [one for one in results.series if one.used]
    if len(fitted) > 1 and len({result.orifice for one in fitted for result in one.points}) > 1:
        found["overview"] = lambda: figures.overview(fitted)
    if mapped(results):
        found["map"] = lambda: _map(results)
    for one in found_against(results):
        found[f"against_{slug(one.key)}"] = lambda one=one: figures.against_key(one)
    if Composition.name in results.study.measure and (points := compositions(results)):
        found["composition"] = lambda: figures.composition_against_discharge(points)
    if energies := balanced(results):
        found["energy"] = lambda: figures.energy_balance(energies)
    if Residence.name in results.study.measure:
        maps, curves = residence_of(results)
        if maps:
            found["residence_map"] = lambda: figures.residence_maps(maps)
        if curves:
            found["residence"] = lambda: figures.residence_distributions(curves)
    return found | figures_of_all(results)


def of_series(results: StudyResults, series: Series) -> dict[str, Draw]:
    """Figures of one series by name, as functions that draw them."""
    beside, source = results.comparisons, results.source
    found: dict[str, Draw] = {}
    if series.fits or len(series.used) > 1:
        found["flow_rate"] = lambda: figures.flow_against_orifice(series, beside, source)
    if any(run.trace is not None for result in series.points for run in result.runs):
        found["flow_over_time"] = lambda: figures.flow_against_time(series)
    if any(run.recorded for result in series.points for run in result.runs):
        found["patterns"] = lambda: _patterns(series)
        found["acceleration"] = lambda: _acceleration(series)
    return found | figures_of_all(results, series)


def _map(results: StudyResults) -> "Figure":
    try:
        return figures.design_map(explore(results))
    except NoSurface as problem:
        raise NothingToShow(f"map: {problem}") from None


def _patterns(series: Series) -> "Figure":
    found = [one[0] for one in map(flow_patterns, series.points) if one]
    if not found:
        raise NothingToShow("patterns: too few frames were recorded within the window; record more often")
    return figures.flow_patterns(found)


def _acceleration(series: Series) -> "Figure":
    found = [(result, profile) for result in series.points if (profile := acceleration(result)) is not None]
    if not found:
        raise NothingToShow("acceleration: no two frames are close enough in time; record every few milliseconds")
    return figures.acceleration_against_height(found, series.points[0].point.scene.gravity)
