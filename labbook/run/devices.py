"""A study on several devices of one machine: one process for each device, in one lab.

Each process begins with its own part of the study, in proportion to the speed of its device. Then it takes runs that
the others have not begun; claims prevent two from running the same. If a device fails, the others take over its work.
"""

import json
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from tempfile import TemporaryFile
from typing import IO, Any

from labbook.backend import Backend, Unsupported, load
from labbook.lab.catalogue import Catalogue
from labbook.lab.folder import DiskFull, LabError, LabFolder
from labbook.lab.index import Index
from labbook.plan.demand import PointDemand
from labbook.plan.devices import speeds
from labbook.plan.plan import Planner
from labbook.plan.possible import check
from labbook.run.execution import CHECKPOINT_EVERY
from labbook.run.job_queue import Tally
from labbook.run.live import running
from labbook.run.runner import Runner
from labbook.run.shard import WHOLE, ProcessRank, Shard, shard_of
from labbook.run.stopping import StopRequest
from labbook.run.summary import Summary
from labbook.run.watch import NullWatcher, View, Watcher
from labbook.study import Study

_POLL_INTERVAL = 0.2  # s
_VIEW_INTERVAL = 1.0  # s between two looks at where processes stand
_MAX_ERROR_TEXT = 2000
"""Maximum length of the last output of a failed process that is shown [characters]."""


@dataclass(eq=False)
class _DeviceProcess:
    """A process that works on one device, with its messages.

    Args:
        device: Name of the device.
        process: The process.
        output: File with its standard output and error.
        end: Its last message.
        view: Its last published progress.
        listener: Thread that reads its messages.
    """

    device: str
    process: "subprocess.Popen[bytes]"
    output: IO[bytes]
    end: dict[str, Any] | None = None
    view: View | None = None
    listener: threading.Thread = field(default_factory=threading.Thread)

    def problem(self) -> str | None:
        """Reason for which it failed; None if it finished."""
        if self.end is not None:
            return self.end.get("failed")
        self.output.seek(0)
        last_line = self.output.read().decode("utf-8", "replace").strip()[-_MAX_ERROR_TEXT:].rpartition("\n")[2]
        return f"its process ended with exit status {self.process.returncode}" + (f": {last_line}" if last_line else "")


@dataclass(eq=False)
class MultiDeviceRunner:
    """Runs a study in a lab on several devices of this machine, otherwise like `Runner`. `backend`: its name."""

    study: Study
    lab: LabFolder
    backend: str
    devices: Sequence[str]
    checkpoint_every: float = CHECKPOINT_EVERY
    watcher: Watcher = field(default_factory=NullWatcher)
    shard: Shard = WHOLE
    base: LabFolder | None = None

    def run(self) -> Summary:
        """Run what is missing. Ctrl-C, SIGTERM or SIGHUP is passed on to all processes, which save their jobs.

        Raises what `Runner.run` raises.
        """
        start, backend = time.perf_counter(), load(self.backend)
        points = [PointDemand(self.study, point) for point in self.study.points]
        holds = shard_of(points, backend.capabilities, self.shard)
        self._check(backend)
        Index(self.lab).close()  # made once, before several want it
        ratios = speeds(self.devices, backend, points)
        request, processes = StopRequest(), list[_DeviceProcess]()
        try:
            with request.listening(self.watcher.tell):
                for number, device in enumerate(self.devices, 1):
                    processes.append(self._start(device, ProcessRank(number, ratios)))
                self._watch(processes, request)
        except KeyboardInterrupt:
            for process in processes:
                _terminate(process)
            raise
        finally:
            for process in processes:
                if process.process.poll() is None:
                    _terminate(process)
                assert process.process.stdin is not None
                with suppress(OSError):
                    process.process.stdin.close()
        return self._summary(processes, request.requested, holds, backend, time.perf_counter() - start)

    def _check(self, backend: Backend) -> None:
        catalogue = Catalogue(self.lab)
        try:
            points = Planner(self.study, catalogue, backend.capabilities).points
        finally:
            catalogue.close()
        for device in self.devices:
            check(backend, device, points[:1])
        check(backend, self.devices[0], points)

    def _start(self, device: str, rank: ProcessRank) -> _DeviceProcess:
        output = TemporaryFile()  # noqa: SIM115  (closed when the process is forgotten)
        read_end, write_end = os.pipe()
        command = [sys.executable, "-c", "from labbook.run.devices import run_worker; run_worker()", str(write_end)]
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=output, stderr=output, pass_fds=(write_end,), start_new_session=True
        )
        os.close(write_end)
        worker = _DeviceProcess(device, process, output)
        worker.listener = threading.Thread(target=self._listen, args=(worker, read_end), daemon=True)
        worker.listener.start()
        assignment = (
            self.study,
            self.lab.folder,
            self.backend,
            device,
            self.checkpoint_every,
            self.shard,
            rank,
            self.base,
        )
        assert process.stdin is not None
        with suppress(BrokenPipeError):  # it ended at once; why is told later
            pickle.dump(assignment, process.stdin)
            process.stdin.flush()
        return worker

    def _listen(self, process: _DeviceProcess, read_end: int) -> None:
        """Read the messages of a process until it ends."""
        with os.fdopen(read_end, encoding="utf-8") as lines:
            for line in lines:
                message = json.loads(line)
                if "tell" in message:
                    self.watcher.tell(message["tell"])
                else:
                    process.end = message

    def _watch(self, processes: Sequence[_DeviceProcess], request: StopRequest) -> None:
        is_signalled, next_view = False, 0.0
        while any(process.process.poll() is None for process in processes):
            if request.requested and not is_signalled:
                is_signalled = True
                for process in processes:
                    _terminate(process)
            if time.monotonic() >= next_view:
                next_view = time.monotonic() + _VIEW_INTERVAL
                by_process = {view.pid: view for view in running(self.lab)}
                for process in processes:
                    process.view = by_process.get(process.process.pid, process.view)
                self.watcher.show(
                    merged_view([(process.device, process.view) for process in processes if process.view is not None])
                )
            time.sleep(_POLL_INTERVAL)
        for process in processes:
            process.listener.join()

    def _summary(
        self, processes: Sequence[_DeviceProcess], stopped: bool, holds, backend: Backend, wall: float
    ) -> Summary:
        tally, ends = Tally(), [process.end for process in processes if process.end is not None]
        for end in ends:
            if end.get("full"):
                raise DiskFull(self.lab.folder)
            tally.ran |= end["ran"]
            tally.resumed += end["resumed"]
            tally.packings += end["packings"]
            tally.failed += [reason for reason in end["lost"] if reason not in tally.failed]
        tally.failed += [f"{process.device}: {problem}" for process in processes if (problem := process.problem())]
        catalogue = Catalogue(self.lab)
        try:
            plan = Planner(self.study, catalogue, backend.capabilities).plan()
        finally:
            catalogue.close()
        problems = tuple(dict.fromkeys(problem for end in ends for problem in end["problems"]))
        work_done = sum(end["work"] for end in ends)
        preparing = min((end["preparing"] for end in ends), default=0.0)
        summary = Summary(tally, plan.points, stopped, wall, work_done, problems, False, holds, preparing=preparing)
        return replace(summary, study=plan.study, campaign=plan.campaign)


