"""The catalogue: what is in the lab, quick to ask. Readers open it read-only."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from sqlalchemy import Engine, func, select

from labbook.catalogue.connect import connect, empty, schema_version
from labbook.catalogue.finished import FinishedRun
from labbook.catalogue.lab import Lab
from labbook.catalogue.record import Coverage
from labbook.catalogue.schema import SCHEMA_VERSION, measurements, packings, runs

if TYPE_CHECKING:
    import pandas as pd

    from labbook.measure import Window
    from labbook.plan.demand import Demand
    from labbook.study import Study

_CHUNK = 500  # keys in one query, well below SQLite's limit on variables


class NoCatalogue(Exception):
    """There is no catalogue, or it is of another version of labbook; the message says what to do."""


@dataclass(frozen=True)
class Entry:
    """What the catalogue knows of one run when planning."""

    run_key: str
    lineage_key: str
    cache_version: int
    outcome: str
    coverage: Coverage | None
    problem: str | None = None


class Catalogue:
    """Questions to the index of one lab. Raises NoCatalogue if there are runs but no index of this
    version."""

    def __init__(self, lab: Path | Lab):
        self.lab = lab if isinstance(lab, Lab) else Lab(lab)
        self._engine = self._open()

    def _open(self) -> Engine:
        path = self.lab.catalogue
        if not path.exists():
            if self.lab.runs.is_dir() and any(self.lab.runs.iterdir()):
                raise NoCatalogue(f"{path} is missing; make it again: labbook reindex --lab {self.lab.folder}")
            return empty()
        engine = connect(path, read_only=True)
        if schema_version(engine) != SCHEMA_VERSION:
            raise NoCatalogue(
                f"{path} is of another version of labbook, or damaged; make it again: "
                f"labbook reindex --lab {self.lab.folder}"
            )
        return engine

    def runs(self, study: str | None = None, outcome: str | None = None, limit: int | None = None) -> "pd.DataFrame":
        """Runs, the latest first: key, study, point, seed, engine, outcome, how far, speed, size.

        Columns: run_key, study, label, seed, engine, cache_version, outcome, grains, discharged, duration
        [s], wall_time [s], rate [grain-steps/s], finished, device, bytes, problem.
        """
        query = select(*(runs.c[name] for name in RUN_COLUMNS)).order_by(runs.c.finished.desc(), runs.c.run_key)
        if study is not None:
            query = query.where(runs.c.study == study)
        if outcome is not None:
            query = query.where(runs.c.outcome == outcome)
        return self._frame(query.limit(limit) if limit is not None else query)

    def counts(self) -> dict[str, int]:
        """Number of runs by outcome."""
        with self._engine.connect() as connection:
            rows = connection.execute(select(runs.c.outcome, func.count()).group_by(runs.c.outcome))
            return {outcome: count for outcome, count in rows}

    def packing_count(self) -> int:
        """Number of packings."""
        with self._engine.connect() as connection:
            return connection.scalar(select(func.count()).select_from(packings)) or 0

    def matching(self, prefix: str) -> list[str]:
        """Run keys that begin with `prefix`, at most ten."""
        query = select(runs.c.run_key).where(runs.c.run_key.startswith(prefix, autoescape=True)).limit(10)
        with self._engine.connect() as connection:
            return list(connection.scalars(query))

    def entries(self, run_keys: Iterable[str] = (), lineages: Iterable[str] = ()) -> list[Entry]:
        """What is known of runs with these keys or of these lineages."""
        columns = (runs.c[name] for name in Entry.__dataclass_fields__)
        base = select(*columns)
        rows = []
        with self._engine.connect() as connection:
            for column, wanted in ((runs.c.run_key, list(run_keys)), (runs.c.lineage_key, list(lineages))):
                for at in range(0, len(wanted), _CHUNK):
                    rows += connection.execute(base.where(column.in_(wanted[at : at + _CHUNK]))).all()
        return [
            Entry(
                row.run_key,
                row.lineage_key or "",
                row.cache_version or 0,
                row.outcome,
                Coverage.model_validate_json(row.coverage) if row.coverage else None,
                row.problem,
            )
            for row in rows
        ]

    def finished(self, study: "Study", engine: str) -> list[FinishedRun]:
        """Runs of `study` on `engine` that cover its stop rule and measures, by point and seed.

        Replicates beyond the minimum count too. The runs of one point are all of one version of the engine, the
        newest that has any: what several versions computed is never pooled.
        """
        from labbook.plan.coverage import shortfall
        from labbook.plan.demand import demands
        from labbook.plan.replicates import stopping_rule

        asked: dict[str, list[Demand]] = defaultdict(list)  # points that come to the same scene share their runs
        for demand in demands(study, stopping_rule(study).cap):
            asked[demand.lineage(engine)].append(demand)
        found: list[tuple[Demand, Entry]] = []
        for entry in self.entries(lineages=asked):
            if entry.coverage is None:
                continue
            for demand in asked[entry.lineage_key]:
                shared = demand.shared
                lacks = shortfall(entry.outcome, entry.coverage, shared.stop, demand.guards, shared.probe_names)
                if lacks.gap == "none":
                    found.append((demand, entry))
        newest: dict[int, int] = {}
        for demand, entry in found:
            newest[demand.point.index] = max(entry.cache_version, newest.get(demand.point.index, entry.cache_version))
        found.sort(key=lambda pair: (pair[0].point.index, pair[0].seed))
        return [
            FinishedRun(demand.point, demand.seed, entry.run_key, self.lab.run(entry.run_key), entry.outcome)
            for demand, entry in found
            if entry.cache_version == newest[demand.point.index]
        ]

    def measurements(self, run_keys: Sequence[str] | None = None, quantity: str | None = None) -> "pd.DataFrame":
        """Measured numbers, with run, measure, version and window; of all runs unless `run_keys` are
        given."""
        base = select(measurements).order_by(measurements.c.run_key, measurements.c.quantity)
        if quantity is not None:
            base = base.where(measurements.c.quantity == quantity)
        if run_keys is None:
            return self._frame(base)
        import pandas as pd

        parts = [
            self._frame(base.where(measurements.c.run_key.in_(run_keys[at : at + _CHUNK])))
            for at in range(0, max(1, len(run_keys)), _CHUNK)
        ]
        return pd.concat(parts, ignore_index=True)

    def values(self, run_keys: Sequence[str], quantity: str, version: int, window: "Window") -> dict[str, float]:
        """The finite values of one quantity, by run."""
        query = select(measurements.c.run_key, measurements.c.value).where(
            measurements.c.quantity == quantity,
            measurements.c.version == version,
            measurements.c.window_start == window.start,
            measurements.c.window_end == window.end,
            measurements.c.value.is_not(None),
            measurements.c.run_key.in_(run_keys),
        )
        with self._engine.connect() as connection:
            return {key: value for key, value in connection.execute(query)}

    def speeds(self, engine: str, machine: str, device: str) -> list[tuple[str, int, float]]:
        """(run key, grains, grain-steps per second) of the latest 50 runs of `engine` on this machine and device."""
        query = (
            select(runs.c.run_key, runs.c.grains, runs.c.rate)
            .where(runs.c.engine == engine, runs.c.machine == machine, runs.c.device == device, runs.c.rate > 0)
            .order_by(runs.c.finished.desc())
            .limit(50)
        )
        with self._engine.connect() as connection:
            return [(key, grains, rate) for key, grains, rate in connection.execute(query)]

    def settling(self, closed_key: str) -> float | None:
        """Mean simulated time [s] that fillings of this closed scene took to settle, or None."""
        with self._engine.connect() as connection:
            return connection.scalar(select(func.avg(packings.c.duration)).where(packings.c.closed_key == closed_key))

    def close(self) -> None:
        """Let go of the file."""
        self._engine.dispose()

    def _frame(self, query) -> "pd.DataFrame":
        import pandas as pd

        with self._engine.connect() as connection:
            result = connection.execute(query)
            return pd.DataFrame.from_records(result.fetchall(), columns=list(result.keys()))


RUN_COLUMNS = (
    "run_key",
    "study",
    "label",
    "seed",
    "engine",
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
)
