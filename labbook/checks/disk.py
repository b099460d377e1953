"""Check that a folder can hold a lab: trials of its file system with two processes, and with two hosts.

All trials run in a hidden subfolder, which is removed. Two hosts meet there through files: the user starts the command
on both with the same folder, and each finds the other by a file that changes while its host waits.
"""

import fcntl
import json
import multiprocessing
import os
import secrets
import shutil
import sqlite3
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from platform import node

from labbook.commands import command
from labbook.lab.database import BUSY, keep_journal
from labbook.lab.folder import LabError, file_system, is_locked, is_network, lock, remove, sync_folder, write_bytes

PEERS = ".labbook-doctor"
"""Name of the folder in which two hosts meet."""
_ALONE = fcntl.LOCK_EX | fcntl.LOCK_NB
_SIZE = 2**16  # bytes of a file that is replaced while another process reads it
SPELL = 1.0  # s for which that goes on
STARTS = 60.0  # s that a process may take to start, or a step of the other host to be seen
_ROWS = 50  # that each of two hosts writes into one index
_LEAST = 10**8  # bytes that have to be free
_SKEW = 5.0  # s that clocks may differ by


class Unfit(Exception):
    """The folder lacks a property that labs need; the message names it."""


@dataclass(frozen=True)
class Check:
    """Result of one trial: its name, its success, and a note for the user."""

    name: str
    works: bool
    note: str


def examine(folder: Path, say: Callable[[str], None] = lambda _: None) -> list[Check]:
    """Try the file system of `folder` with processes of this host. Raises OSError if nothing can be written."""
    trial_folder = Path(tempfile.mkdtemp(prefix=f"{PEERS}-", dir=folder))
    try:
        return [perform(name, lambda check=check: check(trial_folder), say) for name, check in CHECKS.items()]
    finally:
        remove(trial_folder)


def meet(folder: Path, say: Callable[[str], None] = lambda _: None, patience: float = 600.0) -> list[Check]:
    """Try the file system of `folder` with this process and one that calls this function on another host.

    Args:
        folder: The folder, the same on both hosts.
        say: Receives one line of progress at a time.
        patience: Longest wait for the other host [s].

    Returns:
        One result for each trial.

    Raises:
        LabError: No other host came.
        OSError: Nothing can be written.
    """
    own = f"{node()}-{os.getpid()}-{secrets.token_hex(3)}"
    meeting = Meeting(folder / PEERS, own, say, patience)
    try:
        return [perform(name, lambda at=name: _STEPS[at](meeting.at(at)), say) for name in _STEPS]
    finally:
        meeting.leave()


def perform(name: str, check: Callable[[], str], say: Callable[[str], None]) -> Check:
    say(name)
    try:
        return Check(name, True, check())
    except (Unfit, LabError, OSError, sqlite3.Error) as problem:
        return Check(name, False, str(problem))


# one host


def free_space(folder: Path) -> str:
    free = shutil.disk_usage(folder).free
    kind = file_system(folder)
    text = f"{free / 1e9:.3g} GB are free on {kind or 'a file system of unknown type'}"
    if free < _LEAST:
        raise Unfit(f"{text}; make room, at least {_LEAST / 1e9:g} GB")
    return text + (", which other hosts may use too" if is_network(kind) else "")


def locks(folder: Path) -> str:
    path, ready = folder / "held.lock", folder / "ready"
    with _process(_hold, path, ready) as holder:
        _until(ready.exists, "a second process did not lock a file in time")
        claim = lock(path, _ALONE)
        if claim is not None:
            claim.release()
            raise Unfit("two processes held one lock at once: run one labbook at a time in this folder")
        if not is_locked(path):
            raise Unfit("the lock of another process is not seen")
        holder.kill()
        holder.join()
    began = time.monotonic()
    _until(lambda: not is_locked(path), "the lock of a killed process is never released")
    return f"one holder at a time; the lock of a killed process is released after {time.monotonic() - began:.2f} s"


def _hold(path: Path, ready: Path) -> None:
    claim = lock(path, _ALONE)
    if claim is not None:
        ready.touch()
        time.sleep(10 * STARTS)


def _renames(folder: Path) -> str:
    path = folder / "replaced"
    write_bytes(path, bytes(_SIZE))
    with _process(_replace, path, SPELL) as writer:
        observation = read_while(path, writer.is_alive)
    if writer.exitcode != 0:
        raise Unfit("a second process could not replace a file")
    return observation


def _replace(path: Path, seconds: float) -> None:
    end, number = time.monotonic() + seconds, 0
    while time.monotonic() < end:
        number += 1
        write_bytes(path, bytes([number % 256]) * _SIZE, durable=False)


