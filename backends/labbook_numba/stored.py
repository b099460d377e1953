"""Validation of checkpoints. Kernels check no index: one out of range would crash the process."""

from collections.abc import Mapping

import numpy as np
from labbook_dem.ensemble import LONGEST
from labbook_dem.features import has_meshes, is_oriented, rolling_springs
from labbook_dem.mesh import SPRING_KEY
from labbook_dem.mesh_grid import first_features, shapes_of

from labbook.backend.numerics import Numerics
from labbook.scene import Scene
from labbook_numba import state as S
from labbook_numba.state import Layout, State


def layout_of(scene: Scene) -> Layout:
    """Layout of the rows of a scene."""
    layout = S.MIXTURES if scene.grains.varied else S.LAYOUTS[scene.grains.shape]
    layout = layout.with_rolling_springs() if rolling_springs(scene) else layout
    return layout.with_meshes() if has_meshes(scene) else layout


def array_names(scene: Scene) -> set[str]:
    """Names of the arrays of a State that checkpoints contain."""
    return set(State._fields) - set(S.SCRATCH) - (set() if scene.grains.varied else {"body"})


def check_state(arrays: Mapping[str, np.ndarray], scene: Scene, numerics: Numerics, crossings: bool = False) -> None:
    """Validate the arrays of a checkpoint.

    Args:
        arrays: arrays by the names of `array_names`.
        scene: scene of the member.
        numerics: its numerics.
        crossings: the arrays must have room for the crossings of all grains.

    Raises:
        ValueError: no member of `scene` can have these arrays; the message names the array.
    """
    layout, walls = layout_of(scene), len(scene.container.walls())
    lengths = {name: array.shape[0] if array.ndim else 0 for name, array in arrays.items()}
    rows, pairs, near = lengths["ids"], lengths["pair_i"] - S.PAD, lengths["wall_grain"] - S.PAD
    if not (0 < rows <= scene.grains.count and pairs >= 0 and near >= 0):
        raise ValueError(f"it has {rows} grains of {scene.grains.count}, and lists of {pairs} and {near}")
    template = S.allocate(0, 0, walls, 0, 0, numerics.precision, layout)._asdict()
    of_grains = {"grains": rows + S.GHOSTS, "loads": rows + S.GHOSTS, "body": rows + S.GHOSTS, "gone": rows}
    of_pairs = {"pair_j": pairs + S.PAD, "held": pairs + S.PAD, "spring": pairs + S.PAD}
    of_walls = {"wall_held": near + S.PAD, "wall_spring": (near + S.PAD) * layout.WALL_PARTS, "wall_first": walls + 1}
    expected_lengths = of_grains | of_pairs | of_walls | {"count": S.COUNTERS, "sums": S.SUMS}
    for name, array in arrays.items():
        shape = (expected_lengths.get(name, lengths[name]), *template[name].shape[1:])
        if array.shape != shape or array.dtype != template[name].dtype:
            raise ValueError(f"{name} has shape {array.shape} of {array.dtype}, not {shape} of {template[name].dtype}")
    if lengths["cross"] not in (0, rows) or (crossings and lengths["cross"] < rows):
        raise ValueError(f"cross has room for {lengths['cross']} grains of {rows}")
    _check_counters(arrays, rows, pairs, near)
    _check_lists(arrays, walls)
    _check_features(arrays, scene, layout)
    _check_grains(arrays, scene)


def _check_counters(arrays: Mapping[str, np.ndarray], rows: int, pairs: int, near: int) -> None:
    count, first = arrays["count"], arrays["wall_first"]
    n = int(count[S.GRAINS])
    limits = {S.GRAINS: rows, S.PAIRS: pairs, S.CROSSED: len(arrays["cross"]), S.LEAVING: n}
    for counter, limit in limits.items():
        if not 0 <= count[counter] <= limit:
            raise ValueError(f"count[{counter}] is {count[counter]}, not within 0 to {limit}")
    if not 0 <= count[S.STEP] < LONGEST:
        raise ValueError(f"it was saved at step {count[S.STEP]}")
    if first[0] != 0 or (np.diff(first) < 0).any() or first[-1] > near:
        raise ValueError("wall_first is not ascending within the list")


