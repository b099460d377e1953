"""All cases, in the order in which they are best read: simple contacts first, flow last, then those of extensions."""

from labbook.checks.verify import (
    bed,
    clumps,
    collision,
    edge,
    energy,
    flow,
    gas,
    lip,
    mesh,
    mesh_rods,
    mixture,
    moving,
    oblique,
    periodic,
    rim,
    rods,
    rolling,
    rolling_spring,
    round,
    sliding,
    symmetry,
    turned,
    turntable,
    unlike,
)
from labbook.checks.verify.case import Case
from labbook.plugins import Registry

CASES: tuple[Case, ...] = (
    *collision.CASES,
    *gas.CASES,
    *rolling.CASES,
    *rolling_spring.CASES,
    *turntable.CASES,
    *edge.CASES,
    *lip.CASES,
    *mesh.CASES,
    *moving.CASES,
    *round.CASES,
    *rods.CASES,
    *mesh_rods.CASES,
    *clumps.CASES,
    *rim.CASES,
    *energy.CASES,
    *mixture.CASES,
    *unlike.CASES,
    *periodic.CASES,
    *oblique.CASES,
    *sliding.CASES,
    *symmetry.CASES,
    *turned.CASES,
    *bed.CASES,
    *flow.CASES,
)


EVERY = Registry[Case]("labbook.cases", Case, CASES)
"""All cases by name, with those of other packages."""


def select_cases(names: list[str]) -> list[Case]:
    """Select the cases whose name begins with one of `names`; all if it is empty. Raises KeyError without a match."""
    for name in names:
        if not any(name_of_case.startswith(name) for name_of_case in EVERY):
            raise KeyError(name)
    return [case for case in EVERY.values() if not names or any(case.name.startswith(name) for name in names)]
