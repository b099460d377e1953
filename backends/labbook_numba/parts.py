"""Threads within one scene: large scenes are split into parts, where members are fewer than cores.

A *part* is a range of rows. Its thread moves these grains and adds up all forces on them, also those of pairs whose
other grain is another part's: such a pair is computed by both. A part keeps its own copy of the springs of those pairs
whose first grain is another's (`borrowed`); as both compute the same, both stay the same. Sums so have the order that
they have in one thread: how many parts there are is decided beat by beat, and no bit depends on it.
"""

import os
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import pairwise
from types import ModuleType

import numpy as np
from labbook_dem.reading import CROSSING_COLUMNS

from labbook.scene.packing import Packing
from labbook_numba import state as S
from labbook_numba.state import Params, State

NEAR_WORK = 2  # work of a near pair, in grains; so that parts take equally long
STEP = CROSSING_COLUMNS.index("step")
LARGE = 50_000
"""Grains from which on a scene may be split; parts have a quarter of that at least."""


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_layers(packing: Packing, d: float) -> Packing:
    """A large packing, its grains in the order of cells of size d [m], layer by layer; a smaller one as it is.

    Grains that touch then stand close together in memory, and most in the same part.
    """
    if len(packing) < LARGE:
        return packing
    cell = np.floor(packing.x / d)
    return packing.renumbered(np.lexsort(cell.T))


_running = 0
_lock = threading.Lock()


@contextmanager
def threads_for(grains: int, most: int) -> Iterator[int]:
    """Threads that a member should take its beat with: its share of the cores, if it is large, and `most` at most."""
    global _running
    with _lock:
        _running += 1
        share = cores() // _running
    try:
        yield max(1, min(share, most, grains // (LARGE // 4))) if grains >= LARGE else 1
    finally:
        with _lock:
            _running -= 1


def advance(kernels: ModuleType, state: State, params: Params, target: int, threads: int = 1) -> int:
    """Take steps up to `target` with so many threads; the code that `advance` of the kernels gives.

    If a part raises, the others stop waiting for it, and what it raised is raised here; the state is then of no step.
    """
    if threads == 1:
        state.part[:] = 0, 1, 0, state.count[S.GRAINS], 0, state.count[S.PAIRS], 0
        return kernels.advance(state, params, target)
    parts = _split(state, params, threads)
    with ThreadPoolExecutor(threads, thread_name_prefix="labbook-part") as pool:
        codes = list(pool.map(lambda part: _advance(kernels, part, params, target), parts))
    _join(state, parts, codes[0] == kernels.BAD_OVERLAP)
    return codes[0]


def _advance(kernels: ModuleType, part: State, params: Params, target: int) -> int:
    try:
        return kernels.advance(part, params, target)
    except BaseException:
        part.meetings[0] = S.BROKEN
        raise


def _split(state: State, params: Params, threads: int) -> list[State]:
    """States that share grains and lists, and have their own of all that a thread writes elsewhere than in its part."""
    n, pairs = int(state.count[S.GRAINS]), int(state.count[S.PAIRS])
    i, j = state.pair_i[:pairs], state.pair_j[:pairs]
    work = np.cumsum(1 + NEAR_WORK * np.bincount(i, minlength=n))
    bounds = [0, *(int(row) for row in np.searchsorted(work, work[-1] * np.arange(1, threads) / threads)), n]
    told, meetings = np.zeros((threads, S.TOLD)), np.zeros(1, np.int64)
    precision = "mixed" if state.block.dtype == np.float32 else "double"
    parts = []
    for number, (first, last) in enumerate(pairwise(bounds)):
        first_pair, last_pair = (int(k) for k in np.searchsorted(i, (first, last)))
        before = np.flatnonzero((j[:first_pair] >= first) & (j[:first_pair] < last))
        count, loads = state.count.copy(), S.loads(len(state.ids))
        count[S.CROSSED], count[S.FAIL_GRAIN] = 0, -1
        mass = state.body[first:last, 1] if len(state.body) else params.mass
        loads[first:last, S.F + 2] = -mass * params.gravity
        part = state._replace(
            loads=loads,
            cross=np.zeros_like(state.cross),
            count=count,
            sums=state.sums.copy(),
            part=np.array([number, threads, first, last, first_pair, last_pair, len(before)]),
            **S.borrowed(state, before),
            told=told,
            meetings=meetings,
            **S.scratch(len(state.ids), precision, S.MIXTURES if len(state.body) else S.SPHERES),
        )
        parts.append(part)
    return parts


def _join(state: State, parts: list[State], deep: bool) -> None:
    """Bring together what the parts counted, as one thread would have; `deep`: an overlap was too large."""
    crossed, failed = int(state.count[S.CROSSED]), int(state.count[S.FAIL_GRAIN])
    state.count[:], state.sums[:] = parts[0].count, parts[0].sums
    rows = np.concatenate([part.cross[: part.count[S.CROSSED]] for part in parts])
    state.count[S.CROSSED] = crossed + len(rows)
    state.cross[crossed : crossed + len(rows)] = rows[np.argsort(rows[:, STEP], kind="stable")]
    state.count[S.LEAVING] = sum(part.count[S.LEAVING] for part in parts)
    state.sums[S.MAX_OVERLAP] = max(part.sums[S.MAX_OVERLAP] for part in parts)
    state.count[S.FAIL_GRAIN] = failed
    blamed = [part for part in parts if part.count[S.FAIL_GRAIN] >= 0]
    if deep:  # of the deepest overlap, and in one thread the first of them; else the last grain
        blamed = [max(blamed, key=lambda part: part.sums[S.MAX_OVERLAP])]
    if blamed:
        state.count[S.FAIL_GRAIN] = blamed[-1].count[S.FAIL_GRAIN]
