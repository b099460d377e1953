"""Where grains are before they fall: a seeded random start in the column above a closed container's bottom.

Random sequential addition: uniformly drawn positions are taken one after another wherever they overlap
neither a wall nor a grain already there, so no lattice is left for the packing to remember. Loose starts lie
well below the density at which random addition jams (solid fraction 0.38 in 3D, area fraction 0.547 in 2D:
Torquato & Stillinger, Rev. Mod. Phys. 82 (2010) 2633), and are low enough that the fall is short. Where grains
differ, the seed also draws which is of what size and kind; the largest are placed first.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from labbook.filling import from_file
from labbook.filling.from_file import GrainFile
from labbook.filling.placed import Placed
from labbook.filling.relaxing import Crowd
from labbook.filling.room import DENSEST, JAMMED, Full, PlacingError, Room, first_come
from labbook.plugins import Registry
from labbook.scene import Scene, Spheres, Spherocylinders
from labbook.scene.model import Fault, once
from labbook.scene.orientation import axes, distances, random_turns, turned_to
from labbook.scene.packing import Packing

APART = 1 + 1e-6
"""Part of their sizes at which grains are placed apart: nothing touches at the start."""
_ROUNDS = 2000
_ROOM = 0.1
"""Room for centres below the lid of a dense start, in volumes of the grains, at least."""


class Start(ABC):
    """How the grains of a closed container start before they fall."""

    name: ClassVar[str]
    """As `fill.kind` calls it."""
    version: ClassVar[int]
    """Part of the key of every packing made so; it rises whenever a seed gives other positions than before."""
    flat: ClassVar[bool] = False
    """Whether all grains start in the plane y = 0, and move in it."""
    settled_below: ClassVar[float] = 1e-6
    """Kinetic energy per grain [m g d] below which a bed is at rest, unless `fill.settled_below` is stated."""
    quiet: ClassVar[float | None] = None
    """Time [sqrt(d/g)] for which it has to stay below; None: three beats, however long they are."""
    moving: ClassVar[float] = 0.01
    """Fraction of the grains that may go on moving where grains roll for ever, unless `fill.moving` is stated."""
    drop: ClassVar[float] = 1.0
    """Length of the fall by which the time of a filling is foreseen, in heights of the column."""

    def obstacles(self, scene: Scene) -> Iterator[Fault]:
        """Why grains of a scene, closed or open, cannot start so; nothing where they can."""
        yield from ()

    def quiet_beats(self, closed: Scene, beat: float) -> int:
        """Beats of the length `beat` [s] on end after which the kinetic energy has to be low."""
        if self.quiet is None:
            return 3
        return 1 + math.ceil(self.quiet * math.sqrt(closed.grains.diameter / closed.gravity) / beat)

    @abstractmethod
    def volume(self, closed: Scene) -> float:
        """Volume [m^3] over which the grains are spread, by which the length of their fall is foreseen."""

    @abstractmethod
    def place(self, closed: Scene, seed: int) -> Packing:
        """Grains of `closed` above its bottom; all that is by chance is drawn with the seed. Raises PlacingError where
        they find no room."""


class Column(Start):
    """Grains at random places in a column, with Gaussian velocities; nothing spins.

    density: solid fraction; speed: standard deviation of each velocity component, in units of sqrt(g d).
    """

    version: ClassVar[int] = 1
    density: ClassVar[float]
    speed: ClassVar[float]

    def volume(self, closed: Scene) -> float:
        """That of spheres at the density; rods are as often in each other's way.

        Rods of random orientations exclude 4/3 pi d^3 + 2 pi l d^2 + pi/2 l^2 d from one another, l = L - d
        (Onsager 1949).
        """
        grains = closed.grains
        d, slender = grains.diameter, 2 * grains.half_length / grains.diameter
        cube = grains.mean_cube if isinstance(grains, Spheres) else d**3
        return grains.count * math.pi / 6 * cube / self.density * (1 + 1.5 * slender + 0.375 * slender**2)

    def place(self, closed: Scene, seed: int) -> Packing:
        """The seed decides positions, orientations, velocities, and where grains differ which is of what size and kind.

        Raises PlacingError where the container has no sides, no room or no gravity.
        """
        room, grains = _room(closed, self), closed.grains
        diameter, sort = None, None
        if isinstance(grains, Spheres) and grains.varied:
            diameter, sort = assort(grains, self.version, seed)
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
    """A rain in the middle plane between front and back walls, which grains so never touch.

    Forces between spheres whose centres lie in a plane, and which turn about its normal, are in the plane. None has a
    part across it, not even by round-off: every product that would make one has a factor that is zero.
    """

    name: ClassVar[str] = "planar"
    flat: ClassVar[bool] = True

    def volume(self, closed: Scene) -> float:
        """That of a layer at the density of a rain in a container as thick as a grain."""
        return super().volume(closed) * closed.container.front_to_back / closed.grains.diameter

    def obstacles(self, scene: Scene) -> Iterator[Fault]:
        """It takes spheres between a front and a back wall that leave room for one layer."""
        container, d = scene.container, scene.grains.diameter
        if not isinstance(scene.grains, Spheres):
            yield Fault("fill.kind", "a planar start takes spheres: rods turn out of the plane", "use rain or gas")
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
    """Grains at rest, almost as dense as the bed that they settle to: at random places, pushed apart until none touches
    another one.

    Beds that grains of friction 0.5 settle to are as dense as after a rain within some percent. Less friction makes
    both denser, and a dense start with more of it stays denser.
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
    """Diameters at each wall that are left out of the volume: grains are less dense there."""
    layer: ClassVar[float] = 0.54
    """Solid fraction of a layer of grains in a container as thick as they are."""

    def volume(self, closed: Scene) -> float:
        """Volume [m^3] of the grains at the density, wall effects of the front and back walls included."""
        grains = closed.grains
        thin = grains.diameter / closed.container.front_to_back
        density = max(self.density * (1 - 2 * self.beside * thin), self.layer * thin)
        if isinstance(grains, Spheres) and grains.graded:
            density *= _denser(grains)
        return grains.count * grains.volume / density

    def place(self, closed: Scene, seed: int) -> Packing:
        """The seed decides positions and orientations, and where grains differ which is of what size and kind.

        Raises PlacingError where the container has no sides, no room or no gravity.
        """
        room, grains = _room(closed, self), closed.grains
        diameter, sort = None, None
        if isinstance(grains, Spheres) and grains.varied:
            diameter, sort = assort(grains, self.version, seed)
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
        rest = np.zeros_like(crowd.x)
        q = None if crowd.a is None else turned_to(crowd.a)
        return Packing(x=crowd.x, v=rest, omega=rest, q=q, diameter=diameter, kind=sort)


