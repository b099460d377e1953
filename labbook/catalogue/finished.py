"""A run that is there: its record, its tables, its recording."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from labbook.catalogue.lab import Lab
from labbook.catalogue.packings import load_packing
from labbook.catalogue.parts import Unreadable
from labbook.catalogue.record import RunRecord
from labbook.catalogue.tables import read_table

if TYPE_CHECKING:
    import numpy as np

    from labbook.measure.data import RunData
    from labbook.study import Point

RECORDING = "recording.npz"
CHECKPOINT = "checkpoint.npz"


@dataclass(frozen=True)
class FinishedRun:
    """A run that covers what a study asks."""

    point: "Point"
    seed: int
    run_key: str
    folder: Path
    outcome: str

    @cached_property
    def record(self) -> RunRecord:
        """All that the run says of itself. Raises Unreadable."""
        return RunRecord.read(self.folder)

    @property
    def provenance(self) -> dict[str, Any]:
        """Commit, versions, processor, device, threads, precision, seed, times and speed."""
        return self.record.provenance

    def data(self) -> "RunData":
        """Start and tables, for measuring. Raises Unreadable."""
        return run_data(self.folder, self.record)

    def recording(self) -> "dict[str, np.ndarray] | None":
        """Recorded frames (columns id, step, time, x, y, z, vx, vy, vz; single precision), or None without
        any."""
        path = self.folder / RECORDING
        return read_table(path) if path.exists() else None


def run_data(folder: Path, record: RunRecord) -> "RunData":
    """The run in `folder`, which lies in a lab beside its packings. Raises Unreadable."""
    from labbook.measure.data import RunData

    tables = {}
    for path in sorted(folder.glob("*.npz")):
        if path.name in (RECORDING, CHECKPOINT):
            continue
        try:
            tables[path.stem] = read_table(path)
        except (OSError, ValueError) as error:
            raise Unreadable(f"{path}: not a table of numbers ({type(error).__name__})") from error
    start = load_packing(Lab(folder.parent.parent).packing(record.packing_key))
    return RunData(
        scene=record.scene,
        numerics=record.numerics,
        seed=record.seed,
        start=start,
        outcome=record.outcome,
        duration=record.coverage.duration,
        tables=tables,
    )
