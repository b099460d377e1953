"""Demands: the runs that a study asks for, with their scenes, numerics and observations."""

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

_MIN_FRAME_STEPS = math.ceil(1 / UNEVEN)
"""Minimum number of steps between two frames with which their spacing is even enough."""


class Conflict(Exception):
    """A study demands observations that one run cannot make, or has an impossible container; the message says which."""


@dataclass(frozen=True)
class PackingsOf:
    """Backend whose packings runs start from, and the precision with which it makes them."""

    backend: Capabilities
    precision: Precision


@dataclass(eq=False, slots=True)
class PointDemand:
    """Shared part of the demands of one point.

    Args:
        study: The study.
        point: The point.
        packings_of: Backend whose packings its runs start from; None: each backend makes its own.

    Attributes:
        specs: Backend of the last request, with its Specs of filling and discharge (`labbook.plan.possible`).
        outline: Forecast of its runs (`labbook.plan.forecast`), once it was requested.
    """

    study: Study
    point: Point
    packings_of: PackingsOf | None = None
    specs: tuple[Backend, Spec, Spec] | None = field(default=None, init=False, repr=False)
    outline: Any = field(default=None, init=False, repr=False)
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
        """Scene of the filling. Only those of a few points are cached: all would take more memory than the rest of a
        study."""
        return _closed(self)

    @property
    def lifted(self) -> Scene | None:
        """Scene of the filling while upright walls move, to mobilise their friction; None if they never do."""
        mobilise = self.point.fill.mobilise
        return mobilise and lifted(self.closed, mobilise.velocity)

    @property
    def numerics(self) -> Numerics:
        """Numerics of the discharge."""
        return self.point.numerics

    @property
    def filling_numerics(self) -> Numerics:
        """Numerics of the filling."""
        numerics = self.point.fill.numerics or self.numerics
        return numerics if self.packings_of is None else _in_precision(numerics, self.packings_of.precision)

    def maker(self, backend: Capabilities) -> Maker:
        """Return the backend and numerics of the packings of runs on `backend`."""
        return Maker(backend if self.packings_of is None else self.packings_of.backend, self.filling_numerics)

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
        """Compute the keys of both scenes, if that has not been done. `closed`: the closed scene, if it is
        available."""
        if not self._scene_key:  # both at once, while the walls of both scenes are in memory
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
        """Keys of the open and closed scene without source hashes, as lineages use them."""
        self.identify()
        return self._lineage_scenes or (self._scene_key, self._closed_key)

    @property
    def older(self) -> tuple[tuple[str, tuple[str, str]], ...]:
        """Changes since each older version of laws and walls, the newest first, with the keys of both scenes by it."""
        if self._older is None:
            # Without versions there are no older ones: the closed scene, which is not cached for long, is not made.
            closed, installed = self.closed if self.versions else self.scene, self.versions
            self._older = tuple(
                (
                    identity.outdated(versions, installed),
                    (identity.scene_key(self.scene, versions), identity.scene_key(closed, versions)),
                )
                for versions in identity.older(installed)
            )
        return self._older

    @property
    def probes(self) -> tuple[Probe, ...]:
        """Probes of every run: grains that leave, and those of the study's measures. Raises Conflict."""
        if self._probes is None:
            self._probes = self._required_probes()
        return self._probes

    def _required_probes(self) -> tuple[Probe, ...]:
        plane = self.scene.container.outlet_plane
        leaving: tuple[Probe, ...] = () if plane is None else (Crossing(plane=plane),)
        window = self.study.window
        measures = [MEASURES[name] for name in self.study.measure]
        required = (probe for measure in measures for probe in measure.observed(self.scene, self.numerics, window))
        probes = tuple(dict.fromkeys((*leaving, *required)))
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
        """Probe of the recording; None without. Raises Conflict if the frame interval is too few time steps."""
        record = self.study.record
        if record is None:
            return None
        every, dt = self.frame_interval, self.numerics.dt
        assert every is not None
        film = film_probe(every, self.scene.grains)
        if film.uneven(dt) > UNEVEN:
            steps = every / dt
            raise Conflict(
                f"{self.study.path}: record.every: frames lie on time steps, and {span(every)} is {steps:.3g} "
                f"steps of {span(dt)} (at {self.point.label})\n    remedy: use {span(_MIN_FRAME_STEPS * dt)} or more"
            )
        return film

    @property
    def frame_interval(self) -> float | None:
        """Time between two recorded frames [s]; None if runs are not recorded."""
        record = self.study.record
        return None if record is None else record.every or EVERY * gravity_time(self.scene)

    @property
    def declared(self) -> tuple[Probe, ...]:
        """Probes of an ensemble that takes runs of this point, recorded or not."""
        return self.probes if self.film is None else tuple(dict.fromkeys((*self.probes, self.film)))

    @property
    def longest_filling(self) -> float:
        """Time limit of a filling [s]."""
        return self.point.fill.max_time or LONGEST * gravity_time(self.scene) + self.pouring_time

    @property
    def pouring_time(self) -> float:
        """Time [s] in which a stream brings all grains; 0 without a stream."""
        stream = self.point.fill.stream
        return 0.0 if stream is None else stream.time(self.scene.grains)

    @property
    def stop(self) -> StopRule:
        """Stop rule of the runs."""
        if self._stop is None:
            self._stop = self._resolved_stop()
        return self._stop

    def _resolved_stop(self) -> StopRule:
        study, scale = self.study, gravity_time(self.scene)
        until = study.window.end if study.window.timed else 0.0
        if not study.fed:
            return _stop_rule(study.stop, scale, until)
        tolerated = tolerance(study, self.point)
        return _stop_rule(
            study.stop, scale, until, None if tolerated is None else (tolerated, study.window.start), fed=True
        )

    @property
    def default_names(self) -> frozenset[str]:
        """Names of the values of stop rule, guards and recording that the study does not state."""
        stop, record = self.study.stop, self.study.record
        has_speed_limit = (
            "speed_limit" in self.study.definition.get("numerics", {}) or "numerics.speed_limit" in self.point.at
        )
        defaults = {
            "max_time": stop.max_time is None,
            "stall": stop.stall is None,
            "recording": record is not None and record.every is None,
            "speed_limit": not has_speed_limit,
        }
        return frozenset(name for name, is_default in defaults.items() if is_default)

    @property
    def expected_height(self) -> float | None:
        """Expected height [m] of the bed in a flat-bottomed silo at a packing fraction of PACKED; None of other
        containers."""
        return None if flat_area(self.scene.container) is None else bed.expected_bed_height(self.scene)

    def reach(self, height: float | None = None) -> float:
        """Discharged fraction at which the stop rule ends a run; infinite for a fed bed.

        Args:
            height: Height of the bed [m]; None: as expected.
        """
        stop = self.stop
        if stop.fill_height is None or (height := height or self.expected_height) is None:
            return stop.discharged
        return min(stop.discharged, max(0.0, 1 - stop.fill_height / height))

    @property
    def probe_names(self) -> frozenset[str]:
        """Descriptions of the probes, as coverage compares them."""
        return _names(self.probes)

    def run(self, seed: int, discharge: int = 1) -> "Demand":
        """Return the run of a seed and a discharge of its bed."""
        record = self.study.record
        recorded = record is not None and discharge == 1 and seed <= record.replicates
        return Demand(self, seed, recorded=recorded, discharge=discharge)

    def runs(self, beds: int, discharges: int) -> "Iterator[Demand]":
        """Yield the runs of `beds` beds with `discharges` discharges each, by seed."""
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
    stop_settings: Stop, scale: float, min_time: float, precise: tuple[float, float] | None = None, *, fed: bool = False
) -> StopRule:
    """Resolve the stop rule of a study.

    Args:
        stop_settings: Times that the study states.
        scale: sqrt(d*/g) [s], of which times that it does not state are multiples.
        min_time: Minimum of `max_time` [s].
        precise: For fed beds: demanded error of the flow rate, and start of the window.
        fed: Grains are fed.
    """
    defaults: dict[str, Any] = {"max_time": max(LONGEST * scale, min_time), "stall": STALL * scale}
    stop = StopRule.model_validate(
        defaults | {key: v for key, v in stop_settings.model_dump().items() if v is not None}
    )
    if not fed:
        return stop
    precision = None if precise is None else Precise(flow_rate=precise[0], start=precise[1])
    return stop.model_copy(update={"discharged": math.inf, "precise": precision})