class FromFile(Start):
    """Grains at the positions of a file beside the study (`fill.file`), with its velocities, or at rest."""

    name: ClassVar[str] = "file"
    version: ClassVar[int] = from_file.VERSION
    drop: ClassVar[float] = 0.15

    def volume(self, closed: Scene) -> float:
        """Volume [m^3] as of a dense start: most files hold beds."""
        return Dense().volume(closed)

    def place(self, closed: Scene, seed: int) -> Packing:
        """Raises PlacingError: the file is not known here, see `place`."""
        raise PlacingError("fill.file: a start from a file needs the file")


class FromStream(Rain):
    """Grains that a stream brings (`fill.stream`), one after another."""

    name: ClassVar[str] = "stream"

    def place(self, closed: Scene, seed: int) -> Packing:
        """Raises PlacingError: the stream is not known here, see `labbook.filling.pouring`."""
        raise PlacingError("fill.stream: a filling by a stream needs the stream")


LAYER = 2.0
"""Diameters from front to back below which grains cannot pass one another, and are one layer."""


_BUILTIN = (Rain(), Gas(), Planar(), Dense(), FromFile(), FromStream())
STARTS: Registry[Start] = Registry[Start]("labbook.starts", Start, _BUILTIN)
"""What `fill.kind` can name."""


def column(scene: Scene, kind: str = Rain.name) -> float:
    """Height [m] of the column in which grains start, as the start called `kind` has it, over the widest section of the
    container. For planning: above a cone or a wedge the column is higher."""
    wide, deep = scene.container.across or 10 * scene.grains.diameter, scene.container.front_to_back
    deep = wide if math.isinf(deep) else deep
    return STARTS[kind].volume(scene) / (wide * deep)


def place(closed: Scene, kind: str, seed: int, file: GrainFile | None = None) -> Packing:
    """Grains of `closed` as the start called `kind` places them, or at the positions of a `file`. Raises
    PlacingError."""
    return STARTS[kind].place(closed, seed) if file is None else from_file.start_from(closed, file)


