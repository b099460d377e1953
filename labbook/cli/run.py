"""`labbook run`: carry out what a study still needs."""

import shlex
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from labbook.cli.options import BACKEND, GO_ON, LAB, STOPPED, Device, Lab, RunsOn, StudyFile, fail, leave, read_study
from labbook.cli.screen import screen

if TYPE_CHECKING:
    from labbook.api import Lab as Place
    from labbook.run.runner import Summary
    from labbook.run.watch import Watcher
    from labbook.study import Study

Part = Annotated[
    str | None, typer.Option("--shard", help="Run only part i of n, such as 1/4.", metavar="I/N", show_default=False)
]
Base = Annotated[
    Path | None,
    typer.Option("--base", help="Lab whose runs are not made again, and whose packings are taken.", show_default=False),
]
On = Annotated[
    str | None,
    typer.Option("--cluster", help="Address of a Dask scheduler, whose workers run it.", show_default=False),
]
Expect = Annotated[str | None, typer.Option("--expect", help="Refuse other versions than these.", hidden=True)]
Pilot = Annotated[bool, typer.Option("--pilot/--no-pilot", help="Measure first what the time step does, if needed.")]
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
        base: Base = None,
        cluster: On = None,
        expect: Expect = None,
        pilot: Pilot = True,
    ) -> None:
        """Run what a study still needs. Ctrl-C leaves everything resumable: give the same command again.

        Several processes may run one study in one lab, and share the work. With --shard each knows its part beforehand:
        one process a part, in one lab or in several. Parts are even in the work that is foreseen, and runs from one
        packing are in one part.

        Several devices of this machine (--device cuda:all, or cuda:0,cuda:1) get a process each, and share the work.

        With --cluster the workers of a Dask cluster run it, and give their runs back (labbook cluster).

        A study that asks for an error (accuracy.flow_rate) of scenes that were not calibrated gets a pilot first, which
        measures what the time step does, and writes STUDY.calibration.json beside it. --no-pilot leaves that out: the
        usual step is taken, and the error budget says that its bias is not known.

        A second Ctrl-C leaves at once; what was saved last is kept. Exit status: 0 if all runs of the study are there,
        1 if some failed, diverged or are suspect, 130 if it was stopped.
        """
        from labbook.api import Lab as Place
        from labbook.backend import BackendMissing, Unsupported
        from labbook.lab import NoCatalogue
        from labbook.lab.folder import DiskFull
        from labbook.measure import MeasureError
        from labbook.results.calibrating import PilotStopped
        from labbook.run.cluster import ClusterFailed
        from labbook.run.demand import Conflict
        from labbook.run.progress import Bar
        from labbook.run.shard import Shard

        asked = read_study(study)
        if shard is not None:
            try:
                Shard.parse(shard)
            except ValueError as problem:
                fail(f"--shard: {problem}")
        if cluster is not None and (shard is not None or base is not None):
            fail("--cluster: the workers share the whole study out; leave out --shard and --base")
        if expect is not None and (told_apart := unexpected(expect, asked, backend)):
            fail(f"{told_apart} since the script was written: write it again by labbook slurm")
        console, place = screen(highlight=False, markup=False), Place(lab, backend, device)
        try:
            with Bar(screen(stderr=True)) as bar:
                if pilot:
                    asked = piloted(place, asked, bar, shard)
                summary = place.run(asked, bar, checkpoint_every, shard, base, cluster)
        except PilotStopped:
            with suppress(OSError):
                typer.echo(f"Stopped early, in the pilot; everything is saved: {GO_ON}", err=True)
            leave(STOPPED)
        except (BackendMissing, NoCatalogue, Unsupported, Conflict, MeasureError, DiskFull, ClusterFailed) as problem:
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


def piloted(place: "Place", study: "Study", watcher: "Watcher", shard: str | None) -> "Study":
    """The study after the pilot that it needs, if any. Raises PilotStopped, and what `run` raises."""
    from labbook.results.calibrating import NotCalibrated, PilotStopped
    from labbook.study.pilot import first_needed

    needed = first_needed(study)
    if needed is None:
        return study
    if shard is not None:
        fail(f"{study.name} needs a pilot, which all parts share: labbook calibrate {study.path} first, or --no-pilot")
    runs = len(needed.points) * needed.replicates
    watcher.tell(f"Nothing was measured of such scenes: first a pilot of {runs} runs (--no-pilot leaves it out)")
    try:
        study = place.pilot(study, watcher)
    except PilotStopped:
        raise
    except NotCalibrated as problem:
        watcher.tell(f"The pilot tells nothing: {problem}. The usual step is taken, whose bias is not known")
        return study
    except PermissionError as problem:
        fail(f"{problem.filename}: {problem.strerror}; labbook calibrate {study.path} --out FILE, and name FILE as "
             "accuracy.calibration; or --no-pilot")  # fmt: skip
    watcher.tell(f"Written by the pilot: {study.calibration_file}; what was chosen: labbook plan {study.path}")
    return study


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
