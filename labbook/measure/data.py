"""Data of one finished run, as measures read them, independent of backend and storage."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from labbook.backend.numerics import Numerics
from labbook.scene import Scene
from labbook.scene.bodies import Bodies, kind_names
from labbook.scene.packing import Packing


@dataclass(frozen=True, eq=False)
class RunData:
    """Recorded data of a discharge.

    Attributes:
        scene: The scene.
        numerics: Time step, beat and precision of the run.
        seed: Seed of the bed.
        start: Packing at the opening.
        outcome: Outcome of the run: finished, precise, emptied, clogged, diverged or time-limit.
        duration: Simulated time since the opening [s].
        tables: Rows of the probes by their lower-case names (`crossing`, `sample`, `slab`, `zone`, `contacts`,
            `traction`, `above`, `ledger`, `dissipation`), with the columns of `labbook.backend.probes`. A run with
            restarts also has `restart`, with the columns `stopped` (time of the last grain before a stop) and `time`
            (time at which the arch was broken) [s].
        recorded: Function that reads the frames of a recorded run; it returns None for a run without frames.
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
        """Return the columns of a table by name.

        Where grains differ, rows of single grains also have the `radius` [m] and `mass` [kg] of the grain, and where
        there are kinds the name of its `kind`. Crossings of a container with several outlets have the name of the
        `outlet`.

        Raises:
            KeyError: The run has no such table.
        """
        columns, grains = self.tables[table], self.scene.grains
        outlets = self.scene.container.outlets
        if table == "crossing" and len(outlets) > 1:
            through = self.scene.container.outlet_of(
                np.column_stack([np.asarray(columns[axis], float) for axis in "xyz"])
            )
            columns = {**columns, "outlet": np.array([outlet.name for outlet in outlets])[through]}
        if "id" not in columns or not grains.varied:
            return columns
        bodies, grain = Bodies.of(grains, self.start), self.start.rows(np.asarray(columns["id"]))
        kinds = {"kind": kind_names(grains)[bodies.kind[grain]]} if grains.kinds else {}
        return {**columns, "radius": bodies.radius[grain], "mass": bodies.mass[grain], **kinds}

    def frames(self) -> Mapping[str, np.ndarray] | None:
        """Read the recorded frames, with `radius` [m] and `kind` where grains differ; None without any."""
        table = self.recorded()
        return table if table is None else self.with_bodies(table)

    def with_bodies(self, table: Mapping[str, np.ndarray]) -> Mapping[str, np.ndarray]:
        """Add the `radius` [m] and the number of the `kind` of each grain to rows of grains, where grains differ."""
        if not self.scene.grains.varied:
            return table
        bodies = Bodies.of(self.scene.grains, self.start)
        rows = self.start.rows(np.asarray(table["id"]))
        return {**table, "radius": bodies.radius[rows], "kind": bodies.kind[rows]}
