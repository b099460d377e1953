"""Fit of profiles along outlets: parameters with intervals over seeds, bands of the laws, and the dependence of the
shape on the distance of the outlet from the wall."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar
from weakref import WeakKeyDictionary

import numpy as np

from labbook.fit import Context, FitError, Parameter
from labbook.fit.band import half_width, scatter
from labbook.measure.outlet import COVERAGE, ProfileAcross, mean_of
from labbook.papers.fan2023.laws import (
    FEWEST,
    Approach,
    Saturation,
    centred_flow,
    dome,
    eccentric_flow,
    fit_approach,
    fit_dome,
    fit_saturation,
    middle_speed,
    tilted,
)
from labbook.papers.fan2023.ratios import Ratio
from labbook.results.points import PointResult
from labbook.results.series import FurtherFit, Series, context
from labbook.stats.bootstrap import bootstrap_all
from labbook.stats.pooling import Pooled

PLACES = np.linspace(-1, 1, 201)
"""x* at which domes are evaluated."""
_WIDTHS = 60


@dataclass(frozen=True, eq=False)
class Curve:
    """Law with its 95 % intervals at places `at`. Half widths are infinite with one replicate.

    Args:
        at: Places, shape [n].
        value: Value of the law, shape [n].
        law: Half width of the interval of the law, shape [n].
        point: Half width of the interval of one more point, shape [n]. A point is the mean over as many seeds as the
            outlets have: of a profile, a bin of one more outlet; of the middles, one more outlet.
    """

    at: np.ndarray
    value: np.ndarray
    law: np.ndarray
    point: np.ndarray


DRAWS = 400
_SHARED = ("a", "gamma", "b", "delta1", "epsilon1", "sigma1", "delta2", "epsilon2", "sigma2")
_SATURATION = ("phi_inf", "tau1", "tau2")
"""Names of the parameters of eq 12; with `_SHARED`, all that the outlets of a series share."""
OF_OUTLET = ("v_c", "phi_c", "phi_max", "direct", "centred", "printed", "eccentric")
"""Names of the numbers of each outlet."""
_UNITS = {"tau2": "1/m"}


@dataclass(frozen=True, eq=False)
class FittedOutlet:
    """Numbers fitted to one outlet of several.

    Flow rates are those computed from profiles, over the counted flow rate.

    Args:
        profile: Mean over seeds.
        v_c: Velocity in the middle, by the dome [m/s].
        phi_c: Area fraction in the middle, by the dome.
        phi_max: Largest area fraction of the tilted curve.
        direct: Flow rate by integrating the profiles.
        centred: Flow rate by eq 14 with phi_c and v_c of this outlet.
        printed: Flow rate by eq 14 as printed: with gamma, and phi_inf if it could be fitted, else phi_c.
        eccentric: Flow rate by eq 18.
    """

    profile: ProfileAcross
    v_c: Pooled
    phi_c: Pooled
    phi_max: Pooled
    direct: Pooled
    centred: Pooled
    printed: Pooled
    eccentric: Pooled


@dataclass(frozen=True, eq=False)
class ProfileFit(FurtherFit):
    """Parameters shared by all outlets of a series, by name.

    a, gamma, b (centred: eqs 10, 11), phi_inf, tau1, tau2 [1/m] (eq 12; for four outlets or more), delta1, epsilon1,
    sigma1, delta2, epsilon2, sigma2 (eqs 16, 17). `misfit`: root mean square of v/v_c and phi/phi_c about the domes,
    which measures the collapse of the profiles. `curves`: the laws with their bands, by the names that
    `laws` gives them.
    """

    formula: ClassVar[str] = "v = v_c (1 - (x/R)^2)^a, v_c = sqrt(2 g gamma R); phi = phi_c (1 - (x/R)^2)^b"
    source: ClassVar[str] = "Fan et al. 2023, eqs 10-12 and 15-17"
    version: ClassVar[int] = 2
    outlets: tuple[FittedOutlet, ...] = ()
    """Numbers of each outlet, in the order of `points`."""
    misfit: tuple[float, float] = (math.nan, math.nan)
    curves: Mapping[str, Curve] = field(default_factory=dict)

    @property
    def exponents(self) -> tuple[float, float]:
        """Exponents a and b of the domes."""
        return self.parameters["a"].value, self.parameters["b"].value


def fit_along(definition: str, points: Sequence[PointResult]) -> ProfileFit:
    """Fit the profiles along the outlets of the points of a series that have any. Raises FitError."""
    profiled = tuple(result for result in points if result.outlets(definition))
    fit = fit_profiles([result.outlets(definition) for result in profiled], context(points))
    return replace(fit, points=profiled)


def shared_parameters(definition: str, points: Sequence[PointResult]) -> dict[str, float]:
    """Fit the profiles of a series as `fit_along` does, for the parameters alone: without bootstrap and intervals.

    Returns:
        Parameters by name, empty without profiles, or if no grain moved across one of the outlets.
    """
    seeds = [outlets for result in points if (outlets := result.outlets(definition))]
    if not seeds or any(not outlet.has_flow for outlets in seeds for outlet in outlets):
        return {}
    saturates = len({outlets[0].R for outlets in seeds}) >= FEWEST
    names = _SHARED + (_SATURATION if saturates else ())
    return dict(zip(names, _numbers(list(map(mean_of, seeds)), context(points), saturates), strict=False))


def profile_fit(series: Series, definition: str) -> ProfileFit:
    """Return the fit to the profiles of a series. Raises KeyError if there is none."""
    fit = series.further[definition]
    assert isinstance(fit, ProfileFit)
    return fit


def fit_profiles(seeds: Sequence[Sequence[ProfileAcross]], context: Context) -> ProfileFit:
    """Fit the profiles of one or several outlets.

    Intervals are Student's, with errors by the bootstrap over seeds: neighbouring bins of one run are correlated, so
    bins are no independent points. With one replicate at any outlet, intervals are infinite. Profiles are fitted within
    the `reach` of the outlets.

    Args:
        seeds: Replicates of each outlet.
        context: Grains and gravity.

    Raises:
        FitError: There is no outlet, or no grain moved across one.
    """
    if not seeds or any(not replicates for replicates in seeds):
        raise FitError(f"no outlet has profiles; measure {COVERAGE}, and leave out clogged points")
    for outlet in (outlet for replicates in seeds for outlet in replicates if not outlet.has_flow):
        raise FitError(f"no grain was seen to move across the outlet of {2e3 * outlet.R:g} mm in one of its runs")
    several = min(len(replicates) for replicates in seeds) > 1
    saturates = len({replicates[0].R for replicates in seeds}) >= FEWEST

    R = np.array([replicates[0].R for replicates in seeds])
    names = _SHARED + (_SATURATION if saturates else ())

    def statistic(sample: Sequence[Sequence[ProfileAcross]]) -> list[float]:
        numbers = _numbers([mean_of(replicates) for replicates in sample], context, saturates)
        sample_laws = laws(dict(zip(names, numbers, strict=False)), R, context.g)
        return numbers + [float(value) for law in sample_laws.values() for value in law]

    if several:
        pooled = bootstrap_all(seeds, statistic, DRAWS)
    else:
        n = sum(map(len, seeds))
        pooled = tuple(Pooled(value, math.nan, math.inf, n) for value in statistic(seeds))
    parameters = {
        name: Parameter(estimate.value, estimate.low, estimate.high, estimate.error, _UNITS.get(name, ""))
        for name, estimate in zip(names, pooled, strict=False)
    }
    means = [mean_of(replicates) for replicates in seeds]
    first, last = len(names), len(names) + len(seeds) * len(OF_OUTLET)
    rows = np.array(pooled[first:last], dtype=object).reshape(len(seeds), -1)
    outlets = tuple(FittedOutlet(mean, *row) for mean, row in zip(means, rows, strict=True))
    misfits = _misfits(outlets, parameters)
    misfit = misfits["velocity"], misfits["area_fraction"]
    middles = {"v_c": [outlet.v_c for outlet in outlets], "phi_c": [outlet.phi_c for outlet in outlets]}
    freedom = sum(map(len, seeds)) - len(seeds)  # the mean of each outlet takes one
    bands = curves(pooled[last:], parameters, R, context.g, middles, misfits, freedom)
    notes = tuple(_notes(seeds, means, several, saturates))
    return ProfileFit(parameters, notes, outlets=outlets, misfit=misfit, curves=bands)


def _numbers(outlets: Sequence[ProfileAcross], context: Context, saturates: bool) -> list[float]:
    """Fit the shared parameters, those of eq 12, and for each outlet the numbers of OF_OUTLET, in this order."""
    d, rho, g = context.d, context.rho_p, context.g
    R = np.array([outlet.R for outlet in outlets])
    fall = np.sqrt(2 * g * R)
    velocity = fit_dome(outlets, [outlet.velocity for outlet in outlets])
    scaled = fit_dome(
        outlets, [outlet.velocity / s for outlet, s in zip(outlets, fall, strict=True)], one_amplitude=True
    )
    fraction = fit_dome(outlets, [outlet.area_fraction for outlet in outlets])
    # v_c = sqrt(gamma) sqrt(2 g R): a straight line through the origin in sqrt(R)
    gamma = float((velocity.amplitude @ fall) / (fall @ fall)) ** 2
    speed = (float(scaled.tilt[0]), float(scaled.amplitude[0]), scaled.exponent)
    # one tilt for all outlets, each with an amplitude of its own
    tilt = float((fraction.amplitude @ fraction.tilt) / (fraction.amplitude @ fraction.amplitude))
    highest = _highest(tilt, fraction.exponent)
    cover = (tilt / highest, 1 / highest, fraction.exponent)
    numbers = [velocity.exponent, gamma, fraction.exponent, *speed, *cover]
    limit = fraction.amplitude
    if saturates:
        law = fit_saturation(R.tolist(), fraction.amplitude.tolist(), d)
        numbers += [law.phi_inf, law.tau1, law.tau2]
        limit = np.full(len(R), law.phi_inf)
    for k, outlet in enumerate(outlets):
        v_c, phi_c, phi_max = (
            float(velocity.amplitude[k]),
            float(fraction.amplitude[k]),
            fraction.amplitude[k] * highest,
        )
        shape = (outlet.R, velocity.exponent, fraction.exponent)
        width = np.diff(outlet.edges) * outlet.R
        numbers += [v_c, phi_c, float(phi_max)]
        numbers += [2 / 3 * d * rho * float(outlet.flux @ width) / outlet.counted]
        numbers += [centred_flow(d, rho, phi_c, v_c, *shape) / outlet.counted]
        numbers += [centred_flow(d, rho, float(limit[k]), math.sqrt(gamma) * fall[k], *shape) / outlet.counted]
        numbers += [eccentric_flow(d, rho, g, outlet.R, float(phi_max), speed, cover) / outlet.counted]
    return numbers


def _highest(tilt: float, exponent: float) -> float:
    """Largest value of the tilted dome within the outlet."""
    return float(np.max(tilted(np.linspace(-1, 1, 2001), exponent, tilt)))


def _misfits(outlets: Sequence[FittedOutlet], parameters: Mapping[str, Parameter]) -> dict[str, float]:
    """Root mean square of v/v_c and phi/phi_c about the domes and about the tilted curves, by the names of `laws`."""
    value = {name: parameter.value for name, parameter in parameters.items()}
    misfits = {}
    for law, shape, tilt in (
        ("velocity", "a", 0.0),
        ("area_fraction", "b", 0.0),
        ("tilted_velocity", "sigma1", value["delta1"] / value["epsilon1"]),
        ("tilted_area_fraction", "sigma2", value["delta2"] / value["epsilon2"]),
    ):
        profile, residuals = law.removeprefix("tilted_"), []
        for outlet in outlets:
            centre = outlet.v_c if profile == "velocity" else outlet.phi_c
            values, edges = getattr(outlet.profile, profile), outlet.profile.edges
            inside = outlet.profile.inside & np.isfinite(values)
            expected = dome(edges, value[shape]) + tilt * (edges[1:] + edges[:-1]) / 2
            residuals.append((values / centre.value - expected)[inside])
        misfits[law] = float(np.sqrt(np.mean(np.concatenate(residuals) ** 2)))
    return misfits


def _notes(seeds: Sequence[Sequence[ProfileAcross]], means: Sequence[ProfileAcross], several: bool, saturates: bool):
    if all(mean.reach >= 1 for mean in means):
        yield "fitted over whole outlets: no grain crosses within its radius of an edge, and phi falls to nothing there"
    else:
        reach = ", ".join(f"{mean.reach:.3g}" for mean in means)
        yield f"fitted for |x*| up to 1 - r/R = {reach}, which centres of grains can reach"
    if not several:
        yield "fewer than 2 replicates at some outlet: no intervals"
    if not saturates:
        widths = len({replicates[0].R for replicates in seeds})
        yield f"eq 12 needs {FEWEST} outlets of different widths, and there are {widths}: no phi_inf, tau1, tau2"


def laws(parameters: Mapping[str, float], R: np.ndarray, g: float) -> dict[str, np.ndarray]:
    """Evaluate the laws of a fit, for their bands.

    Args:
        parameters: Parameters by name.
        R: Half widths of the outlets [m].
        g: Gravity [m/s^2].

    Returns:
        By name, v/v_c and phi/phi_c at PLACES, by domes and tilted (eqs 16 and 17 over their epsilon); at `widths(R)`
        v_c [m/s] and, if eq 12 was fitted, phi_c.
    """
    delta = parameters["delta1"] / parameters["epsilon1"], parameters["delta2"] / parameters["epsilon2"]
    values = {
        "velocity": tilted(PLACES, parameters["a"]),
        "area_fraction": tilted(PLACES, parameters["b"]),
        "tilted_velocity": tilted(PLACES, parameters["sigma1"], delta[0]),
        "tilted_area_fraction": tilted(PLACES, parameters["sigma2"], delta[1]),
        "v_c": middle_speed(parameters["gamma"], widths(R), g),
    }
    if "phi_inf" in parameters:
        values["phi_c"] = _saturation(parameters).at(widths(R))
    return values


def widths(R: np.ndarray) -> np.ndarray:
    """Half widths [m] at which the middles of outlets of half widths R are plotted."""
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
    """Compute the laws with their bands, by name.

    Args:
        pooled: Values and errors of the laws one after another, in the order of `laws`.
        parameters: Parameters by name.
        R: Half widths of the outlets [m].
        g: Gravity [m/s^2].
        middles: v_c and phi_c of the outlets.
        misfits: Root mean square distance of bins from the laws at PLACES.
        degrees_of_freedom: Of the intervals.
    """
    values = {name: parameter.value for name, parameter in parameters.items()}
    off = dict(misfits)
    at_outlets = {"v_c": (middle_speed(values["gamma"], R, g), 1)}
    if "phi_inf" in values:
        at_outlets["phi_c"] = (_saturation(values).at(R), 3)  # with the number of parameters that the law takes
    for name, (expected, used) in at_outlets.items():
        errors = np.array([estimate.error for estimate in middles[name]])
        off[name] = scatter(errors, np.array([estimate.value for estimate in middles[name]]) - expected, len(R) - used)
    by_name, first = {}, 0
    for name, value in laws(values, R, g).items():
        error = np.array([estimate.error for estimate in pooled[first : first + len(value)]])
        first += len(value)
        at = PLACES if name in misfits else widths(R)
        bands = (half_width(error, 0.95, degrees_of_freedom, point) for point in (0.0, off[name]))
        by_name[name] = Curve(at, value, *(np.where(np.isnan(band), np.inf, band) for band in bands))
    return by_name


def _saturation(parameters: Mapping[str, float]) -> Saturation:
    return Saturation(parameters["phi_inf"], parameters["tau1"], parameters["tau2"])


SHAPE = ("delta1", "sigma1", "delta2", "sigma2")
"""Shape parameters that depend on the position of the outlet: tilts and exponents of eqs 16 and 17."""


@dataclass(frozen=True, eq=False)
class ShapeApproach:
    """A parameter of SHAPE against s*.

    Args:
        of: Points with profiles.
        positions: s* of each point.
        parameters: The parameter of each point.
        approach: Fitted law; None with too few places.
    """

    of: tuple[PointResult, ...]
    positions: tuple[float, ...]
    parameters: tuple[Parameter, ...]
    approach: Approach | None


def approaches(ratios: Sequence[Ratio], definition: str) -> Mapping[str, ShapeApproach]:
    """Fit the parameters of SHAPE against s*, by name, to the points that have profiles along their outlet.

    Every point has the same weight, whatever its outlet and the width of its hopper: the paper's claim is that they
    depend on s* alone.
    """
    fitted = [(ratio, fit) for ratio in ratios if (fit := fit_of_point(ratio.result, definition)) is not None]
    points, positions = tuple(ratio.result for ratio, _ in fitted), tuple(ratio.at for ratio, _ in fitted)
    several, by_name = len(set(positions)) >= FEWEST, {}
    for name in SHAPE:
        parameters = tuple(fit.parameters[name] for _, fit in fitted)
        law = fit_approach(positions, [parameter.value for parameter in parameters]) if several else None
        by_name[name] = ShapeApproach(points, positions, parameters, law)
    return by_name


_OWN: WeakKeyDictionary[PointResult, dict[str, ProfileFit | None]] = WeakKeyDictionary()
"""Fits to single points by definition, kept while the point exists: page and comparison use the same fits, and a
bootstrap takes long."""


def fit_of_point(result: PointResult, definition: str) -> ProfileFit | None:
    """Fit one point alone; None without profiles, or if no grain moved across the outlet in one of its runs."""
    fits = _OWN.setdefault(result, {})
    if definition not in fits:
        try:
            fits[definition] = fit_profiles([result.outlets(definition)], context([result]))
        except FitError:
            fits[definition] = None
    return fits[definition]
