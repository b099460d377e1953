"""Merging runs, packings, study files and notes of another lab into this one.

The other lab may be damaged, or made with bad intentions. Only ordinary files that belong to a run or a packing are
copied, into the work folder of their key. There they pass all checks of a local folder before they are put in place.
Whatever is left out is reported, and stops nothing else.

Runners may work in both labs at the same time. The other lab's `work/` is never read, and a folder that is replaced
while it is copied is left out. The choice between two runs is made under the claim of their key: a local runner may
have put a longer run in place since the first look.
"""

import errno
import math
import os
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import BinaryIO, get_args

from labbook.accuracy import BESIDE
from labbook.backend import BackendMissing, load
from labbook.backend.probes import parse_probe, table_name
from labbook.lab import notes, studies
from labbook.lab.folder import PICTURE, LabError, LabFolder, is_full, make_folder, remove, stamp
from labbook.lab.index import Index
from labbook.lab.packings import ARRAYS, PackingRecord, read_packing
from labbook.lab.records import MAX_RECORD_BYTES, RunRecord, Unreadable
from labbook.lab.runs import CHECKPOINT, RECORDING, open_run, picture, read_end
from labbook.lab.suspect import suspicion
from labbook.lab.tables import MAX_TABLE_BYTES
from labbook.scene import attached
from labbook.study.source import MAX_BYTES

_CHUNK = 2**20  # bytes copied at a time


@dataclass
class Merged:
    """Report of a merge.

    Args:
        copied: Keys of copied runs and packings.
        studies: Names of studies whose file was copied.
        notes: Number of copied notes.
        stayed: Conflicts in which the local version is kept, as sentences.
        left_out: Reasons for which something was not copied.
    """

    copied: list[str] = field(default_factory=list)
    studies: list[str] = field(default_factory=list)
    notes: int = 0
    stayed: list[str] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)

    def __add__(self, other: "Merged") -> "Merged":
        return Merged(*(getattr(self, item.name) + getattr(other, item.name) for item in fields(self)))


def merge(index: Index, source: Path) -> Merged:
    """Copy runs, packings, study files and notes that this lab lacks from another lab, and index them.

    If both have a run, the one with more coverage stays; a local one that cannot be read is replaced. If both have a
    study file or a note, the local one stays.

    Args:
        index: Index of this lab.
        source: Folder of the other lab, or of a copy.

    Raises:
        FileNotFoundError: `source` is not a lab.
        OSError: The disk is full.
    """
    lab, source_lab = index.lab, LabFolder(source)
    if not source_lab.exists:
        raise FileNotFoundError(errno.ENOENT, "not a lab: it has neither runs/ nor packings/", str(source))
    merged = Merged()
    _merge_attached(lab, source_lab, merged)  # before what may need them
    runs = _entries(source_lab.runs)  # before the packings: whoever works there makes a packing before the runs from it
    for names, theirs, merge_one in (
        (_entries(source_lab.packings), source_lab.packings, _merge_packing),
        (runs, source_lab.runs, _merge_run),
    ):
        for name in names:
            try:
                if merge_one(index, lab, theirs / name):
                    merged.copied.append(name)
            except Unreadable as problem:
                merged.left_out.append(str(problem))
    for name, theirs in studies.candidates(source_lab).items():
        try:
            _merge_study(lab, name, theirs, merged)
        except Unreadable as problem:
            merged.left_out.append(str(problem))
    for kind in get_args(notes.Kind):
        for name, theirs in notes.candidates(source_lab, kind).items():
            try:
                if kind == "study" or lab.run(name).is_dir():
                    _merge_note(lab, kind, name, theirs, merged)
            except Unreadable as problem:
                merged.left_out.append(str(problem))
    return merged


def bring(index: Index, source_lab: LabFolder, packings: Iterable[str], runs: Iterable[str]) -> None:
    """Copy packings and runs of another lab that are to be continued here; those that cannot be read are skipped."""
    for keys, folder_of, merge_one in (
        (packings, source_lab.packing, _merge_packing),
        (runs, source_lab.run, _merge_run),
    ):
        for key in keys:
            with suppress(Unreadable):  # it is made again
                if folder_of(key).is_dir():
                    merge_one(index, index.lab, folder_of(key))


