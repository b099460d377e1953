"""Goal `transition`: the value of the swept key at which flows stop before N grains with a stated probability.

    adapt:
      transition: {container.orifice: {clogging: 50 %, grains: 1000, within: 0.1 d}}

The probability q of a stop per grain falls with the width of the outlet: ln q is modelled as a concave parabola in the
key, and P(stop before N grains) = 1 - (1 - q)^N. Stops are a Poisson number of mean q G among the G grains of all runs
at a setting. Position, slope and bend have a posterior on a grid. New beds are placed at the quartiles of the position:
a sequential Bayesian design of quantal response (Chaloner & Larntz, J. Stat. Plan. Inference 21 (1989) 191).
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import model_validator

from labbook.campaign.goal import HELD_OUT, Goal, Step, held_out, of_one_key, only_swept, spread
from labbook.campaign.stops import COUNT
from labbook.campaign.strategy import EXPOSURE, Assignment, Proposal, Trial, Values
from labbook.measure.clogging import NAME, PROBABILITY
from labbook.scene.model import Fault, Internal, refuse
from labbook.scene.quantities import parse, percent
from labbook.stats.rates import rate

_SETTINGS = 4
"""Number of settings of the start."""
_BATCH = 6
"""Number of beds of a generation after the start."""
_POSITIONS = 161
_SLOPES = np.geomspace(0.5, 60, 20)
"""Falls of ln q over the range of the sweep with equal prior probability."""
_BENDS = np.array([1e-6, 2.0, 5.0, 12.0, 30.0])
"""Additional falls of ln q at the end of a range from the transition on, with equal prior probability: ln q is concave
if flows cease to stop at a critical width."""


@dataclass(frozen=True)
class Position:
    """Position of the transition by its posterior.

    Args:
        lower: Lower quartile [SI].
        median: Median [SI].
        upper: Upper quartile [SI].
        low: Lower end of the 95 % interval [SI].
        high: Upper end of the 95 % interval [SI].
    """

    lower: float
    median: float
    upper: float
    low: float
    high: float

    @property
    def half(self) -> float:
        """Half width of the interval."""
        return (self.high - self.low) / 2


class Transition(Goal):
    """Goal: the value of the swept key at which flows stop before N grains with a stated probability.

    The module docstring has the model, its posterior and the source of the design (Chaloner & Larntz 1989).

    Args:
        key: The swept key.
        clogging: Probability of a stop before N grains.
        grains: Number of grains N.
        within: Half width of the 95 % interval of the setting to reach, with its unit.
    """

    name: ClassVar[str] = "transition"
    point_noun: ClassVar[str] = "settings"

    key: Annotated[str, Internal()]
    """The swept key."""
    clogging: Annotated[float, Internal()]
    """Probability of a stop."""
    grains: Annotated[int, Internal()]
    """Number of grains N before which flows stop."""
    within: Annotated[str, Internal()]
    """Half width of the 95 % interval of the setting to reach, with its unit."""

    @model_validator(mode="before")
    @classmethod
    def _of_mapping(cls, mapping: Any) -> Any:
        """Convert {key: {clogging: part, grains: number, within: width}} to fields."""
        if isinstance(mapping, Mapping) and mapping.keys() >= {"key", "clogging", "grains", "within"}:
            return mapping
        if not (isinstance(mapping, Mapping) and len(mapping) == 1):
            refuse([Fault("", "one swept key is needed", _EXAMPLE)])
        ((key, wish),) = mapping.items()
        if not isinstance(wish, Mapping):
            refuse([Fault(str(key), "a mapping of keys is needed", _EXAMPLE)])
        if wish.keys() != {"clogging", "grains", "within"}:
            refuse([Fault(key, "clogging, grains and within are needed, and nothing else", _EXAMPLE)])
        try:
            fraction = parse(wish["clogging"], "") if isinstance(wish["clogging"], str) else float(wish["clogging"])
            grains = int(float(wish["grains"]))
        except (ValueError, TypeError) as error:
            refuse([Fault(key, str(error), _EXAMPLE)])
            raise
        if not 0 < fraction < 1 or grains < 1:
            refuse([Fault(key, "a probability between 0 and 1, and a number of grains above 0, are needed", _EXAMPLE)])
        return {"key": key, "clogging": fraction, "grains": grains, "within": str(wish["within"])}

    def range_faults(self, points: Sequence[Any]) -> list[Fault]:
        """List faults of the range of a study."""
        return of_one_key("transition", self.key, points)

    def needs(self) -> tuple[str, Sequence[str]]:
        """Name the measure of stops."""
        return "stops are", (NAME,)

    def further_faults(self, measures: Sequence[str], points: Sequence[Any]) -> Iterator[Fault]:
        """Yield a fault for a width that is no part of the range."""
        try:
            width = self._width(points)
        except ValueError as error:
            yield Fault(f"transition.{self.key}.within", f"{self.within}: {error}", _EXAMPLE)
            return
        swept = only_swept(points)
        assert swept is not None
        if not 0 < width < swept.values[-1] - swept.values[0]:
            yield Fault(f"transition.{self.key}.within", "a part of the range of the sweep is needed", _EXAMPLE)

    def plan_rule(self, study: Any) -> str:
        """State the end of the search."""
        return (
            f"{self.key} at which {percent(self.clogging)} of the flows stop before {self.grains} grains, to "
            f"±{self.within}. {_SETTINGS * self.beds} beds over the range, then {_BATCH} at a time at the quartiles of "
            f"its position until the 95 % interval is so narrow, then {HELD_OUT} held-out beds{self.limits()}"
        )

    def first(self, study: Any) -> list[Values]:
        """Return a few settings over the range."""
        swept = only_swept(study.points)
        assert swept is not None
        return [{self.key: x} for x in spread(swept, _SETTINGS)]

    def step(self, study: Any, trials: Sequence[Trial]) -> Step:
        """Propose beds at the quartiles of the position, or held-out beds once it is known well enough.

        Args:
            study: The study, whose sweep is the range.
            trials: All runs so far, with their stops and the grains that count.

        Returns:
            Beds at three settings; held-out beds at one; or the end, if no grain counts or no more beds are allowed.
        """
        counts = self._counts(trials)
        if not sum(exposure for _, exposure in counts.values()):
            return Step(Proposal.end("no grain counts beyond the transients: use more grains, or wider outlets"))
        position, width = self._position(study, counts), self._width(study.points)
        progress = f"{self._setting(study, position.median)} (95 %: {self._setting(study, position.low)} to "
        progress += f"{self._setting(study, position.high)}) from {len(trials)} beds"
        beds = {x: len([trial for trial in trials if trial.at[self.key] == x]) for x in counts}
        if position.half <= width:
            nearest = min(counts, key=lambda x: (abs(x - position.median) > width, -beds[x]))
            return held_out({self.key: nearest}, trials, progress)
        if max(beds.values()) >= study.accuracy.max_replicates:
            reason = "accuracy.max_replicates allows no more beds, and the promise is not reached"
            return Step(Proposal.end(f"{reason}: {progress}"))
        proposed: dict[float, int] = {}
        for x in (position.lower, position.median, position.upper):
            setting = self._on_grid(study, x)
            proposed[setting] = proposed.get(setting, beds.get(setting, 0)) + _BATCH // 3
        assignments = tuple(Assignment({self.key: x}, number) for x, number in sorted(proposed.items()))
        return Step(Proposal(assignments, f"{progress}: {_BATCH} beds at its quartiles"))

    def verdict(self, study: Any, trials: Sequence[Trial], withheld: Sequence[Trial]) -> str:
        """Compare the stops of held-out beds with those that the position implies.

        The promise is kept if the 95 % interval of the measured rate meets the rates that the model implies at the
        setting shifted by plus or minus `within`.

        Args:
            study: The study.
            trials: Runs on which the promise rests.
            withheld: Held-out runs of one setting.

        Returns:
            The position with its interval, and the verdict, in sentences.
        """
        counts, width = self._counts(trials), self._width(study.points)
        position = self._position(study, counts)
        answer = f"{percent(self.clogging)} of the flows stop before {self.grains} grains at "
        answer += f"{self._setting(study, position.median)} (95 %: {self._setting(study, position.low)} to "
        answer += f"{self._setting(study, position.high)}) from {len(trials)} beds"
        observed = self._counts(withheld)
        if not observed or not sum(exposure for _, exposure in observed.values()):
            return f"{answer}. Promise not tested: no grain of the held-out beds counts"
        ((x, (stops, exposure)),) = observed.items()
        measured = rate(round(stops), exposure)
        lowest_rate, highest_rate = sorted(self._expected(study, counts, x + shift) for shift in (width, -width))
        word = "kept" if measured.low <= highest_rate and measured.high >= lowest_rate else "not kept"
        tested = f"{len(withheld)} held-out beds at {self._setting(study, x)} stop {stops:.0f} times in {exposure:.0f} "
        tested += f"grains, and {lowest_rate * exposure:.3g} to {highest_rate * exposure:.3g} are expected"
        return f"{answer}. Promise {word} (±{self.within}): {tested}"

    def _counts(self, trials: Sequence[Trial]) -> dict[float, tuple[float, float]]:
        """Stops, and grains that left beyond the transients, by setting."""
        counts: dict[float, tuple[float, float]] = {}
        for trial in sorted(trials, key=lambda trial: trial.key):
            x = float(trial.at[self.key])
            stops, exposure = counts.get(x, (0.0, 0.0))
            grains = trial.numbers.get(f"{PROBABILITY}{EXPOSURE}", 0.0)
            # a stop without exposure lies within the transients
            counts[x] = stops + (trial.numbers.get(COUNT, 0.0) if grains else 0.0), exposure + grains
        return counts

    def _posterior(self, study: Any, counts: Mapping[float, tuple[float, float]]) -> tuple[np.ndarray, np.ndarray]:
        """Compute the posterior on the grid: positions, and weights of shape [positions, slopes, bends]."""
        swept = only_swept(study.points)
        assert swept is not None
        low, high = swept.values[0], swept.values[-1]
        positions = np.linspace(low, high, _POSITIONS)
        x = np.array([*counts])
        stops, exposures = np.array([*counts.values()]).T
        log_q = self._log_q(study, x, positions)
        likelihood = (stops * log_q - exposures * np.exp(log_q)).sum(axis=-1)
        # the largest is subtracted, as likelihoods of thousands of grains underflow; the prior is uniform on the grid
        posterior = np.exp(likelihood - likelihood.max())
        return positions, posterior / posterior.sum()

    def _log_q(self, study: Any, x: np.ndarray, positions: np.ndarray) -> np.ndarray:
        """ln q at n settings for each position, slope and bend, shape [positions, slopes, bends, n]."""
        swept = only_swept(study.points)
        assert swept is not None
        off = (x - positions[:, None, None, None]) / (swept.values[-1] - swept.values[0])
        slope, bend = _SLOPES[:, None, None], _BENDS[:, None]
        off = np.maximum(off, -slope / (2 * bend))  # the parabola never falls towards narrow outlets
        return np.minimum(self._level - (slope + bend * off) * off, 0.0)

    def _position(self, study: Any, counts: Mapping[float, tuple[float, float]]) -> Position:
        positions, posterior = self._posterior(study, counts)
        cumulative = np.cumsum(posterior.sum(axis=(1, 2)))
        return Position(
            *(float(np.interp(fraction, cumulative, positions)) for fraction in (0.25, 0.5, 0.75, 0.025, 0.975))
        )

    def _expected(self, study: Any, counts: Mapping[float, tuple[float, float]], x: float) -> float:
        """Posterior mean of q at a setting."""
        positions, posterior = self._posterior(study, counts)
        return float((posterior * np.exp(self._log_q(study, np.array([x]), positions))[..., 0]).sum())

    @property
    def _level(self) -> float:
        """ln q at the transition: 1 - (1 - q)^N is the probability."""
        # q is near 1e-3 for 1000 grains: differences from 1 would lose digits
        return math.log(-math.expm1(math.log1p(-self.clogging) / self.grains))

    def _width(self, points: Sequence[Any]) -> float:
        """Half width to reach [SI]. Raises ValueError."""
        scene = points[0].scene
        unit = "m" if self.within.strip().endswith(("d", "m")) else ""
        return parse(self.within, unit, scene.grains.diameter)

    def _on_grid(self, study: Any, x: float) -> float:
        """Round a setting to a grid of half the width to reach, so that beds gather at few settings."""
        swept = only_swept(study.points)
        assert swept is not None
        grid = float(f"{self._width(study.points) / 2:.2g}")
        low, high = swept.values[0], swept.values[-1]
        return min(max(float(f"{round(x / grid) * grid:.12g}"), low), high)

    def _setting(self, study: Any, value: float) -> str:
        if study.units.get(self.key) == "m":
            return f"{1e3 * value:.4g} mm"
        return f"{value:.4g} {study.units.get(self.key, '')}".rstrip()


_EXAMPLE = "write {container.orifice: {clogging: 50 %, grains: 1000, within: 0.1 d}}"
