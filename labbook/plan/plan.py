"""Plans: runs of a study that are done, missing, partial or stale, with reasons; replicates that follow from
results."""

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from labbook.accuracy.groups import has_groups
from labbook.backend import Capabilities
from labbook.campaign import Assignment, Generation, History, Proposal, Replicates, Stops, Trial, point_key
from labbook.campaign.replicates import QUANTITY, in_words, scatter_of_beds
from labbook.campaign.stops import COUNT, stops
from labbook.campaign.strategy import EXPOSURE
from labbook.commands import command
from labbook.lab import identity
from labbook.lab.campaigns import campaign_of
from labbook.lab.catalogue import Catalogue, Entry
from labbook.lab.folder import LabListing, stamp
from labbook.lab.identity import Keys
from labbook.lab.journal import PROGRESS, FillingFailure, Progress
from labbook.lab.records import Unreadable
from labbook.lab.runs import open_run
from labbook.lab.suspect import counts
from labbook.measure import MEASURES
from labbook.measure.clogging import NAME
from labbook.measure.measure import window_in_words
from labbook.plan.beds import filling_cost
from labbook.plan.coverage import made_by, shortfall
from labbook.plan.demand import Demand, PackingsOf, PointDemand, discharges, recorded_in_words, stopping_rule
from labbook.plan.derived import derived
from labbook.plan.meshes import mesh_lines
from labbook.scene.quantities import duration, percent, size, value_range
from labbook.stats import Decision, StoppingRule
from labbook.stats.nested import TYPICAL, by_bed, of_beds, shares
from labbook.stats.rates import events_needed
from labbook.study import Point, Study
from labbook.study.problems import grouped
from labbook.study.proposed import with_points
from labbook.study.schema import AUTO

if TYPE_CHECKING:
    import pandas as pd

State = Literal["done", "missing", "partial", "stale"]
"""State of a run.

`partial`: started, or it covers less than the study demands. `stale`: made by another version of the backend, or by an
older one of the law or of a wall.
"""


@dataclass(frozen=True, eq=False, slots=True)
class Item:
    """State of one demanded run.

    Args:
        demand: The run.
        keys: Its keys.
        state: State in the lab.
        reason: Reason of the state.
        outcome: Outcome of the run in the lab; None without one.
        packed: Its packing is in the lab and can be read.
        suspect: Reason for which the run is suspect (`labbook.lab.suspect`); empty if it is not.
    """

    demand: Demand
    keys: Keys
    state: State
    reason: str
    outcome: str | None
    packed: bool
    suspect: str = ""

    @property
    def counts(self) -> bool:
        """True if the run takes part in means and fits once it is done."""
        return counts(self.outcome or "", self.suspect, self.demand.shared.study.accuracy.count_suspect)


def place_in_order(item: Item) -> tuple[int, int, int]:
    """Sort key of a run: first discharge of the first bed of every point, its further discharges, the second bed, and
    so on."""
    return *item.demand.number, item.demand.point.index


@dataclass(frozen=True, eq=False)
class PointPlan:
    """Runs of one point that are demanded so far.

    Args:
        shared: Demand of the point.
        items: Its runs, by seed and discharge.
        ended: Why no more replicates are added, with the statistics; None until all runs are done.
    """

    shared: PointDemand
    items: tuple[Item, ...]
    ended: Proposal | None

    @cached_property
    def indices(self) -> dict[str, int]:
        """Index of each run in `items`, by its key."""
        return {item.keys.run: index for index, item in enumerate(self.items)}

    @cached_property
    def lacking(self) -> int:
        """Number of runs that are not done."""
        return sum(item.state != "done" for item in self.items)

    def with_items(self, current: Mapping[str, Item]) -> "PointPlan":
        """Return this plan with new states of some runs, by key; its cost grows with their number only."""
        items, missing = list(self.items), self.lacking
        for key, item in current.items():
            position = self.indices[key]
            missing += (item.state != "done") - (items[position].state != "done")
            items[position] = item
        changed = PointPlan(self.shared, tuple(items), None)
        # As the cached properties would give: counting all runs after each one would take quadratic time.
        changed.__dict__.update(indices=self.indices, lacking=missing)
        return changed

    @property
    def decision(self) -> Decision | None:
        """Statistics of the replicates; None until all are done."""
        return None if self.ended is None else self.ended.decision


