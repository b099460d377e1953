"""`labbook show`: everything about one run."""

from typing import Annotated

import typer

from labbook.cli.options import LAB, AsJson, Lab

Key = Annotated[
    str, typer.Argument(help="Key of the run, or the first digits of it.", metavar="RUN", show_default=False)
]


def register(app: typer.Typer) -> None:
    """Add the command to the app."""

    @app.command()
    def show(run: Key, lab: Lab = LAB, as_json: AsJson = False) -> None:
        """Show one run: its outcome, its numbers and their provenance, and its note.

        Notes are text files that you write: LAB/notes/runs/KEY.md for a run, LAB/notes/studies/NAME.md for a study.
        Their first line may list tags: `tags: slow, for-the-paper`.
        """
        from labbook.cli.work import show as work

        work.show(run, lab, as_json)
