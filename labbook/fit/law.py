"""Flow laws: a formula for the mass flow rate, free parameters, and what is reported of them."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from labbook.scene.scene import Scene


@dataclass(frozen=True)
class Context:
    """What a law needs to know besides the orifice, in SI.

    `d`: diameter of the grains, or of spheres of their volume [m];
    `rho_p`: density of the grains' material [kg/m^3]; `rho_b`: bulk density of the
    packing, its measured packing fraction times rho_p [kg/m^3], None if not measured; `Z`: thickness of the
    slot [m], NaN for a hole; `g`: gravity [m/s^2].
    """

    d: float
    rho_p: float
    rho_b: float | None
    Z: float
    g: float

    @classmethod
    def of(cls, scene: Scene, packing_fraction: float | None) -> "Context":
        """Take it from a scene, and from the measured packing fraction of its bed; None: not measured."""
        density = scene.grains.mean_density
        diameter = (6 * scene.grains.mass / (math.pi * density)) ** (1 / 3)  # of a sphere of the grains' volume
        thickness = float(getattr(scene.container, "thickness", math.nan))
        bulk = None if packing_fraction is None else packing_fraction * density
        return cls(diameter, density, bulk, thickness, scene.gravity)

    @property
    def grain_mass(self) -> float:
        """Mass of a grain [kg]."""
        return self.rho_p * math.pi / 6 * self.d**3

    @property
    def unit_flow(self) -> float:
        """Mass flow rate of sqrt(g/d) grains per second [kg/s]."""
        return self.grain_mass * math.sqrt(self.g / self.d)


_EXAMPLE = Context(d=1e-3, rho_p=1.0, rho_b=1.0, Z=1e-3, g=9.81)


@dataclass(frozen=True)
class Reported:
    """A parameter as it is reported: a monotone function of one free parameter.

    `symbol` stands in headings and on axes (superscripts as ^(...)); `unit` is SI, `shown` the unit that people read,
    if it is another, and `scale` the factor from SI to it.
    """

    name: str
    unit: str
    free: int
    of: Callable[[float], float]
    symbol: str = ""
    shown: str = ""
    scale: float = 1.0

    def invert(self, value: float, near: float) -> float:
        """The free parameter that is reported as this `value`, found about `near`; ValueError if there is none."""
        from scipy.optimize import brentq

        for reach in (1.0, 10.0, 100.0, 1e4):
            ends = self.of(near - reach) - value, self.of(near + reach) - value
            if ends[0] * ends[1] <= 0:
                found = brentq(lambda free: self.of(free) - value, near - reach, near + reach, xtol=1e-12)
                return float(found)  # pyright: ignore[reportArgumentType]
        raise ValueError(f"{self.name} cannot be {value:g}")


class Law(ABC):
    """A law W(D) of the mass flow rate [kg/s] through an orifice of width D [m].

    Free parameters are dimensionless and chosen so that the fit is well behaved; `reported` says what they
    mean.
    """

    name: ClassVar[str]
    version: ClassVar[int]
    """Rises whenever fitted numbers may change."""
    formula: ClassVar[str]
    source: ClassVar[str]
    free: ClassVar[tuple[str, ...]]
    least_ratio: ClassVar[float]
    """D/d below which the law is not meant to hold."""
    outlet: ClassVar[Literal["slot", "hole", "any"]] = "any"
    """The outlets that it holds for."""

    def __repr__(self) -> str:
        return f"<{self.name}: {self.formula}>"

    @abstractmethod
    def log_flow(self, D: np.ndarray, free: np.ndarray, context: Context) -> np.ndarray:
        """ln W at the orifices D [m], shape [n]; W in kg/s."""

    @abstractmethod
    def start(self, D: np.ndarray, W: np.ndarray, context: Context) -> np.ndarray:
        """Free parameters to start a fit from."""

    @abstractmethod
    def reported(self, context: Context) -> tuple[Reported, ...]:
        """The parameters as a physicist reads them."""

    def without_minimum(
        self, D: np.ndarray, W: np.ndarray, relative: np.ndarray, context: Context, allowed: Callable[[float], float]
    ) -> str:
        """Why chi2 has no minimum at finite parameters, with the limits that the data set all the same; empty if it has
        one, or if the law has no limit that it could run into.

        Args:
            D: Orifices [m], shape [n].
            W: Flow rates [kg/s], shape [n].
            relative: Relative standard errors of W, shape [n].
            context: What else the law needs to know.
            allowed: Rise of chi2 over a least value that bounds the intervals.
        """
        return ""

    def endless(self, free: np.ndarray) -> Collection[int]:
        """Free parameters, shape [p], that only a bound of the law keeps from growing at these values: by their
        indices. An end of their intervals there is that of the bound, and not of the data."""
        return ()

    @property
    def parameters(self) -> Mapping[str, Reported]:
        """What may be reported, by name: of a slot with a measured packing fraction."""
        return {one.name: one for one in self.reported(_EXAMPLE)}

    @property
    def of_bulk(self) -> tuple[str, ...]:
        """Symbols of the parameters that need the bulk density, and so a measured packing fraction."""
        without = {one.name for one in self.reported(replace(_EXAMPLE, rho_b=None))}
        return tuple(one.symbol for name, one in self.parameters.items() if name not in without)

    def flow(self, D: np.ndarray, free: np.ndarray, context: Context) -> np.ndarray:
        """W [kg/s] at the orifices D [m], shape [n]."""
        return np.exp(self.log_flow(np.asarray(D, float), np.asarray(free, float), context))

    def outside(self, D: np.ndarray, context: Context) -> np.ndarray:
        """Which orifices lie outside the range that the law is meant for, shape [n]."""
        return np.asarray(D, float) / context.d < self.least_ratio * (1 - 1e-9)


def extended_log(x: np.ndarray) -> np.ndarray:
    """ln x, continued below 1e-3 by its tangent, so that a fit that strays out of the domain finds its way
    back. `x` should be of order one a grain's diameter beyond its zero.
    """
    edge = 1e-3
    inside = np.maximum(x, edge)
    return np.log(inside) + (x - inside) / edge


def exponential(x: float) -> float:
    """e^x, infinite where a double overflows: the end of an interval that the data do not set."""
    return math.exp(x) if x < 700 else math.inf
