"""Several steps in one launch, where grains are so few that all threads are on the device at once."""

from __future__ import annotations

from labbook_warp.kernels.step import take_step
from labbook_warp.kernels.system import System
from labbook_warp.kernels.words import Bits, Words, hot_kernel, this_thread, wait_for_all, wp


@hot_kernel
def several_steps(a: System, p: Words, q: Words, first: int, some: int, arrived: Bits):
    """`some` steps of this beat, from p to q and back: each begins when all threads have ended the one before."""
    thread = this_thread(wp.tid())
    for k in range(some):
        if k > 0:
            wait_for_all(arrived)
        odd = k % 2 == 1
        take_step(a, wp.where(odd, q, p), wp.where(odd, p, q), first + k, thread)