@dataclass(frozen=True, eq=False, slots=True)
class Demand:
    """One run that a study asks for."""

    shared: PointDemand
    seed: int
    recorded: bool
    discharge: int = 1
    """Number of the discharge of its bed, from 1."""

    @property
    def kick(self) -> Kick | None:
        """Kick at its start; None for the first discharge of its bed."""
        return None if self.discharge == 1 else Kick(self.discharge)

    @property
    def number(self) -> tuple[int, int]:
        """Seed of its bed, and number of the discharge."""
        return self.seed, self.discharge

    @property
    def repeat(self) -> str:
        """Label of the run among those of its point: `seed 3, discharge 2`."""
        return repeat(self.seed, self.discharge)

    @property
    def point(self) -> Point:
        """The point of the study."""
        return self.shared.point

    @property
    def filling(self) -> Filling:
        """Preparation of its packing."""
        fill, scene = self.point.fill, self.shared.scene
        start, moving = placing.STARTS[fill.kind], fill.moving
        if moving is None:
            rolls = "settled_below" not in fill.model_fields_set and bed.rolls_without_end(
                scene.grains, fill.contact or scene.contact
            )
            moving = start.moving if rolls else 0.0
        optional = fill.grain_file, fill.mobilise, fill.stream, fill.until
        return Filling(fill.kind, self.seed, fill.settled_below, start.version, moving, *optional)

    @property
    def film(self) -> Film | None:
        """Probe of its recording; None if it is not recorded."""
        return self.shared.film if self.recorded else None

    @property
    def recording(self) -> float | None:
        """Time between recorded frames [s]; None if the run is not recorded."""
        return self.film.every if self.film else None

    @property
    def guards(self) -> dict[str, float]:
        """The guards of its numerics."""
        return identity.guards(self.shared.numerics)

    def keys(self, backend: Capabilities, scenes: tuple[str, str] | None = None) -> Keys:
        """Compute the keys of this run on `backend`. `scenes`: as for `lineage`."""
        shared = self.shared
        opened, closed = scenes or (shared.scene_key, shared.closed_key)
        lineage = scenes or shared.lineage_scenes
        maker = shared.maker(backend)
        return identity.run_keys(opened, closed, self.filling, shared.numerics, backend, maker, lineage, self.kick)

    def run_key(self, backend: str, version: int) -> str:
        """Key of this run on one version of the backend called `backend`."""
        shared = self.shared
        maker = (backend, version)
        if shared.packings_of is not None:
            maker = (shared.packings_of.backend.name, shared.packings_of.backend.cache_version)
        packing = identity.packing_key(shared.closed_key, self.filling, shared.filling_numerics, *maker)
        experiment = identity.experiment_key(shared.scene_key, packing, self.kick)
        return identity.run_key(experiment, shared.numerics, backend, version)

    def lineage(self, backend: str, scenes: tuple[str, str] | None = None) -> str:
        """Lineage key of this run on any version of a backend.

        Args:
            backend: Name of the backend.
            scenes: Keys of the open and closed scene; None: by laws and walls as installed.
        """
        shared = self.shared
        opened, closed = scenes or shared.lineage_scenes
        maker_name = backend if shared.packings_of is None else shared.packings_of.backend.name
        return identity.lineage_from(
            opened, closed, self.filling, shared.filling_numerics, maker_name, shared.numerics, backend, self.kick
        )

    def older_lineages(self, backend: str) -> Iterator[tuple[str, str]]:
        """Lineage keys by older versions of laws and walls, the newest first, each with the changes since."""
        for outdated, scenes in self.shared.older:
            yield self.lineage(backend, scenes), outdated


