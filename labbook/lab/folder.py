"""The lab folder: its layout, claims on keys, and atomic writes.

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
"""Prefix of files with evaluations of a run: they can be made again from its other files."""
PICTURE = "picture.png"
"""File name of the picture of a run's bed. A run without it is complete."""
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
    """The disk is full; the message says where and what to do."""

    def __init__(self, path: Path):
        super().__init__(
            f"no room is left on the disk of {path}: finished runs and the last checkpoints are safe; "
            "free some space and give the same command again"
        )
        self.path = path

    def __reduce__(self):
        return DiskFull, (self.path,)  # else it would be made again from its message


class NoLocks(LabError):
    """Files in a folder cannot be locked; the message names the folder and the remedy."""

    def __init__(self, folder: Path, error: OSError):
        super().__init__(
            f"{folder}: files there cannot be locked ({error.strerror}), and nothing would keep two processes from the "
            "same work; use a lab on a local disk and copy runs there with labbook import, or have the file system "
            "mounted with locks (NFS: with its lock service, Lustre: with the option flock)"
        )


@contextmanager
def room(path: Path) -> Iterator[None]:
    """Raise DiskFull, naming `path`, for the error of a full disk or quota within the context."""
    try:
        yield
    except OSError as error:
        if is_full(error):
            raise DiskFull(path) from error
        raise


def is_full(error: OSError) -> bool:
    """Decide whether an error means that the disk, or the user's quota, is full."""
    return error.errno in _FULL


class Claim:
    """The exclusive right to work on a key: a locked file. It ends with `release`, or with its process."""

    def __init__(self, path: Path, handle: int):
        self._path, self._handle = path, handle

    def release(self) -> None:
        """Release the key; again, without effect: a failure may release what its job releases too.

        The file is removed before it is unlocked: removed later, it could be the file that another process has just
        locked. A file that cannot be removed locks nothing.
        """
        handle, self._handle = self._handle, -1
        if handle < 0:
            return  # another file may have the number of the handle by now
        try:
            with suppress(OSError):
                os.unlink(self._path)
        finally:
            os.close(handle)  # closing frees the lock; a killed process frees its locks in the same way


def lock(path: Path, operation: int) -> Claim | None:
    """Lock a file, which is made if it is missing.

    Args:
        path: File to lock.
        operation: Operation of `fcntl.flock`: LOCK_EX, with LOCK_NB not to wait.

    Returns:
        The lock; None if another process has it and `operation` does not wait.

    Raises:
        NoLocks: The file system does not support locks.
        OSError: The file cannot be opened.
    """
    last_error: OSError | None = None
    for _ in range(_TRIES):
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        claim = None
        try:
            fcntl.flock(handle, operation)
            # Between opening and locking the file may have been removed: a lock on it then holds nothing.
            if os.stat(path).st_ino == os.fstat(handle).st_ino:
                claim = Claim(path, handle)
                return claim
        except BlockingIOError:
            # `is_locked` takes a shared lock for a moment: a claim must not fail because somebody asked for its state.
            if not _is_only_looked_at(handle):
                return None
            last_error = None
        except OSError as error:
            if error.errno in _NO_LOCKS:
                raise NoLocks(path.parent, error) from error
            if error.errno not in (errno.ENOENT, errno.ESTALE):  # removed, by this host or by another one
                raise
            last_error = error
        finally:
            if claim is None:
                os.close(handle)
        time.sleep(random.uniform(0.1, 1.0) * _PAUSE)  # at random: two processes must not collide again and again
    if last_error is not None:
        raise NoLocks(path.parent, last_error)
    return None


