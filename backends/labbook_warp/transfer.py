"""Members to and from slots: packings, which are portable, and checkpoints, which are exact."""

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
"""Cells along the edges of a block in space: some hundred grains, about the threads of a block of a kernel."""


def start(arrays: Arrays, slot: int, scene: Scene, packing: Packing, plane: float, cell: float) -> None:
    """Write a packing into a slot, in an order in which neighbours are close in memory."""
    order = _in_blocks(arrays, packing.x, cell)
    arrays.clear(slot)
    for name, values in entering(arrays, scene, packing, packing.v, plane).items():
        arrays.write(name, slot, values[order])


def entering(
    arrays: Arrays, scene: Scene, packing: Packing, v: np.ndarray, plane: float
) -> dict[str, np.ndarray]:  # fmt: skip
    """Nonzero state arrays of a packing's grains, with the velocities v [m/s], by row.

    Raises:
        ValueError: rods without orientations.
    """
    x, omega, q = packing.x, packing.omega, packing.q
    assert packing.ids is not None
    arrays_by_name = {"ids": packing.ids.astype(np.int32), "gone": (x[:, 2] < plane).astype(np.int32)}
    if is_oriented(scene):
        if q is None:
            raise ValueError("rods cannot start from a packing without orientations q: it is one of spheres")
        arrays_by_name["p"] = arrays.codec.encode(x, v, omega, axes(q))
        arrays_by_name["turned"] = q
        arrays_by_name["momentum"] = np.pad(momenta(scene.grains, omega, q), ((0, 0), (0, 1)))
    else:
        arrays_by_name["p"] = arrays.codec.encode(x, v, omega)
    if scene.grains.varied:
        varied = Bodies.of(scene.grains, packing)
        arrays_by_name["body"] = np.column_stack([varied.radius, varied.mass, varied.inertia, varied.kind])
    return arrays_by_name


def joined(
    arrays: Arrays, scene: Scene, stored: Checkpoint, packing: Packing, v: np.ndarray, plane: float
) -> Checkpoint:  # fmt: skip
    """Checkpoint of a slot with a packing's grains behind the others, in no list yet; v: as in `entering`."""
    new_rows, state = entering(arrays, scene, packing, v, plane), dict(stored.arrays)
    for name in ("p", *arrays.state):
        axis = 0 if name == "p" or arrays.state[name] == "one" else 1
        old = state[name]
        new = np.zeros((*old.shape[:axis], len(packing), *old.shape[axis + 1 :]), old.dtype)
        if name in new_rows:
            new[:] = new_rows[name]
        state[name] = np.concatenate([old, new], axis=axis)
    state["past_work"] = state["past_work"][state["past_work"] != 0]  # else it would grow with each return of grains
    return replace(stored, arrays=state)


def set_velocities(arrays: Arrays, slot: int, rows: int, ids: np.ndarray, v: np.ndarray) -> None:
    """Set velocities v [m/s] of grains among the first `rows` rows of a slot."""
    numbers, of_rows = np.array(arrays.read("p", slot, rows)), arrays.read("ids", slot, rows)
    order = present_rows(arrays.codec.decode(numbers)[0], of_rows)  # a grain that returned has a second row
    index = order[np.searchsorted(of_rows[order], ids)]
    numbers[index] = arrays.codec.with_velocities(numbers[index], v)
    arrays.write("p", slot, numbers)


def _in_blocks(arrays: Arrays, x: np.ndarray, cell: float) -> np.ndarray:
    """Order of grains in a slot: by blocks of cells, so that threads of a block have neighbours in common.

    If threads share rods, a block at a wall would take longer, and all others wait for it in every step. There rods are
    ordered by cells within each quarter of the bed, the fastest of the measured orders.
    """
    at = np.floor(x / cell).astype(np.int64)
    block = at // _BLOCK
    if arrays.module.ORIENTED and arrays.module.SHARED and len(x):
        block = x[:, :2] > np.median(x[:, :2], axis=0)
    return np.lexsort((*at.T, *block.T))


