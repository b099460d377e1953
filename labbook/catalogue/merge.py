"""Merging the runs and packings of another lab, brought from another machine."""

import shutil
from pathlib import Path

from labbook.catalogue.lab import Lab
from labbook.catalogue.packings import PackingRecord
from labbook.catalogue.parts import Unreadable
from labbook.catalogue.record import RunRecord
from labbook.catalogue.rows import stamps


def merge(lab: Lab, source: Path) -> tuple[list[str], list[str]]:
    """Copy runs and packings of the lab (or copy of one) in `source` that `lab` lacks: (copied keys,
    problems).

    Where both have a run, the one that covers more time stays. Raises FileNotFoundError if `source` is no
    lab.
    """
    other = Lab(source)
    if not other.runs.is_dir() and not other.packings.is_dir():
        raise FileNotFoundError(f"{source}: no lab: it has neither runs/ nor packings/")
    copied: list[str] = []
    problems: list[str] = []
    for record, theirs, mine in (
        (PackingRecord, other.packings, lab.packings),
        (RunRecord, other.runs, lab.runs),
    ):
        for key in stamps(theirs):
            try:
                wanted = _better(record.read(theirs / key), mine / key)
            except Unreadable as problem:
                problems.append(str(problem))
                continue
            if wanted and _copy(lab, key, theirs / key, mine / key):
                copied.append(key)
            elif wanted:
                problems.append(f"{key}: another process works on it; import again later")
    return copied, problems


def _better(theirs: PackingRecord | RunRecord, mine: Path) -> bool:
    if not mine.exists():
        return True
    if isinstance(theirs, PackingRecord):
        return False
    try:
        had = RunRecord.read(mine)
    except Unreadable:
        return True
    return theirs.coverage.duration > had.coverage.duration and set(theirs.coverage.probes) >= set(had.coverage.probes)


def _copy(lab: Lab, key: str, theirs: Path, mine: Path) -> bool:
    claim = lab.claim(key)
    if claim is None:
        return False
    try:
        made = lab.work(key) / "done"
        shutil.rmtree(made, ignore_errors=True)
        made.parent.mkdir(parents=True, exist_ok=True)
        shutil.copytree(theirs, made)
        lab.put(made, mine)
        lab.clear(key)
    finally:
        claim.release()
    return True
