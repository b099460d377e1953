"""Stop requests: Ctrl-C, SIGTERM, or a terminal that goes away (SIGHUP).

The first request saves the work and ends it. A second one raises KeyboardInterrupt at once; the last saves stay valid.
A batch system may send SIGTERM to a job's shell, which passes it on, and to every process of the job: these signals
count as one request.
"""

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from queue import SimpleQueue

SAVING = "stopping: saving unfinished runs ... (Ctrl-C again to stop at once)"
SIGTERM_WINDOW = 5.0  # s within which SIGTERM may come several times


class StopRequest:
    """A flag that asks a runner to stop, set by signals or by another thread (`requested`)."""

    def __init__(self) -> None:
        self.requested = False

    @contextmanager
    def listening(self, tell: Callable[[str], None]) -> Iterator[None]:
        """Handle stop signals while in the context; outside the main thread this does nothing.

        Args:
            tell: Shows the answer to the first signal. It is called in a thread of its own: the main thread may be
                busy, or in the middle of printing.
        """
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        answer: SimpleQueue[bool] = SimpleQueue()  # whose `put` is safe in a handler

        def handle(number: int, _frame: object) -> None:
            # Closing a terminal may send several signals of different kinds: they are one request.
            now = time.monotonic()
            is_late = number in received and (number != signal.SIGTERM or now - received[number] > SIGTERM_WINDOW)
            is_repeated = self.requested and (number == signal.SIGINT or is_late)
            if is_repeated and number != signal.SIGHUP:
                raise KeyboardInterrupt
            received.setdefault(number, now)
            self.requested = True
            answer.put(True)

        def announce() -> None:
            if answer.get():
                with suppress(OSError):  # the terminal is gone
                    tell(SAVING)

        received: dict[int, float] = {}
        threading.Thread(target=announce, name="labbook-stopping", daemon=True).start()
        numbers = [signal.SIGINT, signal.SIGTERM]
        if signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:  # which nohup asks for
            numbers.append(signal.SIGHUP)
        former_handlers = {number: signal.signal(number, handle) for number in numbers}
        try:
            yield
        finally:
            for number, handler in former_handlers.items():
                signal.signal(number, handler)
            answer.put(False)
