"""Being asked to stop: by Ctrl-C, by SIGTERM, or by a terminal that goes away (SIGHUP).

Asked once, work is saved and ends. Asked again, it is left at once by a KeyboardInterrupt: the last saves stay good.
A batch system may send SIGTERM to a job's shell, which passes it on, and to every process of the job: those are one
request.
"""

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from queue import SimpleQueue

SAVING = "stopping: saving unfinished runs ... (Ctrl-C again to stop at once)"
TOGETHER = 5.0  # s within which SIGTERM may come several times


class Request:
    """Whether it was asked to stop."""

    def __init__(self) -> None:
        self.made = False

    @contextmanager
    def listening(self, tell: Callable[[str], None]) -> Iterator[None]:
        """Take note of signals, in the main thread; elsewhere this does nothing. `tell` passes on the answer to the
        first one, from a thread of its own: the main thread may be busy, or in the middle of printing."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        answer: SimpleQueue[bool] = SimpleQueue()  # whose `put` is safe in a handler

        def ask(number: int, _frame: object) -> None:
            # Closing a terminal may send several signals of different kinds: they are one request.
            now = time.monotonic()
            late = number in seen and (number != signal.SIGTERM or now - seen[number] > TOGETHER)
            again = self.made and (number == signal.SIGINT or late)
            if again and number != signal.SIGHUP:
                raise KeyboardInterrupt
            seen.setdefault(number, now)
            self.made = True
            answer.put(True)

        def announce() -> None:
            if answer.get():
                with suppress(OSError):  # the terminal is gone
                    tell(SAVING)

        seen: dict[int, float] = {}
        threading.Thread(target=announce, name="labbook-stopping", daemon=True).start()
        asking = [signal.SIGINT, signal.SIGTERM]
        if signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:  # which nohup asks for
            asking.append(signal.SIGHUP)
        before = {number: signal.signal(number, ask) for number in asking}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
            answer.put(False)
