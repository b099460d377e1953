"""Result of a fit: parameters with intervals, goodness, and prediction bands."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from labbook import html
from labbook.chart import Chart
from labbook.fit.band import half_width, law_error
from labbook.fit.law import Context, Law
from labbook.fit.profile import Minimum, derivative
from labbook.scene.quantities import parse, percent
from labbook.warning import warn

if TYPE_CHECKING:
    import pandas as pd


NOT_DETERMINED = "not determined"
"""Text in place of a parameter that the data do not determine."""
_WIDE = 10.0
"""Width of an interval, in units of its value, from which on a parameter is not determined."""
_FAR = 2.0
"""Factor beyond the fitted orifices from which a prediction is extrapolated far."""


class FitError(ValueError):
    """The data cannot be fitted; the message gives the reason and a remedy."""


@dataclass(frozen=True)
class Parameter:
    """A fitted parameter.

    Attributes:
        value: Fitted value [`unit`].
        low: Lower end of its interval; -inf without one.
        high: Upper end of its interval; inf without one.
        error: Standard error, linearised at the minimum.
        unit: SI unit.
    """

    value: float
    low: float
    high: float
    error: float
    unit: str

    def determined(self, about_zero: bool = False) -> bool:
        """Decide if the data determine the parameter.

        Args:
            about_zero: A value compatible with zero is a result too, whatever the width of its interval.

        Returns:
            True if the interval has both ends and is at most ten times as wide as the value.
        """
        width = self.high - self.low
        return math.isfinite(width) and (about_zero or width <= _WIDE * abs(self.value))


@dataclass(frozen=True, eq=False)
class FitResult:
    """A law fitted to n points.

    Attributes:
        law: The law.
        context: Properties of grains, slot and gravity.
        parameters: Reported parameters by name.
        D: Orifices [m], shape [n].
        W: Flow rates [kg/s], shape [n].
        relative_error: Relative standard errors of W, as used for the weights, shape [n].
        residuals: ln W - ln W_law, about the relative deviation, shape [n].
        outside: Points outside the range of the law; they are fitted all the same, shape [n].
        chi2: Sum of squares of the residuals over their errors.
        dof: Degrees of freedom, n - p.
        p_value: Probability of a larger chi2 if the law holds; NaN without replicates. By the F distribution, since the
            errors are estimates with `error_dof` degrees of freedom.
        error_dof: Degrees of freedom of the errors; infinite if they are known exactly.
        aicc: Akaike's criterion for few points.
        confidence: Confidence of the intervals.
        notes: Warnings for the reader.
    """

    law: Law
    context: Context
    parameters: Mapping[str, Parameter]
    D: np.ndarray
    W: np.ndarray
    relative_error: np.ndarray
    residuals: np.ndarray
    outside: np.ndarray
    chi2: float
    dof: int
    p_value: float
    error_dof: float
    aicc: float
    confidence: float
    notes: tuple[str, ...]
    _minimum: Minimum = field(repr=False)

    @property
    def best(self) -> np.ndarray:
        """Free parameters of the law at the minimum, shape [p]."""
        return self._minimum.best

    @property
    def chi2_reduced(self) -> float:
        """chi2 per degree of freedom."""
        return self.chi2 / self.dof

    @property
    def widening(self) -> float:
        """Factor on all standard errors, so that a law that misses the data does not claim their precision."""
        return widened(self.chi2, self.dof, self.error_dof)[0]

    @property
    def freedom(self) -> float:
        """Degrees of freedom of all intervals and joint regions."""
        return widened(self.chi2, self.dof, self.error_dof)[1]

    def frame(self) -> "pd.DataFrame":
        """Tabulate the parameters: value, error, interval, unit, symbol, and if the data determine them."""
        import pandas as pd

        rows = [
            {"parameter": name, **vars(parameter), "determined": parameter.determined()}
            for name, parameter in self.parameters.items()
        ]
        return pd.DataFrame([{**row, "symbol": self.symbols[row["parameter"]]} for row in rows])

    @property
    def symbols(self) -> dict[str, str]:
        """Symbols of the parameters on pages, by name: `C (bulk density)` is the symbol of `C`."""
        return {entry.name: entry.symbol or entry.name for entry in self.law.reported(self.context)}

    def _repr_html_(self) -> str:
        rows = []
        for entry in self.law.reported(self.context):
            parameter = self.parameters[entry.name]
            value, error, low, high = (
                entry.scale * x for x in (parameter.value, parameter.error, parameter.low, parameter.high)
            )
            text = f"{value:.4g} ± {error:.2g}" if parameter.determined() else NOT_DETERMINED
            rows.append(
                (entry.symbol or entry.name, entry.name, text, f"{low:.4g} to {high:.4g}", entry.shown or entry.unit)
            )
        goodness = f"χ² = {self.chi2:.3g} with {self.dof} degrees of freedom, p = {self.p_value:.2g}"
        notes = (goodness, *(f"note: {note}" for note in self.notes))
        heads = ("parameter", "name", "value ± error", f"{percent(self.confidence)} interval", "unit")
        table = f"<div>{html.table(heads, rows, notes)}</div>"
        content = f'<div style="display:flex;flex-wrap:wrap;gap:1.5em">{table}<div>{self._chart()}</div></div>'
        return html.titled(f"{self.law.name}: {self.law.formula}", content)

    def _chart(self) -> str:
        """Points with standard errors and the law with its band, over the fitted orifices."""
        low, high = float(self.D.min()), float(self.D.max())
        margin = 0.05 * (high - low)
        D = np.linspace(low, high, 100)
        W, *ends = (1e3 * one for one in self.band(D))
        above = self.W * (1 + np.where(np.isfinite(self.relative_error), self.relative_error, 0.0))
        chart = Chart("D [mm]", "W [g/s]", (1e3 * (low - margin), 1e3 * (high + margin)), 1.05e3 * float(above.max()))
        D_mm = (1e3 * D).tolist()
        chart.band(D_mm, *(end.tolist() for end in ends))
        chart.curve(D_mm, W.tolist())
        for at, rate, error, outside in zip(self.D, self.W, self.relative_error, self.outside, strict=True):
            reach = float(error) if math.isfinite(error) else 0.0
            chart.point(1e3 * at, 1e3 * rate, 1e3 * rate * (1 - reach), 1e3 * rate * (1 + reach), bool(outside))
        caption = f"bars: standard errors; band: {percent(self.confidence)} interval of the law"
        hollow = ["hollow: outside the range of the law"] if self.outside.any() else []
        return chart.svg() + html.lines([caption, *hollow])

    def __repr__(self) -> str:
        lines = [f"<{self.law.name}: {self.law.formula}>"]
        for name, parameter in self.parameters.items():
            within = f"{percent(self.confidence)}: {parameter.low:.4g} to {parameter.high:.4g}"
            symbol = self.symbols[name]
            label = name if symbol == name else f"{name}, shown as {symbol},"
            value = (
                f"= {parameter.value:.4g} ± {parameter.error:.2g} {parameter.unit}".rstrip()
                if parameter.determined()
                else NOT_DETERMINED
            )
            lines.append(f"  {label} {value}  ({within})")
        lines.append(f"  χ² = {self.chi2:.3g} with {self.dof} degrees of freedom, p = {self.p_value:.2g}")
        return "\n".join(lines + [f"  note: {note}" for note in self.notes])

    def predict(
        self, D: float | str | Sequence[float | str] | np.ndarray, *, new_point: bool = False
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Predict W of the law at one or m orifices, with its pointwise interval, linearised in ln W.

        A LabWarning reports orifices below half the smallest or above twice the largest fitted one.

        Args:
            D: Orifices: text with a unit (`"20 mm"`, `["20 mm", "8 d"]`), or numbers [m].
            new_point: Give the interval of a new mean over as many seeds as the points have, not that of the law.

        Returns:
            W, and lower and upper end of its interval [kg/s], each of shape [m]; NaN where the law has no flow.

        Raises:
            ValueError: A text is no length.
        """
        at = self._orifices(D)
        low, high = float(self.D.min()), float(self.D.max())
        if (far := at[(at < low / _FAR) | (at > _FAR * high)]).size:
            warn(
                f"{self.law.name}: the orifice {far[0] * 1e3:g} mm is far outside the fitted range, {low * 1e3:g} to "
                f"{high * 1e3:g} mm: the interval does not cover the error of extrapolating (numbers are in m)"
            )
        return self.band(at, new_point=new_point)

    def _orifices(self, D: float | str | Sequence[float | str] | np.ndarray) -> np.ndarray:
        orifices = [D] if isinstance(D, str) else np.atleast_1d(np.asarray(D, dtype=object)).ravel()
        try:
            return np.array(
                [
                    parse(orifice, "m", self.context.d) if isinstance(orifice, str) else float(orifice)
                    for orifice in orifices
                ]
            )
        except ValueError as problem:
            raise ValueError(f"orifice: {problem}; give text such as '20 mm', or numbers in m") from None

    def band(self, at: np.ndarray, *, new_point: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Compute the band of `predict` without its warning on extrapolation.

        Args:
            at: Orifices [m], shape [m].
            new_point: Band of one further point with as many replicates, instead of that of the law.

        Returns:
            W of the law and the ends of its interval [kg/s], each of shape [m].
        """
        best = self._minimum.best
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            slopes = derivative(lambda free: self.law.log_flow(at, free, self.context), best)
            error = law_error(slopes, self._minimum.covariance) * self.widening
            reach = half_width(error, self.confidence, self.freedom, self._scatter if new_point else 0.0)
            value = self.law.flow(at, best, self.context)
            return value, value * np.exp(-reach), value * np.exp(reach)

    def together(self, values: Mapping[str, float]) -> float:
        """Compute the p-value of a set of values for all parameters at once.

        Parameters are correlated: values that are each within their interval may be excluded together. The test is the
        F test of the rise of chi2 over its minimum (Seber & Wild, Nonlinear Regression, 5.3), with the errors of the
        intervals.

        Args:
            values: Values [SI] by names of `parameters`; together they have to fix all free parameters.

        Returns:
            Probability of points as far from the law with these values, if it were true.

        Raises:
            KeyError: The law does not report a name.
            ValueError: A parameter is left free, or cannot have the value.
        """
        from scipy.special import chdtrc, fdtrc

        reported = {entry.name: entry for entry in self.law.reported(self.context)}
        free = np.full(len(self.law.free), np.nan)
        for name, value in values.items():
            free[reported[name].free] = reported[name].invert(value, self._minimum.best[reported[name].free])
        if np.isnan(free).any():
            unset = ", ".join(entry.name for entry in reported.values() if np.isnan(free[entry.free]))
            raise ValueError(f"{self.law.name}: {unset} left free; give a value of each parameter")
        misfit = np.log(self.W) - self.law.log_flow(self.D, free, self.context)
        own = self.relative_error if self.error_dof else self.relative_error / self.widening
        rise = (float(np.sum((misfit / own) ** 2)) - self.chi2) / self.widening**2
        if np.isinf(self.freedom):
            return float(chdtrc(len(free), rise))
        return float(fdtrc(len(free), self.freedom, max(rise, 0.0) / len(free)))

    @property
    def _scatter(self) -> float:
        """Standard error of ln W of a point about the law."""
        own = float(np.sqrt(np.mean(self.relative_error**2)))
        return own * self.widening if self.error_dof else own  # without replicates it is that of the scatter already


def widened(chi2: float, dof: int, error_dof: float) -> tuple[float, float]:
    """Compute the factor on the standard errors of a fit, and the degrees of freedom of Student's t and F for them.

    Where the law holds, the errors are those of the replicates, with their degrees of freedom. Where it misses the
    points by more, or without replicates, the errors are taken from the scatter about the law: that is an estimate
    from `dof` degrees of freedom, however many replicates there are.

    Args:
        chi2: Sum of squares about the law, in units of the errors.
        dof: Points less parameters.
        error_dof: Degrees of freedom of the errors; 0 without replicates, infinite if they are known exactly.

    Returns:
        The factor, 1 or sqrt(chi2/dof), and the degrees of freedom.
    """
    factor = math.sqrt(chi2 / dof)
    if error_dof and factor <= 1:
        return 1.0, error_dof
    return factor, dof
