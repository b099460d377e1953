"""A member to and from a slot: packings, which are portable, and checkpoints, which are exact."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from labbook_dem.features import is_oriented
from labbook_dem.mesh import spring_places
from labbook_dem.mesh_grid import first_features, shapes_of
from labbook_dem.reading import Inside
from labbook_dem.rotation import momenta, spins

from labbook.backend import Checkpoint
from labbook.scene import Bodies, Packing, Scene, TriangleMesh
from labbook.scene.orientation import axes
from labbook_warp.arrays import Arrays, SlotState
from labbook_warp.kernels.words import PARKED

_BLOCK = 5
"""Cells along the edges of a block: some hundred grains, as many as a block has threads."""


def start(arrays: Arrays, slot: int, scene: Scene, packing: Packing, plane: float, cell: float) -> None:
    """Put a packing's grains into a slot, in an order in which neighbours lie near each other in memory."""
    order = _in_blocks(arrays, packing.x, cell)
    arrays.clear(slot)
    for name, values in _entering(arrays, scene, packing, packing.v, plane).items():
        arrays.write(name, slot, values[order])


def append(
    arrays: Arrays, slot: int, rows: int, scene: Scene, packing: Packing, v: np.ndarray, plane: float
) -> None:  # fmt: skip
    """Put a packing's grains into rows of a slot behind the first `rows`, which no grain has had since the slot was
    written as a whole; they are in no list yet. v: as in `_entering`."""
    for name, values in _entering(arrays, scene, packing, v, plane).items():
        arrays.write_rows(name, slot, rows, values)


def _entering(
    arrays: Arrays, scene: Scene, packing: Packing, v: np.ndarray, plane: float
) -> dict[str, np.ndarray]:  # fmt: skip
    """State arrays of a packing's grains that are not zero, with the velocities v [m/s], by row."""
    x, omega, q = packing.x, packing.omega, packing.q
    assert packing.ids is not None
    found = {"ids": packing.ids.astype(np.int32), "gone": (x[:, 2] < plane).astype(np.int32)}
    if is_oriented(scene):
        if q is None:
            raise ValueError("rods cannot start from a packing without orientations q: it is one of spheres")
        found["p"] = arrays.codec.encode(x, v, omega, axes(q))
        found["turned"] = q
        found["momentum"] = np.pad(momenta(scene.grains, omega, q), ((0, 0), (0, 1)))
    else:
        found["p"] = arrays.codec.encode(x, v, omega)
    if scene.grains.varied:
        own = Bodies.of(scene.grains, packing)
        found["body"] = np.column_stack([own.radius, own.mass, own.inertia, own.kind])
    return found


def joined(
    arrays: Arrays, scene: Scene, stored: Checkpoint, packing: Packing, v: np.ndarray, plane: float
) -> Checkpoint:  # fmt: skip
    """The state of a slot with a packing's grains behind the others, in no list yet. v: as in `_entering`."""
    entering, state = _entering(arrays, scene, packing, v, plane), dict(stored.arrays)
    for name in ("p", *arrays.state):
        each = 0 if name == "p" or arrays.state[name] == "one" else 1
        old = state[name]
        new = np.zeros((*old.shape[:each], len(packing), *old.shape[each + 1 :]), old.dtype)
        if name in entering:
            new[:] = entering[name]
        state[name] = np.concatenate([old, new], axis=each)
    state["past_work"] = state["past_work"][state["past_work"] != 0]  # else one more for each passage
    return replace(stored, arrays=state)


def set_velocities(arrays: Arrays, slot: int, rows: int, ids: np.ndarray, v: np.ndarray) -> None:
    """Give grains among the first `rows` rows of a slot other velocities v [m/s]."""
    numbers, of_rows = np.array(arrays.read("p", slot, rows)), arrays.read("ids", slot, rows)
    order = here(arrays.codec.decode(numbers)[0], of_rows)  # a grain that came back has a second row
    place = order[np.searchsorted(of_rows[order], ids)]
    numbers[place] = arrays.codec.with_velocities(numbers[place], v)
    arrays.write("p", slot, numbers)


def _in_blocks(arrays: Arrays, x: np.ndarray, cell: float) -> np.ndarray:
    """The order of grains in a slot: by blocks of cells, so that threads of a block have neighbours in common.

    Where threads share rods, blocks that lie at a wall would take longer than others, which wait for them in every
    step. There, rods are in rows of cells in each quarter of the bed, which measured best.
    """
    at = np.floor(x / cell).astype(np.int64)
    part = at // _BLOCK
    if arrays.module.ORIENTED and arrays.module.SHARED and len(x):
        part = x[:, :2] > np.median(x[:, :2], axis=0)
    return np.lexsort((*at.T, *part.T))


