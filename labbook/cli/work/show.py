"""Everything about one run."""

import json
import math
from pathlib import Path

import typer
from rich import box
from rich.markup import escape
from rich.table import Table

from labbook.cli.options import existing, fail
from labbook.cli.screen import say, screen
from labbook.commands import command
from labbook.lab import LabError, LabFolder
from labbook.lab.notes import Note, read
from labbook.lab.runs import open_run, picture
from labbook.lab.suspect import ledger_summary, suspicion
from labbook.results import display
from labbook.scene.quantities import duration, percent


def show(run: str, lab: Path, as_json: bool) -> None:
    """Print a run and its note as lines or as JSON."""
    catalogue = existing(lab)
    keys = catalogue.matching(run)
    if not keys:
        fail(f"no run in {lab} has a key that begins with {run}; list them: {command('runs', lab=lab)}")
    if len(keys) > 1:
        fail(f"several runs begin with {run}: {', '.join(key[:12] for key in keys)}; give more of the key")
    folder = catalogue.lab.run(keys[0])
    record, _ = open_run(folder)
    measured = catalogue.measurements(record.run_key)
    note, problem = _noted(catalogue.lab, record.run_key)
    if as_json:
        rows = json.loads(measured.to_json(orient="records") or "[]")
        image = picture(folder)
        whole = {
            "folder": str(folder),
            "picture": image and str(image),
            "run": record.model_dump(mode="json"),
            "measurements": rows,
            "note": {"tags": note.tags, "text": note.text, "problem": problem},
        }
        typer.echo(json.dumps(whole, indent=2, allow_nan=False))
        return
    _show(record, folder, picture(folder), measured)
    if note.tags:
        say(f"{'tags':12} {', '.join(note.tags)}")
    if note.text:
        say(f"\n{note.text}")
    if problem:
        say(f"Unreadable: {problem}", err=True)


def _noted(lab: LabFolder, key: str) -> tuple[Note, str | None]:
    """The note of a run, and why it cannot be read."""
    try:
        return read(lab, "run", key), None
    except LabError as problem:
        return Note(), str(problem)


def _ledger(ledger) -> str:
    """Text of a ledger, with the reason if it is suspect."""
    why = suspicion(ledger)
    return ledger_summary(ledger) + (f"; suspect: {why}" if why else "")


def _show(record, folder, picture, measured) -> None:
    coverage, provenance = record.coverage, record.provenance
    lines = {
        "run": record.run_key,
        "study": f"{record.study}, {record.label}, {record.repeat}",
        "outcome": record.outcome + (f": {record.failure.message}" if record.failure else ""),
        "ledger": _ledger(record.ledger),
        "covered": f"{coverage.duration:.4g} s, {coverage.crossed} of {coverage.grains} grains discharged "
        f"({percent(coverage.discharged, '.1f')} of the mass), the last one {coverage.waiting:.3g} s before the end",
        "backend": f"{record.backend} version {record.cache_version} on {record.device}, {record.numerics.precision}, "
        f"dt {record.numerics.dt:.4g} s",
        "restitution": ", ".join(f"{key} {value:.4g}" for key, value in record.physics.items()),
        "speed": f"{record.rate / 1e6:.2f} M grain-steps/s, {duration(record.wall_time)} in "
        f"{len(record.sessions)} session{'s' if len(record.sessions) > 1 else ''}, ended {record.finished}",
        "made by": f"{provenance.get('machine')}; commit {str(provenance.get('commit'))[:10]}"
        f"{' (changed)' if provenance.get('dirty') else ''}",
        "packages": ", ".join(f"{name} {version}" for name, version in provenance.get("packages", {}).items()),
        "packing": record.packing_key,
        "experiment": record.experiment_key,
        "folder": str(folder),
        "picture": str(picture or "none"),
    }
    console = screen(highlight=False, markup=False)
    for name, value in lines.items():
        console.print(f"{name:12} {value}")
    rows = [_row(row) for row in measured.itertuples(index=False)]
    windows = list(dict.fromkeys(row.window for row in measured.itertuples(index=False)))
    headings = ("quantity", "value", "error", "unit", *(("window",) if len(windows) > 1 else ()), "note")
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for heading in headings:
        text = heading in ("window", "note")
        table.add_column(heading, justify="right" if heading in ("value", "error") else "left", no_wrap=not text)
    for row, window in zip(rows, measured["window"], strict=True):
        *numbers, note = row
        number = [str(windows.index(window) + 1)] if len(windows) > 1 else []
        table.add_row(*map(escape, (*numbers, *number, note)))
    if rows:
        console.print(table)
        for number, window in enumerate(windows, 1):
            console.print(f"window {number}: {window}" if len(windows) > 1 else f"window: {window}")


def _row(row) -> tuple[str, ...]:
    """Quantity, value, error and unit as all tables show them, and the note."""
    unit = display.quantity(row.quantity, row.unit)
    value, error = (math.nan if number is None else float(number) for number in (row.value, row.error))
    numbers = (display.number(number, error, unit.scale) for number in (value, error))
    return row.quantity, *numbers, unit.unit, row.note
