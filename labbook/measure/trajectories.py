"""The paths of the grains of a recorded run, as arrays by frame and grain."""

from dataclasses import dataclass

import numpy as np

from labbook.measure.data import RunData
from labbook.scene.bodies import Bodies, kind_names


@dataclass(frozen=True, eq=False)
class Trajectories:
    """Positions and velocities of n grains in f recorded frames, as precise as they were recorded (single precision).

    A grain that has left the frames is NaN from then on.
    """

    time: np.ndarray
    """Since the opening [s], shape [f]."""
    ids: np.ndarray
    """Identities of the grains in every table, in their order, shape [n]."""
    x: np.ndarray
    """Positions [m], shape [f, n, 3]."""
    v: np.ndarray
    """Velocities [m/s], shape [f, n, 3]."""
    radius: np.ndarray
    """Radii [m], shape [n]."""
    mass: np.ndarray
    """Masses [kg], shape [n]."""
    kind: np.ndarray | None = None
    """Names of the grains' kinds, shape [n]; None without kinds."""
    q: np.ndarray | None = None
    """Of rods and clumps, unit quaternions (w, x, y, z) that turn the z axis to the long axis, shape [f, n, 4]."""

    @classmethod
    def of(cls, run: RunData) -> "Trajectories | None":
        """Read the trajectories of a run; None if it was not recorded."""
        rows = run.recorded()
        if rows is None:
            return None
        start = run.start
        assert start.ids is not None
        order = np.argsort(start.ids)
        ids, grains = start.ids[order], run.scene.grains
        bodies = Bodies.of(grains, start)
        kind = kind_names(grains)[bodies.kind[order]] if grains.kinds else None
        time, frame = np.unique(rows["time"], return_inverse=True)
        grain = np.searchsorted(ids, rows["id"])

        def filled(*names: str) -> np.ndarray:
            array = np.full((len(time), len(ids), len(names)), np.nan, np.result_type(*(rows[name] for name in names)))
            array[frame, grain] = np.column_stack([rows[name] for name in names])
            return array

        q = filled("qw", "qx", "qy", "qz") if "qw" in rows else None
        x, v = filled("x", "y", "z"), filled("vx", "vy", "vz")
        return cls(time, ids, x, v, bodies.radius[order], bodies.mass[order], kind, q)

    def __repr__(self) -> str:
        span = f" from {self.time[0]:.4g} s to {self.time[-1]:.4g} s" if len(self.time) else ""
        return f"<Trajectories of {len(self.ids)} grains in {len(self.time)} frames{span}>"
