"""The page of a run: its bed, W(t), how it ended, what was measured, and where it comes from."""

import math
import os
from base64 import b64encode
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from labbook.backend import BackendMissing, load
from labbook.commands import command
from labbook.lab import LabError, RunRecord, Unreadable, identity
from labbook.lab.catalogue import Entry, Listing
from labbook.lab.evaluations import NotEvaluated, ReadOnlyRun
from labbook.lab.folder import EVALUATION, stamp
from labbook.lab.runs import picture_content
from labbook.lab.suspect import ledger_summary, suspicion
from labbook.measure import MEASURES
from labbook.measure.arch import Arch, StoppedBed
from labbook.measure.clogging import width_ratio
from labbook.measure.flow import Trace
from labbook.measure.ledger import EnergyLedger
from labbook.report.blocks import Facts
from labbook.report.figures import stopped_bed
from labbook.report.setting import common
from labbook.results import display
from labbook.scene import drawing
from labbook.scene.quantities import percent, span
from labbook.study import Point
from labbook.study.schema import Fill
from labbook_web.page import Page, records
from labbook_web.pages import curves
from labbook_web.pages.clogged import clogged
from labbook_web.pages.study import encoded
from labbook_web.store import LabStore, NotFound

_SIBLINGS = 60


def run_page(store: LabStore, prefix: str, query: Mapping[str, str]) -> Page:
    """Make the page of the run whose key begins with `prefix`. Raises NotFound."""
    key = key_of(store, prefix)
    entry = store.catalogue.entries([key])[0]
    folder = store.lab.run(key)
    measured = store.catalogue.measurements(key)
    note = store.note("run", key)
    context: dict[str, Any] = {"key": key, "entry": entry, "note": note, "problem": entry.problem, "record": None}
    path = f"run/{key[:16]}"
    context["command"] = command("view", key[:16], lab=store.lab.folder)
    try:
        record = RunRecord.read(folder)
    except Unreadable as problem:
        context["problem"] = why = str(problem)
        return Page("run.html.j2", path, key[:10], lambda: {"run_key": key, "problem": why},
                    lambda: measured, context, {"curves": []})  # fmt: skip
    flow_curves, lacking = curve(folder, entry, record)
    ledger = _ledger(folder, entry, record)
    arch_picture, arch_text = arch(folder, entry, record)
    siblings, total = store.catalogue.listed(Listing(packing=record.packing_key, sort="study", limit=_SIBLINGS))
    context |= {
        "record": record,
        "known": _in_study(store, record),
        "clogged": clogged(store, record),
        "facts": _facts(record),
        "setting": Facts(tuple(row for row in common([point_of_run(record)]) if row[0] != "Filling")),
        "provenance": Facts(tuple(_flat(record.provenance))),
        "measured": _rows(measured),
        "changed": stamp(folder) != entry.stamp,
        "stale": _stale(record),
        "suspect": suspicion(record.ledger),
        "files": [(path.name, path.stat().st_size) for path in sorted(folder.iterdir()) if _downloadable(path)],
        "recorded": record.coverage.recording is not None,
        "picture": picture_content(folder) is not None,
        "siblings": [row for row in records(siblings) if row["run_key"] != key],
        "several": total - 1,
        "lacking": lacking,
        "caption": curves.caption(flow_curves),
        "arch": arch_picture,
        "arch_text": arch_text,
        "largest_overlap": ledger.get("largest") if ledger else None,
    }
    return Page(
        "run.html.j2",
        path,
        f"{record.study}, {record.label}, {record.repeat}",
        lambda: {"run": record.model_dump(mode="json"), "measurements": measured.to_dict(orient="records")},
        lambda: measured,
        context,
        {"curves": flow_curves, "ledger": ledger},
    )


def key_of(store: LabStore, prefix: str) -> str:
    """Complete a key from its first digits. Raises NotFound for none or several."""
    keys = store.catalogue.matching(prefix)
    if len(keys) == 1:
        return keys[0]
    several = f"several runs have a key that begins with {prefix}: {', '.join(key[:12] for key in keys)}"
    raise NotFound(several if keys else f"no run in this lab has a key that begins with {prefix}")


def sketch(store: LabStore, key: str) -> str:
    """Draw the scene of a run that has no picture, as SVG. Raises NotFound."""
    try:
        scene = RunRecord.read(store.lab.run(key)).scene
    except Unreadable as problem:
        raise NotFound(str(problem)) from problem
    return drawing.svg(scene.grains, scene.container, sized=False) or _NOTHING


_NOTHING = '<svg xmlns="http://www.w3.org/2000/svg" width="1" height="1"/>'


def file_of(store: LabStore, key: str, name: str) -> Path:
    """Path of a file of a run by its name. Raises NotFound."""
    folder = store.lab.run(key)
    if not folder.is_dir() or name not in os.listdir(folder) or not _downloadable(folder / name):
        raise NotFound(f"the run {key[:10]} has no file {name[:80]}")
    return folder / name


def _downloadable(path: Path) -> bool:
    """True for a file that is offered for download: no link, nor in a folder that is one, as links may lead out."""
    ordinary = path.is_file() and not path.is_symlink() and not path.parent.is_symlink()
    return ordinary and not path.name.startswith((EVALUATION, ".")) and _has_address(path.name)


def _has_address(name: str) -> bool:
    """True if the name of a file is valid text: other bytes have no address."""
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True


