"""`labbook plan`: what a study still needs, and why."""

import typer

from labbook.cli.options import BACKEND, LAB, AsJson, Device, Lab, RunsOn, StudyFile


def register(app: typer.Typer) -> None:
    """Add the command to the app."""

    @app.command()
    def plan(
        study: StudyFile, lab: Lab = LAB, backend: RunsOn = BACKEND, device: Device = "cpu", as_json: AsJson = False
    ) -> None:
        """Show which runs are done, missing, partial or stale and why, and forecast time and disk space."""
        from labbook.cli.work import plan as work

        work.plan(study, lab, backend, device, as_json)
