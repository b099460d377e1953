"""Stream of grains into a scene, a few after every beat."""

import math
from dataclasses import replace

import numpy as np

from labbook.filling.entering import Search, entering
from labbook.filling.placing import APART, draw_sizes_and_kinds
from labbook.filling.room import PlacingError, Room
from labbook.scene import BedTop, Bodies, Packing, Scene, Spheres
from labbook.scene.bodies import masses
from labbook.scene.periodic import Y
from labbook.scene.stream import Stream

VERSION = 1
"""Part of the key of the results of a stream; it rises whenever a seed puts grains to other places."""
_TRIES = 60
"""Number of places that a grain tries after a beat."""


class Pouring:
    """A stream into one scene. Its grains depend on the seed, the beat and the grains of the bed.

    Attributes:
        every: All grains of the scene, by id; their positions have no meaning.
        order: Ids in the order of entry, shape [n].
    """

    def __init__(
        self, scene: Scene, stream: Stream, seed: int, beat: float, every: Packing | None = None, since: float = 0.0
    ):
        """Prepare a stream.

        Args:
            scene: The closed scene.
            stream: The stream.
            seed: Seed of the bed.
            beat: Duration of a beat [s].
            every: Sizes and kinds of all grains; None: the seed decides.
            since: Time [s] for which it has flowed before the first beat.

        Raises:
            PlacingError: No grain fits into its region, or a kind of its layers is unknown.
        """
        grains = scene.grains
        self._scene, self._stream, self._beat, self._since = scene, stream, beat, since
        self._key = (VERSION, seed, 3 if since else 2)
        self._room = Room(scene.container, grains.radius * APART)
        none = np.zeros((grains.count, 3))
        diameter, kind = None, None
        if isinstance(grains, Spheres) and grains.varied:
            diameter, kind = draw_sizes_and_kinds(grains, VERSION, seed)
        q = np.tile([1.0, 0, 0, 0], (grains.count, 1)) if grains.oriented else None
        self.every = every or Packing(x=none, v=none, omega=none, q=q, diameter=diameter, kind=kind)
        self.order = _order(scene, stream, self.every.kind, np.random.default_rng([VERSION, seed, 1]))
        mass = np.broadcast_to(masses(grains, self.every), grains.count)[self.order]
        self._brought = np.cumsum(mass)
        self._radius = Bodies.of(grains, self.every).radius
        self._mean = float(np.mean(mass))
        clear = self._room.clearance
        beyond = clear, clear + grains.overhang if self._room.periodic else clear  # grains reach across periodic sides
        ranges = zip((self._room.x, self._room.y), beyond, strict=True)
        sides = [(first - away, last + away) for (first, last), away in ranges]
        self._low = np.maximum(stream.low, [*(side[0] for side in sides), -math.inf])
        self._high = np.minimum(stream.high, [*(side[1] for side in sides), math.inf])
        self._near = 2 * grains.reach
        self.floor = float(self._low[2]) - self._near
        """Height z [m] above which grains of the bed may be in the way."""
        for axis, width in zip("xyz", self._high - self._low, strict=True):
            if width < 2 * (clear + grains.overhang):
                reason = f"between the walls, the region of the stream is narrower than a grain along {axis}"
                raise PlacingError(f"{reason}; make it {2e3 * (clear + grains.overhang):.4g} mm or more")

    @property
    def time(self) -> float:
        """Time [s] in which all grains enter, if the region always has room."""
        return float(self._brought[-1]) / self._stream.rate

    def due(self, beat: int) -> int:
        """Number of grains that should have entered after this beat, at least one."""
        brought = self._stream.rate * self._time(beat) * (1 + 1e-12)
        return max(1, int(np.searchsorted(self._brought, brought, "right")))

    def number(self, beat: int) -> int:
        """Number of grains of mean mass that the stream brings after this beat."""
        before, now = (math.floor(self._stream.rate * self._time(at) / self._mean) for at in (beat - 1, beat))
        return now - before

    def _time(self, beat: int) -> float:
        """Time [s] for which the stream has flowed by the end of the next beat; for batches, that of whole batches."""
        time, every = self._since + (beat + 1) * self._beat, self._stream.every
        return time if every is None else (math.floor(time / every * (1 + 1e-12)) + 1) * every

    def first(self) -> Packing:
        """Return the first grains. Raises PlacingError if none finds a place."""
        nobody = self.every.subset(np.zeros(0, np.int64))
        grains = self.entering(BedTop.of(nobody), self.order[: self.due(0)], 0)
        if grains is None:
            raise PlacingError(
                "no grain finds a place in the region of the stream; move fill.stream.low and high between the walls"
            )
        return grains

    def returning(self, there: BedTop, beat: int, left: np.ndarray | None = None) -> Packing | None:
        """Return the grains that enter a bed after this beat; None if none does. Grains without a place wait.

        Args:
            there: The bed.
            beat: Number of the beat.
            left: Mask of the grains that have left, by id; None: none has.
        """
        due = self.order[: self.due(beat)]
        waiting = due[~np.isin(due, there.present)]
        waiting = waiting if left is None else waiting[~left[waiting]]
        return self.entering(there, waiting, beat) if len(waiting) else None

    def with_waiting(self, there: Packing) -> Packing:
        """Return a bed with the grains that have still to enter as `waiting`; itself if all have."""
        assert self.every.ids is not None
        assert there.ids is not None
        rows = np.setdiff1d(self.every.ids, there.ids)
        if not len(rows):
            return there
        rng = np.random.default_rng([*self._key[:2], 5])
        tables = there.arrays(), self.every.subset(rows).arrays()
        own = {name: np.concatenate([table[name] for table in tables]) for name in ("ids", "q", "diameter", "kind")
               if name in tables[0]}  # fmt: skip
        x, v = rng.uniform(self._low, self._high, (len(rows), 3)), np.tile(self._stream.velocity, (len(rows), 1))
        return replace(
            there,
            x=np.concatenate([there.x, x]),
            v=np.concatenate([there.v, v]),
            omega=np.concatenate([there.omega, np.zeros((len(rows), 3))]),
            waiting=np.arange(len(there) + len(rows)) >= len(there),
            **own,
        )

    def entering(self, there: BedTop, rows: np.ndarray, beat: int) -> Packing | None:
        """Place those of the grains `rows` that find a place in a bed; None if none does."""
        stream, rng = self._stream, np.random.default_rng([*self._key, beat])
        half = self._scene.grains.overhang
        low, high = self._low + half, self._high - half

        def draw(_: int, reach: np.ndarray) -> np.ndarray:
            return rng.uniform(low + reach[:, None], high - reach[:, None])

        near = (there.x > self._low - self._near) & (there.x < self._high + self._near)
        if math.isfinite(self._scene.container.period):
            near[:, Y] = True  # a grain beyond the other side may be near
        bed = there.subset(np.all(near, axis=1))
        search = Search(self._radius[rows], bed, self._radius[bed.ids], rng, draw)
        [positions] = entering(self._room, self._scene.grains, [search], _TRIES)
        return positions.packing(self.every, rows, stream.velocity) if len(positions.rows) else None


