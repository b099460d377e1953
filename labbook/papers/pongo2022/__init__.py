"""The rotating bottom of Pongo et al., Phys. Rev. E 106 (2022) 034904: flow and fields against frequency."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import ClassVar

from labbook.fit import LAWS
from labbook.measure import Quantity
from labbook.papers import Draw, Drawing, Paper
from labbook.papers.pongo2022 import figures, pages
from labbook.papers.pongo2022.rotation import TRENDS, rotations_of
from labbook.papers.pongo2022.statements import FEATURES, TURNING, judged
from labbook.report.blocks import Section
from labbook.results.paper import Row
from labbook.results.points import PointResult
from labbook.results.statements import Judged
from labbook.results.study import StudyResults
from labbook.study import Statement
from labbook.study.paper import QuantityContext, Wrong, none_such
from labbook.study.problems import instead, quote


class Pongo2022(Paper):
    """Points that differ in `container.rotation` only, over the one at rest; statements on `rotation.QUANTITY`."""

    name = "pongo2022"
    heads = (TURNING,)
    declared = tuple(
        Quantity(f"{TURNING}.grain_rate.{name}", name.replace("_", " "), "1/m", "", "1/mm", 1e-3)
        for name, trend in TRENDS.items()
        if trend.by == "orifice"
    )
    columns: ClassVar = {"rotation": dict.fromkeys(("ratio", "error", "low", "high"), "")}

    def unit(self, quantity: str, context: QuantityContext) -> str | Wrong | None:
        """Unit of a feature: none for ratios, Hz for the frequency of a minimum."""
        head, _, tail = quantity.partition(".")
        name, _, feature = tail.partition(".")
        if head != TURNING:
            return None
        if not context.is_statement:
            return Wrong("what turning does is stated, not given as a number", "write `from` and `to` and `says`")
        if name in LAWS:
            names = [f"{TURNING}.{name}.{parameter}" for parameter in LAWS[name].parameters]
            return "" if quantity in names else none_such(quantity, names)
        if feature and feature not in FEATURES:
            return Wrong(f"a curve has no {quote(feature)}", instead(feature, FEATURES))
        if all(scene.container.spin_key is None for scene in context.scenes):
            return Wrong("this container has no rotation", "leave it out, or use a cylinder-silo")
        if name not in context.units:
            return none_such(quantity, [f"{TURNING}.{unit_of}" for unit_of in context.units])
        return _UNITS.get(feature, "")

    def judged(self, results: StudyResults, statement: Statement) -> Sequence[Judged] | None:
        if statement.quantity.partition(".")[0] != TURNING:
            return None
        return judged(statement, rotations_of(results), results.series)

    def frames(self, results: StudyResults) -> Mapping[str, Iterable[Row]]:
        """Frame `rotation`: a row a point and quantity, the ratio to the bottom at rest."""
        return {"rotation": _rows(results)}

    def sections(self, results: StudyResults, folder: Path) -> Sequence[Section]:
        return pages.turning_sections(results, folder)

    def figures(self, results: StudyResults) -> Mapping[str, Draw]:
        draws: dict[str, Draw] = {}
        if curves := [curve for curve in rotations_of(results) if curve.flows]:
            draws["rotation"] = Drawing(
                partial(figures.flow_against_rotation, curves), lambda: pages.flow_caption(curves)
            )  # fmt: skip
        if scaled := pages.scaled(results):
            draws["scaling"] = Drawing(partial(figures.flow_scaling, scaled), lambda: pages.SCALING, "points")
        return draws

    def shows_beds_of(self, results: StudyResults) -> Collection[PointResult]:
        return [point for curve in rotations_of(results) for point in curve.points]


_UNITS = {"minimum": "Hz"} | {name: "1/m" for name, trend in TRENDS.items() if trend.by == "orifice"}


def _rows(results: StudyResults) -> Iterator[Row]:
    """Yield every quantity over that with the bottom at rest, paired by seeds, with intervals of CONFIDENCE."""
    for curve in rotations_of(results):
        for k, result in enumerate(curve.points):
            for quantity in result.pooled if k else ():
                ratio = curve.ratio(quantity, k) if _has_ratio(curve.points[0], quantity) else None
                if ratio is not None:
                    ends = {"low": ratio.low, "high": ratio.high, "confidence": ratio.confidence}
                    numbers = {"ratio": ratio.value, "error": ratio.error, **ends, "pairs": ratio.n}
                    yield {"shape": curve.shape, **result.at, "quantity": quantity, **numbers}


def _has_ratio(at_rest, quantity: str) -> bool:
    """True if a ratio to the value at rest is meaningful: a drift or a waiting time may be 0."""
    pooled = at_rest.pooled.get(quantity)
    return pooled is not None and pooled.value != 0 and not quantity.startswith("flow_rate_drift")
