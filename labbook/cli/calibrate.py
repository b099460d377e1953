"""`labbook calibrate`: parameters of the contact law from measurements."""

from pathlib import Path
from typing import Annotated

import typer

from labbook.cli.options import BACKEND, LAB, AsJson, Device, Lab, RunsOn, StudyFile

Runs = Annotated[bool, typer.Option("--run/--no-run", help="Make missing runs first, or use the finished ones only.")]
Card = Annotated[
    Path | None,
    typer.Option("--card", help="Material card to write.", show_default="STUDY.material.yaml beside the study"),
]


def register(app: typer.Typer) -> None:
    """Add the command to the app."""

    @app.command()
    def calibrate(
        study: StudyFile,
        lab: Lab = LAB,
        backend: RunsOn = BACKEND,
        device: Device = "cpu",
        run: Runs = True,
        card: Card = None,
        as_json: AsJson = False,
    ) -> None:
        """Find the parameters with which runs agree with measured values.

        Parameters and priors are those of `calibrate` in the study, measured values those of `reference`. Makes the
        runs that are missing, round by round, until the emulator of the runs is good enough. Shows each parameter with
        its 95 % interval, the ridge, predictions, and the experiment that would tell most next. Writes a material
        card, which a study takes in by `include`. After Ctrl-C the same command goes on.

        Exit status: 1 if the runs do not give an answer.
        """
        from labbook.cli.work import calibrate as work

        work.run(study, lab, backend, device, run, card, as_json)