def set_springs(arrays: Arrays, slot: int, scene: Scene, packing: Packing, names: Sequence[str]) -> None:
    """Put a packing's springs into the lists of a slot, built since: of each pair both sides."""
    n = len(packing)
    if not len(packing.pairs) and not len(packing.wall_grain):
        return
    ids = arrays.read("ids", slot, n)
    assert packing.ids is not None
    by_id = np.argsort(ids)
    rows = by_id[np.searchsorted(ids, packing.ids, sorter=by_id)]
    nbr, count = arrays.read("nbr", slot, n), arrays.read("count", slot, n)
    nbr = nbr[: count.max()]
    held, spring = arrays.read("held", slot, n), arrays.read("spring", slot, n)
    rolling = arrays.read("rolling", slot, n) if "rolling" in arrays.state else None
    of_pairs, _ = packing.rolling
    i, j = rows[packing.pairs[:, 0]], rows[packing.pairs[:, 1]]
    entries = np.arange(len(nbr))[:, None]
    for a, b, sign in ((i, j, 1.0), (j, i, -1.0)):
        k, pair = np.nonzero((nbr[:, a] == b) & (entries < count[a]))
        row = a[pair]
        spring[k, row] = sign * packing.pair_spring[pair]
        if rolling is not None:
            rolling[k, row] = sign * of_pairs[pair]
        np.bitwise_or.at(held, row, np.uint32(1) << k.astype(np.uint32))
    arrays.write("spring", slot, spring)
    arrays.write("held", slot, held)
    if rolling is not None:
        arrays.write("rolling", slot, rolling)
    if names and len(packing.wall_grain):
        _set_wall_springs(arrays, slot, scene, packing, rows, names)


def _set_wall_springs(
    arrays: Arrays, slot: int, scene: Scene, packing: Packing, rows: np.ndarray, names: Sequence[str]
) -> None:  # fmt: skip
    """Put a packing's springs at walls into a slot; rows: of its grains. Raises ValueError for springs of parts that a
    wall has not."""
    n, parts = len(packing), arrays.sizes.parts
    state = {name: arrays.read(name, slot, n) for name in arrays.state if name.startswith("wall_")}
    at, part = rows[packing.wall_grain], packing.wall_part
    place = {name: wall for wall, name in enumerate(names)}
    wall = np.array([place.get(name, -1) for name in packing.wall_name.tolist()], np.int64)
    feature = None
    if "wall_feature" in state:
        features = np.diff(first_features(shapes_of(scene.container.walls()), is_oriented(scene)), append=0)[wall]
        if (beyond := (features > 0) & (part >= features)).any():
            raise ValueError(f"the packing has a spring at part {part[beyond].max()} of a wall of triangles")
        meshes = features > 0
        feature, part = np.where(meshes, part, 0), part.copy()
        part[meshes] = spring_places(at[meshes] * len(names) + wall[meshes])
    q = _seat_of(wall, state["wall_seat"][:, at], state["wall_near"][at], parts) if arrays.sizes.listed else wall
    there = (wall >= 0) & (q >= 0)
    k, at = (q * parts + part)[there], at[there]
    state["wall_spring"][k, at] = packing.wall_spring[there]
    if "wall_rolling" in state:
        state["wall_rolling"][k, at] = packing.rolling[1][there]
    if feature is not None:
        state["wall_feature"][k, at] = feature[there]
    # near or not: another part may go on with it
    np.bitwise_or.at(state["wall_held"], at, np.uint32(1) << k.astype(np.uint32))
    state["wall_held"][state["wall_near"] == 0] = 0  # where no wall is near nobody would look again
    for name in state.keys() & {"wall_spring", "wall_rolling", "wall_feature", "wall_held"}:
        arrays.write(name, slot, state[name])


def _seat_of(wall: np.ndarray, seat: np.ndarray, near: np.ndarray, parts: int) -> np.ndarray:
    """Entry at walls of each grain that is of a wall, -1 if none, shape [n] as `wall`. seat: of which wall each entry
    is, shape [entries, n]; near: which parts are near, as bits, shape [n]."""
    entries = np.arange(len(seat), dtype=np.uint32)[:, None]
    taken = (near >> (entries * np.uint32(parts)) & np.uint32((1 << parts) - 1)) > 0
    mine = taken & (seat == wall)
    return np.where(mine.any(axis=0), mine.argmax(axis=0), -1)