def _check_lists(arrays: Mapping[str, np.ndarray], walls: int) -> None:
    n, pairs, first = int(arrays["count"][S.GRAINS]), int(arrays["count"][S.PAIRS]), arrays["wall_first"]
    # 64 bits: i * (n + 1) of many grains does not fit into the 32 of the lists
    i, j = arrays["pair_i"][:pairs].astype(np.int64), arrays["pair_j"][:pairs].astype(np.int64)
    order = np.diff(i * (n + 1) + j)
    if pairs and not ((i >= 0).all() and (i < j).all() and (j < n).all() and (order > 0).all()):
        raise ValueError(f"pair_i and pair_j are not ascending pairs of {n} grains")
    # Kernels take pairs in blocks, and read beyond the last pair: there they must find grains that touch nothing.
    ghosts = len(arrays["grains"]) - S.GHOSTS
    behind = slice(pairs, pairs + S.PAD)
    if not ((arrays["pair_i"][behind] == ghosts).all() and (arrays["pair_j"][behind] == ghosts + 1).all()):
        raise ValueError("no pairs of ghosts are behind the last pair")
    for w in range(walls):
        grain = arrays["wall_grain"][first[w] : first[w + 1]]
        if len(grain) and not (grain[0] >= 0 and grain[-1] < n and (np.diff(grain) > 0).all()):
            raise ValueError(f"wall_grain is not ascending within {n} grains")
    per_contact = len(arrays["wall_spring"]) // len(arrays["wall_grain"])
    for name, largest in (("held", 1), ("wall_held", (1 << per_contact) - 1)):
        if (arrays[name] > largest).any():
            raise ValueError(f"{name} is not within 0 to {largest}")


def _check_features(arrays: Mapping[str, np.ndarray], scene: Scene, layout: Layout) -> None:
    """Raise ValueError if a spring at a mesh is not of one of its features."""
    shapes, first = shapes_of(scene.container.walls()), arrays["wall_first"]
    bounds = first_features(shapes, is_oriented(scene))
    for w in np.flatnonzero(np.diff(bounds)):
        entries = arrays["wall_held"][first[w] : first[w + 1]]
        bits = (entries[:, None] >> np.arange(layout.WALL_PARTS) & 1).astype(bool).ravel()
        rows = slice(first[w] * layout.WALL_PARTS, first[w + 1] * layout.WALL_PARTS)
        feature = arrays["wall_spring"][rows, SPRING_KEY][bits]
        if not ((feature >= bounds[w]) & (feature < bounds[w + 1])).all():
            raise ValueError("springs at a mesh are not of its features")


def _check_grains(arrays: Mapping[str, np.ndarray], scene: Scene) -> None:
    n, pairs = int(arrays["count"][S.GRAINS]), int(arrays["count"][S.PAIRS])
    ids = arrays["ids"][:n]
    if n and not (ids.min() >= 0 and ids.max() < scene.grains.count and len(np.unique(ids)) == n):
        raise ValueError(f"ids are not different ones of {scene.grains.count} grains")
    if arrays["grains"][-1, S.X] != S.FAR:
        raise ValueError("the last ghost is not far away")
    per_contact = len(arrays["wall_spring"]) // len(arrays["wall_grain"])
    springs = {"spring": pairs, "wall_spring": int(arrays["wall_first"][-1]) * per_contact}
    if not (arrays["sums"][[S.DEEPEST, S.FASTEST2]] >= 0).all():
        raise ValueError("the largest overlap or speed so far is negative or NaN")
    for name, rows in ({"grains": n, "loads": n, "sums": S.OLDER_SUMS} | springs).items():
        if not np.isfinite(arrays[name][:rows]).all():
            row = int(np.argmin(np.isfinite(arrays[name][:rows]).reshape(rows, -1).all(axis=1)))
            raise ValueError(f"{name} is not finite in row {row}")
    if "body" in arrays:
        radius, mass, inertia, kind = arrays["body"][:n].T
        sound = (radius > 0) & (radius <= scene.grains.radius) & (mass > 0) & (inertia > 0)
        if not (sound & np.isin(kind, np.arange(len(scene.grains.species)))).all():
            raise ValueError("body holds grains that the scene does not have")
