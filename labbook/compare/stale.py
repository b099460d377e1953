"""Whether a verdict still speaks of the backends, measures and study that are here now."""

from labbook.backend import BackendMissing, load
from labbook.compare.compare import run_keys
from labbook.compare.pair import Contestant, WrongPair
from labbook.compare.verdict import Verdict
from labbook.measure import MEASURES
from labbook.study import Study


def stale(verdict: Verdict, study: Study) -> list[str]:
    """Why `verdict` is out of date, in words; nothing if it holds. `study` as its file has it now."""
    reasons, here = [], []
    for entrant in verdict.entrants:
        try:
            here.append(Contestant(load(entrant.name), entrant.device, entrant.precision))
        except BackendMissing as problem:
            reasons.append(f"whether {entrant.name} has changed cannot be told: {problem}")
            continue
        now = here[-1].can.cache_version
        if now != entrant.cache_version:
            reasons.append(f"{entrant.name} was at version {entrant.cache_version} and is at {now}")
    for name, version in verdict.measures.items():
        now = MEASURES[name].version
        if now != version:
            reasons.append(f"the measure {name} was at version {version} and is at {now}")
    if not reasons:
        reasons += _changed(verdict, study, (here[0], here[1]))
    return reasons


def _changed(verdict: Verdict, study: Study, pair: tuple[Contestant, Contestant]) -> list[str]:
    """Points that are no longer what they were."""
    try:
        now = {run_keys(study, point, pair, verdict.replicates) for point in study.points}
    except WrongPair as problem:
        return [str(problem)]
    changed = [point.label or "its point" for point in verdict.points if point.runs not in now]
    return [f"the study has changed at {'; '.join(changed)}"] if changed else []
