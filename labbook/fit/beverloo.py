"""Beverloo's law for a slot."""

import math

import numpy as np

from labbook.fit.law import Context, Law, Reported, exponential, extended_log


class Beverloo2D(Law):
    """W = C rho_b sqrt(g) (D - k d)^{3/2} Z.

    W^{2/3} is a straight line in D: `slope` is its slope, k d its zero. C is reported for both normalisations
    in use: `C` with the bulk density rho_b = phi_B rho_p of the measured packing (left out without one),
    `C_particle` with the density rho_p of the grains. The error of phi_B is not part of the interval of C.
    """

    name = "beverloo"
    version = 1
    formula = "W = C rho_b sqrt(g) (D - k d)^(3/2) Z"
    source = "Beverloo et al., Chem. Eng. Sci. 15 (1961) 260; for a slot: Fan et al. 2023, eq 1"
    free = ("ln C_particle", "k")
    least_ratio = 6.0

    def log_flow(self, D: np.ndarray, free: np.ndarray, context: Context) -> np.ndarray:
        return math.log(_unit_flow(context)) + free[0] + 1.5 * extended_log(D / context.d - free[1])

    def start(self, D: np.ndarray, W: np.ndarray, context: Context) -> np.ndarray:
        slope, shift = np.polyfit(D / context.d, (W / _unit_flow(context)) ** (2 / 3), 1)
        smallest = float(D.min()) / context.d
        if slope <= 0:
            return np.array([math.log(float(np.mean(W)) / _unit_flow(context)), 0.0])
        return np.array([1.5 * math.log(slope), min(-shift / slope, 0.9 * smallest)])

    def reported(self, context: Context) -> tuple[Reported, ...]:
        by_particle = context.rho_p * math.sqrt(context.g) * context.Z
        parameters = (
            Reported("C_particle", "", 0, exponential),
            Reported("k", "", 1, float),
            Reported("slope", "kg^(2/3) s^(-2/3) m^(-1)", 0, lambda x: (exponential(x) * by_particle) ** (2 / 3)),
        )
        if context.rho_b is None:
            return parameters
        ratio = context.rho_p / context.rho_b
        return (Reported("C", "", 0, lambda x: exponential(x) * ratio), *parameters)


def _unit_flow(context: Context) -> float:
    """rho_p sqrt(g) d^{3/2} Z [kg/s]."""
    return context.rho_p * math.sqrt(context.g) * context.d**1.5 * context.Z
