"""End of the start-up of an outflow, found from the times at which grains left.

A flow that builds up as W(t) = W_inf (1 - exp(-t/tau)) has discharged W_inf [t - tau (1 - exp(-t/tau))] after the time
t. For the right tau, the mass of equally large parts of the outflow over the difference of the bracket is W_inf with
noise; for a wrong one it changes with time. So tau is the time for which the logarithm of this ratio scatters least.
The start-up is over when W is within 1 % of W_inf, after tau ln 100.

Each run is judged by itself. Replicates then stay independent of each other, so that Student's interval of their mean
holds, and a further replicate changes no number of the others.

The truncation rule MSER (White, Simulation 69 (1997) 323) was tried first. It weighs the bias of a single run against
its variance, and leaves a bias of some 0.4 standard deviations of a run. In a mean of many runs that is too much.
"""

import math

import numpy as np

PLATEAU = 0.01
"""Part of W_inf that W may lack at the end of the start-up."""
LONGEST = 0.5
"""Part of the outflow that a start-up may take: a longer one leaves no steady part."""
_PARTS = (6, 50)  # least and largest number of parts of the outflow
_GRAINS = 25  # in a part, if that gives enough parts
_TAUS = np.geomspace(0.003, 0.5, 60)  # of the duration; below, a start-up is shorter than one part


def end_of_start_up(times: np.ndarray, passed: np.ndarray, gap: float = math.inf) -> int | None:
    """Find the first crossing after the start-up.

    Args:
        times: Ascending times of crossings since the opening [s], shape [n], n of at least 20.
        passed: Mass that has left with each crossing and before, in any unit, shape [n].
        gap: Longest time without a grain that counts as flow [s]; longer ones count as a mean one.

    Returns:
        Index of the crossing; None if the start-up takes more than `LONGEST` of the crossings.
    """
    waits = np.diff(times, prepend=0.0)
    flowing = waits[waits <= gap]
    elapsed = np.cumsum(np.where(waits > gap, flowing.mean() if len(flowing) else gap, waits))
    end = math.log(1 / PLATEAU) * start_up_time(elapsed, passed)
    first = int(np.searchsorted(elapsed, end))
    return first if first <= LONGEST * (len(times) - 1) else None


def start_up_time(times: np.ndarray, passed: np.ndarray) -> float:
    """Estimate the time tau [s] of an exponential start-up; 0 if noise hides it. Arguments as above."""
    blocks = int(np.clip(len(times) // _GRAINS, *_PARTS))
    rows = np.linspace(0, len(times) - 1, blocks + 1).round().astype(int)
    at, mass = times[rows], np.diff(passed[rows])
    taus = np.concatenate([[0.0], at[-1] * _TAUS])
    lost = np.zeros((len(taus), len(at)))  # time for which the flow is behind W_inf t
    lost[1:] = -taus[1:, None] * np.expm1(-at / taus[1:, None])
    scatter = np.log(mass / np.diff(at - lost, axis=1)).var(axis=1)
    return float(taus[np.argmin(scatter)])
