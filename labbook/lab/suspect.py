"""Suspect runs: their ledger shows an error although no guard stopped them.

A suspect run is kept and shown with the reason. It is left out of all means and fits unless the study sets
`accuracy.count_suspect`.
"""

import math

from labbook.lab.records import RunLedger
from labbook.scene.quantities import format_distinct

DEEPEST = 0.1
"""Largest overlap of a run that is not suspect [diameters].

Contact laws hold for small overlaps: at a tenth of d, the contact circle of two spheres by Hertz has a third of their
radius. Runs of studies/quickstart.yaml (G = 2 MPa) reach 3.4 to 5.2 %. 1000 grains with 1 MPa reach 3.4 to 4.9 %, and
with 0.2 MPa 8.6 to 10.6 %. Rods of studies/pongo2022-small.yaml reach 1.3 to 5.7 %. The guard `numerics.overlap_limit`
stops runs at 25 % by default.
"""
FASTEST = 3.0
"""Largest speed of a run that is not suspect, in units of its free-fall speed (`RunLedger.expected_speed`).

A grain this fast has nine times the energy that its fall can give it. Runs of studies/quickstart.yaml reach 0.4 to 0.6.
"""


def counts(outcome: str, suspect: str, count_suspect: bool) -> bool:
    """Decide whether a run takes part in means and fits.

    A diverged run never does, a suspect one only if `count_suspect`.

    Args:
        outcome: Outcome of the run.
        suspect: Reason for which it is suspect; empty if it is not.
        count_suspect: The study includes suspect runs.
    """
    return outcome != "diverged" and (not suspect or count_suspect)


def suspicion(ledger: RunLedger | None) -> str:
    """Explain why a run with this ledger is suspect; empty if it is not, or if there is no ledger."""
    if ledger is None:
        return ""
    reasons = []
    if ledger.overlap is not None and ledger.overlap > DEEPEST:
        overlap, threshold = format_distinct(ledger.overlap, DEEPEST)
        reasons.append(f"grains overlap by {overlap} d, more than {threshold} d")
    limit = FASTEST * (ledger.expected_speed or math.inf)  # a filling has none: no speed is too high
    if ledger.speed is not None and ledger.speed > limit:
        reasons.append(f"a grain moves at {ledger.speed:.3g} m/s, more than {FASTEST:g} times its free-fall speed")
    if ledger.outside:
        reasons.append(f"{_grains(ledger.outside)} went through a wall or past the outlet")
    if ledger.lost:
        balance = f"{ledger.started} = {ledger.inside} inside + {ledger.left} left + {ledger.outside} outside"
        balance += f" + {ledger.waiting} to enter" if ledger.waiting else ""
        reasons.append(f"the number of grains is not conserved: {balance} fails by {ledger.lost}")
    return "; ".join(reasons)


def ledger_summary(ledger: RunLedger | None) -> str:
    """Format a ledger as one line."""
    if ledger is None:
        return "not kept"
    overlap = "not known" if ledger.overlap is None else f"{ledger.overlap:.3g} d"
    speed = "not known" if ledger.speed is None else f"{ledger.speed:.3g} m/s"
    lost = f" + {ledger.waiting} to enter" if ledger.waiting else ""
    lost += f" + {ledger.lost} lost" if ledger.lost else ""
    grains = f"{ledger.started} grains = {ledger.inside} inside + {ledger.left} left + {ledger.outside} outside{lost}"
    return f"largest overlap {overlap}, largest speed {speed}; {grains}"


def _grains(n: int) -> str:
    return f"{n} grain{'' if n == 1 else 's'}"
