"""`labbook run`: carry out what a study still needs."""

import shlex
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from labbook.cli.options import BACKEND, GO_ON, LAB, STOPPED, Device, Lab, RunsOn, StudyFile, fail, leave, read_study
from labbook.cli.screen import screen

if TYPE_CHECKING:
    from labbook.run.runner import Summary

Part = Annotated[
    str | None, typer.Option("--shard", help="Run only part i of n, such as 1/4.", metavar="I/N", show_default=False)
]
Every = Annotated[float, typer.Option("--checkpoint-every", help="Seconds between two checkpoints of a run.", min=0)]


def register(app: typer.Typer) -> None:
    """Add the verb."""

    @app.command()
    def run(
        study: StudyFile,
        lab: Lab = LAB,
        backend: RunsOn = BACKEND,
        device: Device = "cpu",
        checkpoint_every: Every = 20,
        shard: Part = None,
    ) -> None:
        """Run what a study still needs. Ctrl-C leaves everything resumable: give the same command again.

        Several processes may run one study in one lab, and share the work. With --shard each knows its part beforehand:
        one process a part, in one lab or in several.

        A second Ctrl-C leaves at once; what was saved last is kept. Exit status: 0 if all runs of the study are there,
        1 if some failed, diverged or are suspect, 130 if it was stopped.
        """
        from labbook.api import Lab as Place
        from labbook.backend import BackendMissing, Unsupported
        from labbook.lab import NoCatalogue
        from labbook.lab.folder import DiskFull
        from labbook.measure import MeasureError
        from labbook.run.demand import Conflict
        from labbook.run.progress import Bar
        from labbook.run.shard import Shard

        asked = read_study(study)
        if shard is not None:
            try:
                Shard.parse(shard)
            except ValueError as problem:
                fail(f"--shard: {problem}")
        console = screen(highlight=False, markup=False)
        try:
            with Bar(screen(stderr=True)) as bar:
                summary = Place(lab, backend, device).run(asked, bar, checkpoint_every, shard)
        except (BackendMissing, NoCatalogue, Unsupported, Conflict, MeasureError, DiskFull) as problem:
            fail(problem)
        except KeyboardInterrupt:
            with suppress(OSError):
                typer.echo(f"Left at once; what was saved last is kept: {GO_ON}", err=True)
            leave(STOPPED)
        with suppress(OSError):  # the terminal is gone: all is saved, and nobody reads it
            for line in told(summary):
                console.print(line, soft_wrap=not console.is_terminal)
            for line in advice(summary, study, lab, backend):
                console.print(line, soft_wrap=True)  # commands stay in one piece
        if summary.left_behind:
            leave(STOPPED)
        if summary.stopped:
            raise typer.Exit(STOPPED)
        if summary.failed or summary.diverged or summary.suspect:
            raise typer.Exit(1)


def told(summary: "Summary") -> list[str]:
    """What came of it, line by line."""
    return summary.lines() + ([f"Stopped early; everything is saved: {GO_ON}"] if summary.stopped else [])


def advice(summary: "Summary", study: Path, lab: Path, backend: str) -> list[str]:
    """What to do next, as commands."""
    there = f" --lab {shlex.quote(str(lab))}" if lab != LAB else ""
    given = shlex.quote(str(study)) + there + (f" --backend {backend}" if backend != BACKEND else "")
    lines = (
        [f"Which runs diverged, and how: labbook runs --outcome diverged{there}; labbook show RUN{there}"]
        if summary.diverged
        else []
    )
    if summary.suspect:
        lines.append(f"Which runs are suspect, and why: labbook runs --outcome suspect{there}")
    if summary.done and not summary.stopped:
        lines.append(f"Next: labbook report {given}")
        if any(item.demand.recorded for point in summary.points for item in point.items):
            lines.append(f"      labbook view {given}")
    return lines
