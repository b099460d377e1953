"""The strategy behind `calibrate`: parameters of the contact law from measurements.

    calibrate:
      parameters: {contact.friction: {uniform: [0.1, 0.9]}, contact.rolling_friction: {loguniform: [0.001, 0.1]}}
      discrepancy: 3 %
      accuracy: {contact.friction: 5 %}

Runs start as a space-filling design over parameters and conditions. Each further round goes to the 99 % region of the
posterior so far, where runs lower the error of the emulators most; a fifth of it goes over the whole range. The
campaign ends once the emulators are good enough (`Inference.lacking`) and the errors are reached, or no emulator could
reach them.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar

import numpy as np

from labbook.campaign.goal import SCATTER, Goal, Step
from labbook.campaign.inference import ALLOWED_SHARE, REGION, Inference, Measurement, NotInferred
from labbook.campaign.space import Axis, one_bed_more, sobol
from labbook.campaign.strategy import Assignment, Proposal, Trial, point_key
from labbook.scene.model import Internal, Model
from labbook.scene.quantities import percent
from labbook.stats.emulator import best_settings, check_installed

BATCH = 32
"""Runs of a round, unless stated."""
LIMIT = 2000
"""Largest number of runs, unless `budget` is stated."""
_BEDS = 4
"""Beds of each point of the start; they give the scatter of runs, and the contribution that beds of one seed share."""
_ALL_OVER = 0.2
"""Part of the runs of a round that covers the whole range."""
_CANDIDATES = 800
"""Number of settings from which the runs of a round are chosen."""
_TESTING = 16
"""Number of held-out runs."""
_LARGEST_RESIDUAL = 1.46
"""Root mean square of 16 standardised residuals that is exceeded in 0.5 % of all cases."""


class Prior(Model):
    """A uniform prior of a parameter.

    Args:
        low: Smallest value [SI].
        high: Largest value [SI].
        logarithmic: The logarithm of the parameter is uniform.
    """

    low: float
    high: float
    logarithmic: bool = False


class Calibrate(Goal):
    """Goal: the parameters of the contact law with which the model gives the measured values.

    Args:
        parameters: Priors by key.
        measurements: Measured values.
        discrepancy: Relative standard deviation between the model and reality.
        accuracy: Half width of the 95 % interval of each parameter to reach, over its median.
        predict: Conditions to predict [SI]; measurements there are withheld from the calibration.
        batch: Runs of a round.
    """

    name: ClassVar[str] = "calibrate"
    version: ClassVar[int] = 2
    testing: ClassVar[int] = _TESTING
    beds: ClassVar[int] = _BEDS
    point_noun: ClassVar[str] = "parameter sets"

    parameters: Annotated[dict[str, Prior], Internal()]
    """Priors by key."""
    measurements: Annotated[tuple[Measurement, ...], Internal()]
    """Measured values."""
    discrepancy: Annotated[float, Internal()]
    """Relative standard deviation between the model and reality."""
    accuracy: Annotated[dict[str, float], Internal()]
    """Half width of the 95 % interval of each parameter to reach, over its median."""
    predict: Annotated[tuple[dict[str, float], ...], Internal()] = ()
    """Conditions to predict [SI]; measurements there are withheld from the calibration."""
    batch: Annotated[int, Internal()] = BATCH
    """Runs of a round."""

    @property
    def axes(self) -> tuple[Axis, ...]:
        """Axes of the parameters."""
        return tuple(Axis(key, entry.low, entry.high, entry.logarithmic) for key, entry in self.parameters.items())

    @property
    def conditions(self) -> list[dict[str, float]]:
        """Conditions of the runs, each once."""
        every = [*(entry.at for entry in self.measurements), *self.predict]
        return list({point_key(at): dict(at) for at in every}.values())

    def infer(self, study: Any, trials: Sequence[Trial], unmeasured: Sequence[str] = ()) -> Inference:
        """Compute the posterior from runs.

        Args:
            study: The study.
            trials: The runs.
            unmeasured: Names of quantities without a measurement that get an emulator too.

        Raises:
            NotInferred: Too few runs have a value.
            LearnMissing: scikit-learn is not installed.
        """
        scene = study.points[0].scene
        return Inference.of(self.axes, self.measurements, self.discrepancy, trials, scene, unmeasured, self.predict)

    def plan_rule(self, study: Any) -> str:
        """State the end of the campaign, and the expected number of runs."""
        errors = " and ".join(f"{key} to {percent(fraction)}" for key, fraction in self.accuracy.items())
        used = sum(not entry.withheld for entry in self.measurements)
        reached = " and these errors are reached, or cannot be" if errors else ""
        return (
            f"{', '.join(self.parameters)} from {used} measured values{f', {errors}' if errors else ''}. "
            f"{_BEDS * self._first} runs over the range, then rounds of {self.batch} until the emulator's variance is "
            f"at most a quarter of that of the measurements{reached}, then {_TESTING} held-out runs. "
            f"About {self._expected()} runs{self.limits(LIMIT)} (scatter of a run: "
            f"{percent(SCATTER)})"
        )

    def first(self, study: Any) -> list[dict[str, float]]:
        """Return a Sobol sequence over parameters and conditions. Raises LearnMissing, before anything runs."""
        check_installed()
        return self._settings(sobol(self._first, len(self.parameters) + 1))

    def step(self, study: Any, trials: Sequence[Trial]) -> Step:
        """Propose the next round, or held-out runs once the posterior is an answer.

        Args:
            study: The study.
            trials: All runs so far.

        Returns:
            Runs of the next round, or more beds of a likely point; held-out runs drawn from the posterior; or the end,
            without an emulator or a budget for more.
        """
        try:
            inference = self.infer(study, trials)
        except NotInferred as problem:
            if len(trials) > _BEDS * self._first + 2 * self.batch:
                return Step(Proposal.end(f"no emulator: {problem}"))
            points = self._settings(sobol(self.batch // _BEDS, len(self.parameters) + 1, skip=len(trials)))
            return Step(Proposal(tuple(Assignment(at, _BEDS) for at in points), f"{problem}: more over the range"))
        progress = f"{self._in_words(inference)} from {len(trials)} runs"
        lacking = inference.lacking()
        if not lacking and (self._reached(inference) or not self._reachable(inference)):
            return self._held_out(inference, trials, progress)
        if len(trials) + self.batch > LIMIT and not self.is_limited:
            reason = f"{LIMIT} runs are made without a stated budget, and the promise is not reached"
            return Step(Proposal.end(f"{reason}: {lacking or progress}"))
        share = f"emulator's variance {inference.share:.2g} of that of the measurements"
        if self._lacks_beds(inference):
            at, beds = self._anchor(inference, trials)
            reason = f"{progress}, {share}, most of it of the beds: {self.batch} beds more at a likely point"
            return Step(Proposal((Assignment(at, beds + self.batch),), reason))
        points = self._round(inference, trials)
        return Step(Proposal(one_bed_more(points, trials), f"{progress}, {share}: {len(points)} runs more"))

    def verdict(self, study: Any, trials: Sequence[Trial], withheld: Sequence[Trial]) -> str:
        """Compare held-out runs with the emulators."""
        inference = self.infer(study, trials)
        answer = f"{self._in_words(inference)} from {len(trials)} runs"
        if self.accuracy and not self._reached(inference):
            answer += "; the measurements do not allow the requested error"
        squares = self._residuals(inference, withheld) ** 2
        if len(squares) < 4:
            return f"{answer}. Promise not tested: {len(squares)} values of held-out runs"
        rms = math.sqrt(float(np.mean(squares)))
        word = "kept" if rms <= _LARGEST_RESIDUAL else "not kept"
        return (
            f"{answer}. Promise {word} (emulator): the residuals of {len(withheld)} held-out runs are {rms:.2f} "
            f"standard errors (root mean square), and at most {_LARGEST_RESIDUAL} is expected"
        )

    @property
    def _first(self) -> int:
        """Number of points of the start."""
        return max(self.batch // 2, 4 * (len(self.parameters) + 1))

    def _settings(self, points: np.ndarray) -> list[dict[str, float]]:
        """Map points of the unit cube to values of keys; the last coordinate chooses the condition."""
        conditions = self.conditions
        return [self._at(entry[:-1], conditions[int(entry[-1] * len(conditions))]) for entry in points]

    def _at(self, parameters: np.ndarray, condition: Mapping[str, float]) -> dict[str, float]:
        return {
            **condition,
            **{axis.key: axis.setting(float(u)) for axis, u in zip(self.axes, parameters, strict=True)},
        }

    def _round(self, inference: Inference, trials: Sequence[Trial]) -> list[dict[str, float]]:
        """Choose the runs of the next round."""
        spread_runs, conditions = round(_ALL_OVER * self.batch), self.conditions
        sets = self._region(inference, max(16, _CANDIDATES // len(conditions)), len(trials))
        candidates = [(entry, at) for entry in sets for at in conditions]
        covariances, noises, weights = [], [], []
        for quantity in dict.fromkeys(entry.quantity for entry in self.measurements):
            settings = np.array([
                [*entry, *(float(axis.unit(at[axis.key])) for axis in inference.conditions)] for entry, at in candidates
            ])  # fmt: skip
            covariances.append(inference.emulators[quantity].covariance(settings))
            noises.append(np.array([inference.observed[quantity].noise_at(at) for _, at in candidates]))
            # errors of the emulator count in units of the error of each measurement; conditions without one have no
            # weight
            weight = {
                point_key(entry.at): 1 / inference.variance(entry)
                for entry in self.measurements
                if entry.quantity == quantity and not entry.withheld
            }
            weights.append(np.array([weight.get(point_key(at), 0.0) for _, at in candidates]))
        picks = best_settings(covariances, noises, weights, self.batch - spread_runs)
        spread = self._settings(sobol(spread_runs, len(self.parameters) + 1, skip=len(trials)))
        return [*(self._at(*candidates[index]) for index in picks), *spread]

    def _lacks_beds(self, inference: Inference) -> bool:
        """True if beds that points share make most of the variance of the emulator that is worst.

        Only further beds lower that part. The other emulators wait for their turn: beds lower nothing else, and one
        that is good enough may have nearly all of its variance from beds.
        """
        quantity = max(inference.shares, key=lambda name: inference.shares[name])
        _, covariance = inference.joint(quantity, inference.draws(), self.conditions)
        mean = float(np.diagonal(covariance, axis1=1, axis2=2).mean())
        return inference.shares[quantity] > ALLOWED_SHARE and inference.observed[quantity].of_bed_means > 0.5 * mean

    def _anchor(self, inference: Inference, trials: Sequence[Trial]) -> tuple[dict[str, float], int]:
        """Find the point that gets further beds, and its number of beds.

        It is the likely point with most rounds of beds, since only seeds that no other point has are new beds: another
        point would need those of this one first. Of several it is the nearest to the mean of the posterior.
        """
        off, beds, likely = dict[tuple, float](), dict[tuple, int](), set[tuple]()
        for trial, inside in zip(trials, inference.likely, strict=True):
            if trial.outcome in ("clogged", "diverged"):
                continue
            where = point_key(trial.at)
            beds[where] = max(beds.get(where, 0), trial.seed)
            off[where] = sum(
                float(axis.unit(float(trial.at[axis.key])) - mean) ** 2
                for axis, mean in zip(self.axes, inference.posterior.mean, strict=True)
            )
            if inside:
                likely.add(where)
        anchor = min(likely or off, key=lambda at: (-(beds[at] // self.batch), off[at]))
        return {key: float(value) for key, value in anchor}, beds[anchor]

    def _region(self, inference: Inference, number: int, stream: int) -> np.ndarray:
        """Select parameter sets that fill the region of the posterior, shape [number, p]."""
        posterior = inference.posterior
        inside = posterior.parameter_sets[posterior.region(REGION)]
        # seeded by the number of runs: a resumed campaign proposes the same
        rng = np.random.default_rng([stream, 7])
        sets = inside[np.linspace(0, len(inside) - 1, number).round().astype(int)]
        # anywhere within their cells of the grid: else every round would choose from the same settings
        return np.clip(sets + posterior.cell * rng.uniform(-0.5, 0.5, sets.shape), 0, 1)

    def _held_out(self, inference: Inference, trials: Sequence[Trial], progress: str) -> Step:
        sets = inference.draws()[:: len(inference.draws()) // _TESTING][:_TESTING]
        conditions = self.conditions
        tried = {point_key(trial.at) for trial in trials}
        points = [self._at(entry, conditions[index % len(conditions)]) for index, entry in enumerate(sets)]
        new = {point_key(at): Assignment(at, 1) for at in points if point_key(at) not in tried}
        return Step(
            Proposal(tuple(new.values()), f"{progress}; {len(new)} runs are held out to test the emulator"), True
        )

    def _residuals(self, inference: Inference, withheld: Sequence[Trial]) -> np.ndarray:
        """Residuals of runs about the emulators, over their standard errors."""
        residuals = []
        for quantity in dict.fromkeys(entry.quantity for entry in self.measurements):
            observed = inference.observed[quantity]
            for trial in withheld:
                value = trial.numbers.get(quantity, math.nan)
                if trial.outcome == "clogged" or not value > 0:
                    continue
                where = np.array([[float(axis.unit(float(trial.at[axis.key]))) for axis in inference.parameters]])
                at = {axis.key: float(trial.at[axis.key]) for axis in inference.conditions}
                mean, covariance = inference.joint(quantity, where, [at])
                off = math.log(value) - inference.trends[quantity].at(trial.at) - mean[0, 0]
                noise = observed.noise_at(trial.at) + observed.of_beds
                residuals.append(off / math.sqrt(covariance[0, 0, 0] + noise))
        return np.array(residuals)

    def _reached(self, inference: Inference) -> bool:
        intervals = inference.intervals()
        return all(intervals[key].relative <= fraction for key, fraction in self.accuracy.items())

    def _reachable(self, inference: Inference) -> bool:
        """True if emulators without error would reach the stated errors."""
        best = inference.intervals(inference.exact)
        return all(best[key].relative <= fraction for key, fraction in self.accuracy.items())

    def _in_words(self, inference: Inference) -> str:
        return ", ".join(
            f"{key} = {entry.median:.4g} (95 %: {entry.low:.4g} to {entry.high:.4g})"
            for key, entry in inference.intervals().items()
        )

    def _expected(self) -> int:
        """Expected number of runs, for a response of second order.

        Each coefficient of an emulator needs so many runs that the emulator's variance is a quarter of that of the
        measurements.
        """
        d = len(self.parameters) + (len(self.conditions) > 1)
        coefficients = (d + 1) * (d + 2) // 2
        flows = [entry for entry in self.measurements if entry.quantity == "flow_rate"] or self.measurements
        variance = min((entry.error / entry.value) ** 2 + self.discrepancy**2 for entry in flows)
        needed = math.ceil(4 * coefficients * SCATTER**2 / variance)
        rounds = max(0, math.ceil((needed - _BEDS * self._first) / self.batch))
        return _BEDS * self._first + rounds * self.batch + _TESTING
