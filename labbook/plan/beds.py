"""The cost of a filling beside that of a discharge: on it rests how many discharges of a bed are cheapest."""

from collections.abc import Iterable

from labbook.lab.folder import LabFolder
from labbook.lab.packings import PackingRecord
from labbook.lab.records import RunRecord

_BEDS = 8
"""Beds that the cost is a mean over, the first ones: it differs little between beds, and the optimum is flat."""


def filling_cost(lab: LabFolder, runs: Iterable[tuple[str, str]], points: int = 1) -> float:
    """Cost of a filling, in discharges: grain-steps of both, by the records of what was run.

    It is the same wherever and however often the runs were interrupted.

    Args:
        lab: Has the runs and their packings.
        runs: Keys of a run and of its packing, for each bed of a point, by seed.
        points: Points of the study that start from the same packings: each of them costs its part.

    Raises:
        Unreadable: A record cannot be read.
    """
    fillings = discharges = 0.0
    for run_key, packing_key in list(runs)[:_BEDS]:
        run, packing = RunRecord.read(lab.run(run_key)), PackingRecord.read(lab.packing(packing_key))
        fillings += packing.grains * packing.duration / packing.numerics.dt
        inside = mean_inside(min(run.coverage.discharged, 1.0))
        discharges += run.coverage.grains * inside * run.coverage.steps
    return fillings / discharges / points


def mean_inside(discharged: float) -> float:
    """Return the fraction of the grains that are inside on average over a run which ends at the fraction `discharged`:
    they leave at a steady rate, and grains that left cost nothing."""
    return 1 - discharged / 2