@dataclass(frozen=True)
class Forecast:
    """Time [s] and disk [bytes] that are still needed.

    Args:
        seconds: Wall time [s].
        disk: Disk space [bytes].
        grain_steps: Number of grain-steps.
        speed: Grain-steps per second of one worker.
        workers: Number of workers: ensembles that are stepped at the same time.
        basis: Basis of the speed, in words.
        compiling: Part of the time [s] for Specs with which no run of this study has been made.
        sets: Number of these Specs.
    """

    seconds: float
    disk: float
    grain_steps: float
    speed: float
    workers: int
    basis: str
    compiling: float = 0.0
    sets: int = 0

    @property
    def lanes(self) -> int:
        """Number of workers, under the name that scripts and `labbook plan --json` use."""
        return self.workers


@dataclass(frozen=True, eq=False)
class Plan:
    """All runs of a study with their states; with a forecast and warnings if they were requested.

    Args:
        study: The study.
        backend: Capabilities of the backend.
        points: Plan of each point.
        rule: Stopping rule of the replicates.
        forecast: Time and disk still needed.
        warnings: Warnings with file, key and remedy.
        pilot: Plan of the pilot that runs first, if there is one.
        lab: Folder of the lab.
        campaign: Proposals of the study's strategy with their reasons, as lines; empty without a strategy.
        shares: Labels of points, by the cheapest number of discharges of a bed with its reason; empty if the study
            states the number.
        stops: Labels of points, by stops so far and replicates expected; empty without `accuracy.clogging`.
    """

    study: Study
    backend: Capabilities
    points: tuple[PointPlan, ...]
    rule: StoppingRule
    forecast: Forecast | None = None
    warnings: tuple[str, ...] = ()
    pilot: "Plan | None" = None
    lab: Path | None = None
    campaign: tuple[str, ...] = ()
    shares: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    stops: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @cached_property
    def items(self) -> list[Item]:
        """All runs: the first seed of every point, then the second, and so on."""
        items_of_points = [item for point in self.points for item in point.items]
        return sorted(items_of_points, key=place_in_order)

    @cached_property
    def todo(self) -> list[Item]:
        """Runs that are not done; a run that several points share comes once."""
        waiting: dict[str, Item] = {}
        for item in self.items:
            if item.state != "done":
                waiting.setdefault(item.keys.run, item)
        return list(waiting.values())

    @cached_property
    def fillings(self) -> dict[str, Item]:
        """One run for each packing that is missing, by packing key."""
        return {item.keys.packing: item for item in reversed(self.todo) if not item.packed}

    def counts(self) -> Counter[str]:
        """Number of runs by state."""
        return Counter(item.state for item in self.items)

    def frame(self) -> "pd.DataFrame":
        """Table with one row for each run.

        Returns:
            Columns: `point` (from 1), swept keys [SI, units in `attrs`], `label`, `seed`, `discharge` (if beds have
                several), `state`, `reason`, `outcome`, `run_key`, `packed` (its packing is in the lab).
        """
        import pandas as pd

        rows = []
        for item in self.items:
            point = item.demand.point
            head = {"point": point.index + 1, **point.at, "label": point.label, "seed": item.demand.seed}
            head |= {} if self.study.discharges_per_bed == 1 else {"discharge": item.demand.discharge}
            state = {"state": item.state, "reason": item.reason, "outcome": item.outcome}
            rows.append({**head, **state, "run_key": item.keys.run, "packed": item.packed})
        frame = pd.DataFrame(rows)
        frame.attrs = {"study": self.study.name, "units": self.study.units}
        return frame

    def __repr__(self) -> str:
        return "\n".join([f"<Plan of {self.study.name} on {self.backend.name}>", *self.lines()])

    def _repr_html_(self) -> str:
        counts, cells = self.counts(), []
        for point in self.points:
            states = Counter(item.state for item in point.items)
            numbers = "".join(f"<td>{states[state] or ''}</td>" for state in _STATES if counts[state])
            cells.append(f'<tr><td style="text-align:left">{escape(point.shared.point.label)}</td>{numbers}</tr>')
        hidden = len(cells) - _MAX_SHOWN
        if hidden > 0:
            cells[_MAX_SHOWN:] = [f"<tr><td>and {hidden} more points</td></tr>"]
        heads = "".join(f"<th>{state}</th>" for state in _STATES if counts[state])
        lines = "".join(f"<div>{escape(line)}</div>" for line in self.lines())
        return (
            f"<div><b>{escape(self.study.name)}</b> on {escape(self.backend.name)}</div>"
            f"<table><thead><tr><th>point</th>{heads}</tr></thead><tbody>{''.join(cells)}</tbody></table>{lines}"
        )

    def lines(self) -> list[str]:
        """Format states, forecast and warnings as lines."""
        counts = self.counts()
        ahead, lines = self.forecast, [", ".join(f"{counts[state]} {state}" for state in _STATES if counts[state])]
        if self.rule.tolerance is not None:
            if self.rule.sequential:
                precision = percent(self.rule.tolerance)
                lines.append(f"Up to {self.rule.cap} replicates per point, until the flow rate is known to {precision}")
            lines += self._numerics_lines()
            lines += [f"Discharges: {line}" for line in _at_points(self.shares)]
        if (error := self.study.accuracy.clogging) is not None:
            until = f"{events_needed(error)} stops are counted (q to {percent(error)})"
            lines.append(f"Up to {self.rule.cap} replicates per point, until {until}")
            lines += [f"Stops: {line}" for line in _at_points(self.stops)]
        lines += _at_points(derived(self.study.points), len(self.study.points))
        lines += mesh_lines(point.shared.scene for point in self.points)
        if "flow_rate" in self.study.measure:
            lines.append(f"Flow rates from {window_in_words(self.study.window)}")
        lines += filter(None, [recorded_in_words(point.shared for point in self.points)])
        lines += self._ends()
        lines += self.campaign
        if self.pilot is not None and self.pilot.todo and self.pilot.forecast is not None:
            runs = f"{len(self.pilot.todo)} run{'' if len(self.pilot.todo) == 1 else 's'}"
            lines.append(f"Before that, the pilot: {runs}, {self.pilot._cost(self.pilot.forecast)}")
        if self.todo and ahead is not None:
            lines.append(self._cost(ahead))
            if ahead.compiling:
                sets = "set of features" if ahead.sets == 1 else "sets of features"
                cached = f"Of that about {duration(ahead.compiling)} for compiling {ahead.sets} {sets}"
                lines.append(f"{cached}, unless it is cached")
        lost = {one.keys.packing: one for one in reversed(self.todo) if one.reason.startswith(_FAILED_PREFIX)}
        failed = [
            f"seed {one.demand.seed}: {one.reason.removeprefix(_FAILED_PREFIX)}" for one in reversed(lost.values())
        ]
        lines += [f"A filling failed before and will be tried again: {why}" for why in grouped(failed)]
        return lines + [f"Warning: {line}" for line in self.warnings]

    def _ends(self) -> list[str]:
        """Line on the ends of runs, by times that the study leaves to labbook."""
        stops, stop_settings = [point.shared.stop for point in self.points], self.study.stop
        endings = []
        if stop_settings.stall is None and any(
            point.shared.scene.container.outlet_plane is not None for point in self.points
        ):
            stalls = value_range([stop.stall for stop in stops], "s")
            endings.append(f"{stalls} after the last grain, as clogged (stop.stall)")
        if stop_settings.max_time is None:
            endings.append(
                f"at the latest {value_range([stop.max_time for stop in stops], 's')} after the opening (stop.max_time)"
            )
        return [f"Runs end {'; '.join(endings)}"] if endings else []

    def _cost(self, ahead: Forecast) -> str:
        making = f"{len(self.fillings)} packing{'' if len(self.fillings) == 1 else 's'} to make"
        packings = making if self.fillings else "all packings are done"
        cost = f"about {duration(ahead.seconds)} on {ahead.workers} worker{'' if ahead.workers == 1 else 's'}"
        return f"{packings}; {cost} ({ahead.basis}), {size(ahead.disk)} on disk"

    def _numerics_lines(self) -> list[str]:
        """Lines on numerics chosen for the requested error, one for all points that share them."""
        groups: dict[str, tuple[str, ...]] = {}
        for point in (one.shared.point for one in self.points):
            choice = point.choice
            if choice is not None:
                scatter = scatter_of_beds(choice.scatter, discharges(self.study)[0])
                needed = stopping_rule(self.study, point).forecast(scatter)
                alone = " of one discharge" if self.study.discharges_per_bed == AUTO else ""
                cap = f" (accuracy.max_replicates is {self.rule.cap})" if needed == self.rule.cap else ""
                bias = f"{percent(choice.bias.value, '+.2f')} +- {percent(choice.bias.half_width, '.2f')}"
                summary = (
                    f"dt = {choice.dt * 1e6:.3g} us, stiffness_scale = {choice.stiffness_scale:g}, precision = "
                    f"{choice.precision}: they change the flow "
                )
                summary += (
                    f"rate by {bias}, which leaves {percent(choice.remainder, '.2f')} for the scatter; "
                    f"{needed} replicates{alone} expected{cap}"
                )
                if choice.usual is not None:
                    ratio = percent(choice.over_usual, ".0f")
                    summary += f"; {ratio} of the steps that {choice.usual * 1e6:.3g} us would take if it had no bias"
                line = f"Chosen for {percent(choice.tolerance)}: {summary} ({choice.source})"
                groups[line] = (*groups.get(line, ()), point.label)
            elif point.unchosen:
                step = f"dt = {point.numerics.dt * 1e6:.3g} us, whose bias is not known"
                if self.study.source:
                    measure = command("pilot", self.study.path, lab=self.lab, backend=self.backend.name)
                else:
                    measure = "lab.pilot(study, seeds=8)"
                phrase = f"{measure} measures it"
                if point.wants_pilot:
                    phrase = "labbook run first measures it by a pilot and chooses again"
                if has_groups(point.scene):
                    why = f"Not calibrated: {point.unchosen}; {step} ({phrase})"
                else:
                    why = f"Cannot be calibrated: {point.unchosen}; {step}"
                groups[why] = (*groups.get(why, ()), point.label)
        return _at_points(groups)


