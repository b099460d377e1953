"""Recordings of runs, made if missing, and the rerun viewer."""

import re
from pathlib import Path

from labbook.cli.options import fail
from labbook.cli.screen import say
from labbook.cli.work.recorded import Recorded, of_recorded
from labbook.export.entities import ViewerMissing
from labbook.export.frames import NotRecorded
from labbook.export.recording import SIDE_BY_SIDE, middle_of, of_run, of_runs, path_of
from labbook.export.viewer import ViewerFailed, show
from labbook.export.viewer import screenshot as photograph
from labbook.lab import NoCatalogue, RunRecord, Unreadable


def view(
    targets: list[str], point: int | None, screenshot: Path | None, at: float, size: str, open_viewer: bool, lab: Path,
    backend: str,
) -> None:  # fmt: skip
    """Make the recordings of a study or a run, or one of several side by side, and show or photograph them."""
    sides = re.fullmatch(r"(\d{2,5})x(\d{2,5})", size)
    if sides is None:
        fail(f"--size: {size} is not WIDTHxHEIGHT in pixels, such as 1100x1200")
    if len(targets) > SIDE_BY_SIDE:
        fail(f"{len(targets)} are too many side by side; name at most {SIDE_BY_SIDE}")
    try:
        if len(targets) > 1:
            runs = [_first(target, point, lab, backend) for target in targets]
            recordings = [beside(runs, lab)]
        else:
            files = of_recorded(
                targets[0], point, lab, backend, lambda run: (run, of_run(run.folder, lab, run.study, run.point))
            )
            runs, recordings = [run for run, _ in files], [path for _, path in files]
        for path in recordings:
            say(f"Recording: {path}")
        if screenshot is not None:
            photograph(recordings[0], screenshot, at, (int(sides[1]), int(sides[2])))
            say(f"Picture: {screenshot}")
        elif open_viewer:
            show(recordings, middle_of([run.folder for run in runs]))
    except (NoCatalogue, Unreadable, NotRecorded, ViewerMissing, ViewerFailed) as error:
        fail(error)


def _first(target: str, point: int | None, lab: Path, backend: str) -> Recorded:
    """The first recorded run of a study, or the run."""
    return of_recorded(target, point, lab, backend, lambda run: run)[0]


def beside(runs: list[Recorded], lab: Path) -> Path:
    """The recording of runs side by side: LAB/recordings/side-by-side/STUDY-point-1-seed-1-BACKEND_....rrd."""
    files = [path_of(Path(), RunRecord.read(run.folder), run.study, run.point, "") for run in runs]
    name = "_".join(f"{file.parent.name}-{file.name}" for file in files)
    return of_runs([run.folder for run in runs], lab / "recordings" / "side-by-side" / f"{name}.rrd")
