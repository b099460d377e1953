"""Forces between walls and grains, contact by contact, and their sums in bins (`labbook.backend.probes.Traction`).

Sums are of whole numbers: forces in units of 2^-24 of the weight of the largest grain, torques in these times d.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from labbook.backend.probes import SLIDING, TRACTION_SUMS, Traction
from labbook.scene import Scene
from labbook.scene.scene import STANDARD_GRAVITY
from labbook.scene.wall_bins import WallBins, bins_of_walls
from labbook_dem.coefficients import MU
from labbook_dem.words import coefs, dot, func, sqrt, wide, wide3

HEIGHT, RADIUS, ABSCISSA = 0, 1, 2
"""Coordinates of bins, as kernels know them: z, the distance from the axis, x."""
SUMS = 14
"""Numbers of a bin, in the order of `TRACTION_SUMS`."""
WALL_COLUMNS = 5
"""Numbers that describe the bins of a wall: coordinate, lower end [m], bins per metre, how many, and the first one."""
_QUANTA = 2.0**24
_PLACES = {"height": HEIGHT, "radius": RADIUS, "x": ABSCISSA}


@func
def bin_of(coordinate: int, low: wide, per_size: wide, count: int, point: wide3):
    """Bin of a wall that a contact point lies in."""
    radius = sqrt(point.x * point.x + point.y * point.y)
    at = point.z if coordinate == HEIGHT else (radius if coordinate == RADIUS else point.x)
    # the upper end belongs to the last bin; what lies outside counts in the nearest one
    position = min(max((at - low) * per_size, wide(0.0)), wide(count) - wide(0.5))
    return int(position)


@func
def moment(a: wide3, b: wide3):
    """Vector product, in double."""
    return wide3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)


@func
def friction_of(c: coefs):
    """Coefficient of friction of a contact, from its coefficients."""
    return wide(c[MU])


@func
def components(coordinate: int, force: wide3, normal: wide3, point: wide3):
    """Components of a force: along the normal; within the wall along its coordinate (up, outwards or x); across."""
    radius = sqrt(point.x * point.x + point.y * point.y)
    round_wall = coordinate == RADIUS and radius > wide(0.0)
    dx = point.x / radius if round_wall else (wide(0.0) if coordinate == HEIGHT else wide(1.0))
    dy = point.y / radius if round_wall else wide(0.0)
    dz = wide(1.0) if coordinate == HEIGHT else wide(0.0)
    direction = wide3(dx, dy, dz)
    tangent = direction - normal * dot(direction, normal)
    length = sqrt(dot(tangent, tangent))
    tangent = tangent * (wide(1.0) / length if length > wide(1e-9) else wide(0.0))
    return dot(force, normal), dot(force, tangent), dot(force, moment(normal, tangent))


@func
def slides(force: wide3, normal: wide3, friction: wide, fraction: wide):
    """1 if the tangential force is above a `fraction` of the Coulomb limit, else 0."""
    pressed = dot(force, normal)
    tangential = force - normal * pressed
    limit = fraction * friction * pressed
    return 1 if limit > wide(0.0) and dot(tangential, tangential) > limit * limit else 0


class BinTable(NamedTuple):
    """The bins of a scene's walls, as kernels take them.

    Attributes:
        bins: Of each wall.
        numbers: Of each wall, shape [W, WALL_COLUMNS].
        total: Number of bins.
        force: Unit in which forces are counted [N].
        torque: Unit in which torques are counted [N m].
    """

    bins: tuple[WallBins, ...]
    numbers: np.ndarray
    total: int
    force: float
    torque: float

    @classmethod
    def of(cls, scene: Scene, probe: Traction) -> "BinTable":
        """Bins of the walls of `scene`."""
        bins = bins_of_walls(scene, scene.container.walls(), probe.size)
        counts = [one.count for one in bins]
        first = np.cumsum([0, *counts])
        rows = [(_PLACES[b.along], b.low, 1 / b.size, b.count, at) for b, at in zip(bins, first, strict=False)]
        force = _heaviest(scene) * (scene.gravity or STANDARD_GRAVITY) / _QUANTA
        numbers = np.array(rows, float).reshape(-1, WALL_COLUMNS)
        return cls(bins, numbers, int(first[-1]), force, force * scene.grains.diameter)

    def rows(self, sums: np.ndarray) -> Mapping[str, np.ndarray]:
        """Columns of a probe's rows from `sums`, whole numbers of shape [total, SUMS]."""
        # The first bin has a row even if nothing touches a wall: a reading without rows could not be told from none.
        touched = np.flatnonzero((sums[:, 0] > 0) | (np.arange(self.total) == 0))
        wall = np.repeat(np.arange(len(self.bins)), [one.count for one in self.bins])
        table = {"wall": wall[touched], "bin": touched - self.numbers[wall[touched], 4].astype(np.int64)}
        for name, column in zip(TRACTION_SUMS, sums[touched].T, strict=True):
            # f*, normal, along and across are forces; t* and the others are torques.
            whole = name in ("contacts", "sliding")
            table[name] = column if whole else column * (self.force if name[0] in "fna" else self.torque)
        return table


class Touch(NamedTuple):
    """A grain at a wall: force on it [N], unit normal from the wall to it, contact point [m], and friction there."""

    force: wide3
    normal: wide3
    point: wide3
    friction: float


def add_touch(table: BinTable, wall: int, touch: Touch, sums: np.ndarray) -> None:
    """Add a contact with a wall to `sums`, in plain Python."""
    along, low, per_size, count, first = table.numbers[wall].tolist()
    row = sums[int(first) + bin_of(int(along), low, per_size, int(count), touch.point)]
    normal, up, across = components(int(along), touch.force, touch.normal, touch.point)
    forces = [round(f / table.force) for f in (*_three(touch.force), normal, up, across)]
    vectors = moment(touch.point, touch.force), touch.point * normal
    torques = [round(t / table.torque) for vector in vectors for t in _three(vector)]
    sliding = slides(touch.force, touch.normal, touch.friction, SLIDING)
    row += (1, sliding, *forces[:3], *torques[:3], *forces[3:], *torques[3:])


def _three(v: wide3) -> tuple[float, float, float]:
    return v.x, v.y, v.z


def _heaviest(scene: Scene) -> float:
    """Mass [kg] of the largest and densest grain that the scene may have."""
    grains = scene.grains
    volume = np.pi / 6 * grains.diameter**3 if grains.varied else grains.volume
    return volume * max(one.density for one in grains.species)