def no_room(closed: Scene, placed: int, top: float) -> PlacingError:
    """That only `placed` grains found a place, up to z = `top` [m]; with the keys of the study that make room."""
    grains, container = closed.grains, closed.container
    widths = [f"container.{key}" for key in container.widths]
    narrow = [
        f"container.{key} ({size * 1e3:.4g} mm) to {grains.extent * 1e3:.4g} mm, the length of a rod, or more"
        for key in container.widths
        if isinstance(size := getattr(container, key), float) and size < grains.extent
    ]
    remedy = f"widen {narrow[0]}" if narrow else f"use grains.count: {placed} or fewer, or widen {' or '.join(widths)}"
    if placed == 0 and not narrow:
        remedy = f"use a smaller grains.diameter ({grains.diameter * 1e3:.4g} mm), or widen {' or '.join(widths)}"
    found = f"{placed} of {grains.count} grains found a place up to z = {top * 1e3:.4g} mm"
    return PlacingError(f"grains.count: only {found}; {remedy}")


_SAMPLE = 10_000


@once(64)
def _denser(grains: Spheres) -> float:
    """Random close packing of spheres of several sizes over that of equal ones.

    0.634 + 0.0658 delta + 0.0857 S delta^2, with the standard deviation delta of the diameters over their mean and
    their skewness S (Desmond & Weeks, Phys. Rev. E 90 (2014) 022204).
    """
    rng = np.random.default_rng(0)
    sizes = np.array([one.sizes.draw(rng, _SAMPLE, grains.diameter) for one in grains.species])
    weights = np.repeat([[one.share / _SAMPLE] for one in grains.species], _SAMPLE, axis=1)
    mean, deviation = np.sum(weights * sizes), sizes - np.sum(weights * sizes)
    spread = math.sqrt(np.sum(weights * deviation**2))
    skewness = np.sum(weights * deviation**3) / spread**3
    return float(1 + (0.0658 * spread / mean + 0.0857 * skewness * (spread / mean) ** 2) / 0.634)


def _room(closed: Scene, start: Start) -> Room:
    """The room in which grains start. Raises PlacingError where they cannot."""
    if closed.gravity == 0:
        raise PlacingError("a filling needs gravity: grains would never come to rest (gravity is 0)")
    for fault in start.obstacles(closed):
        raise PlacingError(f"{fault.key}: {fault.reason}; {fault.remedy}")
    return Room(closed.container, closed.grains.radius * APART, start.flat)


def _place_equal(
    closed: Scene, rng: np.random.Generator, room: Room, top: float
) -> tuple[np.ndarray, np.ndarray | None]:
    """Centres [m], shape [n, 3], and of rods orientations, shape [n, 4], of grains that are alike. Raises Full."""
    grains = closed.grains
    rods = isinstance(grains, Spherocylinders)
    there, q = Placed(np.empty((0, 3))), np.empty((0, 4))
    for _ in range(_ROUNDS):
        wanted = grains.count - len(there)
        if wanted == 0:
            return there.x, q if rods else None
        drawn = room.draw(rng, 2 * wanted + 16, top)
        turned = random_turns(rng, len(drawn)) if rods else np.empty((len(drawn), 4))
        if rods:
            reach = grains.half_length * axes(turned)
            fits = room.holds(drawn + reach) & room.holds(drawn - reach)
            drawn, turned = drawn[fits], turned[fits]
            free = _rods_apart(drawn, turned, there, q, grains.half_length, grains.diameter * APART)
            q = np.concatenate([q, turned[free]])[: grains.count]
        else:
            free = _apart(drawn, there, grains.diameter * APART)
        there.add(drawn[free][:wanted])
    raise Full(len(there))


def _apart(drawn: np.ndarray, there: Placed, distance: float) -> np.ndarray:
    """Which of `drawn`, taken in their order, keep `distance` from `there` and from each other."""
    from scipy.spatial import KDTree

    kept = there.keep(drawn, distance)
    if len(drawn) > 1:
        first_come(kept, KDTree(drawn).query_pairs(distance, output_type="ndarray"))
    return kept


