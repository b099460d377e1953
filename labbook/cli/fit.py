"""`labbook fit`: what a study found, as tables; or the design that gives a wanted value."""

from typing import Annotated

import typer

from labbook.cli.options import BACKEND, LAB, AsJson, Backend, Lab, StudyFile, results

Want = Annotated[
    str | None,
    typer.Option(
        "--want",
        help="Show only the value of the swept key that gives this, such as 'flow_rate = 50 g/s'.",
        metavar="QUANTITY = VALUE",
        show_default=False,
    ),
]
Over = Annotated[
    str | None,
    typer.Option("--over", help="Key to vary for --want, if several are swept.", metavar="KEY", show_default=False),
]
At = Annotated[
    list[str] | None,
    typer.Option(
        "--at", help="Value of another swept key for --want; repeatable.", metavar="KEY = VALUE", show_default=False
    ),
]


def register(app: typer.Typer) -> None:
    """Add the verb."""

    @app.command()
    def fit(
        study: StudyFile,
        want: Want = None,
        over: Over = None,
        at: At = None,
        lab: Lab = LAB,
        backend: Backend = BACKEND,
        as_json: AsJson = False,
    ) -> None:
        """Show flow rates with errors, fits with intervals, and the comparison with the reference.

        With --want, show the value of the swept key that gives a wanted quantity, with its 95 % interval. It follows
        from a fitted law if the points allow it, else from interpolation, and lies within the swept range.

        Exit status: 1 if the study has no finished run, or no value within the swept range gives what is wanted.
        """
        from labbook.cli.work.fit import answer, show

        if want is None and (over is not None or at):
            raise typer.BadParameter("needs --want", param_hint="--over" if over is not None else "--at")
        study_results = results(study, lab, backend)
        if want is None:
            show(study_results, as_json)
        else:
            answer(study_results, want, over, at or [], as_json)
