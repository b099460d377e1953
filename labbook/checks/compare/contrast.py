"""Numbers that two backends are compared by, seed by seed, and the equivalence test between them."""

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

Values = Mapping[int, float | str]
"""Number by seed, or the reason why there is none."""


def of_runs(point: PointPlan, numbers: Numbers, measure: str, quantity: str) -> Values:
    """Collect a quantity of the beds of a point: the mean over the discharges of each bed.

    A run that clogged, does not count or is missing has no number.
    """
    quantities, runs = {declared.name for declared in MEASURES[measure].declared}, dict[int, list[float | str]]()
    for item in point.items:
        key = item.keys.run
        if item.state != "done" or not item.counts:
            number = f"suspect: {item.suspect}" if item.suspect else item.reason
        else:
            measured = [entry for entry in numbers.measured.get(key, {}).values() if entry.quantity in quantities]
            why = numbers.problems.get(key) or numbers.failed.get(key, {}).get(measure, "")
            number = _number(measured, quantity, why)
        runs.setdefault(item.demand.seed, []).append(number)
    beds = by_bed((seed, value) for seed, values in runs.items() for value in values if not isinstance(value, str))
    means = dict(zip(beds, of_beds(beds), strict=True))
    return {seed: means.get(seed, values[0]) for seed, values in runs.items()}


def of_packings(point: PointPlan, catalogue: Catalogue) -> Values:
    """Collect the packing fractions of the packings of a point; a bed whose bulk is too small has none."""
    values = {}
    for item in point.items:
        key, seed = item.keys.packing, item.demand.seed
        folder = catalogue.lab.packing(key)
        if problem := catalogue.packing_problem(key):
            values[seed] = problem if folder.is_dir() else "its packing was not made"
            continue
        evaluated = evaluated_packing(folder, point.shared.scene, lambda at=folder: load_packing(at))
        values[seed] = _number(evaluated.evaluation.numbers, "packing_fraction", evaluated.problem)
    return values


def _number(measured: Sequence[Measured], quantity: str, problem: str) -> float | str:
    """Return the number, or the notes in its place."""
    value = next((number.value for number in measured if number.quantity == quantity), nan)
    notes = [problem, *dict.fromkeys(number.note for number in measured)]
    return value if isfinite(value) else "; ".join(filter(None, notes)) or f"no {quantity} was measured"


def contrast(quantity: str, first: Values, second: Values, margin: float, *, paired: bool) -> Contrast:
    """Test if both backends have the same mean within a margin.

    Args:
        quantity: Name of the quantity.
        first: Values of the first backend, by seed.
        second: Values of the second backend, by seed.
        margin: Margin, as a part of the first backend's mean.
        paired: Numbers of the same seed come from the same packing. Then only seeds that both sides have count, and the
            test is that of differences.

    Returns:
        The contrast; untested with fewer than 2 numbers of either backend.
    """
    numbers_first, numbers_second = (
        {seed: x for seed, x in values_by_seed.items() if not isinstance(x, str)} for values_by_seed in (first, second)
    )
    seeds = sorted(
        numbers_first.keys() & numbers_second.keys() if paired else numbers_first.keys() | numbers_second.keys()
    )
    a, b = ([numbers[seed] for seed in seeds if seed in numbers] for numbers in (numbers_first, numbers_second))
    why = Counter(x for values_by_seed in (first, second) for x in values_by_seed.values() if isinstance(x, str))
    note = "; ".join(f"{count} without a number: {reason}" for reason, count in why.items())
    scale = abs(sum(a) / len(a)) if a else 0.0
    fields = {"quantity": quantity, "unit": UNITS.get(quantity, ""), "paired": paired, "finding": "untested"}
    fields |= {"seeds": seeds, "first": a, "second": b, "note": note}
    if min(len(a), len(b)) >= 2 and scale > 0:
        test = tost(a, b, margin * scale, ALPHA, paired=paired).relative_to(scale)
        fields |= {
            name: getattr(test, name) for name in ("finding", "difference", "error", "low", "high", "p", "power")
        }
        fields["replicates_needed"] = replicates_needed(test, min(len(a), len(b)))
    return Contrast.model_validate(fields)