def demands(study: Study, seeds: int, packings_of: PackingsOf | None = None) -> Iterator[Demand]:
    """Yield all runs that a study may have of the seeds 1 to `seeds`: first seed of all points, then the second, and so
    on.

    `packings_of`: backend whose packings they start from; None: their own.
    """
    shared = [PointDemand(study, point, packings_of) for point in study.points]
    numbers = range(1, discharges(study)[1] + 1)
    for seed in range(1, seeds + 1):
        yield from (point.run(seed, number) for number in numbers for point in shared)


def discharges(study: Study) -> tuple[int, int]:
    """Return the first and the maximum number of discharges of each bed."""
    number = study.discharges_per_bed
    return (1, LARGEST) if number == AUTO else (number, number)


def fewest_runs(study: Study, point: Point | None = None) -> int:
    """Return the minimum number of runs of a point; `point` None: of any point that no strategy has proposed."""
    beds = (None if point is None else point.replicates) or study.replicates
    return beds * discharges(study)[0]


def recorded_in_words(points: Iterable[PointDemand]) -> str:
    """Describe which runs are recorded, and how often; empty if none are."""
    records = {point.frame_interval: point.study.record for point in points}
    intervals = sorted(interval for interval in records if interval is not None)
    if not intervals or (record := records[intervals[0]]) is None:
        return ""
    seeds = "seed 1" if record.replicates == 1 else f"seeds 1 to {record.replicates}"
    times = " to ".join(dict.fromkeys((span(intervals[0]), span(intervals[-1]))))
    return f"Recorded: {seeds} of each point, a frame every {times} from the opening on"


def tolerance(study: Study, point: Point | None = None) -> float | None:
    """Error of the flow rate that is left for scatter after the bias of a point's numerics; None if no error is
    requested.

    `point` None: a point whose numerics have no known bias.
    """
    return study.accuracy.flow_rate if point is None or point.choice is None else point.choice.remainder


def stopping_rule(study: Study, point: Point | None = None) -> StoppingRule:
    """Return the rule by which replicates are added to a point: until the half width of the interval is within
    `tolerance`.

    None are added for W of fed beds, where each run goes on as long as needed, nor where a strategy has proposed their
    number. The cap also holds for `accuracy.clogging`.
    """
    proposed = [
        candidate.replicates
        for candidate in (study.points if point is None else (point,))
        if candidate.replicates is not None
    ]
    if proposed:
        return StoppingRule(tolerance=None, minimum=max(proposed), cap=max(proposed))
    tolerated, least = tolerance(study, point), study.replicates
    cap = max(least, study.accuracy.max_replicates)
    if tolerated is None or study.fed:
        return StoppingRule(tolerance=None, minimum=least, cap=least if study.accuracy.clogging is None else cap)
    return StoppingRule(tolerance=tolerated, minimum=least, cap=cap)
