"""Progress for other processes: runners publish their state in `lab/live`, which anybody may read.

A runner holds the lock of `ID.lock` while it works, and writes its View to `ID.json` beside it, at most once a second.
A killed process frees its lock: from then on it does not count as running, and the next runner removes its files.
"""

import fcntl
import os
import re
import secrets
import time
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from platform import node
from typing import Any, ClassVar, Literal

from pydantic import ConfigDict, TypeAdapter
from pydantic_core import to_json

from labbook.lab.folder import Claim, LabError, LabFolder, is_locked, lock, open_file, remove, write_bytes
from labbook.lab.provenance import now
from labbook.run.watch import View, Watcher

EVERY = 1.0
"""Minimum wall time between two writes [s]."""
MAX_JOBS = 50
"""Maximum number of jobs that are published: a GPU may have thousands."""
_MAX_BYTES = 1_000_000  # bytes of a file that is read
_ID = re.compile(r"[A-Za-z0-9_-]+-[A-Za-z0-9._]*-\d+-[0-9a-f]{4}")
_FILE, _PARTIAL, _LOCK = ".json", ".json.part", ".lock"


@dataclass(frozen=True, kw_only=True)
class Running(View):
    """A process that works on a study, with the View that it published last; `going` has the first jobs only.

    Args:
        format: Version of the file's schema.
        id: Name of its files.
        study: Name of the study.
        backend: Name of the backend.
        device: Device.
        host: Name of the host.
        pid: Process number.
        started: Start of the work (UTC, ISO 8601).
        updated: Time of the last write (UTC, ISO 8601).
        jobs: Number of active jobs, also of those that `going` omits.
    """

    __pydantic_config__: ClassVar = ConfigDict(strict=True, allow_inf_nan=False)

    format: Literal[1] = 1
    id: str
    study: str
    backend: str
    device: str
    host: str
    pid: int
    started: str
    updated: str
    jobs: int

    def plain(self) -> dict[str, Any]:
        """Return all values as in the file, and `seconds_left`: remaining time [s], None while unknown."""
        return {**asdict(self), "seconds_left": self.seconds_left}


_RUNNING = TypeAdapter(Running)


def running(lab: LabFolder) -> list[Running]:
    """List the processes that work on studies in `lab` now, by their start.

    It writes nothing and never waits. Invalid files are skipped.
    """
    processes = []
    with suppress(OSError):  # nobody has published here
        for name in sorted(os.listdir(lab.live)):
            if name.endswith(_LOCK) and (process := _read_running(lab.live / name.removesuffix(_LOCK))):
                processes.append(process)
    return sorted(processes, key=lambda process: process.started)


def _read_running(path: Path) -> Running | None:
    try:
        if not is_locked(_with_suffix(path, _LOCK)):
            return None
        with open_file(_with_suffix(path, _FILE)) as file:
            content = file.read(_MAX_BYTES + 1)
        if len(content) > _MAX_BYTES:
            return None
        process = _RUNNING.validate_json(content)
    except (OSError, ValueError):
        return None
    return process if process.id == path.name else None


class Publisher:
    """Watcher that passes everything on to another one, and publishes the state it is shown.

    It publishes within a `with` statement, at the end of which its files are removed. Errors of writing are ignored: a
    full disk is reported when results are written.

    Args:
        lab: Folder of the lab.
        study: Name of the study.
        backend: Name of the backend.
        device: Device.
        watcher: Watcher to pass everything on to.
    """

    def __init__(self, lab: LabFolder, study: str, backend: str, device: str, watcher: Watcher):
        self._lab, self._watcher = lab, watcher
        host, pid = node(), os.getpid()
        host_part = re.sub(r"[^A-Za-z0-9.]", "_", host)[:60]
        # one process may run a study several times at once: they are told apart by the last part
        name = f"{study}-{host_part}-{pid}-{secrets.token_hex(2)}"
        self._path = lab.live / name
        self._identity = {"id": name, "study": study, "backend": backend, "device": device, "host": host, "pid": pid}
        self._claim: Claim | None = None
        self._open, self._next_time = False, float("-inf")

    def __enter__(self) -> "Publisher":
        self._open = True
        self._started = now()
        with suppress(OSError, LabError):
            _remove_stale(self._lab)
        return self

    def __exit__(self, *_) -> None:
        self._open = False
        if self._claim is not None:
            _remove_files(self._path, self._claim)
            self._claim = None

    def show(self, view: View) -> None:
        """Pass the state on, and publish it if a second has passed."""
        self._watcher.show(view)
        if self._open and time.monotonic() >= self._next_time:
            self._next_time = time.monotonic() + EVERY
            with suppress(OSError, LabError):
                self._publish(view)

    def tell(self, line: str) -> None:
        """Pass a line on."""
        self._watcher.tell(line)

    def _publish(self, view: View) -> None:
        if self._claim is None:
            self._lab.live.mkdir(exist_ok=True)
            self._claim = lock(_with_suffix(self._path, _LOCK), fcntl.LOCK_EX | fcntl.LOCK_NB)
        if self._claim is None:
            return  # somebody looks at the new file just now; there is a next time
        shortened = replace(view, going=view.going[:MAX_JOBS])
        process = Running(
            **vars(shortened), **self._identity, started=self._started, updated=now(), jobs=len(view.going)
        )
        # Not synchronised: after a crash nobody holds the lock, so nobody reads the file.
        write_bytes(_with_suffix(self._path, _FILE), to_json(process.plain()), durable=False)


def _remove_stale(lab: LabFolder) -> None:
    """Remove files of processes that were killed, or that could not remove them."""
    suffixes = (_PARTIAL, _FILE, _LOCK)  # the longest first
    for name in os.listdir(lab.live):
        stem = next((name.removesuffix(suffix) for suffix in suffixes if name.endswith(suffix)), "")
        if _ID.fullmatch(stem):  # what others put there is theirs
            path = lab.live / stem
            with suppress(OSError, LabError):
                if (claim := lock(_with_suffix(path, _LOCK), fcntl.LOCK_EX | fcntl.LOCK_NB)) is not None:
                    _remove_files(path, claim)


def _remove_files(path: Path, claim: Claim) -> None:
    """Remove the files of a runner whose lock is held, the lock last."""
    for suffix in (_FILE, _PARTIAL):
        remove(_with_suffix(path, suffix))
    with suppress(OSError):
        claim.release()


def _with_suffix(path: Path, suffix: str) -> Path:
    return path.with_name(path.name + suffix)
