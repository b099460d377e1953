"""The lab folder: where runs, packings and unfinished work lie, who may work on what, and how files get there whole.

| path                      | holds                                                                    |
|---------------------------|--------------------------------------------------------------------------|
| lab/runs/KEY/             | a finished run, put in place by one rename                               |
| lab/packings/KEY/         | a settled packing, put in place by one rename                            |
| lab/study-files/NAME.yaml | the text of the study NAME as it was last run, and beside it its own      |
|                           | calibration, if it has one, and the list of the files that it names      |
| lab/attached/SHA256       | the content of such a file, by its hash                                  |
| lab/campaigns/NAME-KEY.json | what a strategy has proposed for the study NAME, and why                |
| lab/notes/studies/        | notes and tags that people gave to studies, NAME.md                      |
| lab/notes/runs/           | the same of runs, KEY.md                                                 |
| lab/work/KEY/             | unfinished work on a run or packing, with its exact checkpoints          |
| lab/work/KEY.lock         | held by the process that works on KEY                                    |
| lab/work/KEY.look         | held by the process that evaluates the run KEY, or writes the file KEY   |
| lab/live/ID.json          | where a process that works on a study stands just now                    |
| lab/live/ID.lock          | held by that process                                                     |
| lab/catalogue.db          | an index of runs, packings and measured numbers, which can be made again |
| lab/catalogue.db.new      | the next one, while it is made                                           |
| lab/catalogue.url         | in place of it: where the index is, if that is on a server               |
"""

import errno
import fcntl
import hashlib
import os
import random
import re
import shutil
import stat
import time
from collections.abc import Iterator, Set
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from labbook.scene import attached

DEFAULT = Path("lab")
EVALUATION = "measured-"
"""How files begin that hold what was evaluated of a run: they can be made again from the others."""
PICTURE = "picture.png"
"""The file of a run that shows its bed: nothing is measured in it, and a run without it is whole."""
LINK = "it is a link, or lies in one; labbook follows no links within a lab"
_FULL = (errno.ENOSPC, errno.EDQUOT)
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)
_NETWORK = frozenset(
    (
        *("nfs", "nfs4", "cifs", "smb3", "smbfs", "lustre", "gpfs", "beegfs", "ceph", "glusterfs", "orangefs"),
        *("pvfs2", "panfs", "afs", "9p", "virtiofs", "wekafs", "vboxsf"),
    )
)
_TRIES = 200  # to lock a file that others look at, or remove, at the same moment
_PAUSE = 0.005  # s, at most, between two of them


class LabError(Exception):
    """A lab cannot be read or written; the message says why and what to do."""


class DiskFull(LabError):
    """No room is left; the message says where and what to do."""

    def __init__(self, path: Path):
        super().__init__(
            f"no room is left on the disk of {path}: finished runs and the last checkpoints are safe; "
            "free some space and give the same command again"
        )
        self.path = path

    def __reduce__(self):
        return DiskFull, (self.path,)  # else it would be made again from its message


class NoLocks(LabError):
    """Files in a folder cannot be locked; the message says where and what to do."""

    def __init__(self, folder: Path, error: OSError):
        super().__init__(
            f"{folder}: files there cannot be locked ({error.strerror}), and nothing would keep two processes from the "
            "same work; use a lab on a local disk and copy runs there with labbook import, or have the file system "
            "mounted with locks (NFS: with its lock service, Lustre: with the option flock)"
        )


@contextmanager
def room(path: Path) -> Iterator[None]:
    """Turns the error of a full disk (or quota) within into DiskFull, naming `path`."""
    try:
        yield
    except OSError as error:
        if is_full(error):
            raise DiskFull(path) from error
        raise


def is_full(error: OSError) -> bool:
    """Whether an error says that the disk, or the user's part of it, is full."""
    return error.errno in _FULL


class Claim:
    """The sole right to work on a key, until it is released or its process ends in whatever way."""

    def __init__(self, path: Path, handle: int):
        self._path, self._handle = path, handle

    def release(self) -> None:
        """Give the key back. The lock file goes first, while it is still held; one that cannot be removed holds
        nothing."""
        try:
            with suppress(OSError):
                os.unlink(self._path)
        finally:
            os.close(self._handle)


def lock(path: Path, how: int) -> Claim | None:
    """A lock on a file, which is made if it is missing; None if it is not to be waited for and another has it.

    Raises LabError where files cannot be locked, and OSError.
    """
    lost: OSError | None = None
    for _ in range(_TRIES):
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        claim = None
        try:
            fcntl.flock(handle, how)
            # Between opening and locking the file may have been removed: a lock on it then holds nothing.
            if os.stat(path).st_ino == os.fstat(handle).st_ino:
                claim = Claim(path, handle)
                return claim
        except BlockingIOError:
            if not _is_only_looked_at(handle):
                return None
            lost = None
        except OSError as error:
            if error.errno in _NO_LOCKS:
                raise NoLocks(path.parent, error) from error
            if error.errno not in (errno.ENOENT, errno.ESTALE):  # removed, by this host or by another one
                raise
            lost = error
        finally:
            if claim is None:
                os.close(handle)
        time.sleep(random.uniform(0.1, 1.0) * _PAUSE)
    if lost is not None:
        raise NoLocks(path.parent, lost)
    return None