def _rods_apart(
    drawn: np.ndarray, turned: np.ndarray, there: Placed, q: np.ndarray, half: float, distance: float
) -> np.ndarray:
    """As `_apart`, for rods centred at `drawn` and `there`, turned by `turned` and `q`."""
    from scipy.spatial import KDTree

    kept = np.ones(len(drawn), bool)
    if len(drawn) == 0:
        return kept
    a = axes(turned)
    i, j = there.near(drawn, 2 * half + distance)
    kept[j[distances(there.x[i] - drawn[j], axes(q[i]), a[j], half) < distance]] = False
    pairs = KDTree(drawn).query_pairs(2 * half + distance, output_type="ndarray")
    i, j = pairs.T
    first_come(kept, pairs[distances(drawn[i] - drawn[j], a[i], a[j], half) < distance])
    return kept


_NEARLY = 0.9
"""Grains of this part of the largest diameter that is left, and above, are placed at a time."""


def place_graded(room: Room, rng: np.random.Generator, top: float, reach: np.ndarray) -> np.ndarray:
    """Centres [m], shape [n, 3], up to z = `top` of grains that keep `reach` [m], shape [n], free around them.

    Large grains come first, as they would find no room among small ones: at a time, those of nearly the largest size
    that is left, each of which tries one place a round. Raises Full.
    """
    x, left = np.empty((len(reach), 3)), np.arange(len(reach))
    placed, there = left[:0], Placed(x[:0])
    for _ in range(_ROUNDS):
        if len(left) == 0:
            return x
        trying = left[reach[left] >= _NEARLY * reach[left].max()]
        x[trying] = room.draw_each(rng, reach[trying], top)
        found = free(x, reach, there, placed, trying[room.holds(x[trying], reach[trying])])
        there.add(x[found])
        placed = np.concatenate([placed, found])
        left = np.setdiff1d(left, found, assume_unique=True)
    raise Full(len(placed))


def free(
    x: np.ndarray,
    reach: np.ndarray,
    there: Placed,
    placed: np.ndarray,
    trying: np.ndarray,
    a: np.ndarray | None = None,
    half: float = 0.0,
    apart: np.ndarray | None = None,
) -> np.ndarray:
    """Those of the grains `trying`, in their order, that are in the way of neither grains `placed` nor each other.

    x: centres [m], shape [n, 3]; reach [m], shape [n]: what each keeps free around it; there: the centres of those
    placed. Of rods also their axes `a`, shape [n, 3], and half the length of their segments [m]. Where grains lie in
    beds of their own, `apart` [m], shape [n, 1], is a fourth coordinate, by which beds are out of each other's reach;
    `there` has it too.
    """
    from scipy.spatial import KDTree

    if not len(trying):
        return trying

    def meet(one: np.ndarray, other: np.ndarray) -> np.ndarray:
        branch = x[one] - x[other]
        gap = np.linalg.norm(branch, axis=1) if a is None else distances(branch, a[one], a[other], half)
        return gap < reach[one] + reach[other]

    kept, most = np.ones(len(trying), bool), reach[trying].max() + half
    where = x[trying] if apart is None else np.hstack([x[trying], apart[trying]])
    i, j = there.near(where, most + reach.max() + half)
    kept[j[meet(placed[i], trying[j])]] = False
    pairs = KDTree(where).query_pairs(2 * most, output_type="ndarray")
    first_come(kept, pairs[meet(*trying[pairs].T)])
    return trying[kept]


_STREAM = 1
"""Told from the placing's random numbers by this."""


def assort(grains: Spheres, version: int, seed: int) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Diameters [m] and kinds (places in `grains.kinds`) by id, each of shape [count]; None where all are alike.

    Of each kind there are as many as its share says, to the nearest whole grain; who they are is drawn, and so is each
    diameter. `version`: of the rules that place the grains.
    """
    rng = np.random.default_rng([version, seed, _STREAM])
    numbers = whole_numbers(np.array([one.share for one in grains.species]), grains.count)
    kind = rng.permutation(np.repeat(np.arange(len(numbers)), numbers))
    diameter = np.full(grains.count, grains.diameter)
    for index, one in enumerate(grains.species):
        mine = kind == index
        diameter[mine] = one.sizes.draw(rng, int(mine.sum()), grains.diameter)
    return diameter if grains.graded else None, kind if grains.kinds else None


def whole_numbers(shares: np.ndarray, total: int) -> np.ndarray:
    """Whole numbers that add up to `total`, each within one of its share: the largest remainders are rounded up."""
    exact = shares / shares.sum() * total
    numbers = np.floor(exact).astype(int)
    short = total - int(numbers.sum())
    numbers[np.argsort(-(exact - numbers), kind="stable")[:short]] += 1
    return numbers
