"""Coverage and cost of intervals from several discharges of each bed, in simulation.

    python benchmarks/nested.py [--repeats 4000] [--out FILE]

A run's W is 1 + scatter (sqrt(share) bed + sqrt(1 - share) flow), with normal or skewed bed and flow (gamma
distribution of shape 8: its skewness is 0.71). Each repeat follows the stopping rule of `accuracy.flow_rate` (1 %) to
its end, with 1, 2, 3 or 6 discharges of each bed or the cheapest number. A table has how many intervals hold the mean,
their mean half width, beds, discharges of each and cost. Costs are in discharges; a filling costs as many as stated.
"""

import argparse
import json
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path

import numpy as np

from labbook.campaign import Assignment, Generation, History, Replicates, Trial
from labbook.stats import StoppingRule
from labbook.stats.nested import Design

ERROR = 0.01
SHARES, SCATTERS = (0.0, 0.15, 0.5), (0.015, 0.04)
DESIGNS: tuple[tuple[int | str, float], ...] = ((1, 2.0), (2, 2.0), (3, 2.0), (6, 2.0), ("auto", 2.0), ("auto", 0.5))
"""Discharges of each bed, and cost of a filling."""
_SHAPE = 8.0

Draw = Callable[[np.random.Generator], float]


def normal(rng: np.random.Generator) -> float:
    """A number of mean 0 and variance 1 from the normal distribution."""
    return rng.standard_normal()


def skewed(rng: np.random.Generator) -> float:
    """The same from a gamma distribution."""
    return (rng.gamma(_SHAPE) - _SHAPE) / math.sqrt(_SHAPE)


@dataclass(frozen=True)
class Case:
    """What is simulated, and what came of it."""

    share: float
    scatter: float
    filling: float
    skewed: bool
    discharges: int | str
    coverage: float
    half_width: float
    beds: float
    discharges_of_each: float
    cost: float


def ending(rng: np.random.Generator, draw: Draw, case: tuple) -> tuple[bool, float, int, int, float]:
    """One repeat: whether its interval holds the mean, half width, beds, discharges of each, cost."""
    share, scatter, filling, number = case
    auto = number == "auto"
    strategy = Replicates.of(rule=StoppingRule(ERROR, 3, 200), scatter=None, filling=filling if auto else None)
    bed, flow = dict[int, float](), dict[tuple[int, int], float]()
    now = Design(3, 1 if auto else number)
    while True:
        trials = []
        for seed, k in product(range(1, now.beds + 1), range(1, now.discharges + 1)):
            bed[seed] = bed[seed] if seed in bed else draw(rng)
            flow[seed, k] = flow[seed, k] if (seed, k) in flow else draw(rng)
            value = 1 + scatter * (math.sqrt(share) * bed[seed] + math.sqrt(1 - share) * flow[seed, k])
            trials.append(Trial({}, seed, f"{seed} {k}", "finished", {"flow_rate": value}, k))
        done = Generation(0, (Assignment({}, now.beds, now.discharges),), "", tuple(trials))
        proposal = strategy.propose(History(None, (done,), (), 1))
        if proposal.state == "end":
            break
        (assigned,) = proposal.assignments
        now = Design(assigned.replicates, assigned.discharges)
    assert proposal.decision is not None
    pooled = proposal.decision.pooled
    assert pooled is not None
    inside = abs(pooled.value - 1) <= pooled.half_width
    return inside, pooled.half_width, now.beds, now.discharges, now.beds * (filling + now.discharges)


def main() -> None:
    """Simulate and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--repeats", type=int, default=4000)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    cases = []
    print("| share | scatter | filling | distribution | discharges | coverage | half width | beds | of each | cost |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for shape, share, scatter, (number, filling) in product((normal, skewed), SHARES, SCATTERS, DESIGNS):
        rng = np.random.default_rng([7, int(100 * share), int(1000 * scatter)])
        ended = np.array(
            [ending(rng, shape, (share, scatter, filling, number)) for _ in range(given.repeats)], dtype=float
        )
        case = Case(share, scatter, filling, shape is skewed, number, *ended.mean(axis=0).tolist())
        cases.append(case)
        stated = f"| {share:g} | {100 * scatter:g} % | {filling:g} | {shape.__name__} | {number} "
        widths = f"| {100 * case.coverage:.1f} % | {100 * case.half_width:.2f} % "
        print(f"{stated}{widths}| {case.beds:.1f} | {case.discharges_of_each:.2f} | {case.cost:.1f} |", flush=True)
    if given.out:
        given.out.write_text(json.dumps([asdict(case) for case in cases], indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
