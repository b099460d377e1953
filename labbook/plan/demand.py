"""What a study asks for, run by run: the experiment, how it is computed, and what must be observed."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

from labbook.backend import Backend, Capabilities, Spec
from labbook.backend.numerics import Numerics, Precision
from labbook.backend.probes import UNEVEN, Crossing, Film, Probe, describe_probe, film_probe, table_name
from labbook.filling import Kick, bed, lifted, placing
from labbook.lab import identity
from labbook.lab.identity import Filling, Keys, Maker, Versions
from labbook.lab.records import Precise, StopRule, repeat
from labbook.measure import MEASURES
from labbook.scene import Scene
from labbook.scene.model import once
from labbook.scene.quantities import span
from labbook.scene.timescales import gravity_time
from labbook.stats import StoppingRule
from labbook.stats.nested import LARGEST
from labbook.study import Point, Study
from labbook.study.applicable import flat_area
from labbook.study.schema import AUTO, EVERY, LONGEST, STALL, Stop

_ENOUGH = math.ceil(1 / UNEVEN)
"""Steps between two frames from which on these are as close to each other as asked."""


class Conflict(Exception):
    """A study asks for observations that cannot be made in one run, or for a container that cannot do what it is said
    to; the message says which."""


@dataclass(frozen=True)
class PackingsOf:
    """The backend whose packings runs start from, and the precision in which it makes them."""

    backend: Capabilities
    precision: Precision


@dataclass(eq=False, slots=True)
class PointDemand:
    """All that the runs of one point have in common."""

    study: Study
    point: Point
    packings_of: PackingsOf | None = None
    """Whose packings its runs start from; None: each backend makes its own."""
    specs: tuple[Backend, Spec, Spec] | None = field(default=None, init=False, repr=False)
    """The backend that was asked last, and its sets of features for filling and discharge (`labbook.plan.plan`)."""
    outline: Any = field(default=None, init=False, repr=False)
    """What is foreseen of its runs (`labbook.plan.forecast`), once that was asked for."""
    _scene_key: str = field(default="", init=False, repr=False)
    _closed_key: str = field(default="", init=False, repr=False)
    _versions: Versions = field(default_factory=dict, init=False, repr=False)
    _lineage_scenes: tuple[str, str] | None = field(default=None, init=False, repr=False)
    _older: tuple[tuple[str, tuple[str, str]], ...] | None = field(default=None, init=False, repr=False)
    _probes: tuple[Probe, ...] | None = field(default=None, init=False, repr=False)
    _stop: StopRule | None = field(default=None, init=False, repr=False)

    @property
    def scene(self) -> Scene:
        """The open scene."""
        return self.point.scene

    @property
    def closed(self) -> Scene:
        """The scene of its filling. Those of a few points are remembered: to keep all takes more memory than the rest
        of a study."""
        return _closed(self)

    @property
    def lifted(self) -> Scene | None:
        """The scene of its filling while upright walls move, to mobilise their friction; None where they never do."""
        mobilise = self.point.fill.mobilise
        return mobilise and lifted(self.closed, mobilise.velocity)

    @property
    def numerics(self) -> Numerics:
        """How the discharge is computed."""
        return self.point.numerics

    @property
    def filled_by(self) -> Numerics:
        """How the filling is computed."""
        numerics = self.point.fill.numerics or self.numerics
        return numerics if self.packings_of is None else _in_precision(numerics, self.packings_of.precision)

    def maker(self, backend: Capabilities) -> Maker:
        """What makes the packings of runs on `backend`."""
        return Maker(backend if self.packings_of is None else self.packings_of.backend, self.filled_by)

    @property
    def scene_key(self) -> str:
        """Key of the open scene."""
        self.identify()
        return self._scene_key

    @property
    def closed_key(self) -> str:
        """Key of the closed scene."""
        self.identify()
        return self._closed_key

    def identify(self, closed: Scene | None = None) -> None:
        """Make the keys of both scenes, if there are none yet; `closed`: the closed one, if it is at hand."""
        if not self._scene_key:
            closed = closed or self.closed
            self._closed_key = identity.scene_key(closed)
            self._scene_key = identity.scene_key(self.scene)
            self._versions = identity.versions(closed) | identity.versions(self.scene)
            if identity.hashed(self._versions):
                bare = identity.numbered(self._versions)
                self._lineage_scenes = identity.scene_key(self.scene, bare), identity.scene_key(closed, bare)

    @property
    def versions(self) -> Versions:
        """Versions of the laws and walls of both scenes, as installed."""
        self.identify()
        return self._versions

    @property
    def lineage_scenes(self) -> tuple[str, str]:
        """Keys of the open and of the closed scene whatever the source of extensions, as lineages have them."""
        self.identify()
        return self._lineage_scenes or (self._scene_key, self._closed_key)

    @property
    def older(self) -> tuple[tuple[str, tuple[str, str]], ...]:
        """What has changed since each older version of laws and walls, the newest first, and the keys of the open and
        of the closed scene by that version."""
        if self._older is None:
            closed, now = self.closed if self.versions else self.scene, self.versions
            self._older = tuple(
                (identity.outdated(made, now), (identity.scene_key(self.scene, made), identity.scene_key(closed, made)))
                for made in identity.older(now)
            )
        return self._older

    @property
    def probes(self) -> tuple[Probe, ...]:
        """What every run observes: grains leaving, and what the study's measures need. Raises Conflict."""
        if self._probes is None:
            self._probes = self._asked_probes()
        return self._probes

    def _asked_probes(self) -> tuple[Probe, ...]:
        plane = self.scene.container.outlet_plane
        leaving: tuple[Probe, ...] = () if plane is None else (Crossing(plane=plane),)
        window = self.study.window
        measures = [MEASURES[name] for name in self.study.measure]
        asked = (probe for one in measures for probe in one.observed(self.scene, self.numerics, window))
        probes = tuple(dict.fromkeys((*leaving, *asked)))
        by_table = {table_name(probe): probe for probe in probes}
        for probe in probes:
            if by_table[table_name(probe)] != probe:
                raise Conflict(
                    f"measure: {probe} and {by_table[table_name(probe)]} cannot be observed in one run; "
                    "put the measures that need them into two studies"
                )
        return probes

    @property
    def film(self) -> Film | None:
        """The probe by which runs are recorded. Raises Conflict if frames cannot be as close to each other as asked."""
        record = self.study.record
        if record is None:
            return None
        every, dt = self.frame_interval, self.numerics.dt
        assert every is not None
        film = film_probe(every, self.scene.grains)
        if film.uneven(dt) > UNEVEN:
            few = every / dt
            raise Conflict(
                f"{self.study.path}: record.every: frames lie on time steps, and {span(every)} is {few:.3g} "
                f"steps of {span(dt)} (at {self.point.label})\n    remedy: use {span(_ENOUGH * dt)} or more"
            )
        return film

    @property
    def frame_interval(self) -> float | None:
        """Time between two frames [s] of its recorded runs; None if none are recorded."""
        record = self.study.record
        return None if record is None else record.every or EVERY * gravity_time(self.scene)

    @property
    def declared(self) -> tuple[Probe, ...]:
        """The probes of an ensemble that takes runs of this point, recorded or not."""
        return self.probes if self.film is None else tuple(dict.fromkeys((*self.probes, self.film)))

    @property
    def longest_filling(self) -> float:
        """Time [s] after which a bed that still moves is an error."""
        return self.point.fill.max_time or LONGEST * gravity_time(self.scene) + self.pouring_time

    @property
    def pouring_time(self) -> float:
        """Time [s] in which a stream brings all grains; 0 without one."""
        stream, grains = self.point.fill.stream, self.scene.grains
        return 0.0 if stream is None else grains.count * grains.volume * grains.mean_density / stream.rate

    @property
    def stop(self) -> StopRule:
        """When a run ends."""
        if self._stop is None:
            self._stop = self._stated_stop()
        return self._stop

    def _stated_stop(self) -> StopRule:
        study, scale = self.study, gravity_time(self.scene)
        until = study.window.end if study.window.timed else 0.0
        if not study.fed:
            return _stop_rule(study.stop, scale, until)
        asked = tolerance(study, self.point)
        return _stop_rule(study.stop, scale, until, None if asked is None else (asked, study.window.start), fed=True)

    @property
    def unstated(self) -> frozenset[str]:
        """Which numbers of the stop rule, the guards and the recording the study leaves to labbook."""
        stop, record = self.study.stop, self.study.record
        limited = "speed_limit" in self.study.stated.get("numerics", {}) or "numerics.speed_limit" in self.point.at
        left = {
            "max_time": stop.max_time is None,
            "stall": stop.stall is None,
            "recording": record is not None and record.every is None,
            "speed_limit": not limited,
        }
        return frozenset(name for name, is_left in left.items() if is_left)

    @property
    def height_ahead(self) -> float | None:
        """Height [m] that the bed of a flat-bottomed silo will have at a packing fraction of PACKED; None of other
        containers."""
        return None if flat_area(self.scene.container) is None else bed.bed_height_ahead(self.scene)

    def reach(self, height: float | None = None) -> float:
        """Discharged fraction at which the stop rule ends a run whose bed is `height` [m] high (None: as foreseen);
        infinite for one that is fed."""
        stop = self.stop
        if stop.fill_height is None or (height := height or self.height_ahead) is None:
            return stop.discharged
        return min(stop.discharged, max(0.0, 1 - stop.fill_height / height))

    @property
    def probe_names(self) -> frozenset[str]:
        """What every run observes, as coverage compares it."""
        return _names(self.probes)

    def run(self, seed: int, discharge: int = 1) -> "Demand":
        """The run with this seed, which is this discharge of its bed."""
        record = self.study.record
        recorded = record is not None and discharge == 1 and seed <= record.replicates
        return Demand(self, seed, recorded=recorded, discharge=discharge)

    def runs(self, beds: int, discharges: int) -> "Iterator[Demand]":
        """The runs of so many beds with so many discharges each, by seed."""
        return (self.run(seed, number) for seed in range(1, beds + 1) for number in range(1, discharges + 1))


