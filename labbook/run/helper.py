"""A helper process that places grains, writes the output of jobs to the lab, and measures it.

The main process steps other jobs meanwhile. Threads would share Python's interpreter lock with it: where hundreds of
small beds end together, they would keep a GPU waiting. The helper is a new program, not a fork: so it inherits no GPU
context, and scripts need no `if __name__ == "__main__"`.

A helper takes seconds to start, since it imports labbook. So it is kept when its run ends: later runs of the same
process take it over. It ends with its parent.
"""

import atexit
import fcntl
import logging
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Hashable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, ClassVar, TypeVar
from weakref import WeakSet

from labbook.plugins import loaded_sources
from labbook.run.job import JobOutput, LabEntry
from labbook.scene import attached

T = TypeVar("T")
_LOG = logging.getLogger("labbook")


MAX_HELPERS = 15
"""Maximum number of helpers of a run, and of idle ones."""
_PIPE_BYTES = 2**20
"""Size of its pipes [bytes]: about that of a bed of 1000 grains."""
_PIPE_ERRORS = (OSError, EOFError, pickle.PickleError, AttributeError, TypeError)
"""Errors of a process that has ended, and of objects that cannot be pickled."""


class HelperLost(Exception):
    """The helper process has ended, or cannot take over a task; the message gives the reason."""


class HelperProcess:
    """A running helper process. Raises HelperLost if it cannot start.

    Attributes:
        origin: What it was started with, as `origin` gives it.
    """

    running: ClassVar["WeakSet[HelperProcess]"] = WeakSet()

    def __init__(self) -> None:
        self.origin = origin()
        self._unread = 0
        """Number of answers that have not been read yet."""
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-c", "from labbook.run.helper import serve; serve()"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env=_environment(),
            )
        except OSError as problem:
            raise HelperLost(f"it cannot be started: {problem}") from problem
        self.running.add(self)
        for pipe in (self._process.stdin, self._process.stdout):
            assert pipe is not None
            with suppress(OSError, AttributeError):  # where a user has many pipes, or pipes are always as large
                fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
        self.begin()

    def begin(self) -> None:
        """Begin a run: hand over what may have changed since the last one. Raises HelperLost if the process has
        ended."""
        self._send((_begin, (_environment(), attached.registered())))
        self._answer()

    @property
    def is_idle(self) -> bool:
        """True if it runs and has answered every message."""
        return not self._unread and self._process.poll() is None

    def put(self, output: JobOutput) -> None:
        """Put the output of a job into the lab. Raises what `JobOutput.put` does, and HelperLost."""
        self._send(output)
        self._answer()
        self._unread += 1  # the entry

    def _send(self, message: object) -> None:
        assert self._process.stdin is not None
        self._unread += 1
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
        self._unread -= 1
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

    def kill(self) -> None:
        """End the process now; only of one that has no task."""
        self._process.kill()
        self.end()

    def forget(self) -> None:
        """Let go of the process in a child that this process has forked: its pipes belong to the parent."""
        null = os.open(os.devnull, os.O_RDWR)
        for pipe in (self._process.stdin, self._process.stdout):
            with suppress(ValueError):  # it is closed
                assert pipe is not None
                os.dup2(null, pipe.fileno(), inheritable=False)  # closing it might write what the parent is writing
        os.close(null)


class IdleHelpers:
    """The idle helpers of this process, which its later runs take over. They are killed at its end.

    A helper is taken over only where a new one would start alike (`origin`); the environment is handed over.
    """

    def __init__(self) -> None:
        self._helpers: list[HelperProcess] = []
        self._lock = threading.Lock()

    def take(self) -> HelperProcess:
        """Take over an idle helper, or start a new one. Raises HelperLost if none can be started."""
        present = origin()
        while (helper := self._pop()) is not None:
            if helper.origin != present:
                helper.kill()
                continue
            with suppress(HelperLost):  # it was killed while it was idle
                helper.begin()
                return helper
        return HelperProcess()

    def _pop(self) -> HelperProcess | None:
        with self._lock:
            return self._helpers.pop() if self._helpers else None

    def put_back(self, helper: HelperProcess) -> None:
        """Keep a helper whose run has ended; end it if it is busy or MAX_HELPERS are kept already."""
        with self._lock:
            keeps = helper.is_idle and len(self._helpers) < MAX_HELPERS
            if keeps:
                self._helpers.append(helper)
        if not keeps:
            helper.end()

    def end(self) -> None:
        """Kill all idle helpers."""
        while (helper := self._pop()) is not None:
            helper.kill()

    def forget(self) -> None:
        """Let go of all helpers, busy ones too, in a child that this process has forked."""
        self.__init__()
        for helper in list(HelperProcess.running):
            helper.forget()


idle_helpers = IdleHelpers()
atexit.register(idle_helpers.end)
os.register_at_fork(after_in_child=idle_helpers.forget)


def origin() -> Hashable:
    """Return what a new helper starts with that cannot be handed over later: working folder, error stream, search path
    of modules, and the code of extensions. Raises HelperLost if the working folder or the stream is gone."""
    try:
        stream = os.fstat(2)
        return os.getcwd(), stream.st_dev, stream.st_ino, tuple(sys.path), loaded_sources()
    except OSError as problem:
        raise HelperLost(f"its working folder or error stream is gone: {problem}") from problem


def _environment() -> dict[str, str]:
    """Return the environment of helpers."""
    return {**os.environ, "PYTHONPATH": os.pathsep.join(dict.fromkeys(sys.path))}


def _begin(environment: Mapping[str, str], attached_files: tuple[dict[str, Path], tuple[Path, ...]]) -> None:
    """Take over the environment of the parent and its places of attached files, in the helper."""
    os.environ.clear()
    os.environ.update(environment)
    attached.use(attached_files)


def load_packages() -> None:
    """Import the packages that placing grains and drawing beds need, in a helper, before it has grains to place."""
    import PIL.Image  # noqa: F401
    import scipy.spatial  # noqa: F401


def serve() -> None:
    """Serve requests from standard input until it closes: call functions, and put outputs into labs.

    Stop signals are ignored: the parent handles them.
    """
    # Ctrl-C reaches all processes of a terminal. The helper must finish its task: the parent waits for the answer.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what anything prints is no answer
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
