"""A study carried out, and what came of it."""

from contextlib import suppress
from pathlib import Path

import typer

from labbook.api import Lab, PilotNeeded
from labbook.backend import BackendMissing, Unsupported, load
from labbook.cli.options import GO_ON, STOPPED, fail, leave, read_study
from labbook.cli.screen import say, screen
from labbook.commands import command
from labbook.lab import NoCatalogue
from labbook.lab.folder import DiskFull
from labbook.measure import MeasureError
from labbook.plan.demand import Conflict
from labbook.results.calibrating import PilotStopped
from labbook.run.cluster import ClusterFailed
from labbook.run.execution import CHECKPOINT_EVERY
from labbook.run.progress import Bar
from labbook.run.shard import Shard
from labbook.run.slurm import differs
from labbook.run.summary import Summary
from labbook.study import Study


def run(
    study: Path,
    lab: Path,
    backend: str,
    device: str,
    checkpoint_every: float,
    shard: str | None,
    base: Path | None,
    cluster: str | None,
    expect: str | None,
    pilot: bool,
) -> None:
    """Run what a study still needs, print what came of it, and exit accordingly."""
    definition = read_study(study)
    if shard is not None:
        try:
            Shard.parse(shard)
        except ValueError as problem:
            fail(f"--shard: {problem}")
    if cluster is not None and (shard is not None or base is not None):
        fail("--cluster: the workers share the whole study; leave out --shard and --base")
    if expect is not None and (difference := unexpected(expect, definition, backend)):
        fail(f"{difference} since the script was written: write the script again with labbook slurm")
    console = screen(highlight=False, markup=False)
    summary = carry_out(definition, Lab(lab, backend, device), checkpoint_every, shard, base, cluster, pilot)
    with suppress(OSError):  # the terminal is gone: all is saved, and nobody reads it
        for line in outcome_lines(summary):
            console.print(line, soft_wrap=not console.is_terminal)
        for line in advice(summary, study, lab, backend):
            console.print(line, soft_wrap=True)  # commands stay in one piece
    if summary.left_behind:
        leave(STOPPED)
    if summary.stopped:
        raise typer.Exit(STOPPED)
    if summary.failed or summary.diverged or summary.suspect or summary.no_flow:
        raise typer.Exit(1)


def carry_out(
    definition: Study,
    lab: Lab,
    checkpoint_every: float = CHECKPOINT_EVERY,
    shard: str | None = None,
    base: Path | None = None,
    cluster: str | None = None,
    pilot: bool = True,
) -> Summary:
    """Make the runs that a study still needs; what hinders them is printed, and ends the program."""
    try:
        with Bar(screen(stderr=True)) as bar:
            return lab.run(definition, bar, checkpoint_every, shard, base, cluster, pilot)
    except PilotStopped:
        with suppress(OSError):
            say(f"Stopped early, in the pilot; everything is saved: {GO_ON}", err=True)
        leave(STOPPED)
    except PermissionError as problem:
        elsewhere = command("pilot", definition.path, "--out", "FILE", lab=Path(lab.folder), backend=lab.backend)
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


def unexpected(expect: str, study: Study, backend: str) -> str | None:
    """In what labbook, the backend or the study differ from what a script was written for; None if in nothing."""

    try:
        return differs(expect, study, load(backend).capabilities)
    except BackendMissing as problem:
        fail(problem)


def outcome_lines(summary: Summary) -> list[str]:
    """Outcome of a run of a study, in lines for a terminal."""
    return summary.lines() + ([f"Stopped early; everything is saved: {GO_ON}"] if summary.stopped else [])


def advice(summary: Summary, study: Path, lab: Path, backend: str) -> list[str]:
    """Commands for the next steps."""
    lines = []
    if summary.diverged:
        listed, details = command("runs", "--outcome", "diverged", lab=lab), command("show", "RUN", lab=lab)
        lines.append(f"Which runs diverged, and how: {listed}; {details}")
    if summary.suspect:
        lines.append(f"Which runs are suspect, and why: {command('runs', '--outcome', 'suspect', lab=lab)}")
    if summary.done and not summary.stopped:
        lines.append(f"Next: {command('report', study, lab=lab, backend=backend)}")
        if any(item.demand.recorded for point in summary.points for item in point.items):
            lines.append(f"      {command('view', study, lab=lab, backend=backend)}")
    return lines
