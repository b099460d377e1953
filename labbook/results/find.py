"""Results of a study from the runs of a lab: replicates pooled, series fitted, comparisons with the reference."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TypeVar

from labbook.backend import BackendMissing, load
from labbook.fit import LAWS
from labbook.lab import Catalogue, FinishedRun, evaluations
from labbook.lab.campaigns import as_proposed
from labbook.lab.evaluations import NotEvaluated, Numbers, ReadOnlyRun
from labbook.lab.records import Observe
from labbook.lab.suspect import counts
from labbook.plan.coverage import RequestedRun, finished, unreadable
from labbook.results.numerical import numerical
from labbook.results.paper import compared, further_fits, judged
from labbook.results.points import RunResult, pooled_point, redundant
from labbook.results.reference import compare
from labbook.results.series import series_of
from labbook.results.statements import judge
from labbook.results.study import StudyResults
from labbook.study import Study

_R = TypeVar("_R", bound=StudyResults)


def results_of(
    study: Study,
    runs: Sequence[FinishedRun],
    numbers: Numbers,
    lost: Sequence[str] = (),
    kind: Callable[..., _R] = StudyResults,
) -> _R:
    """Pool replicates, fit series and compare with the study's reference.

    An unreadable run is left out and reported. A run on which a measure fails keeps its other numbers.

    Args:
        study: The study, with its points as a strategy proposed them.
        runs: Its finished runs, in any order.
        numbers: Measured numbers of the runs.
        lost: Messages on runs that were found unreadable before.
        kind: Class of the results, or a function that makes them.

    Returns:
        Points, series, comparisons and statements.
    """
    unreadable, unmeasured = list(lost), list[str]()
    by_point: dict[int, list[RunResult]] = {}
    for run in sorted(runs, key=lambda run: (run.point.index, run.seed, run.discharge)):
        key = run.entry.run_key
        if (why := numbers.problems.get(key)) is not None:
            unreadable.append(why)
            continue
        unmeasured += numbers.failed.get(key, {}).values()
        included = counts(run.entry.outcome, run.entry.suspect, study.accuracy.count_suspect)
        of_run = RunResult(run, numbers.measured.get(key, {}), study.measure, study.window, included)
        by_point.setdefault(run.point.index, []).append(of_run)
    read = [point for point in study.points if by_point.get(point.index)]
    extra = redundant(study.points)
    points = tuple(pooled_point(study, point, extra, tuple(by_point[point.index])) for point in read)
    missing = tuple(point for point in study.points if not by_point.get(point.index))
    series = series_of(points, study.fit, further_fits())
    results = kind(study, points, missing, tuple(unreadable), series, unmeasured=tuple(unmeasured))
    own = partial(compared, results)
    return replace(
        results,
        comparisons=compare(study.reference, points, series, own),
        judged=judge(study.reference, points, series, own, partial(judged, results)),
        numerical=numerical(study.points, points, study.accuracy.numerics),
    )


def find(
    study: Study,
    catalogue: Catalogue,
    backend: str,
    progress: Callable[[int], None] = lambda done: None,
    kind: Callable[..., _R] = StudyResults,
) -> _R:
    """Read the results of a study from the lab. Runs that are not evaluated yet are evaluated, and the numbers stored.

    Args:
        study: The study.
        catalogue: Index of the lab.
        backend: Name of the backend that made the runs.
        progress: Called with the number of evaluated runs.
        kind: Class of the results, as for `results_of`.

    Returns:
        The results.
    """
    study, proposed = as_proposed(study, catalogue.lab, backend)
    runs, lost = finished(catalogue, study, backend), unreadable(catalogue, study, backend)
    observe = Observe.of(study.measure, study.window)
    results = results_of(study, runs, evaluations.numbers(catalogue, runs, observe, progress), lost, kind)
    return replace(results, installed=_installed(backend), campaign=proposed)


def stored_results(
    study: Study,
    catalogue: Catalogue,
    backend: str,
    requested: Mapping[str, Sequence[RequestedRun]] | None = None,
    kind: Callable[..., _R] = StudyResults,
) -> _R:
    """Read the results of a study that are stored already: nothing is evaluated, and no folder is opened.

    Profiles, traces and fields without a stored evaluation raise NotEvaluated (of `labbook.lab.evaluations`) on access.
    Fits and comparisons of a paper that rest on such data are left out, and the run is among the unevaluated.

    Args:
        study: The study.
        catalogue: Index of the lab.
        backend: Name of the backend that made the runs.
        requested: Result of `labbook.plan.coverage.requested_runs`, if it is at hand.
        kind: Class of the results, as for `results_of`.

    Returns:
        The results; their `unevaluated` names the runs that lack evaluations.
    """
    study, proposed = as_proposed(study, catalogue.lab, backend)
    runs, lost = (
        finished(catalogue, study, backend, None if proposed else requested, ReadOnlyRun),
        unreadable(catalogue, study, backend),
    )
    observe = Observe.of(study.measure, study.window)
    numbers = evaluations.kept_numbers(catalogue, runs, observe)
    lacking = dict.fromkeys(numbers.lacking)
    try:
        results = results_of(study, runs, numbers, lost, kind)
    except NotEvaluated as problem:  # profiles that a paper's fits or statements rest on
        lacking |= {problem.run_key: None}
        plain = replace(study, fit=tuple(law for law in study.fit if law in LAWS), reference=None)
        results = replace(results_of(plain, runs, numbers, lost, kind), study=study)
    return replace(results, installed=_installed(backend), unevaluated=tuple(lacking), campaign=proposed)


def _installed(backend: str) -> tuple[str, int] | None:
    """Name and version of a backend; None where it is not installed: a lab may be read anywhere."""
    try:
        return backend, load(backend).capabilities.cache_version
    except BackendMissing:
        return None
