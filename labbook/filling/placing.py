"""Starts of fillings: a seeded random arrangement of grains above the bottom of a closed container.

Random sequential addition: uniformly drawn positions are accepted one after another if they overlap neither a wall nor
an accepted grain, so that the packing cannot inherit a lattice. Loose starts lie well below the density at which random
addition jams (solid fraction 0.38 in 3D, area fraction 0.547 in 2D: Torquato & Stillinger, Rev. Mod. Phys. 82 (2010)
2633), and low enough for a short fall. If grains differ, the seed also draws the size and kind of each; the largest are
placed first.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from labbook.filling import from_file
from labbook.filling.from_file import GrainFile
from labbook.filling.placed_centres import PlacedCentres
from labbook.filling.relaxing import Crowd
from labbook.filling.room import DENSEST, JAMMED, Full, PlacingError, Room, first_come
from labbook.plugins import Registry
from labbook.scene import Clumps, Grains, Scene, Spheres, Spherocylinders
from labbook.scene.hulls import bounding_spheres, overlapping
from labbook.scene.model import Fault, once
from labbook.scene.orientation import random_turns, turned_to
from labbook.scene.packing import Packing
from labbook.scene.periodic import nearest_images, tree

APART = 1 + 1e-6
"""Factor on the sizes of grains when they are placed: nothing touches at the start."""
_ROUNDS = 2000
_ROOM = 0.1
"""Least room for centres below the lid of a dense start, in volumes of the grains."""


class Start(ABC):
    """Arrangement of the grains of a closed container before they fall. A subclass defines `place` and `volume`.

    Attributes:
        name: Name as `fill.kind` of a study.
        version: Version; raise it whenever a seed gives other positions. It is part of the key of every packing.
        flat: All grains start in the plane y = 0, and move in it.
        settled_below: Kinetic energy per grain [m g d] below which a bed is at rest, unless `fill.settled_below` is
            stated.
        quiet: Time [sqrt(d/g)] for which the energy has to stay below; None: three beats of any length.
        moving: Fraction of the grains that may go on moving if grains roll without end, unless `fill.moving` is stated.
        drop: Length of the fall, in heights of the column, for the forecast of the time of a filling.
    """

    name: ClassVar[str]
    version: ClassVar[int]
    flat: ClassVar[bool] = False
    settled_below: ClassVar[float] = 1e-6
    quiet: ClassVar[float | None] = None
    moving: ClassVar[float] = 0.01
    drop: ClassVar[float] = 1.0

    def obstacles(self, scene: Scene) -> Iterator[Fault]:
        """Reasons why grains of a scene cannot start in this way; none by default.

        Args:
            scene: The scene, closed or open.

        Yields:
            A fault for each reason, with key and remedy.
        """
        yield from ()

    def quiet_beats(self, closed: Scene, beat: float) -> int:
        """Number of consecutive beats with low kinetic energy after which a bed is at rest.

        Args:
            closed: The closed scene.
            beat: Length of a beat [s].

        Returns:
            The number, at least one.
        """
        if self.quiet is None:
            return 3
        return 1 + math.ceil(self.quiet * math.sqrt(closed.grains.diameter / closed.gravity) / beat)

    @abstractmethod
    def volume(self, closed: Scene) -> float:
        """Volume over which the grains are spread, for the forecast of the length of their fall.

        Args:
            closed: The closed scene.

        Returns:
            Volume [m^3].
        """

    @abstractmethod
    def place(self, closed: Scene, seed: int) -> Packing:
        """Place the grains of a closed scene above its bottom.

        Args:
            closed: The closed scene.
            seed: Seed of all random numbers.

        Returns:
            The grains, with positions, velocities and orientations.

        Raises:
            PlacingError: The grains find no room.
        """


class Column(Start):
    """Grains at random places in a column, with Gaussian velocities and no spins.

    Attributes:
        density: Solid fraction of the column.
        speed: Standard deviation of each velocity component, in units of sqrt(g d).
    """

    version: ClassVar[int] = 1
    density: ClassVar[float]
    speed: ClassVar[float]

    def volume(self, closed: Scene) -> float:
        """Volume [m^3] of the column: that of spheres at the density, times the crowding of grains."""
        grains = closed.grains
        cube = grains.mean_cube if isinstance(grains, Spheres) else grains.diameter**3
        return grains.count * math.pi / 6 * cube / self.density * grains.crowding

    def place(self, closed: Scene, seed: int) -> Packing:
        """Place the grains; the seed decides positions, orientations, velocities, sizes and kinds.

        Raises PlacingError if the container has no sides, no room or no gravity.
        """
        room, grains = _room(closed, self), closed.grains
        diameter, sort = None, None
        if isinstance(grains, Spheres) and grains.varied:
            diameter, sort = draw_sizes_and_kinds(grains, self.version, seed)
        solid, placed, highest = grains.count * grains.volume, 0, room.bottom
        equal = diameter is None and isinstance(grains, Spheres)
        for top in room.tops(self.volume(closed), solid, JAMMED if equal else DENSEST):
            rng = np.random.default_rng([self.version, seed])
            try:
                if diameter is None:
                    x, q = _place_equal(closed, rng, room, top)
                else:
                    x, q = place_graded(room, rng, top, diameter / 2 * APART), None
                break
            except Full as full:
                placed, highest = full.placed, top
        else:
            raise no_room(closed, placed, highest)
        speed = self.speed * math.sqrt(closed.gravity * grains.diameter)
        v = rng.normal(0, speed, x.shape)
        if self.flat:
            v[:, 1] = 0
        return Packing(x=x, v=v, omega=np.zeros_like(x), q=q, diameter=diameter, kind=sort)


class Rain(Column):
    """A tall, dilute column of slow grains, which land one after another."""

    name: ClassVar[str] = "rain"
    density: ClassVar[float] = 0.12
    speed: ClassVar[float] = 0.1


class Gas(Column):
    """A denser column of fast grains."""

    name: ClassVar[str] = "gas"
    density: ClassVar[float] = 0.25
    speed: ClassVar[float] = 1.0


class Planar(Rain):
    """A rain in the middle plane between front and back walls, which grains then never touch.

    Forces between spheres with centres in a plane, and spins about its normal, lie in the plane. They have no component
    across it, not even by round-off: every product that would make one has a factor of zero.
    """

    name: ClassVar[str] = "planar"
    flat: ClassVar[bool] = True

    def volume(self, closed: Scene) -> float:
        """Volume [m^3] of a column at which a layer has the density of a rain in a container as thick as a grain."""
        return super().volume(closed) * closed.container.front_to_back / closed.grains.diameter

    def obstacles(self, scene: Scene) -> Iterator[Fault]:
        """Yield a fault unless grains are spheres between a front and a back wall that leave room for one layer."""
        container, d = scene.container, scene.grains.diameter
        if not isinstance(scene.grains, Spheres):
            reason = f"a planar start takes spheres: {scene.grains.noun}s turn out of the plane"
            yield Fault("fill.kind", reason, "use rain or gas")
        depth = container.front_to_back
        if math.isinf(depth):
            reason = f"a planar start needs a front and a back wall, and the container is {container.kind}"
            yield Fault("fill.kind", reason, "use rain or gas, or a wedge-hopper or box")
        elif depth >= LAYER * d:
            reason = f"a planar start makes one layer of grains, and there is room for more ({depth / d:.3g} d)"
            yield Fault(
                f"container.{container.widths[0]}",
                reason,
                f"make it less than {LAYER:g} d, such as 1.01 d, or use rain",
            )


class Dense(Start):
    """Grains at rest, almost as dense as their settled bed: at random places, pushed apart until none overlap.

    Beds of grains with friction 0.5 are as dense as after a rain, within some percent. With less friction both are
    denser. With more friction beds from a dense start stay denser.
    """

    name: ClassVar[str] = "dense"
    version: ClassVar[int] = 1
    settled_below: ClassVar[float] = 1e-3
    quiet: ClassVar[float | None] = 0.5
    moving: ClassVar[float] = 0.0
    drop: ClassVar[float] = 0.15

    density: ClassVar[float] = 0.548
    """Solid fraction far from walls."""
    beside: ClassVar[float] = 0.12
    """Thickness of the layer at each wall that does not count as volume, in diameters: grains are less dense there."""
    layer: ClassVar[float] = 0.54
    """Solid fraction of a layer of grains in a container as thick as they are."""

    def obstacles(self, scene: Scene) -> Iterator[Fault]:
        """Yield a fault for clumps, which this start does not push apart."""
        if isinstance(scene.grains, Clumps):
            yield Fault("fill.kind", "a dense start takes spheres and rods, not clumps", "use rain or gas")

    def volume(self, closed: Scene) -> float:
        """Volume [m^3] of the grains at the density, wall effects of the front and back walls included.

        Periodic sides count as such walls, so that beds between them begin looser than they could.
        """
        grains = closed.grains
        thin = grains.diameter / closed.container.front_to_back
        density = max(self.density * (1 - 2 * self.beside * thin), self.layer * thin)
        if isinstance(grains, Spheres) and grains.graded:
            density *= _denser(grains)
        return grains.count * grains.volume / density

    def place(self, closed: Scene, seed: int) -> Packing:
        """Place the grains; the seed decides positions, orientations, sizes and kinds.

        Raises PlacingError if the container has no sides, no room or no gravity.
        """
        room, grains = _room(closed, self), closed.grains
        assert not isinstance(grains, Clumps)
        diameter, sort = None, None
        if isinstance(grains, Spheres) and grains.varied:
            diameter, sort = draw_sizes_and_kinds(grains, self.version, seed)
        beside = self.beside * grains.diameter
        level = room.level_for(self.volume(closed), beside)
        lowest = room.level_for(_ROOM * grains.count * grains.volume)  # where few grains find a place, as in a tip
        if level is None or lowest is None or math.isinf(level + lowest):
            raise no_room(closed, 0, room.bottom)
        rng = np.random.default_rng([self.version, seed])
        reach = (np.full(grains.count, grains.diameter) if diameter is None else diameter) / 2 * APART
        crowd = Crowd(room, reach, grains.half_length, isinstance(grains, Spherocylinders), beside)
        lid = max(level, lowest + grains.half_length) + grains.radius  # the uppermost grains are no closed layer
        if (placed := crowd.scatter(rng, lid)) < grains.count or not crowd.separate(rng, lid):
            raise no_room(closed, placed, lid)
        zero = np.zeros_like(crowd.x)
        q = None if crowd.a is None else turned_to(crowd.a)
        return Packing(x=crowd.x, v=zero, omega=zero, q=q, diameter=diameter, kind=sort)


class FromFile(Start):
    """Grains at the positions of a file beside the study (`fill.file`), with its velocities, or at rest."""

    name: ClassVar[str] = "file"
    version: ClassVar[int] = from_file.VERSION
    drop: ClassVar[float] = 0.15

    def volume(self, closed: Scene) -> float:
        """Volume [m^3] of a dense start: most files hold beds."""
        return Dense().volume(closed)

    def place(self, closed: Scene, seed: int) -> Packing:
        """Raise PlacingError: the file is not known here; see the function `place`."""
        raise PlacingError("fill.file: a start from a file needs the file")


class FromStream(Rain):
    """Grains from a stream (`fill.stream`), one after another."""

    name: ClassVar[str] = "stream"

    def place(self, closed: Scene, seed: int) -> Packing:
        """Raise PlacingError: the stream is not known here; see `labbook.filling.pouring`."""
        raise PlacingError("fill.stream: a filling by a stream needs the stream")


LAYER = 2.0
"""Distance from front to back, in diameters, below which grains cannot pass one another and form one layer."""


_BUILTIN = (Rain(), Gas(), Planar(), Dense(), FromFile(), FromStream())
STARTS: Registry[Start] = Registry[Start]("labbook.starts", Start, _BUILTIN)
"""Starts by name, as `fill.kind` of a study."""


def column(scene: Scene, kind: str = Rain.name) -> float:
    """Height of the column of a start over the widest section of the container, for planning.

    Above a cone or a wedge the column is higher.

    Args:
        scene: The scene.
        kind: Name of the start.

    Returns:
        Height [m].
    """
    wide, deep = scene.container.across or 10 * scene.grains.diameter, scene.container.front_to_back
    deep = wide if math.isinf(deep) else deep
    return STARTS[kind].volume(scene) / (wide * deep)


def place(closed: Scene, kind: str, seed: int, file: GrainFile | None = None) -> Packing:
    """Place the grains of a closed scene.

    Args:
        closed: The closed scene.
        kind: Name of the start.
        seed: Seed of all random numbers.
        file: Positions to use instead of the start.

    Returns:
        The grains, with positions, velocities and orientations.

    Raises:
        PlacingError: The grains cannot be placed.
    """
    return STARTS[kind].place(closed, seed) if file is None else from_file.start_from(closed, file)


def no_room(closed: Scene, placed: int, top: float) -> PlacingError:
    """Build the error for a container with too little room, with the keys that make room.

    Args:
        closed: The closed scene.
        placed: Number of grains that found a place.
        top: Height up to which places were tried [m].

    Returns:
        The error.
    """
    grains, container = closed.grains, closed.container
    widths = [f"container.{key}" for key in container.widths]
    narrow = [
        f"container.{key} ({size * 1e3:.4g} mm) to {grains.extent * 1e3:.4g} mm, the length of a {grains.noun}, or more"
        for key in container.widths
        if isinstance(size := getattr(container, key), float) and size < grains.extent
    ]
    remedy = f"widen {narrow[0]}" if narrow else f"use grains.count: {placed} or fewer, or widen {' or '.join(widths)}"
    if placed == 0 and not narrow:
        remedy = f"use a smaller grains.diameter ({grains.diameter * 1e3:.4g} mm), or widen {' or '.join(widths)}"
    count = f"{placed} of {grains.count} grains found a place up to z = {top * 1e3:.4g} mm"
    return PlacingError(f"grains.count: only {count}; {remedy}")


_SAMPLE = 10_000


@once(64)
def _denser(grains: Spheres) -> float:
    """Random close packing of spheres of several sizes over that of equal ones.

    0.634 + 0.0658 delta + 0.0857 S delta^2, with the standard deviation delta of the diameters over their mean, and
    their skewness S (Desmond & Weeks, Phys. Rev. E 90 (2014) 022204).
    """
    rng = np.random.default_rng(0)
    sizes = np.array([sort.sizes.draw(rng, _SAMPLE, grains.diameter) for sort in grains.species])
    weights = np.repeat([[sort.share / _SAMPLE] for sort in grains.species], _SAMPLE, axis=1)
    mean, deviation = np.sum(weights * sizes), sizes - np.sum(weights * sizes)
    spread = math.sqrt(np.sum(weights * deviation**2))
    skewness = np.sum(weights * deviation**3) / spread**3
    return float(1 + (0.0658 * spread / mean + 0.0857 * skewness * (spread / mean) ** 2) / 0.634)


def _room(closed: Scene, start: Start) -> Room:
    """Build the room in which grains start. Raises PlacingError if they cannot."""
    if closed.gravity == 0:
        raise PlacingError("a filling needs gravity: grains would never come to rest (gravity is 0)")
    for fault in start.obstacles(closed):
        raise PlacingError(f"{fault.key}: {fault.reason}; {fault.remedy}")
    return Room(closed.container, closed.grains.radius * APART, start.flat)


def _place_equal(
    closed: Scene, rng: np.random.Generator, room: Room, top: float
) -> tuple[np.ndarray, np.ndarray | None]:
    """Place grains of equal size: centres [m], shape [n, 3], and orientations of rods, shape [n, 4]. Raises Full."""
    grains = closed.grains
    there, q = PlacedCentres(np.empty((0, 3)), room.period), np.empty((0, 4))
    for _ in range(_ROUNDS):
        lacking = grains.count - len(there)
        if lacking == 0:
            return there.x, q if grains.oriented else None
        trial = room.draw(rng, 2 * lacking + 16, top)
        if grains.oriented:
            turns = random_turns(rng, len(trial))
            fits = clear_of_walls(room, grains, trial, turns)
            trial, turns = trial[fits], turns[fits]
            apart = _apart_turned(grains, trial, turns, there, q, room.period)
            q = np.concatenate([q, turns[apart]])[: grains.count]
        else:
            apart = _apart(trial, there, grains.diameter * APART, room.period)
        there.add(trial[apart][:lacking])
    raise Full(len(there))


def clear_of_walls(
    room: Room, grains: Grains, x: np.ndarray, q: np.ndarray | None, clearance: np.ndarray | None = None
) -> np.ndarray:
    """Mark the grains that lie inside a room and clear of its walls.

    Args:
        room: The room.
        grains: Grains of the scene.
        x: Centres [m], shape [n, 3].
        q: Orientations, shape [n, 4]; None for spheres.
        clearance: Radius [m] that each keeps free, shape [n]; None: that of the room for all.
    """
    free = np.ones(len(x), bool)
    for centres, part in bounding_spheres(grains, x, q):
        free &= room.holds(centres, part * (room.clearance if clearance is None else clearance))
    return free


def _apart(trial: np.ndarray, there: PlacedCentres, distance: float, period: float) -> np.ndarray:
    """Mark the points `trial`, taken in their order, that keep `distance` [m] from `there` and from each other."""
    accepted = there.keep(trial, distance)
    if len(trial) > 1:
        first_come(accepted, tree(trial, period).query_pairs(distance, output_type="ndarray"))
    return accepted


def _apart_turned(
    grains: Grains, trial: np.ndarray, turns: np.ndarray, there: PlacedCentres, q: np.ndarray, period: float
) -> np.ndarray:  # fmt: skip
    """Mark grains centred at `trial` as `_apart` does points; orientations are `turns`, and `q` of those in `there`."""

    def branch(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        return nearest_images(first - second, period)

    accepted = np.ones(len(trial), bool)
    if len(trial) == 0:
        return accepted
    distance = grains.diameter * APART
    farthest = 2 * grains.overhang + distance
    i, j = there.near(trial, farthest)
    accepted[j[overlapping(grains, branch(there.x[i], trial[j]), q[i], turns[j], distance)]] = False
    pairs = tree(trial, period).query_pairs(farthest, output_type="ndarray")
    i, j = pairs.T
    first_come(accepted, pairs[overlapping(grains, branch(trial[i], trial[j]), turns[i], turns[j], distance)])
    return accepted


_NEARLY = 0.9
"""Part of the largest radius left: grains above it are placed together."""


def place_graded(room: Room, rng: np.random.Generator, top: float, reach: np.ndarray) -> np.ndarray:
    """Place spheres of different sizes, the largest first, since they would find no room among small ones.

    In each round those of nearly the largest size left try one place each.

    Args:
        room: The room.
        rng: Generator.
        top: Height z [m] up to which they are placed.
        reach: Radius [m] that each keeps free, shape [n].

    Returns:
        Centres [m], shape [n, 3].

    Raises:
        Full: Not all find a place.
    """
    x, waiting = np.empty((len(reach), 3)), np.arange(len(reach))
    placed, there = waiting[:0], PlacedCentres(x[:0], room.period)
    for _ in range(_ROUNDS):
        if len(waiting) == 0:
            return x
        trying = waiting[reach[waiting] >= _NEARLY * reach[waiting].max()]
        x[trying] = room.draw_each(rng, reach[trying], top)
        accepted = free(x, reach, there, placed, trying[room.holds(x[trying], reach[trying])])
        there.add(x[accepted])
        placed = np.concatenate([placed, accepted])
        waiting = np.setdiff1d(waiting, accepted, assume_unique=True)
    raise Full(len(placed))


def free(
    x: np.ndarray,
    reach: np.ndarray,
    there: PlacedCentres,
    placed: np.ndarray,
    trying: np.ndarray,
    turned: tuple[Grains, np.ndarray] | None = None,
    apart: np.ndarray | None = None,
) -> np.ndarray:
    """Select those of the grains `trying`, in their order, that overlap neither `placed` grains nor each other.

    Args:
        x: Centres [m], shape [n, 3].
        reach: Radius [m] that each keeps free, shape [n].
        there: Centres of the placed grains.
        placed: Indices of the placed grains.
        trying: Indices of the grains to select from.
        turned: Grains of the scene and their orientations, shape [n, 4], unless they are spheres.
        apart: Fourth coordinate [m], shape [n, 1], that separates beds; `there` has it too.

    Returns:
        Indices of the selected grains.
    """
    if not len(trying):
        return trying
    overhang = 0.0 if turned is None else turned[0].overhang

    def meet(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        branch, clearance = nearest_images(x[first] - x[second], there.period), reach[first] + reach[second]
        if turned is None:
            return np.linalg.norm(branch, axis=1) < clearance
        grains, q = turned
        return overlapping(grains, branch, q[first], q[second], clearance)

    accepted, farthest = np.ones(len(trying), bool), reach[trying].max() + overhang
    where = x[trying] if apart is None else np.hstack([x[trying], apart[trying]])
    i, j = there.near(where, farthest + reach.max() + overhang)
    accepted[j[meet(placed[i], trying[j])]] = False
    pairs = tree(where, there.period).query_pairs(2 * farthest, output_type="ndarray")
    first_come(accepted, pairs[meet(*trying[pairs].T)])
    return trying[accepted]


_STREAM = 1
"""Part of the seed of the generator of sizes and kinds, which separates it from that of positions."""


def draw_sizes_and_kinds(grains: Spheres, version: int, seed: int) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Draw sizes and kinds of grains.

    The number of each kind is its share, to the nearest whole grain; which grains they are, and each diameter, is
    random.

    Args:
        grains: The grains.
        version: Version of the rules that place them.
        seed: Seed of the bed.

    Returns:
        Diameters [m] and kinds (indices into `grains.kinds`) by id, each of shape [count]; None if all are equal.
    """
    rng = np.random.default_rng([version, seed, _STREAM])
    numbers = whole_numbers(np.array([sort.share for sort in grains.species]), grains.count)
    kind = rng.permutation(np.repeat(np.arange(len(numbers)), numbers))
    diameter = np.full(grains.count, grains.diameter)
    for index, sort in enumerate(grains.species):
        own = kind == index
        diameter[own] = sort.sizes.draw(rng, int(own.sum()), grains.diameter)
    return diameter if grains.graded else None, kind if grains.kinds else None


def whole_numbers(shares: np.ndarray, total: int) -> np.ndarray:
    """Round shares to whole numbers: those with the largest remainders are rounded up.

    Args:
        shares: Shares of any sum, shape [k].
        total: Sum of the whole numbers.

    Returns:
        Whole numbers, shape [k].
    """
    exact = shares / shares.sum() * total
    numbers = np.floor(exact).astype(int)
    short = total - int(numbers.sum())
    numbers[np.argsort(-(exact - numbers), kind="stable")[:short]] += 1
    return numbers
