"""Return of grains that left: at rest, at random free places above the bed.

They start just above the highest grain of the bed at the opening. The level and the number of grains are fixed, so that
the bed keeps its height, but for grains in free fall. Places are tried one after another, as in a filling; each try
reaches a quarter of a grain higher, so that grains fall as short a way as there is room for.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labbook.filling.entering import Search, entering
from labbook.filling.placing import APART, STARTS
from labbook.filling.pouring import Inflow, Pouring
from labbook.filling.room import PlacingError, Room
from labbook.scene import BedTop, Bodies, Packing, Scene

_TRIES = 400
_BELOW = 0.501
"""Distance below the level, over twice the reach of a grain, from which on grains of the bed may be in the way:
centres of fed grains are their reach above it or more, and those of grains that touch at most twice the reach apart."""
_ROOM = 4.0
"""Least distance between the highest grain of the bed and the upper end of the side walls, in lengths of a grain."""


class Feeder:
    """Return of the grains of one run.

    Args:
        scene: Scene with `feed`.
        start: Bed at the opening.
        fill: Kind of the bed's start (`fill.kind`).
        seed: Seed of the bed.

    Raises:
        PlacingError: The bed reaches too far up.
    """

    def __init__(self, scene: Scene, start: Packing, fill: str, seed: int):
        assert scene.feed is not None
        assert start.ids is not None
        self.grains, self.start, self._key = scene.grains, start, (scene.feed.version, seed)
        # twice the reach: a clump may reach farther from its centre of mass than half its length
        self._radius, self._length = Bodies.of(scene.grains, start).radius, 2 * scene.grains.reach
        closed, clearance, flat = scene.container.close(), scene.grains.radius * APART, STARTS[fill].flat
        self.room = Room(closed, clearance, flat)
        self.like = (closed, clearance, flat, scene.grains.form)
        """Equal for runs whose grains are placed in the same room by the same rules."""
        self.level = float((start.x[:, 2] + self._radius).max()) + scene.grains.overhang
        """Height z [m] above which grains are placed."""
        self._roof = scene.container.roof
        if self._roof - self.level < _ROOM * self._length:
            raise PlacingError(
                f"the bed reaches up to {self.level * 1e3:.4g} mm, and the side walls to {self._roof * 1e3:.4g} mm: no "
                f"room for fed grains; raise container.height by {_ROOM:g} grains or more, or use fewer grains"
            )
        self.floor = self.level - _BELOW * self._length
        """Height z [m] above which grains of the bed may be in the way."""
        self._rows = np.full(int(start.ids.max()) + 1, -1)
        self._rows[start.ids] = np.arange(len(start))

    def missing(self, there: BedTop) -> np.ndarray:
        """Rows of the start whose grains have left, in their order."""
        absent = np.ones(len(self.start), bool)
        absent[self._rows[there.present]] = False
        return np.flatnonzero(absent)

    def search(self, rows: np.ndarray, there: BedTop, beat: int) -> Search:
        """Search for places of the grains `rows`; draws depend on beat and seed alone."""
        rng, level, roof, length = np.random.default_rng([*self._key, beat]), self.level, self._roof, self._length

        def draw(k: int, reach: np.ndarray) -> np.ndarray:
            low = level + length / 2
            top = min(level + (1 + k / 4) * length, roof - length / 2)
            return self.room.draw_each(rng, reach, max(top, low), low)

        return Search(self._radius[rows], there, self._radius[self._rows[there.ids]], rng, draw)


@dataclass(frozen=True, eq=False)
class Refill:
    """A bed that lacks grains after a beat, and its source of grains. `there`: its grains above the feeder's `floor`.
    `left`: mask of the grains that have left and do not come back, by id; None: none has."""

    feeder: Feeder | Inflow | Pouring
    there: BedTop
    beat: int
    left: np.ndarray | None = None


def refill(beds: Sequence[Refill]) -> list[Packing | None]:
    """Find the grains that enter each bed after a beat.

    Grains without a place are left out; those of a Feeder or Pouring wait for the next beat.

    Returns:
        The grains for each bed; None if none enters.
    """
    back: list[Packing | None] = [None] * len(beds)
    by_room = defaultdict[tuple[object, ...], list[tuple[int, Feeder, np.ndarray]]](list)
    for k, bed in enumerate(beds):
        if isinstance(bed.feeder, Pouring):
            back[k] = bed.feeder.returning(bed.there, bed.beat, bed.left)
        elif isinstance(bed.feeder, Inflow):
            back[k] = bed.feeder.returning(bed.there, bed.beat)
        elif len(rows := bed.feeder.missing(bed.there)):
            by_room[bed.feeder.like].append((k, bed.feeder, rows))
    for group in by_room.values():
        first = group[0][1]
        searches = [feeder.search(rows, beds[k].there, beds[k].beat) for k, feeder, rows in group]
        for (k, feeder, rows), positions in zip(
            group, entering(first.room, first.grains, searches, _TRIES), strict=True
        ):
            back[k] = positions.packing(feeder.start, rows) if len(positions.rows) else None
    return back
