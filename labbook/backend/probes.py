"""Probes of a member. Only declared probes are compiled in. Reading a probe never changes the motion."""

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from labbook.scene import Grains
from labbook.scene.model import canonical

Table = Mapping[str, np.ndarray]
"""Columns of equal length by name, always including `member`, `step` and `time` [s]."""


@dataclass(frozen=True)
class Crossing:
    """First downward passage of each grain's centre through z = `plane` [m].

    If a grain is put back, its next passage is recorded too.

    Columns: id, time (interpolated within the step), x, y, z, vx, vy, vz, wx, wy, wz, and for rods qw, qx, qy, qz.
    Positions and orientations are those at the end of the step. Velocities are those half a step before.
    """

    plane: float = 0.0


@dataclass(frozen=True)
class Sample:
    """State of all grains every `every` beats.

    `fields` are any of x, v, omega and, for rods, q: the unit quaternion of the rotation from the z axis to the axis of
    the rod. Columns: id, x, y, z, vx, ..., wx, ..., qw, qx, qy, qz.
    """

    fields: tuple[str, ...] = ("x", "v")
    every: int = 1


UNEVEN = 0.1
"""Largest relative deviation of the time between two frames from the requested one."""


@dataclass(frozen=True)
class Film:
    """State of all grains every `every` seconds from step 0 on, each frame at the step nearest to its time.

    Frames may lie within beats. Those of the first beat begin with step 0. `fields` and columns are those of `Sample`.
    """

    every: float
    fields: tuple[str, ...] = ("x", "v")

    def steps(self, dt: float, first: int, last: int) -> Iterator[int]:
        """Yield the steps of dt [s] with a frame, from `first` to `last`."""
        number = max(0, int(first * dt / self.every) - 1)
        while (step := round(number * self.every / dt)) <= last:
            if step >= first:
                yield step
            number += 1

    def uneven(self, dt: float) -> float:
        """Largest relative deviation of the time between two frames from `every`, since frames lie on steps."""
        steps = self.every / dt
        if steps > 0.5 and abs(steps - round(steps)) <= 1e-9 * steps:
            return 0.0
        return max(math.ceil(steps) - steps, steps - math.floor(steps)) / steps

    def as_often(self, requested: "Film") -> bool:
        """True if frames are at least as frequent as those of `requested`, within UNEVEN."""
        return self.every <= requested.every * (1 + UNEVEN)


@dataclass(frozen=True)
class Slab:
    """State of the grains with centres at `low` <= z <= `high` [m], every `every` beats.

    The flow at an outlet needs many frames but few grains. Columns: id, x, y, z, vx, vy, vz.
    """

    low: float
    high: float
    every: int = 1

    def holds(self, z: np.ndarray) -> np.ndarray:
        """Mask of the heights z [m] inside the slab."""
        return (z >= self.low) & (z <= self.high)


@dataclass(frozen=True)
class Zone:
    """State of the grains around and above an outlet on the z axis, every `every` beats.

    Unless `again` is 0, a second frame follows `again` beats after each: two frames give accelerations. The zone
    around the outlet has `low` <= z <= `high` and the `radius` [m] about the axis. The zone above it has
    `high` < z <= `top` and the radius `core`. Columns: id, x, y, z, vx, vy, vz and, for rods, qw, qx, qy, qz.
    """

    radius: float
    low: float
    high: float
    core: float
    top: float
    every: int = 1
    again: int = 0

    def holds(self, x: np.ndarray) -> np.ndarray:
        """Mask of the centres x [m], shape [n, 3], inside the zone."""
        off, z = np.hypot(x[:, 0], x[:, 1]), x[:, 2]
        around = (off <= self.radius) & (z >= self.low) & (z <= self.high)
        return around | ((off <= self.core) & (z > self.high) & (z <= self.top))


@dataclass(frozen=True)
class Contacts:
    """All contacts with overlap, every `every` beats. A rod may touch a wall at several points: each has its own row.

    Columns: i, j (ids; j = -1 at a wall), wall (index into the scene's walls, -1 for a pair), fx, fy, fz [N] on i,
    bx, by, bz [m]. The branch vector b points from the centre of i to that of j, or to the contact point at the wall.
    """

    every: int = 1


@dataclass(frozen=True)
class Traction:
    """Sums over the contacts with each wall, in bins of the width `size` [m], every `every` beats.

    Bins are those of `labbook.scene.wall_bins`: by height, of level walls by radius or x. Forces are those of the wall
    on the grains. Columns: wall (index into the scene's walls), bin, contacts, sliding (contacts whose friction is
    above SLIDING of its limit), fx, fy, fz [N], tx, ty, tz [N m] (torque about the origin), normal, along, across [N]
    (components of the force along the normal from the wall to the grain; along the wall, upwards, outwards or along x;
    and perpendicular to both), mx, my, mz [N m] (normal force times contact point). Bins without contacts have no row,
    but for the first one of the first wall: every frame has a row.

    Sums are exact: forces are rounded to 2^-24 of the weight of the largest grain, so that no bit depends on an order.
    """

    size: float
    every: int = 1


SLIDING = 0.95
"""Part of the Coulomb limit above which a contact counts as sliding."""


@dataclass(frozen=True)
class Above:
    """Grains whose centres lie above each of the `planes` z [m], every `every` beats.

    Columns: plane (its index among `planes`), grains, mass [kg].
    """

    planes: tuple[float, ...]
    every: int = 1


@dataclass(frozen=True)
class Ledger:
    """Totals every `every` beats.

    Columns: grains, kinetic, potential [J], contact_work [J] (work done by contacts since the start), mass [kg],
    max_overlap [m], touching (contacts), rebuilds, px, py, pz [kg m/s], lx, ly, lz [kg m^2/s] about the origin.
    """

    every: int = 1