def curve(folder: Path, entry: Entry, record: RunRecord) -> tuple[list[dict[str, Any]], list[str]]:
    """List the curve W(t) of a run with its window [SI], and the reasons if there is none; both lists may be empty."""
    if record.scene.container.outlet_plane is None:
        return [], []
    run = ReadOnlyRun(point_of_run(record), record.seed, folder, entry)
    try:
        evaluation = run.evaluated(MEASURES["flow_rate"], record.observe).evaluation
    except NotEvaluated as problem:
        return [], [f"{problem}: {command('reindex', lab=folder.parents[1])} evaluates it"]
    trace = Trace.of(evaluation)
    if trace is None:
        return [], ["No grain left."]
    numbers = {number.quantity: number for number in evaluation.numbers}
    flowing = numbers.get("flow_rate_flowing")
    label = record.repeat
    return [curves.curve(trace, numbers.get("flow_rate"), label, flowing.note if flowing else "")], []


def _ledger(folder: Path, entry: Entry, record: RunRecord) -> dict[str, Any] | None:
    """Energies [J] and overlaps [smallest d] against time [s], each of shape [n], and the largest overlap; None where
    the run did not measure `ledger`, or that was not evaluated."""
    if EnergyLedger.name not in record.observe.measure:
        return None
    run = ReadOnlyRun(point_of_run(record), record.seed, folder, entry)
    try:
        evaluation = run.evaluated(MEASURES[EnergyLedger.name], record.observe).evaluation
    except NotEvaluated:
        return None
    if not evaluation.arrays:
        return None
    names = {"time": "time", "kinetic": "kinetic", "potential": "potential", "work": "contact_work"}
    names |= {"overlap": "max_overlap"}
    largest = next((number.value for number in evaluation.numbers if number.quantity == "max_overlap"), None)
    return {**{name: evaluation.arrays[column] for name, column in names.items()}, "largest": largest}


def arch(folder: Path, entry: Entry, record: RunRecord) -> tuple[str, str]:
    """Picture of the arch that held the last stop, as an address with its data, and a sentence on it.

    Both are empty where `arch` was not measured or not evaluated, or no stop has one.
    """
    if Arch.name not in record.observe.measure:
        return "", ""
    run = ReadOnlyRun(point_of_run(record), record.seed, folder, entry)
    try:
        bed = StoppedBed.of(run.evaluated(MEASURES[Arch.name], record.observe).evaluation.arrays)
    except NotEvaluated:
        return "", ""
    if bed is None:
        return "", ""
    (drawing,) = encoded(lambda: stopped_bed(record.scene, bed), "svg")
    link = f", with forces along them of {bed.link.min():.2g} to {bed.link.max():.2g} grain weights"
    words = f"Held by {len(bed.rows)} grains{link}; D = {width_ratio(record.scene):.3g} d."
    return f"data:image/svg+xml;base64,{b64encode(drawing).decode('ascii')}", words


def _stale(record: RunRecord) -> str:
    """Reason why `labbook run` would repeat the run; empty of a run that is up to date."""
    if outdated := identity.outdated(record.versions, identity.versions(record.scene)):
        return outdated
    try:
        installed = load(record.backend).capabilities.cache_version
    except BackendMissing:
        return ""
    if installed == record.cache_version:
        return ""
    return f"made by version {record.cache_version} of {record.backend}, now at version {installed}"


def _in_study(store: LabStore, record: RunRecord) -> bool:
    """True if the study of the lab has the point for which the run was made."""
    try:
        study, _ = store.study(record.study)
    except (NotFound, LabError, ValueError):
        return False
    return record.point < len(study.points) and study.points[record.point].label == record.label


def _facts(record: RunRecord) -> Facts:
    coverage = record.coverage
    outcome = record.outcome + (f": {record.failure.message}" if record.failure else "")
    discharged = f"{coverage.crossed} of {coverage.grains} grains ({percent(coverage.discharged, '.1f')})"
    rows = [
        ("Outcome", outcome),
        ("Ledger", ledger_summary(record.ledger)),
        ("Simulated", f"{coverage.duration:.4g} s, {coverage.steps} steps of {record.numerics.dt * 1e6:.4g} µs"),
        ("Discharged", discharged + (f", none in the last {coverage.waiting:.2g} s" if coverage.waiting > 0.1 else "")),
        ("Recorded", "no" if coverage.frame_interval is None else f"a frame every {span(coverage.frame_interval)}"),
        ("Backend", f"{record.backend} (version {record.cache_version}), {record.numerics.precision}, {record.device}"),
        ("Speed", f"{record.rate / 1e6:.2f} M grain-steps/s, {record.wall_time:.3g} s"
         if math.isfinite(record.rate) else "–"),
        ("Ended", record.finished[:19].replace("T", " ") + " UTC"),
    ]  # fmt: skip
    return Facts(tuple(rows))


def point_of_run(record: RunRecord) -> Point:
    """Point of the run, without the filling of its study, which a run does not record."""
    return Point(record.point, record.scene, Fill(), record.numerics, record.at, record.label)


def _flat(facts: Mapping[str, Any], prefix: str = "") -> "list[tuple[str, str]]":
    """Rows of name and text; a nested mapping is one row."""
    rows: list[tuple[str, str]] = []
    for name, value in facts.items():
        if isinstance(value, Mapping):
            rows.append((f"{prefix}{name}".replace("_", " "), ", ".join(f"{k} {v}" for k, v in value.items())))
        else:
            text = "not known" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)
            rows.append((f"{prefix}{name}".replace("_", " "), text))
    return rows


def _rows(measured) -> list[dict[str, Any]]:
    """Rows of the table of measured numbers; a dash, and a note with the reason, for missing ones."""
    rows = []
    for row in measured.itertuples(index=False):
        notation = display.quantity(row.quantity, row.unit)
        value, error = (math.nan if number is None else float(number) for number in (row.value, row.error))
        rows.append({
            "name": notation.heading,
            "value": display.with_error(value, error, notation.scale) if math.isfinite(value) else "–",
            "window": row.window,
            "method": row.method,
            "note": row.note,
        })  # fmt: skip
    return rows
