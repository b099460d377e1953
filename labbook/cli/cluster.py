"""`labbook cluster`: a Dask cluster for `labbook run --cluster`."""

import logging
import shutil
import signal
import time
from importlib.util import find_spec
from typing import TYPE_CHECKING, Annotated, Any

import typer

from labbook.cli.options import fail
from labbook.cli.screen import say

if TYPE_CHECKING:
    from collections.abc import Callable

Workers = Annotated[int, typer.Option("--workers", help="Number of workers: one per GPU, or one per core.", min=1)]
Gpus = Annotated[int, typer.Option("--gpus", help="GPUs per worker.", min=0, max=1)]
Port = Annotated[int, typer.Option("--port", help="Port of the scheduler; 0: any free port.", min=0, max=65535)]
Time = Annotated[str, typer.Option("--time", help="Time limit of a worker's job.", metavar="HH:MM:SS")]
Memory = Annotated[str, typer.Option("--memory", help="Memory per worker.")]
Interface = Annotated[
    str | None, typer.Option("--interface", help="Network interface of the nodes, such as ib0.", show_default=False)
]
Hosts = Annotated[
    list[str], typer.Argument(help="Hosts; the scheduler runs on the first.", metavar="HOST...", show_default=False)
]
Options = Annotated[
    list[str] | None,
    typer.Argument(help="Further options for sbatch, after --.", metavar="[-- OPTION...]", show_default=False),
]


def register(app: typer.Typer) -> None:
    """Add the command to the app."""
    group = typer.Typer(no_args_is_help=True, rich_markup_mode=None)
    app.add_typer(group, name="cluster", help="Start a Dask cluster for labbook run STUDY --cluster ADDRESS.")

    @group.command()
    def local(workers: Workers = 2, gpus: Gpus = 0, port: Port = 0) -> None:
        """Start a cluster of processes that only this machine can reach; Ctrl-C ends it."""

        def local_cluster():
            from distributed import LocalCluster  # pyright: ignore[reportMissingImports]

            untyped: Any = LocalCluster  # its dashboard may be None, whatever its signature says
            return untyped(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                scheduler_port=port,
                dashboard_address=None,
                resources={"GPU": 1} if gpus else None,
                silence_logs=logging.CRITICAL,  # what is lost `labbook run` says itself
                preload=_DEAF,
            )

        _serve(local_cluster)

    @group.command()
    def slurm(
        options: Options = None,
        workers: Workers = 2,
        gpus: Gpus = 0,
        time: Time = "04:00:00",
        memory: Memory = "4 GB",
        interface: Interface = None,
    ) -> None:
        """Start workers as jobs of Slurm, and a scheduler here; Ctrl-C ends them.

        A worker ends some minutes before its time limit and hands its work to other workers.
        """
        from labbook.run.slurm import seconds

        try:
            limit = seconds(time)
        except ValueError as problem:
            fail(problem)

        if shutil.which("sbatch") is None:
            fail("sbatch is not installed here; give this command where jobs of Slurm can be submitted")

        def slurm_cluster():
            from dask_jobqueue.slurm import SLURMCluster  # pyright: ignore[reportMissingImports]

            cluster = SLURMCluster(
                cores=1,
                processes=1,
                memory=memory,
                walltime=time,
                interface=interface,
                job_extra_directives=[*(options or ()), *([f"--gpus={gpus}"] if gpus else [])],
                worker_extra_args=[
                    *("--lifetime", f"{max(limit - 420, 60)}s", "--lifetime-stagger", "120s"),
                    *(("--resources", "GPU=1") if gpus else ()),
                ],
                scheduler_options={"dashboard_address": None},
            )
            cluster.scale(jobs=workers)
            return cluster

        _serve(slurm_cluster)

    @group.command()
    def ssh(hosts: Hosts, workers: Workers = 1, gpus: Gpus = 0) -> None:
        """Start a scheduler on the first host and workers on the others, by ssh; Ctrl-C ends them."""

        if find_spec("asyncssh") is None:
            fail("asyncssh is not installed; try: pip install asyncssh")

        def ssh_cluster():
            from distributed import SSHCluster  # pyright: ignore[reportMissingImports]

            options: dict[str, Any] = {"nthreads": 1, "n_workers": workers}
            if gpus:
                options["resources"] = {"GPU": 1}
            return SSHCluster(hosts, worker_options=options)

        _serve(ssh_cluster)


_DEAF = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"
"""Code that each worker of this machine runs first: a terminal sends Ctrl-C to workers too, and these have to go on
until the cluster is closed."""


def _serve(make_cluster: "Callable[[], Any]") -> None:
    """Start a cluster, print its address, and wait for Ctrl-C."""
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)  # as processes inherit it that are only just beginning
    try:
        cluster = make_cluster()
    except ImportError as missing:
        fail(f"Dask is not installed ({missing}); try: pip install 'labbook[cluster]'")
    except (OSError, RuntimeError) as problem:
        fail(f"the cluster does not start: {problem}")
    finally:
        signal.signal(signal.SIGINT, handler)
    try:
        say(f"Scheduler: {cluster.scheduler_address}")
        say(f"In another terminal: labbook run STUDY --cluster {cluster.scheduler_address}")
        while True:
            time.sleep(1)
    except KeyboardInterrupt:
        say("Ended")
    finally:
        cluster.close()