def packing(state: SlotState, scene: Scene, v: np.ndarray, m: np.ndarray) -> Packing:
    """The grains of a slot that have not left, by id. v, m: velocities and reduced angular momenta at the whole step,
    by row."""
    x, _, _, turned = state.states()
    ids, held = state.read("ids").astype(np.int64), state.read("held")
    order = here(x, ids)
    place = np.full(len(ids), -1)
    place[order] = np.arange(len(order))
    nbr, spring = state.read("nbr"), state.read("spring")
    k, r = np.nonzero(held[None, :] >> np.arange(len(nbr), dtype=np.uint32)[:, None] & 1)
    i, j = place[r], place[nbr[k, r]]
    kept = (i >= 0) & (j > i)
    by_pair = np.lexsort((j[kept], i[kept]))
    walls = state.read("wall_held")
    names, parts = [wall.name for wall in scene.container.walls()], state.sizes.parts
    most = min(len(names), state.sizes.seats) * parts
    k_wall, g = np.nonzero(walls[None, :] >> np.arange(most, dtype=np.uint32)[:, None] & 1)
    of = state.read("wall_seat")[k_wall // parts, g] if state.sizes.listed else k_wall // parts
    part = k_wall % parts
    if "wall_feature" in state.kinds:
        meshes = np.array([isinstance(shape, TriangleMesh) for shape in shapes_of(scene.container.walls())])[of]
        part = np.where(meshes, state.read("wall_feature")[k_wall, g], part)
    by_wall = np.lexsort((place[g], part, of))
    by_wall = by_wall[place[g[by_wall]] >= 0]
    k_wall, g, of, part = k_wall[by_wall], g[by_wall], of[by_wall], part[by_wall]
    q = None if turned is None else turned[order]
    more: dict[str, np.ndarray | None] = {}
    if "rolling" in state.kinds:
        rolling, at_walls = state.read("rolling"), state.read("wall_rolling")
        more["pair_rolling"] = rolling[k, r][kept][by_pair].astype(np.float64)
        more["wall_rolling"] = at_walls[k_wall, g].astype(np.float64)
    own = bodies(state, scene, order)
    return Packing(
        x=x[order],
        v=v[order],
        omega=spins(scene.grains, m[order], q),
        q=q,
        ids=ids[order],
        pairs=np.column_stack([i[kept], j[kept]])[by_pair],
        pair_spring=spring[k, r][kept][by_pair].astype(np.float64),
        wall_grain=place[g],
        wall_name=np.array([*names, ""], "U40")[of],
        wall_spring=state.read("wall_spring")[k_wall, g].astype(np.float64),
        wall_part=part,
        **more,
        **(own.carried(scene.grains) if own else {}),
    )


def bodies(state: SlotState, scene: Scene, order: np.ndarray) -> Bodies | None:
    """What the grains of a slot in the rows `order` are; None where all are alike."""
    if not scene.grains.varied:
        return None
    radius, mass, inertia, kind = state.read("body")[order].T
    return Bodies(radius, mass, inertia, kind.astype(np.int64))


def here(x: np.ndarray, ids: np.ndarray, inside: Inside | None = None) -> np.ndarray:
    """Rows of the grains that have not left, and are `inside`, in the order of their ids."""
    left = x[:, 2] > 0.5 * PARKED
    rows = np.flatnonzero(left if inside is None else left & inside(x))
    return rows[np.argsort(ids[rows])]


def checkpoint(state: SlotState, past_work: np.ndarray) -> dict[str, np.ndarray]:
    """The exact state of a slot, without the grains that have left: of these, only the work done on them is kept.

    past_work: that of grains that were left out earlier [J].
    """
    arrays = {name: state.read(name) for name in ("p", *state.kinds)}
    here = state.codec.decode(arrays["p"])[0][:, 2] > 0.5 * PARKED
    past = np.concatenate([past_work, arrays["work"][~here]])
    return _closed_up(arrays, here, state.kinds) | {"past_work": past}


def _closed_up(state: dict[str, np.ndarray], here: np.ndarray, entries: Mapping[str, str]) -> dict[str, np.ndarray]:
    """State arrays of the rows in `here` only; the others drop out of the lists."""
    if here.all():
        return state
    new_row = np.cumsum(here) - 1
    nbr, held = state["nbr"][:, here], state["held"][here]
    k = np.arange(len(nbr))[:, None]
    kept = (k < state["count"][here]) & here[nbr]
    order = np.argsort(~kept, axis=0, kind="stable")
    bits = np.take_along_axis((held >> k.astype(np.uint32) & 1) * kept, order, axis=0).astype(np.uint32)
    of_contacts = {name: state[name][:, here] for name in ("spring", "rolling") if name in state}
    one = {name: array[here] for name, array in state.items() if name == "p" or entries[name] == "one"}
    return {
        **one,
        **{name: array[:, here] for name, array in state.items() if entries.get(name) in ("walls", "seats")},
        "nbr": np.take_along_axis(np.where(kept, new_row[nbr], 0), order, axis=0).astype(nbr.dtype),
        **{name: np.take_along_axis(array, order[:, :, None], axis=0) for name, array in of_contacts.items()},
        "count": kept.sum(axis=0).astype(state["count"].dtype),
        "held": np.bitwise_or.reduce(bits << k.astype(np.uint32), axis=0),
    }


def restore(arrays: Arrays, slot: int, stored: Checkpoint) -> None:
    """Put back the exact state of a slot.

    A checkpoint has room for as many walls as any member had that was stepped beside this one. Where there now is room
    for fewer, what is left out is of walls that this member has not.
    """
    for name in ("p", *arrays.state):
        values = np.asarray(stored.arrays[name])
        kind = arrays.state.get(name)
        if kind in ("walls", "seats"):
            values = values[: arrays.sizes.entries[kind]]
        arrays.write(name, slot, values)
