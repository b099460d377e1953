"""Recordings of runs, made if missing, and the rerun viewer."""

from pathlib import Path

from labbook.cli.options import again, existing, fail, instead_of_none, read_study
from labbook.cli.screen import say
from labbook.commands import command
from labbook.export.recording import NotRecorded, ViewerMissing, of_run
from labbook.export.viewer import ViewerFailed, show
from labbook.export.viewer import screenshot as photograph
from labbook.lab import NoCatalogue, Unreadable
from labbook.plan.coverage import finished, unreadable


def view(target: str, point: int | None, screenshot: Path | None, open_viewer: bool, lab: Path, backend: str) -> None:
    """Make the recordings of a study or a run, and show or photograph them."""
    try:
        recordings = _recordings(target, point, lab, backend)
        for path in recordings:
            say(f"Recording: {path}")
        if screenshot is not None:
            photograph(recordings[0], screenshot)
            say(f"Picture: {screenshot}")
        elif open_viewer:
            show(recordings)
    except (NoCatalogue, Unreadable, NotRecorded, ViewerMissing, ViewerFailed) as error:
        fail(error)


def _recordings(target: str, point: int | None, lab: Path, backend: str) -> list[Path]:
    """Recordings of what is asked for; those that are missing are made."""
    catalogue = existing(lab)
    if not Path(target).is_file():
        keys = catalogue.matching(target)
        if len(keys) != 1:
            known = (
                f"the keys of {len(keys)} runs begin so"
                if keys
                else f"no such file, and no key of a run in {lab} begins so"
            )
            fail(f"{target}: {known}; `{command('runs', lab=lab)}` lists them")
        return [of_run(catalogue.lab.run(keys[0]), lab)]
    study = read_study(Path(target))
    if point is not None and point > len(study.points):
        points = "1 point" if len(study.points) == 1 else f"{len(study.points)} points"
        fail(f"--point {point}: the study has {points}; use 1 to {len(study.points)}")
    runs = [run for run in finished(catalogue, study, backend) if point is None or run.point.index == point - 1]
    made, lost = [], unreadable(catalogue, study, backend)
    for run in runs:
        try:
            if run.record.coverage.recording is not None:
                made.append(of_run(run.folder, lab, study.name, run.point))
        except Unreadable as problem:
            lost.append(str(problem))
    for problem in lost:
        say(f"Left out: {problem}", err=True)
    if not runs:
        what = instead_of_none(study.name, target, lab, backend)
        fail(f"{lab} has no such finished run of {study.name} on {backend}; {what}")
    if not made and not lost:
        raise NotRecorded(
            f"none of these runs kept frames: add `record: {{every: 10 ms}}` to {target} and run it again"
        )
    if not made:
        fail(f"no recorded run of {study.name} can be read; make them again: {again(target, lab, backend)}")
    return made