def read_while(path: Path, going: Callable[[], bool]) -> str:
    """Read a file that is replaced again and again. Raises Unfit if it is ever missing, or incomplete."""
    read, contents = 0, set[int]()
    while going():
        try:
            content = path.read_bytes()
        except FileNotFoundError as error:
            raise Unfit("a file that is replaced is missing for a moment: rename is not atomic") from error
        if len(content) != _SIZE or len(set(content)) != 1:
            raise Unfit("a file that is replaced is seen half old, half new: rename is not atomic")
        read += 1
        contents.add(content[0])
    if len(contents) < 2:
        raise Unfit(f"a file that another process replaced looked unchanged, in {read} looks")
    return f"{read} looks at a file that is replaced all the time found it whole"


def syncs(folder: Path) -> str:
    times = []
    for number in range(10):
        began = time.perf_counter()
        write_bytes(folder / f"synced-{number}", bytes(4096))
        sync_folder(folder)
        times.append(time.perf_counter() - began)
    return f"{sorted(times)[len(times) // 2] * 1e3:.2g} ms to write a small file and its name to the disk"


def clock(folder: Path) -> str:
    skew = clock_skew(folder / "clock")
    text = f"the file system's clock is {abs(skew):.3g} s {'ahead' if skew > 0 else 'behind'}"
    if abs(skew) > _SKEW:
        raise Unfit(f"{text}; set the clocks (NTP), or times of runs are out of order")
    return text


def clock_skew(path: Path) -> float:
    """Measure by how much the clock that stamps files is ahead of this host's [s]; writes `path`."""
    before = time.time()
    path.write_bytes(b"now")
    return path.stat().st_mtime - (before + time.time()) / 2


def index(folder: Path) -> str:
    with closing(_database(folder / "index.db")) as connection:
        mode = keep_journal(connection, folder / "index.db")
        connection.execute("CREATE TABLE numbers (value INTEGER)")
        connection.executemany("INSERT INTO numbers VALUES (?)", [(n,) for n in range(_ROWS)])
    return f"SQLite {sqlite3.sqlite_version}, {_count_rows(folder / 'index.db', _ROWS)}, journal mode {mode}"


def _database(path: Path) -> sqlite3.Connection:
    return sqlite3.connect(path, timeout=BUSY, isolation_level=None)


def _count_rows(path: Path, rows: int) -> str:
    with closing(_database(path)) as connection:
        count = connection.execute("SELECT count(*) FROM numbers").fetchone()[0]
        integrity = connection.execute("PRAGMA integrity_check").fetchone()[0]
    if (count, integrity) != (rows, "ok"):
        raise Unfit(f"the index has {count} of {rows} rows; SQLite says: {integrity}")
    return f"{rows} rows written and read"


CHECKS: dict[str, Callable[[Path], str]] = {
    "free space": free_space,
    "locks": locks,
    "atomic rename": _renames,
    "fsync": syncs,
    "clock": clock,
    "index": index,
}


@contextmanager
def _process(target: Callable[..., None], *arguments: object) -> Iterator[multiprocessing.Process]:
    """Run a function in another process of this host; kill it at the end if it still runs."""
    process = multiprocessing.get_context("spawn").Process(target=target, args=arguments, daemon=True)
    process.start()
    try:
        yield process  # pyright: ignore[reportReturnType]
        process.join(STARTS)
    finally:
        process.kill()
        process.join()


def _until(condition: Callable[[], bool], message: str, patience: float | None = None) -> None:
    """Wait for a condition, for `patience` [s] (None: STARTS). Raises Unfit with `message` if it stays false."""
    end = time.monotonic() + (STARTS if patience is None else patience)
    while not condition():
        if time.monotonic() > end:
            raise Unfit(message)
        time.sleep(0.02)


# two hosts


