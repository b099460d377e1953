"""What is done of a study, what is missing, partial or stale, and why; and whether a backend can do what is planned."""

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
from labbook.campaign import Assignment, Generation, History, Proposal, Replicates, Stops, Trial, place
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
"""`partial`: begun, or covers less than is asked. `stale`: made by another version of the backend, or by an older
one of the law or of a wall."""


@dataclass(frozen=True, eq=False, slots=True)
class Item:
    """One run of a study: how it stands, and why."""

    demand: Demand
    keys: Keys
    state: State
    reason: str
    outcome: str | None
    packed: bool
    """Whether its packing is there."""
    suspect: str = ""
    """Why the run is suspect (`labbook.lab.suspect`); empty if it is not."""

    @property
    def counts(self) -> bool:
        """Whether the run, once it is done, takes part in means and fits."""
        return counts(self.outcome or "", self.suspect, self.demand.shared.study.accuracy.count_suspect)


def place_in_order(item: Item) -> tuple[int, int, int]:
    """The place of a run in the order in which runs are begun: the first discharge of the first bed of every point, its
    further discharges, then the second bed, and so on."""
    return *item.demand.number, item.demand.point.index


@dataclass(frozen=True, eq=False)
class PointPlan:
    """The runs of one point that are asked for so far. `ended`: why no more replicates are added, with the statistics
    that it rests on; None until all runs are done."""

    shared: PointDemand
    items: tuple[Item, ...]
    ended: Proposal | None

    @cached_property
    def places(self) -> dict[str, int]:
        """Place of each run among `items`, by its key."""
        return {item.keys.run: place for place, item in enumerate(self.items)}

    @cached_property
    def lacking(self) -> int:
        """Number of runs that are not done."""
        return sum(item.state != "done" for item in self.items)

    def with_items(self, now: Mapping[str, Item]) -> "PointPlan":
        """Return this plan with some of its runs as they are now, by key; the time that it takes is theirs."""
        items, lacking = list(self.items), self.lacking
        for key, item in now.items():
            place = self.places[key]
            lacking += (item.state != "done") - (items[place].state != "done")
            items[place] = item
        changed = PointPlan(self.shared, tuple(items), None)
        changed.__dict__.update(places=self.places, lacking=lacking)  # as the cached properties would give
        return changed

    @property
    def decision(self) -> Decision | None:
        """The statistics of its replicates; None until all of them are done."""
        return None if self.ended is None else self.ended.decision


@dataclass(frozen=True)
class Forecast:
    """Time [s] and disk [bytes] still needed; `basis` says what the speed rests on."""

    seconds: float
    disk: float
    grain_steps: float
    speed: float
    """Grain-steps per second of one lane."""
    lanes: int
    basis: str
    compiling: float = 0.0
    """Part of the time [s] for sets of features that no run of this study was computed with yet."""
    sets: int = 0
    """How many of these there are."""


