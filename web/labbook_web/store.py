"""Read access to the studies of a lab and their results, cached until their files change.

Several threads read concurrently. Nothing here writes, evaluates a run, or holds a lock that a running study waits for.
"""

import hashlib
import threading
import time
from collections import OrderedDict, defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any, TypeVar

from labbook.accuracy import BESIDE
from labbook.api import Results
from labbook.backend import BackendMissing, installed
from labbook.backend import load as load_backend
from labbook.checks.compare.compare import stale
from labbook.checks.compare.sides import CannotCompare, Side
from labbook.checks.compare.verdict import NoVerdict, Verdict, path_of
from labbook.lab import Catalogue, LabError, LabFolder, notes, studies
from labbook.lab.catalogue import StudyCount
from labbook.lab.notes import Note
from labbook.plan.coverage import RequestedRun, requested_runs
from labbook.results.find import stored_results
from labbook.run.live import Running, running
from labbook.study import Study, StudyError, load

BACKEND = "numba"
"""The backend of a study that has no runs, and of commands that name none."""
_CACHE_SIZE = 64
"""Largest number of studies whose results are cached."""
_SERVER_AGE = 2.0
"""Largest age of values from an index on a server, which does not report changes [s]."""
AGE_FACTOR = 20
"""Largest age of the results of a running study, in multiples of the time to find them: the pages then take at most 5 %
of one core from it."""
_T = TypeVar("_T")


class NotFound(LookupError):
    """Error for a name that the lab does not have; the message lists those that it has."""


@dataclass(frozen=True)
class StudyListing:
    """Entry of a study in a list.

    Attributes:
        name: Name of the study.
        path: Its file; None if the lab has only its runs.
        counts: Number of its runs by backend and outcome.
        note: Note and tags.
        problem: Reason why the file cannot be read; empty if it can.
    """

    name: str
    path: Path | None
    counts: tuple[StudyCount, ...] = ()
    note: Note = field(default_factory=Note)
    problem: str = ""

    @property
    def runs(self) -> int:
        """Number of runs that were made for it."""
        return sum(count.runs for count in self.counts)

    @property
    def latest(self) -> str:
        """Time at which the last of them ended (UTC, ISO 8601); empty without any."""
        return max((count.latest for count in self.counts), default="")

    @property
    def backends(self) -> tuple[str, ...]:
        """Backends of its runs, the one with most runs first."""
        counts: dict[str, int] = defaultdict(int)
        for count in self.counts:
            counts[count.backend] += count.runs
        return tuple(sorted(filter(None, counts), key=lambda name: (-counts[name], name)))


@dataclass(frozen=True, eq=False)
class BackendComparison:
    """Stored comparison of two backends on a study.

    Attributes:
        name: Stem of its files.
        verdict: Its result.
        study: The study.
        recording: Recording of both backends side by side; None without one.
    """

    name: str
    verdict: Verdict
    study: Study
    recording: Path | None

    @cached_property
    def stale(self) -> list[str]:
        """Reasons why it is out of date; empty if it is up to date."""
        return stale(self.verdict, self.study)


@dataclass(frozen=True, eq=False)
class StudyContents:
    """A study with its results on one backend.

    Attributes:
        study: The study.
        text: Text of its file.
        backend: Name of the backend.
        results: Results of its runs.
        comparisons: Stored comparisons of backends on this study.
        packings_of: Backend whose packings these runs start from; empty if they start from their own.
    """

    study: Study
    text: str
    backend: str
    results: Results
    comparisons: tuple[BackendComparison, ...] = ()
    packings_of: str = ""
    _values: dict[str, Any] = field(default_factory=dict)

    def cached(self, name: str, make: Callable[[], _T]) -> _T:
        """Return the value of `make`, which is called at the first use of `name`."""
        if name not in self._values:
            self._values[name] = make()
        return self._values[name]

    @cached_property
    def state(self) -> str:
        """Hash of the study, its runs and their numbers, which changes with any of them."""
        runs = [
            (run.run_key, run.outcome, sorted((name, value.value) for name, value in run.measured.items()))
            for result in self.results.points
            for run in result.runs
        ]
        parts = (
            self.text,
            runs,
            *([comparison.verdict.made for comparison in self.comparisons],) * bool(self.comparisons),
        )
        return hashlib.blake2b(repr(parts).encode(), digest_size=5).hexdigest()


