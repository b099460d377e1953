"""Cost of a filling relative to a discharge, which determines the cheapest number of discharges of a bed."""

from collections.abc import Iterable

from labbook.lab.folder import LabFolder
from labbook.lab.packings import PackingRecord
from labbook.lab.records import RunRecord

_BEDS = 8
"""Number of beds over which the cost is averaged: it differs little between beds, and the optimum is flat."""


def filling_cost(lab: LabFolder, runs: Iterable[tuple[str, str]], points: int = 1) -> float:
    """Return the cost of a filling in discharges: ratio of their grain-steps, from the records of runs.

    It does not depend on interruptions of the runs.

    Args:
        lab: Folder of the lab.
        runs: Keys of a run and of its packing, for each bed of a point, by seed.
        points: Number of points that start from the same packings and share their cost.

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
    """Mean fraction of grains inside during a run that ends at the fraction `discharged`, for a steady flow."""
    return 1 - discharged / 2