class Inflow:
    """Return of grains that left, at the rate of a stream (`feed.stream`)."""

    def __init__(self, scene: Scene, start: Packing, seed: int, beat: float):
        """Prepare the inflow into an open scene whose bed at the opening was `start`. Raises PlacingError."""
        assert scene.feed is not None
        assert scene.feed.stream is not None
        assert start.ids is not None
        self._pouring = Pouring(scene.close(), scene.feed.stream, seed, beat, start.renumbered(np.argsort(start.ids)))
        self.floor = self._pouring.floor
        """Height z [m] above which grains of the bed may be in the way."""

    def returning(self, there: BedTop, beat: int) -> Packing | None:
        """Return the grains that enter again after this beat; None if none does. The others stay outside."""
        waiting = self._pouring.order[~np.isin(self._pouring.order, there.present)]
        rows = waiting[: self._pouring.number(beat)]
        return self._pouring.entering(there, rows, beat) if len(rows) else None


def _order(scene: Scene, stream: Stream, kind: np.ndarray | None, rng: np.random.Generator) -> np.ndarray:
    """Draw the ids in the order of entry: at random, or in layers of kinds. Raises PlacingError."""
    count = scene.grains.count
    if not stream.layers:
        return rng.permutation(count)
    names = [kind_of_grains.name for kind_of_grains in scene.grains.kinds]
    strange = [name for name in stream.layers if name not in names]
    lacking = [name for name in names if name not in stream.layers]
    if kind is None or strange or lacking:
        wrong = f"no kind is called {strange[0]}" if strange else f"no layer is of the kind {(lacking or ['?'])[0]}"
        raise PlacingError(f"stream.layers: {wrong}; name each of grains.kinds, as {names}")
    shares = {name: np.array_split(rng.permutation(np.flatnonzero(kind == index)), stream.layers.count(name))
              for index, name in enumerate(names)}  # fmt: skip
    return np.concatenate([shares[name].pop(0) for name in stream.layers])
