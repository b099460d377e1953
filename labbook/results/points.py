"""Points of a study with their replicates: what was measured of each run, and means over beds."""

import math
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from labbook import html
from labbook.fields import Fields
from labbook.lab import FinishedRun
from labbook.measure import MEASURES, Evaluation, Measure, MeasureError, Window, scales
from labbook.measure.acceleration import AccelerationProfile
from labbook.measure.clogging import Avalanches, Clogging
from labbook.measure.flow import CUT_SHORT, WIDER, FlowRate, Trace, merge_notes
from labbook.measure.orifice import OrificeMeans
from labbook.measure.outlet import OutletProfile, OutletProfiles, ProfileAcross, mean_of
from labbook.measure.steady import BLOCKS, FEWEST
from labbook.measure.stress import ContactStress
from labbook.plan.demand import fewest_runs, stopping_rule
from labbook.results import display
from labbook.stats import Measured, Pooled, Tolerance
from labbook.stats.nested import by_bed, of_beds
from labbook.stats.pooling import student
from labbook.stats.rates import PooledRate, rate
from labbook.stats.trend import MATERIAL
from labbook.study import Point, Study
from labbook.warning import RenamedAttribute

FLOW_RATE, DRIFT = "flow_rate", "flow_rate_drift"
ORIFICE = "container.orifice"
NUMERICS, FILLING, BED = "numerics.", "fill.", "grains.count"
"""First letters of keys that do not change the physical scene: its numerics, its filling and the size of its bed."""
_NO_FLOW = {
    "few": f"fewer than {FEWEST} grains flowed out within the window ({WIDER})",
    "clogged": f"runs clogged (use a wider outlet, or measure: [{Clogging.name}])",
    Clogging.name: "runs clogged before enough grains had left",
    "diverged": "runs diverged (use a smaller time step)",
    "suspect": "runs are suspect and left out",
}
"""Reasons that a run gives no flow rate, each with a remedy."""


