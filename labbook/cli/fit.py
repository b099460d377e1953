"""`labbook fit`: what a study found, as tables; the design that gives a wanted value; what matters and what to run."""

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
        "--at",
        help="Value of another swept key for --want or --explore; repeatable.",
        metavar="KEY = VALUE",
        show_default=False,
    ),
]
Explore = Annotated[
    str | None,
    typer.Option(
        "--explore",
        help="Show only what matters for this quantity, such as flow_rate, and what to run next.",
        metavar="QUANTITY",
        show_default=False,
    ),
]


def register(app: typer.Typer) -> None:
    """Add the command to the app."""

    @app.command()
    def fit(
        study: StudyFile,
        want: Want = None,
        over: Over = None,
        at: At = None,
        explore: Explore = None,
        lab: Lab = LAB,
        backend: Backend = BACKEND,
        as_json: AsJson = False,
    ) -> None:
        """Show flow rates with errors, fits with intervals, and the comparison with the reference.

        With --want, show the value of the swept key that gives a wanted quantity, with its 95 % interval. It follows
        from a fitted law if the points allow it, else from interpolation, and lies within the swept range. If several
        keys are swept and no point has the values of --at, it follows from a surface over all keys.

        With --explore, show the share of each swept key in the variance of a quantity, and the designs at which more
        runs narrow the surface most for each second of run time.

        Exit status: 1 if the study has no finished run, or no value within the swept range gives what is wanted.
        """
        from labbook.cli.work.fit import answer, show, show_explored

        if want is not None and explore is not None:
            raise typer.BadParameter("give --want or --explore, not both", param_hint="--explore")
        if want is None and (over is not None or (at and explore is None)):
            raise typer.BadParameter("needs --want", param_hint="--over" if over is not None else "--at")
        study_results = results(study, lab, backend)
        if explore is not None:
            show_explored(study_results, explore, at or [], as_json)
        elif want is None:
            show(study_results, as_json)
        else:
            answer(study_results, want, over, at or [], as_json)
