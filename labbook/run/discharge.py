"""A discharge: from the packing, or from where it was left, until the stop rule ends it; and a picture of its bed."""

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from labbook.backend import Backend, Emptied, EndState, Ensemble, Event, Member, Status
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
from labbook.filling import Breaker, Feeder, Inflow, PlacingError, Refill, kicked, opened, still
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
from labbook.run.job import Bench, Job, JobFailed, Kept, LabEntry, failure
from labbook.run.ledger import ledger
from labbook.scene import Packing, Scene
from labbook.scene.quantities import percent
from labbook.scene.timescales import stop_time
from labbook.scene.wall_bins import all_walls
from labbook.stats.stopping import looks

_LOG = logging.getLogger("labbook")
_WHOLE = {"id": np.int32, "i": np.int32, "j": np.int32, "wall": np.int16, "step": np.int64, "time": np.float64}
_WHOLE |= dict.fromkeys(("bin", "contacts", "sliding"), np.int32)


_FRAMED = Sample | Zone | Contacts | Traction
"""Probes whose rows are kept in single precision."""


class DischargeJob(Job):
    """The run of one demand."""

    kind = "run"

    def __init__(self, bench: Bench, demand: Demand, keys: Keys, claim: Claim, observe: Observe):
        super().__init__(bench, demand, keys, keys.run, bench.lab.run(keys.run), claim)
        self.scene = demand.point.scene
        self.observe = observe
        self._plane = self.scene.container.outlet_plane
        self._crossed, self._discharged, self._last = 0, 0.0, 0.0
        self._looked, self._precision = 0, math.inf
        self._advanced = False
        self._restarts: list[tuple[float, float]] = []
        self._rests = False
        self._failure: RunFailure | None = None
        self._seen: Packing | None = None
        """The bed in the middle of the window, which is drawn at the end."""
        self._unseen = False
        self.film = demand.film
        self._observes(demand.shared.probes)

    @property
    def declared(self) -> tuple[Probe, ...]:
        """Those of all runs of its point, so that recorded ones and others share an ensemble."""
        return tuple(dict.fromkeys((*self.demand.shared.declared, *self.probes)))

    def _observes(self, probes: Sequence[Probe]) -> None:
        """Observe `probes` and, if the run is recorded, its frames."""
        self._measured = tuple(probes)
        self.probes = tuple(dict.fromkeys((*probes, *((self.film,) if self.film else ()))))

    # start

    def fresh(self) -> Packing:
        """The packing, with the outlet open, and the kick of a further discharge."""
        packing = self._packed
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
        _ = self._feeder  # which may have no room
        start, kick = opened(packing, self.demand.shared.closed, self.scene), self.demand.kick
        return start if kick is None else kicked(start, self.scene, kick, self.demand.seed)

    @cached_property
    def _feeder(self) -> Feeder | Inflow | None:
        """What puts grains back; None where none come back. Raises JobFailed."""
        if self.scene.feed is None:
            return None
        try:
            if self.scene.feed.stream is not None:
                return Inflow(self.scene, self._packed, self.demand.seed, self.numerics.beat)
            return Feeder(self.scene, self._packed, self.demand.filling.kind, self.demand.seed)
        except PlacingError as error:
            raise JobFailed(f"{self.label}: {error}") from error

    @cached_property
    def _breaker(self) -> Breaker | None:
        """Breaks arches; None where a stop ends the run."""
        if self.scene.restart is None:
            return None
        return Breaker(self.scene, self.demand.seed, self.numerics.beat)

    @cached_property
    def _packed(self) -> Packing:
        try:
            return load_packing(self.bench.lab.packing(self.keys.packing))
        except Unreadable as problem:
            raise JobFailed(f"{self.label}: {problem}; delete the folder, and labbook run makes it again") from problem

    def recall(self, saved: Saved | None) -> Saved | None:
        """The later of what is in the work folder and in the run's folder, if it observes all that is
        asked. Raises Unreadable for a damaged work folder; a damaged run is noted, and made again."""
        if saved is not None:
            self._check_saved(saved)
        before = self._before()
        if before and (not saved or saved.step <= before.coverage.steps):
            saved = self._from_folder(before) or saved
        if saved is None or not self._suffices(saved.state):
            if before:
                self._observe_also(before)
            self.start_over()
            return None
        state = saved.state
        self._crossed, self._last = int(state["crossed"]), float(state["last"])
        self._discharged = float(state.get("discharged", self._crossed / self.scene.grains.count))
        self._restarts = _restarts(state)
        self._looked = self._looks()
        self.film = parse_film(state["film"], self.numerics)
        self._observes([parse_probe(text) for text in state["probes"]])
        return saved

    def _check_saved(self, saved: Saved) -> None:
        """Whether everything in the work folder belongs together. Raises Unreadable."""
        folder, state = self.journal.folder, saved.state
        try:
            probes = {table_name(probe): probe for probe in map(parse_probe, state["probes"])}
            if (film := parse_film(state["film"], self.numerics)) is not None:
                probes[FILM_TABLE] = film
            _restarts(state)
            crossed, last, left = int(state["crossed"]), float(state["last"]), float(state.get("discharged", 0.0))
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise Unreadable(f"{folder / PROGRESS}: state: {type(error).__name__}: {error}") from error
        most = math.inf if self.scene.feed is not None else 1 + 1e-9  # of the bed
        if not (0 <= crossed <= most * self.scene.grains.count and math.isfinite(last) and 0 <= left <= most):
            raise Unreadable(f"{folder / PROGRESS}: state: {crossed} crossed, the last at {last} s, {left} of the mass")
        for name, table in self.journal.each():
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

    def _before(self) -> RunRecord | None:
        try:
            return RunRecord.read(self.place)
        except Unreadable as problem:
            if self.place.exists():
                self.damaged[self.place] = str(problem)
            return None

    def _from_folder(self, before: RunRecord) -> Saved | None:
        """A finished run as if it had been saved at its end; None if its state cannot be read."""
        try:
            saved, rows = at_its_end(self.place, before)
            self.check(saved, self.place)
        except Unreadable as problem:
            self.damaged[self.place] = str(problem)
            return None
        self.start_over()
        self.journal.save(saved.checkpoint, rows, saved.state, saved.sessions)
        return saved

    def _suffices(self, state: Mapping[str, Any]) -> bool:
        film = parse_film(state["film"], self.numerics)
        filmed = self.film is None or (film is not None and film.as_often(self.film))
        return filmed and not unobserved(self.demand.shared.probe_names, state["probes"])

    def _observe_also(self, before: RunRecord) -> None:
        """When running again, observe what the earlier run did too, so that nothing is lost."""
        kinds = {table_name(probe) for probe in self._measured}
        more = [probe for probe in map(parse_probe, before.coverage.probes) if table_name(probe) not in kinds]
        film = film_of(before)
        if film is not None and (self.film is None or film.every < self.film.every):
            self.film = film
        self._observes((*self._measured, *more))

    # going on

    def state(self) -> dict[str, Any]:
        """Grains that left, their part of the mass, when the last one did, and what is observed."""
        return {
            "crossed": self._crossed,
            "discharged": self._discharged,
            "last": self._last,
            "probes": [describe_probe(probe) for probe in self._measured],
            "film": describe_probe(self.film) if self.film else None,
            **({"restarts": [list(restart) for restart in self._restarts]} if self._restarts else {}),
        }

    def absorb(self, probe: Probe, table: Table) -> None:
        """Keep rows; count grains that left."""
        if isinstance(probe, Crossing) and probe.plane == self._plane and len(table["time"]):
            self._crossed += len(table["time"])
            if self.scene.grains.varied:
                self._discharged += float(self._part_of_mass[table["id"]].sum())
            else:
                self._discharged = self._crossed / self.scene.grains.count
            self._last = max(self._last, float(np.max(table["time"])))
        if probe == self.film:
            self.keep(FILM_TABLE, frame_rows(table))
        if probe in self._measured:
            self.keep(table_name(probe), frame_rows(table) if isinstance(probe, _FRAMED) else table)

    @property
    def looks(self) -> bool:
        """True if the bed is in the middle of the window, and to be drawn."""
        if self._seen is not None or self._unseen or self._plane is None or self.demand.seed > PICTURED:
            return False
        middle = (self.observe.start + self.observe.end) / 2
        reached = self.status.time if self.observe.timed else self._discharged
        return reached >= middle

    def look(self, ensemble: Ensemble, member: Member) -> None:
        """Keep the bed as it is, for a picture of it."""
        try:
            self._seen = ensemble.packing(member)
        except Exception as problem:
            self._unseen = True
            _no_picture(self.label, problem)

    def after(
        self, status: Status, tables: Mapping[Probe, Table], wall: float, process: float, grain_steps: float
    ) -> None:
        """Account for a beat; after a failed one the member is in the last good state, into which grains came back."""
        self._advanced = status.step > self.status.step
        super().after(status, tables, wall, process, grain_steps)

    @property
    def lacks_grains(self) -> bool:
        """True if grains have left: a state that is saved has those that are put back after its beat."""
        return self._feeder is not None and self._advanced and self.status.grains < self.scene.grains.count

    def refill(self, bed: Packing) -> Refill:
        """Return this bed with the grains that it has lost after this beat."""
        assert self._feeder is not None
        return Refill(self._feeder, bed, self._beat)

    @property
    def pauses(self) -> bool:
        """True if no grain has left for so long that the flow may have stopped, or if a push is due after a stop."""
        if self._breaker is None:
            return self.demand.shared.stop.still and self._waits
        return self._advanced and (self._push is not None if self._stuck else self._waits)

    def intervene(self, ensemble: Ensemble, member: Member, bed: Packing) -> None:
        """Note that the flow has stopped if the grains near the outlet are still; push them where arches are broken."""
        if not self._stuck:
            self._rests = still(self.scene, bed)
        if self._breaker is None or not (self._stuck or self._rests):
            return
        if not self._stuck:
            self._restarts.append((self._last, self.status.time))
        number, self._rests = self._push, False
        assert number is not None
        ensemble.set_velocities(member, *self._breaker.pushed(bed, self._beat, number))

    @property
    def _beat(self) -> int:
        """Beats since the opening."""
        return self.status.step // self.numerics.steps_per_beat

    @property
    def _idle(self) -> float:
        """Time [s] since the last grain left or the last part vanished; negative before that."""
        return self.status.time - max([self._last, *self._removals])

    @cached_property
    def _removals(self) -> list[float]:
        """Times [s] at which parts vanish."""
        return [wall.removal for wall in self.scene.container.walls() if wall.removal is not None]

    @property
    def _waits(self) -> bool:
        """True if no grain has left for so long that the flow may count as stopped."""
        return self._idle >= self._stop_time

    @cached_property
    def _stop_time(self) -> float:
        return stop_time(self.scene)

    @property
    def _stuck(self) -> bool:
        """True if no grain has left since the arch was pushed last."""
        return bool(self._restarts) and self._last <= self._restarts[-1][1]

    @property
    def _push(self) -> int | None:
        """Number of the push that is due after this beat, from 1 on, since the last restart; None if none is."""
        assert self._breaker is not None
        return self._breaker.push(self._beat - round(self._restarts[-1][1] / self.numerics.beat))

    def verdict(self, events: Sequence[Event]) -> Outcome | None:
        """The stop rule."""
        failed = failure(events)
        if failed:
            self._failure = RunFailure(guard=failed.guard, step=failed.step, grain=failed.grain, message=failed.message)
            return "diverged"
        stop = self.demand.shared.stop
        if self._discharged >= self._enough:
            return "finished"
        if stop.precise is not None and self._is_precise(stop.precise):
            return "precise"
        if self.status.grains == 0 or any(isinstance(event, Emptied) for event in events):
            return "emptied"
        if self._plane is not None and self._idle >= 0 and (self._rests or self._idle >= stop.stall):
            return "clogged"
        return "time-limit" if self.status.time >= stop.max_time else None

    def _is_precise(self, asked: Precise) -> bool:
        """Whether the flow rate is known as precisely as asked, and has no trend; looked at now and then only."""
        looked, self._looked = self._looked, self._looks()
        if self._looked <= looked:
            return False
        grains, table = self.scene.grains, self.tables()[table_name(Crossing())]
        times, mass = passages(grains, self._packed, table)
        flow = steady_flow(times, grains.count, self.demand.shared.study.window, mass)
        self._precision = math.inf if flow is None or flow.trend.trending else flow.precision
        known = {HALF_WIDTH: self._precision} if math.isfinite(self._precision) else {}
        at = self.demand.point.at
        look = Generation(0, (Assignment(at),), "", (Trial(at, self.demand.seed, self.key, "going on", known),))
        history = History(self.demand.shared.study, (look,), (), 1)
        return PreciseRun.of(error=asked.flow_rate).propose(history).state == "end"

    def _looks(self) -> int:
        """How often its flow rate was looked at so far."""
        precise = self.demand.shared.stop.precise
        return 0 if precise is None else looks(int((self._discharged - precise.start) * self.scene.grains.count))

    def progress(self) -> float:
        """By discharged fraction, by time or by precision, whichever is nearest to its end."""
        stop = self.demand.shared.stop
        known = 0.0 if stop.precise is None else (stop.precise.flow_rate / self._precision) ** 2
        return min(1.0, max(self._discharged / self._enough, self.status.time / stop.max_time, known))

    def doing(self) -> tuple[str, ...]:
        """The part of the mass that has left, where that ends the run, how long the flow rests, and the simulated
        time; without an outlet, the simulated time and the longest."""
        if self._plane is None:
            return (f"{self.status.time:.2f} of {self.demand.shared.stop.max_time:g} s",)
        discharged = f"{percent(self._discharged, '.0f')} discharged, ends at {percent(self._enough, '.0f')}"
        if (stop := self.demand.shared.stop).fed:
            known = f", W to {percent(self._precision, '.2f')}" if math.isfinite(self._precision) else ""
            asked = f", ends at {percent(stop.precise.flow_rate)}" if stop.precise else f", ends at {stop.max_time:g} s"
            discharged = f"{percent(self._discharged, '.0f')} of the bed has passed{known}{asked}"
        still, stall = self._idle, self.demand.shared.stop.stall
        waiting = (f"no grain for {still:.2f} s, clogged after {stall:g} s",) if still > _STILL * stall else ()
        return discharged, *waiting, f"{self.status.time:.2f} s"

    @cached_property
    def _bed_height(self) -> float:
        """Height [m] of the settled bed above the outlet plane."""
        return bed_height(self.scene.grains, self._packed, self._plane or 0.0)

    @cached_property
    def _part_of_mass(self) -> np.ndarray:
        """Of the mass of all grains, the part that each is, by id."""
        return parts_of_mass(self.scene.grains, self._packed)

    @cached_property
    def _enough(self) -> float:
        """Discharged fraction at which the run has come far enough."""
        shared = self.demand.shared
        return shared.reach(self._bed_height) if shared.stop.fill_height is not None else shared.stop.discharged

    # end

    def kept(self, verdict: str, left: EndState) -> "KeptRun":
        """All of it."""
        drawn = not self._unseen and (self.demand.seed <= PICTURED or verdict in ("clogged", "diverged"))
        return KeptRun(
            self.bench.lab,
            self.key,
            self.place,
            self.label,
            record=self._record(verdict),
            status=self.status,
            journal=self.journal,
            unsaved=self._rows,
            left=left,
            start=self._packed,
            drawn=drawn,
            seen=self._seen,
            before=self._before_opening(),
        )

    def _before_opening(self) -> "BeforeOpening | None":
        """The bed at rest, where forces of walls are observed."""
        probe = next((one for one in self._measured if isinstance(one, Traction)), None)
        if probe is None:
            return None
        shared = self.demand.shared
        return BeforeOpening(self.bench.backend, shared.closed, shared.filled_by, probe)

    def _record(self, verdict: str) -> RunRecord:
        """What the run says of itself, but for its ledger."""
        bench, demand, status = self.bench, self.demand, self.status
        coverage = Coverage(
            duration=status.time,
            steps=status.step,
            grains=self.scene.grains.count,
            crossed=self._crossed,
            mass_left=self._discharged if self.scene.grains.varied else None,
            last_crossing=self._last,
            stop=demand.shared.stop,
            guards=demand.guards,
            probes=tuple(describe_probe(probe) for probe in self._measured),
            recording=self.film.every if self.film else None,
            every_frame=self.film is not None,
            restarts=tuple(self._restarts),
            bed_height=self._bed_height if demand.shared.stop.fill_height is not None else None,
        )
        physics = bench.backend.describe(self.scene, self.numerics)
        return RunRecord.model_validate(
            {
                "run_key": self.keys.run,
                "experiment_key": self.keys.experiment,
                "scene_key": self.keys.scene,
                "packing_key": self.keys.packing,
                "lineage_key": self.keys.lineage,
                "backend": bench.backend.capabilities.name,
                "cache_version": bench.backend.capabilities.cache_version,
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
                "device": bench.device,
                "finished": now(),
                "sessions": self.sessions(),
            }
        )