def set_springs(arrays: Arrays, slot: int, scene: Scene, packing: Packing, names: Sequence[str]) -> None:
    """Write a packing's springs into the new lists of a slot, on both sides of each pair."""
    n = len(packing)
    if not len(packing.pairs) and not len(packing.wall_grain):
        return
    ids = arrays.read("ids", slot, n)
    assert packing.ids is not None
    by_id = np.argsort(ids)
    rows = by_id[np.searchsorted(ids, packing.ids, sorter=by_id)]
    nbr, count = arrays.read("nbr", slot, n), arrays.read("count", slot, n)
    nbr = nbr[: count.max()]
    masks, springs = arrays.read("held", slot, n), arrays.read("spring", slot, n)
    rolling = arrays.read("rolling", slot, n) if "rolling" in arrays.state else None
    pair_rolling, _ = packing.rolling
    i, j = rows[packing.pairs[:, 0]], rows[packing.pairs[:, 1]]
    entries = np.arange(len(nbr))[:, None]
    for first, second, sign in ((i, j, 1.0), (j, i, -1.0)):
        k, pair = np.nonzero((nbr[:, first] == second) & (entries < count[first]))
        row = first[pair]
        springs[k, row] = sign * packing.pair_spring[pair]
        if rolling is not None:
            rolling[k, row] = sign * pair_rolling[pair]
        np.bitwise_or.at(masks, row, np.uint32(1) << k.astype(np.uint32))
    arrays.write("spring", slot, springs)
    arrays.write("held", slot, masks)
    if rolling is not None:
        arrays.write("rolling", slot, rolling)
    if names and len(packing.wall_grain):
        _set_wall_springs(arrays, slot, scene, packing, rows, names)


def _set_wall_springs(
    arrays: Arrays, slot: int, scene: Scene, packing: Packing, rows: np.ndarray, names: Sequence[str]
) -> None:  # fmt: skip
    """Write a packing's springs at walls into a slot; rows: rows of its grains.

    Raises:
        ValueError: a spring at a part that a mesh lacks.
    """
    n, parts = len(packing), arrays.sizes.parts
    state = {name: arrays.read(name, slot, n) for name in arrays.state if name.startswith("wall_")}
    at, part = rows[packing.wall_grain], packing.wall_part
    index_of_wall = {name: wall for wall, name in enumerate(names)}
    wall = np.array([index_of_wall.get(name, -1) for name in packing.wall_name.tolist()], np.int64)
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
    # also at parts that are not near: another part may inherit the spring
    np.bitwise_or.at(state["wall_held"], at, np.uint32(1) << k.astype(np.uint32))
    state["wall_held"][state["wall_near"] == 0] = 0  # as after a rebuild of lists
    for name in state.keys() & {"wall_spring", "wall_rolling", "wall_feature", "wall_held"}:
        arrays.write(name, slot, state[name])


def _seat_of(wall: np.ndarray, seat: np.ndarray, near: np.ndarray, parts: int) -> np.ndarray:
    """Entry of each grain that belongs to its wall, -1 if none, shape [n].

    Args:
        wall: a wall for each grain, shape [n].
        seat: wall of each entry, shape [entries, n].
        near: masks of near parts, shape [n].
        parts: parts a wall.
    """
    entries = np.arange(len(seat), dtype=np.uint32)[:, None]
    in_use = (near >> (entries * np.uint32(parts)) & np.uint32((1 << parts) - 1)) > 0
    of_wall = in_use & (seat == wall)
    return np.where(of_wall.any(axis=0), of_wall.argmax(axis=0), -1)


