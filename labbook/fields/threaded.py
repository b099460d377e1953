"""The compiled loops, with their tables and on as many threads as asked for."""

from collections.abc import Iterator
from contextlib import contextmanager

import numba

from labbook.fields import compiled


@contextmanager
def limited(threads: int) -> Iterator[None]:
    """Numba uses `threads` threads inside, but no more than it has."""
    before = numba.get_num_threads()
    numba.set_num_threads(min(threads, before))
    try:
        yield
    finally:
        numba.set_num_threads(before)


def threads() -> int:
    """Threads that are used unless fewer are asked for."""
    return numba.get_num_threads()


on_lattice = compiled.on_lattice
about_axis = compiled.about_axis


def _with_tables(loop):
    def call(*args):
        *given, out = args
        loop(*given, compiled.ERF, compiled.SLOPE, out)

    return call


lines_on_lattice = _with_tables(compiled.lines_on_lattice)
lines_about_axis = _with_tables(compiled.lines_about_axis)
