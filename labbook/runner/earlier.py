"""Taking up a finished run again, because more is asked of it than it covers."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from labbook.catalogue.finished import RECORDING, check_keys, read_end, read_recording, read_tables
from labbook.catalogue.record import RunRecord, describe_probe
from labbook.plan.demand import film_probe
from labbook.probes import Table
from labbook.runner.journal import Saved


def at_its_end(folder: Path, record: RunRecord) -> tuple[Saved, Mapping[str, Sequence[Table]]]:
    """The run in `folder` as its job would have saved it at its end, and its rows. Raises Unreadable."""
    check_keys(folder, record)
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
    rows: dict[str, Sequence[Table]] = {name: [table] for name, table in read_tables(folder, record).items()}
    frames = read_recording(folder, record)
    if frames is not None:
        rows[Path(RECORDING).stem] = [frames]
    return Saved(read_end(folder, record), state, record.sessions), rows
