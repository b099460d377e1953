"""How the flow rate of a hopper depends on the angle of its bottom: laws without free parameters.

Angles [rad] are those of the bottom from the vertical, 90 deg being flat; flow rates are relative to a flat bottom.
"""

import math

BROWN = "Brown, Nature 191 (1961) 458; Fan et al. 2023, eq 3"
ROSE_TANAKA = "Rose & Tanaka, Engineer 208 (1959) 465"


def brown(angle: float) -> float:
    """Brown's factor int_0^a sqrt(cos x) dx / sin^{3/2} a over its value at 90 deg, 1.198.

    From the least energy of grains that fall freely from an arch. It grows as a^{-1/2} for steep bottoms. Raises
    ValueError for an angle that is not above 0 and at most 90 deg.
    """
    return _brown(_checked(angle)) / _brown(math.pi / 2)


def _brown(angle: float) -> float:
    from scipy.integrate import quad

    # x = pi/2 - y^2 takes the root out of the end at 90 deg
    low = math.sqrt(max(math.pi / 2 - angle, 0.0))
    integral, _ = quad(
        lambda y: 2 * y * math.sqrt(math.sin(y * y)), low, math.sqrt(math.pi / 2), epsabs=0, epsrel=1e-12
    )
    return integral / math.sin(angle) ** 1.5


def rose_tanaka(angle: float, friction_angle: float) -> float:
    """(tan a tan phi_d)^{-0.35} for a < 90 deg - phi_d, else 1.

    `friction_angle` phi_d [rad]: the angle between the stagnant zone and the horizontal; where it is not known the
    arctangent of the friction of the grains may stand for it. Raises ValueError for angles out of range.
    """
    angle = _checked(angle)
    if not 0 < friction_angle < math.pi / 2:
        raise ValueError(
            f"the angle of friction lies between 0 and 90 deg, not at {math.degrees(friction_angle):g} deg"
        )
    if angle >= math.pi / 2 - friction_angle:
        return 1.0
    return (math.tan(angle) * math.tan(friction_angle)) ** -0.35


def _checked(angle: float) -> float:
    if not 0 < angle <= math.pi / 2 * (1 + 1e-9):
        raise ValueError(f"the angle of a bottom lies between 0 and 90 deg, not at {math.degrees(angle):g} deg")
    return min(angle, math.pi / 2)
