"""Tables of the index. They are never migrated: another SCHEMA_VERSION means that the index is made again."""

from sqlalchemy import Column, Float, Index, Integer, MetaData, String, Table, Text

SCHEMA_VERSION = 2

metadata = MetaData()

about = Table("about", metadata, Column("schema_version", Integer, primary_key=True))

runs = Table(
    "runs",
    metadata,
    Column("run_key", String, primary_key=True),
    Column("study", String, nullable=False, default=""),
    Column("label", String, nullable=False, default=""),
    Column("seed", Integer),
    Column("engine", String, key="backend"),
    Column("cache_version", Integer),
    Column("outcome", String, nullable=False),
    Column("grains", Integer),
    Column("discharged", Float),
    Column("duration", Float),
    Column("wall_time", Float),
    Column("rate", Float),
    Column("finished", String),
    Column("device", String),
    Column("machine", String),
    Column("bytes", Integer),
    Column("experiment_key", String),
    Column("scene_key", String),
    Column("packing_key", String),
    Column("lineage_key", String),
    Column("coverage", Text),
    Column("stamp", Integer, nullable=False),
    Column("problem", Text),
    Index("runs_by_lineage", "lineage_key"),
    Index("runs_by_study", "study"),
    Index("runs_by_finish", "finished"),
    Index("runs_by_packing", "packing_key"),
    sqlite_with_rowid=True,
)
"""One row a run folder. `coverage`: that of `run.json`, as JSON; `stamp`: that of the folder
(`labbook.lab.folder.stamp`) when it was read, by which changes are noticed; `outcome` is `unreadable` and `problem`
says why where a folder cannot be read."""

packings = Table(
    "packings",
    metadata,
    Column("packing_key", String, primary_key=True),
    Column("closed_key", String),
    Column("engine", String, key="backend"),
    Column("seed", Integer),
    Column("grains", Integer),
    Column("duration", Float),
    Column("wall_time", Float),
    Column("rate", Float),
    Column("machine", String),
    Column("bytes", Integer),
    Column("stamp", Integer, nullable=False),
    Column("problem", Text),
)

measurements = Table(
    "measurements",
    metadata,
    Column("run_key", String, primary_key=True),
    Column("quantity", String, primary_key=True),
    Column("version", Integer, primary_key=True),
    Column("window_start", Float, primary_key=True),
    Column("window_end", Float, primary_key=True),
    Column("measure", String, nullable=False),
    Column("value", Float),
    Column("error", Float),
    Column("n_effective", Float),
    Column("window", String, nullable=False),
    Column("method", String, nullable=False),
    Column("unit", String, nullable=False),
    Column("note", String, nullable=False),
)
"""What was measured in a run, by version of the measure and by window (fractions of the initial mass
discharged). A measure that gives nothing, or that failed, leaves a row with its own name as quantity, no
value, and a note."""