def _entries(folder: Path) -> list[str]:
    """Sorted names of the folders and links in `folder`, without hidden ones."""
    if not folder.is_dir():
        return []
    entries = os.scandir(folder)
    return sorted(
        entry.name for entry in entries if not entry.name.startswith(".") and (entry.is_symlink() or entry.is_dir())
    )


def _merge_packing(index: Index, lab: LabFolder, theirs: Path) -> bool:
    """Copy a packing, unless there is a readable local one; True if copied."""
    fingerprint = _fingerprint(theirs)
    record = PackingRecord.read(theirs)
    key = record.packing_key
    mine = lab.packing(key)
    if mine.exists() and not index.problem(mine):
        return False
    with _staging_folder(lab, key, theirs, mine) as copy:
        # Asked again under the claim: a local process may have made the packing since the first look.
        if _is_readable_packing(mine):
            return False
        _copy(theirs, copy, {PackingRecord.FILE, ARRAYS}, fingerprint)
        with _with_original_path(copy, theirs):
            read_packing(copy, key)
        lab.put(copy, mine)
        lab.clear(key)
        index.add_packing(mine)
    return True


def _merge_run(index: Index, lab: LabFolder, theirs: Path) -> bool:
    """Copy a run, unless the local one is as good; True if copied."""
    fingerprint = _fingerprint(theirs)
    record = RunRecord.read(theirs)
    key = record.run_key
    mine = lab.run(key)
    if not index.problem(mine) and not _is_better(record, theirs, mine):
        return False
    if not lab.packing(record.packing_key).exists():
        in_progress = lab.is_claimed(record.packing_key)
        why = "another process works on that; import again later" if in_progress else "it was not imported either"
        raise Unreadable(f"{theirs}: it starts from the packing {record.packing_key}, which is not in this lab: {why}")
    names = {RunRecord.FILE, CHECKPOINT, *(f"{table_name(parse_probe(text))}.npz" for text in record.coverage.probes)}
    if record.coverage.recording is not None:
        names.add(RECORDING)
    if picture(theirs) is not None:
        names.add(PICTURE)
    with _staging_folder(lab, key, theirs, mine) as copy:
        if not _is_better(record, theirs, mine, whole=True):
            return False
        _copy(theirs, copy, names, fingerprint)
        with _with_original_path(copy, theirs):  # the copy is checked, not the original: that one may change meanwhile
            copied_record, _ = open_run(copy, key=key, lab=lab)
            _check_end(copy, copied_record)
        lab.put(copy, mine)
        # Only the older run goes: local checkpoints of unfinished work on this key stay.
        remove(lab.replaced(key))
        index.add_run(mine)
    return True


def _is_better(record: RunRecord, theirs: Path, mine: Path, *, whole: bool = False) -> bool:
    """Decide whether their run replaces ours in `mine`. Raises Unreadable for a longer run that is suspect where ours
    is not.

    Args:
        record: Record of their run.
        theirs: Folder of their run.
        mine: Folder of our run; it may be missing.
        whole: Check all files of our run: one that cannot be read is replaced.
    """
    try:
        ours = open_run(mine)[0] if whole else RunRecord.read(mine)
    except Unreadable:
        return True
    if not covers_more(record, ours):
        return False
    if (why := suspicion(record.ledger)) and not suspicion(ours.ledger):
        raise Unreadable(f"{theirs}: it is suspect ({why}), and the shorter run of this lab is not: that one is kept")
    return True


def _is_readable_packing(folder: Path) -> bool:
    """Check that a packing exists and can be read."""
    try:
        read_packing(folder)
    except Unreadable:
        return False
    return True


def _merge_attached(lab: LabFolder, source: LabFolder, merged: Merged) -> None:
    """Copy attached files of studies, named by their hashes; files with other names are left out."""
    names = sorted(os.listdir(source.attached)) if source.attached.is_dir() and not source.attached.is_symlink() else []
    for name in filter(attached.is_hash, names):
        theirs = source.attached / name
        try:
            with _open_ordinary(theirs, attached.MOST_BYTES) as (file, _):
                content = read_bytes(theirs, file)
            if attached.key_of(content) != name:
                raise Unreadable(f"{theirs}: it was changed after it was written (wrong checksum)")
            with _write_errors(theirs, lab.attached / name):
                studies.attach_content(lab, content)
        except Unreadable as problem:
            merged.left_out.append(str(problem))


