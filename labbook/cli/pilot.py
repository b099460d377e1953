"""`labbook pilot`: what numerics do to the flow rate of a study."""

from pathlib import Path
from typing import Annotated

import typer

from labbook.cli.options import BACKEND, LAB, Device, Lab, RunsOn, fail, read_study
from labbook.cli.screen import screen

Studies = Annotated[list[Path], typer.Argument(help="Study files (YAML).", metavar="STUDY...", show_default=False)]
Seeds = Annotated[int, typer.Option(help="Replicates of each setting.", min=3)]
Out = Annotated[
    Path | None,
    typer.Option(help="Calibration file to write.", show_default="STUDY.calibration.json beside the first study"),
]


def register(app: typer.Typer) -> None:
    """Add the command to the app."""

    @app.command()
    def pilot(
        studies: Studies,
        lab: Lab = LAB,
        backend: RunsOn = BACKEND,
        device: Device = "cpu",
        seeds: Seeds = 8,
        out: Out = None,
    ) -> None:
        """Measure the effect of time step and stiffness on the flow rate of studies.

        Runs a pilot of each study: seven settings of numerics at its first, middle and last point, with shared beds.
        Writes one calibration file for all. From it labbook chooses the numerics for accuracy.flow_rate. A study
        uses the file with its own name, or the one named as accuracy.calibration. A study that sweeps numerics is
        run as it is. After Ctrl-C the same command goes on.
        """
        from labbook.accuracy import BESIDE, write
        from labbook.api import Lab as OpenLab
        from labbook.api import effects_of_numerics
        from labbook.backend import BackendMissing, Unsupported
        from labbook.lab import NoCatalogue
        from labbook.lab.folder import DiskFull
        from labbook.measure import MeasureError
        from labbook.plan.demand import Conflict
        from labbook.results.calibrating import NotCalibrated
        from labbook.run.progress import Bar
        from labbook.study import StudyError
        from labbook.study.pilot import whole

        path = out or studies[0].with_suffix(BESIDE)
        open_lab, effects = OpenLab(lab, backend, device), []
        for study in [read_study(study) for study in studies]:
            try:
                with Bar(screen(stderr=True)) as bar:
                    effects += effects_of_numerics(open_lab, whole(study, seeds), bar)
            except (BackendMissing, NoCatalogue, Unsupported, Conflict, MeasureError, DiskFull, StudyError) as problem:
                fail(problem)
            except NotCalibrated as problem:
                fail(f"{study.name} cannot be calibrated: {problem}")
        write(path, [result.effects for result in effects])
        console = screen(highlight=False, markup=False)
        for line in (line for result in effects for line in result.lines()):
            console.print(line, soft_wrap=True)
        console.print(f"Written: {path}", soft_wrap=True)
        name = path.name if path.resolve().parent == studies[0].resolve().parent else path
        option = "" if path == studies[0].with_suffix(BESIDE) else f", calibration: {name}"
        console.print(f"Next, in {studies[0]}: accuracy: {{flow_rate: 1 %{option}}}", soft_wrap=True)