@dataclass(frozen=True)
class Dissipation:
    """Power of the forces in the contacts of spheres, every `every` beats.

    Columns: normal_power, tangential_power [W] (work per time of normal and tangential forces against the relative
        motion of both surfaces: dissipated, or stored in springs), wall_power [W] (of moving walls on the grains),
        elastic [J] (half the sum of normal force times overlap). Forces, positions and velocities are those at the end
        of the step. Torques of
    rolling friction do not count.
    """

    every: int = 1


Probe = Crossing | Sample | Film | Slab | Zone | Contacts | Traction | Above | Ledger | Dissipation


def due(probe: Probe, beat: int) -> bool:
    """Decide if a probe is read at the end of a beat, or has rows from within it."""
    if isinstance(probe, Crossing | Film):
        return True
    return beat % probe.every == 0 or (isinstance(probe, Zone) and beat % probe.every == probe.again)


_VECTORS = {"x": "x y z", "v": "vx vy vz", "omega": "wx wy wz", "q": "qw qx qy qz"}
_WHOLE = frozenset(
    ["member", "step", "id", "i", "j", "wall", "bin", "contacts", "sliding", "grains", "touching", "rebuilds", "plane"]
)
_TRACTION_SUMS = "contacts sliding fx fy fz tx ty tz normal along across mx my mz"
TRACTION_SUMS = tuple(_TRACTION_SUMS.split())
"""Columns of `Traction` that are sums."""


def columns(probe: Probe, rods: bool = False) -> dict[str, type]:
    """Names and types (int64 or float64) of the columns of a probe's table.

    rods: True if the grains have an orientation.
    """
    match probe:
        case Crossing():
            names = "id x y z vx vy vz wx wy wz" + (" qw qx qy qz" if rods else "")
        case Sample(fields=fields) | Film(fields=fields):
            names = " ".join(["id", *(_VECTORS[name] for name in fields)])
        case Slab():
            names = f"id {_VECTORS['x']} {_VECTORS['v']}"
        case Zone():
            names = f"id {_VECTORS['x']} {_VECTORS['v']}" + (f" {_VECTORS['q']}" if rods else "")
        case Contacts():
            names = "i j wall fx fy fz bx by bz"
        case Traction():
            names = f"wall bin {_TRACTION_SUMS}"
        case Above():
            names = "plane grains mass"
        case Ledger():
            names = "grains kinetic potential contact_work mass max_overlap touching rebuilds px py pz lx ly lz"
        case Dissipation():
            names = "normal_power tangential_power wall_power elastic"
    return {name: np.int64 if name in _WHOLE else np.float64 for name in ["member", "step", "time", *names.split()]}


UNITS = {
    **dict.fromkeys(("time", "stopped"), "s"),
    **dict.fromkeys(("x", "y", "z", "bx", "by", "bz", "max_overlap"), "m"),
    **dict.fromkeys(("vx", "vy", "vz"), "m/s"),
    **dict.fromkeys(("wx", "wy", "wz"), "rad/s"),
    **dict.fromkeys(("fx", "fy", "fz", "normal", "along", "across"), "N"),
    **dict.fromkeys(("tx", "ty", "tz", "mx", "my", "mz"), "N m"),
    **dict.fromkeys(("kinetic", "potential", "contact_work", "elastic"), "J"),
    **dict.fromkeys(("normal_power", "tangential_power", "wall_power"), "W"),
    "mass": "kg",
    "radius": "m",
    **dict.fromkeys(("px", "py", "pz"), "kg m/s"),
    **dict.fromkeys(("lx", "ly", "lz"), "kg m^2/s"),
}
"""SI units of the columns of tables. The other columns are dimensionless."""


def empty_table(probe: Probe, rods: bool = False) -> Table:
    """Return the empty table of a probe; `rods` as in `columns`."""
    return {name: np.zeros(0, kind) for name, kind in columns(probe, rods).items()}


_KINDS: dict[str, type[Probe]] = {
    "crossing": Crossing,
    "sample": Sample,
    "film": Film,
    "slab": Slab,
    "zone": Zone,
    "contacts": Contacts,
    "traction": Traction,
    "above": Above,
    "ledger": Ledger,
    "dissipation": Dissipation,
}


def table_name(probe: Probe) -> str:
    """Name of a probe's table: `crossing`, `sample`, `film`, `slab`, `zone`, `contacts`, `traction`, `above`, `ledger`
    or `dissipation`."""
    return type(probe).__name__.lower()


def describe_probe(probe: Probe) -> str:
    """Describe a probe as canonical JSON, the text that coverage compares."""
    return canonical({"kind": table_name(probe), **vars(probe)})


@lru_cache(maxsize=4096)
def parse_probe(text: str) -> Probe:
    """Return the probe of a text from `describe_probe`. Raises ValueError for any other text."""
    try:
        fields: dict[str, Any] = json.loads(text)
        kind = _KINDS[fields.pop("kind")]
        _adapter(kind).validate_python(fields)  # its types; a number keeps the form that it was written in
        values: dict[str, Any] = {key: tuple(v) if isinstance(v, list) else v for key, v in fields.items()}
        probe = kind(**values)
        if describe_probe(probe) == text and getattr(probe, "every", 1) > 0:
            return probe
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        pass
    raise ValueError(f"not the description of a probe: {text[:80]}")


@cache
def _adapter(kind: type[Probe]) -> TypeAdapter[Probe]:
    return TypeAdapter(kind)


def film_probe(every: float, grains: Grains) -> Film:
    """Return the probe that records a frame every `every` seconds; frames of rods and clumps include orientations."""
    return Film(every, ("x", "v") if not grains.oriented else ("x", "v", "q"))