@lru_cache(maxsize=256)
def _closed(shared: PointDemand) -> Scene:
    fill = shared.point.fill
    return shared.scene.close(fill.friction, fill.contact, fill.surface_motion)


@lru_cache(maxsize=1024)
def _names(probes: tuple[Probe, ...]) -> frozenset[str]:
    return frozenset(map(describe_probe, probes))


@once(64)
def _in_precision(numerics: Numerics, precision: Precision) -> Numerics:
    return numerics.model_copy(update={"precision": precision})


@once(256)
def _stop_rule(
    stated: Stop, scale: float, least: float, precise: tuple[float, float] | None = None, *, fed: bool = False
) -> StopRule:
    """The rule that a study states, with multiples of `scale`, sqrt(d*/g) [s], where it leaves times out, but no end
    before `least` [s]; of beds that are fed, with the error and the start of the window where the flow rate is to be
    known."""
    usual: dict[str, Any] = {"max_time": max(LONGEST * scale, least), "stall": STALL * scale}
    stop = StopRule.model_validate(usual | {key: v for key, v in stated.model_dump().items() if v is not None})
    if not fed:
        return stop
    until = None if precise is None else Precise(flow_rate=precise[0], start=precise[1])
    return stop.model_copy(update={"discharged": math.inf, "precise": until})


