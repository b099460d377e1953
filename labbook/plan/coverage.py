"""Whether a run that exists covers what is asked: how far it went, and what it observed; and a study's runs that do."""

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

NEAR = 2.0
"""Factor by which a run may fall short of a number that its study does not state: what labbook takes in its place has
changed, and differs between scenes."""
COARSER = 1.4
"""Factor by which observations may be less frequent than a measure would ask for: it foresees how fast a bed flows."""


def shortfall(
    outcome: str,
    had: Coverage,
    stop: StopRule,
    guards: Mapping[str, float],
    probes: frozenset[str],
    recording: float | None = None,
    unstated: frozenset[str] = frozenset(),
) -> str:
    """What a run that ended as `outcome` with coverage `had` lacks of what is asked, in words; empty if it covers it.

    `recording`: time between frames [s] if the run is to be recorded; frames closer to each other will do. `unstated`:
    which of `max_time`, `stall`, `recording` and the guards the study leaves to labbook; those need to be met within
    NEAR only.
    """

    def short(name: str, had: float, asked: float) -> bool:
        return had < asked * (1 / NEAR if name in unstated else 1 - 1e-9)

    missing = unobserved(probes, had.probes)
    if missing:
        return f"not observed: {', '.join(missing)}"
    if recording is not None:
        apart = had.frame_interval
        if apart is None:
            return "not recorded"
        if apart > recording * (NEAR if "recording" in unstated else 1 + UNEVEN):
            return f"has frames every {span(apart)}, not every {span(recording)}: runs again for its recording"
    if outcome == "emptied" or had.discharged >= stop.discharged:
        return ""
    if stop.fill_height is not None and had.fill_height is not None and had.fill_height <= stop.fill_height:
        return ""
    if outcome == "diverged":
        # what a wide guard stops, a narrow one stops too
        changed = [name for name, value in guards.items() if short(name, had.guards.get(name, 0.0), value)]
        return f"diverged with another {' and '.join(changed)}" if changed else ""
    if outcome == "clogged" and stop.still and had.stop.still:
        return ""
    if not short("stall", had.waiting, stop.stall) or not short("max_time", had.duration, stop.max_time):
        return ""
    if outcome == "precise" and had.stop.as_precise(stop):
        return ""
    if stop.fed:
        asked = "" if stop.precise is None else f" or a flow rate to {percent(stop.precise.flow_rate)}"
        return f"{outcome} after {had.duration:.4g} s; asked: {stop.max_time:.4g} s{asked}, stall {stop.stall:.4g} s"
    ended = "out of time" if outcome in ("time-limit", "interrupted") else outcome  # the latter in older indexes
    return (
        f"{ended} after {had.duration:.4g} s with {percent(had.discharged, '.1f')} discharged; "
        f"asked: {percent(stop.discharged)}, {stop.max_time:.4g} s, stall {stop.stall:.4g} s"
    )


def unobserved(asked: Iterable[str], had: Iterable[str]) -> list[str]:
    """Which probes of `asked`, as `describe_probe` writes them, are not covered by those that a run `had`."""
    had = set(had)
    seen = {table_name(probe): probe for probe in map(parse_probe, had)}
    return sorted(
        one
        for one in set(asked) - had
        if (other := seen.get(table_name(parse_probe(one)))) is None or not _covers(other, parse_probe(one))
    )


def _covers(had: Probe, asked: Probe) -> bool:
    """Whether a probe has seen the grains that another one of its kind asks for, and about as often."""
    if isinstance(had, Sample) and isinstance(asked, Sample) and not set(asked.fields) <= set(had.fields):
        return False
    if isinstance(had, Zone) and isinstance(asked, Zone):
        near = 1e-9 * asked.radius
        wide = all(getattr(had, size) >= getattr(asked, size) - near for size in ("radius", "high", "core", "top"))
        pairs = bool(had.again) == bool(asked.again) and asked.again / COARSER <= had.again <= asked.again * COARSER
        if not (wide and had.low <= asked.low + near and pairs):
            return False
    if isinstance(had, Traction) and isinstance(asked, Traction) and had.size != asked.size:
        return False
    if isinstance(had, Above) and isinstance(asked, Above) and had.planes != asked.planes:
        return False
    if isinstance(had, Crossing | Slab) or isinstance(asked, Crossing | Slab):
        return had == asked
    return had.every <= asked.every * COARSER


class RequestedRun(NamedTuple):
    """A run that a study may have. `age`: 0 of one by the laws and walls as installed, more of older versions;
    `outdated`: what has changed since."""

    demand: Demand
    age: int = 0
    outdated: str = ""


