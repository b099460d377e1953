"""The numbers that two engines are compared by, and the equivalence test between them."""

import math
from collections.abc import Mapping, Sequence

from labbook.catalogue.finished import run_data
from labbook.catalogue.lab import Lab
from labbook.catalogue.packings import load_packing
from labbook.catalogue.parts import Unreadable
from labbook.catalogue.record import RunRecord
from labbook.compare.verdict import Contrast, Finding
from labbook.measure import MEASURES
from labbook.measure.measure import MeasureError, Window
from labbook.measure.packing import PackingStructure
from labbook.scene import Scene
from labbook.stats.equivalence import Equivalence, replicates_needed, tost

ALPHA = 0.05
USED = ("flow_rate", "packing")
"""Measures that a comparison rests on."""

BySeed = Mapping[int, float]


def flow_rates(lab: Lab, runs: Mapping[int, str], window: Window) -> dict[int, float]:
    """Flow rates [kg/s] by seed of the runs with these keys that are there and have one: none clogged or diverged."""
    found = {}
    for seed, key in runs.items():
        try:
            record = RunRecord.read(lab.run(key))
            measured = MEASURES["flow_rate"].evaluate(run_data(lab.run(key), record), window)
        except (Unreadable, MeasureError):
            continue
        value = next((one.value for one in measured if one.quantity == "flow_rate"), math.nan)
        if record.outcome != "diverged" and math.isfinite(value):
            found[seed] = value
    return found


def packing_fractions(lab: Lab, scene: Scene, packings: Mapping[int, str]) -> dict[int, float]:
    """Packing fractions by seed of the packings with these keys that are there and whose bulk is large enough."""
    found = {}
    for seed, key in packings.items():
        try:
            measured = PackingStructure().of(scene, load_packing(lab.packing(key)))
        except (Unreadable, MeasureError):
            continue
        value = next((one.value for one in measured if one.quantity == "packing_fraction"), math.nan)
        if math.isfinite(value):
            found[seed] = value
    return found


def contrast(quantity: str, unit: str, first: BySeed, second: BySeed, margin: float, *, paired: bool) -> Contrast:
    """Whether both engines have the same mean within `margin`, a part of the first one's.

    `paired`: numbers of the same seed come from the same packing; only seeds that both have count.
    """
    seeds = sorted(first.keys() & second.keys() if paired else first.keys() | second.keys())
    a = [first[seed] for seed in seeds if seed in first]
    b = [second[seed] for seed in seeds if seed in second]
    if min(len(a), len(b)) < 2:
        what = "pairs of runs" if paired else "packings of each engine"
        note = f"{min(len(a), len(b))} {what} gave a number; 2 at least are needed"
        return _told(quantity, unit, paired, seeds, a, b, "untested", note)
    scale = abs(sum(a) / len(a))
    result = tost(a, b, margin * scale, ALPHA, paired=paired)
    lost = len(first.keys() | second.keys()) - len(seeds)
    note = f"{lost} seeds left out: only one engine has a number" if lost else ""
    return _told(quantity, unit, paired, seeds, a, b, finding(result), note).model_copy(
        update={
            "difference": result.difference / scale,
            "error": result.error / scale,
            "low": result.low / scale,
            "high": result.high / scale,
            "p": result.p,
            "power": result.power,
            "replicates_needed": replicates_needed(result, min(len(a), len(b))),
        }
    )


def finding(result: Equivalence) -> Finding:
    """What a test shows: equivalence, a difference beyond the margin, or neither."""
    if result.equivalent:
        return "equivalent"
    beyond = result.low > result.margin or result.high < -result.margin
    return "different" if beyond else "undecided"


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
