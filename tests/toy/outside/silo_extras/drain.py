"""A paper of another package: how the time until half of the grains had left falls with the orifice."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from labbook.fit import FitError, Parameter
from labbook.measure import Quantity
from labbook.papers import Draw, Paper
from labbook.report.blocks import Block, Prose, Section, picture
from labbook.report.tables import Table
from labbook.results.paper import Row
from labbook.results.points import PointResult
from labbook.results.reference import Comparison, sought
from labbook.results.series import FurtherFit, Series
from labbook.results.statements import Judged
from labbook.results.study import StudyResults
from labbook.study import Statement
from labbook.study.paper import QuantityContext, Wrong


class DrainFit(FurtherFit):
    """t = T (D / 1 m)^-p."""

    formula = "t½ = T D^-p"
    source = "nobody"
    version = 1


class Drain(Paper):
    """Fits `drain`; `drained.first` is the half time of the narrowest orifice, `drained.order` whether they fall."""

    name = "drain"
    fits: ClassVar = {"drain": "half_time"}
    heads = ("drained",)
    declared = (
        Quantity("drain.p", "p", meaning="exponent of the half time"),
        Quantity("drained.first", "t½ of the first", "s", "half time of the narrowest orifice", "ms", 1e3),
    )
    columns: ClassVar = {"drained": {"half_time": "s"}}

    def fit(self, name: str, points: Sequence[PointResult]) -> FurtherFit:
        if len(points) < 3:
            raise FitError("drain needs three orifices")
        D, t = (np.log([f(one) for one in points]) for f in (lambda r: r.orifice, _half_time))
        (slope, _), covariance = np.polyfit(D, t, 1, cov=True)
        error = float(np.sqrt(covariance[0, 0]))
        p = Parameter(-slope, -slope - 2 * error, -slope + 2 * error, error, "")
        return DrainFit({"p": p}, ("a straight line through logarithms",), tuple(points))

    def unit(self, quantity: str, context: QuantityContext) -> str | Wrong | None:
        if quantity == "drained.order":
            return "" if context.is_statement else Wrong("an order is no number", "write `from`, `to` and `says`")
        return super().unit(quantity, context)

    def compared(
        self, results: StudyResults, quantity: str, at: Mapping[str, float | str]
    ) -> Sequence[Comparison] | None:
        if quantity != "drained.first":
            return None
        return [replace(sought(quantity, at), ours=_half_time(results.points[0]), error=1e-3, unit="s")]

    def judged(self, results: StudyResults, statement: Statement) -> Sequence[Judged] | None:
        if statement.quantity != "drained.order":
            return None
        times = [_half_time(one) for one in results.points]
        ours = float(np.mean(np.diff(times) < 0))
        return [Judged(statement, "all orifices", ours, 0.0, ours, ours, how="Ends are those of the only number.")]

    def frames(self, results: StudyResults) -> Mapping[str, Iterable[Row]]:
        return {"drained": [{"orifice": one.orifice, "half_time": _half_time(one)} for one in results.points]}

    def sections(self, results: StudyResults, folder: Path) -> Sequence[Section]:
        drawn = picture(self._draw(results), folder / "drain", "half time against orifice", "Half times.")
        return [Section("How silos drain", (drawn,))]

    def of_series(
        self, results: StudyResults, series: Series, folder: Path, suffix: str, where: str
    ) -> Sequence[Block]:
        return [Prose("These drain.")]

    def tables(self, results: StudyResults, series: Series, where: str) -> Sequence[tuple[str, Table]]:
        rows = tuple((name, f"{one.value:.2f}") for name, one in series.parameters("drain").items())
        return [(f"Drain{where}", Table(("parameter", "value"), rows))]

    def figures(self, results: StudyResults) -> Mapping[str, Draw]:
        return {"drain": lambda: self._draw(results)}

    def _draw(self, results: StudyResults):
        from matplotlib.figure import Figure

        figure = Figure()
        times = [_half_time(one) for one in results.points]
        figure.subplots().plot([one.orifice for one in results.points], times, "o")
        return figure


def _half_time(result: PointResult) -> float:
    return result.pooled["half_time"].value
