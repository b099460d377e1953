"""Results of runs that no index knows: each is asked for what was measured of it."""

from collections.abc import Callable, Sequence

from labbook.lab import Unreadable
from labbook.lab.evaluations import Numbers
from labbook.measure import MEASURES
from labbook.results.find import results_of
from labbook.results.points import Finished
from labbook.results.study import Results
from labbook.study import Study


def analyse(
    study: Study,
    finished: Sequence[Finished],
    progress: Callable[[int], None] = lambda done: None,
    lost: Sequence[str] = (),
) -> Results:
    """What these runs come to. `progress` is told how many are done; `lost`: why others cannot be read."""
    numbers = Numbers()
    for done, run in enumerate(finished, 1):
        kept, failed = numbers.measured.setdefault(run.run_key, {}), numbers.failed.setdefault(run.run_key, {})
        try:
            for name in study.measure:
                try:
                    found = run.evaluated(MEASURES[name], study.window)
                except ImportError as problem:
                    failed[name] = _said(run, f"{name}: {problem}")
                    continue
                kept |= {one.quantity: one for one in found.evaluation.numbers}
                if found.problem:
                    failed[name] = _said(run, f"{name}: {found.problem}")
        except Unreadable as problem:
            numbers.problems[run.run_key] = str(problem)
        progress(done)
    return results_of(study, finished, numbers, lost)


def _said(run: Finished, problem: str) -> str:
    return f"run {run.run_key} of {run.point.label}, seed {run.seed}: {problem}"