def _merge_study(lab: LabFolder, name: str, theirs: Path, merged: Merged) -> None:
    text = _text(theirs, MAX_BYTES)
    beside = theirs.with_suffix(BESIDE)
    calibration = _text(beside, MAX_BYTES) if beside.exists() else None
    listed = theirs.with_suffix(attached.LIST)
    files = _text(listed, MAX_BYTES) if listed.exists() else None
    with _write_errors(theirs, studies.study_path(lab, name)):
        before = studies.add(lab, name, text, calibration, files)
    if before is None:
        merged.studies.append(name)
    elif before != text:
        merged.stayed.append(f"the study file {name} of this lab differs and is kept: {studies.study_path(lab, name)}")


def _merge_note(lab: LabFolder, kind: notes.Kind, name: str, theirs: Path, merged: Merged) -> None:
    text, mine = _text(theirs, notes.MOST_BYTES), notes.note_path(lab, kind, name)
    try:
        note, before = notes.parsed(text.encode()), notes.read(lab, kind, name)
    except ValueError as problem:
        raise Unreadable(f"{theirs}: {problem}") from problem
    except LabError as problem:
        merged.stayed.append(f"the note of this lab cannot be read and is kept: {problem}")
        return
    if not before and note:
        with _write_errors(theirs, mine):
            notes.write(lab, kind, name, note)
        merged.notes += 1
    elif note not in (before, notes.Note()):
        merged.stayed.append(f"the note of the {kind} {name} in this lab differs and is kept: {mine}")


@contextmanager
def _write_errors(theirs: Path, mine: Path) -> Iterator[None]:
    """Raise Unreadable for errors of writing `mine`, except for a full disk: that one stops the merge."""
    try:
        yield
    except OSError as error:
        if is_full(error):
            raise
        raise Unreadable(f"{theirs}: {mine}: {error.strerror}") from error


def covers_more(theirs: RunRecord, mine: RunRecord) -> bool:
    """Decide whether their run covers all that ours does, and is longer, has more probes, or has closer frames."""
    their_coverage, our_coverage = theirs.coverage, mine.coverage
    their_probes, our_probes = set(their_coverage.probes), set(our_coverage.probes)
    their_interval, our_interval = (
        (math.inf if coverage.frame_interval is None else coverage.frame_interval)
        for coverage in (their_coverage, our_coverage)
    )
    if not (
        their_coverage.duration >= our_coverage.duration
        and their_probes >= our_probes
        and their_interval <= our_interval
    ):
        return False
    return their_coverage.duration > our_coverage.duration or their_probes > our_probes or their_interval < our_interval


def _check_end(copy: Path, record: RunRecord) -> None:
    """Check that the installed backend can continue from the last state, if it is the one that made the run. Raises
    Unreadable."""
    try:
        backend = load(record.backend)
    except BackendMissing:
        return  # the state is looked at again by whoever goes on from it
    own = backend.capabilities
    if (own.name, own.cache_version) == (record.backend, record.cache_version):
        try:
            backend.verify(record.scene, record.numerics, read_end(copy, record), record.coverage.steps)
        except ImportError:
            return
        except ValueError as error:
            raise Unreadable(f"{copy / CHECKPOINT}: {error}") from error


def _fingerprint(folder: Path) -> tuple[int, int]:
    """(inode, stamp) of a folder, to detect that it was replaced while it was copied.

    Raises:
        Unreadable: It is a link, or has anything but ordinary files; hidden entries are ignored.
    """
    with reading(folder):
        status = os.lstat(folder)
        if stat.S_ISLNK(status.st_mode):
            raise Unreadable(f"{folder}: it is a link; import copies no links")
        for entry in os.scandir(folder):  # a link could copy any file of the user into a shared lab
            if entry.is_symlink():
                raise Unreadable(f"{entry.path}: it is a link; import copies no links")
            if not entry.is_file(follow_symlinks=False) and not entry.name.startswith("."):
                raise Unreadable(f"{entry.path}: not an ordinary file; it does not belong in a lab")
        return status.st_ino, stamp(folder)


