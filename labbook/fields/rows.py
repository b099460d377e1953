"""Grains and contacts of many frames below each other: what fields are made of."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

Table = Mapping[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class GrainRows:
    """Rows of grains in `frames` frames.

    `x` [m] and `v` [m/s], shape [n, 3]; `mass` [kg] and `volume` [m^3] of one grain, or of each, shape [n]; `axis`:
    unit vectors along rods, of either sign, shape [n, 3], None for spheres.
    """

    x: np.ndarray
    v: np.ndarray
    mass: float | np.ndarray
    volume: float | np.ndarray
    frames: int
    axis: np.ndarray | None = None

    @property
    def unlike(self) -> bool:
        """Whether each has a mass of its own."""
        return isinstance(self.mass, np.ndarray)


@dataclass(frozen=True, eq=False)
class ContactRows:
    """Rows of contacts in `frames` frames: centre `x` [m] of grain i, `branch` b [m] from there to the centre of j or
    to the point of contact with a wall, `force` [N] on i; shape [n, 3] each.
    """

    x: np.ndarray
    branch: np.ndarray
    force: np.ndarray
    frames: int


def grains_of(
    sample: Table, mass: float | np.ndarray, volume: float | np.ndarray, begin: float, end: float
) -> GrainRows:  # fmt: skip
    """Grains of the rows of a sample with begin <= time <= end [s]. mass, volume: of one grain, or of each row.

    Frames that have rows are counted. Rods have columns qw qx qy qz, the rotation of the z axis into theirs. Raises
    ValueError if there is no frame.
    """
    rows = {name: np.asarray(column) for name, column in sample.items()}
    inside = (rows["time"] >= begin) & (rows["time"] <= end)
    count = len(np.unique(rows["step"][inside]))
    if count < 1:
        raise ValueError(f"no frame was sampled between {begin:g} and {end:g} s")
    x, v = (_columns(rows, names, inside) for names in ("x y z", "vx vy vz"))
    axis = axes(_columns(rows, "qw qx qy qz", inside)) if "qw" in rows else None
    mass, volume = (of[inside] if isinstance(of, np.ndarray) else of for of in (mass, volume))
    return GrainRows(x, v, mass, volume, count, axis)


def contacts_of(contacts: Table, sample: Table, begin: float, end: float) -> ContactRows:
    """Contacts with begin <= time <= end [s], with the centres that `sample` has of their grains.

    Frames of contacts must be among those of the sample. Raises ValueError if a grain or every frame is missing.
    """
    rows = {name: np.asarray(column) for name, column in contacts.items()}
    inside = (rows["time"] >= begin) & (rows["time"] <= end)
    steps = np.unique(rows["step"][inside])
    if not len(steps):
        raise ValueError(f"no contacts were recorded between {begin:g} and {end:g} s")
    known = {name: np.asarray(column) for name, column in sample.items()}
    most = int(max(known["id"].max(), rows["i"].max())) + 1
    key = known["step"].astype(np.int64) * most + known["id"]
    order = np.argsort(key)
    wanted = rows["step"][inside].astype(np.int64) * most + rows["i"][inside]
    at = order[np.minimum(np.searchsorted(key[order], wanted), len(key) - 1)]
    if not np.array_equal(key[at], wanted):
        raise ValueError("contacts were recorded in frames that the sample lacks; record both equally often")
    x = np.column_stack([known[c][at] for c in "xyz"]).astype(float)
    return ContactRows(x, _columns(rows, "bx by bz", inside), _columns(rows, "fx fy fz", inside), len(steps))


def axes(q: np.ndarray) -> np.ndarray:
    """Where unit quaternions (w, x, y, z), shape [n, 4], turn the z axis: shape [n, 3]."""
    w, x, y, z = np.asarray(q, float).T
    return np.column_stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])


def _columns(rows: Table, names: str, inside: np.ndarray) -> np.ndarray:
    return np.column_stack([rows[name][inside] for name in names.split()]).astype(float)
