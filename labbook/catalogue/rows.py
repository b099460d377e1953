"""From a folder to its rows in the index. A folder that cannot be read gives a row that says so."""

import os
from pathlib import Path
from typing import Any

from labbook.catalogue.derive import derive
from labbook.catalogue.finished import open_run
from labbook.catalogue.lab import EVALUATION, folders, stamp
from labbook.catalogue.packings import read_packing
from labbook.catalogue.parts import Unreadable
from labbook.catalogue.record import Observe, RunRecord
from labbook.catalogue.schema import packings, runs

UNREADABLE = "unreadable"
"""Outcome, in the index, of a run whose folder cannot be read."""


def stamps(folder: Path) -> dict[str, int]:
    """Folders in `folder`, each with its stamp."""
    return {name: stamp(folder / name) for name in folders(folder)}


def _size(folder: Path) -> int:
    files = (entry for entry in os.scandir(folder) if entry.is_file() and not entry.name.startswith(EVALUATION))
    return sum(entry.stat().st_size for entry in files)


def run_rows(folder: Path, observe: Observe | None) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Row of a run, and of its measurements; of a folder that cannot be read, a row that says so."""
    seen = stamp(folder)  # before it is read: what changes meanwhile is noticed later
    try:
        record, data = open_run(folder)
    except Unreadable as problem:
        return unreadable_row(folder, seen, problem), []
    rows = derive(folder, observe or record.observe, lambda: data)
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
        "stamp": seen,
        "problem": None,
    }
    return row, rows


def unreadable_row(folder: Path, seen: int, problem: Unreadable) -> dict[str, Any]:
    """Row of a run folder with the stamp `seen` that cannot be read; what its record says of it is kept."""
    row = dict.fromkeys((column.name for column in runs.columns), None)
    try:
        record = RunRecord.read(folder)
    except Unreadable:
        row |= {"study": "", "label": ""}
    else:
        known = ("study", "label", "seed", "engine", "cache_version", "packing_key", "lineage_key")
        row |= {name: getattr(record, name) for name in known}
    return {**row, "run_key": folder.name, "outcome": UNREADABLE, "stamp": seen, "problem": str(problem)}


def packing_row(folder: Path) -> dict[str, Any]:
    """Row of a packing folder."""
    blank = dict.fromkeys(column.name for column in packings.columns)
    row = {**blank, "packing_key": folder.name, "stamp": stamp(folder)}
    try:
        record, _ = read_packing(folder)
    except Unreadable as problem:
        return {**row, "problem": str(problem)}
    return {
        **row,
        "closed_key": record.closed_key,
        "engine": record.engine,
        "seed": record.filling.seed,
        "grains": record.grains,
        "duration": record.duration,
        "wall_time": record.wall_time,
        "rate": record.rate if record.rate == record.rate else None,
        "machine": record.sessions[-1].provenance.get("machine"),
        "bytes": _size(folder),
    }
