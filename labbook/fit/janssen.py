"""Janssen's law of the stress in a column of grains, fitted to profiles of wall stress.

Three models of the mean vertical stress at the depth x below the effective free surface:
J1 (Janssen 1895): sigma_zz = rho g l (1 - exp(-x/l));
J2: J1 with the surface at another height, x + s in place of x;
J3 (Vanel & Clément 1999): rho g x for x < a, then rho g (a + l (1 - exp(-(x - a)/l))).
Walls give two profiles of each: the normal stress K sigma_zz, and, by the balance of a slice, the shear stress
(A/P) (rho g - d sigma_zz/dx), with area A and perimeter P of the section.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labbook.fit.profile import Minimum, minimise
from labbook.fit.result import FitError, Parameter
from labbook.stats.choice import aicc, unbeaten
from labbook.stats.pooling import student

MODELS = ("J1", "J2", "J3")
_STARTS = (0.4, 1.5)
"""Screening lengths to start fits from, in hydraulic diameters 4 A/P."""
_FEWEST = 4
"""Fewest bins for a fit."""


@dataclass(frozen=True, eq=False)
class WallProfile:
    """Stresses on upright walls by depth.

    Attributes:
        depth: Depth of the middle of each bin below the effective free surface [m], shape [n].
        normal: Normal stress [Pa], shape [n].
        shear: Shear stress of the wall on the bed, positive upwards [Pa], shape [n].
        normal_error: Relative weights of the normal stress, as standard errors up to a common factor, shape [n].
        shear_error: The same of the shear stress.
        specific_weight: rho_b g of the bulk [N/m^3].
        section: A/P [m].
    """

    depth: np.ndarray
    normal: np.ndarray
    shear: np.ndarray
    normal_error: np.ndarray
    shear_error: np.ndarray
    specific_weight: float
    section: float


@dataclass(frozen=True, eq=False)
class JanssenFit:
    """A model fitted to a profile.

    Attributes:
        model: One of MODELS.
        parameters: `length` l [m], `ratio` K and `layer`, which is the shift s of J2 or the hydrostatic layer a of J3
            [m].
        chi2: Sum of squares of the residuals.
        dof: Degrees of freedom.
        aicc: Akaike's criterion for few points.
        profile: The profile.
    """

    model: str
    parameters: Mapping[str, Parameter]
    chi2: float
    dof: int
    aicc: float
    profile: WallProfile

    @property
    def friction(self) -> float:
        """Mobilised friction of the saturated part, A/(P K l)."""
        values = self.parameters
        return self.profile.section / (values["ratio"].value * values["length"].value)

    def curves(self, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Normal and shear stress [Pa] at depths [m]."""
        third = self.parameters.get("layer")
        free = [self.parameters["length"].value, third.value if third else 0.0]
        vertical, slope = _vertical(self.model, depth, *free)
        weight = self.profile.specific_weight
        return self.parameters["ratio"].value * weight * vertical, self.profile.section * weight * (1 - slope)


def vertical_stress(model: str, depth: np.ndarray, length: float, layer: float = 0.0) -> np.ndarray:
    """sigma_zz/(rho g) [m] at depths x [m], by a model of MODELS; layer: s of J2, a of J3 [m]."""
    return _vertical(model, np.asarray(depth, float), length, layer)[0]


def _vertical(model: str, x: np.ndarray, length: float, layer: float) -> tuple[np.ndarray, np.ndarray]:
    """sigma_zz/(rho g) [m], and its derivative."""
    if model == "J3":
        below = np.maximum(x - layer, 0.0)
        stress = np.minimum(np.maximum(x, 0.0), layer) + length * -np.expm1(-below / length)
        return stress, np.where(x < layer, 1.0, np.exp(-below / length))
    shifted = np.maximum(x + (layer if model == "J2" else 0.0), 0.0)
    return length * -np.expm1(-shifted / length), np.exp(-shifted / length)