def _at_points(groups: Mapping[str, Sequence[str]], points: int = 0) -> list[str]:
    """Format lines with the labels of their points; without labels for a single line, or one for all `points`
    points."""
    if len(groups) == 1 and not points:
        return list(groups)
    return [
        line if len(at) == points else f"{line}; at {'; '.join(at[:3])}{' ...' * (len(at) > 3)}"
        for line, at in groups.items()
    ]


_FAILED_PREFIX = "its packing failed: "
"""Beginning of the reason of a run whose filling failed before."""
_STATES: tuple[State, ...] = ("done", "missing", "partial", "stale")
_LISTING_FROM = 100
"""Number of runs up to which folders are looked up one by one: listing a large lab takes longer."""
_MAX_SHOWN = 30
"""Maximum number of points that are shown singly."""


def done_and_demanded(points: Iterable[PointPlan], holds: Callable[[Demand], bool]) -> tuple[int, int]:
    """Count the runs of a part that are done, and those that are demanded; a run that several points share counts
    once."""
    items = (item for point in points for item in point.items)
    demanded = {item.keys.run: item for item in items if holds(item.demand)}
    return sum(item.state == "done" for item in demanded.values()), len(demanded)


class Planner:
    """Compares demanded runs with the lab, and asks strategies for further ones.

    Args:
        study: The study, with the points that its strategy has proposed so far.
        catalogue: Index of the lab.
        backend: Capabilities of the backend.
        packings_of: Backend whose packings the runs start from; None: `backend` makes its own.
        writes: Store the proposals of the study's strategy in the lab.
    """

    def __init__(
        self,
        study: Study,
        catalogue: Catalogue,
        backend: Capabilities,
        packings_of: PackingsOf | None = None,
        *,
        writes: bool = False,
    ):
        self.study, self.catalogue, self.backend, self.packings_of = study, catalogue, backend, packings_of
        self.campaign = campaign_of(study, catalogue.lab, backend.name, writes)
        self._adds_replicates = True
        self._entries: dict[str, Entry] = {}
        self._older_entries: dict[str, Entry] = {}
        self._installed_entries: dict[str, Entry] = {}
        """Runs by the installed version of the backend, by lineage; their keys may differ."""
        self._outdated: dict[str, str] = {}
        """Changes of laws and walls since a run was made, by lineage."""

    def plan(self) -> Plan:
        """Plan the whole study. Raises Conflict or MeasureError if observations cannot be made."""
        planned: dict[int, PointPlan] = {}
        if self.campaign is None:
            planned = {point.shared.point.index: point for point in self._with_first_runs(self.points)}
        while new := self.proposed(planned):
            planned |= {point.shared.point.index: point for point in new}
        return self._plan_of(tuple(planned[index] for index in sorted(planned)))

    def proposed(self, points: Mapping[int, PointPlan]) -> list[PointPlan]:
        """Ask the study's strategy for further runs.

        Args:
            points: Present plans of points, by index.

        Returns:
            Plans of points that are new, or need more replicates; empty if there are none so far.

        Raises:
            StudyError: A proposed point is invalid.
        """
        if self.campaign is None or not self._adds_replicates:
            return []
        self.campaign.advance(lambda generation: self._trials(generation, points))
        self._update_study()
        replicates = {index: point.shared.point.replicates for index, point in points.items()}
        changed = [shared for shared in self.points if replicates.get(shared.point.index) != shared.point.replicates]
        return self._with_first_runs(changed)

    def _update_study(self) -> None:
        """Add all points that are proposed so far to the study."""
        assert self.campaign is not None
        assignments = self.campaign.assignments
        if [point.replicates for point in self.study.points] != [assignment.replicates for assignment in assignments]:
            self.study = with_points(self.campaign.study, assignments)
            self.__dict__.pop("points", None)

    def _trials(self, generation: Generation, points: Mapping[int, PointPlan]) -> tuple[Trial, ...] | None:
        """Runs of a generation with their numbers; None until all are done. `points`: present plans, by index."""
        self._update_study()
        assert self.campaign is not None
        point_keys = [point_key(assignment.at) for assignment in self.campaign.assignments]
        shared = dict(zip(point_keys, self.points, strict=True))
        runs: list[tuple[Assignment, Item]] = []
        for assignment in generation.assignments:
            point = points.get(shared[point_key(assignment.at)].point.index)
            # Plans may be older than the generation, which can ask for more replicates of a point.
            if point is None or point.items[-1].demand.seed < assignment.replicates:
                (point,) = self._with_first_runs([shared[point_key(assignment.at)]])
            assigned = [item for item in point.items if item.demand.seed <= assignment.replicates]
            runs += [(assignment, item) for item in assigned]
            if any(item.state != "done" for item in assigned):
                return None
        keys = [item.keys for _, item in runs]
        numbers = self._numbers([of.run for of in keys])
        times = self.catalogue.device_times([of.run for of in keys], {of.packing for of in keys})
        return tuple(
            Trial(
                assignment.at,
                item.demand.seed,
                item.keys.run,
                item.outcome or "",
                numbers[item.keys.run],
                item.demand.discharge,
                {key: times.get(key) for key in (item.keys.run, item.keys.packing)},
            )
            for assignment, item in runs
        )

    def _numbers(self, run_keys: list[str]) -> dict[str, dict[str, float]]:
        """All measured numbers of runs, by run key and quantity."""
        study, numbers = self.study, {key: dict[str, float]() for key in run_keys}
        for measure in (MEASURES[name] for name in study.measure):
            for quantity in dict.fromkeys((*measure.declared, *measure.quantities(study.points[0].scene))):
                suspects = study.accuracy.count_suspect
                values = self.catalogue.values(
                    run_keys, quantity.name, measure.version, study.window, suspects=suspects
                )
                for key, value in values.items():
                    numbers[key][quantity.name] = value
                if quantity.estimator == "rate":
                    exposures = self.catalogue.values(
                        run_keys, quantity.name, measure.version, study.window, suspects=suspects, exposures=True
                    )
                    for key, value in exposures.items():
                        numbers[key][f"{quantity.name}{EXPOSURE}"] = value
        return numbers

    def _with_first_runs(self, points: Iterable[PointDemand]) -> list[PointPlan]:
        """Plan points with their first runs, and the replicates that follow."""
        first = {shared: self._with_keys(self._first(shared)) for shared in points}
        listed = self._look_up(pair for pairs in first.values() for pair in pairs)
        return [
            self._extended(PointPlan(shared, tuple(self._item(*pair, listed) for pair in pairs), None))
            for shared, pairs in first.items()
        ]

    def _plan_of(self, points: tuple[PointPlan, ...]) -> Plan:
        lines = () if self.campaign is None else tuple(self.campaign.lines)
        rule, lab = stopping_rule(self.study), self.catalogue.lab.folder
        return Plan(self.study, self.backend, points, rule, lab=lab, campaign=lines)

    def of_base(self, base: Plan) -> Plan:
        """Plan here what another lab lacks; what is done there stays done, and no replicates are added."""
        self._adds_replicates = False
        listed = self._look_up((item.demand, item.keys) for item in base.todo)
        points = tuple(
            self._updated(point, [item for item in point.items if item.state != "done"], listed)
            for point in base.points
        )
        return replace(base, points=points)

    def plan_runs(self, repeats: Mapping[int, Iterable[tuple[int, int]]]) -> Plan:
        """Plan given runs alone, by index of their point, seed and discharge; no replicates are added."""
        self._adds_replicates = False
        pairs_by_point = {
            shared: self._with_keys(shared.run(*repeat) for repeat in repeats.get(shared.point.index, ()))
            for shared in self.points
        }
        listed = self._look_up(pair for pairs in pairs_by_point.values() for pair in pairs)
        planned = (
            PointPlan(shared, tuple(self._item(*pair, listed) for pair in pairs), None)
            for shared, pairs in pairs_by_point.items()
        )
        return self._plan_of(tuple(planned))

    def after(self, points: Mapping[int, PointPlan], done: Mapping[int, Collection[str]]) -> list[PointPlan]:
        """Plan points again after some of their runs were done.

        Only these runs are looked up: looking up all replicates after each run would take time that grows with the
        square of their number.

        Args:
            points: Former plans of points, by index.
            done: Keys of the runs that were done, by index of the point.

        Returns:
            New plans of the points.
        """
        items_by_point = {
            index: [points[index].items[points[index].indices[key]] for key in keys] for index, keys in done.items()
        }
        listed = self._look_up((item.demand, item.keys) for items in items_by_point.values() for item in items)
        return [self._updated(points[index], items, listed) for index, items in items_by_point.items()]

    def point(self, previous: PointPlan) -> PointPlan:
        """Plan one point again after other processes may have done some of its runs."""
        waiting = [item for item in previous.items if item.state != "done"]
        return self._updated(previous, waiting, self._look_up((item.demand, item.keys) for item in waiting))

    def _updated(self, previous: PointPlan, items: Iterable[Item], listed: LabListing | None) -> PointPlan:
        """Plan a point again with new states of the runs `items`, and the replicates that follow."""
        return self._extended(
            previous.with_items({item.keys.run: self._item(item.demand, item.keys, listed) for item in items})
        )

    @cached_property
    def points(self) -> list[PointDemand]:
        """Demands of all points of the study."""
        return [PointDemand(self.study, point, self.packings_of) for point in self.study.points]

    def refresh(self, item: Item) -> Item:
        """Look up one run in its folder, past the catalogue."""
        return self._assess(item.demand, item.keys, self._read_entry(item.keys.run))

    def _first(self, shared: PointDemand) -> list[Demand]:
        return list(shared.runs(stopping_rule(self.study, shared.point).first, discharges(self.study)[0]))

    def _extended(self, plan: PointPlan) -> PointPlan:
        """Add proposed replicates to a plan while all its runs are done."""
        while self._adds_replicates and not plan.lacking:
            shared, items = plan.shared, plan.items
            proposal = self._replicates(shared.point, items)
            if proposal.state == "end":
                return PointPlan(shared, items, proposal)
            (assigned,) = proposal.assignments
            numbers = {item.demand.number for item in items}
            assigned_runs = shared.runs(assigned.replicates, assigned.discharges)
            added = self._with_keys(run for run in assigned_runs if run.number not in numbers)
            listed = self._look_up(added)
            plan = PointPlan(shared, (*items, *(self._item(*pair, listed) for pair in added)), None)
        return plan

    def _replicates(self, point: Point, items: Sequence[Item]) -> Proposal:
        """Propose replicates of a point all of whose runs are done: as many as any requested error needs."""
        strategies = self._strategies(point, items)
        if not strategies:
            return _NO_MORE
        history = History(self.study, (Generation(0, (), "", self._trials_of(point, items)),), (), 1)
        proposals = [strategy.propose(history) for strategy in strategies]
        reason = "; ".join(proposal.reason for proposal in proposals if proposal.reason)
        decision = next((proposal.decision for proposal in proposals if proposal.decision is not None), None)
        assigned = [assignment for proposal in proposals for assignment in proposal.assignments]
        if not assigned:
            return Proposal((), reason, "end", decision)
        replicates, discharges_per_bed = (
            max(proposal.replicates for proposal in assigned),
            max(proposal.discharges for proposal in assigned),
        )
        return Proposal((Assignment(point.at, replicates, discharges_per_bed),), reason, decision=decision)

    def _strategies(self, point: Point, items: Sequence[Item]) -> list[Replicates | Stops]:
        """Strategies that add replicates to a point, one for each requested error."""
        rule, strategies = stopping_rule(self.study, point), list[Replicates | Stops]()
        if rule.tolerance is not None:
            scatter = None if point.choice is None else point.choice.scatter
            filling = self._filling_cost(items) if self.study.discharges_per_bed == AUTO else None
            strategies.append(Replicates.of(rule=rule, scatter=scatter, filling=filling))
        if (error := self.study.accuracy.clogging) is not None:
            strategies.append(Stops.of(error=error, cap=rule.cap))
        return strategies

    def _trials_of(self, point: Point, items: Sequence[Item]) -> tuple[Trial, ...]:
        """Runs of a point with the numbers on which its replicates depend."""
        keys, numbers = [item.keys.run for item in items], dict[str, dict[str, float]]()
        for quantity, values in (
            (QUANTITY, flow_rates(self.study, self.catalogue, keys)),
            (COUNT, self._stops(keys)),
        ):
            for key, value in values.items():
                numbers.setdefault(key, {})[quantity] = value
        return tuple(
            Trial(
                point.at,
                item.demand.seed,
                item.keys.run,
                item.outcome or "",
                numbers.get(item.keys.run, {}),
                item.demand.discharge,
            )
            for item in items
        )

    def _stops(self, run_keys: Sequence[str]) -> dict[str, float]:
        """Number of stops by run; empty unless an error of their probability is requested."""
        if self.study.accuracy.clogging is None:
            return {}
        version, suspects = MEASURES[NAME].version, self.study.accuracy.count_suspect
        return self.catalogue.values(run_keys, COUNT, version, self.study.window, suspects=suspects)

    def stops_in_words(self, point: PointPlan) -> str:
        """Describe the number of stops of a point's runs, and of replicates expected."""
        shared, error = point.shared, self.study.accuracy.clogging
        assert error is not None
        items = [item for item in point.items if item.state == "done"]
        strategy = Stops.of(error=error, cap=stopping_rule(self.study, shared.point).cap)
        stops_so_far = stops(self._trials_of(shared.point, items))
        return strategy.in_words(stops_so_far, len({item.demand.seed for item in items}))

    def _filling_cost(self, items: Sequence[Item]) -> float:
        """Cost of a filling of a point, in discharges, from its finished runs."""
        first = [(item.keys.run, item.keys.packing) for item in items if item.demand.discharge == 1]
        return filling_cost(self.catalogue.lab, first, self._points_by_packing[items[0].keys.packing])

    @cached_property
    def _points_by_packing(self) -> Counter[str]:
        """Number of points that start from a packing, by its key, for the first bed of each point."""
        return Counter(shared.run(1).keys(self.backend).packing for shared in self.points)

    def shares_in_words(self, point: PointPlan, expected: float) -> str:
        """Describe the variance of a point's flow rate between beds and within them, and the cheapest number of
        discharges.

        Args:
            point: Plan of the point.
            expected: Cost of a filling, in discharges, until one is made.
        """
        shared, rule = point.shared, stopping_rule(self.study, point.shared.point)
        items = [item for item in point.items if item.state == "done"]
        rates = flow_rates(self.study, self.catalogue, [item.keys.run for item in items])
        values = [(item.demand.seed, rates[item.keys.run]) for item in items if item.keys.run in rates]
        if len(beds := by_bed(values)) < 2:
            choice, sharing = shared.point.choice, self._points_by_packing[point.items[0].keys.packing]
            scatter = math.nan if choice is None else choice.scatter
            return in_words(rule, 1.0, replace(TYPICAL, scatter=scatter), expected / sharing)
        means = of_beds(beds)
        return in_words(rule, sum(means) / len(means), shares(beds), self._filling_cost(items))

    def _with_keys(self, demands: Iterable[Demand]) -> list[tuple[Demand, Keys]]:
        return [(demand, demand.keys(self.backend)) for demand in demands]

    def _look_up(self, pairs: Iterable[tuple[Demand, Keys]]) -> LabListing | None:
        """Look up runs in the catalogue. Returns a listing of the lab if they are many, None if they are few."""
        pairs = list(pairs)
        keys = [keys for _, keys in pairs]
        for entry in self.catalogue.entries(
            [keys_of_run.run for keys_of_run in keys], [keys_of_run.lineage for keys_of_run in keys]
        ):
            self._entries[entry.run_key] = entry
            if entry.coverage is not None:
                installed = entry.cache_version == self.backend.cache_version
                (self._installed_entries if installed else self._older_entries)[entry.lineage_key] = entry
        self._look_up_outdated(pairs)
        return LabListing.of(self.catalogue.lab) if len(keys) > _LISTING_FROM else None

    def _look_up_outdated(self, pairs: Iterable[tuple[Demand, Keys]]) -> None:
        """Look up earlier versions of missing runs, made with older versions of laws and walls."""
        lacking = [pair for pair in pairs if pair[0].shared.versions and pair[1].run not in self._entries]
        if not lacking or not self.catalogue.counts():  # keys by older versions take time, and an empty lab has no run
            return
        lineages: dict[str, tuple[str, str]] = {}
        for demand, keys in lacking:
            for lineage, outdated in demand.older_lineages(self.backend.name):
                lineages.setdefault(lineage, (keys.lineage, outdated))
        indexed = {one.lineage_key for one in self.catalogue.entries((), lineages) if one.coverage is not None}
        for lineage, (lineage_now, outdated) in lineages.items():
            if lineage in indexed:
                self._outdated.setdefault(lineage_now, outdated)

    def _item(self, demand: Demand, keys: Keys, listed: LabListing | None) -> Item:
        entry = self._entries.get(keys.run)
        if entry is None and listed is not None and keys.run not in listed.runs:
            return self._assess(demand, keys, None, listed)
        if entry is None or entry.stamp != stamp(self.catalogue.lab.run(keys.run)):
            entry = self._read_entry(keys.run)
        return self._assess(demand, keys, entry, listed)

    def _assess(self, demand: Demand, keys: Keys, entry: Entry | None, listed: LabListing | None = None) -> Item:
        state, reason = self._compare(demand, keys, entry, listed)
        outcome = entry.outcome if entry else None
        # Reading a packing takes long: it is done only where it may exist, or decides about a finished run.
        problem: str | None = "is not there"
        if listed is None or keys.packing in listed.packings or state == "done":
            problem = self.catalogue.packing_problem(keys.packing)
        if problem and state == "done":
            state, reason = "missing", f"its packing cannot be read: {problem}"
        return Item(demand, keys, state, reason, outcome, problem is None, entry.suspect if entry else "")

    def _compare(self, demand: Demand, keys: Keys, entry: Entry | None, listed: LabListing | None) -> tuple[State, str]:
        if entry is None:
            is_begun = listed is None or keys.run in listed.work
            is_begun = is_begun and (self.catalogue.lab.work(keys.run) / PROGRESS).exists()
            # A checkpoint counts first: work may have started again after a new version made the finished run stale.
            older = self._older_entries.get(keys.lineage)
            if is_begun:
                return "partial", "started, goes on from its checkpoint"
            if older:
                made_by_version, name = older.cache_version, self.backend.name
                return (
                    "stale",
                    f"made by version {made_by_version} of {name}, now at version {self.backend.cache_version}",
                )
            if outdated := self._outdated.get(keys.lineage):
                return "stale", outdated
            if edited := self._edited_sources(demand, keys):
                return "stale", edited
            failure = (
                self._filling_failure(demand, keys.packing) if listed is None or keys.packing in listed.work else ""
            )
            return "missing", f"{_FAILED_PREFIX}{failure}" if failure else "not run yet"
        if entry.coverage is None:
            return "missing", f"cannot be read: {entry.problem}"
        shared = demand.shared
        lacks = shortfall(
            entry.outcome,
            entry.coverage,
            shared.stop,
            demand.guards,
            shared.probe_names,
            demand.recording,
            shared.default_names,
        )
        return ("partial", lacks) if lacks else ("done", entry.outcome)

    def _edited_sources(self, demand: Demand, keys: Keys) -> str:
        """Describe extensions whose source has changed since the run was made; empty if none has."""
        installed, entry = demand.shared.versions, self._installed_entries.get(keys.lineage)
        if entry is None or not identity.hashed(installed):
            return ""
        return identity.outdated(made_by(self.catalogue.lab, entry), installed)

    def _filling_failure(self, demand: Demand, packing: str) -> str:
        """Reason of an earlier failure of a filling; empty if there is none, or if a longer filling may now succeed."""
        folder = self.catalogue.lab.work(packing)
        failure = FillingFailure.read(folder)
        if failure is not None:
            may_succeed = failure.max_time is not None and demand.shared.longest_filling > failure.max_time
            return "" if may_succeed else failure.why
        try:
            progress = Progress.read(folder)
        except Unreadable:
            return ""
        return progress.failed if progress else ""

    def _read_entry(self, key: str) -> Entry | None:
        """Entry of a run read from its folder, which changed since it was indexed, or was not indexed."""
        folder = self.catalogue.lab.run(key)
        if not folder.is_dir():
            return None
        folder_stamp = stamp(folder)
        try:
            record, _ = open_run(folder)
        except Unreadable as problem:
            return Entry(key, "", 0, "unreadable", None, str(problem), folder_stamp)
        return Entry.of(record, folder_stamp)


def flow_rates(study: Study, catalogue: Catalogue, run_keys: Sequence[str]) -> dict[str, float]:
    """Return the flow rates [kg/s] by run key; runs without one (clogged, diverged, suspect) are left out."""
    version, suspects = MEASURES[QUANTITY].version, study.accuracy.count_suspect
    return catalogue.values(run_keys, QUANTITY, version, study.window, suspects=suspects)


_NO_MORE = Proposal.end("")
"""Proposal for points that have all replicates that the study states."""
