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
from labbook.stats.choice import aicc, best_laws
from labbook.stats.pooling import student

MODELS = ("J1", "J2", "J3")
_STARTS = (0.4, 1.5)
"""Screening lengths from which fits begin, in hydraulic diameters 4 A/P."""
_FEWEST = 4
"""Bins below which nothing is fitted."""


@dataclass(frozen=True, eq=False)
class WallProfile:
    """Stresses of upright walls by depth.

    Attributes:
        depth: Of the middle of each bin below the effective free surface [m], shape [n].
        normal: Normal stress [Pa].
        shear: Shear stress of the wall on the bed, positive upwards [Pa].
        normal_error: Standard error, of which the size is left free.
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
class BulkProfile:
    """Mean vertical stress in a bed by depth.

    Attributes:
        depth: Below the effective free surface [m], shape [n].
        vertical: Vertical stress [Pa].
        error: Standard error, of which the size is left free.
        specific_weight: rho_b g of the bulk [N/m^3].
    """

    depth: np.ndarray
    vertical: np.ndarray
    error: np.ndarray
    specific_weight: float


@dataclass(frozen=True, eq=False)
class ModelFit:
    """A model fitted to a profile.

    Attributes:
        model: Name in MODELS.
        parameters: `length` l [m]; of walls also `ratio` K; of J2 and J3 also `layer`, the shift s or the thickness a
            of the hydrostatic layer [m].
        chi2: Sum of squares of the residuals over their errors.
        dof: Degrees of freedom.
        aicc: Akaike's criterion, corrected for small samples.
    """

    model: str
    parameters: Mapping[str, Parameter]
    chi2: float
    dof: int
    aicc: float

    def _over_weight(self, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """sigma_zz/(rho g) [m] at depths [m], and its derivative."""
        layer = self.parameters.get("layer")
        return _vertical(self.model, depth, self.parameters["length"].value, layer.value if layer else 0.0)


@dataclass(frozen=True, eq=False)
class BulkFit(ModelFit):
    """A model fitted to the vertical stress in the bed.

    Attributes:
        profile: The fitted profile.
    """

    profile: BulkProfile

    def curve(self, depth: np.ndarray) -> np.ndarray:
        """Vertical stress of the model.

        Args:
            depth: Depths below the surface [m], shape [n].

        Returns:
            Stress [Pa], shape [n].
        """
        return self.profile.specific_weight * self._over_weight(depth)[0]


@dataclass(frozen=True, eq=False)
class JanssenFit(ModelFit):
    """A model fitted to the normal and shear stress of walls.

    Attributes:
        profile: The fitted profile.
    """

    profile: WallProfile

    @property
    def friction(self) -> float:
        """Mobilised friction of the saturated part, A/(P K l)."""
        values = self.parameters
        return self.profile.section / (values["ratio"].value * values["length"].value)

    def curves(self, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Stresses on the walls by the model.

        Args:
            depth: Depths below the surface [m], shape [n].

        Returns:
            Normal stress and shear stress [Pa], each of shape [n].
        """
        vertical, slope = self._over_weight(depth)
        weight = self.profile.specific_weight
        return self.parameters["ratio"].value * weight * vertical, self.profile.section * weight * (1 - slope)


def vertical_stress(model: str, depth: np.ndarray, length: float, layer: float = 0.0) -> np.ndarray:
    """Vertical stress over specific weight, sigma_zz/(rho g), by a model of MODELS.

    Args:
        model: Name of the model.
        depth: Depths x below the surface [m], shape [n].
        length: Length l [m].
        layer: Shift s of J2, or thickness a of J3 [m].

    Returns:
        sigma_zz/(rho g) [m], shape [n].
    """
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
    """Fit the three models by weighted least squares to the stresses of walls.

    Intervals are Student's in ln l and ln K, with errors of the size that the residuals have.

    Args:
        profile: Stresses of the walls by depth.
        confidence: Confidence of the intervals.

    Returns:
        Fits by model; those that do not converge are left out.

    Raises:
        FitError: fewer than four bins, or an error that is not positive.
    """
    _check(profile.depth, profile.normal_error, profile.shear_error)

    def residuals(vertical: np.ndarray, slope: np.ndarray, ratio: float) -> np.ndarray:
        normal = ratio * profile.specific_weight * vertical
        shear = profile.section * profile.specific_weight * (1 - slope)
        return np.concatenate(
            [(profile.normal - normal) / profile.normal_error, (profile.shear - shear) / profile.shear_error]
        )

    fits = _fits(residuals, profile.depth, ("length", "ratio"), _starts(profile), confidence)
    return {fit.model: JanssenFit(**vars(fit), profile=profile) for fit in fits}


