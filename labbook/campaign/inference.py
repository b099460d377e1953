"""Inference of parameters from measurements: emulators of all measured quantities, and the posterior.

Each quantity has an emulator over parameters and conditions (`labbook.stats.emulator`). The likelihood of a parameter
set is normal in the logarithms of the measured values. Its covariance is the sum of those of the measurements, of the
discrepancy of the model, and of the emulator across all conditions of this set (Kennedy & O'Hagan, J. R. Stat. Soc. B
63 (2001) 425).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from labbook.campaign.space import FEWEST_REPEATS, Axis, BedValues, SpaceTrend, sobol
from labbook.campaign.strategy import Trial
from labbook.fit.interpolation import CLOGGED
from labbook.scene.model import Model
from labbook.stats.emulator import Emulator
from labbook.stats.posterior import Posterior, posterior

ALLOWED_SHARE = 0.25
"""Largest variance of an emulator in an answer, over that of each measured value (with the discrepancy)."""
REGION = 0.99
"""Part of the posterior within the region that further runs fill."""
_DRAWS = 2048
"""Number of parameter sets for expectations over the posterior."""
_INTERVAL = np.array([0.025, 0.5, 0.975])


class NotInferred(ValueError):
    """The runs so far give no posterior; the message names the lack."""


class Measurement(Model):
    """A measured value.

    Args:
        quantity: Name of the quantity.
        at: Conditions [SI].
        value: The value [SI].
        error: Its standard error [SI].
        withheld: It does not enter the calibration but tests it.
    """

    quantity: str
    at: dict[str, float]
    value: float
    error: float
    withheld: bool = False


@dataclass(frozen=True)
class Interval:
    """Median and 95 % interval.

    Args:
        low: Lower end [SI].
        median: Median [SI].
        high: Upper end [SI].
    """

    low: float
    median: float
    high: float

    @property
    def relative(self) -> float:
        """Half width of the interval over the median."""
        return (self.high - self.low) / 2 / abs(self.median)


@dataclass(frozen=True)
class Prediction:
    """Predicted quantity at conditions outside the calibration.

    Args:
        quantity: Name of the quantity.
        at: Conditions [SI].
        interval: Median and 95 % interval by the posterior [SI].
        measured: Measured value [SI]; None without one.
        error: Its standard error [SI].
    """

    quantity: str
    at: Mapping[str, float]
    interval: Interval
    measured: float | None
    error: float | None

    @property
    def agrees(self) -> bool | None:
        """True if the measured value lies within the interval, which includes its error; None without one."""
        return None if self.measured is None else self.interval.low <= self.measured <= self.interval.high


@dataclass(frozen=True)
class Experiment:
    """A possible next measurement.

    Args:
        quantity: Name of the quantity.
        at: Conditions [SI].
        error: Relative standard error of the measurement.
        gain: Factor by which it would lower the volume of the posterior (root of the determinant of its covariance).
    """

    quantity: str
    at: Mapping[str, float]
    error: float
    gain: float


@dataclass(frozen=True)
class Direction:
    """Direction of the parameter space with its remaining uncertainty.

    Args:
        components: Change of each parameter [of its prior range], a vector of length 1.
        remaining: Standard deviation of the posterior along it, over that of the prior.
    """

    components: Mapping[str, float]
    remaining: float


@dataclass(frozen=True, eq=False)
class Inference:
    """Posterior of parameters.

    Attributes:
        parameters: Axes of the parameters.
        conditions: Axes of the conditions that differ between measurements.
        measurements: All measurements.
        discrepancy: Relative standard deviation between the model and reality.
        emulators: Emulator of each quantity of the runs, by name.
        observed: Values to which they are fitted, by name.
        trends: Known trend of each quantity, by name.
        trials: The runs.
    """

    parameters: tuple[Axis, ...]
    conditions: tuple[Axis, ...]
    measurements: tuple[Measurement, ...]
    discrepancy: float
    emulators: Mapping[str, Emulator]
    observed: Mapping[str, BedValues]
    trends: Mapping[str, SpaceTrend]
    trials: tuple[Trial, ...]

    @classmethod
    def of(
        cls,
        parameters: Sequence[Axis],
        measurements: Sequence[Measurement],
        discrepancy: float,
        trials: Sequence[Trial],
        scene: object,
        unmeasured: Sequence[str] = (),
        further: Sequence[Mapping[str, float]] = (),
    ) -> "Inference":
        """Fit the emulators.

        Args:
            parameters: Axes of the parameters.
            measurements: Measured values.
            discrepancy: Relative standard deviation between the model and reality.
            trials: Runs.
            scene: Any scene of the study.
            unmeasured: Names of quantities without a measurement that get an emulator too.
            further: Conditions to predict, without a measured value.

        Raises:
            NotInferred: Too few runs have a value.
            LearnMissing: scikit-learn is not installed.
        """
        conditions = axes_of([*(entry.at for entry in measurements), *further])
        axes = (*parameters, *conditions)
        emulators, observations, trends = dict[str, Emulator](), dict[str, BedValues](), dict[str, SpaceTrend]()
        used = dict.fromkeys(entry.quantity for entry in measurements)
        for quantity in dict.fromkeys((*used, *unmeasured)):
            trend = SpaceTrend.of(quantity, axes, scene)
            observed = BedValues.of(trials, quantity, axes, trend, [axis.key for axis in conditions])
            if observed.repeats < FEWEST_REPEATS or observed.points < 2 * len(axes):
                if quantity not in used:
                    continue
                runs = f"{len(observed.values)} of {len(trials)} runs"
                raise NotInferred(f"{quantity} has a value in {runs}, too few for an emulator")
            emulators[quantity], observations[quantity] = observed.emulator(), observed
            trends[quantity] = trend
        return cls(tuple(parameters), conditions, tuple(measurements), discrepancy, emulators, observations, trends,
                   tuple(trials))  # fmt: skip

    @cached_property
    def posterior(self) -> Posterior:
        """Posterior of the parameters, scaled from 0 to 1."""
        return posterior(self.log_likelihood, len(self.parameters))

    @cached_property
    def exact(self) -> Posterior:
        """Posterior if these emulators had no error: further runs lead to one as narrow."""
        return posterior(lambda places: self._log_likelihood(places, False), len(self.parameters))

    def log_likelihood(self, parameter_sets: np.ndarray) -> np.ndarray:
        """Compute ln of the likelihood at k parameter sets, shape [k, p]: shape [k]."""
        return self._log_likelihood(parameter_sets, True)

    def _log_likelihood(self, parameter_sets: np.ndarray, emulated: bool) -> np.ndarray:
        total = np.zeros(len(parameter_sets))
        for quantity, group in self._groups.items():
            # errors of the emulator at one parameter set are correlated across conditions: they do not average out
            mean, covariance = self.joint(quantity, parameter_sets, [entry.at for entry in group])
            of_data = np.diag([self.variance(entry) for entry in group])
            total += _log_normal(self._targets(group) - mean, covariance * emulated + of_data)
        return total

    def variance(self, entry: Measurement) -> float:
        """Variance of the logarithm of a measured value about that of the model."""
        return (entry.error / entry.value) ** 2 + self.discrepancy**2

    def joint(
        self, quantity: str, parameter_sets: np.ndarray, at: Sequence[Mapping[str, float]]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Emulate the logarithm of a quantity, up to its trend, at k parameter sets and m conditions.

        Returns:
            Means, shape [k, m], and covariances within each set, shape [k, m, m].
        """
        k, m, p = len(parameter_sets), len(at), len(self.parameters)
        settings = np.empty((k, m, p + len(self.conditions)))
        settings[:, :, :p] = parameter_sets[:, None, :]
        for index, axis in enumerate(self.conditions):
            settings[:, :, p + index] = [float(axis.unit(entry[axis.key])) for entry in at]
        return self.emulators[quantity].joint(settings)

    @cached_property
    def shares(self) -> dict[str, float]:
        """Ratios of the emulators' variances to those of measured values (with the discrepancy), by quantity.

        Each is the mean over the posterior, for the measurement at which it is largest.
        """
        draws, shares = self.draws(), dict[str, float]()
        for quantity, group in self._groups.items():
            _, covariance = self.joint(quantity, draws, [entry.at for entry in group])
            of_emulator = np.diagonal(covariance, axis1=1, axis2=2).mean(axis=0)
            shares[quantity] = max(v / self.variance(entry) for v, entry in zip(of_emulator, group, strict=True))
        return shares

    @property
    def share(self) -> float:
        """Largest of the ratios of the emulators' variances to those of measured values."""
        return max(self.shares.values())

    def draws(self, number: int = _DRAWS) -> np.ndarray:
        """Draw parameter sets of the posterior, the same ones at each call: shape [number, p]."""
        return self.posterior.samples(number, np.random.default_rng(0))

    def intervals(self, of: Posterior | None = None) -> dict[str, Interval]:
        """Compute median and interval of each parameter [SI]."""
        low, median, high = (of or self.posterior).quantiles(_INTERVAL)
        return {
            axis.key: Interval(*(float(axis.value(end[index])) for end in (low, median, high)))
            for index, axis in enumerate(self.parameters)
        }

    @cached_property
    def ridge(self) -> Direction:
        """Direction of the least informed combination of parameters: largest variance of the posterior."""
        # 1/12 is the variance of the uniform prior: eigenvalues are variances over that of the prior
        values, vectors = np.linalg.eigh(12 * self.posterior.covariance)
        vector = vectors[:, -1] * (1 if vectors[np.argmax(abs(vectors[:, -1])), -1] > 0 else -1)
        components = {axis.key: float(component) for axis, component in zip(self.parameters, vector, strict=True)}
        return Direction(components, min(1.0, float(math.sqrt(values[-1]))))

    def sobol_indices(self) -> dict[tuple[str, int], dict[str, tuple[float, float]]]:
        """Compute the parts of the variance over the prior that each parameter explains.

        Returns:
            For each measurement, by quantity and index among those of the quantity: by parameter, the first-order index
            and the total one (Sobol', Math. Comput. Simul. 55 (2001) 271), of the emulator's mean.
        """
        from scipy.stats import sobol_indices

        if len(self.parameters) == 1:
            (axis,) = self.parameters
            return {(name, k): {axis.key: (1.0, 1.0)} for name, of in self._groups.items() for k in range(len(of))}
        n, p = 1024, len(self.parameters)
        points = sobol(n, 2 * p, stream=3)
        A, B = points[:, :p], points[:, p:]
        mixed = [np.where(np.arange(p) == index, B, A) for index in range(p)]
        indices = {}
        for quantity, group in self._groups.items():
            at = [entry.at for entry in group]
            a, b, *ab = (self.joint(quantity, X, at)[0].T for X in (A, B, *mixed))
            result = sobol_indices(func={"f_A": a, "f_B": b, "f_AB": np.array(ab)}, n=n)
            first, total = (np.atleast_2d(index) for index in (result.first_order, result.total_order))
            for number in range(len(group)):
                indices[quantity, number] = {
                    axis.key: (float(first[number, k]), float(total[number, k]))
                    for k, axis in enumerate(self.parameters)
                }
        return indices

    def predictions(self, further: Sequence[tuple[str, Mapping[str, float]]] = ()) -> list[Prediction]:
        """Predict the withheld measurements, and quantities at further conditions."""
        requests = [(entry.quantity, entry.at, entry) for entry in self.measurements if entry.withheld]
        requests += [(quantity, at, None) for quantity, at in further if not any(at == had for _, had, _ in requests)]
        return [self._prediction(*entry) for entry in requests]

    def _prediction(self, quantity: str, at: Mapping[str, float], entry: Measurement | None) -> Prediction:
        draws = self.draws()
        mean, covariance = self.joint(quantity, draws, [at])
        variance = covariance[:, 0, 0] + (self.discrepancy**2 if entry is None else self.variance(entry))
        # not the stream of `draws`: noise and parameters have to be independent
        logs = mean[:, 0] + np.sqrt(variance) * np.random.default_rng(1).normal(size=len(draws))
        ends = np.exp(np.quantile(logs, _INTERVAL) + self.trends[quantity].at(at))
        return Prediction(quantity, at, Interval(*map(float, ends)), entry and entry.value, entry and entry.error)

    def experiments(self) -> list[Experiment]:
        """Compare possible next measurements, the best one first.

        They are each quantity of the runs at each condition of the measurements, with the smallest relative error of
        these.
        """
        draws = self.draws()
        off = draws - draws.mean(axis=0)
        covariance = off.T @ off / len(draws)
        error = min(entry.error / entry.value for entry in self.measurements)
        conditions = {tuple(entry.at.items()): entry.at for entry in self.measurements}
        experiments = []
        for quantity in self.emulators:
            mean, spread = self.joint(quantity, draws, list(conditions.values()))
            for index, at in enumerate(conditions.values()):
                response = mean[:, index] - mean[:, index].mean()
                cross = off.T @ response / len(draws)
                noise = error**2 + self.discrepancy**2 + float(spread[:, index, index].mean())
                variance = float(response @ response) / len(draws) + noise
                # with a response linear in the parameters, the determinant of their covariance falls by 1 - explained
                explained = float(cross @ np.linalg.solve(covariance, cross)) / variance
                experiments.append(Experiment(quantity, at, error, 1 / math.sqrt(max(1 - explained, 1e-9))))
        return sorted(experiments, key=lambda entry: -entry.gain)

    @cached_property
    def likely(self) -> np.ndarray:
        """True for each run whose parameter set lies within the region of the posterior, shape [runs]."""
        edge = math.log(max(self.posterior.threshold(REGION), 1e-300))
        parameter_sets = np.array([self._unit_position(trial) for trial in self.trials])
        return self.log_likelihood(parameter_sets) - self._largest >= edge

    def clogged(self) -> tuple[int, int]:
        """Count clogged runs, and all runs, at parameter sets within the region of the posterior."""
        stops = [trial.outcome == "clogged" for trial in self.trials]
        return int(np.sum(self.likely & np.array(stops))), int(self.likely.sum())

    def lacking(self) -> str:
        """Give the reason why the posterior is no answer yet; empty if it is one."""
        clogged, runs = self.clogged()
        if clogged > CLOGGED * runs:
            return (
                f"{clogged} of {runs} runs with likely parameters clogged, so the others are a biased sample: "
                "measure at wider outlets"
            )
        if self.share > ALLOWED_SHARE:
            return (
                f"the emulator's variance is {self.share:.2f} of that of the measurements, and {ALLOWED_SHARE} is "
                f"allowed: about {math.ceil(len(self.trials) * (self.share / ALLOWED_SHARE - 1))} more runs are needed"
            )
        return ""

    def _unit_position(self, trial: Trial) -> np.ndarray:
        return np.array([float(axis.unit(float(trial.at[axis.key]))) for axis in self.parameters])

    @cached_property
    def _largest(self) -> float:
        return float(self.log_likelihood(self.posterior.parameter_sets[[int(np.argmax(self.posterior.density))]])[0])

    @cached_property
    def _groups(self) -> dict[str, list[Measurement]]:
        groups: dict[str, list[Measurement]] = {}
        for entry in self.measurements:
            if not entry.withheld:
                groups.setdefault(entry.quantity, []).append(entry)
        return groups

    def _targets(self, group: Sequence[Measurement]) -> np.ndarray:
        return np.array([math.log(entry.value) - self.trends[entry.quantity].at(entry.at) for entry in group])


def axes_of(conditions: Sequence[Mapping[str, float]]) -> tuple[Axis, ...]:
    """Build the axes of keys that have several values."""
    values: dict[str, set[float]] = {}
    for at in conditions:
        for key, value in at.items():
            values.setdefault(key, set()).add(value)
    return tuple(Axis(key, min(of), max(of)) for key, of in values.items() if len(of) > 1)


def _log_normal(off: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Logarithm of normal densities, up to a constant, at k deviations of shape [k, m]; shape [k]."""
    root = np.linalg.cholesky(covariance)
    left = np.linalg.solve(root, off[..., None])[..., 0]
    return -0.5 * (left**2).sum(axis=1) - np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
