"""`labbook compare`: two backends on the same study."""

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from labbook.cli.options import GO_ON, LAB, STOPPED, AsJson, Lab, StudyFile, fail, leave, read_study
from labbook.cli.screen import say, screen
from labbook.commands import command

if TYPE_CHECKING:
    from labbook.checks.compare.verdict import Verdict


def register(app: typer.Typer) -> None:
    """Add the verb."""

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
                min=1e-6, max=1, help="Margin of equivalence: relative difference of means that counts as none."
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
        from labbook.checks.compare.sides import CannotCompare
        from labbook.checks.compare.verdict import NoVerdict, Verdict, path_of
        from labbook.cli.sides import names_of
        from labbook.lab.folder import LabFolder

        asked, failed = read_study(study), []
        try:
            path = path_of(LabFolder(lab), asked.name, *names_of(backends, precisions))
            if show:
                verdict = Verdict.read(path)
            else:
                sides = backends, devices, precisions
                verdict, failed = _made(asked, LabFolder(lab), sides, margin, replicates, point or [], record, path)
        except CannotCompare as problem:
            fail(problem)
        except NoVerdict as problem:
            sides = ["--backends", backends, *(["--precisions", precisions] if precisions else [])]
            fail(f"{problem}; make one: {command('compare', study, *sides, lab=lab)}")
        _tell(verdict, asked, path.parent, as_json)
        for why in failed:
            say(f"Failed: {why}", err=True)
        if failed or verdict.finding == "different":
            raise typer.Exit(1)


def _made(asked, lab, sides, margin, replicates, points: list[int], seconds: float | None, path: Path):
    """The verdict and what failed; everything that is missing is made."""
    from labbook.backend import BackendMissing, Unsupported
    from labbook.checks.compare.compare import Stopped, compare, narrowed
    from labbook.checks.compare.lockstep import record
    from labbook.checks.compare.shown import figure
    from labbook.cli.sides import parse
    from labbook.export.recording import ViewerMissing
    from labbook.measure import MeasureError
    from labbook.plan.demand import Conflict
    from labbook.report.style import save
    from labbook.run.progress import Bar

    console = screen(stderr=True, highlight=False, markup=False)
    try:
        pair = parse(*sides)
        study = narrowed(asked, [number - 1 for number in points], replicates)
        with Bar(console) as bar:
            verdict, failed = compare(study, lab, pair, margin, bar, lambda what: console.print(what, style="dim"))
        save(figure(verdict), path.with_suffix(""))
        if seconds is not None:
            made = record(study, study.points[0], lab, pair, seconds, path.with_suffix(".rrd"))
            console.print(f"Recording: {made}")
    except (BackendMissing, Unsupported, Conflict, MeasureError, ViewerMissing) as problem:
        fail(problem)
    except Stopped as stopped:
        with suppress(OSError):
            say(f"Stopped early; everything is saved: {GO_ON}", err=True)
        if stopped.left_behind:
            leave(STOPPED)
        raise typer.Exit(STOPPED) from None
    except KeyboardInterrupt:
        with suppress(OSError):
            say(f"Stopped at once; the last checkpoints are kept: {GO_ON}", err=True)
        leave(STOPPED)
    return verdict, failed


def _tell(verdict: "Verdict", asked, folder: Path, as_json: bool) -> None:
    import json

    from labbook.checks.compare import shown
    from labbook.checks.compare.compare import stale
    from labbook.cli.screen import print_table

    reasons = stale(verdict, asked)
    if as_json:
        plain = {"finding": verdict.finding, "stale": reasons, **verdict.model_dump(mode="json")}
        typer.echo(json.dumps(plain, indent=2, allow_nan=False))
        return
    console = screen(highlight=False)
    console.print(f"[bold]{verdict.study}[/bold], compared {verdict.made}")
    for reason in reasons:
        console.print(f"STALE: {reason}", style="red", markup=False)
    for sentence in shown.summary(verdict):
        console.print(sentence, markup=False)
    print_table(console, shown.contrast_table(verdict), "Means")
    print_table(console, shown.divergence_table(verdict), "The same packing, side by side")
    print_table(console, shown.cost_table(verdict), "Cost")
    console.print(f"Verdict and figure: {folder}", markup=False)