def fit_bulk(profile: BulkProfile, confidence: float = 0.95) -> dict[str, BulkFit]:
    """Fit the three models to the vertical stress in a bed, as `fit_janssen` does; K is no parameter.

    Args:
        profile: Stresses in the bed by depth.
        confidence: Confidence of the intervals.

    Returns:
        Fits by model; those that do not converge are left out.

    Raises:
        FitError: fewer than four heights, or an error that is not positive.
    """
    _check(profile.depth, profile.error)

    def residuals(vertical: np.ndarray, _slope: np.ndarray, _ratio: float) -> np.ndarray:
        return (profile.vertical - profile.specific_weight * vertical) / profile.error

    largest = float(profile.vertical.max()) / profile.specific_weight
    starts = [np.array([math.log(fraction * largest)]) for fraction in (1.0, 3.0)]
    fits = _fits(residuals, profile.depth, ("length",), starts, confidence)
    return {fit.model: BulkFit(**vars(fit), profile=profile) for fit in fits}


def _check(depth: np.ndarray, *errors: np.ndarray) -> None:
    if len(depth) < _FEWEST:
        raise FitError(f"Janssen: {len(depth)} bins, fewer than {_FEWEST}; use a higher bed")
    if not (np.concatenate(errors) > 0).all():
        raise FitError("Janssen: the errors of the stresses are not positive")


def preferred(fits: Mapping[str, ModelFit]) -> tuple[str, ...]:
    """Models that no other beats by 4 in AICc.

    Args:
        fits: Fits by model, to the same profile.

    Returns:
        Their names; several mean that the data do not decide.
    """
    return best_laws({name: (entry.aicc,) for name, entry in fits.items()}) if fits else ()


def _fits(
    residuals: Callable[[np.ndarray, np.ndarray, float], np.ndarray], depth: np.ndarray, shared: tuple[str, ...],
    starts: Sequence[np.ndarray], confidence: float,
) -> list[ModelFit]:  # fmt: skip
    """Fit each of MODELS that converges.

    Args:
        residuals: Of sigma_zz/(rho g) [m] at the depths, its derivative, and K.
        depth: Depths [m].
        shared: Names of the parameters that all models have: `length`, or `length` and `ratio`.
        starts: Logarithms of these, from which the fit of J1 begins.
        confidence: Of the intervals.
    """
    fits: list[ModelFit] = []
    for model in MODELS:

        def misfit(free: np.ndarray, model: str = model) -> np.ndarray:
            values = np.exp(np.minimum(free[: len(shared)], 50.0))
            layer = 0.0 if model == "J1" else abs(free[-1]) if model == "J3" else free[-1]
            return residuals(*_vertical(model, depth, values[0], layer), values[-1])

        names = shared if model == "J1" else (*shared, "layer")
        try:
            minimum = _lowest(misfit, [np.resize(start, len(names)) for start in starts])
        except RuntimeError:
            continue
        fits.append(_model_fit(model, names, minimum, len(misfit(minimum.best)), confidence))
        if model == "J1":
            best = minimum.best
            starts = [np.append(best, layer) for layer in (0.0, 0.1 * math.exp(best[0]), float(depth[1]))]
    return fits


def _model_fit(model: str, names: tuple[str, ...], minimum: Minimum, points: int, confidence: float) -> ModelFit:
    dof = points - len(names)
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
    return ModelFit(model, parameters, minimum.chi2, dof, aicc(minimum.chi2, points, len(names)))


def _exp(value: float) -> float:
    return math.exp(min(value, 700.0))


def _starts(profile: WallProfile) -> list[np.ndarray]:
    starts = []
    for fraction in _STARTS:
        length = fraction * 4 * profile.section
        vertical = profile.specific_weight * vertical_stress("J1", profile.depth, length)
        starts.append(np.array([math.log(length), math.log(max(float(profile.normal.sum() / vertical.sum()), 1e-3))]))
    return starts


def _lowest(residuals: Callable[[np.ndarray], np.ndarray], starts: Sequence[np.ndarray]) -> Minimum:
    """The lowest of the minima that are reached from the starts. Raises RuntimeError if there is none."""
    minima = []
    for start in starts:
        try:
            minima.append(minimise(residuals, start))
        except RuntimeError:
            continue
    if not minima:
        raise RuntimeError("no start converged")
    return min(minima, key=lambda minimum: minimum.chi2)