@dataclass(frozen=True, eq=False)
class RunResult:
    """One run: how it ended, and what was measured of it, by quantity. Profiles and fields are read when asked for."""

    run: FinishedRun
    measured: Mapping[str, Measured]
    measures: tuple[str, ...]
    """Names of the measures that the study requests."""
    window: Window
    counted: bool
    """True if the run takes part in means and fits (`labbook.lab.suspect`)."""

    @property
    def seed(self) -> int:
        """Number of the replicate, which is a bed."""
        return self.run.seed

    @property
    def discharge(self) -> int:
        """Number of the discharge of its bed."""
        return self.run.discharge

    @property
    def repeat(self) -> str:
        """The number of a run among those of its point, for people: `seed 3, discharge 2`."""
        return self.run.repeat

    @property
    def run_key(self) -> str:
        """Key of the run in the lab."""
        return self.run.entry.run_key

    @property
    def packing_key(self) -> str:
        """Key of the packing that it started from."""
        return self.run.entry.packing_key

    @property
    def outcome(self) -> str:
        """Outcome of the run."""
        return self.run.entry.outcome

    @property
    def suspect(self) -> str:
        """Reason that the run is suspect; empty if it is not."""
        return self.run.entry.suspect

    @property
    def ended(self) -> str:
        """Time at which the run ended (UTC, ISO 8601)."""
        return self.run.entry.finished

    @property
    def backend(self) -> str:
        """The backend that made it."""
        return self.run.entry.backend

    @property
    def cache_version(self) -> int:
        """Version of that backend."""
        return self.run.entry.cache_version

    @property
    def outdated(self) -> str:
        """Changes of its law and walls since the run was made; empty if there are none."""
        return self.run.outdated

    @property
    def device(self) -> str:
        """Device on which the run was computed."""
        return self.run.entry.device

    @property
    def cost(self) -> float:
        """Device time [s] of it and of the packing that it started from, as far as the index knows; of runs of older
        versions the wall time."""
        return self.run.entry.device_time + self.run.entry.filling_time

    @property
    def provenance(self) -> Mapping[str, Any]:
        """Software, hardware and sessions that made the run."""
        return self.run.provenance

    @property
    def recorded(self) -> bool:
        """True if frames of the run were recorded."""
        return self.frame_interval is not None

    @property
    def frame_interval(self) -> float | None:
        """Time between two recorded frames [s]; None without any."""
        return self.run.entry.frame_interval

    def evaluation(self, measure: Measure | str) -> Evaluation:
        """Evaluation of a measure on this run, made if none is stored; empty if the measure does not apply or fails.

        Args:
            measure: the measure, or its name in `labbook.measure.MEASURES`.

        Raises:
            ImportError: a package that the measure needs is missing.
            ExtensionError: the code of a measure of another package fails.
            LookupError: no measure has this name.
        """
        if isinstance(measure, str):
            if measure not in MEASURES:
                raise LookupError(f"no measure is called {measure!r}; there are: {', '.join(MEASURES)}")
            measure = MEASURES[measure]
        return self.run.evaluated(measure, self.window).evaluation

    def frames(self) -> Mapping[str, np.ndarray] | None:
        """Recorded frames; None without any."""
        return self.run.data().frames() if self.recorded else None

    @cached_property
    def trace(self) -> Trace | None:
        """W(t), if its outflow was recorded and any grain left."""
        try:
            FlowRate().check(self.run.point.scene)
        except MeasureError:
            return None
        return Trace.of(self.evaluation(FlowRate()))

    def avalanches_of(self, outlet: int | None = None) -> Avalanches | None:
        """Avalanches of the run, where `clogging` was measured and the run counts.

        Args:
            outlet: Index of one of several outlets.
        """
        if Clogging.name not in self.measures or not self.counted:
            return None
        return Avalanches.of(self.evaluation(Clogging()).arrays, outlet)

    @property
    def avalanches(self) -> Avalanches | None:
        """Avalanches of a run with one outlet, where `clogging` was measured and the run counts."""
        return self.avalanches_of()

    @cached_property
    def waits(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Times between grains [s] of an agitated silo, and if a grain ended each, where `clogging` was measured and
        the run counts."""
        if self.avalanches is None:
            return None
        arrays = self.evaluation(Clogging()).arrays
        return (arrays["waits"], arrays["wait_ended"].astype(bool)) if "waits" in arrays else None

    @cached_property
    def acceleration(self) -> AccelerationProfile | None:
        """Above the middle of the outlet, where `orifice` was measured."""
        return AccelerationProfile.of(self.evaluation(OrificeMeans())) if OrificeMeans.name in self.measures else None

    @cached_property
    def stress(self) -> Fields | None:
        """Fields with the contact stress of the bed, where `contact_stress` was measured."""
        arrays = self.evaluation(ContactStress()).arrays if ContactStress.name in self.measures else {}
        return Fields.of(arrays) if arrays else None

    @cached_property
    def outlets(self) -> Mapping[str, ProfileAcross]:
        """Profiles along its outlet by definition (`labbook.measure.outlet.DEFINITIONS`); none of a run that clogged
        or does not count, as for its flow rate."""
        if OutletProfiles.name not in self.measures or self.outcome == "clogged" or not self.counted:
            return {}
        profiles = OutletProfile.of(self.evaluation(OutletProfiles()))
        return profiles.outlets(self.run.point.scene.grains.radius) if profiles is not None else {}


@dataclass(frozen=True, eq=False)
class PointResult:
    """One point of a study with its replicates.

    Args:
        point: The point of the study.
        at: Swept values [SI or word], without those that follow from others.
        runs: Its finished runs.
        pooled: Means over beds by quantity, with Student intervals. The value of a bed is the mean of its discharges.
        tolerance: Requested relative half-width of the flow rate's interval; None if none is requested.
        requested: Number of runs that the study requests at least.
        along: Swept values that follow from those in `at`.
    """

    point: Point
    at: Mapping[str, float | str]
    runs: tuple[RunResult, ...]
    pooled: Mapping[str, Pooled]
    tolerance: float | None
    requested: int
    along: Mapping[str, float | str] = field(default_factory=dict)
    interval = RenamedAttribute("acceleration_interval")

    @property
    def of_point(self) -> "PointResult":
        """The point itself; of an outlet that of all its outlets."""
        return self

    @property
    def identity(self) -> int | tuple[int, str]:
        """Index of the point, which no other of its series has."""
        return self.point.index

    @property
    def outlet_form(self) -> str | None:
        """Form of the only outlet, `slot` or `hole`; None if it is not known."""
        return self.point.scene.container.outlet_form

    @property
    def label(self) -> str:
        """Swept values in the units of the field."""
        return self.label_without(())

    def label_without(self, omitted: Collection[str]) -> str:
        """Label without the keys `omitted`, and without keys that change only how a scene is computed or filled."""
        return display.label(
            {**self.at, **{name: value for name, value in self.along.items() if names_scene(name)}}, omitted
        )

    @property
    def orifice(self) -> float:
        """Width of the outlet [m]; NaN where the container has none."""
        return float(getattr(self.point.scene.container, "orifice", math.nan))

    @property
    def layer(self) -> float:
        """Height [m] of the layer above the orifice over which fields are averaged."""
        return scales.layer(self.point.scene, self.runs[0].window if self.runs else None)

    @property
    def acceleration_interval(self) -> float:
        """Time [s] between two velocities whose difference gives an acceleration."""
        return scales.interval(self.point.scene, self.runs[0].window if self.runs else None)

    @property
    def flow_rate(self) -> Pooled | None:
        """Pooled W [kg/s], or None if no replicate gave one."""
        return self.pooled.get(FLOW_RATE)

    @cached_property
    def beds(self) -> tuple[int, ...]:
        """Seeds of its beds."""
        return tuple(dict.fromkeys(run.seed for run in self.runs))

    def outlets(self, definition: str) -> tuple[ProfileAcross, ...]:
        """Profiles along the outlet, of every bed that has them: means over its discharges."""
        beds: dict[int, list[ProfileAcross]] = {}
        for run in self.runs:
            if definition in run.outlets:
                beds.setdefault(run.seed, []).append(run.outlets[definition])
        return tuple(each[0] if len(each) == 1 else mean_of(each) for each in beds.values())

    @property
    def outcomes(self) -> Counter[str]:
        """Number of runs by outcome."""
        return Counter(run.outcome for run in self.runs)

    @property
    def suspect(self) -> tuple[RunResult, ...]:
        """Runs that are suspect, whether they count or not."""
        return tuple(run for run in self.runs if run.suspect)

    @cached_property
    def notes(self) -> Counter[str]:
        """Number of runs by note on their flow rate (`trending` ...)."""
        carried = (run.measured[FLOW_RATE].notes for run in self.runs if FLOW_RATE in run.measured)
        return Counter(merge_notes(Counter(note for notes in carried for note in notes)))

    @property
    def no_flow(self) -> str:
        """Reasons that no run gave a flow rate, with remedies; empty if one did, or if no flow rate was measured."""
        if self.flow_rate is not None:
            return ""
        reasons = dict.fromkeys(filter(None, map(_no_flow, self.runs)))
        return " and ".join(_NO_FLOW[reason] for reason in reasons)

    @property
    def trending(self) -> bool:
        """True if the flow has no plateau.

        Either more than half of the runs trend, or the mean drift of the beds is above 5 % with a 95 % interval that
        excludes zero: single runs may be too noisy to show a drift.
        """
        drift = self.pooled.get(DRIFT)
        together = drift is not None and abs(drift.value) > max(MATERIAL, drift.half_width)
        return self.notes["trending"] > len(self.runs) / 2 or together

    @property
    def hollow(self) -> bool:
        """True if figures draw the point hollow: it has a remark, or its flow rate has no interval (one run)."""
        return bool(self.remark) or (self.flow_rate is not None and not math.isfinite(self.flow_rate.half_width))

    @property
    def lacking(self) -> str:
        """Reason that the point has no flow rate, in a few words: `4 of 4 clogged`; empty if it has one."""
        if self.flow_rate is not None:
            return ""
        return self.remark or "too few grains"

    @property
    def precise(self) -> bool | None:
        """True if |bias of the chosen numerics| + half-width of the flow rate's interval is within the requested error;
        None if the study requests none."""
        if self.tolerance is None:
            return None
        bias = 0.0 if self.point.choice is None else self.point.choice.bias.bound
        return self.flow_rate is not None and Tolerance(self.tolerance, bias).met(self.flow_rate.relative)

    @property
    def partial(self) -> bool:
        """True if runs are missing. Runs that end first flow fastest, so that they are a biased sample."""
        return len(self.runs) < self.requested

    @property
    def remark(self) -> str:
        """Remarks that readers of this point need, in a few words; empty without any."""
        parts = [f"{len(self.runs)} of {self.requested} runs so far"] if self.partial else []
        parts += ["trending"] if self.trending else []
        parts += ["stopped within the window"] if self.notes[CUT_SHORT] else []
        ended = {how: n for how, n in self.outcomes.items() if how in ("clogged", "diverged")}
        ended |= {"suspect": len(self.suspect)} if self.suspect else {}
        return ", ".join(parts + [f"{n} of {len(self.runs)} {how}" for how, n in ended.items()])

    def _repr_html_(self) -> str:
        rows = []
        for name, mean in self.pooled.items():
            unit = next((run.measured[name].unit for run in self.runs if name in run.measured), "")
            notation = display.quantity(name, unit)
            low, high = (display.number(end, mean.error, notation.scale) for end in (mean.low, mean.high))
            interval = f"{low} to {high}" if math.isfinite(mean.half_width) else "unknown"
            value = display.with_error(mean.value, mean.error, notation.scale)
            rows.append((notation.name, value, interval, notation.unit, str(mean.n)))
        table = html.table(("quantity", "mean ± error", "95 % interval", "unit", "replicates in the mean"), rows)
        ended = ", ".join(f"{count} {name}" for name, count in self.outcomes.items())
        return html.titled(self.label or "the only point", table, html.lines(filter(None, (ended, self.remark))))

    def __repr__(self) -> str:
        names = ", ".join(self.pooled)
        return f"<PointResult {self.label or 'of the only point'}: {len(self.runs)} runs; pooled: {names}>"


def _no_flow(run: RunResult) -> str:
    """Key of `_NO_FLOW` that applies to a run; empty if no flow rate was requested, or if it is not evaluated yet."""
    if FlowRate.name not in run.measures:
        return ""
    if run.outcome == "clogged" and Clogging.name in run.measures:
        return Clogging.name
    if run.outcome in _NO_FLOW:
        return run.outcome
    if not run.counted:
        return "suspect" if run.suspect else ""
    return "few" if FLOW_RATE in run.measured else ""


def values_by_run(result: PointResult, quantity: str) -> list[tuple[RunResult, float]]:
    """The quantity of every run of a point that counts and has it."""
    there = ((run, run.measured[quantity].value) for run in result.runs if run.counted and quantity in run.measured)
    return [(run, value) for run, value in there if math.isfinite(value)]


def by_seed(result: PointResult, quantity: str) -> dict[int, float]:
    """The quantity of every bed of a point that has it, by its seed: the mean over its discharges."""
    beds = by_bed((run.seed, value) for run, value in values_by_run(result, quantity))
    return dict(zip(beds, of_beds(beds), strict=True))


def names_scene(name: str) -> bool:
    """True for keys of the physical scene; false for numerics, filling and the number of grains."""
    return not name.startswith((NUMERICS, FILLING, BED))


def redundant(points: Sequence[Point]) -> frozenset[str]:
    """Swept keys that follow from another one, such as a number of grains given for every width.

    The orifice counts by itself: what varies with it makes series of its own. Of keys that follow from one another, how
    a scene is computed or filled follows from what it is, in whichever order they are listed.
    """
    names = list(dict.fromkeys(name for point in points for name in point.at if name != ORIFICE))
    names.sort(key=lambda name: not names_scene(name))
    extra: set[str] = set()
    for index, name in enumerate(names):
        for earlier in (other for other in names[:index] if other not in extra):
            pairs = {(point.at.get(earlier), point.at.get(name)) for point in points}
            if len(pairs) == len({first for first, _ in pairs}) == len({second for _, second in pairs}) > 1:
                extra.add(name)
    return frozenset(extra)


def swept(point: Point, extra: frozenset[str]) -> dict[str, float | str]:
    """Swept values of a point, without the keys in `extra`, which follow from others."""
    return {name: value for name, value in point.at.items() if name not in extra}


def followers(points: Sequence[PointResult], key: str) -> tuple[str, ...]:
    """Swept keys that change with `key` and are known as soon as it is: a diameter that is given for every length."""
    valued = [({**result.at, **result.along}, value) for result in points if (value := result.at.get(key)) is not None]
    following = []
    for name in dict.fromkeys(name for result in points for name in result.along):
        pairs = {(value, known.get(name)) for known, value in valued}
        if len(pairs) == len({value for value, _ in pairs}) and len({other for _, other in pairs}) > 1:
            following.append(name)
    return tuple(following)


def pooled_point(study: Study, point: Point, extra: frozenset[str], runs: tuple[RunResult, ...]) -> PointResult:
    """A point with its numbers pooled over beds, of the runs that count."""
    rule = stopping_rule(study)
    declared = [quantity for measure in MEASURES.values() for quantity in measure.declared]
    declared += [quantity for name in study.measure for quantity in MEASURES[name].quantities(point.scene)]
    unpooled = {quantity.name for quantity in declared if not quantity.pooled}
    rates = {quantity.name for quantity in declared if quantity.estimator == "rate"}
    values: dict[str, list[tuple[int, Measured]]] = {}
    for run in runs:
        for name, measured in run.measured.items():
            if run.counted and name not in unpooled and math.isfinite(measured.value):
                values.setdefault(name, []).append((run.seed, measured))
    pooled: dict[str, Pooled] = {}
    for name, numbers in values.items():
        means = of_beds(by_bed((seed, measured.value) for seed, measured in numbers))
        pooled[name] = _rate(numbers) if name in rates else rule.pool(means)
    if study.fed and len(values.get(FLOW_RATE, ())) == 1:
        pooled |= _of_one_run(runs)
    along = {name: value for name, value in point.at.items() if name in extra}
    requested = fewest_runs(study, point)
    return PointResult(point, swept(point, extra), runs, pooled, study.accuracy.flow_rate, requested, along)


def _rate(runs: Sequence[tuple[int, Measured]]) -> PooledRate:
    """Events over exposure of all runs, each with the seed of its bed."""
    events = sum(round(number.value * number.n_effective) for _, number in runs)
    return rate(events, sum(number.n_effective for _, number in runs), len({seed for seed, _ in runs}))


def _of_one_run(runs: tuple[RunResult, ...]) -> dict[str, Pooled]:
    """Flow rates of the only run of a fed bed, which is long enough to tell its own error."""
    names = (FLOW_RATE, "grain_rate")
    rates_of_run = [run.measured[name] for run in runs for name in names if run.counted and name in run.measured]
    finite = [rate for rate in rates_of_run if math.isfinite(rate.value)]
    t = student(0.95, BLOCKS - 1)
    return {rate.quantity: Pooled(rate.value, rate.error, t * rate.error, 1) for rate in finite}
