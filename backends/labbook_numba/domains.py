"""Threads within one scene: large scenes are split into domains, where members are fewer than cores.

A *domain* is a range of rows. Its thread moves these grains and adds up all forces on them, also those of pairs whose
other grain is another domain's: such a pair is computed by both. A domain keeps its own copy of the springs of those
pairs whose first grain is another's (`borrowed`); as both compute the same, both stay the same. Sums so have the order
that they have in one thread: how many domains there are is decided beat by beat, and no bit depends on it.
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

NEAR_WORK = 2  # work of a near pair, in grains; so that domains take equally long
STEP = CROSSING_COLUMNS.index("step")
LARGE, LARGE_RODS = 50_000, 10_000
"""Spheres and rods from which on a scene may be split; domains have a quarter of that at least. A rod takes four times
as long to step as a sphere, and the meetings of the threads take as long."""
LAYERED = 2000
"""Grains from which on they are put in layers: fewer fit into a core's own cache in any order."""


def in_layers(packing: Packing, d: float) -> Packing:
    """A packing of some size, its grains in the order of cells of size d [m], layer by layer; a small one as it is.

    Grains that touch then stand close together in memory, and those of a large scene mostly in the same domain.
    """
    if len(packing) < LAYERED:
        return packing
    cell = np.floor(packing.x / d)
    return packing.renumbered(np.lexsort(cell.T))


_running = 0
_lock = threading.Lock()


@contextmanager
def threads_for(grains: int, most: int, large: int) -> Iterator[int]:
    """Threads that a member should take its beat with: its share of the cores, if it has `large` grains or more, and
    `most` at most."""
    global _running
    with _lock:
        _running += 1
        share = cores() // _running
    try:
        yield max(1, min(share, most, grains // (large // 4))) if grains >= large else 1
    finally:
        with _lock:
            _running -= 1


def advance(
    kernels: ModuleType, state: State, params: Params, target: int, layout: Layout, threads: int = 1
) -> int:  # fmt: skip
    """Take steps up to `target` with so many threads; the code that `advance` of the kernels gives.

    If a domain raises, the others stop waiting for it, and what it raised is raised here; the state is then of no step.
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
    except BaseException:
        domain.meetings[0] = S.BROKEN
        raise


def _split(state: State, params: Params, layout: Layout, threads: int) -> list[State]:
    """States that share grains and lists, each with its own of all that a thread writes outside its domain."""
    n, pairs = int(state.count[S.GRAINS]), int(state.count[S.PAIRS])
    i, j = state.pair_i[:pairs], state.pair_j[:pairs]
    work = np.cumsum(1 + NEAR_WORK * np.bincount(i, minlength=n))
    bounds = [0, *(int(row) for row in np.searchsorted(work, work[-1] * np.arange(1, threads) / threads)), n]
    told, meetings = np.zeros((threads, S.CACHE_LINE)), np.zeros(1, np.int64)
    precision = "mixed" if state.block.dtype == np.float32 else "double"
    domains = []
    for number, (first, last) in enumerate(pairwise(bounds)):
        first_pair, last_pair = (int(k) for k in np.searchsorted(i, (first, last)))
        before = np.flatnonzero((j[:first_pair] >= first) & (j[:first_pair] < last))
        count, loads = state.count.copy(), S.loads(len(state.ids))
        count[S.CROSSED], count[S.FAIL_GRAIN] = 0, -1
        mass = state.body[first:last, 1] if len(state.body) else params.mass
        loads[first:last, S.F + 2] = -mass * params.gravity
        domain = state._replace(
            loads=loads,
            cross=np.zeros_like(state.cross),
            count=count,
            sums=state.sums.copy(),
            domain=np.array([number, threads, first, last, first_pair, last_pair, len(before)]),
            **S.borrowed(state, before),
            told=told,
            meetings=meetings,
            **S.scratch(len(state.ids), precision, layout),
        )
        domains.append(domain)
    return domains


def _join(state: State, domains: list[State], deep: bool) -> None:
    """Bring together what the domains counted, as one thread would have; `deep`: an overlap was too large."""
    crossed, failed = int(state.count[S.CROSSED]), int(state.count[S.FAIL_GRAIN])
    state.count[:], state.sums[:] = domains[0].count, domains[0].sums
    rows = np.concatenate([domain.cross[: domain.count[S.CROSSED]] for domain in domains])
    state.count[S.CROSSED] = crossed + len(rows)
    state.cross[crossed : crossed + len(rows)] = rows[np.argsort(rows[:, STEP], kind="stable")]
    state.count[S.LEAVING] = sum(domain.count[S.LEAVING] for domain in domains)
    state.sums[S.MAX_OVERLAP] = max(domain.sums[S.MAX_OVERLAP] for domain in domains)
    state.count[S.FAIL_GRAIN] = failed
    blamed = [domain for domain in domains if domain.count[S.FAIL_GRAIN] >= 0]
    if deep:  # of the deepest overlap, and in one thread the first of them; else the last grain
        blamed = [max(blamed, key=lambda domain: domain.sums[S.MAX_OVERLAP])]
    if blamed:
        state.count[S.FAIL_GRAIN] = blamed[-1].count[S.FAIL_GRAIN]
