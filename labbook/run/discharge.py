"""Discharges: from the packing, or from the last save, until the stop rule ends them; with a picture of the bed."""

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from labbook.backend import Emptied, EndState, Ensemble, Event, Member, Status
from labbook.backend.numerics import Numerics
from labbook.backend.probes import (
    Contacts,
    Crossing,
    Film,
    Probe,
    Sample,
    Table,
    Traction,
    Zone,
    describe_probe,
    parse_probe,
    table_name,
)
from labbook.campaign import Assignment, Generation, History, PreciseRun, Trial
from labbook.campaign.precise import HALF_WIDTH
from labbook.filling import (
    Breaker,
    Feeder,
    Inflow,
    PlacingError,
    Pouring,
    Refill,
    kick_grains,
    start_of_discharge,
    still,
)
from labbook.filling.bed import bed_height, parts_of_mass
from labbook.lab import identity
from labbook.lab.folder import PICTURE, Claim, stamp
from labbook.lab.identity import Keys
from labbook.lab.index import rows_of_run, run_rows, unreadable_row
from labbook.lab.journal import PROGRESS, Journal, Saved, at_its_end
from labbook.lab.packings import load_packing
from labbook.lab.provenance import now
from labbook.lab.records import Coverage, Observe, Outcome, Precise, RunFailure, RunRecord, Unreadable
from labbook.lab.runs import CHECKPOINT, RECORDING, check_tables, fault_of_crossings, film_of
from labbook.lab.tables import fault_of_rows, join, write_checkpoint, write_table
from labbook.measure import RunData
from labbook.measure.series import passages
from labbook.measure.steady import steady_flow
from labbook.picture import bed
from labbook.plan.coverage import unobserved
from labbook.plan.demand import Demand
from labbook.run.frame_rows import BeforeOpening, frame_rows
from labbook.run.job import BeatCost, Job, JobContext, JobFailed, JobOutput, LabEntry, failure
from labbook.run.ledger import ledger
from labbook.scene import BedTop, Packing
from labbook.scene.quantities import percent
from labbook.scene.timescales import stop_time
from labbook.stats.stopping import looks

_LOG = logging.getLogger("labbook")
_SINGLE_PRECISION = Sample | Zone | Contacts | Traction
"""Probes whose rows are stored in single precision."""


