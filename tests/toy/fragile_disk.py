"""A disk that fails, and a machine that loses its power, for tests of what is kept.

`Disk` sees every `open`, `write`, `fsync`, `rename`, `unlink`, `mkdir` and `rmdir` that Python code does below a
folder, one after another. It may fail the n-th of them, end the process before it, or note what a power failure would
leave. SQLite does its own: the index is no part of this, and can be made again.
"""

import io
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from threading import RLock

import pytest

State = tuple[tuple[str, bytes | None], ...]
"""Files with their content, and folders (None), by their path below a folder, in order."""


class Disk:
    """All that is done to files below `folder` while the context is entered.

    before: called with the number of each operation, from 1 on, its name and its path; it may raise. after: called
    with name, path and whether the operation made what is there now.
    """

    def __init__(
        self,
        folder: Path,
        before: Callable[[int, str, str], None] = lambda *_: None,
        after: Callable[[str, str, bool], None] = lambda *_: None,
    ):
        self._folder, self._before, self._after = str(folder), before, after
        self._lock, self._patch = RLock(), pytest.MonkeyPatch()
        self.operations: list[tuple[str, str]] = []

    def __enter__(self) -> "Disk":
        for name in ("open", "fsync", "rename", "replace", "unlink", "mkdir", "rmdir"):
            self._patch.setattr(os, name, getattr(self, f"_{name}")(getattr(os, name)))
        self._open_file, opened = io.open, self._opened
        self._patch.setattr("builtins.open", opened)
        self._patch.setattr(io, "open", opened)
        return self

    def __exit__(self, *_) -> None:
        self._patch.undo()

    def _holds(self, path: str | None) -> bool:
        return path is not None and path.startswith(self._folder) and "catalogue.db" not in path

    @contextmanager
    def operation(self, what: str, path: str, made: bool = False) -> Iterator[None]:
        """One operation on a path, whether or not it is below the folder."""
        if not self._holds(path):
            yield
            return
        with self._lock:
            self.operations.append((what, path))
            self._before(len(self.operations), what, path)
            yield
            self._after(what, path, made)

    def _opened(
        self, file, mode="r", buffering=-1, encoding=None, errors=None, newline=None, closefd=True, opener=None
    ):
        path = None if isinstance(file, int) else os.path.abspath(os.fspath(file))
        if not isinstance(path, str) or not self._holds(path):
            return self._open_file(file, mode, buffering, encoding, errors, newline, closefd, opener)
        writes = set(mode) & set("wax+")
        with self.operation("open", path, bool(writes) and not os.path.lexists(path)):
            raw = _File(path, mode.replace("b", "").replace("t", ""))
        raw.disk, raw.path = self, path
        kind = io.BufferedRandom if "+" in mode else io.BufferedWriter if writes else io.BufferedReader
        buffered = kind(raw)  # pyright: ignore[reportArgumentType]
        return buffered if "b" in mode else io.TextIOWrapper(buffered, encoding, errors, newline)

    def _open(self, call):
        def wrapped(path, flags, mode=0o777, *, dir_fd=None):
            place = _place(path, dir_fd)
            made = bool(flags & os.O_CREAT) and not os.path.lexists(place)
            with self.operation("open", place, made):
                return call(path, flags, mode, dir_fd=dir_fd)

        return wrapped

    def _fsync(self, call):
        def wrapped(handle):
            with self.operation("fsync", _of_handle(handle if isinstance(handle, int) else handle.fileno())):
                return call(handle)

        return wrapped

    def _rename(self, call):
        def wrapped(old, new, *, src_dir_fd=None, dst_dir_fd=None):
            with self.operation("rename", _place(new, dst_dir_fd)):
                return call(old, new, src_dir_fd=src_dir_fd, dst_dir_fd=dst_dir_fd)

        return wrapped

    _replace = _rename

    def _unlink(self, call):
        def wrapped(path, *, dir_fd=None):
            with self.operation("unlink", _place(path, dir_fd)):
                return call(path, dir_fd=dir_fd)

        return wrapped

    def _rmdir(self, call):
        def wrapped(path, *, dir_fd=None):
            with self.operation("rmdir", _place(path, dir_fd)):
                return call(path, dir_fd=dir_fd)

        return wrapped

    def _mkdir(self, call):
        def wrapped(path, mode=0o777, *, dir_fd=None):
            place = _place(path, dir_fd)
            with self.operation("mkdir", place, not os.path.lexists(place)):
                return call(path, mode, dir_fd=dir_fd)

        return wrapped


