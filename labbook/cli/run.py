"""`labbook run`: carry out what a study still needs."""

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from labbook.cli.options import (
    BACKEND,
    GO_ON,
    LAB,
    STOPPED,
    Device,
    Lab,
    RunsOn,
    StudyFile,
    fail,
    leave,
    read_study,
)
from labbook.cli.screen import say, screen
from labbook.commands import command

if TYPE_CHECKING:
    from labbook.run.summary import Summary
    from labbook.study import Study

Part = Annotated[
    str | None, typer.Option("--shard", help="Run only part i of n, such as 1/4.", metavar="I/N", show_default=False)
]
Base = Annotated[
    Path | None,
    typer.Option(
        "--base", help="Lab whose finished runs are not repeated and whose packings are used.", show_default=False
    ),
]
On = Annotated[
    str | None,
    typer.Option("--cluster", help="Address of a Dask scheduler; its workers run the study.", show_default=False),
]
Expect = Annotated[
    str | None, typer.Option("--expect", help="Refuse to run with other versions than these.", hidden=True)
]
Pilot = Annotated[
    bool, typer.Option("--pilot/--no-pilot", help="Measure the effect of the time step first, if needed.")
]
Every = Annotated[
    float,
    typer.Option(
        "--checkpoint-every",
        help="Seconds between two checkpoints of a run; more if saving took over 5 % of the time.",
        min=0,
    ),
]


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
        base: Base = None,
        cluster: On = None,
        expect: Expect = None,
        pilot: Pilot = True,
    ) -> None:
        """Run what a study still needs. Ctrl-C leaves everything resumable: give the same command again.

        Several processes may run one study in one lab, and share the work. With --shard each process runs a fixed part,
        in one lab or in several. Parts have about the same forecast cost, and runs from one packing are in one part.

        Several devices of this machine (--device cuda:all, or cuda:0,cuda:1) get a process each, and share the work.

        With --cluster the workers of a Dask cluster (see labbook cluster) run the study and send back the runs.

        If a study requests an error (accuracy.flow_rate) and its scenes are not calibrated, a pilot comes first. It
        measures the effect of the time step, and writes STUDY.calibration.json beside the study. --no-pilot skips it:
        the default step is used, and the error budget says that its bias is not known.

        If runs are missing, the warnings of labbook plan are repeated first. A second Ctrl-C stops at once and keeps
        the last checkpoints.

        Exit status: 0 if all runs of the study are done; 1 if a run or its filling failed, diverged or is suspect, or
        if the study measures flow_rate and no point has one (not judged for one --shard or with --base); 2 if an
        argument is wrong; 130 if it was stopped.
        """
        from labbook.api import Lab as Place
        from labbook.api import PilotNeeded
        from labbook.backend import BackendMissing, Unsupported
        from labbook.lab import NoCatalogue
        from labbook.lab.folder import DiskFull
        from labbook.measure import MeasureError
        from labbook.plan.demand import Conflict
        from labbook.results.calibrating import PilotStopped
        from labbook.run.cluster import ClusterFailed
        from labbook.run.progress import Bar
        from labbook.run.shard import Shard

        asked = read_study(study)
        if shard is not None:
            try:
                Shard.parse(shard)
            except ValueError as problem:
                fail(f"--shard: {problem}")
        if cluster is not None and (shard is not None or base is not None):
            fail("--cluster: the workers share the whole study; leave out --shard and --base")
        if expect is not None and (told_apart := unexpected(expect, asked, backend)):
            fail(f"{told_apart} since the script was written: write the script again with labbook slurm")
        console, place = screen(highlight=False, markup=False), Place(lab, backend, device)
        try:
            with Bar(screen(stderr=True)) as bar:
                summary = place.run(asked, bar, checkpoint_every, shard, base, cluster, pilot)
        except PilotStopped:
            with suppress(OSError):
                say(f"Stopped early, in the pilot; everything is saved: {GO_ON}", err=True)
            leave(STOPPED)
        except PermissionError as problem:
            elsewhere = command("pilot", asked.path, "--out", "FILE", lab=lab, backend=backend)
            fail(f"{problem.filename}: {problem.strerror}; give {elsewhere} and name FILE as accuracy.calibration, or "
                 "give --no-pilot")  # fmt: skip
        except (BackendMissing, NoCatalogue, Unsupported, Conflict, MeasureError) as problem:
            fail(problem)
        except (DiskFull, ClusterFailed, PilotNeeded) as problem:
            fail(problem)
        except KeyboardInterrupt:
            with suppress(OSError):
                say(f"Stopped at once; the last checkpoints are kept: {GO_ON}", err=True)
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
        if summary.failed or summary.diverged or summary.suspect or summary.no_flow:
            raise typer.Exit(1)


def unexpected(expect: str, study: "Study", backend: str) -> str | None:
    """In what labbook, the backend or the study differ from what a script was written for; None if in nothing."""
    from labbook.backend import BackendMissing, load
    from labbook.run.slurm import differs

    try:
        return differs(expect, study, load(backend).capabilities)
    except BackendMissing as problem:
        fail(problem)


def told(summary: "Summary") -> list[str]:
    """What came of it, line by line."""
    return summary.lines() + ([f"Stopped early; everything is saved: {GO_ON}"] if summary.stopped else [])


def advice(summary: "Summary", study: Path, lab: Path, backend: str) -> list[str]:
    """What to do next, as commands."""
    lines = []
    if summary.diverged:
        listed, shown = command("runs", "--outcome", "diverged", lab=lab), command("show", "RUN", lab=lab)
        lines.append(f"Which runs diverged, and how: {listed}; {shown}")
    if summary.suspect:
        lines.append(f"Which runs are suspect, and why: {command('runs', '--outcome', 'suspect', lab=lab)}")
    if summary.done and not summary.stopped:
        lines.append(f"Next: {command('report', study, lab=lab, backend=backend)}")
        if any(item.demand.recorded for point in summary.points for item in point.items):
            lines.append(f"      {command('view', study, lab=lab, backend=backend)}")
    return lines
