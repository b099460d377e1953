"""`labbook compare`: two backends on the same study."""

import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from labbook.cli.options import GO_ON, LAB, STOPPED, AsJson, Lab, StudyFile, fail, leave, read_study
from labbook.cli.screen import say, screen

if TYPE_CHECKING:
    from labbook.compare.verdict import Verdict

Backends = Annotated[str, typer.Option("--backends", help="Two backends; the first one makes the shared packings.")]
Devices = Annotated[str, typer.Option("--devices", help="Their devices, such as cpu,cuda:0.")]
Precisions = Annotated[
    str | None,
    typer.Option("--precisions", help="Theirs, such as double,mixed, instead of the study's.", show_default=False),
]
Margin = Annotated[
    float, typer.Option("--margin", min=1e-6, max=1, help="Difference of means that counts as none, as a part of them.")
]
Replicates = Annotated[
    int | None,
    typer.Option("--replicates", min=2, help="Replicates a point, instead of the study's.", show_default=False),
]
Points = Annotated[
    list[int] | None,
    typer.Option("--point", min=1, help="Only this point, counted from 1; may be repeated.", show_default=False),
]
Show = Annotated[bool, typer.Option("--show", help="Only show the stored verdict, and whether it is stale.")]
Record = Annotated[
    float | None,
    typer.Option(
        "--record",
        min=0.001,
        help="Also write a rerun recording of both backends side by side, so many seconds from the opening.",
        show_default=False,
    ),
]


def register(app: typer.Typer) -> None:
    """Add the verb."""

    @app.command()
    def compare(
        study: StudyFile,
        backends: Backends = "numba,warp",
        devices: Devices = "cpu,cpu",
        precisions: Precisions = None,
        margin: Margin = 0.03,
        replicates: Replicates = None,
        point: Points = None,
        show: Show = False,
        record: Record = None,
        lab: Lab = LAB,
        as_json: AsJson = False,
    ) -> None:
        """Compare two backends: how long they agree, whether they measure the same, and what each costs.

        Runs that are missing are made first. Exit status 1 if a difference beyond the margin is found.
        """
        from labbook.compare.pair import WrongPair
        from labbook.compare.verdict import NoVerdict

        asked = read_study(study)
        try:
            if show:
                verdict, failed = _stored(asked, lab, backends, precisions), []
            else:
                sides = backends, devices, precisions
                verdict, failed = _made(asked, lab, sides, margin, replicates, point or [], record)
        except WrongPair as problem:
            fail(problem)
        except NoVerdict as problem:
            fail(f"{problem}; make one: labbook compare {study} --backends {backends} --lab {lab}")
        _tell(verdict, asked, lab, as_json)
        for why in failed:
            say(f"Failed: {why}", err=True)
        if failed or verdict.finding == "different":
            raise typer.Exit(1)


def _stored(asked, lab: Path, backends: str, precisions: str | None) -> "Verdict":
    from labbook.compare.pair import names_of
    from labbook.compare.verdict import Verdict, folder_of, stem
    from labbook.lab.folder import Lab as Folder

    return Verdict.read(folder_of(Folder(lab), asked.name) / f"{stem(*names_of(backends, precisions))}.json")


def _made(asked, lab: Path, sides, margin: float, replicates: int | None, points: list[int], seconds: float | None):
    from labbook.backend import BackendMissing, Unsupported
    from labbook.compare.carry import Stopped
    from labbook.compare.compare import CannotCompare, compare, narrowed
    from labbook.compare.figure import figure
    from labbook.compare.pair import pair
    from labbook.compare.recording import record
    from labbook.compare.verdict import folder_of, stem
    from labbook.export.recording import ViewerMissing
    from labbook.lab import NoCatalogue, Unreadable
    from labbook.lab.folder import DiskFull
    from labbook.lab.folder import Lab as Folder
    from labbook.measure import MeasureError
    from labbook.report.style import save
    from labbook.run.demand import Conflict
    from labbook.run.progress import Bar

    console = screen(stderr=True, highlight=False, markup=False)
    folder = Folder(lab)
    try:
        two = pair(*sides)
        study = narrowed(asked, tuple(number - 1 for number in points), replicates)
        with Bar(console) as bar:
            verdict, failed = compare(study, folder, two, margin, bar, lambda what: console.print(what, style="dim"))
        path = folder_of(folder, study.name) / stem(two[0].name, two[1].name)
        save(figure(verdict), path)
        if seconds is not None:
            made = record(study, study.points[0], folder, two, seconds, path.with_suffix(".rrd"))
            console.print(f"Recording: {made}")
    except (CannotCompare, BackendMissing, Unsupported, Conflict, MeasureError) as problem:
        fail(problem)
    except (NoCatalogue, Unreadable, DiskFull, ViewerMissing) as problem:
        fail(problem)
    except Stopped as stopped:
        with suppress(OSError):
            typer.echo(f"Stopped early; everything is saved: {GO_ON}", err=True)
        if stopped.left_behind:
            leave(STOPPED)
        raise typer.Exit(STOPPED) from None
    except KeyboardInterrupt:
        with suppress(OSError):
            typer.echo(f"Left at once; what was saved last is kept: {GO_ON}", err=True)
        leave(STOPPED)
    return verdict, failed


def _tell(verdict: "Verdict", asked, lab: Path, as_json: bool) -> None:
    import json

    from labbook.cli.screen import print_table
    from labbook.compare import tables
    from labbook.compare.stale import stale
    from labbook.compare.verdict import folder_of
    from labbook.lab.folder import Lab as Folder

    reasons = stale(verdict, asked)
    if as_json:
        plain = {"finding": verdict.finding, "stale": reasons, **verdict.model_dump(mode="json")}
        typer.echo(json.dumps(plain, indent=2, allow_nan=False))
        return
    console = screen(highlight=False, width=None if sys.stdout.isatty() else 160)
    console.print(f"[bold]{verdict.study}[/bold], compared {verdict.made}")
    for reason in reasons:
        console.print(f"STALE: {reason}", style="red", markup=False)
    for sentence in tables.summary(verdict):
        console.print(sentence, markup=False)
    print_table(console, tables.contrast_table(verdict), "Means")
    print_table(console, tables.divergence_table(verdict), "The same packing, side by side")
    print_table(console, tables.cost_table(verdict), "Cost")
    console.print(f"Verdict and figure: {folder_of(Folder(lab), verdict.study)}", markup=False)
