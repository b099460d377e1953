"""Search for free places for grains that enter a bed: grains that come back, and those of a stream."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from labbook.filling.placed_centres import PlacedCentres
from labbook.filling.placing import APART, clear_of_walls, free
from labbook.filling.room import Room
from labbook.scene import BedTop, Grains, Packing
from labbook.scene.orientation import random_turns

Draw = Callable[[int, np.ndarray], np.ndarray]
"""Function that draws centres [m], shape [n, 3], in round k, for grains with a clearance `reach` [m], shape [n]."""


@dataclass(frozen=True, eq=False)
class Entering:
    """Places found for entering grains.

    Attributes:
        x: Centres [m].
        q: Orientations; None for spheres.
        rows: Indices of the grains that found a place.
    """

    x: np.ndarray
    q: np.ndarray | None
    rows: np.ndarray

    def packing(self, every: Packing, rows: np.ndarray, v: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Packing:
        """Build the packing of those grains `rows` of the packing `every` that found a place, at velocity v [m/s]."""
        assert every.ids is not None
        mine = rows[self.rows]
        q = None if self.q is None else self.q[self.rows]
        diameter, kind = (None if own is None else own[mine] for own in (every.diameter, every.kind))
        zero = np.zeros((len(mine), 3))
        return Packing(
            x=self.x[self.rows], v=zero + v, omega=zero, q=q, ids=every.ids[mine], diameter=diameter, kind=kind
        )


@dataclass(frozen=True, eq=False)
class Search:
    """Search of one bed for places of grains.

    Attributes:
        radius: Radius [m] of each entering grain, shape [n].
        there: Grains in the bed that may be in the way, those above its height.
        radius_there: Their radii [m], shape [m].
        rng: Generator of orientations.
        draw: Draws centres.
    """

    radius: np.ndarray
    there: BedTop
    radius_there: np.ndarray
    rng: np.random.Generator
    draw: Draw


def entering(room: Room, grains: Grains, searches: Sequence[Search], rounds: int) -> list[Entering]:
    """Find places where grains touch neither walls nor each other nor the bed, with one try each a round.

    Beds of scenes that share a room are searched together, which takes a small part of the time. Each draws as if it
    were alone.

    Args:
        room: Inside of the containers.
        grains: Grains of one of the scenes; all have the same shape and size, unless they are spheres.
        searches: Searches of all beds.
        rounds: Number of tries of each grain.
    """
    beds = np.arange(len(searches))
    own = np.repeat(beds, [len(search.radius) for search in searches])
    there = [search.there for search in searches]
    n, ends = len(own), np.searchsorted(own, np.arange(len(searches) + 1))
    radii = [*(search.radius for search in searches), *(search.radius_there for search in searches)]
    reach = np.concatenate(radii) * APART
    x = np.concatenate([np.empty((n, 3)), *(bed.x for bed in there)])
    q = None
    if grains.oriented:
        turns = [bed.q for bed in there if bed.q is not None]
        q = np.concatenate([np.empty((n, 4)), *turns])
    # a fourth coordinate separates the beds: grains of different beds are never neighbours in the tree
    bed_of = np.concatenate([own, np.repeat(beds, [len(bed.x) for bed in there])])
    apart = bed_of[:, None] * (4 * (float(reach.max()) + grains.overhang))
    waiting, placed, above = np.arange(n), np.arange(n, len(x)), PlacedCentres(np.hstack([x, apart])[n:])
    for k in range(rounds):
        if not len(waiting):
            break
        cuts = np.searchsorted(waiting, ends)
        for bed in np.flatnonzero(np.diff(cuts)).tolist():
            mine, search = waiting[cuts[bed] : cuts[bed + 1]], searches[bed]
            x[mine] = search.draw(k, reach[mine])
            if q is not None:
                q[mine] = random_turns(search.rng, len(mine))
        inside = clear_of_walls(room, grains, x[waiting], None if q is None else q[waiting], reach[waiting])
        new = free(x, reach, above, placed, waiting[inside], None if q is None else (grains, q), apart)
        above.add(np.hstack([x[new], apart[new]]))
        placed, waiting = np.concatenate([placed, new]), np.setdiff1d(waiting, new, assume_unique=True)
    rows = np.setdiff1d(np.arange(n), waiting, assume_unique=True)
    cuts = np.searchsorted(rows, ends)
    return [
        Entering(x[first:last], None if q is None else q[first:last], rows[cuts[bed] : cuts[bed + 1]] - first)
        for bed, (first, last) in enumerate(zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True))
    ]