def merged_view(views: Iterable[tuple[str, View]]) -> View:
    """Combine the progress of processes on several devices."""
    total = View(0, 0, 0, (), 0, 0.0, 0.0, 0.0)
    for device, view in views:
        total = View(
            runs_done=total.runs_done + view.runs_done,
            runs_asked=total.runs_asked + view.runs_asked,
            fillings_left=total.fillings_left + view.fillings_left,
            going=(*total.going, *(replace(job, label=f"{device}: {job.label}") for job in view.going)),
            elsewhere=0,  # held by one of the others, as a rule
            work_done=total.work_done + view.work_done,
            work_left=total.work_left + view.work_left,
            rate=total.rate + view.rate,
            open_ended=total.open_ended or view.open_ended,
        )
    return total


def _terminate(process: _DeviceProcess) -> None:
    with suppress(ProcessLookupError):
        process.process.send_signal(signal.SIGTERM)


class _PipeWatcher(NullWatcher):
    """Watcher that sends lines to the parent process."""

    def __init__(self, stream: IO[str]):
        self._stream = stream

    def tell(self, line: str) -> None:
        """Send a line to the parent."""
        self.send({"tell": line})

    def send(self, message: dict[str, Any]) -> None:
        """Send a message to the parent."""
        with suppress(OSError):
            self._stream.write(json.dumps(message) + "\n")
            self._stream.flush()


def run_worker() -> None:
    """Entry point of a device's process: run the study that standard input describes; stop when the parent ends."""
    watcher = _PipeWatcher(os.fdopen(int(sys.argv[1]), "w", encoding="utf-8"))
    study, lab, name, device, interval, shard, rank, base = pickle.load(sys.stdin.buffer)

    def orphaned() -> None:
        sys.stdin.buffer.read()
        os.kill(os.getpid(), signal.SIGTERM)

    try:
        runner = Runner(study, LabFolder(lab), load(name), device, interval, watcher, shard=shard, rank=rank, base=base)
        threading.Thread(target=orphaned, daemon=True).start()
        summary = runner.run()
        tally = summary.tally
        end = {"ran": tally.ran, "resumed": tally.resumed, "packings": tally.packings, "lost": tally.failed}
        watcher.send({**end, "problems": summary.problems, "work": summary.work_done, "preparing": summary.preparing})
    except (LabError, Unsupported, ImportError) as problem:
        no_result = {"ran": {}, "resumed": 0, "packings": 0, "lost": [], "problems": [], "work": 0.0, "preparing": 0.0}
        watcher.send({**no_result, "failed": str(problem), "full": isinstance(problem, DiskFull)})
    except KeyboardInterrupt:
        pass
    except BaseException:
        import traceback

        traceback.print_exc()
        sys.stderr.flush()
        os._exit(1)
    sys.stdout.flush()
    os._exit(0)  # whatever threads still compile
