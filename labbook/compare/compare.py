"""Comparing two backends on a study, from missing runs to the verdict."""

from collections.abc import Callable, Iterator
from dataclasses import replace

from labbook.compare.carry import Session, carry_out
from labbook.compare.contrast import ALPHA, OF_RUNS, UNITS, USED, contrast, of_runs, packing_fractions
from labbook.compare.cost import cost
from labbook.compare.divergence import divergence
from labbook.compare.pair import Contestant, Pair
from labbook.compare.verdict import Contrast, Divergence, Entrant, NoVerdict, PointVerdict, Verdict, folder_of, stem
from labbook.lab.folder import Lab
from labbook.measure import MEASURES
from labbook.run.demand import Demand, PointDemand
from labbook.run.provenance import now
from labbook.run.watch import Watcher
from labbook.study import Point, Study
from labbook.study.schema import Accuracy

SEED = 1
"""The packing from which backends are followed side by side."""

Say = Callable[[str], None]
RunKeys = tuple[tuple[str, ...], tuple[str, ...]]


class CannotCompare(Exception):
    """What is asked cannot be compared; the message says why and what to do."""


def narrowed(study: Study, points: tuple[int, ...] = (), replicates: int | None = None) -> Study:
    """`study` with only the points at these places (from 0; none: all), and a number of replicates fixed beforehand.

    A test wants a number of replicates that does not depend on their values. Raises CannotCompare for a point that is
    not there and for fewer than 2 replicates.
    """
    wrong = [index for index in points if not 0 <= index < len(study.points)]
    if wrong:
        raise CannotCompare(f"--point {wrong[0] + 1}: {study.name} has the points 1 to {len(study.points)}")
    number = replicates or study.replicates
    if number < 2:
        raise CannotCompare(f"{study.name} has 1 replicate a point and a test needs 2 at least; use --replicates")
    chosen = tuple(point for point in study.points if not points or point.index in points)
    return replace(study, points=chosen, replicates=number, accuracy=Accuracy(flow_rate=None))


def compare(
    study: Study, lab: Lab, pair: Pair, margin: float, watcher: Watcher | None = None, say: Say = lambda _: None
) -> tuple[Verdict, list[str]]:
    """Run what is missing and compare; the verdict is kept in the lab. Also what failed, in words.

    `study` as `narrowed` gives it. Raises Stopped; Unsupported, Conflict or MeasureError before anything runs;
    DiskFull; Unreadable.
    """
    for one in pair:  # before hours of the other backend's work
        say(f"opening {one.name} on {one.device}")
        shared = PointDemand(study, one.at(study.points[0]))
        one.try_out(shared, shared.probes)
    before = _before(study, lab, pair)
    say("running what is missing")
    sessions = carry_out(study, lab, pair, watcher)
    known = {point.divergence.key: point.divergence for point in before.points if point.divergence} if before else {}
    points = []
    for point in study.points:
        say(f"comparing at {point.label or 'the only point'}")
        points.append(_point(study, point, lab, pair, margin, known))
    verdict = Verdict(
        study=study.name,
        made=now(),
        entrants=entrants(pair),
        measures={name: MEASURES[name].version for name in dict.fromkeys((*USED, *_measures(study)))},
        margin=margin,
        alpha=ALPHA,
        replicates=study.replicates,
        points=tuple(points),
        costs=(_cost(0, lab, pair, points, sessions, before), _cost(1, lab, pair, points, sessions, before)),
    )
    verdict.write(folder_of(lab, study.name))
    return verdict, [why for session in sessions for why in session.failed]


def entrants(pair: Pair) -> tuple[Entrant, Entrant]:
    """The backends of a pair as a verdict names them."""
    first, second = (
        Entrant(name=one.can.name, cache_version=one.can.cache_version, device=one.device, precision=one.precision)
        for one in pair
    )
    return first, second


def run_keys(study: Study, point: Point, pair: Pair, replicates: int) -> RunKeys:
    """Keys of both backends' runs of a point, from the first one's packings, by seed."""
    first, second = (
        tuple(demand.keys(one.can).run for demand in demands(study, point, pair, one, replicates)) for one in pair
    )
    return first, second


def demands(study: Study, point: Point, pair: Pair, one: Contestant, replicates: int) -> list[Demand]:
    """The runs of a point on one side of the pair, all from the first side's packings."""
    shared = PointDemand(study, one.at(point), packings_of=pair[0].packings(study))
    return [shared.run(seed) for seed in range(1, replicates + 1)]


def _point(
    study: Study, point: Point, lab: Lab, pair: Pair, margin: float, known: dict[str, Divergence]
) -> PointVerdict:
    runs = run_keys(study, point, pair, study.replicates)
    first, second = (demands(study, point, pair, one, SEED)[-1] for one in pair)
    packed = lab.packing(first.keys(pair[0].can).packing).is_dir()
    return PointVerdict(
        index=point.index,
        label=point.label,
        runs=runs,
        contrasts=(*_flow(study, lab, runs, margin), _packing(study, point, lab, pair, margin)),
        divergence=divergence(pair, (first, second), lab, known) if packed else None,
    )


def _measures(study: Study) -> list[str]:
    return [name for name in OF_RUNS if name in ("flow_rate", *study.measure)]


def _flow(study: Study, lab: Lab, runs: RunKeys, margin: float) -> Iterator[Contrast]:
    """Flow rates and what the study measures at the outlet, from the same packings, seed by seed."""
    for measure in _measures(study):
        for quantity in OF_RUNS[measure]:
            first, second = (of_runs(lab, dict(enumerate(keys, 1)), study.window, measure, quantity) for keys in runs)
            yield contrast(quantity, UNITS.get(quantity, ""), first, second, margin, paired=True)


def _packing(study: Study, point: Point, lab: Lab, pair: Pair, margin: float) -> Contrast:
    """Packing fractions of each backend's own packings."""
    found = []
    for one in pair:
        shared = PointDemand(study, one.at(point))
        packings = {seed: shared.run(seed).keys(one.can).packing for seed in range(1, study.replicates + 1)}
        found.append(packing_fractions(lab, point.scene, packings))
    first, second = found
    return contrast("packing_fraction", "", first, second, margin, paired=False)


def _cost(
    which: int,
    lab: Lab,
    pair: Pair,
    points: list[PointVerdict],
    sessions: tuple[Session, Session],
    before: Verdict | None,
):
    runs = [key for point in points for key in point.runs[which]]
    earlier = before.costs[which] if before else None
    return cost(lab, pair[which].name, runs, sessions[which], earlier)


def _before(study: Study, lab: Lab, pair: Pair) -> Verdict | None:
    """The last verdict on the same versions of the backends, on the same devices."""
    try:
        verdict = Verdict.read(folder_of(lab, study.name) / f"{stem(pair[0].name, pair[1].name)}.json")
    except NoVerdict:
        return None
    return verdict if verdict.entrants == entrants(pair) else None
