"""Arches and domes: the chains of grains that hold a stopped outlet, and the forces along them."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Contacts, Crossing, Probe, Sample
from labbook.measure.data import RunData
from labbook.measure.expected import beats_of, rounded
from labbook.measure.measure import Evaluation, Measure, MeasureError, Quantity, Window
from labbook.measure.series import crossings, mean_mass
from labbook.scene import Outlet, Scene
from labbook.scene.timescales import gravity_time
from labbook.stats import Measured

NAME = "arch"
SIZE, FORCE = "arch_grains", "arch_force"
EVERY = 10.0
"""Time between two frames of contacts, in sqrt(d*/g): half of the shortest stop."""
REST = 4.0
"""Time after the last grain from which on the bed may count as at rest, in sqrt(d*/g)."""
_WEAK = 0.3
"""Force, in weights of a grain, below which a contact is hardly a link."""
_BESIDE, _SPAN, _RISE = 1.2, 1.6, 0.9
"""Ends of an arch lie within this many diameters of an edge of the outlet; its grains within this many beside it, and
within this many widths, and a diameter, above it."""


_APART = 1.0
"""Distance between the vertical planes of the chains of a dome, at the rim of the outlet or along a slot, and largest
distance of grains from the plane of their chain, in diameters."""
NEAR = 4.0
"""Diameters beside the outlet and above the arch within which a bed is kept for its picture."""
_PREFIX = "bed_"
"""Of the names of its arrays."""


class Arch(Measure):
    """Measure the arch or dome that holds each stop of spheres over one outlet.

    The arch of a layer over a slot is the strongest short chain of contacts between grains that rest on the bottom at
    either side of the outlet. The chain minimises the sum of 1 + 2 / (F / mg + 0.3) over its contacts, F being the
    force of a contact. The dome over a hole, or over a slot of a deeper hopper, is the union of such chains in vertical
    planes. These go through the axis of the hole, a diameter apart at its rim, or across the slot, a diameter apart.
    Grains of a chain lie within a diameter of its plane.

    Contacts of the whole bed are recorded: use it for small beds.

    Quantities:
        arch_grains: Mean number of grains of an arch or dome.
        arch_force: Mean contact force along it, in weights of a grain.

    Arrays:
        size: Number of grains of each arch, shape [n].
        force: Mean contact force along each arch, in weights of a grain, shape [n].
        bed_*: The bed near the last arch, as `StoppedBed` reads it.

    Raises:
        MeasureError: Grains are not spheres, there is no gravity, or the container does not have one slot or one hole.
    """

    name = NAME
    version = 2
    declared = (
        Quantity(SIZE, "n_a", "", "grains of the arch that holds a stopped outlet"),
        Quantity(FORCE, "F_a", "", "mean force along the arch, in weights of a grain"),
    )

    def check(self, scene: Scene) -> None:
        outlets = scene.container.outlets
        single = len(outlets) == 1 and outlets[0].form is not None
        if not (single and scene.grains.round and scene.gravity > 0):
            reason = f"{NAME} is made of chains of spheres that gravity presses on one slot or one round outlet"
            raise MeasureError(reason, f"take {NAME} out of measure, or use spheres and a container with one outlet")

    def probes(self, scene: Scene, numerics: Numerics) -> tuple[Probe, ...]:
        self.check(scene)
        every = beats_of(rounded(EVERY * gravity_time(scene), scene, 1), numerics)
        outlet = scene.container.outlets[0]
        return Crossing(outlet.plane), Sample(fields=("x",), every=every), Contacts(every=every)

    def evaluate(self, run: RunData, window: Window) -> Evaluation:
        self.check(run.scene)
        if not {"sample", "contacts"} <= set(run.tables):
            raise MeasureError(f"{NAME}: the run recorded no contacts; run it again with this measure")
        beds = list(stopped_beds(run))
        where, how = "at each stop", "strongest short chain of contacts over the outlet"
        if not beds:
            note = "no stop with a chain of contacts over the outlet"
            none = (math.nan, math.nan, 0, where, how, "", note)
            return Evaluation((Measured(SIZE, *none), Measured(FORCE, *none)))
        sizes = np.array([len(bed.rows) for bed in beds], float)
        forces = np.array([bed.link.mean() for bed in beds])
        numbers = [
            Measured(name, float(values.mean()), _error(values), len(values), where, how, "")
            for name, values in ((SIZE, sizes), (FORCE, forces))
        ]
        last = beds[-1].near(run.scene)
        return Evaluation(tuple(numbers), {"size": sizes, "force": forces, **last.arrays()})


def _error(values: np.ndarray) -> float:
    return float(values.std(ddof=1)) / math.sqrt(len(values)) if len(values) > 1 else math.nan


def stops(run: RunData) -> list[tuple[float, float]]:
    """List begin and end [s] of the rest of the bed in each stop of a run.

    A rest begins `REST` after the last grain, and ends with the restart, or with the end of a run that clogged.
    """
    rest = REST * gravity_time(run.scene)
    table = run.tables.get("restart", {"stopped": np.array([]), "time": np.array([])})
    pauses = [
        (float(stopped) + rest, float(time)) for stopped, time in zip(table["stopped"], table["time"], strict=True)
    ]
    times, _ = crossings(run)
    last = float(times[-1]) if len(times) else 0.0
    if run.outcome == "clogged" and not (pauses and last <= pauses[-1][1]):
        pauses.append((last + rest, run.duration))
    return pauses


@dataclass(frozen=True, eq=False)
class StoppedBed:
    """Bed in the last frame of a stop, and the arch or dome that holds it.

    Attributes:
        ids: Identities of the grains, shape [n].
        x: Positions of the grains [m], shape [n, 3].
        pairs: Rows of the two grains of each contact, shape [k, 2].
        force: Contact forces in weights of a grain, shape [k].
        rows: Rows of the grains of the arch, from left to right; of a dome in no order, shape [m].
        link: Forces of its contacts in weights of a grain, shape [c].
        links: Rows of the two grains of each of them, shape [c, 2].
    """

    ids: np.ndarray
    x: np.ndarray
    pairs: np.ndarray
    force: np.ndarray
    rows: np.ndarray
    link: np.ndarray
    links: np.ndarray

    def near(self, scene: Scene) -> "StoppedBed":
        """Select the bed near the outlet: NEAR diameters beside it and above the arch."""
        outlet, reach = scene.container.outlets[0], NEAR * scene.grains.diameter
        side = np.abs(self.x[:, 0] - outlet.centre)
        if outlet.form == "hole":
            side = np.hypot(side, self.x[:, 1])
        inside = (side < outlet.width / 2 + reach) & (self.x[:, 2] < self.x[self.rows, 2].max() + reach)
        inside[self.rows] = True
        index, both = np.cumsum(inside) - 1, inside[self.pairs].all(axis=1)
        arch = index[self.rows], self.link, index[self.links]
        return StoppedBed(self.ids[inside], self.x[inside], index[self.pairs[both]], self.force[both], *arch)

    def arrays(self) -> dict[str, np.ndarray]:
        """Convert the bed to arrays by name, which `of` reads."""
        return {f"{_PREFIX}{name}": array for name, array in vars(self).items()}

    @classmethod
    def of(cls, arrays: Mapping[str, np.ndarray]) -> "StoppedBed | None":
        """Read the bed from the arrays of an evaluation; None for a run without an arch."""
        if f"{_PREFIX}x" not in arrays:
            return None
        values = {name: arrays.get(f"{_PREFIX}{name}") for name in cls.__dataclass_fields__}
        if values["links"] is None:  # evaluations of layers were stored without
            values["links"] = neighbours(arrays[f"{_PREFIX}rows"])
        return cls(**values)  # pyright: ignore[reportArgumentType]


def neighbours(rows: np.ndarray) -> np.ndarray:
    """Pairs of consecutive rows, shape [m - 1, 2]."""
    return np.column_stack([rows[:-1], rows[1:]])


def stopped_beds(run: RunData) -> Iterator[StoppedBed]:
    """Yield the bed at each stop of a run with its arch, in the order of time.

    Stops without a frame, or without a chain of contacts over the outlet, are left out.
    """
    for begin, end in stops(run):
        bed = _stopped_bed(run, begin, end)
        if bed is not None:
            yield bed


def _stopped_bed(run: RunData, begin: float, end: float) -> StoppedBed | None:
    """Take the bed in the last frame between two times [s]; None without a frame or a chain."""
    contacts, sample = run.tables["contacts"], run.tables["sample"]
    # the last frame may be taken at the end itself: 1e-12 for round-off
    within = (sample["time"] >= begin) & (sample["time"] <= end * (1 + 1e-12))
    if not within.any():
        return None
    step = int(np.max(np.asarray(sample["step"])[within]))
    bed = {name: np.asarray(column)[np.asarray(sample["step"]) == step] for name, column in sample.items()}
    touching = {name: np.asarray(column)[np.asarray(contacts["step"]) == step] for name, column in contacts.items()}
    x, ids = np.column_stack([bed[axis] for axis in "xyz"]).astype(float), bed["id"]
    scene, weight = run.scene, mean_mass(run) * run.scene.gravity
    outlet, d = scene.container.outlets[0], scene.grains.diameter
    chains = [arch(ids, x, touching, outlet, d, weight, plane) for plane in planes_of(scene)]
    chains = [(rows, link) for rows, link in chains if len(rows) > 1]
    if not chains:
        return None
    rows, (link, links) = chains[0][0], _union(chains)
    if len(chains) > 1:
        rows = np.unique(links)
    i, j, force = _between_grains(ids, touching, weight)
    return StoppedBed(ids, x, np.column_stack([i, j]), force, rows, link, links)


def _union(chains: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Forces, shape [c], and pairs of rows, shape [c, 2], of the contacts of several chains, each of them once."""
    links, forces = np.concatenate([neighbours(rows) for rows, _ in chains]), np.concatenate([f for _, f in chains])
    _, first = np.unique(np.sort(links, axis=1), axis=0, return_index=True)
    first.sort()
    return forces[first], links[first]


