"""Nothing is lost: every operation on files fails once, and the power fails between any two of them."""

import errno
import os
import shutil
from collections.abc import Callable, Sequence
from itertools import count
from pathlib import Path

import pytest
from fragile_disk import Crash, Disk, Platter, failing
from toy_lab import carry_out, content, leftovers, study, within

from labbook.cli.options import explanation
from labbook.lab import LabFolder
from labbook.lab.index import Index
from labbook.lab.merge import merge
from labbook.lab.runs import open_run

SMALL = {"count": 60, "orifices": "[24]", "replicates": 1}
SHORT = ("stop: {max_time: 4 ms}",)
LONG = ("stop: {max_time: 10 ms}", "record: {every: 4 ms, replicates: 1}")
ERRORS = (errno.ENOSPC, errno.EIO, errno.EINTR)
EVERY = 12
"""Of so many operations or failures `make test` takes one, `make test-all` all."""


def ran(lab: Path) -> None:
    """A run, saved at every beat, which is then gone on with and replaced."""
    for more in (SHORT, LONG):
        carry_out(study(lab.parent, *more, **SMALL), lab, workers=1, checkpoint_every=0)


def imported(lab: Path) -> None:
    """A longer run and its packing, of another lab, that replace those of this one."""
    carry_out(study(lab.parent, *SHORT, **SMALL), lab, workers=1)
    index = Index(LabFolder(lab))
    try:
        merge(index, lab.parent / "other")
    finally:
        index.close()


WAYS = {"run": ran, "import": imported}


@pytest.fixture(scope="module")
def other(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("other")
    carry_out(study(folder, *LONG, **SMALL), folder / "other")
    return folder / "other"


@pytest.fixture(scope="module", params=WAYS)
def way(request, other, tmp_path_factory) -> tuple[Callable[[Path], None], dict, list[Crash]]:
    """What is done to a lab, what comes of it, and what a failure at any time leaves of it."""
    do, folder = WAYS[request.param], tmp_path_factory.mktemp("way")
    shutil.copytree(other, folder / "other")
    platter = Platter(folder)
    put = Index.put_runs

    def reported(index, ended):
        problems = put(index, ended)
        for place, (row, _) in ended.items():
            if problems[place] is None:
                platter.reported[place.name] = max(row["duration"], platter.reported.get(place.name, 0.0))
        return problems

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Index, "put_runs", reported)
        with Disk(folder, after=platter.after):
            do(folder / "lab")
    assert platter.reported
    assert leftovers(folder / "lab") == []
    return do, content(folder / "lab"), platter.crashes


def _problem(do: Callable[[Path], None], lab: Path) -> Exception | None:
    try:
        do(lab)
    except Exception as problem:
        return problem
    return None


def failures(do, other: Path, folder: Path, every: int, errors: Sequence[int], right: dict) -> int:
    """Do it as often as it has operations on files, of which another one fails each time; how often that was."""
    folder.mkdir()
    shutil.copytree(other, folder / "other")
    for number in count(every, every):
        code = errors[number // every % len(errors)]
        shutil.rmtree(folder / "lab", ignore_errors=True)
        lab, at = folder / "lab", f"operation {number}, {os.strerror(code)}"
        with within(60), Disk(lab, failing(number, code)) as disk:
            problem = _problem(do, lab)
        if len(disk.operations) < number:
            return number // every - 1
        at += f": {disk.operations[number - 1]}"
        assert problem is None or explanation(problem) is not None, f"{at}: {problem!r}"
        with within(60):
            do(lab)
        assert content(lab) == right, at
        assert leftovers(lab) == [], at
    return 0


@pytest.mark.slow
def test_after_some_operations_that_failed_the_same_command_reaches_the_same_end(way, other, tmp_path):
    do, right, _ = way
    assert failures(do, other, tmp_path / "failing", EVERY, ERRORS, right) > 100 / EVERY


@pytest.mark.ring
@pytest.mark.parametrize("code", ERRORS, ids=errno.errorcode.get)
def test_after_any_operation_that_failed_the_same_command_reaches_the_same_end(way, other, tmp_path, code):
    do, right, _ = way
    assert failures(do, other, tmp_path / "failing", 1, [code], right) > 100


def outlived(crash: Crash, do, right: dict, place: Path) -> None:
    """What a crash leaves can be opened, has all that was reported, and comes to the same end."""
    at = f"{crash.kind} after operation {crash.number}, {crash.last}"
    crash.lay_out(place)
    lab = LabFolder(place / "lab")
    Index(lab).close()
    for key, duration in crash.reported.items():
        found, _ = open_run(lab.run(key))
        assert found.coverage.duration >= duration, at
    with within(60):
        do(lab.folder)
    assert content(lab.folder) == right, at
    assert leftovers(lab.folder) == [], at


@pytest.mark.parametrize(
    "every",
    [pytest.param(EVERY, marks=pytest.mark.slow), pytest.param(1, marks=pytest.mark.ring)],
)
def test_whenever_the_power_fails_nothing_that_was_reported_is_lost(way, other, tmp_path, every):
    do, right, crashes = way
    assert {crash.kind for crash in crashes} == {"killed", "unsynced data", "unsynced names"}
    assert len(crashes) > 100
    for number, crash in enumerate(crashes[::every]):
        place = tmp_path / f"{number}"
        outlived(crash, do, right, place)
        shutil.rmtree(place)
