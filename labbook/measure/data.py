"""What a measurement reads: one finished run, free of any backend and of where it is stored."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from labbook.backend.numerics import Numerics
from labbook.scene import Scene
from labbook.scene.bodies import Bodies, kind_names
from labbook.scene.packing import Packing


@dataclass(frozen=True, eq=False)
class RunData:
    """A discharge as it was observed.

    `tables`: rows of the probes by their lower-case names (`crossing`, `sample`, `slab`, `zone`, `contacts`,
    `traction`, `above`, `ledger`, `dissipation`), columns as `labbook.backend.probes` lists them; and `restart` of
    a run with restarts, with the columns `stopped` (when the last grain before a stop left) and `time` (when the
    arch was broken) [s]. `duration`: simulated time covered since the opening [s]. `outcome`: how it ended
    (finished, precise, emptied, clogged, diverged, time-limit). `recorded`: reads the frames of a run that was
    recorded; None without any.
    """

    scene: Scene
    numerics: Numerics
    seed: int
    start: Packing
    outcome: str
    duration: float
    tables: Mapping[str, Mapping[str, np.ndarray]] = field(default_factory=dict)
    recorded: Callable[[], Mapping[str, np.ndarray] | None] = lambda: None

    def rows(self, table: str) -> Mapping[str, np.ndarray]:
        """The columns of a table. Where grains differ, rows of single grains also have the `radius` [m] and `mass` [kg]
        of the grain, and where there are kinds the name of its `kind`."""
        columns, grains = self.tables[table], self.scene.grains
        if "id" not in columns or not grains.varied:
            return columns
        bodies, grain = Bodies.of(grains, self.start), self.start.rows(np.asarray(columns["id"]))
        kinds = {"kind": kind_names(grains)[bodies.kind[grain]]} if grains.kinds else {}
        return {**columns, "radius": bodies.radius[grain], "mass": bodies.mass[grain], **kinds}

    def frames(self) -> Mapping[str, np.ndarray] | None:
        """Recorded frames, of unlike grains with their `radius` [m] and `kind`; None without any."""
        table = self.recorded()
        return table if table is None else self.with_bodies(table)

    def with_bodies(self, table: Mapping[str, np.ndarray]) -> Mapping[str, np.ndarray]:
        """Rows of grains, where grains differ with the `radius` [m] and the number of the `kind` of each."""
        if not self.scene.grains.varied:
            return table
        bodies = Bodies.of(self.scene.grains, self.start)
        rows = self.start.rows(np.asarray(table["id"]))
        return {**table, "radius": bodies.radius[rows], "kind": bodies.kind[rows]}
