"""Beverloo's law, for a slot and for a circular hole."""

import math

import numpy as np

from labbook.fit.law import Context, Law, Reported, exponential, extended_log


class Beverloo(Law):
    """W = C rho_b sqrt(g) (D - k d)^n, times Z for a slot.

    W^{1/n} is a straight line in D: `slope` is its slope, k d its zero. C is reported for both normalisations
    in use: `C` with the bulk density rho_b = phi_B rho_p of the measured packing (left out without one),
    `C_particle` with the density rho_p of the grains. The error of phi_B is not part of the interval of C.
    """

    version = 1
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
        """rho_p sqrt(g) d^n [kg/s], times Z for a slot."""
        across = context.Z if self.outlet == "slot" else 1.0
        return context.rho_p * math.sqrt(context.g) * context.d**self.power * across


class Beverloo2D(Beverloo):
    """For a slot: n = 3/2."""

    name = "beverloo"
    formula = "W = C rho_b sqrt(g) (D - k d)^(3/2) Z"
    source = "Beverloo et al., Chem. Eng. Sci. 15 (1961) 260; for a slot: Fan et al. 2023, eq 1"
    outlet = "slot"
    power = 1.5


class Beverloo3D(Beverloo):
    """For a circular hole: n = 5/2."""

    name = "beverloo_3d"
    formula = "W = C rho_b sqrt(g) (D - k d)^(5/2)"
    source = "Beverloo et al., Chem. Eng. Sci. 15 (1961) 260"
    outlet = "hole"
    power = 2.5
