"""Periodic sides: a container that repeats along y without end, in place of a front and a back wall.

Centres of grains lie in the box |y| <= period/2: what leaves it on one side enters on the other. A grain meets the
nearest image of every other one, since the period exceeds two grain lengths. Arrays are treated here, single pairs in
`labbook_dem.images`.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from labbook.scene.container_shape import ContainerShape
from labbook.scene.grains import Clumps, Grains
from labbook.scene.model import Fault
from labbook.scene.packing import Packing
from labbook.scene.part_motion import PartMotion
from labbook.scene.walls import Wall

Y = 1
"""Column of the coordinate along which a container repeats."""
PeriodicSides = Annotated[Literal["y"] | None, Field(exclude_if=lambda periodic: periodic is None)]
"""`y`: periodic sides in place of the front and the back wall; left out of what is stored where there are none."""


def nearest_images(vectors: np.ndarray, period: float) -> np.ndarray:
    """Bring places into the box, or branches between grains to those between nearest images.

    Args:
        vectors: Places or branches [m], shape [n, 3] or more columns.
        period: Distance of the periodic sides [m]; infinite without them.

    Returns:
        Array of the same shape, with |y| <= period/2; `vectors` itself without periodic sides.
    """
    if math.isinf(period):
        return vectors
    images = vectors.copy()
    images[:, Y] -= np.floor(vectors[:, Y] * (1.0 / period) + 0.5) * period
    return images


def in_box(packing: Packing, period: float) -> Packing:
    """Bring the grains of a packing into the box between periodic sides.

    Args:
        packing: The packing.
        period: Distance of the sides [m]; infinite without them.

    Returns:
        The packing; itself without periodic sides.
    """
    return packing if math.isinf(period) else replace(packing, x=nearest_images(packing.x, period))


def tree(x: np.ndarray, period: float):
    """Build a k-d tree of places that finds neighbours across periodic sides.

    Args:
        x: Places [m], shape [n, 3] or more columns.
        period: Distance of the periodic sides [m]; infinite without them.

    Returns:
        Tree, whose own coordinates are of no use with periodic sides: ask it by indices, or with `tree_places`.
    """
    from scipy.spatial import KDTree

    if math.isinf(period):
        return KDTree(x)
    box = np.zeros(x.shape[1])
    box[Y] = period
    return KDTree(tree_places(x, period), boxsize=box)


def tree_places(x: np.ndarray, period: float) -> np.ndarray:
    """Convert places [m], shape [n, 3] or more columns, to the coordinates of a `tree`: y from 0 to the period."""
    if math.isinf(period):
        return x
    places = nearest_images(x, period)
    places[:, Y] = np.mod(places[:, Y], period)
    places[places[:, Y] >= period, Y] = 0.0  # the remainder of a tiny negative number rounds up
    return places


def with_images(x: np.ndarray, period: float, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Add the images of grains that reach across a periodic side.

    Args:
        x: Centres in the box [m], shape [n, 3].
        period: Distance of the periodic sides [m]; infinite without them.
        reach: Distance [m] from a side within which a grain has an image beyond the other.

    Returns:
        Centres of grains and images [m], shape [n + k, 3], and the index of the grain of each, shape [n + k].
    """
    rows = np.arange(len(x))
    if math.isinf(period):
        return x, rows
    near = np.flatnonzero(np.abs(x[:, Y]) > period / 2 - reach)
    images = x[near].copy()
    images[:, Y] -= np.copysign(period, images[:, Y])
    return np.concatenate([x, images]), np.concatenate([rows, near])


def faults(container: ContainerShape, grains: Grains) -> Iterator[Fault]:
    """Yield reasons why grains cannot be between the periodic sides of a container.

    Args:
        container: The container, with or without periodic sides.
        grains: Grains of the scene.
    """
    period, extent = container.period, grains.extent
    if math.isinf(period):
        return
    if isinstance(grains, Clumps):
        yield Fault("container.periodic", "clumps have no periodic sides", "use spheres or rods, or leave periodic out")
    if period <= 2 * extent:
        reason = f"{1e3 * period:g} mm between periodic sides let a {grains.noun} touch two images of another"
        yield Fault(
            f"container.{container.widths[0]}", reason, f"make it more than {2e3 * extent:g} mm, two grain lengths"
        )
    for part in container.parts:
        if not _repeats(part) and not _clear_of_sides(part, period / 2 - extent):
            reason = f"the part {part.name} meets a periodic side, and does not go on beyond it"
            remedy = f"keep it a grain length ({1e3 * extent:g} mm) away, or use strips or planes, which have no end"
            yield Fault("container.parts", reason, remedy)


def _repeats(part: Wall) -> bool:
    """True for a part that is the same in all planes y = const, without an end along y; a surface that turns is not."""
    still = part.moves is None and not part.motion.spin
    return still and "planar" in part.shape.symmetries and part.shape.bounds.endless[Y]


def _clear_of_sides(part: Wall, half: float) -> bool:
    """True for a part that stays at |y| <= half [m]."""
    bounds = part.shape.bounds
    inside = not part.shape.half_space and bounds.low[Y] >= -half and bounds.high[Y] <= half
    return inside and (part.moves is None or _keeps_y(part.moves))


def _keeps_y(moves: PartMotion) -> bool:
    """True for a motion that changes the y of no point."""
    directions = [
        moves.velocity is None or moves.velocity[Y] == 0,
        moves.vibration is None or moves.vibration.direction[Y] == 0,
        moves.rotation is None or moves.rotation.axis[0] == moves.rotation.axis[2] == 0,
    ]
    return all(directions)
