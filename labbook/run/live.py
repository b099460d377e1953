"""Progress for other processes: what runners are at just now, as files in `lab/live` that anybody may read.

A runner holds the lock of `ID.lock` for as long as it works, and writes its View to `ID.json` beside it, at most once a
second. A process that is killed in whatever way frees its lock: it is no longer among the running ones from then on,
and the next runner removes its files.
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
"""Wall time between two files [s], at least."""
MOST_JOBS = 50
"""Jobs that are published one by one: a GPU may have thousands."""
_LARGEST = 1_000_000  # bytes of a file that is read
_ID = re.compile(r"[A-Za-z0-9_-]+-[A-Za-z0-9._]*-\d+-[0-9a-f]{4}")
_FILE, _PART, _LOCK = ".json", ".json.part", ".lock"


@dataclass(frozen=True, kw_only=True)
class Running(View):
    """A process that works on a study, with the View that it published last; of `going` the first jobs."""

    __pydantic_config__: ClassVar = ConfigDict(strict=True, allow_inf_nan=False)

    format: Literal[1] = 1
    """Version of the schema of the file."""
    id: str
    study: str
    backend: str
    device: str
    host: str
    pid: int
    started: str
    """When its work began (UTC, ISO 8601)."""
    updated: str
    """When this was published (UTC, ISO 8601)."""
    jobs: int
    """How many are going on, also those that `going` leaves out."""

    def plain(self) -> dict[str, Any]:
        """All of it as plain values, as its file has it; with the time that is left [s], None while not known."""
        return {**asdict(self), "seconds_left": self.seconds_left}


_RUNNING = TypeAdapter(Running)


def running(lab: LabFolder) -> list[Running]:
    """The processes that work on studies in `lab` just now, by the beginning of their work.

    Looking writes nothing and waits for nobody. Files that are not as a runner writes them are left out.
    """
    found = []
    with suppress(OSError):  # nobody has published here
        for name in sorted(os.listdir(lab.live)):
            if name.endswith(_LOCK) and (one := _read(lab.live / name.removesuffix(_LOCK))):
                found.append(one)
    return sorted(found, key=lambda one: one.started)


def _read(place: Path) -> Running | None:
    try:
        if not is_locked(_beside(place, _LOCK)):
            return None
        with open_file(_beside(place, _FILE)) as file:
            content = file.read(_LARGEST + 1)
        if len(content) > _LARGEST:
            return None
        found = _RUNNING.validate_json(content)
    except (OSError, ValueError):
        return None
    return found if found.id == place.name else None


class Publisher:
    """A watcher that passes everything on to another one, and publishes beside it what it is shown.

    It publishes within a `with` statement, at the end of which its files are removed. What cannot be written is not
    published, and stops nothing: a disk that is full is noticed by who writes results.
    """

    def __init__(self, lab: LabFolder, study: str, backend: str, device: str, to: Watcher):
        self._lab, self._to = lab, to
        host, pid = node(), os.getpid()
        safe = re.sub(r"[^A-Za-z0-9.]", "_", host)[:60]
        # one process may run a study several times at once: they are told apart by the last part
        name = f"{study}-{safe}-{pid}-{secrets.token_hex(2)}"
        self._place = lab.live / name
        self._told = {"id": name, "study": study, "backend": backend, "device": device, "host": host, "pid": pid}
        self._claim: Claim | None = None
        self._open, self._next = False, float("-inf")

    def __enter__(self) -> "Publisher":
        self._open = True
        self._started = now()
        with suppress(OSError, LabError):
            _sweep(self._lab)
        return self

    def __exit__(self, *_) -> None:
        self._open = False
        if self._claim is not None:
            _clear(self._place, self._claim)
            self._claim = None

    def show(self, view: View) -> None:
        """Pass on where things stand, and publish it if a second has gone by."""
        self._to.show(view)
        if self._open and time.monotonic() >= self._next:
            self._next = time.monotonic() + EVERY
            with suppress(OSError, LabError):
                self._publish(view)

    def tell(self, line: str) -> None:
        """Pass on a line."""
        self._to.tell(line)

    def _publish(self, view: View) -> None:
        if self._claim is None:
            self._lab.live.mkdir(exist_ok=True)
            self._claim = lock(_beside(self._place, _LOCK), fcntl.LOCK_EX | fcntl.LOCK_NB)
        if self._claim is None:
            return  # somebody looks at the new file just now; there is a next time
        some = replace(view, going=view.going[:MOST_JOBS])
        one = Running(**vars(some), **self._told, started=self._started, updated=now(), jobs=len(view.going))
        write_bytes(_beside(self._place, _FILE), to_json(one.plain()), durable=False)


def _sweep(lab: LabFolder) -> None:
    """Remove the files of processes that were killed, or that could not remove them."""
    suffixes = (_PART, _FILE, _LOCK)  # the longest first
    for name in os.listdir(lab.live):
        own = next((name.removesuffix(suffix) for suffix in suffixes if name.endswith(suffix)), "")
        if _ID.fullmatch(own):  # what others put there is theirs
            place = lab.live / own
            with suppress(OSError, LabError):
                if (claim := lock(_beside(place, _LOCK), fcntl.LOCK_EX | fcntl.LOCK_NB)) is not None:
                    _clear(place, claim)


def _clear(place: Path, claim: Claim) -> None:
    """Remove the files of a runner whose lock is held, and the lock last."""
    for suffix in (_FILE, _PART):
        remove(_beside(place, suffix))
    with suppress(OSError):
        claim.release()


def _beside(place: Path, suffix: str) -> Path:
    return place.with_name(place.name + suffix)
