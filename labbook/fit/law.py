"""Flow laws: formula of the mass flow rate, free parameters, and reported parameters."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from labbook.scene.lids import depth_between
from labbook.scene.scene import Scene


@dataclass(frozen=True)
class Context:
    """Properties of grains, slot and gravity that a law needs besides the orifice, in SI.

    Args:
        d: Diameter of the grains, or of spheres of their volume [m].
        rho_p: Density of the grains' material [kg/m^3].
        rho_b: Bulk density of the packing, its measured packing fraction times rho_p [kg/m^3]; None: not measured.
        Z: Thickness of the slot [m]; NaN for a hole.
        g: Gravity [m/s^2].
    """

    d: float
    rho_p: float
    rho_b: float | None
    Z: float
    g: float

    @classmethod
    def of(cls, scene: Scene, packing_fraction: float | None) -> "Context":
        """Build the context of a scene.

        Args:
            scene: The scene.
            packing_fraction: Measured packing fraction of its bed; None: not measured.

        Returns:
            Properties of its grains, slot and gravity.
        """
        density = scene.grains.mean_density
        diameter = (6 * scene.grains.mass / (math.pi * density)) ** (1 / 3)  # of a sphere of the grains' volume
        deep = scene.container.front_to_back
        thickness = deep if math.isfinite(deep) else depth_between(scene.container.walls())
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
    """A reported parameter: a monotone function of one free parameter.

    Args:
        name: Name of the parameter.
        unit: Unit in SI.
        free: Index of the free parameter.
        of: The function, from the free to the reported value.
        symbol: Symbol in headings and on axes (superscripts as ^(...)).
        shown: Unit in tables and on axes, if it differs.
        scale: Factor from SI to that unit.
    """

    name: str
    unit: str
    free: int
    of: Callable[[float], float]
    symbol: str = ""
    shown: str = ""
    scale: float = 1.0

    def invert(self, value: float, near: float) -> float:
        """Invert the function `of`.

        Args:
            value: Reported value [`unit`].
            near: Free parameter to search around.

        Returns:
            The free parameter.

        Raises:
            ValueError: No free parameter within 1e4 of `near` has this reported value.
        """
        from scipy.optimize import brentq

        for reach in (1.0, 10.0, 100.0, 1e4):
            ends = self.of(near - reach) - value, self.of(near + reach) - value
            if ends[0] * ends[1] <= 0:
                root = brentq(lambda free: self.of(free) - value, near - reach, near + reach, xtol=1e-12)
                return float(root)  # pyright: ignore[reportArgumentType]
        raise ValueError(f"{self.name} cannot be {value:g}")


class Law(ABC):
    """A law W(D) of the mass flow rate [kg/s] through an orifice of width D [m].

    Free parameters are dimensionless and scaled so that the fit converges; `reported` translates them. A subclass
    defines the class variables and the abstract methods.

    Attributes:
        name: Name in studies and reports.
        version: Version; raise it whenever fitted numbers may change.
        formula: The formula, as text.
        source: Publication.
        free: Names of the free parameters.
        least_ratio: Smallest D/d that the law is meant for.
        outlet: Outlets that it holds for: `slot`, `hole` or `any`.
    """

    name: ClassVar[str]
    version: ClassVar[int]
    formula: ClassVar[str]
    source: ClassVar[str]
    free: ClassVar[tuple[str, ...]]
    least_ratio: ClassVar[float]
    outlet: ClassVar[Literal["slot", "hole", "any"]] = "any"

    def __repr__(self) -> str:
        return f"<{self.name}: {self.formula}>"

    @abstractmethod
    def log_flow(self, D: np.ndarray, free: np.ndarray, context: Context) -> np.ndarray:
        """ln W at given orifices.

        Args:
            D: Orifices [m], shape [n].
            free: Free parameters, shape [p].
            context: Properties of grains, slot and gravity.

        Returns:
            ln of W in kg/s, shape [n].
        """

    @abstractmethod
    def start(self, D: np.ndarray, W: np.ndarray, context: Context) -> np.ndarray:
        """Free parameters to start a fit from.

        Args:
            D: Orifices [m], shape [n].
            W: Flow rates [kg/s], shape [n].
            context: Properties of grains, slot and gravity.

        Returns:
            Free parameters, shape [p].
        """

    @abstractmethod
    def reported(self, context: Context) -> tuple[Reported, ...]:
        """Parameters as reports show them.

        Args:
            context: Properties of grains, slot and gravity; without a bulk density, parameters that need it are left
                out.

        Returns:
            The parameters in their order.
        """

    def without_minimum(
        self, D: np.ndarray, W: np.ndarray, relative: np.ndarray, context: Context, allowed: Callable[[float], float]
    ) -> str:
        """Reason why chi2 has no minimum at finite parameters.

        Args:
            D: Orifices [m], shape [n].
            W: Flow rates [kg/s], shape [n].
            relative: Relative standard errors of W, shape [n].
            context: Properties of grains, slot and gravity.
            allowed: Rise of chi2 over a given minimum that bounds the intervals.

        Returns:
            The reason, with the limits that the data still give; empty if there is a minimum, or if the law has no
            limit to diverge to.
        """
        return ""

    def endless(self, free: np.ndarray) -> Collection[int]:
        """Free parameters that would diverge if the law did not bound them.

        An end of their intervals at such a bound is that of the bound, not of the data, and counts as infinite.

        Args:
            free: Free parameters, shape [p].

        Returns:
            Their indices.
        """
        return ()

    @property
    def parameters(self) -> Mapping[str, Reported]:
        """All parameters that may be reported, by name: those for a slot with a measured packing fraction."""
        return {entry.name: entry for entry in self.reported(_EXAMPLE)}

    @property
    def of_bulk(self) -> tuple[str, ...]:
        """Symbols of the parameters that need the bulk density, and so a measured packing fraction."""
        without = {entry.name for entry in self.reported(replace(_EXAMPLE, rho_b=None))}
        return tuple(entry.symbol for name, entry in self.parameters.items() if name not in without)

    def flow(self, D: np.ndarray, free: np.ndarray, context: Context) -> np.ndarray:
        """Flow rates of the law.

        Args:
            D: Orifices [m], shape [n].
            free: Free parameters, shape [p].
            context: Properties of grains, slot and gravity.

        Returns:
            W [kg/s], shape [n].
        """
        return np.exp(self.log_flow(np.asarray(D, float), np.asarray(free, float), context))

    def outside(self, D: np.ndarray, context: Context) -> np.ndarray:
        """Mark the orifices outside the range that the law is meant for, D/d >= `least_ratio`.

        Args:
            D: Orifices [m], shape [n].
            context: Properties of the grains.

        Returns:
            True for orifices outside, shape [n].
        """
        return np.asarray(D, float) / context.d < self.least_ratio * (1 - 1e-9)


def extended_log(x: np.ndarray) -> np.ndarray:
    """ln x, continued below 1e-3 by its tangent: a fit that leaves the domain is led back.

    Args:
        x: Argument, of any shape; of order one at a grain's diameter beyond its zero.

    Returns:
        Finite values of the same shape.
    """
    edge = 1e-3
    inside = np.maximum(x, edge)
    return np.log(inside) + (x - inside) / edge


def exponential(x: float) -> float:
    """e^x, infinite where a double overflows, as at the end of an unbounded interval."""
    return math.exp(x) if x < 700 else math.inf
