"""From a folder to its rows in the index. A folder that cannot be read gives a row that says so."""

import os
from pathlib import Path
from typing import Any

from labbook.catalogue.derive import derive
from labbook.catalogue.finished import CHECKPOINT
from labbook.catalogue.packings import ARRAYS, PackingRecord
from labbook.catalogue.parts import Unreadable
from labbook.catalogue.record import Observe, RunRecord
from labbook.catalogue.schema import packings, runs


def stamps(folder: Path) -> dict[str, int]:
    """Folders in `folder`, each with the time of its last change [ns]."""
    if not folder.is_dir():
        return {}
    return {entry.name: entry.stat().st_mtime_ns for entry in os.scandir(folder) if entry.is_dir()}


def _size(folder: Path) -> int:
    return sum(entry.stat().st_size for entry in os.scandir(folder) if entry.is_file())


def run_rows(folder: Path, observe: Observe | None) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Row of a run, and of its measurements; of a folder that cannot be read, a row that says so."""
    try:
        record = RunRecord.read(folder)
        rows = derive(folder, record, observe or record.observe)
        if not (folder / CHECKPOINT).exists():
            raise Unreadable(f"{folder / CHECKPOINT} is missing")
    except Unreadable as problem:
        return unreadable_row(folder, problem), []
    coverage = record.coverage
    row = {
        "run_key": record.run_key,
        "study": record.study,
        "label": record.label,
        "seed": record.seed,
        "engine": record.engine,
        "cache_version": record.cache_version,
        "outcome": record.outcome,
        "grains": coverage.grains,
        "discharged": coverage.discharged,
        "duration": coverage.duration,
        "wall_time": record.wall_time,
        "rate": record.rate if record.rate == record.rate else None,
        "finished": record.finished,
        "device": record.device,
        "machine": record.sessions[-1].provenance.get("machine"),
        "bytes": _size(folder),
        "experiment_key": record.experiment_key,
        "scene_key": record.scene_key,
        "packing_key": record.packing_key,
        "lineage_key": record.lineage_key,
        "coverage": coverage.model_dump_json(),
        "stamp": folder.stat().st_mtime_ns,
        "problem": None,
    }
    return row, rows


def unreadable_row(folder: Path, problem: Unreadable) -> dict[str, Any]:
    """Row of a run folder that cannot be read."""
    blank = dict.fromkeys(column.name for column in runs.columns)
    return {
        **blank,
        "run_key": folder.name,
        "study": "",
        "label": "",
        "outcome": "unreadable",
        "stamp": folder.stat().st_mtime_ns,
        "problem": str(problem),
    }


def packing_row(folder: Path) -> dict[str, Any]:
    """Row of a packing folder."""
    blank = dict.fromkeys(column.name for column in packings.columns)
    row = {**blank, "packing_key": folder.name, "stamp": folder.stat().st_mtime_ns}
    try:
        record = PackingRecord.read(folder)
        if not (folder / ARRAYS).exists():
            raise Unreadable(f"{folder / ARRAYS} is missing")
    except Unreadable as problem:
        return {**row, "problem": str(problem)}
    return {
        **row,
        "closed_key": record.closed_key,
        "engine": record.engine,
        "seed": record.filling["seed"],
        "grains": record.grains,
        "duration": record.duration,
        "wall_time": record.wall_time,
        "rate": record.rate if record.rate == record.rate else None,
        "machine": record.sessions[-1].provenance.get("machine"),
        "bytes": _size(folder),
    }
