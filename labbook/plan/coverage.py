"""Coverage: comparison of existing runs with demanded duration and observations; the finished runs of a study."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from labbook.backend.probes import UNEVEN, Above, Crossing, Probe, Sample, Slab, Traction, Zone, parse_probe, table_name
from labbook.lab import identity
from labbook.lab.catalogue import Catalogue, Entry
from labbook.lab.evaluations import FinishedRun
from labbook.lab.folder import LabFolder
from labbook.lab.identity import Versions
from labbook.lab.packings import PackingRecord
from labbook.lab.records import Coverage, RunRecord, StopRule, Unreadable
from labbook.plan.demand import Demand, PackingsOf, demands, stopping_rule
from labbook.scene.quantities import percent, span
from labbook.study import Study

DEFAULT_FACTOR = 2.0
"""Factor by which a run may fall short of a number that labbook chose: such defaults have changed, and differ between
scenes."""
INTERVAL_FACTOR = 1.4
"""Factor by which intervals of observations may exceed a measure's choice, which rests on a forecast of the flow."""


def shortfall(
    outcome: str,
    coverage: Coverage,
    stop: StopRule,
    guards: Mapping[str, float],
    probes: frozenset[str],
    recording: float | None = None,
    default_names: frozenset[str] = frozenset(),
) -> str:
    """Describe what a run lacks of a demand; empty if it covers the demand.

    Args:
        outcome: Outcome of the run.
        coverage: Its coverage.
        stop: Demanded stop rule.
        guards: Demanded guards.
        probes: Demanded probes, as `describe_probe` writes them.
        recording: Demanded time between frames [s]; None: no recording. Closer frames are enough.
        default_names: Numbers among `max_time`, `stall`, `recording` and the guards that labbook chose; they have to be
            met within DEFAULT_FACTOR only.
    """

    def is_short(name: str, coverage: float, required: float) -> bool:
        return coverage < required * (1 / DEFAULT_FACTOR if name in default_names else 1 - 1e-9)

    # Observations come first: no outcome makes up for a table that a measure needs.
    missing = unobserved(probes, coverage.probes)
    if missing:
        return f"not observed: {', '.join(missing)}"
    if recording is not None:
        interval = coverage.frame_interval
        if interval is None:
            return "not recorded"
        if interval > recording * (DEFAULT_FACTOR if "recording" in default_names else 1 + UNEVEN):
            return f"has frames every {span(interval)}, not every {span(recording)}: runs again for its recording"
    if outcome == "emptied" or coverage.discharged >= stop.discharged:
        return ""
    if stop.fill_height is not None and coverage.fill_height is not None and coverage.fill_height <= stop.fill_height:
        return ""
    if outcome == "diverged":
        # what a wide guard stops, a narrow one stops too
        changed = [name for name, value in guards.items() if is_short(name, coverage.guards.get(name, 0.0), value)]
        return f"diverged with another {' and '.join(changed)}" if changed else ""
    if outcome == "clogged" and stop.still and coverage.stop.still:
        return ""
    if not is_short("stall", coverage.waiting, stop.stall):
        return ""
    if not is_short("max_time", coverage.duration, stop.max_time):
        return ""
    if outcome == "precise" and coverage.stop.as_precise(stop):
        return ""
    if stop.fed:
        precision = "" if stop.precise is None else f" or a flow rate to {percent(stop.precise.flow_rate)}"
        required = f"{stop.max_time:.4g} s{precision}, stall {stop.stall:.4g} s"
        return f"{outcome} after {coverage.duration:.4g} s; requested: {required}"
    ending = "out of time" if outcome in ("time-limit", "interrupted") else outcome  # the latter in older indexes
    return (
        f"{ending} after {coverage.duration:.4g} s with {percent(coverage.discharged, '.1f')} discharged; "
        f"requested: {percent(stop.discharged)}, {stop.max_time:.4g} s, stall {stop.stall:.4g} s"
    )


def unobserved(required: Iterable[str], observed: Iterable[str]) -> list[str]:
    """List the demanded probes that the probes `observed` of a run do not cover, as `describe_probe` writes them."""
    observed = set(observed)
    by_table = {table_name(probe): probe for probe in map(parse_probe, observed)}
    return sorted(
        name
        for name in set(required) - observed
        if (match := by_table.get(table_name(parse_probe(name)))) is None or not _covers(match, parse_probe(name))
    )


def _covers(observed: Probe, required: Probe) -> bool:
    """Decide whether a probe has observed the grains that another one of its kind demands, about as often."""
    if (
        isinstance(observed, Sample)
        and isinstance(required, Sample)
        and not set(required.fields) <= set(observed.fields)
    ):
        return False
    if isinstance(observed, Zone) and isinstance(required, Zone):
        near = 1e-9 * required.radius
        wide = all(
            getattr(observed, size) >= getattr(required, size) - near for size in ("radius", "high", "core", "top")
        )
        pairs = (
            bool(observed.again) == bool(required.again)
            and required.again / INTERVAL_FACTOR <= observed.again <= required.again * INTERVAL_FACTOR
        )
        if not (wide and observed.low <= required.low + near and pairs):
            return False
    if isinstance(observed, Traction) and isinstance(required, Traction) and observed.size != required.size:
        return False
    if isinstance(observed, Above) and isinstance(required, Above) and observed.planes != required.planes:
        return False
    if isinstance(observed, Crossing | Slab) or isinstance(required, Crossing | Slab):
        return observed == required
    return observed.every <= required.every * INTERVAL_FACTOR


