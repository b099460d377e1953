"""Read-only queries on the index of a lab."""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from pydantic import ValidationError
from sqlalchemy import ColumnElement, Connection, Engine, Row, ScalarSelect, func, select
from sqlalchemy.exc import DatabaseError

from labbook.lab import server
from labbook.lab.database import (
    DAMAGED,
    SCHEMA_VERSION,
    NoCatalogue,
    empty,
    index_error,
    measurements,
    on_server,
    open_connection,
    open_engine,
    packings,
    runs,
    schema_version,
    select_in,
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
    """Index entry of one run, as the planner and results use it.

    Args:
        run_key: Key of the run.
        lineage_key: Key that the run shares with runs of other versions of its backend.
        cache_version: Version of the backend.
        outcome: How the run ended (`labbook.lab.records.Outcome`), or UNREADABLE.
        coverage: Duration, steps and probes of the run; None of a damaged run.
        problem: Why the folder cannot be read; None if it can be.
    """

    run_key: str
    lineage_key: str
    cache_version: int
    outcome: str
    coverage: Coverage | None
    problem: str | None = None
    stamp: int = 0
    """Stamp of the folder when it was indexed (`labbook.lab.folder.stamp`)."""
    packing_key: str = ""
    """Key of the packing from which the run started."""
    backend: str = ""
    device: str = ""
    finished: str = ""
    """End of the run (UTC, ISO 8601)."""
    suspect: str = ""
    """Reason for which the run is suspect (`labbook.lab.suspect`); empty if it is not."""
    device_time: float = 0.0
    """Device time [s]; the wall time spent stepping where a record of an older version has none."""
    filling_time: float = 0.0
    """The same of its packing [s]; 0 where the index lacks it."""

    @classmethod
    def of(cls, record: RunRecord, stamp: int) -> "Entry":
        """Make the entry from a run's record and the stamp of its folder."""
        attributes = {name: getattr(record, name) for name in _RECORD_ATTRIBUTES}
        return cls(
            coverage=record.coverage,
            stamp=stamp,
            suspect=suspicion(record.ledger),
            device_time=record.wall_time if record.device_time is None else record.device_time,
            **attributes,
        )

    @property
    def frame_interval(self) -> float | None:
        """Time between two recorded frames [s]; None without any."""
        return None if self.coverage is None else self.coverage.frame_interval


_RECORD_ATTRIBUTES = (
    "run_key",
    "lineage_key",
    "cache_version",
    "outcome",
    "packing_key",
    "backend",
    "device",
    "finished",
)
"""Attributes that a record and an index row have under the same name."""
_TIMES = {
    "device_time": func.coalesce(runs.c.device_time, runs.c.wall_time).label("device_time"),
    "filling_time": func.coalesce(packings.c.device_time, packings.c.wall_time).label("filling_time"),
}
_ENTRIES = select(
    *(_TIMES[name] if name in _TIMES else runs.c[name] for name in Entry.__dataclass_fields__)
).select_from(runs.outerjoin(packings, packings.c.packing_key == runs.c.packing_key))
"""Query for the rows from which entries are made."""


@dataclass(frozen=True)
class StudyCount:
    """Number of runs of a study with one backend and outcome; `latest`: end of the latest of them."""

    study: str
    backend: str
    outcome: str
    runs: int
    latest: str


SUSPECT = "suspect"
"""Filter value in place of an outcome: suspect runs, whatever their outcome."""


FLOW_RATE = "flow_rate"
"""Quantity by which runs can be sorted."""


def _has_outcome(outcome: str) -> "ColumnElement[bool]":
    return runs.c.suspect != "" if outcome == SUSPECT else runs.c.outcome == outcome


@dataclass(frozen=True)
class Listing:
    """Filters, sort order and page of a list of runs. A filter that is None passes all runs."""

    study: str | None = None
    backend: str | None = None
    outcome: str | None = None
    """Outcome of the runs, or SUSPECT."""
    packing: str | None = None
    """Key of the packing from which they started."""
    text: str | None = None
    """Part of the label or of the study's name, or beginning of the run key."""
    keys: tuple[str, ...] | None = None
    """Keys of the runs: at most some hundred."""
    since: str | None = None
    """Only runs that ended at this moment or later (UTC, the beginning of an ISO 8601 text)."""
    sort: str = "finished"
    """One of RUN_COLUMNS, or FLOW_RATE."""
    descending: bool = True
    offset: int = 0
    limit: int | None = 100

    def conditions(self) -> "list[ColumnElement[bool]]":
        """Return the filters as conditions of SQL."""
        filters = {"study": self.study, "backend": self.backend, "packing_key": self.packing}
        clauses: list[ColumnElement[bool]] = [
            runs.c[name] == value for name, value in filters.items() if value is not None
        ]
        if self.outcome is not None:
            clauses.append(_has_outcome(self.outcome))
        if self.text:
            # autoescape: % and _ in the text are characters, not wildcards of LIKE
            key_begins = runs.c.run_key.istartswith(self.text, autoescape=True)
            clauses.append(runs.c.label.icontains(self.text, autoescape=True)
                         | runs.c.study.icontains(self.text, autoescape=True) | key_begins)  # fmt: skip
        if self.keys is not None:
            clauses.append(runs.c.run_key.in_(self.keys))
        if self.since is not None:
            clauses.append(runs.c.finished >= self.since)
        return clauses


class Catalogue:
    """Reader of the index of one lab.

    Args:
        lab: Folder of the lab.

    Raises:
        NoCatalogue: There are runs, but no index of this version.
        LabError: The index cannot be read.
    """

    def __init__(self, lab: Path | LabFolder):
        self.lab = lab if isinstance(lab, LabFolder) else LabFolder(lab)
        self._engine = self._open()
        self._packings: dict[tuple[str, int], str | None] | None = None
        """Problem of each packing (None if it can be read), by its key and the stamp of its folder."""

    def _open(self) -> Engine:
        path, folder = self.lab.catalogue, self.lab.folder
        if folder.exists() and not folder.is_dir():
            raise LabError(f"{folder} is a file, not a lab folder; give another one with --lab")
        exists = path.exists() or server.address(self.lab) is not None
        if not exists:
            # readers write nothing: an index that is missing is made by those who run, and never by a glance
            if self.lab.runs.is_dir() and any(self.lab.runs.iterdir()):
                raise NoCatalogue(self.lab, "is missing")
            return empty()
        engine = open_engine(self.lab, read_only=True)
        try:
            version = schema_version(engine) if on_server(engine) or path.is_file() else DAMAGED
        except DatabaseError as error:
            raise index_error(self.lab, error) from error
        if version is None and on_server(engine):
            raise NoCatalogue(self.lab, "is missing")
        if version != SCHEMA_VERSION:
            old = "is of another version of labbook, or damaged"
            raise NoCatalogue(self.lab, "is damaged" if version == DAMAGED else old)
        return engine

    @contextmanager
    def _connection(self) -> Iterator[Connection]:
        """Open a connection for one query. Raises LabError."""
        try:
            with open_connection(self._engine, self.lab) as connection:
                yield connection
        except ValidationError as error:  # a damaged page may hold other text than was written
            raise NoCatalogue(self.lab, "is damaged") from error

    def runs(self, study: str | None = None, outcome: str | None = None, limit: int | None = None) -> "pd.DataFrame":
        """Table of runs, the latest first.

        Args:
            study: Name of a study; None: all studies.
            outcome: An outcome, or SUSPECT; None: all outcomes.
            limit: Maximum number of rows.

        Returns:
            Columns: run_key, study, label, seed, discharge (number of the discharge of its bed, from 1), backend,
                cache_version, outcome, grains, discharged, duration [s], wall_time [s], device_time (share of the time
                of the device; absent of runs of older versions) [s], rate [grain-steps/s], finished, device, bytes,
                problem, suspect (reason; empty if the run is not suspect), scene_key (of readable runs; it tells points
                of equal label apart if two studies share a name).
        """
        query = select(*(runs.c[name].label(name) for name in (*RUN_COLUMNS, "scene_key"))).order_by(
            runs.c.finished.desc().nulls_last(), runs.c.run_key
        )
        if study is not None:
            query = query.where(runs.c.study == study)
        if outcome is not None:
            query = query.where(_has_outcome(outcome))
        return self._frame(query.limit(limit) if limit is not None else query)

    def absent(self, study: str | None, outcome: str | None) -> str:
        """Explain why no run can match a study name or an outcome, and name the valid ones; empty if one can match."""
        outcomes = (*get_args(Ending), UNREADABLE, SUSPECT)
        if outcome is not None and outcome not in outcomes:
            return f"no such outcome as {outcome}; use one of: {', '.join(outcomes)}"
        names = sorted({count.study for count in self.studies()} - {""})
        if study is not None and names and study not in names:
            return f"no run was first made for a study {study}; use one of: {', '.join(names)}"
        return ""

    def listed(self, listing: "Listing") -> "tuple[pd.DataFrame, int]":
        """Select one page of the list of runs.

        Args:
            listing: Filters, sort order and page.

        Returns:
            Table with the columns of `runs` (without scene_key), packing_key and flow_rate [kg/s], and the number of
            runs on all pages.
        """
        rate = _flow_rate()
        columns = (runs.c[name].label(name) for name in (*RUN_COLUMNS, "packing_key"))
        query = select(*columns, rate.label(FLOW_RATE)).where(*listing.conditions())
        column = rate if listing.sort == FLOW_RATE else runs.c[listing.sort]
        # by the key at last: among equal values the order would be free, and pages would overlap
        # places of NULL are stated: SQLite takes it for the smallest value, PostgreSQL for the largest
        ordered = query.order_by(
            column.desc().nulls_last() if listing.descending else column.asc().nulls_first(), runs.c.run_key
        )
        with self._connection() as connection:
            total = connection.scalar(select(func.count()).select_from(runs).where(*listing.conditions())) or 0
        limited = ordered.offset(listing.offset)
        return self._frame(limited if listing.limit is None else limited.limit(listing.limit)), total

    def studies(self) -> list[StudyCount]:
        """Count runs by study, backend and outcome."""
        columns = runs.c.study, runs.c.backend, runs.c.outcome
        query = select(*columns, func.count(), func.max(runs.c.finished)).group_by(*columns)
        with self._connection() as connection:
            return [StudyCount(row[0], row[1] or "", *row[2:4], row[4] or "") for row in connection.execute(query)]

    def counts(self) -> dict[str, int]:
        """Count runs by outcome."""
        with self._connection() as connection:
            rows = connection.execute(select(runs.c.outcome, func.count()).group_by(runs.c.outcome))
            return {outcome: count for outcome, count in rows}

    def suspect_count(self) -> int:
        """Number of runs that are suspect."""
        with self._connection() as connection:
            return connection.scalar(select(func.count()).select_from(runs).where(_has_outcome(SUSPECT))) or 0

    def packing_count(self) -> int:
        """Number of packings."""
        with self._connection() as connection:
            return connection.scalar(select(func.count()).select_from(packings)) or 0

    def matching(self, prefix: str) -> list[str]:
        """Run keys that begin with `prefix`, at most ten."""
        query = select(runs.c.run_key).where(runs.c.run_key.istartswith(prefix, autoescape=True)).limit(10)
        with self._connection() as connection:
            return list(connection.scalars(query))

    def entries(self, run_keys: Iterable[str] = (), lineages: Iterable[str] = ()) -> list[Entry]:
        """Return the entries of runs with these keys, and of runs of these lineages."""
        query = _ENTRIES
        with self._connection() as connection:
            rows = select_in(connection, query, runs.c.run_key, run_keys)
            rows += select_in(connection, query, runs.c.lineage_key, lineages)
            return [_entry(row) for row in rows]

    def damaged(self) -> list[Entry]:
        """Return the entries of runs that cannot be read."""
        query = _ENTRIES.where(runs.c.problem.is_not(None))
        with self._connection() as connection:
            return [_entry(row) for row in connection.execute(query)]

    def unreadable(self) -> list[str]:
        """Problems of run folders and of their packings, each once.

        A folder that has changed since it was indexed is read now. A folder that is gone is not damaged.
        """
        query = select(runs.c.run_key, runs.c.stamp, runs.c.packing_key, runs.c.problem).order_by(runs.c.run_key)
        with self._connection() as connection:
            rows = connection.execute(query).fetchall()
        problems: dict[str, None] = {}
        for row in rows:
            folder = self.lab.run(row.run_key)
            # a stamp is one look at the folder: with thousands of runs, files are read of the changed ones only
            problem = row.problem if stamp(folder) == row.stamp else _problem_of_run(folder)
            if problem is None and row.packing_key:
                problem = self.packing_problem(row.packing_key)
            if problem is not None:
                problems[problem] = None
        return list(problems)

    def versions(self, backend: str) -> list[int]:
        """Versions of `backend` that have made runs in this lab."""
        query = select(runs.c.cache_version).where(runs.c.backend == backend).distinct()
        with self._connection() as connection:
            return [version for version in connection.scalars(query) if version is not None]

    def changed(self, keys: Iterable[str]) -> set[str]:
        """Select the runs whose folder differs from the index: a file was added, removed or written, or the packing
        cannot be read."""
        query = select(runs.c.run_key, runs.c.stamp, runs.c.packing_key)
        with self._connection() as connection:
            rows = select_in(connection, query, runs.c.run_key, keys)
        packed = {row.packing_key for row in rows if row.packing_key is not None}
        lost = {key for key in packed if self.packing_problem(key) is not None}
        return {row.run_key for row in rows if stamp(self.lab.run(row.run_key)) != row.stamp or row.packing_key in lost}

    def packing_problem(self, key: str) -> str | None:
        """Return why no run can start from the packing with this key; None if runs can.

        A packing that has changed since it was indexed is read completely.
        """
        folder = self.lab.packing(key)
        current = stamp(folder)
        if self._packings is None:
            columns = packings.c.packing_key, packings.c.stamp, packings.c.problem
            with self._connection() as connection:
                self._packings = {(row[0], row[1]): row[2] for row in connection.execute(select(*columns))}
        # the stamp is part of the key, so that a packing is read again only after its folder has changed
        if (key, current) not in self._packings:
            self._packings[key, current] = _problem_of_packing(folder)
        return self._packings[key, current]

    def note_packing(self, key: str, stamp: int) -> None:
        """Mark a packing as readable that this process has just written, to save reading it."""
        if self._packings is not None:
            self._packings[key, stamp] = None

    def measurements(self, run_key: str | None = None) -> "pd.DataFrame":
        """Table of the measured numbers of a run, or of all runs: for each measure and window those of its newest
        version."""
        query = select(measurements).order_by(measurements.c.run_key, measurements.c.quantity)
        frame = self._frame(query if run_key is None else query.where(measurements.c.run_key == run_key))
        group = ["run_key", "measure", "window_start", "window_end", "window_timed", "window_scales"]
        # the version is part of the key of a row, so that rows of older versions stay
        superseded = frame["version"].to_numpy() < frame.groupby(group)["version"].transform("max").to_numpy()
        return frame.drop(index=frame.index[superseded]).reset_index(drop=True)

    def measured(
        self, run_keys: Iterable[str], window: "Window"
    ) -> dict[str, dict[tuple[str, int], list[Mapping[str, Any]]]]:
        """Rows of measurements within a window, by run key and then by (name, version) of the measure."""
        rows: dict[str, dict[tuple[str, int], list[Mapping[str, Any]]]] = {}
        query = select(measurements).where(
            measurements.c.window_start == window.start,
            measurements.c.window_end == window.end,
            measurements.c.window_timed == window.timed,
            measurements.c.window_scales == scales.in_text(window),
        )
        names = [column.key for column in measurements.columns]
        with self._connection() as connection:
            for row in select_in(connection, query, measurements.c.run_key, run_keys):
                record = dict(zip(names, row, strict=True))
                of_run = rows.setdefault(record["run_key"], {})
                of_run.setdefault((record["measure"], record["version"]), []).append(record)
        return rows

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
        """Return the finite values of one quantity, by run key.

        Args:
            run_keys: Keys of the runs.
            quantity: Name of the quantity.
            version: Version of its measure.
            window: Window of the measurement.
            suspects: Include suspect runs. Diverged runs are never included.
            exposures: Return the exposures of a rate (`n_effective`) in place of its values.
        """
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
        with self._connection() as connection:
            return {key: value for key, value in select_in(connection, query, measurements.c.run_key, run_keys)}

    def device_times(self, run_keys: Iterable[str], packing_keys: Iterable[str]) -> dict[str, float | None]:
        """Return the device times [s] of runs and packings by key; None where older records have none."""
        with self._connection() as connection:
            rows = select_in(connection, select(runs.c.run_key, runs.c.device_time), runs.c.run_key, run_keys)
            query = select(packings.c.packing_key, packings.c.device_time)
            rows += select_in(connection, query, packings.c.packing_key, packing_keys)
            return {key: device_time for key, device_time in rows}

    def flow_rates(self, run_keys: Iterable[str]) -> dict[str, float]:
        """Flow rates [kg/s] of runs by their key, as in `listed`."""
        rate = _flow_rate()
        query = select(runs.c.run_key, rate).where(rate.is_not(None))
        with self._connection() as connection:
            return {key: value for key, value in select_in(connection, query, runs.c.run_key, run_keys)}

    def speeds(self, backend: str, machine: str, device: str) -> list[tuple[str, int, float]]:
        """(run key, grains, grain-steps per second) of the latest 50 runs of `backend` on this machine and device."""
        query = (
            select(runs.c.run_key, runs.c.grains, runs.c.rate)
            .where(runs.c.backend == backend, runs.c.machine == machine, runs.c.device == device, runs.c.rate > 0)
            .order_by(runs.c.finished.desc().nulls_last())
            .limit(50)
        )
        with self._connection() as connection:
            return [(key, grains, rate) for key, grains, rate in connection.execute(query)]

    def settling(self) -> dict[str, float]:
        """Mean simulated time [s] that fillings took to settle, by the key of the closed scene."""
        query = select(packings.c.closed_key, func.avg(packings.c.duration)).group_by(packings.c.closed_key)
        with self._connection() as connection:
            return {key: mean for key, mean in connection.execute(query) if mean is not None}

    def close(self) -> None:
        """Close the connections to the index."""
        self._engine.dispose()

    def _frame(self, query) -> "pd.DataFrame":
        import pandas as pd

        with self._connection() as connection:
            result = connection.execute(query)
            return pd.DataFrame.from_records(result.fetchall(), columns=list(result.keys()))


def _flow_rate() -> ScalarSelect[float]:
    """Flow rate of each run [kg/s]: by the newest version of the measure, in the window that opens last (and closes
    last)."""
    rates = measurements.alias()
    return (
        select(rates.c.value)
        .where(rates.c.run_key == runs.c.run_key, rates.c.quantity == FLOW_RATE, rates.c.value.is_not(None))
        .order_by(rates.c.version.desc(), rates.c.window_start.desc(), rates.c.window_end.desc())
        .limit(1)
        .scalar_subquery()
    )


def _entry(row: Row) -> Entry:
    """Make an entry from a row of the index; values that a damaged run lacks are empty."""
    attributes: dict[str, Any] = {
        name: getattr(row, name) or ("" if name != "cache_version" else 0) for name in _RECORD_ATTRIBUTES
    }
    coverage = Coverage.model_validate_json(row.coverage) if row.coverage else None
    times: dict[str, Any] = {name: getattr(row, name) or 0.0 for name in _TIMES}
    return Entry(coverage=coverage, problem=row.problem, stamp=row.stamp, suspect=row.suspect, **attributes, **times)


def _problem_of_run(folder: Path) -> str | None:
    try:
        if folder.is_dir():
            open_run(folder)
    except Unreadable as problem:
        return str(problem)
    return None


def _problem_of_packing(folder: Path) -> str | None:
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
    "device_time",
    "rate",
    "finished",
    "device",
    "bytes",
    "problem",
    "suspect",
)
