"""An exponential of the orifice."""

import math

import numpy as np

from labbook.fit.law import Context, Law, Reported, exponential


class Exponential(Law):
    """W = W_0 e^{kappa D}, observed for rods in narrow outlets (Pongo et al. 2022).

    `kappa` [1/m] and `W_0` [kg/s]. kappa alone does not distinguish laws: Beverloo's law has d ln W/dD = n/(D - k d),
    which is 0.08/mm at D = 45 mm for grains of 9.9 mm.
    """

    name = "exponential"
    version = 2
    formula = "W = W_0 exp(kappa D)"
    source = "Pongo et al. 2022; kappa = 0.084/mm, experiment 0.13/mm"
    free = ("ln W_0 / m sqrt(g/d)", "kappa d")
    least_ratio = 0.0

    def log_flow(self, D: np.ndarray, free: np.ndarray, context: Context) -> np.ndarray:
        return math.log(context.unit_flow) + free[0] + free[1] * D / context.d

    def start(self, D: np.ndarray, W: np.ndarray, context: Context) -> np.ndarray:
        kappa, shift = np.polyfit(D / context.d, np.log(W / context.unit_flow), 1)
        return np.array([shift, kappa])

    def reported(self, context: Context) -> tuple[Reported, ...]:
        unit = context.unit_flow
        return (
            Reported("kappa", "1/m", 1, lambda x: x / context.d, "κ", "1/mm", 1e-3),
            Reported("W_0", "kg/s", 0, lambda x: exponential(x) * unit, "W at D = 0", "g/s", 1e3),
        )
