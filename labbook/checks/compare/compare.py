"""Comparison of two backends on a study, from missing runs to the verdict, and the check that a verdict still holds."""

from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from statistics import median

from labbook.backend import BackendMissing, load
from labbook.checks.compare.contrast import ALPHA, COMPARED, contrast, of_packings, of_runs
from labbook.checks.compare.lockstep import divergence
from labbook.checks.compare.sides import CannotCompare, Pair, Side, from_shared
from labbook.checks.compare.verdict import Cost, NoVerdict, PointVerdict, Verdict, path_of
from labbook.lab import Catalogue, Entry, FinishedRun, RunRecord
from labbook.lab.evaluations import numbers
from labbook.lab.folder import LabFolder, stamp
from labbook.lab.provenance import now
from labbook.lab.records import Observe
from labbook.measure import MEASURES
from labbook.plan.demand import PointDemand, discharges
from labbook.plan.plan import Planner, PointPlan
from labbook.run.runner import Runner
from labbook.run.summary import Summary
from labbook.run.watch import NullWatcher, Watcher
from labbook.study import Study
from labbook.study.schema import Accuracy


class Stopped(Exception):
    """The runner was asked to stop; everything is saved. `left_behind`: see `labbook.run.summary.Summary`."""

    def __init__(self, *, left_behind: bool = False):
        super().__init__()
        self.left_behind = left_behind


def select_points(study: Study, points: Sequence[int] = (), replicates: int | None = None) -> Study:
    """Reduce a study to some points, with a number of replicates fixed beforehand.

    The equivalence test assumes a number of replicates that does not depend on their values.

    Args:
        study: The study.
        points: Indices of points, from 0; none: all points.
        replicates: Replicates of each point; None: as in the study.

    Raises:
        CannotCompare: A point does not exist, there are fewer than 2 replicates, or the study is adaptive.
    """
    if study.adapt is not None:
        raise CannotCompare(
            f"{study.name}: adapt: its points follow from the results of one backend; state the points to compare"
        )
    wrong = [index for index in points if not 0 <= index < len(study.points)]
    if wrong:
        raise CannotCompare(f"--point {wrong[0] + 1}: {study.name} has the points 1 to {len(study.points)}")
    number = replicates or study.replicates
    if number < 2:
        raise CannotCompare(f"{study.name} has 1 replicate per point; a test needs 2: use --replicates 2 or more")
    selected = tuple(point for point in study.points if not points or point.index in points)
    return replace(
        study, points=selected, replicates=number, accuracy=Accuracy(count_suspect=study.accuracy.count_suspect)
    )