class DischargeJob(Job):
    """The run of one demand, in the scene with its outlet open."""

    kind = "run"

    def __init__(self, context: JobContext, demand: Demand, keys: Keys, claim: Claim, observe: Observe):
        super().__init__(context, demand, keys, keys.run, context.lab.run(keys.run), claim)
        self.scene = demand.point.scene
        self.observe = observe
        self._plane = self.scene.container.outlet_plane
        self._crossed, self._discharged, self._last_crossing = 0, 0.0, 0.0
        self._looks_taken, self._precision = 0, math.inf
        self._has_advanced = False
        self._restarts: list[tuple[float, float]] = []
        self._is_at_rest = False
        self._failure: RunFailure | None = None
        self._stream_is_over = False
        """True once all grains of the stream of the filling have entered."""
        self._midway: Packing | None = None
        """Bed in the middle of the window, of which a picture is drawn at the end."""
        self._picture_failed = False
        self.film = demand.film
        self._set_probes(demand.shared.probes)

    @property
    def declared(self) -> tuple[Probe, ...]:
        """Probes of all runs of the point, so that recorded and other runs share an ensemble."""
        return tuple(dict.fromkeys((*self.demand.shared.declared, *self.probes)))

    def _set_probes(self, probes: Sequence[Probe]) -> None:
        """Observe `probes` and, if the run is recorded, its frames."""
        self._measured = tuple(probes)
        self.probes = tuple(dict.fromkeys((*probes, *((self.film,) if self.film else ()))))

    # start

    def fresh(self) -> Packing:
        """Open the outlet of the packing, and kick the bed of a further discharge. Raises JobFailed."""
        packing = self._packing.entered
        height = self.scene.container.roof
        level = float(packing.x[:, 2].max())
        if level > height:
            raise JobFailed(
                f"{self.label}: the bed stands {level * 1e3:.4g} mm high, above the side walls "
                f"({height * 1e3:.4g} mm), and would spill over them; raise container.height or use fewer grains"
            )
        lowest = self.demand.shared.stop.fill_height
        if lowest is not None and self._bed_height <= lowest:
            raise JobFailed(
                f"{self.label}: the settled bed is {self._bed_height * 1e3:.4g} mm high, not above stop.fill_height "
                f"({lowest * 1e3:.4g} mm); use more grains or lower stop.fill_height"
            )
        _ = self._feeder  # which may have no room: that shows now, and not after the first beat
        start, kick = start_of_discharge(packing, self.demand.shared.closed, self.scene), self.demand.kick
        return start if kick is None else kick_grains(start, self.scene, kick, self.demand.seed)

    @cached_property
    def _feeder(self) -> Feeder | Inflow | Pouring | None:
        """Source of grains that are fed, or of those of the filling's stream that have still to enter; None without
        either. Raises JobFailed."""
        try:
            if self.scene.feed is None:
                return self._pouring()
            if self._packing.waiting is not None:
                late = f"{int(self._packing.waiting.sum())} grains of the stream had not entered by fill.until"
                raise PlacingError(f"{late}, and the feed would bring them; use a later time or a larger rate")
            if self.scene.feed.stream is not None:
                return Inflow(self.scene, self._packing, self.demand.seed, self.numerics.beat)
            return Feeder(self.scene, self._packing, self.demand.filling.kind, self.demand.seed)
        except PlacingError as error:
            raise JobFailed(f"{self.label}: {error}") from error

    def _pouring(self) -> Pouring | None:
        """The stream of the filling, which goes on; None if all grains have entered."""
        filling, filling_numerics = self.demand.filling, self.demand.shared.filling_numerics
        if filling.stream is None or filling.until is None or self._packing.waiting is None:
            return None
        assert self._packing.ids is not None
        every = self._packing.renumbered(np.argsort(self._packing.ids))
        since = math.ceil(filling.until / filling_numerics.beat * (1 - 1e-12)) * filling_numerics.beat
        return Pouring(self.demand.shared.closed, filling.stream, filling.seed, self.numerics.beat, every, since)

    @cached_property
    def _left(self) -> np.ndarray:
        """Mask of the grains that have crossed the outlet, by id, of a run into which a stream goes on."""
        left = np.zeros(self.scene.grains.count, bool)
        if (table := self.tables().get(table_name(Crossing()))) is not None:
            left[table["id"]] = True
        return left

    @cached_property
    def _breaker(self) -> Breaker | None:
        """Breaks arches; None where a stop ends the run."""
        if self.scene.restart is None:
            return None
        return Breaker(self.scene, self.demand.seed, self.numerics.beat)

    @cached_property
    def _packing(self) -> Packing:
        try:
            return load_packing(self.context.lab.packing(self.keys.packing))
        except Unreadable as problem:
            raise JobFailed(f"{self.label}: {problem}; delete the folder, and labbook run makes it again") from problem

    def recall(self, saved: Saved | None) -> Saved | None:
        """Restore the later one of the save and the finished run, if it observes all that is demanded.

        A damaged run is reported, and made again. Raises Unreadable for a damaged work folder.
        """
        if saved is not None:
            self._check_saved(saved)
        earlier = self._earlier_run()
        if earlier and (not saved or saved.step <= earlier.coverage.steps):
            saved = self._from_folder(earlier) or saved
        if saved is None or not self._has_observations(saved.state):
            if earlier:
                self._observe_as_before(earlier)
            self.start_over()
            return None
        state = saved.state
        self._crossed, self._last_crossing = int(state["crossed"]), float(state["last"])
        # saves from before grains could differ have no mass: it was that of the number
        self._discharged = float(state.get("discharged", self._crossed / self.scene.grains.count))
        self._restarts = _restarts(state)
        self._looks_taken = self._looks_due()
        self.film = parse_film(state["film"], self.numerics)
        self._set_probes([parse_probe(text) for text in state["probes"]])
        return saved

    def _check_saved(self, saved: Saved) -> None:
        """Check that the files of the work folder are valid and consistent. Raises Unreadable."""
        folder, state = self.journal.folder, saved.state
        try:
            probes = {table_name(probe): probe for probe in map(parse_probe, state["probes"])}
            if (film := parse_film(state["film"], self.numerics)) is not None:
                probes[FILM_TABLE] = film
            _restarts(state)
            crossed, last, discharged = int(state["crossed"]), float(state["last"]), float(state.get("discharged", 0.0))
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise Unreadable(f"{folder / PROGRESS}: state: {type(error).__name__}: {error}") from error
        limit = math.inf if self.scene.feed is not None else 1 + 1e-9  # of the bed; grains that are fed cross again
        if not (0 <= crossed <= limit * self.scene.grains.count and math.isfinite(last) and 0 <= discharged <= limit):
            raise Unreadable(
                f"{folder / PROGRESS}: state: {crossed} crossed, the last at {last} s, {discharged} of the mass"
            )
        for name, table in self.journal.iter_rows():
            if name not in probes:
                raise Unreadable(f"{folder / PROGRESS}: chunks: {name} is unexpected")
            if fault := fault_of_rows(table, probes[name], self.scene, self.numerics, saved.step):
                raise Unreadable(f"{folder}: {name}: {fault}")
        tables = self.journal.tables({})
        if missing := probes.keys() - tables.keys():
            raise Unreadable(f"{folder / PROGRESS}: chunks: {', '.join(sorted(missing))} is missing")
        for probe in probes.values():
            if isinstance(probe, Crossing) and probe.plane == self._plane:
                fault = fault_of_crossings(tables[table_name(probe)], crossed, last, self.scene.feed is not None)
                if fault:
                    raise Unreadable(f"{folder}: {table_name(probe)}: {fault}")
        self.check(saved, folder)

    def _earlier_run(self) -> RunRecord | None:
        try:
            return RunRecord.read(self.folder)
        except Unreadable as problem:
            if self.folder.exists():
                self.damaged[self.folder] = str(problem)
            return None

    def _from_folder(self, earlier: RunRecord) -> Saved | None:
        """Save the finished run in the work folder, as at its end; None if its state cannot be read."""
        try:
            saved, rows = at_its_end(self.folder, earlier)
            self.check(saved, self.folder)
        except Unreadable as problem:
            self.damaged[self.folder] = str(problem)
            return None
        # from here on a finished run is continued as any saved one
        self.start_over()
        self.journal.save(saved.checkpoint, rows, saved.state, saved.sessions)
        return saved

    def _has_observations(self, state: Mapping[str, Any]) -> bool:
        film = parse_film(state["film"], self.numerics)
        filmed = self.film is None or (film is not None and film.as_often(self.film))
        return filmed and not unobserved(self.demand.shared.probe_names, state["probes"])

    def _observe_as_before(self, earlier: RunRecord) -> None:
        """Add the probes of the earlier run, so that repeating it loses no observations."""
        kinds = {table_name(probe) for probe in self._measured}
        added = [probe for probe in map(parse_probe, earlier.coverage.probes) if table_name(probe) not in kinds]
        film = film_of(earlier)
        if film is not None and (self.film is None or film.every < self.film.every):
            self.film = film
        self._set_probes((*self._measured, *added))

    # going on

    def state(self) -> dict[str, Any]:
        """Return crossings, discharged mass, time of the last crossing, and probes."""
        return {
            "crossed": self._crossed,
            "discharged": self._discharged,
            "last": self._last_crossing,
            "probes": [describe_probe(probe) for probe in self._measured],
            "film": describe_probe(self.film) if self.film else None,
            **({"restarts": [list(restart) for restart in self._restarts]} if self._restarts else {}),
        }

    def absorb(self, probe: Probe, table: Table) -> None:
        """Store rows, and count grains that left."""
        if isinstance(probe, Crossing) and probe.plane == self._plane and len(table["time"]):
            self._crossed += len(table["time"])
            if self.scene.grains.varied:
                self._discharged += float(self._mass_fractions[table["id"]].sum())
            else:
                self._discharged = self._crossed / self.scene.grains.count
            self._last_crossing = max(self._last_crossing, float(np.max(table["time"])))
            if isinstance(self._feeder, Pouring):
                self._left[table["id"]] = True
        if probe == self.film:
            self.keep(FILM_TABLE, frame_rows(table))
        if probe in self._measured:
            self.keep(table_name(probe), frame_rows(table) if isinstance(probe, _SINGLE_PRECISION) else table)

    @property
    def looks(self) -> bool:
        """True if the bed is in the middle of the window, and a picture is to be drawn."""
        if self._midway is not None or self._picture_failed or self._plane is None or self.demand.seed > PICTURED:
            return False
        middle = (self.observe.start + self.observe.end) / 2
        reached = self.status.time if self.observe.timed else self._discharged
        return reached >= middle

    def look(self, ensemble: Ensemble, member: Member) -> None:
        """Store the present bed for the picture."""
        try:
            self._midway = ensemble.packing(member)
        except Exception as problem:  # of whatever kind: no run is lost for a picture
            self._picture_failed = True
            _log_missing_picture(self.label, problem)

    def status_of(self, ensemble: Ensemble, member: Member) -> Status:
        """Read the status of its member without the kinetic energy, which decides nothing here."""
        return ensemble.progress(member)

    def after(self, status: Status, tables: Mapping[Probe, Table], cost: BeatCost) -> None:
        """Account for a beat.

        After a failed beat the member is in its last good state, into which grains have already been fed: none are fed
        again.
        """
        self._has_advanced = status.step > self.status.step
        super().after(status, tables, cost)

    @property
    def needs_refill(self) -> bool:
        """True if grains that have left are to be fed; a saved state includes those fed after its beat."""
        if self._feeder is None or not self._has_advanced or self._stream_is_over:
            return False
        return self.status.grains < self.scene.grains.count

    @property
    def floor(self) -> float:
        """Height z [m] above which grains of the bed may be in the way of those that are fed."""
        assert self._feeder is not None
        return self._feeder.floor

    def refill(self, bed: BedTop) -> Refill:
        """Return the bed with the source of the grains that it has lost, or that enter by the stream of the filling."""
        assert self._feeder is not None
        if not isinstance(self._feeder, Pouring):
            return Refill(self._feeder, bed, self._beat_number)
        present = np.zeros(self.scene.grains.count, bool)
        present[bed.present] = True
        self._stream_is_over = bool((present | self._left).all())
        return Refill(self._feeder, bed, self._beat_number, self._left)

    @property
    def pauses(self) -> bool:
        """True if no grain has left for so long that the flow may have stopped, or if a push is due after a stop."""
        if self._breaker is None:
            return self.demand.shared.stop.still and self._is_waiting
        return self._has_advanced and (self._due_push is not None if self._is_stuck else self._is_waiting)

    def break_arch(self, ensemble: Ensemble, member: Member, bed: Packing) -> None:
        """Record a stop of the flow if the grains near the outlet are at rest; push them if arches are broken."""
        if not self._is_stuck:
            flows = isinstance(self._feeder, Pouring) and not self._stream_is_over
            self._is_at_rest = not flows and still(self.scene, bed)
        if self._breaker is None or not (self._is_stuck or self._is_at_rest):
            return
        if not self._is_stuck:
            self._restarts.append((self._last_crossing, self.status.time))
        # counted from the restart that has just been noted, or from an earlier one of the same stop
        number, self._is_at_rest = self._due_push, False
        assert number is not None
        ensemble.set_velocities(member, *self._breaker.pushed(bed, self._beat_number, number))

    @property
    def _beat_number(self) -> int:
        """Number of beats since the opening."""
        return self.status.step // self.numerics.steps_per_beat

    @property
    def _idle_time(self) -> float:
        """Time [s] since the last grain left or the last part vanished; negative before that."""
        return self.status.time - max([self._last_crossing, *self._removal_times])

    @cached_property
    def _removal_times(self) -> list[float]:
        """Times [s] at which parts vanish."""
        return [wall.removal for wall in self.scene.container.walls() if wall.removal is not None]

    @property
    def _is_waiting(self) -> bool:
        """True if no grain has left for so long that the flow may count as stopped."""
        return self._idle_time >= self._stop_time

    @cached_property
    def _stop_time(self) -> float:
        return stop_time(self.scene)

    @property
    def _is_stuck(self) -> bool:
        """True if no grain has left since the arch was last pushed."""
        return bool(self._restarts) and self._last_crossing <= self._restarts[-1][1]

    @property
    def _due_push(self) -> int | None:
        """Number of the push that is due after this beat, from 1, since the last restart; None if none is due."""
        assert self._breaker is not None
        # a restart is stored by its time, which is that of the end of a beat
        return self._breaker.push(self._beat_number - round(self._restarts[-1][1] / self.numerics.beat))

    def verdict(self, events: Sequence[Event]) -> Outcome | None:
        """Apply the stop rule."""
        failed = failure(events)
        if failed:
            self._failure = RunFailure(guard=failed.guard, step=failed.step, grain=failed.grain, message=failed.message)
            return "diverged"
        stop = self.demand.shared.stop
        # the target comes first: a bed that empties or stops within the same beat has reached it
        if self._discharged >= self._target_fraction:
            return "finished"
        if stop.precise is not None and self._is_precise(stop.precise):
            return "precise"
        if self.status.grains == 0 or any(isinstance(event, Emptied) for event in events):
            return "emptied"
        if self._plane is not None and self._idle_time >= 0 and (self._is_at_rest or self._idle_time >= stop.stall):
            return "clogged"
        return "time-limit" if self.status.time >= stop.max_time else None

    def _is_precise(self, required: Precise) -> bool:
        """Decide whether the flow rate is as precise as required, without trend; evaluated only from time to time."""
        looks_before, self._looks_taken = self._looks_taken, self._looks_due()
        if self._looks_taken <= looks_before:
            return False
        grains, table = self.scene.grains, self.tables()[table_name(Crossing())]
        times, mass = passages(grains, self._packing, table)
        flow = steady_flow(times, grains.count, self.demand.shared.study.window, mass)
        # the error about a mean says nothing of a flow that still changes: with a trend the run goes on
        self._precision = math.inf if flow is None or flow.trend.trending else flow.precision
        quantities = {HALF_WIDTH: self._precision} if math.isfinite(self._precision) else {}
        at = self.demand.point.at
        look = Generation(0, (Assignment(at),), "", (Trial(at, self.demand.seed, self.key, "going on", quantities),))
        history = History(self.demand.shared.study, (look,), (), 1)
        return PreciseRun.of(error=required.flow_rate).propose(history).state == "end"

    def _looks_due(self) -> int:
        """Number of times that the flow rate should have been evaluated by now."""
        precise = self.demand.shared.stop.precise
        return 0 if precise is None else looks(int((self._discharged - precise.start) * self.scene.grains.count))

    def progress(self) -> float:
        """Return the progress by discharged fraction, time or precision, whichever is nearest to its end. A flow that
        rests is on its way to the time at which it counts as clogged."""
        stop = self.demand.shared.stop
        # an error falls with the square root of the time
        precision_progress = 0.0 if stop.precise is None else (stop.precise.flow_rate / self._precision) ** 2
        may_clog = self._is_pausing and self._breaker is None
        wait_progress = self.status.time / (self.status.time - self._idle_time + stop.stall) if may_clog else 0.0
        by_discharge, by_time = self._discharged / self._target_fraction, self.status.time / stop.max_time
        return min(1.0, max(by_discharge, by_time, precision_progress, wait_progress))

    @property
    def _is_pausing(self) -> bool:
        """True if no grain has left for so long that the run may end as clogged."""
        return self._idle_time > _REPORTED_WAIT * self.demand.shared.stop.stall

    def doing(self) -> tuple[str, ...]:
        """Return the discharged mass and its target, how long no grain has left, and the simulated time.

        Without an outlet: the simulated time and its maximum.
        """
        if self._plane is None:
            return (f"{self.status.time:.2f} of {self.demand.shared.stop.max_time:g} s",)
        discharged = f"{percent(self._discharged, '.0f')} discharged, ends at {percent(self._target_fraction, '.0f')}"
        if (stop := self.demand.shared.stop).fed:
            precision = f", W to {percent(self._precision, '.2f')}" if math.isfinite(self._precision) else ""
            ending = (
                f", ends at {percent(stop.precise.flow_rate)}" if stop.precise else f", ends at {stop.max_time:g} s"
            )
            discharged = f"{percent(self._discharged, '.0f')} of the bed has passed{precision}{ending}"
        waiting, stall = (), self.demand.shared.stop.stall
        if self._is_pausing:
            waiting = (f"no grain for {self._idle_time:.2f} s, clogged after {stall:g} s",)
        return discharged, *waiting, f"{self.status.time:.2f} s"

    @cached_property
    def _bed_height(self) -> float:
        """Height [m] of the settled bed above the outlet plane."""
        return bed_height(self.scene.grains, self._packing, self._plane or 0.0)

    @cached_property
    def _mass_fractions(self) -> np.ndarray:
        """Mass of each grain as a fraction of that of all grains, by id, shape [n]."""
        return parts_of_mass(self.scene.grains, self._packing)

    @cached_property
    def _target_fraction(self) -> float:
        """Discharged fraction at which the run ends."""
        shared = self.demand.shared
        return shared.reach(self._bed_height) if shared.stop.fill_height is not None else shared.stop.discharged

    # end

    def output(self, verdict: str, end_state: EndState) -> "RunOutput":
        """Return record, rows, last state and bed of the picture."""
        has_picture = not self._picture_failed and (self.demand.seed <= PICTURED or verdict in ("clogged", "diverged"))
        return RunOutput(
            self.context.lab,
            self.key,
            self.folder,
            self.label,
            record=self._record(verdict),
            status=self.status,
            journal=self.journal,
            unsaved=self._rows,
            left=end_state,
            start=self._packing,
            has_picture=has_picture,
            midway=self._midway,
            before=self._bed_before_opening(),
        )

    def _bed_before_opening(self) -> "BeforeOpening | None":
        """Scene and probe for forces of walls on the bed at rest; None if they are not observed."""
        probe = next((candidate for candidate in self._measured if isinstance(candidate, Traction)), None)
        if probe is None:
            return None
        shared = self.demand.shared
        return BeforeOpening(self.context.backend, shared.closed, shared.filling_numerics, probe)

    def _record(self, verdict: str) -> RunRecord:
        """Make the record of the run, without its ledger."""
        context, demand, status = self.context, self.demand, self.status
        coverage = Coverage(
            duration=status.time,
            steps=status.step,
            grains=self.scene.grains.count,
            crossed=self._crossed,
            mass_left=self._discharged if self.scene.grains.varied else None,
            last_crossing=self._last_crossing,
            stop=demand.shared.stop,
            guards=demand.guards,
            probes=tuple(describe_probe(probe) for probe in self._measured),
            recording=self.film.every if self.film else None,
            every_frame=self.film is not None,
            restarts=tuple(self._restarts),
            bed_height=self._bed_height if demand.shared.stop.fill_height is not None else None,
        )
        physics = context.backend.describe(self.scene, self.numerics)
        return RunRecord.model_validate(
            {
                "run_key": self.keys.run,
                "experiment_key": self.keys.experiment,
                "scene_key": self.keys.scene,
                "packing_key": self.keys.packing,
                "lineage_key": self.keys.lineage,
                "backend": context.backend.capabilities.name,
                "cache_version": context.backend.capabilities.cache_version,
                "study": demand.shared.study.name,
                "point": demand.point.index,
                "label": demand.point.label,
                "at": dict(demand.point.at),
                "seed": demand.seed,
                "kick": demand.kick,
                "scene": self.scene,
                "versions": identity.versions(self.scene),
                "numerics": self.numerics,
                "outcome": verdict,
                "coverage": coverage,
                "failure": self._failure,
                "observe": self.observe,
                "physics": {key: float(value) for key, value in physics.items() if math.isfinite(value)},
                "device": context.device,
                "finished": now(),
                "sessions": self.sessions(),
            }
        )