class RequestedRun(NamedTuple):
    """A run that a study may have.

    Args:
        demand: The run.
        age: 0 by the laws and walls as installed; larger for older versions.
        outdated: Changes since that version.
    """

    demand: Demand
    age: int = 0
    outdated: str = ""


def requested_runs(
    study: Study, backend: str, packings_of: PackingsOf | None = None
) -> Mapping[str, Sequence[RequestedRun]]:
    """Return all runs that a study may have on `backend`, by lineage key: points with equal scenes share theirs.

    `packings_of`: backend whose packings they start from; None: their own.
    """
    by_lineage: dict[str, list[RequestedRun]] = defaultdict(list)
    for demand in demands(study, stopping_rule(study).cap, packings_of):
        by_lineage[demand.lineage(backend)].append(RequestedRun(demand))
        for age, (lineage, outdated) in enumerate(demand.older_lineages(backend), 1):
            by_lineage[lineage].append(RequestedRun(demand, age, outdated))
    return by_lineage


class _Match(NamedTuple):
    """A finished run that belongs to a study. `versions`: those of the extensions that made it; None: as installed, or
    no extensions."""

    request: RequestedRun
    entry: Entry
    versions: Versions | None
    outdated: str

    @property
    def group(self) -> tuple[int, int, str]:
        """Versions of laws, walls and backend: runs of a point are pooled within one group only."""
        versions = "" if self.versions is None else str(sorted(self.versions.items()))
        return -self.request.age, self.entry.cache_version, versions

    @property
    def rank(self) -> tuple[int, bool, int, str]:
        """Sort key by age: newer versions are larger."""
        return -self.request.age, self.versions is None, self.entry.cache_version, self.entry.finished


def _match(lab: LabFolder, backend: str, request: RequestedRun, entry: Entry) -> _Match:
    demand = request.demand
    installed = demand.shared.versions
    current = not request.age and entry.run_key == demand.run_key(backend, entry.cache_version)
    if current or not identity.hashed(installed):
        return _Match(request, entry, None, request.outdated)
    recorded = made_by(lab, entry)  # read from disk: the index has no hashes of sources
    outdated = identity.outdated(recorded, installed)
    return _Match(request, entry, recorded if outdated else None, outdated)


def made_by(lab: LabFolder, entry: Entry) -> Versions:
    """Return the versions and hashes of the laws and walls that made a run and its packing; none if a record is
    unreadable."""
    try:
        run, packing = RunRecord.read(lab.run(entry.run_key)), PackingRecord.read(lab.packing(entry.packing_key))
    except Unreadable:
        return {}
    return {**packing.versions, **run.versions}


def finished(
    catalogue: Catalogue,
    study: Study,
    backend: str,
    requests: Mapping[str, Sequence[RequestedRun]] | None = None,
    kind: type[FinishedRun] = FinishedRun,
) -> list[FinishedRun]:
    """Return the runs of `study` on `backend` that cover its stop rule and measures, by point, seed and discharge.

    Replicates beyond the minimum are included. All runs of a point have one version of its law and walls, one source of
    extensions, and one version of the backend: the newest with any runs. Results of several versions are never pooled.

    Args:
        catalogue: Index of the lab.
        study: The study.
        backend: Name of the backend.
        requests: Result of `requested_runs`, if it is available.
        kind: Class of the result.
    """
    by_lineage = requested_runs(study, backend) if requests is None else requests
    lab, matches = catalogue.lab, list[_Match]()
    for entry in catalogue.entries(lineages=by_lineage):
        if entry.coverage is None:
            continue
        for request in by_lineage[entry.lineage_key]:
            shared = request.demand.shared
            missing = shortfall(
                entry.outcome,
                entry.coverage,
                shared.stop,
                request.demand.guards,
                shared.probe_names,
                default_names=shared.default_names,
            )
            if not missing:
                matches.append(_match(lab, backend, request, entry))
    newest: dict[int, _Match] = {}
    for match in matches:
        point = match.request.demand.point.index
        newest[point] = max(match, newest.get(point, match), key=lambda candidate: candidate.rank)
    matches.sort(key=lambda match: (match.request.demand.point.index, *match.request.demand.number))
    return [
        kind(
            request.demand.point, request.demand.seed, lab.run(entry.run_key), entry, outdated, request.demand.discharge
        )
        for request, entry, _, outdated in (
            match for match in matches if match.group == newest[match.request.demand.point.index].group
        )
    ]


def unreadable(catalogue: Catalogue, study: Study, backend: str) -> list[str]:
    """List the problems of runs of `study` on `backend` that cannot be read."""
    damaged = catalogue.damaged()
    if not damaged:
        return []
    versions, own_keys = catalogue.versions(backend), set[str]()
    for demand in demands(study, stopping_rule(study).cap):
        own_keys |= {demand.lineage(backend), *(demand.run_key(backend, version) for version in versions)}
    return sorted(
        {entry.problem for entry in damaged if entry.problem and {entry.run_key, entry.lineage_key} & own_keys}
    )
