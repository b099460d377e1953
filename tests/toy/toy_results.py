"""Results of runs that no lab holds: their data are made when they are requested."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

from labbook.lab import Entry, FinishedRun, Unreadable
from labbook.lab.evaluations import Evaluated, Numbers, evaluate
from labbook.lab.records import Coverage
from labbook.measure import MEASURES, Measure
from labbook.results.find import results_of
from labbook.results.study import StudyResults
from labbook.study import Point, Study

_R = TypeVar("_R", bound=StudyResults)


class RunDouble(FinishedRun):
    """A finished run in no lab; a test that needs its data defines `data`."""

    def __init__(
        self,
        point: Point,
        seed: int,
        outcome: str = "finished",
        packing_key: str = "",
        frame_interval: float | None = None,
        cache_version: int = 1,
        outdated: str = "",
        suspect: str = "",
        ended: str = "2026-01-02T03:04:05+00:00",
        discharge: int = 1,
    ):
        bed = f"{point.index:04x}{seed:04x}"
        key = bed * 3 + (bed if discharge == 1 else f"{discharge:08x}")
        entry = Entry(
            run_key=key,
            lineage_key="",
            cache_version=cache_version,
            outcome=outcome,
            coverage=Coverage.model_construct(recording=frame_interval, every_frame=True),
            packing_key=packing_key,
            backend="double",
            device="cpu",
            finished=ended,
            suspect=suspect,
        )
        super().__init__(point, seed, Path("no-such-lab", "runs", key), entry, outdated, discharge)

    @property
    def provenance(self) -> dict[str, Any]:
        return {"backend": "double"}

    def evaluated(self, measure: Measure, window: Any) -> Evaluated:
        return evaluate(measure, window, self.data())


def analyse(
    study: Study,
    finished: Sequence[FinishedRun],
    progress: Callable[[int], None] = lambda done: None,
    lost: Sequence[str] = (),
    kind: Callable[..., _R] = StudyResults,
) -> _R:
    """What these runs come to. `progress` is told how many are done; `lost`: why others cannot be read; `kind`: class
    of the results."""
    numbers = Numbers()
    for done, run in enumerate(finished, 1):
        key = run.entry.run_key
        kept, failed = numbers.measured.setdefault(key, {}), numbers.failed.setdefault(key, {})
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
            numbers.problems[key] = str(problem)
        progress(done)
    return results_of(study, finished, numbers, lost, kind)


def _said(run: FinishedRun, problem: str) -> str:
    return f"run {run.entry.run_key} of {run.point.label}, {run.repeat}: {problem}"
