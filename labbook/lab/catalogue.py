"""The catalogue: what is in the lab, quick to ask. Readers open it read-only."""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from pydantic import ValidationError
from sqlalchemy import ColumnElement, Connection, Engine, Row, func, select
from sqlalchemy.exc import DatabaseError

from labbook.lab import server
from labbook.lab.database import (
    DAMAGED,
    SCHEMA_VERSION,
    NoCatalogue,
    among,
    asking,
    empty,
    measurements,
    on_server,
    opened,
    packings,
    runs,
    schema_version,
    unusable,
)
from labbook.lab.folder import LabError, LabFolder, stamp
from labbook.lab.packings import read_packing
from labbook.lab.records import UNREADABLE, Coverage, Ending, RunRecord, Unreadable
from labbook.lab.runs import open_run
from labbook.lab.suspect import suspicion
from labbook.measure import Window, scales

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Entry:
    """What the catalogue knows of one run when planning."""

    run_key: str
    lineage_key: str
    cache_version: int
    outcome: str
    coverage: Coverage | None
    problem: str | None = None
    stamp: int = 0
    """Of the folder, as it was indexed."""
    packing_key: str = ""
    """Key of the packing that it started from."""
    backend: str = ""
    device: str = ""
    finished: str = ""
    """When it ended (UTC, ISO 8601)."""
    suspect: str = ""
    """Why it is suspect (`labbook.lab.suspect`); empty if it is not."""
    wall_time: float = 0.0
    """Time spent stepping [s]."""
    filling_time: float = 0.0
    """The same of the packing that it started from, where the index has it [s]."""

    @classmethod
    def of(cls, record: RunRecord, stamp: int) -> "Entry":
        """What a run says of itself; `stamp`: of its folder."""
        said = {name: getattr(record, name) for name in _SAID}
        return cls(
            coverage=record.coverage,
            stamp=stamp,
            suspect=suspicion(record.ledger),
            wall_time=record.wall_time,
            **said,
        )

    @property
    def frame_interval(self) -> float | None:
        """Time between two recorded frames [s]; None without any."""
        return None if self.coverage is None else self.coverage.frame_interval


_SAID = ("run_key", "lineage_key", "cache_version", "outcome", "packing_key", "backend", "device", "finished")
"""Of a run, in its record as in the index."""
_FILLING = packings.c.wall_time.label("filling_time")
_ENTRIES = select(
    *(_FILLING if name == _FILLING.name else runs.c[name] for name in Entry.__dataclass_fields__)
).select_from(runs.outerjoin(packings, packings.c.packing_key == runs.c.packing_key))
"""Rows from which entries are made."""


@dataclass(frozen=True)
class StudyCount:
    """How many runs of a study there are on a backend that ended in one way; `latest`: when the last of them did."""

    study: str
    backend: str
    outcome: str
    runs: int
    latest: str


SUSPECT = "suspect"
"""What may be asked for in place of an outcome: the runs that are suspect, however they ended."""


FLOW_RATE = "flow_rate"
"""Quantity by which runs can be sorted."""


def _ended(outcome: str) -> "ColumnElement[bool]":
    return runs.c.suspect != "" if outcome == SUSPECT else runs.c.outcome == outcome


@dataclass(frozen=True)
class Listing:
    """Which runs are listed, and in what order. Whatever is None leaves all runs in."""

    study: str | None = None
    backend: str | None = None
    outcome: str | None = None
    """How they ended, or SUSPECT."""
    packing: str | None = None
    """Key of the packing that they started from."""
    text: str | None = None
    """What the label, the name of the study or the beginning of the key has in it."""
    keys: tuple[str, ...] | None = None
    """Only these runs: at most some hundred."""
    since: str | None = None
    """Only runs that ended at this moment or later (UTC, the beginning of an ISO 8601 text)."""
    sort: str = "finished"
    """One of RUN_COLUMNS, or FLOW_RATE."""
    descending: bool = True
    offset: int = 0
    limit: int | None = 100

    def conditions(self) -> "list[ColumnElement[bool]]":
        """What SQL is asked for."""
        stated = {"study": self.study, "backend": self.backend, "packing_key": self.packing}
        found: list[ColumnElement[bool]] = [runs.c[name] == one for name, one in stated.items() if one is not None]
        if self.outcome is not None:
            found.append(_ended(self.outcome))
        if self.text:
            begins = runs.c.run_key.istartswith(self.text, autoescape=True)
            found.append(runs.c.label.icontains(self.text, autoescape=True)
                         | runs.c.study.icontains(self.text, autoescape=True) | begins)  # fmt: skip
        if self.keys is not None:
            found.append(runs.c.run_key.in_(self.keys))
        if self.since is not None:
            found.append(runs.c.finished >= self.since)
        return found


