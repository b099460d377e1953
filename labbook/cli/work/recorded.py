"""Recorded runs that a verb is about: those of a study, or one by its key."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, TypeVar

from labbook.cli.options import again, existing, fail, instead_of_none, read_study
from labbook.cli.screen import say
from labbook.commands import command
from labbook.export.frames import NotRecorded
from labbook.lab import Unreadable
from labbook.plan.coverage import finished, unreadable
from labbook.study import Point

T = TypeVar("T")


class Recorded(NamedTuple):
    """A finished run that kept its frames: its folder, and study and point for which it is shown (None: those that made
    it)."""

    folder: Path
    study: str | None = None
    point: Point | None = None


def of_recorded(
    target: str, point: int | None, lab: Path, backend: str, make: Callable[[Recorded], T]
) -> list[T]:  # fmt: skip
    """Call a function with each recorded run of a study file, or with the run whose key begins so.

    Runs of a study that cannot be read are named and left out. Without any run the program ends.

    Args:
        target: Study file, or the first digits of a run's key.
        point: Only this point of the study, counted from 1; None: all.
        lab: Lab folder.
        backend: Backend that made the runs.
        make: Function of a run.

    Returns:
        What the function returned, by point and seed.

    Raises:
        NotRecorded: No run kept frames.
        Unreadable: The run with this key cannot be read.
    """
    catalogue = existing(lab)
    if not Path(target).is_file():
        keys = catalogue.matching(target)
        if len(keys) != 1:
            reason = (
                f"the keys of {len(keys)} runs begin so"
                if keys
                else f"no such file, and no key of a run in {lab} begins so"
            )
            fail(f"{target}: {reason}; `{command('runs', lab=lab)}` lists them")
        return [make(Recorded(catalogue.lab.run(keys[0])))]
    study = read_study(Path(target))
    if point is not None and point > len(study.points):
        points = "1 point" if len(study.points) == 1 else f"{len(study.points)} points"
        fail(f"--point {point}: the study has {points}; use 1 to {len(study.points)}")
    runs = [run for run in finished(catalogue, study, backend) if point is None or run.point.index == point - 1]
    results, lost = [], unreadable(catalogue, study, backend)
    for run in runs:
        try:
            if run.record.coverage.recording is not None:
                results.append(make(Recorded(run.folder, study.name, run.point)))
        except Unreadable as problem:
            lost.append(str(problem))
    for problem in lost:
        say(f"Left out: {problem}", err=True)
    if not runs:
        remedy = instead_of_none(study.name, target, lab, backend)
        fail(f"{lab} has no such finished run of {study.name} on {backend}; {remedy}")
    if not results and not lost:
        raise NotRecorded(
            f"none of these runs kept frames: add `record: {{every: 10 ms}}` to {target} and run it again"
        )
    if not results:
        fail(f"no recorded run of {study.name} can be read; make them again: {again(target, lab, backend)}")
    return results
