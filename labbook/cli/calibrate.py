"""`labbook calibrate`: what numerics do to the flow rate of a study."""

from pathlib import Path
from typing import Annotated

import typer

from labbook.cli.options import BACKEND, LAB, Device, Lab, RunsOn, StudyFile, fail, read_study
from labbook.cli.screen import screen

Seeds = Annotated[int, typer.Option(help="Runs of each setting.", min=3)]
Out = Annotated[
    Path | None,
    typer.Option(help="Calibration file to write.", show_default="STUDY.calibration.json beside the study"),
]


def register(app: typer.Typer) -> None:
    """Add the verb."""

    @app.command()
    def calibrate(
        study: StudyFile,
        lab: Lab = LAB,
        backend: RunsOn = BACKEND,
        device: Device = "cpu",
        seeds: Seeds = 8,
        out: Out = None,
    ) -> None:
        """Measure what time step and stiffness do to the flow rate of a study.

        Runs a pilot: seven settings of its numerics at its first and last point, from shared packings. The file that it
        writes goes into the study as accuracy.calibration, and labbook then chooses numerics for accuracy.flow_rate.
        A study that sweeps numerics itself is run as it is. Ctrl-C leaves everything resumable.
        """
        from labbook.api import Lab as Place
        from labbook.backend import BackendMissing, Unsupported
        from labbook.lab import NoCatalogue
        from labbook.lab.folder import DiskFull
        from labbook.measure import MeasureError
        from labbook.results.calibrating import NotCalibrated, write
        from labbook.run.demand import Conflict
        from labbook.run.progress import Bar
        from labbook.study import StudyError

        asked = read_study(study)
        path = out or study.with_suffix(".calibration.json")
        try:
            with Bar(screen(stderr=True)) as bar:
                found = Place(lab, backend, device).calibrate(asked, seeds, bar)
        except (BackendMissing, NoCatalogue, Unsupported, Conflict, MeasureError, DiskFull, StudyError) as problem:
            fail(problem)
        except NotCalibrated as problem:
            fail(f"{asked.name} cannot be calibrated: {problem}")
        write(path, [found.entry])
        console = screen(highlight=False, markup=False)
        for line in found.lines():
            console.print(line, soft_wrap=True)
        console.print(f"Written: {path}", soft_wrap=True)
        name = path.name if path.resolve().parent == study.resolve().parent else path
        console.print(f"Next, in {study}: accuracy: {{flow_rate: 1 %, calibration: {name}}}", soft_wrap=True)