class Catalogue:
    """Questions to the index of one lab. Raises NoCatalogue if there are runs but no index of this
    version."""

    def __init__(self, lab: Path | LabFolder):
        self.lab = lab if isinstance(lab, LabFolder) else LabFolder(lab)
        self._engine = self._open()
        self._packings: dict[tuple[str, int], str | None] | None = None
        """Why a packing cannot be read, by its key and the stamp of its folder."""

    def _open(self) -> Engine:
        path, folder = self.lab.catalogue, self.lab.folder
        if folder.exists() and not folder.is_dir():
            raise LabError(f"{folder} is a file, not a lab folder; give another one with --lab")
        there = path.exists() or server.address(self.lab) is not None
        if not there:
            if self.lab.runs.is_dir() and any(self.lab.runs.iterdir()):
                raise NoCatalogue(self.lab, "is missing")
            return empty()
        engine = opened(self.lab, read_only=True)
        try:
            version = schema_version(engine) if on_server(engine) or path.is_file() else DAMAGED
        except DatabaseError as error:
            raise unusable(self.lab, error) from error
        if version is None and on_server(engine):
            raise NoCatalogue(self.lab, "is missing")
        if version != SCHEMA_VERSION:
            old = "is of another version of labbook, or damaged"
            raise NoCatalogue(self.lab, "is damaged" if version == DAMAGED else old)
        return engine

    @contextmanager
    def _asking(self) -> Iterator[Connection]:
        """A connection for a question. Raises LabError."""
        try:
            with asking(self._engine, self.lab) as connection:
                yield connection
        except ValidationError as error:  # a damaged page may hold other text than was written
            raise NoCatalogue(self.lab, "is damaged") from error

    def runs(self, study: str | None = None, outcome: str | None = None, limit: int | None = None) -> "pd.DataFrame":
        """Runs, the latest first: key, study, point, seed, discharge, backend, outcome, how far, speed, size.

        Columns: run_key, study, label, seed, discharge (its number of its bed, from 1 on), backend, cache_version,
        outcome, grains, discharged, duration [s], wall_time [s], rate [grain-steps/s], finished, device, bytes,
        problem, suspect (why it is; else empty), scene_key (of a run that can be read; points of one name differ by it
        if two studies have the same name).
        outcome: only those that ended so, or those that are SUSPECT.
        """
        query = select(*(runs.c[name].label(name) for name in (*RUN_COLUMNS, "scene_key"))).order_by(
            runs.c.finished.desc().nulls_last(), runs.c.run_key
        )
        if study is not None:
            query = query.where(runs.c.study == study)
        if outcome is not None:
            query = query.where(_ended(outcome))
        return self._frame(query.limit(limit) if limit is not None else query)

    def absent(self, study: str | None, outcome: str | None) -> str:
        """Why no run can be of a study of this name, or have this outcome: what there is instead; empty if one may."""
        outcomes = (*get_args(Ending), UNREADABLE, SUSPECT)
        if outcome is not None and outcome not in outcomes:
            return f"no such outcome as {outcome}; use one of: {', '.join(outcomes)}"
        made = sorted({one.study for one in self.studies()} - {""})
        if study is not None and made and study not in made:
            return f"no run was first made for a study {study}; use one of: {', '.join(made)}"
        return ""

    def listed(self, wanted: "Listing") -> "tuple[pd.DataFrame, int]":
        """The part of all runs that a listing asks for, with the columns of `runs`, `packing_key` and `flow_rate`
        [kg/s]; and how many runs fit it altogether. The flow rate is that of the newest version of the measure and of
        the window that opens last."""
        rates = measurements.alias()
        rate = (
            select(rates.c.value)
            .where(rates.c.run_key == runs.c.run_key, rates.c.quantity == FLOW_RATE, rates.c.value.is_not(None))
            .order_by(rates.c.version.desc(), rates.c.window_start.desc())
            .limit(1)
            .scalar_subquery()
        )
        columns = (runs.c[name].label(name) for name in (*RUN_COLUMNS, "packing_key"))
        found = select(*columns, rate.label(FLOW_RATE)).where(*wanted.conditions())
        column = rate if wanted.sort == FLOW_RATE else runs.c[wanted.sort]
        ordered = found.order_by(
            column.desc().nulls_last() if wanted.descending else column.asc().nulls_first(), runs.c.run_key
        )
        with self._asking() as connection:
            total = connection.scalar(select(func.count()).select_from(runs).where(*wanted.conditions())) or 0
        limited = ordered.offset(wanted.offset)
        return self._frame(limited if wanted.limit is None else limited.limit(wanted.limit)), total

    def studies(self) -> list[StudyCount]:
        """How many runs there are of each study, backend and outcome."""
        columns = runs.c.study, runs.c.backend, runs.c.outcome
        query = select(*columns, func.count(), func.max(runs.c.finished)).group_by(*columns)
        with self._asking() as connection:
            return [StudyCount(row[0], row[1] or "", *row[2:4], row[4] or "") for row in connection.execute(query)]

    def counts(self) -> dict[str, int]:
        """Number of runs by outcome."""
        with self._asking() as connection:
            rows = connection.execute(select(runs.c.outcome, func.count()).group_by(runs.c.outcome))
            return {outcome: count for outcome, count in rows}

    def suspect_count(self) -> int:
        """Number of runs that are suspect."""
        with self._asking() as connection:
            return connection.scalar(select(func.count()).select_from(runs).where(_ended(SUSPECT))) or 0

    def packing_count(self) -> int:
        """Number of packings."""
        with self._asking() as connection:
            return connection.scalar(select(func.count()).select_from(packings)) or 0

    def matching(self, prefix: str) -> list[str]:
        """Run keys that begin with `prefix`, at most ten."""
        query = select(runs.c.run_key).where(runs.c.run_key.istartswith(prefix, autoescape=True)).limit(10)
        with self._asking() as connection:
            return list(connection.scalars(query))

    def entries(self, run_keys: Iterable[str] = (), lineages: Iterable[str] = ()) -> list[Entry]:
        """What is known of runs with these keys or of these lineages."""
        query = _ENTRIES
        with self._asking() as connection:
            rows = among(connection, query, runs.c.run_key, run_keys)
            rows += among(connection, query, runs.c.lineage_key, lineages)
            return [_entry(row) for row in rows]

    def damaged(self) -> list[Entry]:
        """What is known of runs that cannot be read."""
        query = _ENTRIES.where(runs.c.problem.is_not(None))
        with self._asking() as connection:
            return [_entry(row) for row in connection.execute(query)]

    def unreadable(self) -> list[str]:
        """Files of runs and of their packings that cannot be read, and why, each once. What is not as it was indexed is
        read now; a folder that is gone is no damage."""
        query = select(runs.c.run_key, runs.c.stamp, runs.c.packing_key, runs.c.problem).order_by(runs.c.run_key)
        with self._asking() as connection:
            rows = connection.execute(query).fetchall()
        found: dict[str, None] = {}
        for row in rows:
            folder = self.lab.run(row.run_key)
            problem = row.problem if stamp(folder) == row.stamp else _problem_of_run(folder)
            if problem is None and row.packing_key:
                problem = self.packing_problem(row.packing_key)
            if problem is not None:
                found[problem] = None
        return list(found)

    def versions(self, backend: str) -> list[int]:
        """Versions of `backend` of which there are runs."""
        query = select(runs.c.cache_version).where(runs.c.backend == backend).distinct()
        with self._asking() as connection:
            return [version for version in connection.scalars(query) if version is not None]

    def changed(self, keys: Iterable[str]) -> set[str]:
        """Which of these runs are not as they were indexed: a file in their folder came, went or was written to, or
        their packing cannot be read."""
        query = select(runs.c.run_key, runs.c.stamp, runs.c.packing_key)
        with self._asking() as connection:
            rows = among(connection, query, runs.c.run_key, keys)
        packed = {row.packing_key for row in rows if row.packing_key is not None}
        lost = {key for key in packed if self.packing_problem(key) is not None}
        return {row.run_key for row in rows if stamp(self.lab.run(row.run_key)) != row.stamp or row.packing_key in lost}

    def packing_problem(self, key: str) -> str | None:
        """Why the packing with this key cannot be started from; None if it can. One that is not as it was indexed is
        read as a whole."""
        folder = self.lab.packing(key)
        seen = stamp(folder)
        if self._packings is None:
            columns = packings.c.packing_key, packings.c.stamp, packings.c.problem
            with self._asking() as connection:
                self._packings = {(row[0], row[1]): row[2] for row in connection.execute(select(*columns))}
        if (key, seen) not in self._packings:
            self._packings[key, seen] = _problem(folder)
        return self._packings[key, seen]

    def note_packing(self, key: str, stamp: int) -> None:
        """Take note of a packing that this process has just put into the lab, so that it is not read for this."""
        if self._packings is not None:
            self._packings[key, stamp] = None

    def measurements(self, run_key: str | None = None) -> "pd.DataFrame":
        """Measured numbers of a run, or of all runs, with run, measure, version and window: of every measure and window
        those by its newest version."""
        query = select(measurements).order_by(measurements.c.run_key, measurements.c.quantity)
        found = self._frame(query if run_key is None else query.where(measurements.c.run_key == run_key))
        one = ["run_key", "measure", "window_start", "window_end", "window_timed", "window_scales"]
        older = found["version"].to_numpy() < found.groupby(one)["version"].transform("max").to_numpy()
        return found.drop(index=found.index[older]).reset_index(drop=True)

    def measured(
        self, run_keys: Iterable[str], window: "Window"
    ) -> dict[str, dict[tuple[str, int], list[Mapping[str, Any]]]]:
        """Rows of measurements within a window by run, and of each by name and version of the measure."""
        found: dict[str, dict[tuple[str, int], list[Mapping[str, Any]]]] = {}
        query = select(measurements).where(
            measurements.c.window_start == window.start,
            measurements.c.window_end == window.end,
            measurements.c.window_timed == window.timed,
            measurements.c.window_scales == scales.in_text(window),
        )
        names = [column.key for column in measurements.columns]
        with self._asking() as connection:
            for row in among(connection, query, measurements.c.run_key, run_keys):
                told = dict(zip(names, row, strict=True))
                of_run = found.setdefault(told["run_key"], {})
                of_run.setdefault((told["measure"], told["version"]), []).append(told)
        return found

    def values(
        self,
        run_keys: Iterable[str],
        quantity: str,
        version: int,
        window: Window,
        *,
        suspects: bool,
        exposures: bool = False,
    ) -> dict[str, float]:
        """The finite values of one quantity, by run; runs that diverged have none, nor those that are suspect unless
        `suspects` says so. `exposures`: in place of values of a rate, what they are over."""
        column = measurements.c.n_effective if exposures else measurements.c.value
        query = select(measurements.c.run_key, column).where(
            measurements.c.run_key == runs.c.run_key,
            runs.c.outcome != "diverged",
            measurements.c.quantity == quantity,
            measurements.c.version == version,
            measurements.c.window_start == window.start,
            measurements.c.window_end == window.end,
            measurements.c.window_timed == window.timed,
            measurements.c.window_scales == scales.in_text(window),
            measurements.c.value.is_not(None),
        )
        if not suspects:
            query = query.where(runs.c.suspect == "")
        with self._asking() as connection:
            return {key: value for key, value in among(connection, query, measurements.c.run_key, run_keys)}

    def speeds(self, backend: str, machine: str, device: str) -> list[tuple[str, int, float]]:
        """(run key, grains, grain-steps per second) of the latest 50 runs of `backend` on this machine and device."""
        query = (
            select(runs.c.run_key, runs.c.grains, runs.c.rate)
            .where(runs.c.backend == backend, runs.c.machine == machine, runs.c.device == device, runs.c.rate > 0)
            .order_by(runs.c.finished.desc().nulls_last())
            .limit(50)
        )
        with self._asking() as connection:
            return [(key, grains, rate) for key, grains, rate in connection.execute(query)]

    def settling(self) -> dict[str, float]:
        """Mean simulated time [s] that fillings of a closed scene took to settle, by its key."""
        query = select(packings.c.closed_key, func.avg(packings.c.duration)).group_by(packings.c.closed_key)
        with self._asking() as connection:
            return {key: mean for key, mean in connection.execute(query) if mean is not None}

    def close(self) -> None:
        """Let go of the file."""
        self._engine.dispose()

    def _frame(self, query) -> "pd.DataFrame":
        import pandas as pd

        with self._asking() as connection:
            result = connection.execute(query)
            return pd.DataFrame.from_records(result.fetchall(), columns=list(result.keys()))


def _entry(row: Row) -> Entry:
    """A row of the index; what a damaged run does not tell is empty."""
    said: dict[str, Any] = {name: getattr(row, name) or ("" if name != "cache_version" else 0) for name in _SAID}
    coverage = Coverage.model_validate_json(row.coverage) if row.coverage else None
    times: dict[str, Any] = {name: getattr(row, name) or 0.0 for name in ("wall_time", "filling_time")}
    return Entry(coverage=coverage, problem=row.problem, stamp=row.stamp, suspect=row.suspect, **said, **times)


def _problem_of_run(folder: Path) -> str | None:
    try:
        if folder.is_dir():
            open_run(folder)
    except Unreadable as problem:
        return str(problem)
    return None


def _problem(folder: Path) -> str | None:
    try:
        read_packing(folder)
    except Unreadable as problem:
        return str(problem)
    return None


RUN_COLUMNS = (
    "run_key",
    "study",
    "label",
    "seed",
    "discharge",
    "backend",
    "cache_version",
    "outcome",
    "grains",
    "discharged",
    "duration",
    "wall_time",
    "rate",
    "finished",
    "device",
    "bytes",
    "problem",
    "suspect",
)
