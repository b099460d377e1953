"""The coefficients of a contact law: a row c of numbers that kernels take and index by names.

A law names its own coefficients once, by places of `OWN`, as constants of its module. The host fills the row and the
formulas read it by these names and by those that all laws share:

    K = OWN[0]

    def coefficients(law, surface, stiffness_scale=1.0, wall=False):
        return row({K: law.stiffness * stiffness_scale, MU: surface.friction, MU_R: surface.rolling_friction})

    @func
    def normal(c, rs, ms, delta, vn):
        return c[K] * delta * delta

A generated module defines the names that its formulas use (`labbook_dem.source.named_numbers`).
"""

from collections.abc import Mapping

COEFFICIENTS = 8
"""Length of the row."""
C_N, MU, MU_R = 1, 4, 5
"""Places that all laws share: coefficient of the normal dashpot, which records call `damping_coefficient`, 0 without a
dashpot; friction; rolling friction."""
OWN = (0, 2, 3, 6, 7)
"""Places of the coefficients of one law alone."""


def row(values: Mapping[int, float]) -> tuple[float, ...]:
    """Fill the row of a law from its coefficients by place; places without one are 0."""
    numbers = [0.0] * COEFFICIENTS
    for index, value in values.items():
        numbers[index] = float(value)
    return tuple(numbers)