class _File(io.FileIO):
    disk: Disk
    path: str

    def write(self, data):
        with self.disk.operation("write", self.path):
            return super().write(data)


def _of_handle(handle: int) -> str:
    return os.readlink(f"/proc/self/fd/{handle}")


def _place(path, handle: int | None) -> str:
    path = os.fsdecode(path)
    return os.path.abspath(path) if handle is None else os.path.join(_of_handle(handle), path)


def failing(number: int, code: int) -> Callable[[int, str, str], None]:
    """The operation with this number fails, once, with this error."""

    def before(at: int, _: str, path: str) -> None:
        if at == number:
            raise OSError(code, os.strerror(code), path)

    return before


def ending(number: int) -> Callable[[int, str, str], None]:
    """The process ends before the operation with this number, as if it was killed."""

    def before(at: int, *_) -> None:
        if at == number:
            os._exit(KILLED)

    return before


KILLED = 137
"""Exit status of a process that `ending` has ended."""


@dataclass(eq=False)
class _Node:
    """A file or folder, as the disk has it: the content that was synced last, or the names."""

    content: bytes = b""
    names: "dict[str, _Node] | None" = None


@dataclass
class Crash:
    """What may be there after a failure, and what had been reported as finished before."""

    kind: str
    state: State
    reported: dict[str, float]
    number: int
    """Of operations before."""
    last: tuple[str, str]
    """The operation before."""

    def lay_out(self, folder: Path) -> None:
        """Make it a folder again."""
        folder.mkdir()
        for name, content in self.state:
            place = folder / name
            if content is None:
                place.mkdir()
            else:
                place.write_bytes(content)


@dataclass
class Platter:
    """What of `folder` a power failure leaves at each operation that a `Disk` tells of.

    `killed`: only the process ends; all is there. `unsynced data`: names are there, as journals of file systems have
    them, and of files that were not synced nothing. `unsynced names`: a name is there only if its folder was synced
    since, and the old name of what was moved only goes when that folder was synced: the strictest reading of POSIX.
    """

    folder: Path
    reported: dict[str, float] = field(default_factory=dict)
    crashes: list[Crash] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._known: set[tuple[State, tuple[tuple[str, float], ...]]] = set()
        self._nodes: dict[int, _Node] = {}
        self._count = 0
        self._root = self._read(str(self.folder))

    def _read(self, path: str) -> _Node:
        """What is there at the beginning is on the disk."""
        names = {entry.name: self._read(entry.path) for entry in _entries(path)} if os.path.isdir(path) else None
        node = _Node(b"" if names is not None else _content(path), names)
        self._nodes[os.stat(path).st_ino] = node
        return node

    def after(self, what: str, path: str, made: bool) -> None:
        """Take note of an operation."""
        self._count += 1
        inode = os.stat(path).st_ino if os.path.exists(path) else 0
        if made:
            self._nodes[inode] = _Node(names={} if what == "mkdir" else None)
        if what == "fsync":
            node = self._nodes[inode]
            if node.names is None:
                node.content = _content(path)
            else:
                node.names = {entry.name: self._nodes[entry.inode()] for entry in _entries(path)}
        states = {"killed": self._now(synced=False), "unsynced data": self._now(synced=True)}
        states["unsynced names"] = tuple(self._kept(self._root, ""))
        for kind, state in states.items():
            known = state, tuple(sorted(self.reported.items()))
            if known not in self._known:
                self._known.add(known)
                self.crashes.append(Crash(kind, state, dict(self.reported), self._count, (what, path)))

    def _now(self, *, synced: bool) -> State:
        found: list[tuple[str, bytes | None]] = []

        def look(path: str) -> None:
            for entry in _entries(path):
                name = os.path.relpath(entry.path, self.folder)
                if entry.is_dir():
                    found.append((name, None))
                    look(entry.path)
                else:
                    found.append((name, self._nodes[entry.inode()].content if synced else _content(entry.path)))

        look(str(self.folder))
        return tuple(sorted(found, key=lambda one: one[0]))

    def _kept(self, node: _Node, path: str) -> Iterator[tuple[str, bytes | None]]:
        for name, below in sorted((node.names or {}).items()):
            place = f"{path}/{name}".lstrip("/")
            yield place, None if below.names is not None else below.content
            yield from self._kept(below, place)


def _entries(path: str) -> list[os.DirEntry]:
    return [entry for entry in os.scandir(path) if not entry.name.startswith("catalogue.db")]


def _content(path: str) -> bytes:
    with io.FileIO(path) as file:
        return file.readall()