def _is_only_looked_at(handle: int) -> bool:
    """Whether only `is_locked` of other processes keeps a file from being locked, for a moment."""
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def is_locked(path: Path) -> bool:
    """Whether some process holds the lock of a file; looking neither waits for it nor disturbs it. Where files cannot
    be locked nobody holds one."""
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except FileNotFoundError:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError as error:
        if error.errno not in (*_NO_LOCKS, errno.ESTALE):
            raise
    finally:
        os.close(handle)
    return False


class LabFolder:
    """Paths below one lab folder; nothing is made before something is written."""

    def __init__(self, folder: Path):
        self.folder = Path(folder)
        self.runs = self.folder / "runs"
        self.packings = self.folder / "packings"
        self.works = self.folder / "work"
        self.studies = self.folder / "study-files"
        self.attached = self.folder / "attached"
        self.campaigns = self.folder / "campaigns"
        self.notes = self.folder / "notes"
        self.live = self.folder / "live"
        self.catalogue = self.folder / "catalogue.db"
        self.server = self.folder / "catalogue.url"
        attached.search(self.attached)

    @property
    def exists(self) -> bool:
        """Whether the folder is a lab: whether any part of one is there that no other folder has. Folders called
        `studies` and `notes` are common."""
        return any(path.exists() for path in (self.runs, self.packings, self.works, self.catalogue, self.server))

    def run(self, key: str) -> Path:
        """Folder of the finished run `key`."""
        return self.runs / key

    def packing(self, key: str) -> Path:
        """Folder of the packing `key`."""
        return self.packings / key

    def work(self, key: str) -> Path:
        """Folder of unfinished work on `key`."""
        return self.works / key

    def claim(self, key: str) -> Claim | None:
        """The right to work on `key`, or None while another process has it."""
        make_folder(self.works)
        return lock(self.works / f"{key}.lock", fcntl.LOCK_EX | fcntl.LOCK_NB)

    @contextmanager
    def alone(self, key: str) -> Iterator[None]:
        """Waits until no other process or thread is within for the same `key`, and keeps others waiting: to evaluate
        the run `key`, or to write a file that several may write at once.

        In a lab that cannot be written to nothing is locked: nothing is kept there either.
        """
        path = self.works / f"{key}.look"
        try:
            make_folder(self.works)
            claim = lock(path, fcntl.LOCK_EX)
            assert claim is not None
        except OSError as error:
            if error.errno not in (errno.EROFS, errno.EACCES, errno.EPERM):
                raise
            yield
            return
        try:
            yield
        finally:
            claim.release()

    def sweep(self, key: str) -> None:
        """Remove the lock file of `alone` for `key`, if nobody holds it: it could not be removed when it was left."""
        path = self.works / f"{key}.look"
        with suppress(OSError):
            if path.exists() and (claim := lock(path, fcntl.LOCK_EX | fcntl.LOCK_NB)):
                claim.release()

    def held(self, key: str) -> bool:
        """Whether some process is working on `key`; looking does not disturb it."""
        return is_locked(self.works / f"{key}.lock")

    def working(self) -> list[str]:
        """Keys with unfinished work."""
        return folders(self.works)

    def touched(self) -> set[str]:
        """Keys of which anything lies in the work folder: unfinished work, or a lock file whose process was killed."""
        try:
            return {name.removesuffix(".lock").removesuffix(".look") for name in os.listdir(self.works)}
        except FileNotFoundError:
            return set()

    def put(self, made: Path, place: Path) -> None:
        """Put the complete folder `made` in `place`; an older one there is replaced.

        `made` lies in the work folder of its key, whose claim is held; its files are synchronised here. A kill between
        moving the old folder out and the new one in is mended by `mend`. Both have their names on the disk before
        either moves, so that a power failure leaves one of them at least.
        """
        work = made.parent
        _sync_tree(made)
        make_folder(place.parent)
        replaces = os.path.lexists(place)
        if replaces:
            replaced = work / "replaced"
            remove(replaced)  # left by a process that was killed after it had put its own folder in place
            sync_folder(work.parent)
            sync_folder(work)
            os.rename(place, replaced)
            sync_folder(work)
        os.rename(made, place)
        sync_folder(place.parent)
        if replaces:
            sync_folder(work)

    def replaced(self, key: str) -> Path:
        """Where the older run or packing `key` is while another one is put in its place."""
        return self.work(key) / "replaced"

    def is_torn(self, key: str, place: Path) -> bool:
        """Whether a kill within `put` has left `place` empty."""
        return self.replaced(key).exists() and not place.exists()

    def mend(self, key: str, place: Path) -> None:
        """Finish or undo what a kill interrupted within `put`; the claim of `key` is held."""
        if self.is_torn(key, place):
            make_folder(place.parent)
            os.rename(self.replaced(key), place)
            sync_folder(place.parent)
            self.drop_empty(key)

    def drop_empty(self, key: str) -> None:
        """Remove the work folder of `key`, whose claim is held, if nothing is in it."""
        with suppress(OSError):
            os.rmdir(self.work(key))

    def clear(self, key: str) -> None:
        """Remove the unfinished work on `key`, whose claim is held."""
        remove(self.work(key))


