"""A comparison of two backends, made or shown."""

import json
from contextlib import suppress
from pathlib import Path

import typer

from labbook.backend import BackendMissing, Unsupported
from labbook.checks.compare import shown
from labbook.checks.compare.compare import Stopped, select_points, stale
from labbook.checks.compare.compare import compare as compared
from labbook.checks.compare.lockstep import record as record_both
from labbook.checks.compare.sides import CannotCompare
from labbook.checks.compare.verdict import NoVerdict, Verdict, path_of
from labbook.cli.options import GO_ON, STOPPED, fail, leave, read_study
from labbook.cli.screen import print_table, say, screen
from labbook.cli.work.sides import names_of, parse
from labbook.commands import command
from labbook.export.entities import ViewerMissing
from labbook.lab.folder import LabFolder
from labbook.measure import MeasureError
from labbook.plan.demand import Conflict
from labbook.report.style import save
from labbook.run.progress import Bar


def compare(
    study: Path,
    backends: str,
    devices: str,
    precisions: str | None,
    margin: float,
    replicates: int | None,
    point: list[int] | None,
    show: bool,
    record: float | None,
    lab: Path,
    as_json: bool,
) -> None:
    """Print the verdict on two backends, made now or stored; exit with 1 if they differ."""
    definition, failed = read_study(study), []
    try:
        path = path_of(LabFolder(lab), definition.name, *names_of(backends, precisions))
        if show:
            verdict = Verdict.read(path)
        else:
            sides = backends, devices, precisions
            verdict, failed = _compare(definition, LabFolder(lab), sides, margin, replicates, point or [], record, path)
    except CannotCompare as problem:
        fail(problem)
    except NoVerdict as problem:
        sides = ["--backends", backends, *(["--precisions", precisions] if precisions else [])]
        fail(f"{problem}; make one: {command('compare', study, *sides, lab=lab)}")
    _tell(verdict, definition, path.parent, as_json)
    for why in failed:
        say(f"Failed: {why}", err=True)
    if failed or verdict.finding == "different":
        raise typer.Exit(1)


def _compare(definition, lab, sides, margin, replicates, points: list[int], seconds: float | None, path: Path):
    """The verdict and what failed; everything that is missing is made."""
    console = screen(stderr=True, highlight=False, markup=False)
    try:
        pair = parse(*sides)
        study = select_points(definition, [number - 1 for number in points], replicates)
        with Bar(console) as bar:
            verdict, failed = compared(study, lab, pair, margin, bar, lambda what: console.print(what, style="dim"))
        save(shown.figure(verdict), path.with_suffix(""))
        if seconds is not None:
            recording = record_both(study, study.points[0], lab, pair, seconds, path.with_suffix(".rrd"))
            console.print(f"Recording: {recording}")
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


def _tell(verdict: Verdict, definition, folder: Path, as_json: bool) -> None:
    """Print a verdict."""
    reasons = stale(verdict, definition)
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
