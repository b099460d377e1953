"""Damping that gives back the asked coefficient of restitution.

The normal force is never attractive, so a collision ends when the force, not the overlap, comes to zero: the textbook
relations between damping and restitution do not hold. Here the clamped collision is solved.
"""

import math
from collections.abc import Callable
from functools import lru_cache

LARGEST_RATIO = 1e3


def linear_restitution(ratio: float) -> float:
    """Compute the coefficient of restitution of the clamped linear law (Schwager & Poschel 2007, eqs 21-23).

    Args:
        ratio: Damping ratio gamma_n/(2 sqrt(k_n m*)).

    Returns:
        Coefficient of restitution e.
    """
    if ratio < 1:
        omega = math.sqrt(1 - ratio**2)
        until = (math.pi - math.atan2(2 * ratio * omega, omega**2 - ratio**2)) / omega
    elif ratio == 1:
        until = 2.0
    else:
        omega = math.sqrt(ratio**2 - 1)
        until = 2 * math.log(ratio + omega) / omega
    return math.exp(-ratio * until)


def linear_textbook(e: float) -> float:
    """Damping ratio of the linear law without the clamp: |ln e| / sqrt(pi^2 + ln^2 e)."""
    return -math.log(e) / math.hypot(math.pi, math.log(e))


@lru_cache(maxsize=256)
def linear_ratio(e: float) -> float:
    """Damping ratio with which the clamped linear law has restitution e in (0, 1]."""
    if e == 1:
        return 0.0
    return _root(lambda ratio: linear_restitution(ratio) - e, LARGEST_RATIO)


def hertz_restitution(c_n: float) -> float:
    """Compute the coefficient of restitution of the clamped Hertz law; it depends on neither speed nor stiffness.

    In units in which m* = K = v = 1: x'' = -x^{3/2} - sqrt(6) C_n x^{1/4} x', until the right side vanishes.

    Args:
        c_n: Damping C_n.

    Returns:
        Coefficient of restitution e.
    """
    from scipy.integrate import solve_ivp

    if c_n == 0:
        return 1.0
    b = math.sqrt(6) * c_n

    def slope(_t, state):
        x, v = max(state[0], 0.0), state[1]
        return [v, -(x**1.5) - b * x**0.25 * v]

    def force(_t, state):
        return max(state[0], 0.0) ** 1.25 + b * state[1]  # has the sign of the force

    force.terminal, force.direction = True, -1  # type: ignore[attr-defined]
    end = solve_ivp(slope, (0, 1e4), [0.0, 1.0], method="DOP853", rtol=1e-11, atol=1e-13, events=force)
    return -float(end.y_events[0][0][1])


def hertz_textbook(e: float) -> float:
    """C_n of the Hertz law without the clamp: sqrt(5/6) |ln e| / sqrt(pi^2 + ln^2 e) (Tsuji et al. 1992)."""
    return math.sqrt(5 / 6) * linear_textbook(e)


@lru_cache(maxsize=256)
def hertz_c_n(e: float) -> float:
    """C_n with which the clamped Hertz law has restitution e in (0, 1]."""
    if e == 1:
        return 0.0
    high = 1.0
    while hertz_restitution(high) > e:
        high *= 2
    return _root(lambda c: hertz_restitution(c) - e, high)


def _root(function: Callable[[float], float], high: float) -> float:
    """Root between 0 and `high`, to ten digits (of what an ODE solution gives)."""
    from scipy.optimize import root_scalar

    return root_scalar(function, bracket=(0.0, high), method="brentq", xtol=1e-12, rtol=1e-10).root