def fit_janssen(profile: WallProfile, confidence: float = 0.95) -> dict[str, JanssenFit]:
    """Fit the three models by weighted least squares.

    Intervals are Student's in ln l and ln K, with errors of the size that the residuals have.

    Returns:
        Fits by model; those that do not converge are left out.

    Raises:
        FitError: fewer than four bins, or an error that is not positive.
    """
    if len(profile.depth) < _FEWEST:
        raise FitError(f"Janssen: {len(profile.depth)} bins, fewer than {_FEWEST}; use a higher bed")
    if not (np.concatenate([profile.normal_error, profile.shear_error]) > 0).all():
        raise FitError("Janssen: the errors of the stresses are not positive")
    fits: dict[str, JanssenFit] = {}
    starts = _starts(profile)
    for model in MODELS:
        try:
            fits[model], best = _fit(model, profile, starts, confidence)
        except RuntimeError:
            continue
        if model == "J1":
            starts = [np.append(best, layer) for layer in (0.0, 0.1 * math.exp(best[0]), float(profile.depth[1]))]
    return fits


def preferred(fits: Mapping[str, JanssenFit]) -> tuple[str, ...]:
    """Models that no other beats by 4 in AICc; several names mean that the data do not decide."""
    return unbeaten({name: (entry.aicc,) for name, entry in fits.items()}) if fits else ()


def _fit(
    model: str, profile: WallProfile, starts: Sequence[np.ndarray], confidence: float
) -> tuple[JanssenFit, np.ndarray]:
    """Fit a model from some starts; also its free parameters. Raises RuntimeError if no start converges."""
    names = ("length", "ratio") if model == "J1" else ("length", "ratio", "layer")

    def residuals(free: np.ndarray) -> np.ndarray:
        length, ratio = np.exp(np.minimum(free[:2], 50.0))
        layer = 0.0 if model == "J1" else abs(free[2]) if model == "J3" else free[2]
        vertical, slope = _vertical(model, profile.depth, length, layer)
        normal = ratio * profile.specific_weight * vertical
        shear = profile.section * profile.specific_weight * (1 - slope)
        return np.concatenate(
            [(profile.normal - normal) / profile.normal_error, (profile.shear - shear) / profile.shear_error]
        )

    minimum = _lowest(residuals, [np.resize(start, len(names)) for start in starts])
    # the shear stress follows from the same parameters, so that a bin counts twice
    points, dof = 2 * len(profile.depth), 2 * len(profile.depth) - len(names)
    errors = np.sqrt(np.diag(minimum.covariance) * minimum.chi2 / dof)
    width = student(confidence, dof)
    parameters = {}
    for name, free, error in zip(names, minimum.best.tolist(), errors.tolist(), strict=True):
        low, high = free - width * error, free + width * error
        if name != "layer":
            unit, value = "m" if name == "length" else "", math.exp(free)
            parameters[name] = Parameter(value, _exp(low), _exp(high), value * error, unit)
        elif model == "J3":  # the sign of a does not count
            parameters[name] = Parameter(
                abs(free), max(abs(free) - width * error, 0.0), abs(free) + width * error, error, "m"
            )
        else:
            parameters[name] = Parameter(free, low, high, error, "m")
    criterion = aicc(minimum.chi2, points, len(names))
    return JanssenFit(model, parameters, minimum.chi2, dof, criterion, profile), minimum.best


def _exp(value: float) -> float:
    return math.exp(min(value, 700.0))


def _starts(profile: WallProfile) -> list[np.ndarray]:
    starts = []
    for part in _STARTS:
        length = part * 4 * profile.section
        vertical = profile.specific_weight * vertical_stress("J1", profile.depth, length)
        starts.append(np.array([math.log(length), math.log(max(float(profile.normal.sum() / vertical.sum()), 1e-3))]))
    return starts


def _lowest(residuals: Callable[[np.ndarray], np.ndarray], starts: Sequence[np.ndarray]) -> Minimum:
    """Find the lowest of the minima reached from the starts. Raises RuntimeError if there is none."""
    minima = []
    for start in starts:
        try:
            minima.append(minimise(residuals, start))
        except RuntimeError:
            continue
    if not minima:
        raise RuntimeError("no start converged")
    return min(minima, key=lambda minimum: minimum.chi2)
