"""Quasi-2D hopper of Fan et al., Powder Technology 429 (2023) 118964: angle of the bottom, position of the outlet.

Profiles along outlets and the flow rate that follows from them (eqs 10 to 18), and flow rates over a plain hopper's.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import ClassVar

from labbook.measure import Quantity
from labbook.measure.outlet import COVERAGE, CROSSINGS, DEFINITIONS
from labbook.papers import Draw, Drawing, Paper
from labbook.papers.fan2023 import figures, pages
from labbook.papers.fan2023.laws import FEWEST, TERMS
from labbook.papers.fan2023.profiles import OF_OUTLET, SHAPE, approaches, fit_along, profile_fit
from labbook.papers.fan2023.ratios import RATIOS, Ratio, angle_factors, by_position
from labbook.report.blocks import Block, Section
from labbook.report.tables import Table
from labbook.results.frames import of_point
from labbook.results.paper import Row
from labbook.results.points import PointResult
from labbook.results.reference import Comparison, matches, sought
from labbook.results.series import FurtherFit, Series
from labbook.results.study import StudyResults


def _declared() -> Iterator[Quantity]:
    yield Quantity("flow_ratio.angle", "W/W of the flat bottom", meaning="flow rate over that of a flat bottom")
    yield Quantity("flow_ratio.position", "W/W in the middle", meaning="flow rate over that of an outlet in the middle")
    symbols = {"a": "a", "gamma": "γ", "b": "b", "phi_inf": "φ_∞", "tau1": "τ₁", "tau2": "τ₂"}
    symbols |= {"delta1": "δ₁", "delta2": "δ₂", "epsilon1": "ε₁", "epsilon2": "ε₂", "sigma1": "σ₁", "sigma2": "σ₂"}
    for fit, suffix in ((COVERAGE, ""), (CROSSINGS, " (crossings)")):
        for name, symbol in symbols.items():
            # a tilt that cannot be told from zero is a finding, not a failed fit
            quantity = Quantity(f"{fit}.{name}", symbol + suffix, about_zero=name.startswith("delta"))
            yield replace(quantity, unit="1/m", shown="1/mm", scale=1e-3) if name == "tau2" else quantity
        for name in SHAPE:  # of its approach to what it is in the middle, limit - depth e^{-rate s*}
            for term in TERMS:
                text = f"{term} of {symbols[name]}(s*){suffix}"
                yield Quantity(f"{fit}.{name}.{term}", text, about_zero=name.startswith("delta"))


class Fan2023(Paper):
    """Fits `outlet_profiles` and `outlet_crossings`, their approach to the middle, and `flow_ratio.*`."""

    name = "fan2023"
    fits = dict.fromkeys(DEFINITIONS, COVERAGE)
    declared = tuple(_declared())
    columns: ClassVar = {
        "outlets": {"R": "m"},
        "ratios": dict.fromkeys(("value", "error", "low", "high", "s_star"), ""),
    }

    def fit(self, name: str, points: Sequence[PointResult]) -> FurtherFit:
        return fit_along(name, points)

    def compared(
        self, results: StudyResults, quantity: str, at: Mapping[str, float | str]
    ) -> Sequence[Comparison] | None:
        head, _, tail = quantity.partition(".")
        shape, _, term = tail.partition(".")
        points = [result for result in results.points if matches(at, result.point)]
        if quantity in RATIOS:
            # of all points: the plain hopper is not among those selected by `at`
            return [_of_ratio(quantity, ratio) for ratio in RATIOS[quantity](results.points) if ratio.result in points]
        if head in DEFINITIONS and shape in SHAPE and term in TERMS:
            return [_of_approach(sought(quantity, at), head, shape, term, points)]
        return None

    def frames(self, results: StudyResults) -> Mapping[str, Iterable[Row]]:
        """Frames `ratios` and `outlets`.

        `ratios`: a row a point, W over a plain hopper's, with the laws of the angle. `outlets`: a row a point and
        definition of profiles, with the numbers fitted to its outlet.
        """
        return {"ratios": _ratios(results), "outlets": _outlets(results)}

    def sections(self, results: StudyResults, folder: Path) -> Sequence[Section]:
        outlets = pages.outlet_pictures(results, folder)
        first = [Section("Outlets of all series", tuple(outlets))] if outlets else []
        return [*first, *pages.ratio_sections(results, folder), *pages.start_sections(results)]

    def of_series(
        self, results: StudyResults, series: Series, folder: Path, suffix: str, where: str
    ) -> Sequence[Block]:
        return [
            pages.profile_section(results, series, name, folder, suffix, where)
            for name in series.further
            if name in DEFINITIONS
        ]

    def tables(self, results: StudyResults, series: Series, where: str) -> Sequence[tuple[str, Table]]:
        return [
            table
            for name in series.further
            if name in DEFINITIONS
            for table in pages.tables_of(results, series, name, where)
        ]

    def figures_of(self, results: StudyResults, series: Series) -> Mapping[str, Draw]:
        beside, draws = (results.comparisons, results.source), dict[str, Draw]()
        for name in (name for name in series.further if name in DEFINITIONS):
            draws[name] = Drawing(partial(figures.outlet_profiles, series, name, *beside), lambda: pages.ALONG)
            middles = partial(figures.outlet_middles, series, name, *beside)
            draws[f"{name}_middles"] = Drawing(middles, lambda: pages.MIDDLES)
        return draws


def _of_ratio(quantity: str, ratio: Ratio) -> Comparison:
    """Compare a ratio with the reference; the plain hopper over itself is 1 without error, and has no comparison."""
    points = tuple(dict.fromkeys((ratio.result, ratio.plain)))
    base = replace(sought(quantity, ratio.result.at), label=ratio.result.label, points=points)
    return replace(base, ours=ratio.value, error=ratio.error, low=ratio.low, high=ratio.high)


def _of_approach(base: Comparison, definition: str, shape: str, term: str, points: Sequence[PointResult]) -> Comparison:
    """Limit, depth or rate with which a parameter of profiles approaches its value in the middle."""
    base = replace(base, label=base.label or "all points")
    shape_approach = approaches(by_position(points), definition)[shape]
    base, law = replace(base, points=shape_approach.of), shape_approach.approach
    if law is None:
        why = f"an approach needs profiles at {FEWEST} distances from the wall, the middle among them"
        return replace(base, why=why)
    ours = law.parameters[term]
    return replace(base, ours=ours.value, error=ours.error, low=ours.low, high=ours.high, unit=ours.unit)


def _ratios(results: StudyResults) -> Iterator[Row]:
    for name, ratios_of in RATIOS.items():
        for ratio in ratios_of(results.points):
            numbers = {"value": ratio.value, "error": ratio.error, "low": ratio.low, "high": ratio.high}
            row = {**of_point(ratio.result), "quantity": name, **numbers}
            if name.endswith("angle"):
                yield row | {_column(author): factor for author, factor in angle_factors(ratio).items()}
            else:
                yield row | {"s_star": ratio.at}


def _column(author: str) -> str:
    """Column of a law: `rose_tanaka` from its author."""
    return author.lower().replace(" & ", "_")


def _outlets(results: StudyResults) -> Iterator[Row]:
    for series in results.series:
        for definition in (name for name in DEFINITIONS if name in series.further):
            fit = profile_fit(series, definition)
            for result, outlet in zip(fit.points, fit.outlets, strict=True):
                numbers = {name: getattr(outlet, name) for name in OF_OUTLET}
                means = {name: pooled.value for name, pooled in numbers.items()}
                errors = {f"{name}_error": pooled.error for name, pooled in numbers.items()}
                yield {**of_point(result), "definition": definition, "R": outlet.profile.R, **means, **errors}
