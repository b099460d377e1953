"""Goal `find`: the value of the swept key at which a quantity has a target value.

    adapt:
      find: {container.orifice: {flow_rate: 50 g/s, within: 1 %}}

The quantity is interpolated between all runs so far, with its error (`labbook.stats.response`). New runs are made where
it has the target value, until the half width of the interval there is within the requested deviation.
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import model_validator

from labbook.campaign.goal import (
    HELD_OUT,
    SCATTER,
    Goal,
    Step,
    clogged_places,
    held_out,
    of_one_key,
    only_swept,
    rounded,
    spread,
)
from labbook.campaign.strategy import Assignment, Proposal, Trial, Values, point_key
from labbook.fit.interpolation import Interpolation, trend_of_outlets
from labbook.measure import MEASURES
from labbook.scene.model import Fault, Internal, refuse
from labbook.scene.quantities import parse, percent
from labbook.stats import Tolerance, pool
from labbook.stats.inverse import NoSetting, setting_for
from labbook.stats.nested import by_bed, of_beds
from labbook.stats.pooling import student
from labbook.stats.response import FEWEST
from labbook.stats.stopping import widening

_LEAST = 4
"""Fewest beds near the answer at the end of the search."""
_NEAR = 1.0
"""Largest distance of a point's value from the target, over the requested deviation, at which the point gets further
beds: they are worth more than the same beds at another point."""
_SHARED = 1.2
"""Largest ratio of the half width at the answer to that at such a point, up to which beds there are worth as much."""
_SEVERAL = 8
"""Beds of each point up to which more are made, if the noise gives the value at several settings."""


class Find(Goal):
    """Goal: the value of the swept key at which a quantity has a target value.

    ln(quantity) is interpolated over all beds by a response with noise (`labbook.stats.response`), and inverted
    (`labbook.stats.inverse`). The half width at the root is widened for a search that stops on it
    (`labbook.stats.stopping.widening`).

    Args:
        key: The swept key.
        quantity: Name of the quantity; it has to be pooled over beds.
        target: Target value [SI], above 0.
        within: Largest deviation from it, promised at 95 %, relative to it.
    """

    name: ClassVar[str] = "find"

    key: Annotated[str, Internal()]
    """The swept key."""
    quantity: Annotated[str, Internal()]
    """The quantity."""
    target: Annotated[float, Internal()]
    """Target value of the quantity [SI]."""
    within: Annotated[float, Internal()]
    """Largest deviation from it, promised at 95 %, relative to it."""

    @model_validator(mode="before")
    @classmethod
    def _of_mapping(cls, mapping: Any) -> Any:
        """Convert {key: {quantity: value, within: part}} to fields."""
        if isinstance(mapping, Mapping) and mapping.keys() >= {"key", "quantity", "target", "within"}:
            return mapping
        if not (
            isinstance(mapping, Mapping) and len(mapping) == 1 and isinstance(next(iter(mapping.values())), Mapping)
        ):
            refuse([Fault("", "one swept key with what it shall give is needed", _EXAMPLE)])
        ((key, wish),) = mapping.items()
        names = [name for name in wish if name != "within"]
        if len(names) != 1 or "within" not in wish:
            refuse([Fault(key, "one quantity and `within` are needed", _EXAMPLE)])
        (quantity,) = names
        units = {
            declared.name: declared.unit
            for measure in MEASURES.values()
            for declared in measure.declared
            if declared.pooled
        }
        if quantity not in units:
            refuse([Fault(f"{key}.{quantity}", "this is no quantity that is pooled over beds", "write flow_rate")])
        numbers = {"target": _number(wish[quantity], units[quantity], f"{key}.{quantity}")}
        numbers["within"] = _number(wish["within"], "", f"{key}.within")
        if not 1e-4 <= numbers["within"] < 1:
            refuse([Fault(f"{key}.within", "a fraction from 0.0001 to 1 is needed", "write 1 %")])
        if numbers["target"] <= 0:
            refuse([Fault(f"{key}.{quantity}", "a value above 0 is needed", _EXAMPLE)])
        return {"key": key, "quantity": quantity, **numbers}

    def range_faults(self, points: Sequence[Any]) -> list[Fault]:
        """List faults of the range of a study."""
        return of_one_key("find", self.key, points)

    def needs(self) -> tuple[str, Sequence[str]]:
        """Name the quantity, and the measures that give it."""
        giving = (name for name, measure in MEASURES.items() if any(q.name == self.quantity for q in measure.declared))
        return f"{self.quantity} is", tuple(giving)

    def plan_rule(self, study: Any) -> str:
        """State the end of the search, and the expected number of runs."""
        scatter = next((point.choice.scatter for point in study.points if getattr(point, "choice", None)), SCATTER)
        start = len(self._start(study)) * self.beds
        expected = start + math.ceil((student(0.95, math.inf) * scatter / self.within) ** 2)
        return (
            f"{self.key} with {self._amount(self.target)} within {percent(self.within)}. {start} beds over the range, "
            f"then beds near the answer until the half width of the 95 % interval is {percent(self.within)}, then "
            f"{HELD_OUT} held-out beds. About {expected + HELD_OUT} beds{self.limits()} (scatter of a run: "
            f"{percent(scatter)})"
        )

    def first(self, study: Any) -> list[Values]:
        """Return a few points over the range."""
        return [{self.key: x} for x in self._start(study)]

    def step(self, study: Any, trials: Sequence[Trial]) -> Step:
        """Propose more beds where the target is reached, or held-out beds once its setting is known well enough.

        Args:
            study: The study, whose sweep is the range.
            trials: All runs so far; settings with many clogged runs are left out.

        Returns:
            Further points where too few have a value; beds at the setting of the target; held-out beds; or the end, if
            the target is out of range or no more beds are allowed.
        """
        runs = self._values(trials)
        if len({x for x, _, _ in runs}) < FEWEST:
            return Step(self._more_points(study, trials, [x for x, _, _ in runs]))
        curve = self._curve(study, runs)
        try:
            root, ends = self._root(study, curve)
        except NoSetting as reason:
            why = f"{self._reach(study, reason)}: {reason}"
            beds = Counter(x for x, _, _ in runs)
            if reason.several and min(beds.values()) < _SEVERAL:
                extended = tuple(
                    Assignment({self.key: x}, n + self.beds) for x, n in sorted(beds.items()) if n < _SEVERAL
                )
                return Step(Proposal(extended, f"{why}; {self.beds} beds more at each"))
            return Step(Proposal.end(f"{why}; change `sweep`"))
        x, beds = self._next_setting(curve, runs, root)
        half = _half_width(curve, root, len(runs))
        progress = f"{self._amount(self.target)} at {self._setting(study, root)} (95 %: {ends}), known to "
        progress += f"±{percent(half, '.2f')} from {len(runs)} beds"
        if beds >= _LEAST and Tolerance(self.within).met(half):
            return held_out({self.key: x}, trials, progress)
        if beds >= study.accuracy.max_replicates:
            reason = "accuracy.max_replicates allows no more beds, and the promise is not reached"
            return Step(Proposal.end(f"{reason}: {progress}"))
        # beds whose mean would be as precise as the interval, and those then missing. Half as many again at most, since
        # scatter and shape are known from few runs.
        worth = (student(0.95, curve.response.freedom) * curve.response.scatter / half) ** 2
        missing = math.ceil(worth * ((half / self.within) ** 2 - 1))
        added = max(2, _LEAST - beds, min(missing, max(_LEAST, len(runs) // 2)))
        number = min(beds + added, study.accuracy.max_replicates)
        reason = f"{progress}: {number} beds in all at {self._setting(study, x)}"
        return Step(Proposal((Assignment({self.key: x}, number),), reason))

    def verdict(self, study: Any, trials: Sequence[Trial], withheld: Sequence[Trial]) -> str:
        """Compare the mean of held-out beds with the promise.

        The promise is kept if the deviation of their mean from the interpolation, less the half width of its 95 %
        interval, is at most `within`.

        Args:
            study: The study.
            trials: Runs on which the promise rests.
            withheld: Held-out runs of one setting.

        Returns:
            The answer with its interval, and the verdict, in sentences.
        """
        runs = self._values(trials)
        curve = self._curve(study, runs)
        root, ends = self._root(study, curve)
        half = _half_width(curve, root, len(runs))
        answer = f"{self._setting(study, root)} gives {self._amount(self.target)} (95 %: {ends}), known to "
        answer += f"±{percent(half, '.2f')} from {len(runs)} beds"
        values = [value for _, value, _ in self._values(withheld)]
        if len(values) < 2:
            return f"{answer}. Promise not tested: {len(values)} of {len(withheld)} held-out beds have a value"
        x = float(withheld[0].at[self.key])
        mean, expected = pool(values), float(curve.band(np.array([x]))[0][0])
        off = mean.value / expected - 1
        word = "kept" if abs(off) - mean.half_width / expected <= self.within else "not kept"
        tested = f"{len(values)} held-out beds at {self._setting(study, x)} give {self._amount(mean.value)}"
        tested += f" ±{percent(mean.relative, '.2f')}, and {self._amount(expected)} is expected"
        return f"{answer}. Promise {word} ({percent(self.within)}): {tested}"

    def _start(self, study: Any) -> tuple[float, ...]:
        sweep = only_swept(study.points)
        assert sweep is not None
        return spread(sweep, FEWEST)

    def _values(self, trials: Sequence[Trial]) -> list[tuple[float, float, int]]:
        """Collect setting, quantity and seed of each bed, for points at which few runs clogged."""
        lost, points = clogged_places(trials), dict[float, list[tuple[int, float]]]()
        for trial in sorted(trials, key=lambda trial: (point_key(trial.at), trial.seed, trial.discharge)):
            value = trial.numbers.get(self.quantity, math.nan)
            if point_key(trial.at) not in lost and value > 0:
                points.setdefault(float(trial.at[self.key]), []).append((trial.seed, value))
        beds = ((x, by_bed(values)) for x, values in points.items())
        return [(x, value, seed) for x, of in beds for seed, value in zip(of, of_beds(of), strict=True)]

    def _is_length(self, study: Any) -> bool:
        return study.units.get(self.key) == "m"

    def _curve(self, study: Any, runs: Sequence[tuple[float, float, int]]) -> Interpolation:
        x, y, seeds = zip(*runs, strict=True)
        trend = trend_of_outlets(self.quantity, self.key, study.points[0].scene, min(x))
        return Interpolation.of(x, y, seeds, of_length=self._is_length(study), trend=trend)

    def _root(self, study: Any, curve: Interpolation) -> tuple[float, str]:
        """Find the setting at which the target is reached, and its interval in words. Raises NoSetting."""
        try:
            setting = setting_for(curve.band, curve.low, curve.high, self.target)
        except NoSetting as reason:
            _, (low,), (high,) = curve.band(np.array([reason.nearest]))
            if reason.several or not low <= self.target <= high:
                raise
            return reason.nearest, "at the end of the range"  # more runs there will tell
        ends = (self._setting(study, end) if math.isfinite(end) else "beyond the range" for end in setting.ends)
        return setting.value, " to ".join(ends)

    def _next_setting(
        self, curve: Interpolation, runs: Sequence[tuple[float, float, int]], root: float
    ) -> tuple[float, int]:
        """Choose the setting of the next beds.

        It is the point with most beds among those near enough to the target; without one the root, rounded.

        Returns:
            The setting, and its present number of beds.
        """
        beds = Counter(x for x, _, _ in runs)
        off = dict(zip(beds, abs(curve.band(np.array([*beds]))[0] / self.target - 1), strict=True))
        half = dict(zip(beds, curve.at(np.array([*beds]))[1], strict=True))
        least_half_width = float(curve.at(np.array([root]))[1][0]) / _SHARED
        near = [x for x in beds if off[x] <= _NEAR * self.within and half[x] >= least_half_width]
        if near:
            x = max(near, key=lambda x: (beds[x], -off[x]))
            return x, beds[x]
        digits = max(4, 2 + math.ceil(-math.log10(self.within)))
        x = min(max(rounded(root, digits), min(beds)), max(beds))
        return x, beds[x]

    def _more_points(self, study: Any, trials: Sequence[Trial], usable: Sequence[float]) -> Proposal:
        """Propose points between those with a value and those without."""
        tried = sorted({float(trial.at[self.key]) for trial in trials})
        if not usable:
            return Proposal.end(f"no point over the range has a {self.quantity} without a clogged run; change `sweep`")
        low = max((x for x in tried if x < min(usable)), default=min(usable))
        high = min((x for x in tried if x > max(usable)), default=max(usable))
        inner = [rounded(low + (high - low) * k / (FEWEST + 1)) for k in range(1, FEWEST + 1)]
        new = tuple(Assignment({self.key: x}, self.beds) for x in inner if x not in tried)
        if not new:
            return Proposal.end(f"{self.quantity} has a value at {len({*usable})} points only; change `sweep`")
        reason = f"{self.quantity} has a value at {len({*usable})} points; {len(new)} more between"
        return Proposal(new, f"{reason} {self._setting(study, low)} and {self._setting(study, high)}")

    def _reach(self, study: Any, reason: NoSetting) -> str:
        low, high = (self._amount(end) for end in (reason.smallest, reason.largest))
        ends = (self._setting(study, x) for x in (self._start(study)[0], self._start(study)[-1]))
        return f"{low} to {high} over the range from {' to '.join(ends)}"

    def _amount(self, value: float) -> str:
        """Write the quantity in the unit of reports."""
        quantities = [declared for measure in MEASURES.values() for declared in measure.declared]
        quantity = next(declared for declared in quantities if declared.name == self.quantity)
        return f"{self.quantity} = {value * quantity.scale:.4g} {quantity.shown or quantity.unit}".rstrip()

    def _setting(self, study: Any, value: float) -> str:
        if self._is_length(study):
            return f"{1e3 * value:.4g} mm"
        return f"{value:.4g} {study.units.get(self.key, '')}".rstrip()


def _half_width(curve: Interpolation, x: float, runs: int) -> float:
    """Half width of the interval at a setting, relative to the quantity, widened for a search that ends on it."""
    return math.expm1(float(curve.at(np.array([x]))[1][0])) * float(widening(runs))


def _number(text: Any, unit: str, key: str) -> float:
    """Parse a quantity with its unit."""
    try:
        if isinstance(text, str):
            return parse(text, unit)
        if isinstance(text, bool) or not isinstance(text, int | float) or unit:
            raise ValueError(f"a quantity in {unit} is needed" if unit else "a number is needed")
        return float(text)
    except ValueError as error:
        refuse([Fault(key, f"{text}: {error}", _EXAMPLE)])
        raise


_EXAMPLE = "write {container.orifice: {flow_rate: 50 g/s, within: 1 %}}"
