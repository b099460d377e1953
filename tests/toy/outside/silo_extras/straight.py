"""A law of another package."""

import numpy as np

from labbook.fit.law import Context, Law, Reported, exponential, extended_log


class Straight(Law):
    """W = S (D - c): a straight line."""

    name = "straight"
    version = 1
    formula = "W = S (D - c)"
    source = "nobody"
    free = ("ln S d / m sqrt(g/d)", "c/d")
    least_ratio = 0.0

    def log_flow(self, D: np.ndarray, free: np.ndarray, context: Context) -> np.ndarray:
        return np.log(context.unit_flow) + free[0] + extended_log(D / context.d - free[1])

    def start(self, D: np.ndarray, W: np.ndarray, context: Context) -> np.ndarray:
        slope, shift = np.polyfit(D / context.d, W / context.unit_flow, 1)
        return np.array([np.log(slope), -shift / slope])

    def reported(self, context: Context) -> tuple[Reported, ...]:
        unit = context.unit_flow / context.d
        return (
            Reported("S", "kg/(s m)", 0, lambda x: exponential(x) * unit, "S", "g/(s mm)"),
            Reported("c", "m", 1, lambda x: x * context.d, "c", "mm", 1e3),
        )