@dataclass(frozen=True, eq=False, slots=True)
class Demand:
    """One run that a study asks for."""

    shared: PointDemand
    seed: int
    recorded: bool
    discharge: int = 1
    """Number of the discharge of its bed."""

    @property
    def kick(self) -> Kick | None:
        """The kick that it starts with; None of the first discharge of its bed."""
        return None if self.discharge == 1 else Kick(self.discharge)

    @property
    def number(self) -> tuple[int, int]:
        """Seed of its bed, and number of the discharge of that."""
        return self.seed, self.discharge

    @property
    def repeat(self) -> str:
        """The number of a run among those of its point, for people: `seed 3, discharge 2`."""
        return repeat(self.seed, self.discharge)

    @property
    def point(self) -> Point:
        """The point of the study."""
        return self.shared.point

    @property
    def filling(self) -> Filling:
        """How its packing is made."""
        fill, scene = self.point.fill, self.shared.scene
        start, moving = placing.STARTS[fill.kind], fill.moving
        if moving is None:
            rolls = "settled_below" not in fill.model_fields_set and bed.unbraked(
                scene.grains, fill.contact or scene.contact
            )
            moving = start.moving if rolls else 0.0
        optional = fill.grain_file, fill.mobilise, fill.stream, fill.until
        return Filling(fill.kind, self.seed, fill.settled_below, start.version, moving, *optional)

    @property
    def film(self) -> Film | None:
        """The probe by which this run is recorded, if it is."""
        return self.shared.film if self.recorded else None

    @property
    def recording(self) -> float | None:
        """Time between recorded frames [s], if this run is recorded."""
        return self.film.every if self.film else None

    @property
    def guards(self) -> dict[str, float]:
        """The guards of its numerics."""
        return identity.guards(self.shared.numerics)

    def keys(self, backend: Capabilities, scenes: tuple[str, str] | None = None) -> Keys:
        """Identities of this run on `backend`; `scenes` as for `lineage`."""
        s = self.shared
        opened, closed = scenes or (s.scene_key, s.closed_key)
        lineage = scenes or s.lineage_scenes
        maker = s.maker(backend)
        return identity.run_keys(opened, closed, self.filling, s.numerics, backend, maker, lineage, self.kick)

    def run_key(self, backend: str, version: int) -> str:
        """Key of this run on one version of the backend called `backend`."""
        s = self.shared
        made = (backend, version)
        if s.packings_of is not None:
            made = (s.packings_of.backend.name, s.packings_of.backend.cache_version)
        packing = identity.packing_key(s.closed_key, self.filling, s.filled_by, *made)
        experiment = identity.experiment_key(s.scene_key, packing, self.kick)
        return identity.run_key(experiment, s.numerics, backend, version)

    def lineage(self, backend: str, scenes: tuple[str, str] | None = None) -> str:
        """Identity of this run on any version of the backend called `backend`. `scenes`: keys of the open and of the
        closed scene, if not by laws and walls as installed."""
        s = self.shared
        opened, closed = scenes or s.lineage_scenes
        made = backend if s.packings_of is None else s.packings_of.backend.name
        return identity.lineage_from(opened, closed, self.filling, s.filled_by, made, s.numerics, backend, self.kick)

    def older_lineages(self, backend: str) -> Iterator[tuple[str, str]]:
        """Lineages of this run by older versions of laws and walls, the newest first, and what has changed since."""
        for outdated, scenes in self.shared.older:
            yield self.lineage(backend, scenes), outdated