def compare(
    study: Study,
    lab: LabFolder,
    pair: Pair,
    margin: float,
    watcher: Watcher | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> tuple[Verdict, list[str]]:
    """Run what is missing, compare, and store the verdict in the lab.

    Args:
        study: The study, as `select_points` returns it.
        lab: Lab that has the runs and stores the verdict.
        pair: The two sides; the first one makes the shared packings.
        margin: Margin of equivalence, as a part of the first side's mean.
        watcher: Receives the progress of runs.
        say: Receives one line of progress at a time.

    Returns:
        The verdict, and a message for each failed run.

    Raises:
        Stopped: The runner was asked to stop.
        Unsupported, Conflict, MeasureError: The study cannot run; raised before anything runs.
        DiskFull: The disk is full.
        Unreadable: A file of the lab cannot be read.
    """
    entrants = pair[0].entrant, pair[1].entrant
    for side, shared in zip(pair, from_shared(study, study.points[0], pair), strict=True):
        say(f"opening {side.entrant.called} on {side.device}")  # before hours of the other backend's work
        side.backend.open(side.backend.specialise(shared.scene, shared.numerics, shared.probes), 1, side.device).close()
    path = path_of(lab, study.name, *(entrant.called for entrant in entrants))
    before = None
    with suppress(NoVerdict):
        before = Verdict.read(path)
    if before and before.entrants != entrants:  # other versions, or on other devices
        before = None
    earlier_divergences = (
        {point.divergence.key: point.divergence for point in before.points if point.divergence} if before else {}
    )
    say("making missing runs")
    sessions = _run(study, lab, pair, watcher or NullWatcher())
    measures = tuple(name for name in COMPARED if name in ("flow_rate", *study.measure))
    points = []
    with closing(Catalogue(lab)) as catalogue:
        runs, own = (
            [Planner(side.of(study), catalogue, side.can, of).plan().points for side in pair]
            for of in (pair[0].packings(study), None)
        )
        observe = Observe.of(measures, study.window)
        done = [_finished(lab, plans) for plans in runs]
        evaluated = numbers(catalogue, [*done[0], *done[1]], observe)
        for point, a, b, *packed in zip(study.points, *runs, *own, strict=True):
            say(f"comparing at {point.label or 'the only point'}")
            contrasts = [
                contrast(name, of_runs(a, evaluated, of, name), of_runs(b, evaluated, of, name), margin, paired=True)
                for of in measures
                for name in COMPARED[of]
            ]
            first, second = (of_packings(plan, catalogue) for plan in packed)
            contrasts.append(contrast("packing_fraction", first, second, margin, paired=False))
            demands = a.items[0].demand, b.items[0].demand
            point_verdict = PointVerdict(
                index=point.index,
                label=point.label,
                runs=(tuple(item.keys.run for item in a.items), tuple(item.keys.run for item in b.items)),
                contrasts=tuple(contrasts),
                divergence=divergence(pair, demands, lab, earlier_divergences) if a.items[0].packed else None,
            )
            points.append(point_verdict)
    earlier = before.costs if before else (None, None)
    verdict = Verdict(
        study=study.name,
        made=now(),
        entrants=entrants,
        measures={name: MEASURES[name].version for name in (measures[0], "packing", *measures[1:])},
        margin=margin,
        alpha=ALPHA,
        replicates=study.replicates,
        points=tuple(points),
        costs=(
            _cost(entrants[0].called, done[0], sessions[:1], earlier[0]),
            _cost(entrants[1].called, done[1], sessions[1:], earlier[1]),
        ),
    )
    verdict.write(path)
    return verdict, [why for session in sessions for why in session.failed]


def stale(verdict: Verdict, study: Study) -> list[str]:
    """List the reasons why `verdict` is out of date; empty if it holds. `study`: as its file states it now."""
    reasons, sides = [], []
    versions = [(f"the measure {name}", was, MEASURES[name].version) for name, was in verdict.measures.items()]
    for entrant in reversed(verdict.entrants):
        try:
            sides.insert(0, Side(load(entrant.name), entrant.device, entrant.precision))
            versions.insert(0, (entrant.name, entrant.cache_version, sides[0].can.cache_version))
        except BackendMissing as problem:
            reasons.insert(0, f"cannot check whether {entrant.name} has changed: {problem}")
    reasons += [f"{name} was at version {was} and is now at {now}" for name, was, now in versions if was != now]
    if reasons:
        return reasons
    now, before = set(), dict[tuple[tuple[str, ...], ...], str]()
    try:
        for point in study.points:
            both = list(zip(sides, from_shared(study, point, (sides[0], sides[1])), strict=True))
            now.add(_run_keys(both, verdict.replicates))
            for outdated, scenes in both[0][1].older:
                before[_run_keys(both, verdict.replicates, scenes)] = outdated
    except CannotCompare as problem:
        return [str(problem)]
    outdated = dict.fromkeys(before[point.runs] for point in verdict.points if point.runs in before)
    missed = [point for point in verdict.points if point.runs not in now and point.runs not in before]
    changed = [point.label or "its point" for point in missed]
    return [*outdated, *([f"the study has changed at {'; '.join(changed)}"] if changed else [])]


def _run_keys(
    both: Sequence[tuple[Side, PointDemand]], replicates: int, scenes: tuple[str, str] | None = None
) -> tuple[tuple[str, ...], ...]:
    """Collect the keys of the runs of a point on both sides; `scenes`: see `Demand.keys`."""
    return tuple(
        tuple(run.keys(side.can, scenes).run for run in shared.runs(replicates, discharges(shared.study)[0]))
        for side, shared in both
    )


def _run(study: Study, lab: LabFolder, pair: Pair, watcher: Watcher) -> list[Summary]:
    """Run what is missing: the first side's runs, the second side's from the same packings, and its own packings."""
    first, second = pair
    sessions = []
    for side, of, packings_only in (
        (first, None, False),
        (second, first.packings(study), False),
        (second, None, True),
    ):
        runner = Runner(side.of(study), lab, side.backend, side.device, watcher=watcher)
        sessions.append(replace(runner, packings_of=of, packings_only=packings_only).run())
        if sessions[-1].stopped:
            raise Stopped(left_behind=sessions[-1].left_behind)
    return sessions


def _finished(lab: LabFolder, plans: Sequence[PointPlan]) -> list[FinishedRun]:
    """Load the finished runs; a run that several points share comes once."""
    done = {item.keys.run: item for plan in plans for item in plan.items if item.state == "done"}
    runs = []
    for key, item in done.items():
        folder = lab.run(key)
        entry = Entry.of(RunRecord.read(folder), stamp(folder))
        runs.append(FinishedRun(item.demand.point, item.demand.seed, folder, entry, discharge=item.demand.discharge))
    return runs


def _cost(backend: str, runs: Sequence[FinishedRun], sessions: Sequence[Summary], before: Cost | None) -> Cost:
    """Sum up the cost of runs.

    Args:
        backend: Name of the side.
        runs: Finished runs.
        sessions: Sessions of this comparison.
        before: Cost in an earlier comparison by the same backend; its session counts if nothing had to run now.
    """
    records = [run.record for run in runs]
    rates = [record.rate for record in records if record.rate == record.rate]
    worked = [session for session in sessions if session.work_done]
    wall = sum(session.wall_time for session in worked)
    session = (wall, sum(session.work_done for session in worked) / wall) if worked else (None, None)
    if before and not worked:
        session = before.session_wall, before.session_rate
    return Cost(
        backend=backend,
        devices=tuple(sorted({record.device for record in records})),
        runs=len(records),
        wall_time=sum(record.wall_time for record in records),
        rate=median(rates) if rates else None,
        session_wall=session[0],
        session_rate=session[1],
    )
