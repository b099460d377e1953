"""A power law of the orifice."""

import math

import numpy as np

from labbook.fit.law import Context, Law, Reported, exponential


class Power(Law):
    """W = W_d (D/d)^n: the limit of Beverloo's and Janda's laws for wide outlets, where n is 3/2 or 5/2.

    `n`, and `W_d` [kg/s], the value at D = d. Narrower outlets let through less, so that n is larger there.
    """

    name = "power"
    version = 2
    formula = "W = W_d (D/d)^n"
    source = "Pongo et al. 2022"
    free = ("ln W_d / m sqrt(g/d)", "n")
    least_ratio = 15.0

    def log_flow(self, D: np.ndarray, free: np.ndarray, context: Context) -> np.ndarray:
        return math.log(context.unit_flow) + free[0] + free[1] * np.log(D / context.d)

    def start(self, D: np.ndarray, W: np.ndarray, context: Context) -> np.ndarray:
        n, shift = np.polyfit(np.log(D / context.d), np.log(W / context.unit_flow), 1)
        return np.array([shift, n])

    def reported(self, context: Context) -> tuple[Reported, ...]:
        unit = context.unit_flow
        return (
            Reported("n", "", 1, float, "n"),
            Reported("W_d", "kg/s", 0, lambda x: exponential(x) * unit, "W at D = d", "g/s", 1e3),
        )
