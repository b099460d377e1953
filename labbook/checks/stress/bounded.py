"""Cases in a process of their own: one that hangs is stopped, and one that crashes its process is reported."""

import multiprocessing
from collections.abc import Generator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass

from labbook.backend import load
from labbook.checks.stress.case import Ending, Row, StressCase, judge, row
from labbook.checks.verify.platform import Platform


@dataclass(frozen=True)
class NamedBackend:
    """A backend by its name, in one precision on one device, so that a new process can load it."""

    backend: str
    precision: str
    device: str

    def platform(self) -> Platform:
        """Load the backend. Raises BackendMissing, or Unsupported where it lacks the precision or device."""
        return Platform(load(self.backend), self.precision, self.device)


def judge_isolated(cases: Sequence[StressCase], named_backend: NamedBackend) -> Generator[list[Row], None, None]:
    """Yield the rows of each case, from a process that is started again after a case hung or crashed it."""
    pool = _pool()
    try:
        for case in cases:
            try:
                yield pool.submit(_judge, case, named_backend).result(timeout=case.seconds)
            except TimeoutError:
                _stop(pool)
                pool = _pool()
                yield [row(case, Ending("", "failed", f"hung: no end after {case.seconds:g} s"))]
            except BrokenProcessPool:
                pool = _pool()
                yield [row(case, Ending("", "failed", "crashed: the process of the case ended"))]
    finally:
        _stop(pool)


def _judge(case: StressCase, named_backend: NamedBackend) -> list[Row]:
    return judge(case, named_backend.platform())


def _pool() -> ProcessPoolExecutor:
    # spawned, not forked: threads and devices of compiled backends do not survive a fork
    return ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"))


def _stop(pool: ProcessPoolExecutor) -> None:
    for process in list((pool._processes or {}).values()):
        process.kill()
    pool.shutdown(wait=True, cancel_futures=True)
