"""Interpolation of a measured quantity between the settings of its runs: values and intervals, in SI.

Positive quantities are interpolated as logarithms, against the logarithm of a length or any other key itself. The known
trend of the flow through an outlet is subtracted first: W is proportional to (D - 1.4 d)^n with n of the outlet, and
the fit describes the deviation from it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from labbook.scene.scene import Scene
from labbook.stats.response import Response

CLOGGED = 0.2
"""Largest part of clogged runs at a point: with more, the runs that flowed are a biased sample."""
_K = 1.4
"""k of Beverloo's law for spheres (Beverloo et al., Chem. Eng. Sci. 15 (1961) 260)."""
_POWERS = {"slot": 1.5, "hole": 2.5}
_NARROWEST = 2.0
"""Narrowest outlet [d] for which the trend is used."""
_RATES = ("flow_rate", "grain_rate")
Trend = Callable[[np.ndarray], np.ndarray]
"""Logarithm of a quantity at m settings, up to a constant: a function of shape [m] to [m]."""


@dataclass(frozen=True, eq=False)
class Interpolation:
    """A quantity against a key, fitted to runs.

    Attributes:
        low: Smallest setting.
        high: Largest setting.
        response: Fitted response, in transformed numbers.
    """

    low: float
    high: float
    response: Response
    _of_length: bool
    _logarithmic: bool
    _trend: Trend

    @classmethod
    def of(
        cls,
        settings: Sequence[float] | np.ndarray,
        values: Sequence[float] | np.ndarray,
        beds: Sequence[int],
        *,
        of_length: bool = False,
        trend: Trend | None = None,
    ) -> "Interpolation":
        """Fit the quantity to runs.

        Args:
            settings: Of the runs [SI], shape [n].
            values: Of the runs [SI], shape [n].
            beds: Seeds of their beds, shape [n].
            of_length: True if the key is a length.
            trend: Known trend of the quantity (`trend_of_outlets`); unused if a value is not positive.

        Returns:
            The fitted quantity.

        Raises:
            ValueError: See `Response.of`.
        """
        x, y = np.asarray(settings, float), np.asarray(values, float)
        of_length, logarithmic = of_length and bool((x > 0).all()), bool((y > 0).all())
        trend = trend if trend is not None and logarithmic else np.zeros_like
        response = Response.of(np.log(x) if of_length else x, (np.log(y) if logarithmic else y) - trend(x), beds)
        return cls(float(x.min()), float(x.max()), response, of_length, logarithmic, trend)

    def at(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute the quantity, or its logarithm if all its values are above 0.

        Args:
            x: Settings [SI], shape [m].

        Returns:
            Values and half widths of their 95 % intervals, each of shape [m].

        Raises:
            ValueError: A setting is outside the range.
        """
        x = np.asarray(x, float)
        mean, half = self.response.at(np.log(x) if self._of_length else x)
        return mean + self._trend(x), half

    def band(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Compute the quantity with its interval.

        Args:
            x: Settings [SI], shape [m].

        Returns:
            Values and the ends of their 95 % intervals [SI], each of shape [m].

        Raises:
            ValueError: A setting is outside the range.
        """
        value, half = self.at(x)
        back = np.exp if self._logarithmic else np.asarray
        return back(value), back(value - half), back(value + half)


@dataclass(frozen=True)
class OutletTrend:
    """Logarithm of a flow rate against the outlet, up to a constant: power ln(D - offset).

    Attributes:
        power: Of Beverloo's law.
        offset: Width of the outlet without flow [m].
    """

    power: float
    offset: float

    def __call__(self, D: np.ndarray) -> np.ndarray:
        return self.power * np.log(D - self.offset)


def trend_of_outlets(quantity: str, key: str, scene: Scene, narrowest: float) -> OutletTrend | None:
    """Build the known trend of a quantity against a key.

    Args:
        quantity: Name of the quantity.
        key: Dotted key.
        scene: Any of the scenes.
        narrowest: Smallest setting.

    Returns:
        The trend of a flow rate against the outlet; None for other quantities and keys, and for outlets hardly wider
        than a grain.
    """
    form, d = scene.container.outlet_form, scene.grains.equivalent_diameter
    if key != "container.orifice" or quantity not in _RATES or form not in _POWERS or narrowest < _NARROWEST * d:
        return None
    return OutletTrend(_POWERS[form], _K * d)