def packing(state: SlotState, scene: Scene, v: np.ndarray, m: np.ndarray) -> Packing:
    """Packing of the present grains of a slot, by id. v, m: velocities and reduced angular momenta at the whole step,
    by row."""
    x, _, _, orientation = state.states()
    ids, masks = state.read("ids").astype(np.int64), state.read("held")
    order = present_rows(x, ids)
    index = np.full(len(ids), -1)
    index[order] = np.arange(len(order))
    nbr, spring = state.read("nbr"), state.read("spring")
    k, row = np.nonzero(masks[None, :] >> np.arange(len(nbr), dtype=np.uint32)[:, None] & 1)
    i, j = index[row], index[nbr[k, row]]
    selected = (i >= 0) & (j > i)
    by_pair = np.lexsort((j[selected], i[selected]))
    wall_masks = state.read("wall_held")
    names, parts = [wall.name for wall in scene.container.walls()], state.sizes.parts
    entries = min(len(names), state.sizes.seats) * parts
    k_wall, wall_row = np.nonzero(wall_masks[None, :] >> np.arange(entries, dtype=np.uint32)[:, None] & 1)
    wall_index = state.read("wall_seat")[k_wall // parts, wall_row] if state.sizes.listed else k_wall // parts
    part = k_wall % parts
    if "wall_feature" in state.kinds:
        meshes = np.array([isinstance(shape, TriangleMesh) for shape in shapes_of(scene.container.walls())])[wall_index]
        part = np.where(meshes, state.read("wall_feature")[k_wall, wall_row], part)
    by_wall = np.lexsort((index[wall_row], part, wall_index))
    by_wall = by_wall[index[wall_row[by_wall]] >= 0]
    k_wall, wall_row, wall_index, part = k_wall[by_wall], wall_row[by_wall], wall_index[by_wall], part[by_wall]
    q = None if orientation is None else orientation[order]
    rolling_fields: dict[str, np.ndarray | None] = {}
    if "rolling" in state.kinds:
        rolling, at_walls = state.read("rolling"), state.read("wall_rolling")
        rolling_fields["pair_rolling"] = rolling[k, row][selected][by_pair].astype(np.float64)
        rolling_fields["wall_rolling"] = at_walls[k_wall, wall_row].astype(np.float64)
    varied = bodies(state, scene, order)
    return Packing(
        x=x[order],
        v=v[order],
        omega=spins(scene.grains, m[order], q),
        q=q,
        ids=ids[order],
        pairs=np.column_stack([i[selected], j[selected]])[by_pair],
        pair_spring=spring[k, row][selected][by_pair].astype(np.float64),
        wall_grain=index[wall_row],
        wall_name=np.array([*names, ""], "U40")[wall_index],
        wall_spring=state.read("wall_spring")[k_wall, wall_row].astype(np.float64),
        wall_part=part,
        **rolling_fields,
        **(varied.carried(scene.grains) if varied else {}),
    )


def bodies(state: SlotState, scene: Scene, order: np.ndarray) -> Bodies | None:
    """Properties of the grains in the rows `order`; None if all grains are the same."""
    if not scene.grains.varied:
        return None
    radius, mass, inertia, kind = state.read("body")[order].T
    return Bodies(radius, mass, inertia, kind.astype(np.int64))


def present_rows(x: np.ndarray, ids: np.ndarray, inside: Inside | None = None) -> np.ndarray:
    """Rows of the grains that have not left, and are `inside`, sorted by id."""
    present = x[:, 2] > 0.5 * PARKED
    rows = np.flatnonzero(present if inside is None else present & inside(x))
    return rows[np.argsort(ids[rows])]


def checkpoint(state: SlotState, past_work: np.ndarray) -> dict[str, np.ndarray]:
    """Arrays of the exact state of a slot without the grains that have left, whose work is added to `past_work`.

    past_work: work on grains that were dropped earlier [J].
    """
    arrays = {name: state.read(name) for name in ("p", *state.kinds)}
    present = state.codec.decode(arrays["p"])[0][:, 2] > 0.5 * PARKED
    past = np.concatenate([past_work, arrays["work"][~present]])
    return _closed_up(arrays, present, state.kinds) | {"past_work": past}


def _closed_up(state: dict[str, np.ndarray], present: np.ndarray, entries: Mapping[str, str]) -> dict[str, np.ndarray]:
    """State arrays of the `present` rows only; the others drop out of the lists."""
    if present.all():
        return state
    new_row = np.cumsum(present) - 1
    nbr, masks = state["nbr"][:, present], state["held"][present]
    k = np.arange(len(nbr))[:, None]
    selected = (k < state["count"][present]) & present[nbr]
    order = np.argsort(~selected, axis=0, kind="stable")
    bits = np.take_along_axis((masks >> k.astype(np.uint32) & 1) * selected, order, axis=0).astype(np.uint32)
    contact_arrays = {name: state[name][:, present] for name in ("spring", "rolling") if name in state}
    by_row = {name: array[present] for name, array in state.items() if name == "p" or entries[name] == "one"}
    return {
        **by_row,
        **{name: array[:, present] for name, array in state.items() if entries.get(name) in ("walls", "seats")},
        "nbr": np.take_along_axis(np.where(selected, new_row[nbr], 0), order, axis=0).astype(nbr.dtype),
        **{name: np.take_along_axis(array, order[:, :, None], axis=0) for name, array in contact_arrays.items()},
        "count": selected.sum(axis=0).astype(state["count"].dtype),
        "held": np.bitwise_or.reduce(bits << k.astype(np.uint32), axis=0),
    }


def restore(arrays: Arrays, slot: int, stored: Checkpoint) -> None:
    """Write the exact state of a slot.

    A checkpoint has entries for as many walls as any member had beside this one. If there are fewer entries now, those
    left out belong to walls that this member does not have.
    """
    for name in ("p", *arrays.state):
        values = np.asarray(stored.arrays[name])
        kind = arrays.state.get(name)
        if kind in ("walls", "seats"):
            values = values[: arrays.sizes.entries[kind]]
        arrays.write(name, slot, values)
