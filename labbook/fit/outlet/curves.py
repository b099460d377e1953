"""The laws of profiles as curves, with the bands of the laws and of one more point."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labbook.fit.band import half_width, scatter
from labbook.fit.outlet.saturation import Saturation
from labbook.fit.outlet.shape import middle_speed, tilted
from labbook.fit.result import Parameter
from labbook.stats.pooling import Pooled

PLACES = np.linspace(-1, 1, 201)
"""x* of the domes."""
_WIDTHS = 60


@dataclass(frozen=True, eq=False)
class Curve:
    """A law at places `at`: `value`, half widths of its 95 % interval, `law`, and of that of one more point, `point`,
    of shape [n]. Both are infinite with one replicate.

    A point is the mean over as many seeds as the outlets have: of a profile a bin of one more outlet, of the middles
    against the width that of one more outlet.
    """

    at: np.ndarray
    value: np.ndarray
    law: np.ndarray
    point: np.ndarray


def laws(parameters: Mapping[str, float], R: np.ndarray, g: float) -> dict[str, np.ndarray]:
    """v/v_c and phi/phi_c at PLACES, by domes and tilted (eqs 16 and 17 over their epsilon); at `widths(R)` v_c [m/s]
    and, where eq 12 was fitted, phi_c.
    """
    delta = parameters["delta1"] / parameters["epsilon1"], parameters["delta2"] / parameters["epsilon2"]
    found = {
        "velocity": tilted(PLACES, parameters["a"]),
        "area_fraction": tilted(PLACES, parameters["b"]),
        "tilted_velocity": tilted(PLACES, parameters["sigma1"], delta[0]),
        "tilted_area_fraction": tilted(PLACES, parameters["sigma2"], delta[1]),
        "v_c": middle_speed(parameters["gamma"], widths(R), g),
    }
    if "phi_inf" in parameters:
        found["phi_c"] = _saturation(parameters).at(widths(R))
    return found


def widths(R: np.ndarray) -> np.ndarray:
    """Half widths [m] at which the middles of outlets of half widths R are drawn."""
    return np.linspace(0.9 * R.min(), 1.05 * R.max(), _WIDTHS)


def curves(
    pooled: Sequence[Pooled],
    parameters: Mapping[str, Parameter],
    R: np.ndarray,
    g: float,
    middles: Mapping[str, Sequence[Pooled]],
    misfits: Mapping[str, float],
    degrees_of_freedom: int,
) -> dict[str, Curve]:
    """The laws with their bands, by name; `pooled`: their values and errors one after another, in the order of `laws`.

    `middles`: v_c and phi_c of the outlets; `misfits`: what bins lie off the laws at PLACES, root mean square.
    """
    values = {name: parameter.value for name, parameter in parameters.items()}
    off = dict(misfits)
    at_outlets = {"v_c": (middle_speed(values["gamma"], R, g), 1)}
    if "phi_inf" in values:
        at_outlets["phi_c"] = (_saturation(values).at(R), 3)
    for name, (expected, used) in at_outlets.items():
        errors = np.array([one.error for one in middles[name]])
        off[name] = scatter(errors, np.array([one.value for one in middles[name]]) - expected, len(R) - used)
    found, first = {}, 0
    for name, value in laws(values, R, g).items():
        error = np.array([one.error for one in pooled[first : first + len(value)]])
        first += len(value)
        at = PLACES if name in misfits else widths(R)
        bands = (half_width(error, 0.95, degrees_of_freedom, point) for point in (0.0, off[name]))
        found[name] = Curve(at, value, *(np.where(np.isnan(band), np.inf, band) for band in bands))
    return found


def _saturation(parameters: Mapping[str, float]) -> Saturation:
    return Saturation(parameters["phi_inf"], parameters["tau1"], parameters["tau2"])
