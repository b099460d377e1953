"""`labbook compare`: two backends on the same study."""

from typing import Annotated

import typer

from labbook.cli.options import LAB, AsJson, Lab, StudyFile


def register(app: typer.Typer) -> None:
    """Add the command to the app."""

    @app.command()
    def compare(
        study: StudyFile,
        backends: Annotated[
            str, typer.Option(help="Two backends; the first one makes the shared packings.")
        ] = "numba,warp",
        devices: Annotated[str, typer.Option(help="Devices of the two, such as cpu,cuda:0.")] = "cpu,cpu",
        precisions: Annotated[
            str | None,
            typer.Option(help="Precisions of the two, such as double,mixed; default: the study's.", show_default=False),
        ] = None,
        margin: Annotated[
            float,
            typer.Option(
                min=1e-6, max=1, help="Equivalence margin: largest relative difference of means that counts as equal."
            ),
        ] = 0.03,
        replicates: Annotated[
            int | None,
            typer.Option(min=2, help="Replicates per point; default: the study's number.", show_default=False),
        ] = None,
        point: Annotated[
            list[int] | None,
            typer.Option(min=1, help="Only this point, counted from 1; may be repeated.", show_default=False),
        ] = None,
        show: Annotated[
            bool, typer.Option("--show", help="Only show the stored verdict and whether it is stale.")
        ] = False,
        record: Annotated[
            float | None,
            typer.Option(
                min=0.001,
                show_default=False,
                help="Also write a rerun recording of both backends side by side, so many seconds from the opening.",
            ),
        ] = None,
        lab: Lab = LAB,
        as_json: AsJson = False,
    ) -> None:
        """Compare two backends: how long their motions agree, whether their measurements agree, and their cost.

        Missing runs are made first. Exit status 1 if a difference beyond the margin is found.
        """
        from labbook.cli.work import compare as work

        work.compare(study, backends, devices, precisions, margin, replicates, point, show, record, lab, as_json)
