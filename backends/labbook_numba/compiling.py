"""Whether Numba is compiling, by its own events. Importing this loads nothing of Numba."""

import threading
from functools import cache

_lock = threading.Lock()
_going = 0


def going() -> bool:
    """Whether a kernel is being compiled in any thread. Kernels read from the cache do not count."""
    return _going > 0


@cache
def watch() -> None:
    """Listen to Numba's events from now on."""
    from numba.core import event

    def count(change: int) -> None:
        global _going
        with _lock:
            _going += change

    class Listener(event.Listener):
        def on_start(self, event) -> None:
            count(1)

        def on_end(self, event) -> None:
            count(-1)

    event.register("numba:compile", Listener())
