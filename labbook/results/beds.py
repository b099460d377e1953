"""Shares of bed and flow of the variance of W, for studies that look for the cheapest number of discharges."""

from collections import Counter

from labbook.campaign.replicates import in_words
from labbook.lab.folder import LabFolder
from labbook.lab.records import Unreadable
from labbook.plan.beds import filling_cost
from labbook.plan.demand import stopping_rule
from labbook.results.points import FLOW_RATE, PointResult, values_by_run
from labbook.results.study import StudyResults
from labbook.stats.nested import by_bed, shares
from labbook.study.schema import AUTO


def shares_in_words(results: StudyResults) -> dict[str, list[str]]:
    """Labels of points by a sentence with the shares and the cheapest number of discharges; empty where the study
    states that number. Points with fewer than two beds, or whose records cannot be read, are left out."""
    if results.study.discharges_per_bed != AUTO:
        return {}
    sharing = Counter(result.runs[0].packing_key for result in results.points)
    lines: dict[str, list[str]] = {}
    for result in results.points:
        beds = by_bed((run.seed, value) for run, value in values_by_run(result, FLOW_RATE))
        if len(beds) > 1 and (line := _in_words(results, result, beds, sharing[result.runs[0].packing_key])):
            lines.setdefault(line, []).append(result.label)
    return lines


def _in_words(results: StudyResults, result: PointResult, beds: dict[int, list[float]], sharing: int) -> str:
    lab = LabFolder(result.runs[0].run.folder.parents[1])
    first = [(run.run_key, run.packing_key) for run in result.runs if run.discharge == 1]
    try:
        filling = filling_cost(lab, first, sharing)
    except Unreadable:
        return ""
    return in_words(stopping_rule(results.study, result.point), result.pooled[FLOW_RATE].value, shares(beds), filling)
