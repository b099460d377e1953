"""Threads within one scene: a large scene is split into domains if there are fewer members than cores.

A *domain* is a range of rows. Its thread moves these grains and adds up all forces on them, including those of pairs
with a grain of another domain: such a pair is computed by both threads. A domain has its own copy of the springs of the
pairs whose first grain is in another domain (`borrowed`); both copies stay equal, since both threads compute the same.
All sums have the order of one thread: the number of domains, chosen beat by beat, decides no bit.
"""

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import pairwise
from types import ModuleType

import numpy as np
from labbook_dem.reading import CROSSING_COLUMNS

from labbook.backend.machine import cores
from labbook.scene.packing import Packing
from labbook_numba import state as S
from labbook_numba.state import Layout, Params, State

NEAR_WORK = 2  # work of a near pair relative to a grain, to balance domains
STEP = CROSSING_COLUMNS.index("step")
LARGE, LARGE_RODS = 50_000, 10_000
"""Smallest numbers of spheres and of rods or clumps of a scene that is split; a domain has at least a quarter of that.
A rod takes four times as long as a sphere to step, and the barriers of the threads take as long for either."""
LAYERED = 2000
"""Smallest number of grains that are ordered in layers: fewer fit into the cache of a core in any order."""


def in_layers(packing: Packing, d: float) -> Packing:
    """Packing with its grains in the order of cells of size d [m], layer by layer; small packings as they are.

    Grains in contact are then close in memory, and those of a large scene mostly in the same domain.
    """
    if len(packing) < LAYERED:
        return packing
    cell = np.floor(packing.x / d)
    return packing.renumbered(np.lexsort(cell.T))


_running = 0
_lock = threading.Lock()


@contextmanager
def threads_for(grains: int, limit: int, large: int) -> Iterator[int]:
    """Return a context with the number of threads for a member's beat: its share of the cores, at most `limit`.

    A member of fewer than `large` grains gets one thread.
    """
    global _running
    with _lock:
        _running += 1
        share = cores() // _running
    try:
        yield max(1, min(share, limit, grains // (large // 4))) if grains >= large else 1
    finally:
        with _lock:
            _running -= 1


def advance(
    kernels: ModuleType, state: State, params: Params, target: int, layout: Layout, threads: int = 1
) -> int:  # fmt: skip
    """Take steps up to `target` with several threads; return the code of the kernel `advance`.

    If a thread raises, the others stop waiting for it, and its exception is raised here; the state is then of no step.
    """
    if threads == 1:
        state.domain[:] = 0, 1, 0, state.count[S.GRAINS], 0, state.count[S.PAIRS], 0
        return kernels.advance(state, params, target)
    domains = _split(state, params, layout, threads)
    with ThreadPoolExecutor(threads, thread_name_prefix="labbook-domain") as pool:
        codes = list(pool.map(lambda domain: _advance(kernels, domain, params, target), domains))
    _join(state, domains, codes[0] == kernels.BAD_OVERLAP)
    return codes[0]


def _advance(kernels: ModuleType, domain: State, params: Params, target: int) -> int:
    try:
        return kernels.advance(domain, params, target)
    except BaseException:  # the others would wait at the next barrier for ever
        domain.meetings[0] = S.BROKEN
        raise


def _split(state: State, params: Params, layout: Layout, threads: int) -> list[State]:
    """Return states that share grains and lists; each has its own copy of what its thread writes outside its domain."""
    n, pairs = int(state.count[S.GRAINS]), int(state.count[S.PAIRS])
    i, j = state.pair_i[:pairs], state.pair_j[:pairs]
    cumulative_work = np.cumsum(1 + NEAR_WORK * np.bincount(i, minlength=n))
    shares = cumulative_work[-1] * np.arange(1, threads) / threads
    per_grain = len(params.spheres) or 1  # the spheres of a clump are of one domain
    row_bounds = [0, *(int(row) // per_grain * per_grain for row in np.searchsorted(cumulative_work, shares)), n]
    shared_values, meetings = np.zeros((threads, S.CACHE_LINE)), np.zeros(1, np.int64)
    precision = "mixed" if state.block.dtype == np.float32 else "double"
    domains = []
    for number, (first, last) in enumerate(pairwise(row_bounds)):
        first_pair, last_pair = (int(k) for k in np.searchsorted(i, (first, last)))
        borrowed_pairs = np.flatnonzero((j[:first_pair] >= first) & (j[:first_pair] < last))
        count, loads = state.count.copy(), S.loads(len(state.ids))
        # Counted from 0 by each thread, and added up in `_join`: the copies all start with those of before.
        count[S.CROSSED], count[S.FAIL_GRAIN] = 0, -1
        mass = state.body[first:last, 1] if len(state.body) else params.mass
        if not len(state.clumps):  # which have weights of their own, that only their domain changes
            loads[first:last, S.F + 2] = -mass * params.gravity
        domain = state._replace(
            loads=loads,
            cross=np.zeros_like(state.cross),
            count=count,
            sums=state.sums.copy(),
            domain=np.array([number, threads, first, last, first_pair, last_pair, len(borrowed_pairs)]),
            **S.borrowed(state, borrowed_pairs),
            shared_values=shared_values,
            meetings=meetings,
            **S.scratch(len(state.ids), precision, layout),
        )
        domains.append(domain)
    return domains


def _join(state: State, domains: list[State], by_overlap: bool) -> None:
    """Combine the counters and crossings of domains as one thread would have them. by_overlap: an overlap was too
    large."""
    crossed, failed = int(state.count[S.CROSSED]), int(state.count[S.FAIL_GRAIN])
    state.count[:], state.sums[:] = domains[0].count, domains[0].sums
    rows = np.concatenate([domain.cross[: domain.count[S.CROSSED]] for domain in domains])
    state.count[S.CROSSED] = crossed + len(rows)
    # By step, and within a step by domain, which is the order of rows: as one thread would have written them.
    state.cross[crossed : crossed + len(rows)] = rows[np.argsort(rows[:, STEP], kind="stable")]
    state.count[S.LEAVING] = sum(domain.count[S.LEAVING] for domain in domains)
    state.sums[S.MAX_OVERLAP] = max(domain.sums[S.MAX_OVERLAP] for domain in domains)
    state.count[S.FAIL_GRAIN] = failed
    failing = [domain for domain in domains if domain.count[S.FAIL_GRAIN] >= 0]
    if by_overlap:  # one thread names the first of the largest overlaps; for other failures the last grain
        failing = [max(failing, key=lambda domain: domain.sums[S.MAX_OVERLAP])]
    if failing:
        state.count[S.FAIL_GRAIN] = failing[-1].count[S.FAIL_GRAIN]
