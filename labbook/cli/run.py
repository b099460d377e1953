"""`labbook run`: carry out what a study still needs."""

import shlex
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from labbook.cli.lab import Device, backend_called, open_catalogue
from labbook.cli.options import BACKEND, GO_ON, LAB, STOPPED, Lab, RunsOn, StudyFile, fail, leave, read_study
from labbook.cli.screen import say, screen

if TYPE_CHECKING:
    from labbook.run.runner import Summary

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
    ) -> None:
        """Run what a study still needs. Ctrl-C leaves everything resumable: give the same command again.

        A second Ctrl-C leaves at once; what was saved last is kept. Exit status: 0 if all runs of the study are there,
        1 if some failed or diverged, 130 if it was stopped.
        """
        from labbook.backend import Unsupported
        from labbook.lab.folder import DiskFull
        from labbook.lab.folder import Lab as Folder
        from labbook.measure import MeasureError
        from labbook.run.demand import Conflict
        from labbook.run.plan import Planner
        from labbook.run.progress import Bar
        from labbook.run.reach import cut_short
        from labbook.run.runner import Runner

        asked, chosen = read_study(study), backend_called(backend)
        console = screen(highlight=False, markup=False)
        if asked.stop.fill_height is not None:
            try:
                ahead = Planner(asked, open_catalogue(lab), chosen.capabilities).plan()
            except (Conflict, MeasureError) as problem:
                fail(problem)
            for line in cut_short(ahead, Folder(lab)):
                say(line, err=True)
        try:
            with Bar(screen(stderr=True)) as bar:
                summary = Runner(asked, Folder(lab), chosen, device, checkpoint_every, bar).run()
        except (Unsupported, Conflict, MeasureError, DiskFull) as problem:
            fail(problem)
        except KeyboardInterrupt:
            with suppress(OSError):
                typer.echo(f"Left at once; what was saved last is kept: {GO_ON}", err=True)
            leave(STOPPED)
        with suppress(OSError):  # the terminal is gone: all is saved, and nobody reads it
            for line in report(summary):
                console.print(line, soft_wrap=not console.is_terminal)
            for line in advice(summary, study, lab, backend):
                console.print(line, soft_wrap=True)  # commands stay in one piece
        if summary.left_behind:
            leave(STOPPED)
        if summary.stopped:
            raise typer.Exit(STOPPED)
        if summary.tally.failed or diverged(summary):
            raise typer.Exit(1)


def report(summary: "Summary") -> list[str]:
    """What came of it, line by line."""
    from collections import Counter

    from labbook.run.plan import counted
    from labbook.run.progress import duration

    tally = summary.tally
    outcomes = Counter(tally.ran.values())
    done, asked = counted(summary.points)
    lines = [f"{done} of {asked} runs done"]
    if tally.ran or tally.packings:
        rate = summary.work_done / summary.wall_time
        what = ", ".join(f"{count} {outcome}" for outcome, count in outcomes.items()) or "none ended"
        made = f"{tally.packings} packing{'' if tally.packings == 1 else 's'}"
        lines[0] += f"; now: {what}; {made}; {duration(summary.wall_time)}"
        lines[0] += f", {rate / 1e6:.2f} M grain-steps/s"
    if tally.resumed:
        lines.append(f"{tally.resumed} went on from a checkpoint")
    for point in summary.points:
        decision = point.decision
        if decision and decision.ended and decision.pooled:
            short = "" if decision.ended == "tolerance" else ": the tolerance is not met, and no more are allowed"
            lines.append(
                f"{point.shared.point.label}: flow rate to {decision.pooled.relative:.2%} "
                f"with {decision.pooled.n} replicates{short}"
            )
    for label, seeds in diverged(summary).items():
        many = f"seeds {', '.join(map(str, seeds))}" if len(seeds) > 1 else f"seed {seeds[0]}"
        lines.append(f"Diverged: {label}, {many}: stopped by a guard, and left out of every mean")
    lines += [f"Failed: {why}" for why in tally.failed]
    lines += [f"Unreadable: {problem}" for problem in summary.problems]
    if summary.stopped:
        lines.append(f"Stopped early; everything is saved: {GO_ON}")
    return lines


def diverged(summary: "Summary") -> dict[str, list[int]]:
    """Seeds of the runs that diverged, now or earlier, by the label of their point."""
    found: dict[str, list[int]] = {}
    for point in summary.points:
        for item in point.items:
            if item.state == "done" and item.outcome == "diverged":
                found.setdefault(item.demand.point.label, []).append(item.demand.seed)
    return found


def advice(summary: "Summary", study: Path, lab: Path, backend: str) -> list[str]:
    """What to do next, as commands."""
    from labbook.run.plan import counted

    there = f" --lab {shlex.quote(str(lab))}" if lab != LAB else ""
    given = shlex.quote(str(study)) + there + (f" --backend {backend}" if backend != BACKEND else "")
    lost = diverged(summary)
    lines = (
        [f"Which runs diverged, and how: labbook runs --outcome diverged{there}; labbook show RUN{there}"]
        if lost
        else []
    )
    done, _ = counted(summary.points)
    if done and not summary.stopped:
        lines.append(f"Next: labbook report {given}")
        if any(item.demand.recorded for point in summary.points for item in point.items):
            lines.append(f"      labbook view {given}")
    return lines
