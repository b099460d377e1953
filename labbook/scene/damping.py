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


HERTZ_C_N = (
    4.388117429245581, 3.0151423922005653, 2.4000798135098957, 2.0301834483946175, 1.7758499790119084,
    1.5868589359464416, 1.439093184556847, 1.3193279588620268, 1.219620141034717, 1.134870048757232,
    1.0616321267506654, 0.9974824790735578, 0.9406591073219217, 0.8898459055004393, 0.8440370773847156,
    0.8024488089200893, 0.7644598773402509, 0.7295706151263676, 0.6973738760575308, 0.66753406155284,
    0.6397716869292536, 0.613851836546054, 0.5895753993387309, 0.566772325728319, 0.5452963768024109,
    0.5250209900728112, 0.5058359914203646, 0.48764495567517546, 0.47036306963480917, 0.4539153883035049,
    0.4382354012898786, 0.4232638463285472, 0.4089477209655688, 0.39523945440403596, 0.38209620970705044,
    0.3694792927647785, 0.3573536490918758, 0.34568743366190086, 0.33445164129873756, 0.3236197879543429,
    0.31316763474555115, 0.3030729480415181, 0.29331529032717685, 0.2838758370915445, 0.2747372161325918,
    0.26588336601415635, 0.25729941110022436, 0.24897155083475286, 0.24088696147430216, 0.23303370856341998,
    0.2254006688818817, 0.2179774605842975, 0.21075438056554385, 0.20372234823914337, 0.19687285487007503,
    0.1901979178921163, 0.18369003961928607, 0.17734216984777512, 0.17114767194506303, 0.16510029203308402,
    0.1591941309349375, 0.15342361860206818, 0.14778349077863087, 0.14226876761796134, 0.13687473418006046,
    0.13159692246318666, 0.12643109496021077, 0.12137322951749847, 0.11641950538940035, 0.11156629040123191,
    0.1068101290865156, 0.10214773173049298, 0.0975759642465335, 0.09309183877522341, 0.0886925049940011,
    0.08437524204038518, 0.0801374510029531, 0.07597664796578045, 0.0718904574955286, 0.06787660660297902,
    0.06393291910673814, 0.06005731036022986, 0.056247782342257274, 0.05250241905321871, 0.04881938221322615,
    0.04519690724494763, 0.04163329948239531, 0.038126930644552214, 0.03467623550236376, 0.03127970875361425,
    0.027935902105464604, 0.02464342149973318, 0.02140092452538218, 0.01820711793611527, 0.015060755414213233,
    0.011960635331905502, 0.008905598723530327, 0.005894527341818767, 0.0029263418457964696,
)  # fmt: skip
"""C_n for e = 0.01, 0.02 ... 0.99, as `solve_hertz_c_n` gives it. It needs scipy, which takes half a second to import
and is needed for nothing else by many processes."""


@lru_cache(maxsize=256)
def hertz_c_n(e: float) -> float:
    """C_n with which the clamped Hertz law has restitution e in (0, 1]."""
    if e == 1:
        return 0.0
    hundredths = round(100 * e)
    if e == hundredths / 100 and hundredths > 0:
        return HERTZ_C_N[hundredths - 1]
    return solve_hertz_c_n(e)


def solve_hertz_c_n(e: float) -> float:
    """C_n with which the clamped Hertz law has restitution e in (0, 1), by integration of collisions."""
    high = 1.0
    while hertz_restitution(high) > e:
        high *= 2
    return _root(lambda c: hertz_restitution(c) - e, high)


def _root(function: Callable[[float], float], high: float) -> float:
    """Root between 0 and `high`, to ten digits (of what an ODE solution gives)."""
    from scipy.optimize import root_scalar

    return root_scalar(function, bracket=(0.0, high), method="brentq", xtol=1e-12, rtol=1e-10).root
