"""A process that places grains, puts what jobs keep into the lab, and measures it, while another steps them.

Threads would do, were it not for Python's interpreter, which only one of them has at a time: where hundreds of small
beds end together, the threads that write and measure them would keep the GPU waiting. The process is one of its own
program, not a copy of its parent: so it takes nothing over from a GPU, and a script that runs a study needs no guard.
It ends with its parent.
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

from labbook.run.job import Kept, LabEntry
from labbook.scene import attached

T = TypeVar("T")
_LOG = logging.getLogger("labbook")


_PIPE = 2**20
"""Bytes that are on their way to or from it, at most: about those of a bed of 1000 grains."""
_BROKEN = (OSError, EOFError, pickle.PickleError, AttributeError, TypeError)
"""What comes of a process that has ended, and of things that cannot be pickled."""


class Gone(Exception):
    """The process has ended, or cannot take over what it was given; the message says why."""


class Aside:
    """The process, started at once. Raises Gone if it cannot start."""

    def __init__(self) -> None:
        paths = os.pathsep.join(dict.fromkeys(sys.path))
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-c", "from labbook.run.aside import serve; serve()"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env={**os.environ, "PYTHONPATH": paths},
            )
        except OSError as problem:
            raise Gone(f"it cannot be started: {problem}") from problem
        for pipe in (self._process.stdin, self._process.stdout):
            assert pipe is not None
            with suppress(OSError, AttributeError):  # where a user has many pipes, or pipes are always as large
                fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, _PIPE)
        self._send(attached.places())

    def put(self, kept: Kept) -> None:
        """Put `kept` into the lab. Raises what `Kept.put` does, and Gone."""
        self._send(kept)
        self._answer()

    def _send(self, message: object) -> None:
        assert self._process.stdin is not None
        try:  # as one: other threads of this process wait for the interpreter after every write
            self._process.stdin.write(pickle.dumps(message, pickle.HIGHEST_PROTOCOL))
            self._process.stdin.flush()
        except _BROKEN as problem:
            self.end()
            raise Gone(f"{type(problem).__name__}: {problem}") from problem

    def call(self, function: Callable[..., T], *args: Any) -> T:
        """Return what a function of a module gives there. Raises what it raises, and Gone."""
        self._send((function, args))
        return self._answer()

    def entry(self) -> LabEntry:
        """Return the entry of what was put last, which is made now. Raises what `Kept.entry` does, and Gone."""
        return self._answer()

    def _answer(self) -> Any:
        assert self._process.stdout is not None
        try:
            answer: Any = pickle.load(self._process.stdout)
        except _BROKEN as problem:
            self.end()
            raise Gone(f"{type(problem).__name__}: {problem}") from problem
        if isinstance(answer, Gone):
            self.end()
        if isinstance(answer, BaseException):
            raise answer
        return answer

    def end(self) -> None:
        """End it, once it has done what it was given."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with suppress(OSError):  # of one that has ended already
            self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()


def serve() -> None:
    """Call functions, and put what else comes by standard input into labs, until there is no more. Ctrl-C is for the
    parent alone."""
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
            _tell(answers, Gone(f"{type(problem).__name__}: {problem}"))
        else:
            if isinstance(message, Kept):
                if _tell(answers, _done(message.put)):
                    _tell(answers, _done(message.entry))
            else:
                function, args = message
                _tell(answers, _done(lambda function=function, args=args: function(*args)))


def _done(what: Callable[[], Any]) -> Any:
    """What comes of it, or the error, which is raised where the run was handed over."""
    try:
        return what()
    except Exception as problem:
        return problem


def _tell(answers: IO[bytes], answer: Any) -> bool:
    """Give an answer; whether it is no error."""
    try:
        pickle.dump(answer, answers)
    except Exception:  # an error that cannot be pickled
        pickle.dump(Gone(repr(answer)), answers)
    answers.flush()
    return not isinstance(answer, Exception)