def asked(study: Study, backend: str, packings_of: PackingsOf | None = None) -> Mapping[str, Sequence[RequestedRun]]:
    """All runs that a study may have on `backend`, by lineage: points that come to the same scene share theirs.
    `packings_of`: the backend whose packings they start from, None for their own."""
    found: dict[str, list[RequestedRun]] = defaultdict(list)
    for demand in demands(study, stopping_rule(study).cap, packings_of):
        found[demand.lineage(backend)].append(RequestedRun(demand))
        for age, (lineage, outdated) in enumerate(demand.older_lineages(backend), 1):
            found[lineage].append(RequestedRun(demand, age, outdated))
    return found


class _Match(NamedTuple):
    """A finished run that is one of a study. `versions`: those of the extensions that made it; None: as installed, or
    there is no extension."""

    request: RequestedRun
    entry: Entry
    versions: Versions | None
    outdated: str

    @property
    def group(self) -> tuple[int, int, str]:
        """Runs of a point with the same are by the same laws, walls and backend."""
        versions = "" if self.versions is None else str(sorted(self.versions.items()))
        return -self.request.age, self.entry.cache_version, versions

    @property
    def rank(self) -> tuple[int, bool, int, str]:
        """The larger, the newer is what made it."""
        return -self.request.age, self.versions is None, self.entry.cache_version, self.entry.finished


def _match(lab: LabFolder, backend: str, request: RequestedRun, entry: Entry) -> _Match:
    demand = request.demand
    now = demand.shared.versions
    current = not request.age and entry.run_key == demand.run_key(backend, entry.cache_version)
    if current or not identity.hashed(now):
        return _Match(request, entry, None, request.outdated)
    before = made_by(lab, entry)
    outdated = identity.outdated(before, now)
    return _Match(request, entry, before if outdated else None, outdated)


def made_by(lab: LabFolder, entry: Entry) -> Versions:
    """Versions and hashes of the laws and walls that made a run and its packing, by their records; none of records that
    cannot be read."""
    try:
        run, packing = RunRecord.read(lab.run(entry.run_key)), PackingRecord.read(lab.packing(entry.packing_key))
    except Unreadable:
        return {}
    return {**packing.versions, **run.versions}


def finished(
    catalogue: Catalogue,
    study: Study,
    backend: str,
    known: Mapping[str, Sequence[RequestedRun]] | None = None,
    kind: type[FinishedRun] = FinishedRun,
) -> list[FinishedRun]:
    """Runs of `study` on `backend` that cover its stop rule and measures, by point, seed and discharge.

    Replicates beyond the minimum count too. The runs of one point are all of one version of its law and walls, of one
    source of extensions among these and of one version of the backend, the newest that has any: what several versions
    computed is never pooled. `known`: what `asked` gives, where it is known already; `kind`: what is made of each run.
    """
    wanted = asked(study, backend) if known is None else known
    lab, found = catalogue.lab, list[_Match]()
    for entry in catalogue.entries(lineages=wanted):
        if entry.coverage is None:
            continue
        for one in wanted[entry.lineage_key]:
            shared = one.demand.shared
            lacks = shortfall(
                entry.outcome,
                entry.coverage,
                shared.stop,
                one.demand.guards,
                shared.probe_names,
                unstated=shared.unstated,
            )
            if not lacks:
                found.append(_match(lab, backend, one, entry))
    newest: dict[int, _Match] = {}
    for match in found:
        point = match.request.demand.point.index
        newest[point] = max(match, newest.get(point, match), key=lambda one: one.rank)
    found.sort(key=lambda match: (match.request.demand.point.index, *match.request.demand.number))
    return [
        kind(one.demand.point, one.demand.seed, lab.run(entry.run_key), entry, outdated, one.demand.discharge)
        for one, entry, _, outdated in (
            match for match in found if match.group == newest[match.request.demand.point.index].group
        )
    ]


def unreadable(catalogue: Catalogue, study: Study, backend: str) -> list[str]:
    """Why runs of `study` on `backend` that are there cannot be read, as far as is known of each whose it is."""
    damaged = catalogue.damaged()
    if not damaged:
        return []
    versions, whose = catalogue.versions(backend), set[str]()
    for demand in demands(study, stopping_rule(study).cap):
        whose |= {demand.lineage(backend), *(demand.run_key(backend, version) for version in versions)}
    return sorted({one.problem for one in damaged if one.problem and {one.run_key, one.lineage_key} & whose})