class Cache:
    """Thread-safe cache: the first thread that needs a value makes it, and others wait for it.

    Args:
        size: Largest number of values; beyond it the oldest are dropped.
    """

    def __init__(self, size: int):
        self._size = size
        self.values: OrderedDict[Any, tuple[Any, Any, float, float]] = OrderedDict()
        """State, value, time at which it was made and duration of that [s], by key; the latest last."""
        self._locks: dict[Any, threading.Lock] = defaultdict(threading.Lock)  # by key: slow values do not block others
        self._lock = threading.Lock()  # of the dictionaries, never held while a value is made

    def get(self, key: Any, state: Any, make: Callable[[], _T], age_factor: float = 0.0) -> _T:
        """Return the value of a key, made anew if its state has changed.

        Args:
            key: Key of the value.
            state: State of the sources of the value, compared by equality.
            make: Makes the value. An error passes to the caller, and the next thread tries again.
            age_factor: A value of an earlier state is returned up to this multiple of the time that it took to make.
        """
        with self._lock:
            lock = self._locks[key]
        with lock:
            entry = self.values.get(key)
            if entry is not None and (entry[0] == state or time.monotonic() - entry[2] < age_factor * entry[3]):
                return entry[1]
            start = time.monotonic()
            value = make()
            end = time.monotonic()
            with self._lock:
                self.values[key] = state, value, end, end - start
                self.values.move_to_end(key)
                while len(self.values) > self._size:
                    self.values.popitem(last=False)
            return value