@dataclass(frozen=True, eq=False)
class Plan:
    """All runs of a study, as they stand; what they will cost and what the study may well want otherwise, if that was
    foreseen."""

    study: Study
    backend: Capabilities
    points: tuple[PointPlan, ...]
    rule: StoppingRule
    forecast: Forecast | None = None
    warnings: tuple[str, ...] = ()
    """With file, key and remedy."""
    pilot: "Plan | None" = None
    """Of the pilot that runs first, if that was foreseen and there is one."""
    lab: Path | None = None
    """Folder of the lab that was looked at."""
    campaign: tuple[str, ...] = ()
    """What its strategy has proposed and why, line by line; empty if it names none."""
    shares: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """By which number of discharges of a bed is cheapest, and why: the labels of the points that it is so at. Empty if
    that was not foreseen, or the study states the number."""
    stops: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Stops so far and replicates expected: the labels of the points. Empty without `accuracy.clogging`."""

    @cached_property
    def items(self) -> list[Item]:
        """All runs: the first seed of every point, then the second, and so on."""
        every = [item for point in self.points for item in point.items]
        return sorted(every, key=place_in_order)

    @cached_property
    def todo(self) -> list[Item]:
        """Runs that are not done; one that several points share comes once."""
        waiting: dict[str, Item] = {}
        for item in self.items:
            if item.state != "done":
                waiting.setdefault(item.keys.run, item)
        return list(waiting.values())

    @cached_property
    def fillings(self) -> dict[str, Item]:
        """One run for each packing that is still to be made, by packing key."""
        return {item.keys.packing: item for item in reversed(self.todo) if not item.packed}

    def counts(self) -> Counter[str]:
        """Number of runs by state."""
        return Counter(item.state for item in self.items)

    def frame(self) -> "pd.DataFrame":
        """A row a run: `point` (from 1), what was swept [SI, units in `attrs`], `label`, `seed`, `discharge` (where
        beds have several), `state`, `reason`, `outcome`, `run_key`, `packed` (whether its packing is there)."""
        import pandas as pd

        rows = []
        for item in self.items:
            point = item.demand.point
            head = {"point": point.index + 1, **point.at, "label": point.label, "seed": item.demand.seed}
            head |= {} if self.study.discharges_per_bed == 1 else {"discharge": item.demand.discharge}
            how = {"state": item.state, "reason": item.reason, "outcome": item.outcome}
            rows.append({**head, **how, "run_key": item.keys.run, "packed": item.packed})
        made = pd.DataFrame(rows)
        made.attrs = {"study": self.study.name, "units": self.study.units}
        return made

    def __repr__(self) -> str:
        return "\n".join([f"<Plan of {self.study.name} on {self.backend.name}>", *self.lines()])

    def _repr_html_(self) -> str:
        counts, cells = self.counts(), []
        for point in self.points:
            states = Counter(item.state for item in point.items)
            numbers = "".join(f"<td>{states[state] or ''}</td>" for state in _STATES if counts[state])
            cells.append(f'<tr><td style="text-align:left">{escape(point.shared.point.label)}</td>{numbers}</tr>')
        more = len(cells) - _SHOWN
        if more > 0:
            cells[_SHOWN:] = [f"<tr><td>and {more} more points</td></tr>"]
        heads = "".join(f"<th>{state}</th>" for state in _STATES if counts[state])
        lines = "".join(f"<div>{escape(line)}</div>" for line in self.lines())
        return (
            f"<div><b>{escape(self.study.name)}</b> on {escape(self.backend.name)}</div>"
            f"<table><thead><tr><th>point</th>{heads}</tr></thead><tbody>{''.join(cells)}</tbody></table>{lines}"
        )

    def lines(self) -> list[str]:
        """How the runs stand, what is foreseen, and the warnings, line by line."""
        counts = self.counts()
        ahead, lines = self.forecast, [", ".join(f"{counts[state]} {state}" for state in _STATES if counts[state])]
        if self.rule.tolerance is not None:
            if self.rule.sequential:
                known = percent(self.rule.tolerance)
                lines.append(f"Up to {self.rule.cap} replicates per point, until the flow rate is known to {known}")
            lines += self._chosen()
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
        lost = {one.keys.packing: one for one in reversed(self.todo) if one.reason.startswith(_FAILED)}
        failed = [f"seed {one.demand.seed}: {one.reason.removeprefix(_FAILED)}" for one in reversed(lost.values())]
        lines += [f"A filling failed before and will be tried again: {why}" for why in grouped(failed)]
        return lines + [f"Warning: {line}" for line in self.warnings]

    def _ends(self) -> list[str]:
        """When runs end, by the times that the study leaves to labbook."""
        stops, stated = [point.shared.stop for point in self.points], self.study.stop
        said = []
        if stated.stall is None and any(point.shared.scene.container.outlet_plane is not None for point in self.points):
            stalls = value_range([stop.stall for stop in stops], "s")
            said.append(f"{stalls} after the last grain, as clogged (stop.stall)")
        if stated.max_time is None:
            said.append(
                f"at the latest {value_range([stop.max_time for stop in stops], 's')} after the opening (stop.max_time)"
            )
        return [f"Runs end {'; '.join(said)}"] if said else []

    def _cost(self, ahead: Forecast) -> str:
        making = f"{len(self.fillings)} packing{'' if len(self.fillings) == 1 else 's'} to make"
        packings = making if self.fillings else "all packings are done"
        cost = f"about {duration(ahead.seconds)} on {ahead.lanes} lane{'' if ahead.lanes == 1 else 's'}"
        return f"{packings}; {cost} ({ahead.basis}), {size(ahead.disk)} on disk"

    def _chosen(self) -> list[str]:
        """The numerics that were chosen for the requested error, one line for all points that share them."""
        groups: dict[str, tuple[str, ...]] = {}
        for point in (one.shared.point for one in self.points):
            choice = point.choice
            if choice is not None:
                scatter = scatter_of_beds(choice.scatter, discharges(self.study)[0])
                needed = stopping_rule(self.study, point).forecast(scatter)
                alone = " of one discharge" if self.study.discharges_per_bed == AUTO else ""
                cap = f" (accuracy.max_replicates is {self.rule.cap})" if needed == self.rule.cap else ""
                bias = f"{percent(choice.bias.value, '+.2f')} +- {percent(choice.bias.half_width, '.2f')}"
                said = (
                    f"dt = {choice.dt * 1e6:.3g} us, stiffness_scale = {choice.stiffness_scale:g}, precision = "
                    f"{choice.precision}: they change the flow "
                )
                said += (
                    f"rate by {bias}, which leaves {percent(choice.left, '.2f')} for the scatter; "
                    f"{needed} replicates{alone} expected{cap}"
                )
                if choice.usual is not None:
                    part = percent(choice.over_usual, ".0f")
                    said += f"; {part} of the steps that {choice.usual * 1e6:.3g} us would take if it had no bias"
                line = f"Chosen for {percent(choice.tolerance)}: {said} ({choice.source})"
                groups[line] = (*groups.get(line, ()), point.label)
            elif point.unchosen:
                step = f"dt = {point.numerics.dt * 1e6:.3g} us, whose bias is not known"
                if self.study.source:
                    measure = command("pilot", self.study.path, lab=self.lab, backend=self.backend.name)
                else:
                    measure = "lab.pilot(study, seeds=8)"
                verb = f"{measure} measures it"
                if point.wants_pilot:
                    verb = "labbook run first measures it by a pilot and chooses again"
                if has_groups(point.scene):
                    why = f"Not calibrated: {point.unchosen}; {step} ({verb})"
                else:
                    why = f"Cannot be calibrated: {point.unchosen}; {step}"
                groups[why] = (*groups.get(why, ()), point.label)
        return _at_points(groups)


def _at_points(groups: Mapping[str, Sequence[str]], points: int = 0) -> list[str]:
    """Lines with the labels of the points that each is for; without labels, if there is one line, or if it is for all
    of so many `points`."""
    if len(groups) == 1 and not points:
        return list(groups)
    return [
        line if len(at) == points else f"{line}; at {'; '.join(at[:3])}{' ...' * (len(at) > 3)}"
        for line, at in groups.items()
    ]


_FAILED = "its packing failed: "
"""How the reason of a run begins whose filling came to nothing before."""
_STATES: tuple[State, ...] = ("done", "missing", "partial", "stale")
_FEW = 100
"""Runs that are looked for one by one: a listing of a large lab takes longer."""
_SHOWN = 30
"""Points that are shown one by one."""


def counted(points: Iterable[PointPlan], holds: Callable[[Demand], bool]) -> tuple[int, int]:
    """Runs of a part that are done, and that are asked for; one that several points share counts once."""
    every = (item for point in points for item in point.items)
    asked = {item.keys.run: item for item in every if holds(item.demand)}
    return sum(item.state == "done" for item in asked.values()), len(asked)


class Planner:
    """Compares demands with what the catalogue and the lab's folders have, and asks the strategies for more.

    `study` has the points that are proposed so far, if it names a strategy. `packings_of`: whose packings the runs
    start from; None: `backend` makes its own. `writes`: keep what a strategy proposes in the lab.
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
        self._extends = True
        self._there: dict[str, Entry] = {}
        self._older: dict[str, Entry] = {}
        self._installed: dict[str, Entry] = {}
        """By lineage: a run by the installed version of the backend, which may have another key."""
        self._outdated: dict[str, str] = {}
        """By lineage: what has changed of laws and walls since a run was made."""

    def plan(self) -> Plan:
        """The whole study. Raises Conflict or MeasureError where observations cannot be made."""
        planned: dict[int, PointPlan] = {}
        if self.campaign is None:
            planned = {point.shared.point.index: point for point in self._begun(self.points)}
        while new := self.proposed(planned):
            planned |= {point.shared.point.index: point for point in new}
        return self._plan_of(tuple(planned[index] for index in sorted(planned)))

    def proposed(self, known: Mapping[int, PointPlan]) -> list[PointPlan]:
        """Ask the strategy of the study, if it names one, what is to be run beside what is known.

        Args:
            known: Points by their index, as they stand.

        Returns:
            Points that are new, or shall have more replicates now; empty if there are none so far.

        Raises:
            StudyError: A point that was proposed cannot be.
        """
        if self.campaign is None or not self._extends:
            return []
        self.campaign.advance(lambda generation: self._trials(generation, known))
        self._take_up()
        replicates = {index: point.shared.point.replicates for index, point in known.items()}
        changed = [one for one in self.points if replicates.get(one.point.index) != one.point.replicates]
        return self._begun(changed)

    def _take_up(self) -> None:
        """Give the study all points that are proposed so far."""
        assert self.campaign is not None
        assignments = self.campaign.assignments
        if [point.replicates for point in self.study.points] != [one.replicates for one in assignments]:
            self.study = with_points(self.campaign.study, assignments)
            self.__dict__.pop("points", None)

    def _trials(self, generation: Generation, points: Mapping[int, PointPlan]) -> tuple[Trial, ...] | None:
        """The runs of a generation, if all are done. points: by their index, as they stand."""
        self._take_up()
        assert self.campaign is not None
        places = [place(assignment.at) for assignment in self.campaign.assignments]
        shared = dict(zip(places, self.points, strict=True))
        runs: list[tuple[Assignment, Item]] = []
        for assignment in generation.assignments:
            point = points.get(shared[place(assignment.at)].point.index)
            if point is None or point.items[-1].demand.seed < assignment.replicates:
                (point,) = self._begun([shared[place(assignment.at)]])
            assigned = [item for item in point.items if item.demand.seed <= assignment.replicates]
            runs += [(assignment, item) for item in assigned]
            if any(item.state != "done" for item in assigned):
                return None
        numbers = self._numbers([item.keys.run for _, item in runs])
        return tuple(
            Trial(
                assignment.at,
                item.demand.seed,
                item.keys.run,
                item.outcome or "",
                numbers[item.keys.run],
                item.demand.discharge,
            )
            for assignment, item in runs
        )

    def _numbers(self, run_keys: list[str]) -> dict[str, dict[str, float]]:
        """All numbers that are measured of runs, by run and quantity."""
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
                    over = self.catalogue.values(
                        run_keys, quantity.name, measure.version, study.window, suspects=suspects, exposures=True
                    )
                    for key, value in over.items():
                        numbers[key][f"{quantity.name}{EXPOSURE}"] = value
        return numbers

    def _begun(self, points: Iterable[PointDemand]) -> list[PointPlan]:
        """Points with the runs that are asked for, as they stand."""
        first = {shared: self._keyed(self._first(shared)) for shared in points}
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
        """What another lab lacks, as it stands here: what is done there stays done, and replicates are added by whoever
        has all of them."""
        self._extends = False
        listed = self._look_up((item.demand, item.keys) for item in base.todo)
        points = tuple(
            self._anew(point, [item for item in point.items if item.state != "done"], listed) for point in base.points
        )
        return replace(base, points=points)

    def these(self, repeats: Mapping[int, Iterable[tuple[int, int]]]) -> Plan:
        """Plan these runs alone, by index of their point, seed and discharge, and none that follow from them."""
        self._extends = False
        asked = {
            shared: self._keyed(shared.run(*repeat) for repeat in repeats.get(shared.point.index, ()))
            for shared in self.points
        }
        listed = self._look_up(pair for pairs in asked.values() for pair in pairs)
        planned = (
            PointPlan(shared, tuple(self._item(*pair, listed) for pair in pairs), None)
            for shared, pairs in asked.items()
        )
        return self._plan_of(tuple(planned))

    def after(self, points: Mapping[int, PointPlan], done: Mapping[int, Collection[str]]) -> list[PointPlan]:
        """Look again at runs that have been done.

        Args:
            points: Points by their index, as they stood.
            done: Keys of these runs by index of their point.

        Returns:
            The points of these runs as they stand now. Only these runs are looked at: looking at all replicates after
            each of them would take as long as the square of their number.
        """
        again = {at: [points[at].items[points[at].places[key]] for key in keys] for at, keys in done.items()}
        listed = self._look_up((item.demand, item.keys) for items in again.values() for item in items)
        return [self._anew(points[at], items, listed) for at, items in again.items()]

    def point(self, before: PointPlan) -> PointPlan:
        """Return one point as it stands after other processes may have done any of its runs."""
        waiting = [item for item in before.items if item.state != "done"]
        return self._anew(before, waiting, self._look_up((item.demand, item.keys) for item in waiting))

    def _anew(self, before: PointPlan, again: Iterable[Item], listed: LabListing | None) -> PointPlan:
        """Return a point with the runs `again` as they are now, and those that follow from them."""
        return self._extended(
            before.with_items({item.keys.run: self._item(item.demand, item.keys, listed) for item in again})
        )

    @cached_property
    def points(self) -> list[PointDemand]:
        """All points of the study."""
        return [PointDemand(self.study, point, self.packings_of) for point in self.study.points]

    def refresh(self, item: Item) -> Item:
        """One run as its folder has it now, whatever the catalogue says."""
        return self._judged(item.demand, item.keys, self._looked_at(item.keys.run))

    def _first(self, shared: PointDemand) -> list[Demand]:
        return list(shared.runs(stopping_rule(self.study, shared.point).first, discharges(self.study)[0]))

    def _extended(self, plan: PointPlan) -> PointPlan:
        """Return the plan with the replicates that are proposed once all so far are done."""
        while self._extends and not plan.lacking:
            shared, items = plan.shared, plan.items
            proposal = self._replicates(shared.point, items)
            if proposal.state == "end":
                return PointPlan(shared, items, proposal)
            (assigned,) = proposal.assignments
            numbers = {item.demand.number for item in items}
            assigned_runs = shared.runs(assigned.replicates, assigned.discharges)
            added = self._keyed(run for run in assigned_runs if run.number not in numbers)
            listed = self._look_up(added)
            plan = PointPlan(shared, (*items, *(self._item(*pair, listed) for pair in added)), None)
        return plan

    def _replicates(self, point: Point, items: Sequence[Item]) -> Proposal:
        """Propose replicates of a point all runs of which are done: as many as any error of it needs."""
        strategies = self._strategies(point, items)
        if not strategies:
            return _AS_STATED
        history = History(self.study, (Generation(0, (), "", self._trials_of(point, items)),), (), 1)
        proposals = [strategy.propose(history) for strategy in strategies]
        reason = "; ".join(one.reason for one in proposals if one.reason)
        decision = next((one.decision for one in proposals if one.decision is not None), None)
        assigned = [assignment for one in proposals for assignment in one.assignments]
        if not assigned:
            return Proposal((), reason, "end", decision)
        beds, times = max(one.replicates for one in assigned), max(one.discharges for one in assigned)
        return Proposal((Assignment(point.at, beds, times),), reason, decision=decision)

    def _strategies(self, point: Point, items: Sequence[Item]) -> list[Replicates | Stops]:
        """Strategies that add replicates to a point, one for each error that is requested."""
        rule, strategies = stopping_rule(self.study, point), list[Replicates | Stops]()
        if rule.tolerance is not None:
            scatter = None if point.choice is None else point.choice.scatter
            filling = self._filling_cost(items) if self.study.discharges_per_bed == AUTO else None
            strategies.append(Replicates.of(rule=rule, scatter=scatter, filling=filling))
        if (error := self.study.accuracy.clogging) is not None:
            strategies.append(Stops.of(error=error, cap=rule.cap))
        return strategies

    def _trials_of(self, point: Point, items: Sequence[Item]) -> tuple[Trial, ...]:
        """The runs of a point with the numbers on which its replicates rest."""
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
        """Stops by run; empty unless an error of their probability is requested."""
        if self.study.accuracy.clogging is None:
            return {}
        version, suspects = MEASURES[NAME].version, self.study.accuracy.count_suspect
        return self.catalogue.values(run_keys, COUNT, version, self.study.window, suspects=suspects)

    def stops_in_words(self, point: PointPlan) -> str:
        """Say how many stops the runs of a point have, and how many replicates are expected."""
        shared, error = point.shared, self.study.accuracy.clogging
        assert error is not None
        items = [item for item in point.items if item.state == "done"]
        strategy = Stops.of(error=error, cap=stopping_rule(self.study, shared.point).cap)
        counted = stops(self._trials_of(shared.point, items))
        return strategy.in_words(counted, len({item.demand.seed for item in items}))

    def _filling_cost(self, items: Sequence[Item]) -> float:
        """Cost of a filling of a point, in discharges, by its runs that are done."""
        first = [(item.keys.run, item.keys.packing) for item in items if item.demand.discharge == 1]
        return filling_cost(self.catalogue.lab, first, self._sharing[items[0].keys.packing])

    @cached_property
    def _sharing(self) -> Counter[str]:
        """Points that start from a packing, by its key; of the first bed of each point."""
        return Counter(shared.run(1).keys(self.backend).packing for shared in self.points)

    def shares_in_words(self, point: PointPlan, expected: float) -> str:
        """Say what bed and flow have of the variance of a point's flow rate, and which number of discharges of a bed is
        cheapest. `expected`: cost of a filling, in discharges, until any is made."""
        shared, rule = point.shared, stopping_rule(self.study, point.shared.point)
        items = [item for item in point.items if item.state == "done"]
        rates = flow_rates(self.study, self.catalogue, [item.keys.run for item in items])
        values = [(item.demand.seed, rates[item.keys.run]) for item in items if item.keys.run in rates]
        if len(beds := by_bed(values)) < 2:
            choice, sharing = shared.point.choice, self._sharing[point.items[0].keys.packing]
            scatter = math.nan if choice is None else choice.scatter
            return in_words(rule, 1.0, replace(TYPICAL, scatter=scatter), expected / sharing)
        means = of_beds(beds)
        return in_words(rule, sum(means) / len(means), shares(beds), self._filling_cost(items))

    def _keyed(self, demands: Iterable[Demand]) -> list[tuple[Demand, Keys]]:
        return [(demand, demand.keys(self.backend)) for demand in demands]

    def _look_up(self, asked: Iterable[tuple[Demand, Keys]]) -> LabListing | None:
        """Ask the catalogue for runs. What the lab has besides is listed where they are many, and looked for one by one
        (None) where they are few."""
        asked = list(asked)
        keys = [keys for _, keys in asked]
        for entry in self.catalogue.entries([one.run for one in keys], [one.lineage for one in keys]):
            self._there[entry.run_key] = entry
            if entry.coverage is not None:
                installed = entry.cache_version == self.backend.cache_version
                (self._installed if installed else self._older)[entry.lineage_key] = entry
        self._look_up_outdated(asked)
        return LabListing.of(self.catalogue.lab) if len(keys) > _FEW else None

    def _look_up_outdated(self, asked: Iterable[tuple[Demand, Keys]]) -> None:
        """Ask the catalogue, of runs that are not there, for those by older versions of laws and walls."""
        lacking = [pair for pair in asked if pair[0].shared.versions and pair[1].run not in self._there]
        if not lacking or not self.catalogue.counts():
            return
        known: dict[str, tuple[str, str]] = {}
        for demand, keys in lacking:
            for lineage, outdated in demand.older_lineages(self.backend.name):
                known.setdefault(lineage, (keys.lineage, outdated))
        there = {one.lineage_key for one in self.catalogue.entries((), known) if one.coverage is not None}
        for lineage, (now, outdated) in known.items():
            if lineage in there:
                self._outdated.setdefault(now, outdated)

    def _item(self, demand: Demand, keys: Keys, listed: LabListing | None) -> Item:
        entry = self._there.get(keys.run)
        if entry is None and listed is not None and keys.run not in listed.runs:
            return self._judged(demand, keys, None, listed)
        if entry is None or entry.stamp != stamp(self.catalogue.lab.run(keys.run)):
            entry = self._looked_at(keys.run)
        return self._judged(demand, keys, entry, listed)

    def _judged(self, demand: Demand, keys: Keys, entry: Entry | None, listed: LabListing | None = None) -> Item:
        state, reason = self._compare(demand, keys, entry, listed)
        outcome = entry.outcome if entry else None
        problem: str | None = "is not there"
        if listed is None or keys.packing in listed.packings or state == "done":
            problem = self.catalogue.packing_problem(keys.packing)
        if problem and state == "done":
            state, reason = "missing", f"its packing cannot be read: {problem}"
        return Item(demand, keys, state, reason, outcome, problem is None, entry.suspect if entry else "")

    def _compare(self, demand: Demand, keys: Keys, entry: Entry | None, listed: LabListing | None) -> tuple[State, str]:
        if entry is None:
            begun = listed is None or keys.run in listed.work
            begun = begun and (self.catalogue.lab.work(keys.run) / PROGRESS).exists()
            older = self._older.get(keys.lineage)
            if begun:
                return "partial", "started, goes on from its checkpoint"
            if older:
                was, name = older.cache_version, self.backend.name
                return "stale", f"made by version {was} of {name}, now at version {self.backend.cache_version}"
            if outdated := self._outdated.get(keys.lineage):
                return "stale", outdated
            if edited := self._edited(demand, keys):
                return "stale", edited
            why = self._failed(demand, keys.packing) if listed is None or keys.packing in listed.work else ""
            return "missing", f"{_FAILED}{why}" if why else "not run yet"
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
            shared.unstated,
        )
        return ("partial", lacks) if lacks else ("done", entry.outcome)

    def _edited(self, demand: Demand, keys: Keys) -> str:
        """The extensions whose source has changed since the run was made, in words; empty if none."""
        now, entry = demand.shared.versions, self._installed.get(keys.lineage)
        if entry is None or not identity.hashed(now):
            return ""
        return identity.outdated(made_by(self.catalogue.lab, entry), now)

    def _failed(self, demand: Demand, packing: str) -> str:
        """Why a filling came to nothing, and what to change; empty if none did, or if it may go on for longer now."""
        folder = self.catalogue.lab.work(packing)
        noted = FillingFailure.read(folder)
        if noted is not None:
            cured = noted.max_time is not None and demand.shared.longest_filling > noted.max_time
            return "" if cured else noted.why
        try:
            last = Progress.read(folder)
        except Unreadable:
            return ""
        return last.failed if last else ""

    def _looked_at(self, key: str) -> Entry | None:
        """A run as its folder has it now: its process was killed before it was indexed, another machine put it there,
        or something in it changed since."""
        folder = self.catalogue.lab.run(key)
        if not folder.is_dir():
            return None
        seen = stamp(folder)
        try:
            record, _ = open_run(folder)
        except Unreadable as problem:
            return Entry(key, "", 0, "unreadable", None, str(problem), seen)
        return Entry.of(record, seen)


def flow_rates(study: Study, catalogue: Catalogue, run_keys: Sequence[str]) -> dict[str, float]:
    """Flow rates [kg/s] by run, without runs that gave none (clogged, diverged, suspect)."""
    version, suspects = MEASURES[QUANTITY].version, study.accuracy.count_suspect
    return catalogue.values(run_keys, QUANTITY, version, study.window, suspects=suspects)


_AS_STATED = Proposal.end("")
"""Of points that have all the replicates that the study states."""