@dataclass(frozen=True)
class RunOutput(JobOutput):
    """Output of an ended run.

    Args:
        record: Record without its ledger.
        status: Last status of the member.
        journal: Saved rows.
        unsaved: Rows since the last save, by table name.
        left: Packing and checkpoint at the end.
        start: Packing of the run.
        has_picture: Draw a picture of the bed.
        midway: Bed in the picture; None: that at the end.
        before: Forces of walls before the opening, where they are observed.
    """

    record: RunRecord
    status: Status
    journal: Journal
    unsaved: Mapping[str, Sequence[Table]]
    left: EndState
    start: Packing
    has_picture: bool
    midway: Packing | None
    before: BeforeOpening | None = None

    def fill_folder(self, folder: Path) -> None:
        """Write tables, last state, recording, picture and record."""
        for name, table in self._tables.items():
            write_table(folder / f"{name}.npz", table, durable=False)
        write_checkpoint(folder / CHECKPOINT, self.left.checkpoint, compress=True, durable=False)
        if picture := self._picture():
            (folder / PICTURE).write_bytes(picture)
        self._full_record.write(folder, durable=False)

    @cached_property
    def _tables(self) -> dict[str, dict[str, np.ndarray]]:
        """Rows of every probe, by table name, as they are written; read before the work folder is cleared."""
        tables = self.journal.tables(self.unsaved)
        if self.before is not None:
            name = table_name(self.before.probe)
            if not (tables[name]["step"] == 0).any():
                rows = self.before.rows(self.start, self.record.scene)
                tables[name] = tables[name] if rows is None else join([rows, tables[name]])
        return tables

    @cached_property
    def _full_record(self) -> RunRecord:
        """Record with its ledger."""
        counts = ledger(self.record.scene, self.status, self.left.packing, self.start, self._tables.get("crossing"))
        return self.record.model_copy(update={"ledger": counts})

    def _picture(self) -> bytes:
        """Draw the bed (PNG). If that fails the log says why, and the run is stored without a picture."""
        if not self.has_picture:
            return b""
        try:
            return bed(self.record.scene, self.start, self.left.packing if self.midway is None else self.midway)
        except Exception as problem:
            _log_missing_picture(self.label, problem)
            return b""

    def entry(self) -> LabEntry:
        """Return the index rows of the run, and evaluate its measures."""
        folder_stamp, record, tables = stamp(self.folder), self._full_record, dict(self._tables)
        tables |= self._full_record.coverage.restart_table
        recorded = tables.pop(FILM_TABLE, None)
        try:
            check_tables(self.folder, record, self._tables)
        except Unreadable as problem:
            return LabEntry((unreadable_row(self.folder, folder_stamp, problem), []))
        data = RunData(
            scene=record.scene,
            numerics=record.numerics,
            seed=record.seed,
            start=self.start,
            outcome=record.outcome,
            duration=record.coverage.duration,
            tables=tables,
            recorded=lambda: recorded,
        )
        return LabEntry(rows_of_run(self.folder, folder_stamp, record, data, record.observe))

    def reread(self) -> LabEntry:
        """Return the index rows of the run from its folder."""
        return LabEntry(run_rows(self.folder, self.record.observe))


def _restarts(state: Mapping[str, Any]) -> list[tuple[float, float]]:
    """Parse the restarts of a saved state. Raises ValueError or TypeError if they are invalid."""
    return [(float(stopped), float(time)) for stopped, time in state.get("restarts", [])]


def _log_missing_picture(label: str, problem: Exception) -> None:
    _LOG.warning("%s: the bed was not drawn: %s: %s", label, type(problem).__name__, problem)
    _LOG.debug("where that was", exc_info=True)


PICTURED = 10
"""Highest seed whose bed is always drawn; of others only clogged or diverged ones: a picture of a small bed takes as
long as writing all its other files."""
FILM_TABLE = Path(RECORDING).stem
_REPORTED_WAIT = 0.3
"""Fraction of the stall time without a grain leaving from which progress reports it."""


def parse_film(text: str | None, numerics: Numerics) -> Film | None:
    """Parse the recording probe of a saved state; older states count whole beats. Raises ValueError for another
    probe."""
    probe = parse_probe(text) if text else None
    if isinstance(probe, Sample):
        return Film(probe.every * numerics.beat, probe.fields)
    if probe is None or isinstance(probe, Film):
        return probe
    raise ValueError(f"film: no frames of grains, but {text}")
