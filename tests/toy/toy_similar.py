"""A study at several scales, and how numbers change between them."""

import math
from dataclasses import dataclass
from typing import Any

from labbook.study import Study, define

D, G = 3e-3, 9.81
"""Diameter of the grains [m] and gravity [m/s^2] before they are scaled."""


@dataclass(frozen=True)
class Similar:
    """A factor of all lengths and one of gravity."""

    L: float
    gravity: float

    @property
    def T(self) -> float:
        return math.sqrt(self.L / self.gravity)

    def of(self, unit: str) -> float:
        """Factor of numbers in an SI unit."""
        L, T, M = self.L, self.T, self.L**3
        factors = {"": 1.0, "m": L, "s": T, "m/s": L / T, "1/s": 1 / T, "kg/s": M / T, "Pa": M / (L * T**2)}
        return {**factors, "J": M * L**2 / T**2, "W": M * L**2 / T**3}[unit]


def asked(by: Similar, **more: Any) -> Study:
    """A hopper and all that it states, scaled; what it leaves out follows from its scene."""
    stiff = f"{2e6 * by.L * by.gravity!r} Pa"
    sizes = {"width": 48, "height": 200, "thickness": 1.01 * 3, "orifice": 21}
    container = {key: f"{size * by.L!r} mm" for key, size in sizes.items()}
    return define(
        name="similar",
        grains={"shape": "sphere", "diameter": f"{3 * by.L!r} mm", "density": "2500 kg/m^3", "count": 300},
        contact={"law": "hertz-mindlin", "shear_modulus": stiff, "poisson_ratio": 0.25, "friction": 0.5}
        | {"restitution": 0.2},
        container={"kind": "wedge-hopper", **container},
        gravity=f"{G * by.gravity!r} m/s^2",
        numerics={"dt": f"{2**-18 * by.T!r} s"},
        window={"start": 0.2, "end": 0.5},
        **more,
    )
