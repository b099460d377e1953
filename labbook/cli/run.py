"""`labbook run`: carry out what a study still needs."""

from pathlib import Path
from typing import Annotated

import typer

from labbook.cli.options import BACKEND, LAB, Device, Lab, RunsOn, StudyFile

ShardOption = Annotated[
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
    """Add the command to the app."""

    @app.command()
    def run(
        study: StudyFile,
        lab: Lab = LAB,
        backend: RunsOn = BACKEND,
        device: Device = "cpu",
        checkpoint_every: Every = 20,
        shard: ShardOption = None,
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
        from labbook.cli.work import run as work

        work.run(study, lab, backend, device, checkpoint_every, shard, base, cluster, expect, pilot)