class Meeting:
    """Rendezvous of this process and one on another host in one folder: both do the same steps, in lockstep.

    Args:
        folder: Folder of the rendezvous.
        own: Name of this process, unique among hosts.
        say: Receives one line of progress at a time.
        patience: Longest wait for the other process [s].

    Raises:
        LabError: No other process came.
    """

    def __init__(self, folder: Path, own: str, say: Callable[[str], None], patience: float):
        self._folder, self._own = folder, own
        folder.mkdir(exist_ok=True)
        self.peer = self._find(say, patience)
        self.first = own < self.peer
        """True in exactly one of the two processes."""
        self.folder = folder / "-and-".join(sorted((own, self.peer)))
        self.folder.mkdir(exist_ok=True)
        self._step, self._swaps = "", 0

    def _find(self, say: Callable[[str], None], patience: float) -> str:
        """Wait for the other process and return its name: that of a file whose content changes meanwhile."""
        shown_command = command("doctor", lab=self._folder.parent)
        say(f"waiting for the same command, with --peer, on another host: {shown_command}")
        before, end, number = self._there(), time.monotonic() + patience, 0
        while time.monotonic() < end:
            number += 1
            write_bytes(self._folder / f"{self._own}.here", str(number).encode(), durable=False)
            time.sleep(0.2)
            for name, content in self._there().items():
                if name != self._own and content != before.get(name):
                    for _ in range(3):  # once more, for the other one to see
                        number += 1
                        write_bytes(self._folder / f"{self._own}.here", str(number).encode(), durable=False)
                        time.sleep(0.3)
                    return name
        remove(self._folder / f"{self._own}.here")
        raise LabError(f"{self._folder.parent}: no other labbook doctor --peer came within {patience:g} s")

    def _there(self) -> dict[str, bytes]:
        """Contents of the `.here` files of all processes, by name of process; its own is among them."""
        contents = {}
        for name in os.listdir(self._folder):
            if name.endswith(".here"):
                try:
                    contents[name.removesuffix(".here")] = (self._folder / name).read_bytes()
                except OSError:  # it just left
                    continue
        return contents

    def at(self, step: str) -> "Meeting":
        """Begin a step, also if another one was given up before."""
        self._step, self._swaps = step.replace(" ", "-"), 0
        return self

    def swap(self, message: object = None) -> object:
        """Synchronise with the other process: send it a message, wait for its message, and return that."""
        self._swaps += 1
        mine, theirs = (self.folder / f"{self._step}-{self._swaps}-{name}" for name in (self._own, self.peer))
        write_bytes(mine, json.dumps(message).encode())
        _until(
            lambda: theirs.name in os.listdir(self.folder),
            f"{self.peer} stopped answering; start both again",
        )
        return json.loads(theirs.read_bytes())

    def leave(self) -> None:
        """Remove this process's files of the rendezvous."""
        remove(self._folder / f"{self._own}.here")
        if not self.first:
            with suppress(Unfit):
                _until(lambda: not (self._folder / f"{self.peer}.here").exists(), "it stays", 5.0)
            remove(self.folder)
            with suppress(OSError):  # others meet there
                self._folder.rmdir()


def _hosts(meeting: Meeting) -> str:
    peer_host = meeting.swap(node())
    if peer_host == node():
        return f"both on {node()}: this tests two processes, not two hosts"
    return f"{node()} and {peer_host}"


def _shared_locks(meeting: Meeting) -> str:
    path, wrong = meeting.folder / "held.lock", ""
    for holds in (meeting.first, not meeting.first):
        claim = lock(path, _ALONE) if holds else None
        if holds and claim is None:
            wrong = "a free lock cannot be taken"
        meeting.swap()
        if not holds:
            if not is_locked(path):
                wrong = "the lock of the other host is not seen"
            elif (second := lock(path, _ALONE)) is not None:
                second.release()
                wrong = "two hosts held one lock at once"
        meeting.swap()
        if claim is not None:
            claim.release()
        meeting.swap()
    theirs = meeting.swap(wrong)
    if wrong or theirs:
        raise Unfit(f"{wrong or theirs}: use this lab on one host only, and copy runs of others with labbook import")
    return "one holder at a time, on two hosts"


def _shared_renames(meeting: Meeting) -> str:
    path, outcomes = meeting.folder / "replaced", []
    write_bytes(path, bytes(_SIZE)) if meeting.first else None
    meeting.swap()
    for writes in (meeting.first, not meeting.first):
        if writes:
            _replace(path, 3 * SPELL)
        else:
            end = time.monotonic() + 2 * SPELL
            try:
                outcomes.append(read_while(path, lambda end=end: time.monotonic() < end))
            except Unfit as problem:
                outcomes.append(problem)
        meeting.swap()
    (outcome,) = outcomes
    theirs = meeting.swap(str(outcome) if isinstance(outcome, Unfit) else "")
    if isinstance(outcome, Unfit) or theirs:
        raise Unfit(str(outcome) if isinstance(outcome, Unfit) else str(theirs))
    return str(outcome)


def _shared_clock(meeting: Meeting) -> str:
    mine = clock_skew(meeting.folder / f"clock-{node()}-{os.getpid()}")
    theirs = meeting.swap(mine)
    assert isinstance(theirs, float)
    apart = abs(mine - theirs)
    if apart > _SKEW:
        raise Unfit(f"the clocks of the hosts differ by {apart:.3g} s; set them (NTP)")
    return f"the clocks of the hosts differ by {apart:.3g} s"


def _shared_index(meeting: Meeting) -> str:
    path = meeting.folder / "index.db"
    if meeting.first:
        with closing(_database(path)) as connection:
            keep_journal(connection, path)
            connection.execute("CREATE TABLE numbers (value INTEGER)")
    meeting.swap()
    with closing(_database(path)) as connection:
        mode = keep_journal(connection, path)
        for number in range(_ROWS):
            connection.execute("INSERT INTO numbers VALUES (?)", (number,))
    meeting.swap()
    rows = _count_rows(path, 2 * _ROWS)
    return f"{rows} by two hosts at once, journal mode {mode}"


_STEPS: dict[str, Callable[[Meeting], str]] = {
    "hosts": _hosts,
    "locks of two hosts": _shared_locks,
    "rename seen by another host": _shared_renames,
    "clocks of two hosts": _shared_clock,
    "index of two hosts": _shared_index,
}