@dataclass(frozen=True)
class BeforeOpening:
    """Forces of walls on a bed at rest, in the scene of its filling: with the lid in place."""

    backend: Backend
    closed: Scene
    numerics: Numerics
    probe: Traction

    def rows(self, packing: Packing, scene: Scene) -> Table | None:
        """Rows of the probe at step 0, without the column `member`; None of a backend that cannot tell.

        Walls are numbered as `all_walls` does: those of the opened `scene` first.
        """
        table = self.backend.tractions(self.closed, self.numerics, packing, self.probe)
        if table is None:
            return None
        places = {wall.name: place for place, wall in enumerate(all_walls(scene.container))}
        number = np.array([places[wall.name] for wall in self.closed.container.walls()], np.int64)
        rows = {name: column for name, column in table.items() if name != "member"}
        return frame_rows({**rows, "wall": number[table["wall"]]})


@dataclass(frozen=True)
class KeptRun(Kept):
    """A run that has ended. record: without its ledger. unsaved: rows since the last save. start: its packing. drawn:
    whether there is to be a picture. seen: the bed that it shows; None: that at the end. before: as of `BeforeOpening`,
    where forces of walls are observed."""

    record: RunRecord
    status: Status
    journal: Journal
    unsaved: Mapping[str, Sequence[Table]]
    left: EndState
    start: Packing
    drawn: bool
    seen: Packing | None
    before: BeforeOpening | None = None

    def fill_folder(self, folder: Path) -> None:
        """Tables, the exact last state, the recording, the picture, and the record."""
        for name, table in self._tables.items():
            write_table(folder / f"{name}.npz", table, durable=False)
        write_checkpoint(folder / CHECKPOINT, self.left.checkpoint, compress=True, durable=False)
        if picture := self._drawn():
            (folder / PICTURE).write_bytes(picture)
        self._complete.write(folder, durable=False)

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
    def _complete(self) -> RunRecord:
        """The record with its ledger."""
        counts = ledger(self.record.scene, self.status, self.left.packing, self.start, self._tables.get("crossing"))
        return self.record.model_copy(update={"ledger": counts})

    def _drawn(self) -> bytes:
        """A picture of its bed. No run is lost for its picture: it then has none, and the log says why."""
        if not self.drawn:
            return b""
        try:
            return bed(self.record.scene, self.start, self.left.packing if self.seen is None else self.seen)
        except Exception as problem:
            _no_picture(self.label, problem)
            return b""

    def entry(self) -> LabEntry:
        """Return the rows of the run and of its measurements, taken now."""
        seen, record, tables = stamp(self.place), self._complete, dict(self._tables)
        tables |= self._complete.coverage.restart_table
        recorded = tables.pop(FILM_TABLE, None)
        try:
            check_tables(self.place, record, self._tables)
        except Unreadable as problem:
            return LabEntry((unreadable_row(self.place, seen, problem), []))
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
        return LabEntry(rows_of_run(self.place, seen, record, data, record.observe))

    def reread(self) -> LabEntry:
        """Return the rows of the run and of its measurements, by its folder."""
        return LabEntry(run_rows(self.place, self.record.observe))