class LabStore:
    """Studies of a lab and their results, cached.

    Args:
        lab: Folder of the lab.
        extra_files: Study files besides those that the lab keeps, with precedence over those of the same name.
        extra_only: Leave out the studies that the lab keeps.
        with_notes: Include notes and tags.
    """

    def __init__(
        self, lab: Path, extra_files: Sequence[Path] = (), *, extra_only: bool = False, with_notes: bool = True
    ):
        self.lab, self._extra_only, self._with_notes = LabFolder(lab), extra_only, with_notes
        self._extra_files = tuple(extra_files)
        self.study_cache, self._requested, self._results = Cache(1000), Cache(_CACHE_SIZE), Cache(_CACHE_SIZE)
        self._counts, self._texts = Cache(1), Cache(1000)
        self.pictures = Cache(400)
        """Encoded figures by study, backend, address and format."""
        self._index_lock = threading.Lock()
        self._index: tuple[Any, Catalogue] | None = None

    @property
    def catalogue(self) -> Catalogue:
        """Index of the lab, opened again after its file was replaced. Raises LabError."""
        identity = _identity(self.lab.server) or _identity(self.lab.catalogue)
        with self._index_lock:
            if self._index is None or self._index[0] != identity:
                self._index = identity, Catalogue(self.lab)
            return self._index[1]

    @property
    def state(self) -> Any:
        """Value that changes with the index."""
        path = self.lab.catalogue
        if self.lab.server.exists():
            return time.monotonic() // _SERVER_AGE
        return tuple(_stamp(file) for file in (path, path.with_name(f"{path.name}-wal")))

    def listings(self) -> list[StudyListing]:
        """List all studies with a file or runs, the one with the latest run first. Raises LabError."""
        counts: dict[str, list[StudyCount]] = defaultdict(list)
        for count in self.counts():
            counts[count.study].append(count)
        files = self._files()
        names = dict.fromkeys((*files, *(() if self._extra_only else filter(None, counts))))
        listings = [
            StudyListing(name, files.get(name), tuple(counts.get(name, ())), self.note("study", name)) for name in names
        ]
        listings += [StudyListing(path.stem, path, problem=why) for path, why in self._problems().items()]
        return sorted(listings, key=lambda listing: (listing.latest, listing.name), reverse=True)

    def counts(self) -> list[StudyCount]:
        """Number of runs of each study, backend and outcome. Raises LabError."""
        return self._counts.get("counts", self.state, self.catalogue.studies, AGE_FACTOR)

    def note(self, kind: notes.Kind, name: str) -> Note:
        """Note on a study or a run; empty if notes are left out; an error message in place of an unreadable one."""
        if not self._with_notes:
            return Note()
        try:
            return notes.read(self.lab, kind, name)
        except LabError as problem:
            return Note(text=f"(this note cannot be read: {problem})")
        except ValueError:  # of a run that was indexed before names were checked
            return Note()

    def study(self, name: str) -> tuple[Study, str]:
        """Read a study and the text of its file. Raises NotFound, StudyError."""
        path = self._files().get(name)
        if path is None:
            names = ", ".join(self._files()) or "none"
            raise NotFound(f"the lab has no study file called {name}; it has: {names}")
        return self._read(path)

    def text(self, entry: StudyListing) -> str:
        """Text of a study's file; empty if it cannot be read."""
        if entry.path is None:
            return ""
        try:
            return self._texts.get(entry.path, _stamp(entry.path), partial(entry.path.read_text, encoding="utf-8"))
        except (OSError, ValueError):
            return ""

    def backend_of(self, name: str, backend: str | None) -> str:
        """Check the name of a backend; None selects the one with most runs. Raises NotFound."""
        backends = next((listing.backends for listing in self.listings() if listing.name == name), ())
        if backend is None:
            return backends[0] if backends else BACKEND
        if backend in backends or backend in installed():
            return backend
        raise NotFound(f"no backend is called {backend}; use one of: {', '.join(sorted({*backends, *installed()}))}")

    def contents(self, name: str, backend: str) -> StudyContents:
        """Read a study and its results on one backend.

        Args:
            name: Name of the study.
            backend: Name of the backend.

        Raises:
            NotFound: No study file of this name.
            StudyError: An invalid study.
            LabError: An index that cannot be read.
        """
        study, text = self.study(name)
        path = self._files()[name]

        def find() -> StudyContents:
            kind = partial(Results, lab_folder=self.lab, backend=backend)
            results = stored_results(study, self.catalogue, backend, self._demands(path, study, backend), kind)
            comparisons, packings_of = self._comparisons(study), ""
            for first, second in (comparison.verdict.entrants for comparison in comparisons if not results.points):
                if second.called == backend and first.called == first.name:
                    with suppress(BackendMissing, CannotCompare):
                        packings = Side(load_backend(first.name), first.device).packings(study)
                        results = stored_results(
                            study, self.catalogue, backend, requested_runs(study, backend, packings), kind
                        )
                        packings_of = first.name if results.points else ""
            return StudyContents(study, text, backend, results, comparisons, packings_of)

        age_factor = AGE_FACTOR if self.running() else 0.0  # the last results of a study are shown as soon as it ends
        verdicts = tuple(_stamp(file) for file in self._verdicts(study.name))
        return self._results.get((path, backend), (_stamps(path), self.state, verdicts), find, age_factor)

    def _verdicts(self, name: str) -> list[Path]:
        folder = path_of(self.lab, name, "", "").parent
        return sorted(path for path in folder.glob("*.json") if not path.is_symlink())

    def _comparisons(self, study: Study) -> tuple[BackendComparison, ...]:
        """Read the stored comparisons of a study; damaged ones are left out."""
        comparisons = []
        for path in self._verdicts(study.name):
            with suppress(NoVerdict):
                recording = path.with_suffix(".rrd")
                there = recording.is_file() and not recording.is_symlink()
                comparisons.append(
                    BackendComparison(path.stem, Verdict.read(path), study, recording if there else None)
                )
        return tuple(comparisons)

    def running(self) -> list[Running]:
        """Processes that run studies in this lab now."""
        return running(self.lab)

    def _demands(self, path: Path, study: Study, backend: str) -> Mapping[str, Sequence[RequestedRun]]:
        return self._requested.get((path, backend), _stamps(path), lambda: requested_runs(study, backend))

    def _files(self) -> dict[str, Path]:
        """Study files by name: those of the lab, and the extra ones."""
        files = {} if self._extra_only else studies.study_files(self.lab)
        for path in self._extra_files:
            try:
                files[self._read(path)[0].name] = path
            except (StudyError, OSError):
                continue  # `listings` shows the reason
        return files

    def _read(self, path: Path) -> tuple[Study, str]:
        """Read a study and its text, again after its file or its calibration has changed. Raises StudyError."""
        calibration = studies.calibration(self.lab, path)
        return self.study_cache.get(path, _stamps(path), lambda: _read(path, calibration))

    def _problems(self) -> dict[Path, str]:
        """Reasons why extra files are no studies, by file."""
        problems = {}
        for path in self._extra_files:
            try:
                self._read(path)
            except (StudyError, OSError) as problem:
                problems[path] = str(problem)
        return problems


def _read(path: Path, calibration: Path | None) -> tuple[Study, str]:
    with _loading:
        study = load(path, calibration)
    return study, study.text


_loading = threading.Lock()  # units and models are set up when the first study is read: by one thread


def _stamps(path: Path) -> tuple[tuple[int, int, int] | None, ...]:
    """Stamps of the file of a study and of the calibration beside it."""
    return _stamp(path), _stamp(path.with_suffix(BESIDE))


def _stamp(path: Path) -> tuple[int, int, int] | None:
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_ino, status.st_size, status.st_mtime_ns


def _identity(path: Path) -> tuple[int, int] | None:
    """Device and inode of a file, whatever its content; None without one."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_dev, status.st_ino