def demands(study: Study, seeds: int, packings_of: PackingsOf | None = None) -> Iterator[Demand]:
    """All runs that the study may have of the seeds 1..`seeds` of every point: first the first seed of all points, then
    the second, and so on. `packings_of`: the backend whose packings they start from, None for their own."""
    shared = [PointDemand(study, point, packings_of) for point in study.points]
    numbers = range(1, discharges(study)[1] + 1)
    for seed in range(1, seeds + 1):
        yield from (point.run(seed, number) for number in numbers for point in shared)


def discharges(study: Study) -> tuple[int, int]:
    """Numbers of discharges that each bed of the study has at first, and at most."""
    number = study.discharges_per_bed
    return (1, LARGEST) if number == AUTO else (number, number)


def fewest_runs(study: Study, point: Point | None = None) -> int:
    """Runs that a point has at least; None as `point`: any that no strategy has proposed."""
    beds = (None if point is None else point.replicates) or study.replicates
    return beds * discharges(study)[0]


def recorded_in_words(points: Iterable[PointDemand]) -> str:
    """Which runs of the points of a study are recorded, and how often; empty if none are."""
    every = {point.frame_interval: point.study.record for point in points}
    apart = sorted(interval for interval in every if interval is not None)
    if not apart or (record := every[apart[0]]) is None:
        return ""
    seeds = "seed 1" if record.replicates == 1 else f"seeds 1 to {record.replicates}"
    times = " to ".join(dict.fromkeys((span(apart[0]), span(apart[-1]))))
    return f"Recorded: {seeds} of each point, a frame every {times} from the opening on"


def tolerance(study: Study, point: Point | None = None) -> float | None:
    """What the bias of a point's numerics leaves of the error that is tolerated in its flow rate. None as `point`: any
    point, whose numerics are not known to have a bias."""
    return study.accuracy.flow_rate if point is None or point.choice is None else point.choice.left


def stopping_rule(study: Study, point: Point | None = None) -> StoppingRule:
    """The rule by which replicates are added to a point of `study`: until the half width of the interval is within the
    `tolerance`. None are added for W where beds are fed, since there each run goes on for as long as it takes, nor
    where a strategy has proposed how many there shall be. The cap is that of `accuracy.clogging` too."""
    proposed = [one.replicates for one in (study.points if point is None else (point,)) if one.replicates is not None]
    if proposed:
        return StoppingRule(tolerance=None, minimum=max(proposed), cap=max(proposed))
    asked, least = tolerance(study, point), study.replicates
    cap = max(least, study.accuracy.max_replicates)
    if asked is None or study.fed:
        return StoppingRule(tolerance=None, minimum=least, cap=least if study.accuracy.clogging is None else cap)
    return StoppingRule(tolerance=asked, minimum=least, cap=cap)
