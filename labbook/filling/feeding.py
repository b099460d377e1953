"""Where grains that left come back: above the bed that the silo was opened with, at random free places.

They start from rest, just above the highest grain of that bed: the level is fixed, and the number of grains is, so that
the bed keeps its height but for those that fall. Places are tried one after another, as a filling tries them; each
try reaches a quarter of a grain higher, so that grains fall as short a way as there is room for.
"""

import numpy as np

from labbook.filling.placed import Placed
from labbook.filling.placing import APART, STARTS, free
from labbook.filling.room import PlacingError, Room
from labbook.scene import Bodies, Packing, Scene, Spherocylinders
from labbook.scene.orientation import axes, random_turns

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
        x, q, placed = self._places(there, rows, np.random.default_rng([*self._key, beat]))
        if not len(placed):
            return None
        rows, rest = rows[placed], np.zeros((len(placed), 3))
        q, ids = None if q is None else q[placed], start.ids[rows]
        diameter, kind = (None if own is None else own[rows] for own in (start.diameter, start.kind))
        return Packing(x=x[placed], v=rest, omega=rest, q=q, ids=ids, diameter=diameter, kind=kind)

    def _places(
        self, there: Packing, rows: np.ndarray, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray | None, np.ndarray]:
        """Centres [m] and orientations of the grains in `rows` of the start, and which of them found a place."""
        grains, n = self._scene.grains, len(rows)
        half = grains.half_length
        high = there.x[:, 2] > self.level - self._length
        reach = np.concatenate([self._bodies.radius[rows], Bodies.of(grains, there).radius[high]]) * APART
        x = np.concatenate([np.empty((n, 3)), there.x[high]])
        q, a = None, None
        if isinstance(grains, Spherocylinders):
            assert there.q is not None
            q = np.concatenate([np.empty((n, 4)), there.q[high]])
            a = np.concatenate([np.empty((n, 3)), axes(there.q[high])])
        left, placed, above = np.arange(n), np.arange(n, len(x)), Placed(x[n:])
        for k in range(_TRIES):
            if not len(left):
                break
            top = min(self.level + (1 + k / 4) * self._length, self._roof - self._length / 2)
            low = self.level + self._length / 2
            x[left] = self._room.draw_each(rng, reach[left], max(top, low), low)
            inside = self._room.holds(x[left], reach[left])
            if q is not None and a is not None:
                q[left] = random_turns(rng, len(left))
                a[left] = axes(q[left])
                ends = half * a[left]
                inside = self._room.holds(x[left] + ends, reach[left]) & self._room.holds(x[left] - ends, reach[left])
            new = free(x, reach, above, placed, left[inside], a, half)
            above.add(x[new])
            placed, left = np.concatenate([placed, new]), np.setdiff1d(left, new, assume_unique=True)
        return x, q, np.setdiff1d(np.arange(n), left, assume_unique=True)
