"""The coarse-graining function: a Gaussian cut off at four times its width (Goldhirsch, Granul. Matter 12 (2010) 239).

phi(r) = A exp(-r^2 / 2 omega^2) for r <= 4 omega, else 0. A makes its integral over the cut-off ball (in quasi-2D:
disc) exactly 1:

    ball:  1/A = (2 pi)^{3/2} omega^3 [erf(c/sqrt 2) - sqrt(2/pi) c e^{-c^2/2}],  c = 4
    disc:  1/A = 2 pi omega^2 (1 - e^{-c^2/2})
"""

import math

CUTOFF = 4.0
"""Radius of the ball in units of omega."""


def amplitude(omega: float, dimensions: int) -> float:
    """A of the kernel in 2 or 3 dimensions [1/m^2 or 1/m^3]. Raises ValueError for a width that is not positive."""
    if not omega > 0:
        raise ValueError(f"the width of the coarse-graining function must be positive, not {omega}")
    tail = math.exp(-(CUTOFF**2) / 2)
    if dimensions == 2:
        return 1 / (2 * math.pi * omega**2 * (1 - tail))
    inside = math.erf(CUTOFF / math.sqrt(2)) - math.sqrt(2 / math.pi) * CUTOFF * tail
    return 1 / ((2 * math.pi) ** 1.5 * omega**3 * inside)
