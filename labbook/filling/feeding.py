"""Where grains that left come back: above the bed that the silo was opened with, at random free places.

They start from rest, just above the highest grain of that bed: the level is fixed, and the number of grains is, so that
the bed keeps its height but for those that fall. Places are tried one after another, as a filling tries them; each
try reaches a quarter of a grain higher, so that grains fall as short a way as there is room for.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field

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
        assert start.ids is not None
        grains = scene.grains
        self._start, self._key = start, (scene.feed.version, seed)
        self._bodies, self._length, self.half = Bodies.of(grains, start), grains.extent, grains.half_length
        self.rods = isinstance(grains, Spherocylinders)
        closed, clearance, flat = scene.container.close(), grains.radius * APART, STARTS[fill].flat
        self.room = Room(closed, clearance, flat)
        self.like = (closed, clearance, flat, self.half)
        """The same of runs whose grains find their places in the same room by the same rules."""
        self.level = float((start.x[:, 2] + self._bodies.radius).max()) + grains.half_length
        """z [m] above which grains are put."""
        self._roof = scene.container.roof
        if self._roof - self.level < _ROOM * self._length:
            raise PlacingError(
                f"the bed reaches up to {self.level * 1e3:.4g} mm, and the side walls to {self._roof * 1e3:.4g} mm: no "
                f"room for fed grains; raise container.height by {_ROOM:g} grains or more, or use fewer grains"
            )
        self._rows = np.full(int(start.ids.max()) + 1, -1)
        """Row of the start of each grain, by id."""
        self._rows[start.ids] = np.arange(len(start))

    def missing(self, there: Packing) -> np.ndarray:
        """Rows of the start whose grains are not there, in their order."""
        left = np.ones(len(self._start), bool)
        left[self._rows[there.ids]] = False
        return np.flatnonzero(left)

    def near(self, there: Packing) -> tuple[np.ndarray, np.ndarray]:
        """Rows of grains in the bed that may be in the way of others, and what each keeps free around it [m]."""
        high = np.flatnonzero(there.x[:, 2] > self.level - self._length)
        return high, self._bodies.radius[self._rows[there.ids[high]]] * APART  # pyright: ignore[reportOptionalSubscript]

    def reach(self, rows: np.ndarray) -> np.ndarray:
        """Free radius [m] around each grain of these rows of the start."""
        return self._bodies.radius[rows] * APART

    def generator(self, beat: int) -> np.random.Generator:
        """Random numbers of a beat: the seed and the beat alone decide what is drawn."""
        return np.random.default_rng([*self._key, beat])

    def heights(self, tried: int) -> tuple[float, float]:
        """Lowest and highest z [m] of centres at a try."""
        low = self.level + self._length / 2
        return low, max(min(self.level + (1 + tried / 4) * self._length, self._roof - self._length / 2), low)

    def at_rest(self, rows: np.ndarray, x: np.ndarray, q: np.ndarray | None) -> Packing:
        """Grains of these rows of the start, at rest in other places."""
        start, rest = self._start, np.zeros((len(rows), 3))
        assert start.ids is not None
        diameter, kind = (None if own is None else own[rows] for own in (start.diameter, start.kind))
        return Packing(x=x, v=rest, omega=rest, q=q, ids=start.ids[rows], diameter=diameter, kind=kind)


@dataclass(eq=False)
class Refill:
    """A bed that has lost grains, after a beat of its run."""

    feeder: Feeder
    there: Packing
    beat: int
    rows: np.ndarray = field(init=False)
    """Rows of the feeder's start whose grains are missing."""

    def __post_init__(self) -> None:
        self.rows = self.feeder.missing(self.there)


def refill(beds: Sequence[Refill]) -> list[Packing | None]:
    """Return the grains that come back into each bed; None where none does.

    Grains that find no place are left out: they wait for the next beat. Beds of one room are looked at together, which
    takes a small part of the time; each draws as if it were alone.
    """
    alike = defaultdict[tuple[object, ...], list[int]](list)
    for k, bed in enumerate(beds):
        if len(bed.rows):
            alike[bed.feeder.like].append(k)
    back: list[Packing | None] = [None] * len(beds)
    for group in alike.values():
        for k, grains in zip(group, _placed([beds[k] for k in group]), strict=True):
            back[k] = grains
    return back


def _placed(beds: Sequence[Refill]) -> list[Packing | None]:
    """The missing grains of beds of one room that found places."""
    first = beds[0].feeder
    near = [bed.feeder.near(bed.there) for bed in beds]
    own = np.repeat(np.arange(len(beds)), [len(bed.rows) for bed in beds])
    ends = np.searchsorted(own, np.arange(len(beds) + 1))
    n, half, room = len(own), first.half, first.room
    bed_of = np.concatenate([own, np.repeat(np.arange(len(beds)), [len(high) for high, _ in near])])
    reach = np.concatenate([*(bed.feeder.reach(bed.rows) for bed in beds), *(free_radius for _, free_radius in near)])
    x = np.concatenate([np.empty((n, 3)), *(bed.there.x[high] for bed, (high, _) in zip(beds, near, strict=True))])
    q = a = None
    if first.rods:
        turns = [bed.there.q[high] for bed, (high, _) in zip(beds, near, strict=True) if bed.there.q is not None]
        q = np.concatenate([np.empty((n, 4)), *turns])
        a = np.concatenate([np.empty((n, 3)), axes(q[n:])])
    # a fourth coordinate keeps grains of different beds out of each other's way
    apart = bed_of[:, None] * (4 * (float(reach.max()) + half))
    left, placed, above = np.arange(n), np.arange(n, len(x)), Placed(np.hstack([x, apart])[n:])
    draws = [bed.feeder.generator(bed.beat) for bed in beds]
    for tried in range(_TRIES):
        if not len(left):
            break
        cuts = np.searchsorted(left, ends)
        for k in np.flatnonzero(np.diff(cuts)).tolist():
            mine = left[cuts[k] : cuts[k + 1]]
            low, top = beds[k].feeder.heights(tried)
            x[mine] = room.draw_each(draws[k], reach[mine], top, low)
            if q is not None:
                q[mine] = random_turns(draws[k], len(mine))
        if q is None or a is None:
            inside = room.holds(x[left], reach[left])
        else:
            a[left] = axes(q[left])
            tips = half * a[left]
            inside = room.holds(x[left] + tips, reach[left]) & room.holds(x[left] - tips, reach[left])
        new = free(x, reach, above, placed, left[inside], a, half, apart)
        above.add(np.hstack([x[new], apart[new]]))
        placed, left = np.concatenate([placed, new]), np.setdiff1d(left, new, assume_unique=True)
    put = np.setdiff1d(np.arange(n), left, assume_unique=True)
    cuts = np.searchsorted(put, ends)
    back: list[Packing | None] = []
    for k, bed in enumerate(beds):
        mine = put[cuts[k] : cuts[k + 1]]
        turned = None if q is None else q[mine]
        back.append(bed.feeder.at_rest(bed.rows[mine - ends[k]], x[mine], turned) if len(mine) else None)
    return back