@dataclass(frozen=True)
class LabListing:
    """Keys of all finished runs and packings, and of unfinished work, as they lay in a lab at one moment."""

    runs: Set[str]
    packings: Set[str]
    work: Set[str]

    @classmethod
    def of(cls, lab: LabFolder) -> "LabListing":
        """What lies in `lab` now."""
        return cls(*({*folders(place)} for place in (lab.runs, lab.packings, lab.works)))


def folders(parent: Path) -> list[str]:
    """Names of the folders in `parent`, and of links, in their order; hidden ones, which other programs put there, are
    left out."""
    try:
        found = [entry for entry in os.scandir(parent) if entry.is_symlink() or entry.is_dir()]
        return sorted(entry.name for entry in found if not entry.name.startswith("."))
    except FileNotFoundError:
        return []


def stamp(folder: Path) -> int:
    """A number that changes when a file in `folder` comes, goes, or is written to: a hash of names, sizes and times.

    What is beside a run's data is left out: it may come at any time. 0 if the folder is not there, or is a link.
    """
    try:
        if folder.is_symlink():
            return 0
        entries = (entry for entry in os.scandir(folder) if not is_beside(entry.name))
        found = [(entry.name, entry.stat(follow_symlinks=False)) for entry in entries]
    except (FileNotFoundError, NotADirectoryError):
        return 0
    files = sorted((name, status.st_mode, status.st_size, status.st_mtime_ns) for name, status in found)
    return int.from_bytes(hashlib.blake2b(repr(files).encode(), digest_size=7).digest(), "big")


def is_beside(name: str) -> bool:
    """Whether the file `name` of a run is no part of its data: what was evaluated of it, and its picture."""
    return name.startswith(EVALUATION) or name == PICTURE


def file_system(path: Path, mounts: Path = Path("/proc/self/mountinfo")) -> str:
    """Type of the file system that `path` is on, such as ext4 or nfs4; empty where nobody tells.

    mounts: the kernel's list of what is mounted (proc(5)).
    """
    try:
        lines = mounts.read_text(errors="surrogateescape").splitlines()
    except OSError:
        return ""
    place, found = Path(path).resolve(), ("", "")
    for line in lines:
        head, _, tail = line.partition(" - ")
        if not tail or len(head.split(" ")) < 5:
            continue
        on = re.sub(r"\\([0-7]{3})", lambda octal: chr(int(octal[1], 8)), head.split(" ")[4])
        if place.is_relative_to(on) and len(on) >= len(found[0]):  # of two on one place the later one is seen
            found = on, tail.split(" ")[0]
    return found[1]


def is_network(kind: str) -> bool:
    """Whether several hosts may have a file system of this type at once."""
    return kind in _NETWORK or kind.startswith("fuse")


def open_file(path: Path) -> BinaryIO:
    """Open a file of a lab to read. Raises OSError, also for what is no ordinary file: reading a pipe would wait for
    ever. A file that is a link, or whose folder is one, may be any file of the user: a lab that came from elsewhere
    could show it."""
    if path.is_symlink() or path.parent.is_symlink():
        raise OSError(errno.ELOOP, LINK, str(path))
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW)
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise OSError(errno.EINVAL, "not an ordinary file", str(path))
    return os.fdopen(handle, "rb")


def remove(path: Path) -> None:
    """Remove a file, a link or a folder with all that is in it; whatever cannot be removed stays."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink()


def write_bytes(path: Path, content: bytes, *, durable: bool = True) -> None:
    """Write `path` as a whole: readers see the old content or the new and, if `durable`, also after a crash."""
    part = path.with_name(path.name + ".part")
    try:
        with open(part, "wb") as file:
            file.write(content)
            file.flush()
            if durable:
                os.fsync(file.fileno())
        os.replace(part, path)
    except OSError as error:
        error.filename = error.filename or str(path)
        with suppress(OSError):
            part.unlink()
        raise


def make_folder(folder: Path) -> None:
    """Make a folder, and those above it that are missing, durably; it may be there."""
    if folder.is_dir():
        return
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    for made in reversed(missing):
        sync_folder(made.parent)


def sync_folder(folder: Path) -> None:
    """Make the names in `folder` durable."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _sync_tree(folder: Path) -> None:
    for entry in os.scandir(folder):
        with open(entry.path, "rb") as file:
            os.fsync(file.fileno())
    sync_folder(folder)
