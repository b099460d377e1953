"""State of Numba's compiler, by its own events. Importing this loads nothing of Numba."""

import threading
from functools import cache

_lock = threading.Lock()
_running = 0


def any_running() -> bool:
    """Return True while a kernel is compiled in any thread. Reading one from the cache does not count."""
    return _running > 0


@cache
def watch() -> None:
    """Listen to Numba's events from now on."""
    from numba.core import event

    def count(change: int) -> None:
        global _running
        with _lock:  # kernels are compiled in several threads, and += is not atomic
            _running += change

    class Listener(event.Listener):
        def on_start(self, event) -> None:
            count(1)

        def on_end(self, event) -> None:
            count(-1)

    event.register("numba:compile", Listener())