@dataclass(frozen=True)
class ChainPlane:
    """Vertical plane in which a chain over an outlet is looked for.

    Attributes:
        along: Horizontal unit vector in the plane, (x, y).
        centre: A point of the plane in the middle of the outlet (x, y) [m].
        reach: Largest distance of grains from it [m].
    """

    along: tuple[float, float]
    centre: tuple[float, float]
    reach: float = math.inf

    def side(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coordinate along the plane and distance from it [m] of places x, shape [n, 3]."""
        (a, b), dx, dy = self.along, x[:, 0] - self.centre[0], x[:, 1] - self.centre[1]
        return dx * a + dy * b, np.abs(dy * a - dx * b)


def planes_of(scene: Scene) -> list[ChainPlane]:
    """Planes in which chains over the outlet are looked for: of a layer one, that of the layer."""
    outlet, d = scene.container.outlets[0], scene.grains.diameter
    if outlet.form == "hole":
        # each plane meets the rim twice, so that half of it is divided; 1e-9: a whole number stays one in spite of
        # round-off
        count = math.ceil(math.pi / 2 * outlet.width / (_APART * d) - 1e-9)
        angles = math.pi / count * np.arange(count)
        return [ChainPlane((math.cos(a), math.sin(a)), (outlet.centre, 0.0), _APART * d) for a in angles.tolist()]
    depth = scene.container.front_to_back
    if depth < 2 * d:
        return [ChainPlane((1.0, 0.0), (outlet.centre, 0.0))]
    count = math.ceil(depth / (_APART * d) - 1e-9)
    at = depth * ((np.arange(count) + 0.5) / count - 0.5)
    return [ChainPlane((1.0, 0.0), (outlet.centre, y), _APART * d) for y in at.tolist()]


def _between_grains(
    ids: np.ndarray, contacts: Mapping[str, np.ndarray], weight: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows of both grains of each contact between two, and the force there in weights of a grain, shape [k]."""
    order, pairs = np.argsort(ids), np.asarray(contacts["j"]) >= 0
    i, j = (order[np.searchsorted(ids, np.asarray(contacts[side])[pairs], sorter=order)] for side in "ij")
    force = np.sqrt(sum(np.asarray(contacts[axis], float)[pairs] ** 2 for axis in ("fx", "fy", "fz"))) / weight
    return i, j, force


def arch(
    ids: np.ndarray, x: np.ndarray, contacts: Mapping[str, np.ndarray], outlet: Outlet, d: float, weight: float,
    plane: ChainPlane | None = None,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Find the arch over an outlet in a plane.

    Args:
        ids: Identities of the grains, shape [n].
        x: Positions of the grains [m], shape [n, 3].
        contacts: Rows of the probe `Contacts`.
        outlet: The slot or hole.
        d: Diameter of the largest grains [m].
        weight: Weight of a grain [N].
        plane: Where it is looked for; None: across a slot, in all of its depth.

    Returns:
        Rows of the grains from left to right, shape [m], and the forces between neighbours in weights of a grain, shape
        [m - 1]; empty where no chain spans the outlet.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra

    i, j, force = _between_grains(ids, contacts, weight)
    side, off = (plane or ChainPlane((1.0, 0.0), (outlet.centre, 0.0))).side(x)
    height, reach = x[:, 2] - outlet.plane, math.inf if plane is None else plane.reach
    inside = (np.abs(side) < outlet.width / 2 + _SPAN * d) & (height < _RISE * outlet.width + d) & (height > -d / 2)
    inside &= off < reach
    below = np.abs(contacts["by"]) < 0.3 * d if outlet.form == "slot" else np.asarray(contacts["bz"]) < 0
    on_bottom = (np.asarray(contacts["j"]) < 0) & below  # not the front, the back or an upright wall
    beside = inside & (np.abs(np.abs(side) - outlet.width / 2) < _BESIDE * d)
    bases = np.flatnonzero(beside & np.isin(ids, np.asarray(contacts["i"])[on_bottom]))
    left, right = bases[side[bases] < 0], bases[side[bases] >= 0]
    near = inside[i] & inside[j]
    a, b, strength = i[near], j[near], force[near]
    nothing = np.zeros(0, np.int64), np.zeros(0)
    if not (len(left) and len(right) and len(a)):
        return nothing
    # A source beside the grains, linked to all bases on the left at almost no cost: one search finds the best of them.
    n, cost = len(x), 1 + 2 / (strength + _WEAK)
    source, tiny = n, 1e-9
    graph = coo_array(
        (np.concatenate([cost, cost, np.full(len(left), tiny)]),
         (np.concatenate([a, b, np.full(len(left), source)]), np.concatenate([b, a, left]))),
        shape=(n + 1, n + 1),
    ).tocsr()  # fmt: skip
    away, before = dijkstra(graph, indices=source, return_predecessors=True)
    end = right[np.argmin(away[right])]
    if not math.isfinite(away[end]):
        return nothing
    rows = [int(end)]
    while before[rows[-1]] != source:
        rows.append(int(before[rows[-1]]))
    rows = np.array(rows[::-1])
    of_pair = {frozenset(pair): float(value) for *pair, value in zip(a.tolist(), b.tolist(), strength, strict=True)}
    return rows, np.array(
        [of_pair[frozenset(pair)] for pair in zip(rows[:-1].tolist(), rows[1:].tolist(), strict=True)]
    )