@contextmanager
def _staging_folder(lab: LabFolder, key: str, theirs: Path, mine: Path) -> Iterator[Path]:
    """Claim `key` and give a path, not yet created, where a copy is prepared before it is put in place.

    Raises:
        Unreadable: Another process works on the key.
    """
    claim = lab.claim(key)
    if claim is None:
        raise Unreadable(f"{theirs}: another process works on it; import again later")
    work = lab.work(key)
    try:
        lab.recover(key, mine)
        remove(work / "done")
        yield work / "done"
    finally:
        remove(work / "done")
        lab.drop_empty(key)
        claim.release()


def _copy(theirs: Path, copy: Path, names: set[str], fingerprint: tuple[int, int]) -> None:
    """Copy the files `names` of a folder. Raises Unreadable if it changed since `fingerprint` was taken, and
    OSError."""
    make_folder(copy)
    for name in sorted(names):
        copy_file(theirs / name, copy / name)
    if _fingerprint(theirs) != fingerprint:
        raise Unreadable(f"{theirs}: it was replaced while it was copied; import again")


@contextmanager
def _with_original_path(copy: Path, theirs: Path) -> Iterator[None]:
    """Name the original in errors about a copy."""
    try:
        yield
    except Unreadable as problem:
        raise Unreadable(str(problem).replace(str(copy), str(theirs))) from problem


@contextmanager
def reading(theirs: Path) -> Iterator[None]:
    """Raise Unreadable for errors of reading a file of the other lab: they stop nothing else."""
    try:
        yield
    except FileNotFoundError as error:
        raise Unreadable(f"{theirs} is missing: removed or replaced meanwhile; import again") from error
    except OSError as error:
        raise Unreadable(f"{theirs}: {error.strerror or error}") from error


def copy_file(theirs: Path, mine: Path) -> None:
    """Copy an ordinary file with its modification time; links are refused.

    Raises:
        Unreadable: It cannot be read.
        OSError: It cannot be written.
    """
    limit = MAX_TABLE_BYTES if theirs.suffix == ".npz" else MAX_RECORD_BYTES
    with _open_ordinary(theirs, limit) as (source, status), open(mine, "wb") as target:
        while chunk := read_bytes(theirs, source, _CHUNK):
            target.write(chunk)
    os.utime(mine, ns=(status.st_atime_ns, status.st_mtime_ns))


def read_bytes(theirs: Path, source: BinaryIO, limit: int = -1) -> bytes:
    """Read from an open file of the other lab; `limit`: maximum number of bytes, or -1. Raises Unreadable."""
    with reading(theirs):
        return source.read(limit)


def _text(theirs: Path, limit: float) -> str:
    """Read the text of an ordinary file of at most `limit` bytes. Raises Unreadable."""
    with _open_ordinary(theirs, limit) as (source, _):
        try:
            return read_bytes(theirs, source).decode()
        except UnicodeDecodeError as error:
            raise Unreadable(f"{theirs}: not text in UTF-8") from error


@contextmanager
def _open_ordinary(theirs: Path, limit: float) -> Iterator[tuple[BinaryIO, os.stat_result]]:
    """Open an ordinary file of at most `limit` bytes; links are refused. Raises Unreadable."""
    if theirs.is_symlink():
        raise Unreadable(f"{theirs}: it is a link; import copies no links")
    with reading(theirs):
        # O_NOFOLLOW: it may have become a link since the check. O_NONBLOCK: opening a pipe would wait for a writer.
        handle = os.open(theirs, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW)
    status = os.fstat(handle)  # of the open file: the path may lead to another one by now
    if not stat.S_ISREG(status.st_mode):
        os.close(handle)
        raise Unreadable(f"{theirs}: not an ordinary file")
    with os.fdopen(handle, "rb") as source:
        if status.st_size > limit:
            raise Unreadable(f"{theirs}: it has {status.st_size} bytes, more than the allowed {limit:.0f}")
        yield source, status
