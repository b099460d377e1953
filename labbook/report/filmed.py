"""What was recorded of a run, for those who draw or export it."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from labbook.measure import RunData
from labbook.scene import Bodies

if TYPE_CHECKING:
    from labbook.report.analysis import Finished


def frames_of(finished: "Finished", data: RunData) -> Callable[[], Mapping[str, np.ndarray] | None]:
    """Reads what was recorded of a run; of unlike grains with their `radius` [m] and `kind`, which the start knows."""
    if not data.scene.grains.varied:
        return finished.recording
    bodies, start = Bodies.of(data.scene.grains, data.start), data.start

    def read() -> Mapping[str, np.ndarray] | None:
        table = finished.recording()
        if table is None:
            return None
        which = start.rows(np.asarray(table["id"]))
        return {**table, "radius": bodies.radius[which], "kind": bodies.kind[which]}

    return read
