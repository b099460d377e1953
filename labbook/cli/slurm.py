"""`labbook slurm`: a study as a job array of Slurm."""

from pathlib import Path
from typing import Annotated

import typer

from labbook.cli.options import BACKEND, LAB, Lab, RunsOn, StudyFile, fail, read_study
from labbook.cli.screen import say
from labbook.commands import command

Tasks = Annotated[
    int, typer.Option("--tasks", help="Number of tasks of the array; each runs a part of the study.", min=1)
]
Time = Annotated[str, typer.Option("--time", help="Time limit of a task, in Slurm's format.", metavar="HH:MM:SS")]
Gpus = Annotated[
    int | None, typer.Option("--gpus", help="GPUs per task; default with warp: 1.", min=0, show_default=False)
]
Cpus = Annotated[int | None, typer.Option("--cpus", help="Cores per task.", min=1, show_default=False)]
Labs = Annotated[
    Path | None,
    typer.Option("--labs", help="Folder for the labs of the parts; default: LAB-parts.", show_default=False),
]
Site = Annotated[
    Path | None,
    typer.Option(
        "--site",
        help="File whose #SBATCH lines and commands go into the script.",
        exists=True,
        dir_okay=False,
        show_default=False,
    ),
]
Submit = Annotated[bool, typer.Option("--submit", help="Submit the script with sbatch, followed by the import.")]
Device = Annotated[
    str | None, typer.Option("--device", help="Device; default: cuda:all with GPUs, else cpu.", show_default=False)
]
Options = Annotated[
    list[str] | None,
    typer.Argument(help="Further options for sbatch, after --.", metavar="[-- OPTION...]", show_default=False),
]


def register(app: typer.Typer) -> None:
    """Add the command to the app."""

    @app.command()
    def slurm(
        study: StudyFile,
        options: Options = None,
        tasks: Tasks = 1,
        time: Time = "04:00:00",
        lab: Lab = LAB,
        backend: RunsOn = BACKEND,
        gpus: Gpus = None,
        cpus: Cpus = None,
        device: Device = None,
        labs: Labs = None,
        site: Site = None,
        submit: Submit = False,
    ) -> None:
        """Print a script that runs a study as a job array of Slurm, or submit it with sbatch.

        Every task runs a part of the runs that LAB lacks, in its own lab below LAB-parts. Task 0 waits for all tasks
        and imports their labs into LAB. A task saves its runs before its time limit and is queued again. Submit the
        same script again to go on. A task refuses to run if labbook, the backend or the study changed since the script
        was written.
        """
        from labbook.backend import BackendMissing, load_to_plan
        from labbook.run.slurm import JobArray, SlurmFailed
        from labbook.run.slurm import submit as hand_in
        from labbook.study.pilot import first_needed

        definition = read_study(study)
        if definition.adapt is not None:
            why = "a strategy chooses its points from all results, and no parts can be fixed before"
            fail(f"{definition.name}: adapt: {why}; let several processes run it in one lab, which share the work")
        if first_needed(definition) is not None:
            first = command("pilot", study, lab=lab, backend=backend)
            fail(f"{definition.name} needs a pilot for all parts: give first: {first}")
        try:
            capabilities = load_to_plan(backend).capabilities
            gpu_count = gpus if gpus is not None else int(backend == "warp" and device in (None, "cuda:0"))
            array = JobArray(
                study=definition,
                backend=capabilities,
                base=lab,
                labs=labs or lab.with_name(f"{lab.name}-parts"),
                tasks=tasks,
                time=time,
                device=device or ("cuda:all" if gpu_count else "cpu"),
                gpus=gpu_count,
                cpus=cpus,
                site=site.read_text(encoding="utf-8") if site else "",
                options=options or (),
            )
            if not submit:
                typer.echo(array.script().encode("utf-8", "surrogateescape"), nl=False)  # folders keep their names
                return
            job, after = hand_in(array)
        except (BackendMissing, ValueError, SlurmFailed) as problem:
            fail(problem)
        say(f"Job {job}: {tasks} tasks; job {after} imports them into {lab} when all have ended")