def _restarts(state: Mapping[str, Any]) -> list[tuple[float, float]]:
    """Restarts in a saved state. Raises ValueError or TypeError for what are none."""
    return [(float(stopped), float(time)) for stopped, time in state.get("restarts", [])]


def _no_picture(label: str, problem: Exception) -> None:
    _LOG.warning("%s: the bed was not drawn: %s: %s", label, type(problem).__name__, problem)
    _LOG.debug("where that was", exc_info=True)


PICTURED = 10
"""Seeds from 1 on of which the bed is drawn, beside those that clogged or diverged: a picture takes as long as all else
that is written of a small bed."""
FILM_TABLE = Path(RECORDING).stem
_STILL = 0.3
"""Part of the stall time without a grain leaving that is worth a word."""


def parse_film(text: str | None, numerics: Numerics) -> Film | None:
    """The recording probe in a saved state; older ones counted whole beats. Raises ValueError for another one."""
    probe = parse_probe(text) if text else None
    if isinstance(probe, Sample):
        return Film(probe.every * numerics.beat, probe.fields)
    if probe is None or isinstance(probe, Film):
        return probe
    raise ValueError(f"film: no frames of grains, but {text}")


def frame_rows(table: Table) -> Table:
    """Rows of grains, contacts or walls in single precision, but for ids, step and time.

    Positions are then known to 1e-8 m and velocities to 1e-7 of themselves: far below what fields resolve.
    """
    return {name: np.asarray(column).astype(_WHOLE.get(name, np.float32)) for name, column in table.items()}
