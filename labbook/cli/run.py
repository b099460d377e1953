"""`labbook run`: carry out what a study still needs."""

from typing import TYPE_CHECKING, Annotated

import typer

from labbook.cli.lab import Device, engine_called, open_catalogue
from labbook.cli.options import ENGINE, LAB, Engine, Lab, StudyFile, fail, read_study
from labbook.cli.screen import say, screen

if TYPE_CHECKING:
    from labbook.runner.runner import Summary

Every = Annotated[float, typer.Option("--checkpoint-every", help="Seconds between two checkpoints of a run.", min=0)]


def register(app: typer.Typer) -> None:
    """Add the verb."""

    @app.command()
    def run(
        study: StudyFile, lab: Lab = LAB, backend: Engine = ENGINE, device: Device = "cpu", checkpoint_every: Every = 20
    ) -> None:
        """Run what a study still needs. Ctrl-C leaves everything resumable: give the same command again."""
        from labbook.backend import Unsupported
        from labbook.catalogue.lab import DiskFull
        from labbook.catalogue.lab import Lab as Folder
        from labbook.measure import MeasureError
        from labbook.plan.demand import Conflict
        from labbook.plan.plan import Planner
        from labbook.plan.reach import cut_short
        from labbook.runner.progress import Bar
        from labbook.runner.runner import Runner

        asked, engine = read_study(study), engine_called(backend)
        console = screen(highlight=False, markup=False)
        if asked.stop.fill_height is not None:
            try:
                ahead = Planner(asked, open_catalogue(lab), engine.capabilities).plan()
            except (Conflict, MeasureError) as problem:
                fail(problem)
            for line in cut_short(ahead, Folder(lab)):
                say(line, err=True)
        with Bar(screen(stderr=True)) as bar:
            runner = Runner(asked, Folder(lab), engine, device, checkpoint_every, bar)
            try:
                summary = runner.run()
            except (Unsupported, Conflict, MeasureError, DiskFull) as problem:
                fail(problem)
        for line in report(summary):
            console.print(line)
        if summary.stopped:
            raise typer.Exit(130)
        if summary.tally.failed:
            raise typer.Exit(1)


def report(summary: "Summary") -> list[str]:
    """What came of it, line by line."""
    from collections import Counter

    from labbook.plan.plan import counted
    from labbook.runner.progress import duration

    tally = summary.tally
    outcomes = Counter(tally.ran.values())
    done, asked = counted(summary.points)
    lines = [f"{done} of {asked} runs done"]
    if tally.ran or tally.packings:
        rate = summary.work_done / summary.wall_time
        what = ", ".join(f"{count} {outcome}" for outcome, count in outcomes.items()) or "none ended"
        lines[0] += f"; now: {what}; {tally.packings} packings; {duration(summary.wall_time)}"
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
    lines += [f"Failed: {why}" for why in tally.failed]
    lines += [f"Unreadable: {problem}" for problem in summary.problems]
    if summary.stopped:
        lines.append("Stopped early; everything is saved: the same command goes on from here")
    return lines
