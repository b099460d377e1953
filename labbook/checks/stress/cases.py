"""All stress cases, in the order in which they are best read."""

from labbook.checks.stress import (
    clumps,
    counts,
    frames,
    geometry,
    impacts,
    meshes,
    moving,
    powers,
    pushes,
    sides,
    steps,
)
from labbook.checks.stress.case import StressCase

CASES: tuple[StressCase, ...] = (
    *impacts.CASES,
    *steps.CASES,
    *geometry.CASES,
    *clumps.CASES,
    *meshes.CASES,
    *moving.CASES,
    *frames.CASES,
    *sides.CASES,
    *counts.CASES,
    *powers.CASES,
    *pushes.CASES,
)


def select_cases(names: list[str]) -> list[StressCase]:
    """Select the cases whose name begins with one of `names`; all if it is empty. Raises KeyError without a match."""
    for name in names:
        if not any(case.name.startswith(name) for case in CASES):
            raise KeyError(name)
    return [case for case in CASES if not names or any(case.name.startswith(name) for name in names)]
