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
        """True if each grain has a mass of its own."""
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
    columns = {name: np.asarray(column) for name, column in sample.items()}
    stride = int(max(columns["id"].max(), rows["i"].max())) + 1
    key = columns["step"].astype(np.int64) * stride + columns["id"]
    order = np.argsort(key)
    keys_of_contacts = rows["step"][inside].astype(np.int64) * stride + rows["i"][inside]
    at = order[np.minimum(np.searchsorted(key[order], keys_of_contacts), len(key) - 1)]
    if not np.array_equal(key[at], keys_of_contacts):
        raise ValueError("contacts were recorded in frames that the sample lacks; record both equally often")
    x = np.column_stack([columns[c][at] for c in "xyz"]).astype(float)
    return ContactRows(x, _columns(rows, "bx by bz", inside), _columns(rows, "fx fy fz", inside), len(steps))


def axes(q: np.ndarray) -> np.ndarray:
    """Rotate the z axis by unit quaternions (w, x, y, z), shape [n, 4]: unit vectors, shape [n, 3]."""
    w, x, y, z = np.asarray(q, float).T
    return np.column_stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])


def _columns(rows: Table, names: str, inside: np.ndarray) -> np.ndarray:
    return np.column_stack([rows[name][inside] for name in names.split()]).astype(float)
