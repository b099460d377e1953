"""The numbers that two backends are compared by, seed by seed, and the equivalence test between them."""

from collections import Counter
from collections.abc import Mapping, Sequence
from math import isfinite, nan

from labbook.checks.compare.verdict import Contrast
from labbook.lab import Catalogue
from labbook.lab.evaluations import Numbers, evaluated_packing
from labbook.lab.packings import load_packing
from labbook.measure import MEASURES
from labbook.plan.plan import PointPlan
from labbook.stats import Measured
from labbook.stats.equivalence import replicates_needed, tost
from labbook.stats.nested import by_bed, of_beds

ALPHA = 0.05
COMPARED = {"flow_rate": ("flow_rate",), "outlet_profiles": ("outlet_area_fraction", "outlet_velocity")}
"""Quantities of runs that are compared, by the measure that gives them; profiles only where the study measures them."""
UNITS = {"flow_rate": "kg/s", "outlet_velocity": "m/s"}

Found = Mapping[int, float | str]
"""By seed, a number, or why there is none."""


def of_runs(point: PointPlan, numbers: Numbers, measure: str, quantity: str) -> Found:
    """A quantity of the beds of a point, the mean over the discharges of each. A run that clogged, does not count or is
    not there has no number."""
    given, runs = {one.name for one in MEASURES[measure].declared}, dict[int, list[float | str]]()
    for item in point.items:
        key = item.keys.run
        if item.state != "done" or not item.counts:
            number = f"suspect: {item.suspect}" if item.suspect else item.reason
        else:
            measured = [one for one in numbers.measured.get(key, {}).values() if one.quantity in given]
            why = numbers.problems.get(key) or numbers.failed.get(key, {}).get(measure, "")
            number = _number(measured, quantity, why)
        runs.setdefault(item.demand.seed, []).append(number)
    beds = by_bed((seed, one) for seed, each in runs.items() for one in each if not isinstance(one, str))
    means = dict(zip(beds, of_beds(beds), strict=True))
    return {seed: means.get(seed, each[0]) for seed, each in runs.items()}


def of_packings(point: PointPlan, catalogue: Catalogue) -> Found:
    """Packing fractions of the packings of a point; one whose bulk is too small has none."""
    found = {}
    for item in point.items:
        key, seed = item.keys.packing, item.demand.seed
        folder = catalogue.lab.packing(key)
        if problem := catalogue.packing_problem(key):
            found[seed] = problem if folder.is_dir() else "its packing was not made"
            continue
        kept = evaluated_packing(folder, point.shared.scene, lambda at=folder: load_packing(at))
        found[seed] = _number(kept.evaluation.numbers, "packing_fraction", kept.problem)
    return found


def _number(measured: Sequence[Measured], quantity: str, problem: str) -> float | str:
    """The number, or what was noted in its place."""
    value = next((one.value for one in measured if one.quantity == quantity), nan)
    notes = [problem, *dict.fromkeys(one.note for one in measured)]
    return value if isfinite(value) else "; ".join(filter(None, notes)) or f"no {quantity} was measured"


def contrast(quantity: str, first: Found, second: Found, margin: float, *, paired: bool) -> Contrast:
    """Whether both backends have the same mean within `margin`, a part of the first one's.

    `paired`: numbers of the same seed come from the same packing; only seeds that both have count. Untested with fewer
    than 2 numbers of each backend.
    """
    one, other = ({seed: x for seed, x in found.items() if not isinstance(x, str)} for found in (first, second))
    seeds = sorted(one.keys() & other.keys() if paired else one.keys() | other.keys())
    a, b = ([values[seed] for seed in seeds if seed in values] for values in (one, other))
    why = Counter(x for found in (first, second) for x in found.values() if isinstance(x, str))
    note = "; ".join(f"{count} without a number: {reason}" for reason, count in why.items())
    scale = abs(sum(a) / len(a)) if a else 0.0
    told = {"quantity": quantity, "unit": UNITS.get(quantity, ""), "paired": paired, "finding": "untested"}
    told |= {"seeds": seeds, "first": a, "second": b, "note": note}
    if min(len(a), len(b)) >= 2 and scale > 0:
        test = tost(a, b, margin * scale, ALPHA, paired=paired).over(scale)
        told |= {name: getattr(test, name) for name in ("finding", "difference", "error", "low", "high", "p", "power")}
        told["replicates_needed"] = replicates_needed(test, min(len(a), len(b)))
    return Contrast.model_validate(told)
