"""The numbers that two backends are compared by, and the equivalence test between them."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from labbook.compare.verdict import Contrast, Finding
from labbook.lab.evaluations import Evaluated, evaluated, evaluated_packing
from labbook.lab.folder import Lab
from labbook.lab.packings import load_packing
from labbook.lab.records import RunRecord, Unreadable
from labbook.lab.runs import run_data
from labbook.measure import MEASURES
from labbook.measure.measure import Window
from labbook.scene import Scene
from labbook.stats.equivalence import replicates_needed, tost

ALPHA = 0.05
USED = ("flow_rate", "packing")
"""Measures that every comparison rests on."""
OF_RUNS = {"flow_rate": ("flow_rate",), "outlet_profiles": ("outlet_area_fraction", "outlet_velocity")}
"""Quantities of runs that are compared, by the measure that gives them; profiles only where the study measures them."""
UNITS = {"flow_rate": "kg/s", "outlet_velocity": "m/s"}


@dataclass
class Numbers:
    """One number a seed of one backend, and why others have none."""

    values: dict[int, float] = field(default_factory=dict)
    lacking: list[str] = field(default_factory=list)

    def keep(self, seed: int, quantity: str, found: Evaluated) -> None:
        """The value of `quantity`, or what was noted in its place."""
        measured = found.evaluation.numbers
        one = next((one for one in measured if one.quantity == quantity), None)
        if one is not None and math.isfinite(one.value):
            self.values[seed] = one.value
        else:
            notes = [found.problem, *dict.fromkeys(one.note for one in measured)]
            self.lacking.append("; ".join(filter(None, notes)) or f"no {quantity} was measured")


def of_runs(lab: Lab, runs: Mapping[int, str], window: Window, measure: str, quantity: str) -> Numbers:
    """A quantity by seed of the runs with these keys; one that clogged or diverged has none."""
    found = Numbers()
    for seed, key in runs.items():
        try:
            record = RunRecord.read(lab.run(key))
            if record.outcome == "diverged":
                found.lacking.append("diverged")
                continue
            folder = lab.run(key)
            kept = evaluated(folder, MEASURES[measure], window, lambda at=folder, of=record: run_data(at, of))
        except (Unreadable, ImportError) as problem:
            found.lacking.append(str(problem))
            continue
        found.keep(seed, quantity, kept)
    return found


def packing_fractions(lab: Lab, scene: Scene, packings: Mapping[int, str]) -> Numbers:
    """Packing fractions by seed of the packings with these keys; one whose bulk is too small has none."""
    found = Numbers()
    for seed, key in packings.items():
        folder = lab.packing(key)
        try:
            found.keep(seed, "packing_fraction", evaluated_packing(folder, scene, lambda at=folder: load_packing(at)))
        except Unreadable as problem:
            found.lacking.append(str(problem))
    return found


def contrast(quantity: str, unit: str, first: Numbers, second: Numbers, margin: float, *, paired: bool) -> Contrast:
    """Whether both backends have the same mean within `margin`, a part of the first one's.

    `paired`: numbers of the same seed come from the same packing; only seeds that both have count. Untested with fewer
    than 2 numbers of each backend.
    """
    one, other = first.values, second.values
    seeds = sorted(one.keys() & other.keys() if paired else one.keys() | other.keys())
    a = [one[seed] for seed in seeds if seed in one]
    b = [other[seed] for seed in seeds if seed in other]
    why = Counter([*first.lacking, *second.lacking])
    note = "; ".join(f"{count} without a number: {reason}" for reason, count in why.items())
    scale = abs(sum(a) / len(a)) if a else 0.0
    if min(len(a), len(b)) < 2 or scale == 0:
        return _told(quantity, unit, paired, seeds, a, b, "untested", note)
    result = tost(a, b, margin * scale, ALPHA, paired=paired).over(scale)
    return _told(quantity, unit, paired, seeds, a, b, result.finding, note).model_copy(
        update={
            "difference": result.difference,
            "error": result.error,
            "low": result.low,
            "high": result.high,
            "p": result.p,
            "power": result.power,
            "replicates_needed": replicates_needed(result, min(len(a), len(b))),
        }
    )


def _told(
    quantity: str,
    unit: str,
    paired: bool,
    seeds: Sequence[int],
    first: Sequence[float],
    second: Sequence[float],
    found: Finding,
    note: str,
) -> Contrast:
    return Contrast(
        quantity=quantity,
        unit=unit,
        paired=paired,
        seeds=tuple(seeds),
        first=tuple(first),
        second=tuple(second),
        finding=found,
        note=note,
    )
