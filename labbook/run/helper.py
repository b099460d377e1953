"""A helper process that places grains, writes the output of jobs to the lab, and measures it.

The main process steps other jobs meanwhile. Threads would share Python's interpreter lock with it: where hundreds of
small beds end together, they would keep a GPU waiting. The helper is a new program, not a fork: so it inherits no GPU
context, and scripts need no `if __name__ == "__main__"`. It ends with its parent.
"""

import fcntl
import logging
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import IO, Any, TypeVar

from labbook.run.job import JobOutput, LabEntry
from labbook.scene import attached

T = TypeVar("T")
_LOG = logging.getLogger("labbook")


_PIPE_BYTES = 2**20
"""Size of its pipes [bytes]: about that of a bed of 1000 grains."""
_PIPE_ERRORS = (OSError, EOFError, pickle.PickleError, AttributeError, TypeError)
"""Errors of a process that has ended, and of objects that cannot be pickled."""


class HelperLost(Exception):
    """The helper process has ended, or cannot take over a task; the message gives the reason."""


class HelperProcess:
    """A running helper process. Raises HelperLost if it cannot start."""

    def __init__(self) -> None:
        paths = os.pathsep.join(dict.fromkeys(sys.path))
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-c", "from labbook.run.helper import serve; serve()"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env={**os.environ, "PYTHONPATH": paths},
            )
        except OSError as problem:
            raise HelperLost(f"it cannot be started: {problem}") from problem
        for pipe in (self._process.stdin, self._process.stdout):
            assert pipe is not None
            with suppress(OSError, AttributeError):  # where a user has many pipes, or pipes are always as large
                fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
        self._send(attached.places())

    def put(self, output: JobOutput) -> None:
        """Put the output of a job into the lab. Raises what `JobOutput.put` does, and HelperLost."""
        self._send(output)
        self._answer()

    def _send(self, message: object) -> None:
        assert self._process.stdin is not None
        try:  # as one: other threads of this process wait for the interpreter after every write
            self._process.stdin.write(pickle.dumps(message, pickle.HIGHEST_PROTOCOL))
            self._process.stdin.flush()
        except _PIPE_ERRORS as problem:
            self.end()
            raise HelperLost(f"{type(problem).__name__}: {problem}") from problem

    def call(self, function: Callable[..., T], *args: Any) -> T:
        """Call a function of a module in the helper, and return its result. Raises its errors, and HelperLost."""
        self._send((function, args))
        return self._answer()

    def entry(self) -> LabEntry:
        """Return the lab entry of the last output; it is made now. Raises what `JobOutput.entry` does, and
        HelperLost."""
        return self._answer()

    def _answer(self) -> Any:
        assert self._process.stdout is not None
        try:
            answer: Any = pickle.load(self._process.stdout)
        except _PIPE_ERRORS as problem:
            self.end()
            raise HelperLost(f"{type(problem).__name__}: {problem}") from problem
        if isinstance(answer, HelperLost):
            self.end()
        if isinstance(answer, BaseException):
            raise answer
        return answer

    def end(self) -> None:
        """End the process after its present task."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with suppress(OSError):  # of one that has ended already
            self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()


def serve() -> None:
    """Serve requests from standard input until it closes: call functions, and put outputs into labs.

    Stop signals are ignored: the parent handles them.
    """
    # Ctrl-C reaches all processes of a terminal. The helper must finish its task: the parent waits for the answer.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what anything prints is no answer
    try:
        attached.use(pickle.load(sys.stdin.buffer))
    except EOFError:
        return
    while True:
        try:
            message = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        except Exception as problem:  # a class from a package that this process cannot import
            _answer_with(answers, HelperLost(f"{type(problem).__name__}: {problem}"))
        else:
            if isinstance(message, JobOutput):
                if _answer_with(answers, _result_of(message.put)):
                    _answer_with(answers, _result_of(message.entry))
            else:
                function, args = message
                _answer_with(answers, _result_of(lambda function=function, args=args: function(*args)))


def _result_of(call: Callable[[], Any]) -> Any:
    """Return the result of a call, or its error, which is raised in the parent."""
    try:
        return call()
    except Exception as problem:
        return problem


def _answer_with(answers: IO[bytes], answer: Any) -> bool:
    """Send an answer. Returns True if it is no error."""
    try:
        pickle.dump(answer, answers)
    except Exception:  # an error that cannot be pickled
        pickle.dump(HelperLost(repr(answer)), answers)
    answers.flush()
    return not isinstance(answer, Exception)