def _is_only_looked_at(handle: int) -> bool:
    """Decide whether only `is_locked` of another process keeps a file from being locked, for a moment."""
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def is_locked(path: Path) -> bool:
    """Check whether a process holds the lock of a file, without waiting and without disturbing it.

    Where files cannot be locked the answer is False.
    """
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except FileNotFoundError:
        return False
    try:
        # A shared lock: several observers do not block each other, and the owner's exclusive lock blocks them all.
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
    """Paths and locks of one lab folder. Nothing is created before something is written.

    Args:
        folder: Path of the lab; it may be missing.
    """

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
        attached.search(self.attached)  # models that name a file by its hash find the content in this lab

    @property
    def exists(self) -> bool:
        """True if the folder is a lab: it has a part that no other folder has. Folders called `studies` and `notes` are
        common."""
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
        """Claim the right to work on `key`; None while another process has it."""
        make_folder(self.works)
        return lock(self.works / f"{key}.lock", fcntl.LOCK_EX | fcntl.LOCK_NB)

    @contextmanager
    def alone(self, key: str) -> Iterator[None]:
        """Hold a lock for `key`: wait for the process or thread that has it, and make others wait.

        It protects the evaluations of the run `key`, or a file that several processes may write. It differs from the
        claim of `key`, with which a run is computed. In a lab that cannot be written to nothing is locked, and nothing
        is stored either.
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
        """Remove the lock file of `alone` for `key`, if no process holds it: a lock file stays where it could not be
        removed."""
        path = self.works / f"{key}.look"
        with suppress(OSError):
            if path.exists() and (claim := lock(path, fcntl.LOCK_EX | fcntl.LOCK_NB)):
                claim.release()

    def is_claimed(self, key: str) -> bool:
        """Check whether a process works on `key`, without disturbing it."""
        return is_locked(self.works / f"{key}.lock")

    def working(self) -> list[str]:
        """Keys with unfinished work."""
        return folders(self.works)

    def touched(self) -> set[str]:
        """Keys with any entry in the work folder: unfinished work, or a lock file, of a running or a killed process."""
        try:
            return {name.removesuffix(".lock").removesuffix(".look") for name in os.listdir(self.works)}
        except FileNotFoundError:
            return set()

    def put(self, source: Path, destination: Path) -> None:
        """Move the complete folder `source` to `destination`; an older folder there is replaced.

        `source` lies in the work folder of its key, whose claim the caller holds. Its files are synchronised here. A
        kill between moving the old folder out and the new one in is repaired by `recover`. The names of both are on the
        disk before either moves, so that at least one of them survives a power failure.
        """
        work = source.parent
        _sync_tree(source)
        make_folder(destination.parent)
        replaces = os.path.lexists(destination)
        if replaces:
            replaced = work / "replaced"
            remove(replaced)  # left by a process that was killed after it had put its own folder in place
            # A rename cannot replace a folder with content, so the old one moves out first. Names are synchronised at
            # each step: after a power failure `source`, or `replaced`, is complete on the disk.
            sync_folder(work.parent)
            sync_folder(work)
            os.rename(destination, replaced)
            sync_folder(work)
        os.rename(source, destination)
        sync_folder(destination.parent)
        if replaces:
            sync_folder(work)

    def replaced(self, key: str) -> Path:
        """Path of the older run or packing `key` while a new one takes its place."""
        return self.work(key) / "replaced"

    def is_interrupted(self, key: str, destination: Path) -> bool:
        """Check whether a kill within `put` has left `destination` empty."""
        return self.replaced(key).exists() and not destination.exists()

    def recover(self, key: str, destination: Path) -> None:
        """Undo a `put` that a kill interrupted; the caller holds the claim of `key`."""
        if self.is_interrupted(key, destination):
            make_folder(destination.parent)
            os.rename(self.replaced(key), destination)
            sync_folder(destination.parent)
            self.drop_empty(key)

    def drop_empty(self, key: str) -> None:
        """Remove the work folder of `key` if it is empty; the caller holds the claim."""
        with suppress(OSError):
            os.rmdir(self.work(key))

    def clear(self, key: str) -> None:
        """Remove the unfinished work on `key`; the caller holds the claim."""
        remove(self.work(key))


@dataclass(frozen=True)
class LabListing:
    """Keys of all finished runs and packings, and of unfinished work, in a lab at one moment."""

    runs: Set[str]
    packings: Set[str]
    work: Set[str]

    @classmethod
    def of(cls, lab: LabFolder) -> "LabListing":
        """List the keys that `lab` has now."""
        return cls(*({*folders(folder)} for folder in (lab.runs, lab.packings, lab.works)))


def folders(parent: Path) -> list[str]:
    """Sorted names of the folders and links in `parent`. Hidden ones are skipped: other programs put them there."""
    try:
        entries = [entry for entry in os.scandir(parent) if entry.is_symlink() or entry.is_dir()]
        return sorted(entry.name for entry in entries if not entry.name.startswith("."))
    except FileNotFoundError:
        return []


def stamp(folder: Path) -> int:
    """Hash of names, sizes and modification times in `folder`: it changes when a file is added, removed or written.

    Evaluations and the picture are left out: they may be added at any time. 0 if the folder is missing or is a link.
    """
    try:
        if folder.is_symlink():
            return 0
        entries = (entry for entry in os.scandir(folder) if not is_derived(entry.name))
        stats = [(entry.name, entry.stat(follow_symlinks=False)) for entry in entries]
    except (FileNotFoundError, NotADirectoryError):
        return 0
    # Inode numbers and change times are left out: a copied lab (rsync -a) keeps its stamps, and is not read again.
    files = sorted((name, status.st_mode, status.st_size, status.st_mtime_ns) for name, status in stats)
    return int.from_bytes(hashlib.blake2b(repr(files).encode(), digest_size=7).digest(), "big")  # fits SQLite's integer


def is_derived(name: str) -> bool:
    """Decide whether the file `name` of a run is not part of its data: an evaluation, or its picture."""
    return name.startswith(EVALUATION) or name == PICTURE


def file_system(path: Path, mounts: Path = Path("/proc/self/mountinfo")) -> str:
    """Type of the file system of `path`, such as ext4 or nfs4; empty if the kernel does not list it.

    Args:
        path: File or folder.
        mounts: The kernel's list of mounts (proc(5)).
    """
    try:
        lines = mounts.read_text(errors="surrogateescape").splitlines()
    except OSError:
        return ""
    target, best_match = Path(path).resolve(), ("", "")
    for line in lines:
        head, _, tail = line.partition(" - ")
        if not tail or len(head.split(" ")) < 5:
            continue
        mount_point = re.sub(r"\\([0-7]{3})", lambda octal: chr(int(octal[1], 8)), head.split(" ")[4])
        if target.is_relative_to(mount_point) and len(mount_point) >= len(
            best_match[0]
        ):  # of two on one place the later one is seen
            best_match = mount_point, tail.split(" ")[0]
    return best_match[1]


def is_network(kind: str) -> bool:
    """Decide whether several hosts may mount a file system of this type at once."""
    return kind in _NETWORK or kind.startswith("fuse")


def open_file(path: Path) -> BinaryIO:
    """Open a file of a lab for reading.

    Links are refused: in a lab that came from elsewhere they could show any file of the user. Pipes are refused because
    reading them would wait for ever.

    Raises:
        OSError: The file cannot be read, is no ordinary file, or is a link or in one.
    """
    if path.is_symlink() or path.parent.is_symlink():
        raise OSError(errno.ELOOP, LINK, str(path))
    # O_NONBLOCK: opening a pipe would wait for a writer. O_NOFOLLOW: the file may have become a link since the check.
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW)
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise OSError(errno.EINVAL, "not an ordinary file", str(path))
    return os.fdopen(handle, "rb")


def remove(path: Path) -> None:
    """Remove a file, a link or a folder with its content; what cannot be removed stays."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink()


def write_bytes(path: Path, content: bytes, *, durable: bool = True) -> None:
    """Write a file atomically: readers see the old content or the new, after a crash too if `durable`."""
    partial = path.with_name(path.name + ".part")
    try:
        with open(partial, "wb") as file:
            file.write(content)
            file.flush()
            if durable:  # before the rename: else a crash may leave the new name with no content
                os.fsync(file.fileno())
        os.replace(partial, path)
    except OSError as error:
        error.filename = error.filename or str(path)  # write() and fsync() name no file; messages need one
        with suppress(OSError):
            partial.unlink()
        raise


def make_folder(folder: Path) -> None:
    """Create a folder and its missing parents durably; it may exist."""
    if folder.is_dir():
        return
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    for created in reversed(missing):  # from the top: a folder's name is in its parent
        sync_folder(created.parent)


def sync_folder(folder: Path) -> None:
    """Synchronise the names in `folder` with the disk."""
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
