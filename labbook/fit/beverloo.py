"""Beverloo's law, for a slot and for a circular hole."""

import math
from collections.abc import Callable
from typing import ClassVar

import numpy as np

from labbook.fit.law import Context, Law, Reported, exponential, extended_log

_NO_BETTER = 1e-6
"""Fall of chi2 below that of a constant flow rate that counts as rounding."""


class Beverloo(Law):
    """W = C rho_b sqrt(g) (D - k d)^n, times Z for a slot.

    W^{1/n} is a straight line in D: `slope` is its slope, k d its zero. C is reported for both normalisations in use.
    `C` uses the bulk density rho_b = phi_B rho_p of the measured packing (left out without one), `C_particle` the
    density rho_p of the grains. The interval of C does not include the error of phi_B.
    """

    power: ClassVar[float]
    """Exponent n of D in the limit of wide outlets."""
    version = 2
    free = ("ln C_particle", "k")
    least_ratio = 6.0

    def log_flow(self, D: np.ndarray, free: np.ndarray, context: Context) -> np.ndarray:
        return math.log(self._unit(context)) + free[0] + self.power * extended_log(D / context.d - free[1])

    def start(self, D: np.ndarray, W: np.ndarray, context: Context) -> np.ndarray:
        unit = self._unit(context)
        slope, shift = np.polyfit(D / context.d, (W / unit) ** (1 / self.power), 1)
        smallest = float(D.min()) / context.d
        if slope <= 0:
            return np.array([math.log(float(np.mean(W)) / unit), 0.0])
        return np.array([self.power * math.log(slope), min(-shift / slope, 0.9 * smallest)])

    def without_minimum(
        self, D: np.ndarray, W: np.ndarray, relative: np.ndarray, context: Context, allowed: Callable[[float], float]
    ) -> str:
        """Reason why chi2 has no minimum at a finite k, with the upper limit of k; empty if it has one.

        For k to minus infinity and C to 0 the law becomes a constant. If no finite k fits better than that constant, k
        has an upper limit only.
        """
        from scipy.optimize import brentq

        x, weights, log_W = D / context.d, relative**-2.0, np.log(W)
        middle = float(np.average(x, weights=weights))

        def chi2(gap: float) -> float:
            """Least sum of squares with k at `gap` [d] below the smallest orifice, over all C."""
            with np.errstate(divide="ignore"):
                residual = log_W - self.power * np.log1p((x - middle) / (middle - x.min() + gap))
            return float(np.sum(weights * (residual - np.average(residual, weights=weights)) ** 2))

        constant = chi2(math.inf)
        # from a millionth to a billion of the range: the profile of chi2 is flat beyond both ends
        gaps = float(np.ptp(x)) * np.logspace(-6, 9, 151)
        chi2_of_gaps = [chi2(gap) for gap in gaps]
        if min(chi2_of_gaps) < constant * (1 - 1e-9) - _NO_BETTER:
            return ""
        rise = allowed(constant)
        inside = [gap for gap, value in zip(gaps, chi2_of_gaps, strict=True) if value - constant > rise]
        limit = ""
        if inside:
            low = math.log(max(inside))
            gap = math.exp(float(brentq(lambda at: chi2(math.exp(at)) - constant - rise, low, low + 1)))  # type: ignore[arg-type]
            limit = f" (its upper limit is {x.min() - gap:.4g})"
        return f"W does not rise with D: k cannot be determined{limit}"

    def reported(self, context: Context) -> tuple[Reported, ...]:
        by_particle = self._unit(context) / context.d**self.power
        n = {1.5: "2/3", 2.5: "2/5"}[self.power]
        parameters = (
            Reported("C_particle", "", 0, exponential, "C (grain density)"),
            Reported("k", "", 1, float, "k"),
            Reported(
                "slope",
                f"kg^({n}) s^(-{n}) m^(-1)",
                0,
                lambda x: (exponential(x) * by_particle) ** (1 / self.power),
                f"slope of W^({n})",
                f"(g/s)^({n})/mm",
                1e3 ** (1 / self.power - 1),
            ),
        )
        if context.rho_b is None:
            return parameters
        ratio = context.rho_p / context.rho_b
        return (Reported("C", "", 0, lambda x: exponential(x) * ratio, "C (bulk density)"), *parameters)

    def _unit(self, context: Context) -> float:
        """Unit of the flow rate: rho_p sqrt(g) d^n [kg/s], times Z for a slot."""
        across = context.Z if self.outlet == "slot" else 1.0
        return context.rho_p * math.sqrt(context.g) * context.d**self.power * across


class Beverloo2D(Beverloo):
    """Beverloo's law for a slot: n = 3/2."""

    name = "beverloo"
    formula = "W = C rho_b sqrt(g) (D - k d)^(3/2) Z"
    source = "Beverloo et al., Chem. Eng. Sci. 15 (1961) 260; for a slot: Fan et al. 2023, eq 1"
    outlet = "slot"
    power = 1.5


class Beverloo3D(Beverloo):
    """Beverloo's law for a circular hole: n = 5/2."""

    name = "beverloo_3d"
    formula = "W = C rho_b sqrt(g) (D - k d)^(5/2)"
    source = "Beverloo et al., Chem. Eng. Sci. 15 (1961) 260"
    outlet = "hole"
    power = 2.5
