"""Janda's law, for a slot and for a circular hole."""

import math
from collections.abc import Collection
from typing import ClassVar

import numpy as np

from labbook.fit.law import Context, Law, Reported, exponential, extended_log

# Bounds of ln alpha_2/d beyond which the law no longer changes: a constant bracket, or one linear in D.
_NARROWEST, _WIDEST = math.log(0.05), math.log(1e3)
_NEAR = 0.01
"""Distance of ln alpha_2/d from a bound within which it counts as lying there."""


class Janda(Law):
    """Q = C' (1 - alpha_1 e^{-D/alpha_2}) D^n, with Q in grains per second; the mass flow rate is W = m Q.

    The bracket is the packing fraction in the orifice relative to that of a wide one. `C_prime` is in s^-1 m^-n,
    `alpha2` in m. Orifices all much wider than alpha_2 do not determine alpha_1 and alpha_2: their intervals then have
    no upper or lower end (infinity, zero).
    """

    power: ClassVar[float]
    """Exponent n of D in the limit of wide outlets."""
    version = 3
    source = "Janda, Zuriguel & Maza, Phys. Rev. Lett. 108 (2012) 248001"
    free = ("ln C' d^n sqrt(d/g)", "alpha_1", "ln alpha_2/d")
    least_ratio = 6.0

    def log_flow(self, D: np.ndarray, free: np.ndarray, context: Context) -> np.ndarray:
        ratio = D / context.d
        decay = math.exp(-min(max(free[2], _NARROWEST), _WIDEST))
        bracket = 1 - free[1] * np.exp(-ratio * decay)
        # Over d/alpha_2, its growth along one diameter: where alpha_2 is large the bracket is small at all orifices.
        log_bracket = extended_log(bracket / decay) + math.log(decay)
        return math.log(context.unit_flow) + free[0] + self.power * np.log(ratio) + log_bracket

    def endless(self, free: np.ndarray) -> Collection[int]:
        """All parameters at the upper bound of alpha_2, where their intervals have no end.

        There the bracket is linear in D, C' grows with alpha_2, and alpha_1 tends to 1. At the lower bound C' is that
        of wide orifices, which the data determine.
        """
        return (0, 1, 2) if free[2] >= _WIDEST - _NEAR else ()

    def start(self, D: np.ndarray, W: np.ndarray, context: Context) -> np.ndarray:
        # Given alpha_2 the law is linear in C' and C' alpha_1: the best of a coarse scan is near enough.
        ratio = D / context.d
        scaled = W / context.unit_flow / ratio**self.power
        best, least = np.array([math.log(float(scaled.max())), 0.5, math.log(6.0)]), math.inf
        for log_range in np.linspace(math.log(0.5), math.log(4 * ratio.max()), 16):
            columns = np.column_stack([np.ones_like(ratio), -np.exp(-ratio * math.exp(-log_range))])
            columns, target = columns / scaled[:, None], np.ones_like(ratio)
            (c, product), *_ = np.linalg.lstsq(columns, target, rcond=None)
            misfit = float(np.sum((target - columns @ (c, product)) ** 2))
            if c > 0 and misfit < least:
                best, least = np.array([math.log(c), product / c, log_range]), misfit
        return best

    def reported(self, context: Context) -> tuple[Reported, ...]:
        unit = math.sqrt(context.g / context.d) / context.d**self.power
        n, scale = f"{2 * self.power:g}", 1e3**-self.power
        return (
            Reported(
                "C_prime", f"s^(-1) m^(-{n}/2)", 0, lambda x: exponential(x) * unit, "C′", f"1/(s mm^({n}/2))", scale
            ),
            Reported("alpha1", "", 1, float, "α₁"),
            Reported("alpha2", "m", 2, lambda x: exponential(x) * context.d, "α₂", "mm", 1e3),
            Reported("alpha2_over_d", "", 2, exponential, "α₂/d"),
        )


class Janda2D(Janda):
    """Janda's law for a slot: n = 3/2."""

    name = "janda"
    formula = "Q = C' (1 - alpha_1 exp(-D/alpha_2)) D^(3/2)"
    outlet = "slot"
    power = 1.5


class Janda3D(Janda):
    """Janda's law for a circular hole: n = 5/2."""

    name = "janda_3d"
    formula = "Q = C' (1 - alpha_1 exp(-D/alpha_2)) D^(5/2)"
    outlet = "hole"
    power = 2.5
