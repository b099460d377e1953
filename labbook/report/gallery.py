"""The figures of a report by name, for whoever wants one of them and not the page."""

from typing import TYPE_CHECKING, Literal, TypeAlias

from labbook.measure.acceleration import AccelerationProfile
from labbook.measure.composition import Composition
from labbook.measure.residence import Residence
from labbook.report import energy, explored, figures, residence
from labbook.report.against import against_caption, found_against
from labbook.report.blocks import slug
from labbook.report.composition import CAPTION as COMPOSITION_CAPTION
from labbook.report.composition import compositions
from labbook.report.paper import Draw, Drawing, figures_of_all
from labbook.report.sections import PATTERNS, acceleration_caption, fit_caption, flow_caption, overview_caption
from labbook.results.explore import explore
from labbook.results.points import PointResult
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
    drawings: dict[str, Draw] = {}
    fitted = [each_series for each_series in results.series if each_series.used]
    if len(fitted) > 1 and len({result.orifice for each_series in fitted for result in each_series.points}) > 1:
        drawings["overview"] = Drawing(lambda: figures.overview(fitted), lambda: overview_caption(fitted), "points")
    if explored.mapped(results):
        drawings["map"] = Drawing(lambda: _map(results), lambda: explored.CAPTION, "points")
    for comparison in found_against(results):
        drawings[f"against_{slug(comparison.key)}"] = Drawing(
            lambda ratios=comparison: figures.against_key(ratios),
            lambda ratios=comparison: against_caption(ratios),
            "against",
        )
    if Composition.name in results.study.measure and (points := compositions(results)):
        drawings["composition"] = Drawing(
            lambda: figures.composition_against_discharge(points), lambda: COMPOSITION_CAPTION, "composition"
        )
    if energies := energy.balanced(results):
        drawings["energy"] = Drawing(lambda: figures.energy_balance(energies), lambda: energy.CAPTION, "points")
    if Residence.name in results.study.measure:
        maps, curves = residence.residence_of(results)
        if maps:
            drawings["residence_map"] = Drawing(
                lambda: figures.residence_maps(maps), lambda: residence.MAP_CAPTION, "residence"
            )
        if curves:
            drawings["residence"] = Drawing(
                lambda: figures.residence_distributions(curves), lambda: residence.CURVE_CAPTION, "residence_times"
            )
    return drawings | figures_of_all(results)


def of_series(results: StudyResults, series: Series) -> dict[str, Draw]:
    """Figures of one series by name, as functions that draw them."""
    beside, source = results.comparisons, results.source
    drawings: dict[str, Draw] = {}
    if series.fits or len(series.used) > 1:
        drawings["flow_rate"] = Drawing(
            lambda: figures.flow_against_orifice(series, beside, source), lambda: fit_caption(series), "points"
        )
    return drawings | of_points(series) | figures_of_all(results, series)


def of_points(series: Series) -> dict[str, Draw]:
    """Figures with a panel or a curve for each point of a series, by name, as functions that draw them."""
    drawings: dict[str, Draw] = {}
    if any(run.trace is not None for result in series.whole_points for run in result.runs):
        drawings["flow_over_time"] = Drawing(
            lambda: figures.flow_against_time(series), lambda: flow_caption(series), "flow"
        )
    if any(run.recorded for result in series.whole_points for run in result.runs):
        drawings["patterns"] = Drawing(lambda: _patterns(series), lambda: PATTERNS)
        drawings["acceleration"] = Drawing(
            lambda: _acceleration(series), lambda: acceleration_caption(_accelerations(series)), "accelerations"
        )
    return drawings


def _map(results: StudyResults) -> "Figure":
    try:
        return figures.design_map(explore(results))
    except NoSurface as problem:
        raise NothingToShow(f"map: {problem}") from None


def _patterns(series: Series) -> "Figure":
    patterns = [pattern[0] for pattern in map(flow_patterns, series.whole_points) if pattern]
    if not patterns:
        raise NothingToShow("patterns: too few frames were recorded within the window; record more often")
    return figures.flow_patterns(patterns)


def _accelerations(series: Series) -> list[tuple[PointResult, AccelerationProfile]]:
    return [(result, profile) for result in series.whole_points if (profile := acceleration(result)) is not None]


def _acceleration(series: Series) -> "Figure":
    profiles = _accelerations(series)
    if not profiles:
        raise NothingToShow("acceleration: no two frames are close enough in time; record every few milliseconds")
    return figures.acceleration_against_height(profiles, series.points[0].point.scene.gravity)
