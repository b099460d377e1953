"""What a fit gives: parameters with intervals, goodness, and prediction bands."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from labbook import html
from labbook.fit.band import half_width, law_error
from labbook.fit.law import Context, Law
from labbook.fit.profile import Minimum, derivative
from labbook.scene.quantities import parse, percent
from labbook.warning import warn

if TYPE_CHECKING:
    import pandas as pd


NOT_DETERMINED = "not determined"
"""In place of a parameter that the data do not determine."""
_WIDE = 10.0
"""Width of an interval, in values, from which on a parameter is not determined."""
_FAR = 2.0
"""Factor beyond the fitted orifices from which a prediction is extrapolated far."""


class FitError(ValueError):
    """The data cannot be fitted; the message says why and what would help."""


@dataclass(frozen=True)
class Parameter:
    """A fitted parameter: value, ends of its interval, standard error (linearised), unit."""

    value: float
    low: float
    high: float
    error: float
    unit: str

    def determined(self, about_zero: bool = False) -> bool:
        """Decide whether the data determine the parameter: its interval has both ends and is at most ten values wide.

        `about_zero`: a value that cannot be told from zero is a finding too, whatever its width.
        """
        width = self.high - self.low
        return math.isfinite(width) and (about_zero or width <= _WIDE * abs(self.value))


@dataclass(frozen=True, eq=False)
class FitResult:
    """A law fitted to n points.

    `D` [m], `W` [kg/s], `relative_error` (of W, as used for the weights), `residuals` (ln W - ln W_law, about
    the relative deviation), `outside` (points outside the law's range: used all the same, and flagged): shape
    [n]. `chi2` with `dof` = n - p; `p_value`: probability of a larger chi2 if the law holds (F distribution,
    since the errors are estimates with `error_dof` degrees of freedom; NaN without replicates).
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
        """The parameters: a row each, with value, error, ends of the interval, unit, and if the data determine it."""
        import pandas as pd

        rows = [
            {"parameter": name, **vars(found), "determined": found.determined()}
            for name, found in self.parameters.items()
        ]
        return pd.DataFrame([{**row, "symbol": self.symbols[row["parameter"]]} for row in rows])

    @property
    def symbols(self) -> dict[str, str]:
        """What pages call the parameters, by name: `C (bulk density)` is the symbol of `C`."""
        return {one.name: one.symbol or one.name for one in self.law.reported(self.context)}

    def _repr_html_(self) -> str:
        rows = []
        for one in self.law.reported(self.context):
            found = self.parameters[one.name]
            value, error, low, high = (one.scale * x for x in (found.value, found.error, found.low, found.high))
            shown = f"{value:.4g} ± {error:.2g}" if found.determined() else NOT_DETERMINED
            rows.append((one.symbol or one.name, one.name, shown, f"{low:.4g} to {high:.4g}", one.shown or one.unit))
        goodness = f"χ² = {self.chi2:.3g} with {self.dof} degrees of freedom, p = {self.p_value:.2g}"
        notes = (goodness, *(f"note: {note}" for note in self.notes))
        heads = ("parameter", "name", "value ± error", f"{percent(self.confidence)} interval", "unit")
        return html.titled(f"{self.law.name}: {self.law.formula}", html.table(heads, rows, notes))

    def __repr__(self) -> str:
        lines = [f"<{self.law.name}: {self.law.formula}>"]
        for name, one in self.parameters.items():
            within = f"{percent(self.confidence)}: {one.low:.4g} to {one.high:.4g}"
            symbol = self.symbols[name]
            called = name if symbol == name else f"{name}, shown as {symbol},"
            value = f"= {one.value:.4g} ± {one.error:.2g} {one.unit}".rstrip() if one.determined() else NOT_DETERMINED
            lines.append(f"  {called} {value}  ({within})")
        lines.append(f"  χ² = {self.chi2:.3g} with {self.dof} degrees of freedom, p = {self.p_value:.2g}")
        return "\n".join(lines + [f"  note: {note}" for note in self.notes])

    def predict(
        self, D: float | str | Sequence[float | str] | np.ndarray, *, new_point: bool = False
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """W of the law at one or m orifices, and the ends of its pointwise interval [kg/s], each of shape [m]; NaN
        where the law has no flow.

        D: text with a unit (`"20 mm"`, `["20 mm", "8 d"]`), or numbers in m. The band of the law or, with `new_point`,
        of the mean that as many seeds as the points have would give there; linearised in ln W. A LabWarning tells of
        orifices below half the smallest or above twice the largest that was fitted. Raises ValueError for text that is
        no length.
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
        given = [D] if isinstance(D, str) else np.atleast_1d(np.asarray(D, dtype=object)).ravel()
        try:
            return np.array([parse(one, "m", self.context.d) if isinstance(one, str) else float(one) for one in given])
        except ValueError as problem:
            raise ValueError(f"orifice: {problem}; give text such as '20 mm', or numbers in m") from None

    def band(self, at: np.ndarray, *, new_point: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """As `predict`, at m orifices `at` [m], without a word on how far they are from those fitted."""
        best = self._minimum.best
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            slopes = derivative(lambda free: self.law.log_flow(at, free, self.context), best)
            error = law_error(slopes, self._minimum.covariance) * self.widening
            reach = half_width(error, self.confidence, self.freedom, self._scatter if new_point else 0.0)
            value = self.law.flow(at, best, self.context)
            return value, value * np.exp(-reach), value * np.exp(reach)

    def together(self, values: Mapping[str, float]) -> float:
        """How probable points as far from the law with these `values` [SI] of all its parameters at once would be, if
        it were true. Parameters trade for one another: values that agree one by one may not agree together.

        `values`: by names of `parameters`, so many that nothing is left free. F test of the rise of chi2 over its
        minimum (Seber & Wild, Nonlinear Regression, 5.3), whose errors are those of the intervals. Raises KeyError for
        a name that this law does not report, ValueError if a parameter is left free or cannot have the value.
        """
        from scipy.special import chdtrc, fdtrc

        reported = {one.name: one for one in self.law.reported(self.context)}
        free = np.full(len(self.law.free), np.nan)
        for name, value in values.items():
            free[reported[name].free] = reported[name].invert(value, self._minimum.best[reported[name].free])
        if np.isnan(free).any():
            left = ", ".join(one.name for one in reported.values() if np.isnan(free[one.free]))
            raise ValueError(f"{self.law.name}: {left} left free; give a value of each parameter")
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
