"""Merging the runs, packings, study files and notes of another lab, brought from another machine.

What is in the other lab may be damaged, or made by somebody who means harm. Only ordinary files that belong to a run or
a packing are copied, into the work folder of their key; there everything in them is looked at as if it had always been
ours; and only then does the copy get its place. What is left out is named, and stops nothing else.

Runners may be at work in both labs meanwhile. The other lab's `work/` is never read, and a folder of it that is
replaced while it is copied is left out. Whether theirs is better is decided under the claim of the key: a local runner
may have put a longer run in place since the first look.
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
from labbook.lab.records import LONGEST, RunRecord, Unreadable
from labbook.lab.runs import CHECKPOINT, RECORDING, open_run, picture, read_end
from labbook.lab.suspect import suspicion
from labbook.lab.tables import MOST
from labbook.scene import attached
from labbook.study.source import MAX_BYTES

_CHUNK = 2**20  # bytes copied at a time


@dataclass
class Merged:
    """What was copied, and what was left out, with the reason."""

    copied: list[str] = field(default_factory=list)
    """Keys of runs and packings."""
    studies: list[str] = field(default_factory=list)
    """Names of studies whose file was copied."""
    notes: int = 0
    """Notes that were copied."""
    stayed: list[str] = field(default_factory=list)
    """What stays as it is here although the other lab has it otherwise, in words."""
    left_out: list[str] = field(default_factory=list)

    def __add__(self, other: "Merged") -> "Merged":
        return Merged(*(getattr(self, one.name) + getattr(other, one.name) for one in fields(self)))


def merge(index: Index, source: Path) -> Merged:
    """Copy runs, packings and study files of the lab (or copy of one) in `source` that the lab of `index` lacks, and
    index them; also notes of studies, and of runs that it has by then.

    Where both have a run, the one that covers more stays; one of ours that cannot be read is replaced. Where both have
    the file of a study or a note, ours stays. Raises FileNotFoundError if `source` is no lab.
    """
    lab, other = index.lab, LabFolder(source)
    if not other.exists:
        raise FileNotFoundError(errno.ENOENT, "not a lab: it has neither runs/ nor packings/", str(source))
    merged = Merged()
    _take_attached(lab, other, merged)  # before what may need them
    runs = _entries(other.runs)  # before the packings: whoever works there makes a packing before the runs from it
    for names, theirs, take in (
        (_entries(other.packings), other.packings, _take_packing),
        (runs, other.runs, _take_run),
    ):
        for name in names:
            try:
                if take(index, lab, theirs / name):
                    merged.copied.append(name)
            except Unreadable as problem:
                merged.left_out.append(str(problem))
    for name, theirs in studies.named(other).items():
        try:
            _take_study(lab, name, theirs, merged)
        except Unreadable as problem:
            merged.left_out.append(str(problem))
    for kind in get_args(notes.Kind):
        for name, theirs in notes.named(other, kind).items():
            try:
                if kind == "study" or lab.run(name).is_dir():
                    _take_note(lab, kind, name, theirs, merged)
            except Unreadable as problem:
                merged.left_out.append(str(problem))
    return merged


def bring(index: Index, other: LabFolder, packings: Iterable[str], runs: Iterable[str]) -> None:
    """Copy these packings and runs of another lab, which go on here, as far as it has them whole."""
    for keys, place, take in ((packings, other.packing, _take_packing), (runs, other.run, _take_run)):
        for key in keys:
            with suppress(Unreadable):  # it is made again
                if place(key).is_dir():
                    take(index, index.lab, place(key))


def _entries(folder: Path) -> list[str]:
    """Names in `folder` that may be those of runs or packings: files and what is hidden are none."""
    if not folder.is_dir():
        return []
    found = os.scandir(folder)
    return sorted(one.name for one in found if not one.name.startswith(".") and (one.is_symlink() or one.is_dir()))


def _take_packing(index: Index, lab: LabFolder, theirs: Path) -> bool:
    seen = _seen(theirs)
    record = PackingRecord.read(theirs)
    key = record.packing_key
    mine = lab.packing(key)
    if mine.exists() and not index.problem(mine):
        return False
    with _claimed(lab, key, theirs, mine) as copy:
        if _whole_packing(mine):
            return False
        _copy(theirs, copy, {PackingRecord.FILE, ARRAYS}, seen)
        with _as_theirs(copy, theirs):
            read_packing(copy, key)
        lab.put(copy, mine)
        lab.clear(key)
        index.add_packing(mine)
    return True


def _take_run(index: Index, lab: LabFolder, theirs: Path) -> bool:
    seen = _seen(theirs)
    record = RunRecord.read(theirs)
    key = record.run_key
    mine = lab.run(key)
    if not index.problem(mine) and not _better(record, theirs, mine):
        return False
    if not lab.packing(record.packing_key).exists():
        held = lab.held(record.packing_key)
        why = "another process works on that; import again later" if held else "it was not imported either"
        raise Unreadable(f"{theirs}: it starts from the packing {record.packing_key}, which is not in this lab: {why}")
    names = {RunRecord.FILE, CHECKPOINT, *(f"{table_name(parse_probe(text))}.npz" for text in record.coverage.probes)}
    if record.coverage.recording is not None:
        names.add(RECORDING)
    if picture(theirs) is not None:
        names.add(PICTURE)
    with _claimed(lab, key, theirs, mine) as copy:
        if not _better(record, theirs, mine, whole=True):
            return False
        _copy(theirs, copy, names, seen)
        with _as_theirs(copy, theirs):
            found, _ = open_run(copy, key=key, lab=lab)
            _check_end(copy, found)
        lab.put(copy, mine)
        remove(lab.replaced(key))
        index.add_run(mine)
    return True


def _better(record: RunRecord, theirs: Path, mine: Path, *, whole: bool = False) -> bool:
    """Whether a run of theirs is better than ours in `mine`; `whole`: also if anything of ours cannot be read. Raises
    Unreadable for a longer run that is suspect where ours is not: it would leave all means."""
    try:
        ours = open_run(mine)[0] if whole else RunRecord.read(mine)
    except Unreadable:
        return True
    if not covers_more(record, ours):
        return False
    if (why := suspicion(record.ledger)) and not suspicion(ours.ledger):
        raise Unreadable(f"{theirs}: it is suspect ({why}), and the shorter run of this lab is not: that one is kept")
    return True


def _whole_packing(folder: Path) -> bool:
    """Whether a packing is there, and can be read."""
    try:
        read_packing(folder)
    except Unreadable:
        return False
    return True


def _take_attached(lab: LabFolder, source: LabFolder, merged: Merged) -> None:
    """Copy the contents of files that studies name, by their hashes. Others are left out."""
    names = sorted(os.listdir(source.attached)) if source.attached.is_dir() and not source.attached.is_symlink() else []
    for name in filter(attached.is_hash, names):
        theirs = source.attached / name
        try:
            with _opened(theirs, attached.MOST_BYTES) as (file, _):
                content = read_bytes(theirs, file)
            if attached.key_of(content) != name:
                raise Unreadable(f"{theirs}: it was changed after it was written (wrong checksum)")
            with _in_the_way(theirs, lab.attached / name):
                studies.attach_content(lab, content)
        except Unreadable as problem:
            merged.left_out.append(str(problem))


def _take_study(lab: LabFolder, name: str, theirs: Path, merged: Merged) -> None:
    text = _text(theirs, MAX_BYTES)
    beside = theirs.with_suffix(BESIDE)
    calibration = _text(beside, MAX_BYTES) if beside.exists() else None
    listed = theirs.with_suffix(attached.LIST)
    files = _text(listed, MAX_BYTES) if listed.exists() else None
    with _in_the_way(theirs, studies.place(lab, name)):
        before = studies.add(lab, name, text, calibration, files)
    if before is None:
        merged.studies.append(name)
    elif before != text:
        merged.stayed.append(f"the study file {name} of this lab differs and is kept: {studies.place(lab, name)}")


def _take_note(lab: LabFolder, kind: notes.Kind, name: str, theirs: Path, merged: Merged) -> None:
    text, mine = _text(theirs, notes.MOST_BYTES), notes.place(lab, kind, name)
    try:
        note, before = notes.parsed(text.encode()), notes.read(lab, kind, name)
    except ValueError as problem:
        raise Unreadable(f"{theirs}: {problem}") from problem
    except LabError as problem:
        merged.stayed.append(f"the note of this lab cannot be read and is kept: {problem}")
        return
    if not before and note:
        with _in_the_way(theirs, mine):
            notes.write(lab, kind, name, note)
        merged.notes += 1
    elif note not in (before, notes.Note()):
        merged.stayed.append(f"the note of the {kind} {name} in this lab differs and is kept: {mine}")


@contextmanager
def _in_the_way(theirs: Path, mine: Path) -> Iterator[None]:
    """Turns an error of writing `mine` into Unreadable, which stops nothing else; a full disk stays an OSError."""
    try:
        yield
    except OSError as error:
        if is_full(error):
            raise
        raise Unreadable(f"{theirs}: {mine}: {error.strerror}") from error


def covers_more(theirs: RunRecord, mine: RunRecord) -> bool:
    """Whether a run covers all that ours does, and goes on for longer, observed more, or has frames closer to each
    other."""
    one, other = theirs.coverage, mine.coverage
    seen, observed = set(one.probes), set(other.probes)
    apart, known = ((math.inf if had.frame_interval is None else had.frame_interval) for had in (one, other))
    if not (one.duration >= other.duration and seen >= observed and apart <= known):
        return False
    return one.duration > other.duration or seen > observed or apart < known


def _check_end(copy: Path, record: RunRecord) -> None:
    """Whether the backend of a run, if it is installed in this version, could go on from its last state."""
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


def _seen(folder: Path) -> tuple[int, int]:
    """By what a folder of theirs is known again, if it stays as it is. Raises Unreadable for one that is a link, or
    holds anything but ordinary files; what is hidden is left."""
    with reading(folder):
        status = os.lstat(folder)
        if stat.S_ISLNK(status.st_mode):
            raise Unreadable(f"{folder}: it is a link; import copies no links")
        for entry in os.scandir(folder):
            if entry.is_symlink():
                raise Unreadable(f"{entry.path}: it is a link; import copies no links")
            if not entry.is_file(follow_symlinks=False) and not entry.name.startswith("."):
                raise Unreadable(f"{entry.path}: not an ordinary file; it does not belong in a lab")
        return status.st_ino, stamp(folder)


@contextmanager
def _claimed(lab: LabFolder, key: str, theirs: Path, mine: Path) -> Iterator[Path]:
    """The folder, which is not there yet, where what is to get the place `mine` is put together while `key` is ours.
    Raises Unreadable while another process has it."""
    claim = lab.claim(key)
    if claim is None:
        raise Unreadable(f"{theirs}: another process works on it; import again later")
    work = lab.work(key)
    try:
        lab.mend(key, mine)
        remove(work / "done")
        yield work / "done"
    finally:
        remove(work / "done")
        lab.drop_empty(key)
        claim.release()


def _copy(theirs: Path, copy: Path, names: set[str], seen: tuple[int, int]) -> None:
    """Copy the files `names` of a folder that was `seen`. Raises Unreadable, also if it changed meanwhile, and OSError
    if there is no room."""
    make_folder(copy)
    for name in sorted(names):
        copy_file(theirs / name, copy / name)
    if _seen(theirs) != seen:
        raise Unreadable(f"{theirs}: it was replaced while it was copied; import again")


@contextmanager
def _as_theirs(copy: Path, theirs: Path) -> Iterator[None]:
    """What cannot be read in a copy is named by where it came from."""
    try:
        yield
    except Unreadable as problem:
        raise Unreadable(str(problem).replace(str(copy), str(theirs))) from problem


@contextmanager
def reading(theirs: Path) -> Iterator[None]:
    """Turns an error of reading what is theirs into Unreadable, which stops nothing else."""
    try:
        yield
    except FileNotFoundError as error:
        raise Unreadable(f"{theirs} is missing: removed or replaced meanwhile; import again") from error
    except OSError as error:
        raise Unreadable(f"{theirs}: {error.strerror or error}") from error


def copy_file(theirs: Path, mine: Path) -> None:
    """Copy an ordinary file, which is not a link, and keep its time. Raises Unreadable, or OSError if there is no
    room."""
    most = MOST if theirs.suffix == ".npz" else LONGEST
    with _opened(theirs, most) as (source, status), open(mine, "wb") as target:
        while chunk := read_bytes(theirs, source, _CHUNK):
            target.write(chunk)
    os.utime(mine, ns=(status.st_atime_ns, status.st_mtime_ns))


def read_bytes(theirs: Path, source: BinaryIO, most: int = -1) -> bytes:
    with reading(theirs):
        return source.read(most)


def _text(theirs: Path, most: float) -> str:
    """The text of an ordinary file, which is not a link and has at most so many bytes. Raises Unreadable."""
    with _opened(theirs, most) as (source, _):
        try:
            return read_bytes(theirs, source).decode()
        except UnicodeDecodeError as error:
            raise Unreadable(f"{theirs}: not text in UTF-8") from error


@contextmanager
def _opened(theirs: Path, most: float) -> Iterator[tuple[BinaryIO, os.stat_result]]:
    """An ordinary file, which is not a link and has at most so many bytes, to read. Raises Unreadable."""
    if theirs.is_symlink():
        raise Unreadable(f"{theirs}: it is a link; import copies no links")
    with reading(theirs):
        handle = os.open(theirs, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW)
    status = os.fstat(handle)
    if not stat.S_ISREG(status.st_mode):
        os.close(handle)
        raise Unreadable(f"{theirs}: not an ordinary file")
    with os.fdopen(handle, "rb") as source:
        if status.st_size > most:
            raise Unreadable(f"{theirs}: it has {status.st_size} bytes, more than the allowed {most:.0f}")
        yield source, status
