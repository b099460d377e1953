"""Several devices of one machine on one study: a process each, in one lab.

Each process begins with its own part of the study, as large as its device is fast, and then takes up what the others
have not begun; claims keep two from doing the same. A device that fails leaves its work to the others.
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
from labbook.run.board import Tally
from labbook.run.execution import CHECKPOINT_EVERY
from labbook.run.live import running
from labbook.run.runner import Runner
from labbook.run.shard import WHOLE, Seat, Shard, shard_of
from labbook.run.stopping import Request
from labbook.run.summary import Summary
from labbook.run.watch import Unwatched, View, Watcher
from labbook.study import Study

_LOOK = 0.2  # s
_VIEW = 1.0  # s between two looks at where processes stand
_LAST = 2000
"""Characters, at most, of what a process that failed said last."""


@dataclass(eq=False)
class _Process:
    """A process that works on one device, and what it told."""

    device: str
    process: "subprocess.Popen[bytes]"
    said: IO[bytes]
    """What it wrote on its standard output and error."""
    end: dict[str, Any] | None = None
    view: View | None = None
    listener: threading.Thread = field(default_factory=threading.Thread)

    def problem(self) -> str | None:
        """Why it did not come to its end; None if it did."""
        if self.end is not None:
            return self.end.get("failed")
        self.said.seek(0)
        last = self.said.read().decode("utf-8", "replace").strip()[-_LAST:].rpartition("\n")[2]
        return f"its process ended with exit status {self.process.returncode}" + (f": {last}" if last else "")


@dataclass(eq=False)
class Crew:
    """Carries out `study` in `lab` on several devices of this machine; the same as `Runner` otherwise. `backend`: its
    name."""

    study: Study
    lab: LabFolder
    backend: str
    devices: Sequence[str]
    checkpoint_every: float = CHECKPOINT_EVERY
    watcher: Watcher = field(default_factory=Unwatched)
    shard: Shard = WHOLE
    base: LabFolder | None = None

    def run(self) -> Summary:
        """Run what is missing; Ctrl-C, SIGTERM or SIGHUP is passed on to all processes, which save what is going on.

        Raises what `Runner.run` raises.
        """
        begun, backend = time.perf_counter(), load(self.backend)
        points = [PointDemand(self.study, point) for point in self.study.points]
        holds = shard_of(points, backend.capabilities, self.shard)
        self._check(backend)
        Index(self.lab).close()  # made once, before several want it
        ratios = speeds(self.devices, backend, points)
        stop, crew = Request(), list[_Process]()
        try:
            with stop.listening(self.watcher.tell):
                for number, device in enumerate(self.devices, 1):
                    crew.append(self._start(device, Seat(number, ratios)))
                self._watch(crew, stop)
        except KeyboardInterrupt:
            for one in crew:
                _signal(one)
            raise
        finally:
            for one in crew:
                if one.process.poll() is None:
                    _signal(one)
                assert one.process.stdin is not None
                with suppress(OSError):
                    one.process.stdin.close()
        return self._summary(crew, stop.made, holds, backend, time.perf_counter() - begun)

    def _check(self, backend: Backend) -> None:
        catalogue = Catalogue(self.lab)
        try:
            points = Planner(self.study, catalogue, backend.capabilities).points
        finally:
            catalogue.close()
        for device in self.devices:
            check(backend, device, points[:1])
        check(backend, self.devices[0], points)

    def _start(self, device: str, seat: Seat) -> _Process:
        said = TemporaryFile()  # noqa: SIM115  (closed when the process is forgotten)
        reads, writes = os.pipe()
        command = [sys.executable, "-c", "from labbook.run.devices import work; work()", str(writes)]
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=said, stderr=said, pass_fds=(writes,), start_new_session=True
        )
        os.close(writes)
        one = _Process(device, process, said)
        one.listener = threading.Thread(target=self._listen, args=(one, reads), daemon=True)
        one.listener.start()
        task = (self.study, self.lab.folder, self.backend, device, self.checkpoint_every, self.shard, seat, self.base)
        assert process.stdin is not None
        with suppress(BrokenPipeError):  # it ended at once; why is told later
            pickle.dump(task, process.stdin)
            process.stdin.flush()
        return one

    def _listen(self, one: _Process, reads: int) -> None:
        """Take what a process tells, until it ends."""
        with os.fdopen(reads, encoding="utf-8") as told:
            for line in told:
                message = json.loads(line)
                if "tell" in message:
                    self.watcher.tell(message["tell"])
                else:
                    one.end = message

    def _watch(self, crew: Sequence[_Process], stop: Request) -> None:
        asked, look = False, 0.0
        while any(one.process.poll() is None for one in crew):
            if stop.made and not asked:
                asked = True
                for one in crew:
                    _signal(one)
            if time.monotonic() >= look:
                look = time.monotonic() + _VIEW
                by_process = {each.pid: each for each in running(self.lab)}
                for one in crew:
                    one.view = by_process.get(one.process.pid, one.view)
                self.watcher.show(together([(one.device, one.view) for one in crew if one.view is not None]))
            time.sleep(_LOOK)
        for one in crew:
            one.listener.join()

    def _summary(self, crew: Sequence[_Process], stopped: bool, holds, backend: Backend, wall: float) -> Summary:
        tally, ends = Tally(), [one.end for one in crew if one.end is not None]
        for end in ends:
            if end.get("full"):
                raise DiskFull(self.lab.folder)
            tally.ran |= end["ran"]
            tally.resumed += end["resumed"]
            tally.packings += end["packings"]
            tally.failed += [why for why in end["lost"] if why not in tally.failed]
        tally.failed += [f"{one.device}: {problem}" for one in crew if (problem := one.problem())]
        catalogue = Catalogue(self.lab)
        try:
            plan = Planner(self.study, catalogue, backend.capabilities).plan()
        finally:
            catalogue.close()
        problems = tuple(dict.fromkeys(problem for end in ends for problem in end["problems"]))
        work = sum(end["work"] for end in ends)
        preparing = min((end["preparing"] for end in ends), default=0.0)
        summary = Summary(tally, plan.points, stopped, wall, work, problems, False, holds, preparing=preparing)
        return replace(summary, study=plan.study, campaign=plan.campaign)


def together(views: Iterable[tuple[str, View]]) -> View:
    """What processes on several devices are at, as one."""
    total = View(0, 0, 0, (), 0, 0.0, 0.0, 0.0)
    for device, one in views:
        total = View(
            runs_done=total.runs_done + one.runs_done,
            runs_asked=total.runs_asked + one.runs_asked,
            fillings_left=total.fillings_left + one.fillings_left,
            going=(*total.going, *(replace(going, label=f"{device}: {going.label}") for going in one.going)),
            elsewhere=0,  # held by one of the others, as a rule
            work_done=total.work_done + one.work_done,
            work_left=total.work_left + one.work_left,
            rate=total.rate + one.rate,
            open_ended=total.open_ended or one.open_ended,
        )
    return total


def _signal(one: _Process) -> None:
    with suppress(ProcessLookupError):
        one.process.send_signal(signal.SIGTERM)


class _Teller(Unwatched):
    """Passes lines on to the process that started this one."""

    def __init__(self, to: IO[str]):
        self._to = to

    def tell(self, line: str) -> None:
        """Pass on a line; that this one is being stopped is told by the other."""
        self.send({"tell": line})

    def send(self, message: dict[str, Any]) -> None:
        """Pass on a message."""
        with suppress(OSError):
            self._to.write(json.dumps(message) + "\n")
            self._to.flush()


def work() -> None:
    """Work on one device, as the process that started this one says on standard input; end when that ends."""
    teller = _Teller(os.fdopen(int(sys.argv[1]), "w", encoding="utf-8"))
    study, lab, name, device, every, shard, seat, base = pickle.load(sys.stdin.buffer)

    def orphaned() -> None:
        sys.stdin.buffer.read()
        os.kill(os.getpid(), signal.SIGTERM)

    try:
        runner = Runner(study, LabFolder(lab), load(name), device, every, teller, shard=shard, seat=seat, base=base)
        threading.Thread(target=orphaned, daemon=True).start()
        done = runner.run()
        tally = done.tally
        end = {"ran": tally.ran, "resumed": tally.resumed, "packings": tally.packings, "lost": tally.failed}
        teller.send({**end, "problems": done.problems, "work": done.work_done, "preparing": done.preparing})
    except (LabError, Unsupported, ImportError) as problem:
        nothing = {"ran": {}, "resumed": 0, "packings": 0, "lost": [], "problems": [], "work": 0.0, "preparing": 0.0}
        teller.send({**nothing, "failed": str(problem), "full": isinstance(problem, DiskFull)})
    except KeyboardInterrupt:
        pass
    except BaseException:
        import traceback

        traceback.print_exc()
        sys.stderr.flush()
        os._exit(1)
    sys.stdout.flush()
    os._exit(0)  # whatever threads still compile
