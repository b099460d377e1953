"""Where grains that left come back: above the bed that the silo was opened with, at random free places.

They start from rest, just above the highest grain of that bed: the level is fixed, and the number of grains is, so that
the bed keeps its height but for those that fall. Places are tried one after another, as a filling tries them; each
try reaches a quarter of a grain higher, so that grains fall as short a way as there is room for.
"""

import numpy as np

from labbook.filling.entering import entering
from labbook.filling.placing import APART, STARTS
from labbook.filling.room import PlacingError, Room
from labbook.scene import Bodies, Packing, Scene

_TRIES = 400
_ROOM = 4.0
"""Lengths of a grain between the highest grain of the bed and the upper end of the side walls, at least."""


class Feeder:
    """Puts grains of one run back. `start`: the bed at the opening; `fill`: the kind of its start (`fill.kind`).

    Raises PlacingError if the bed reaches too far up.
    """

    def __init__(self, scene: Scene, start: Packing, fill: str, seed: int):
        assert scene.feed is not None
        grains = scene.grains
        self._scene, self._start, self._key = scene, start, (scene.feed.version, seed)
        self._bodies = Bodies.of(grains, start)
        self._room = Room(scene.container.close(), grains.radius * APART, STARTS[fill].flat)
        self._length = grains.extent
        self.level = float((start.x[:, 2] + self._bodies.radius).max()) + grains.half_length
        """z [m] above which grains are put."""
        self._roof = scene.container.roof
        if self._roof - self.level < _ROOM * self._length:
            raise PlacingError(
                f"the bed reaches up to {self.level * 1e3:.4g} mm, and the side walls to {self._roof * 1e3:.4g} mm: no "
                f"room for fed grains; raise container.height by {_ROOM:g} grains or more, or use fewer grains"
            )

    def returning(self, there: Packing, beat: int) -> Packing | None:
        """The grains that are not `there`, as they come back after this beat; None if none does.

        Grains that find no place are left out: they wait for the next beat. Beat and seed alone decide what is drawn.
        """
        start = self._start
        assert start.ids is not None
        assert there.ids is not None
        rows = np.flatnonzero(~np.isin(start.ids, there.ids))
        if not len(rows):
            return None
        rng, level, roof, length = np.random.default_rng([*self._key, beat]), self.level, self._roof, self._length

        def draw(k: int, reach: np.ndarray) -> np.ndarray:
            low = level + length / 2
            top = min(level + (1 + k / 4) * length, roof - length / 2)
            return self._room.draw_each(rng, reach, max(top, low), low)

        high = there.part(there.x[:, 2] > level - length)
        places = entering(self._room, self._scene.grains, self._bodies.radius[rows], high, rng, draw, _TRIES)
        return places.packing(start, rows) if len(places.rows) else None
