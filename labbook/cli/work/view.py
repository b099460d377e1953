"""Recordings of runs, made if missing, and the rerun viewer."""

import re
from pathlib import Path

from labbook.cli.options import fail
from labbook.cli.screen import say
from labbook.cli.work.recorded import of_recorded
from labbook.export.frames import NotRecorded
from labbook.export.recording import ViewerMissing, of_run
from labbook.export.viewer import ViewerFailed, show
from labbook.export.viewer import screenshot as photograph
from labbook.lab import NoCatalogue, Unreadable


def view(
    target: str, point: int | None, screenshot: Path | None, at: float, size: str, open_viewer: bool, lab: Path,
    backend: str,
) -> None:  # fmt: skip
    """Make the recordings of a study or a run, and show or photograph them."""
    sides = re.fullmatch(r"(\d{2,5})x(\d{2,5})", size)
    if sides is None:
        fail(f"--size: {size} is not WIDTHxHEIGHT in pixels, such as 1100x1200")
    try:
        recordings = of_recorded(target, point, lab, backend, lambda run: of_run(run.folder, lab, run.study, run.point))
        for path in recordings:
            say(f"Recording: {path}")
        if screenshot is not None:
            photograph(recordings[0], screenshot, at, (int(sides[1]), int(sides[2])))
            say(f"Picture: {screenshot}")
        elif open_viewer:
            show(recordings)
    except (NoCatalogue, Unreadable, NotRecorded, ViewerMissing, ViewerFailed) as error:
        fail(error)
