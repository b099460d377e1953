"""Taking up a finished run again, because more is asked of it than it covers."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from labbook.catalogue.finished import CHECKPOINT
from labbook.catalogue.record import RunRecord, describe_probe
from labbook.catalogue.tables import read_checkpoint, read_table
from labbook.plan.demand import film_probe
from labbook.probes import Table
from labbook.runner.journal import Saved


def at_its_end(folder: Path, record: RunRecord) -> tuple[Saved, Mapping[str, Sequence[Table]]] | None:
    """The run in `folder` as its job would have saved it at its end, and its rows; None if they cannot be read."""
    had = record.coverage
    film = None if had.recording is None else film_probe(had.recording, record.numerics, record.scene.grains)
    state = {
        "step": had.steps,
        "crossed": had.crossed,
        "discharged": had.discharged,
        "last": had.last_crossing,
        "probes": list(had.probes),
        "film": describe_probe(film) if film else None,
    }
    try:
        checkpoint = read_checkpoint(folder / CHECKPOINT)
        files = [path for path in sorted(folder.glob("*.npz")) if path.name != CHECKPOINT]
        rows = {path.stem: [read_table(path)] for path in files}
    except (OSError, ValueError):
        return None
    return Saved(checkpoint, state, record.sessions), rows
