"""Validation of checkpoints. Kernels check no index: one out of range would corrupt other members."""

from collections.abc import Mapping

import numpy as np
from labbook_dem.clump_rows import rows_of_grain
from labbook_dem.ensemble import LONGEST, check_checkpoint
from labbook_dem.features import has_rods
from labbook_dem.mesh_grid import first_features, shapes_of

from labbook.backend import Capabilities, Checkpoint, Spec
from labbook.backend.numerics import Numerics
from labbook.scene import Clumps, Scene
from labbook_warp.codec import Codec
from labbook_warp.kernels.words import MOST_CONTACTS
from labbook_warp.layout import state
from labbook_warp.room import MOST_NEAR
from labbook_warp.shapes import SHAPES
from labbook_warp.spec import most_parts

_NUMBERS = ("step", "rebuilds")
_NEWER = frozenset({"most"})
"""Arrays that older checkpoints lack."""
_WIDE = {"origin": 3, "facing": 3, "turned": 4, "body": 4, "work": 0, "deep": 0}
_WIDE |= {"clump_x": 3, "clump_v": 3, "clump_m": 3}
_REAL = {"spring": 3, "wall_spring": 3, "rolling": 3, "wall_rolling": 3, "momentum": 4}
_WHOLE = ("ids", "gone", "count", "nbr", "wall_seat", "wall_feature")
"""Types of arrays, with numbers an entry; all others are masks of 32 bits."""


def check(can: Capabilities, spec: Spec, scene: Scene, numerics: Numerics, stored: Checkpoint) -> None:
    """Validate a checkpoint.

    Args:
        can: capabilities of the backend.
        spec: features.
        scene: scene of the member.
        numerics: its numerics.
        stored: the checkpoint.

    Raises:
        ValueError: no member of `scene` with `spec` can have left this checkpoint; the message names the array.
    """
    listed, rolling = spec.feature("LISTED"), spec.feature("ROLLING_SPRING")
    per_grain, varied = rows_of_grain(scene), scene.grains.varied or isinstance(scene.grains, Clumps)
    entries = state(scene.grains.shape, varied, listed, rolling, spec.feature("MESHES"))
    check_checkpoint(can, {"p", *entries, *_NUMBERS, "past_work", *_NEWER}, stored, _NEWER)
    arrays = {name: np.asarray(array) for name, array in stored.arrays.items()}
    codec, real = (
        Codec(numerics.precision == "mixed", SHAPES[scene.grains.shape].shared_fields),
        np.dtype("f4" if numerics.precision == "mixed" else "f8"),
    )
    n = len(arrays["ids"]) if arrays["ids"].ndim else -1
    near, walls = (len(arrays[name]) if arrays[name].ndim else 0 for name in ("nbr", "wall_spring"))
    if not (0 <= n <= scene.grains.count * per_grain and n % per_grain == 0 and 0 < near <= MOST_NEAR and walls > 0):
        raise ValueError(f"it has {n} grains of {scene.grains.count}, {near} neighbours a grain and {walls} walls")
    parts = most_parts(spec)
    leading_shapes = {"one": (n,), "near": (near, n), "walls": (walls, n), "seats": (walls // parts, n)}
    expected: dict[str, tuple[tuple[int, ...], np.dtype]] = {name: ((), np.dtype(np.int64)) for name in _NUMBERS}
    expected |= {
        "p": ((n, codec.words * codec.numbers), real),
        "past_work": (arrays["past_work"].shape[:1], np.dtype("f8")),
    }
    for name, kind_of_entries in entries.items():
        size = _WIDE.get(name, _REAL.get(name, 0))
        kind = np.float64 if name in _WIDE else real if name in _REAL else np.int32 if name in _WHOLE else np.uint32
        expected[name] = ((*leading_shapes[kind_of_entries], *((size,) if size else ())), np.dtype(kind))
    if "most" in arrays:
        expected["most"] = ((2,), np.dtype("f8"))
    for name, (shape, kind) in expected.items():
        if arrays[name].shape != shape or arrays[name].dtype != kind:
            raise ValueError(f"{name} has shape {arrays[name].shape} of {arrays[name].dtype}, not {shape} of {kind}")
        if name == "most":
            if not (arrays[name] >= 0).all():
                raise ValueError("most: the largest overlap or speed so far is negative or NaN")
        elif name != "p" and not np.isfinite(arrays[name]).all():
            raise ValueError(f"{name} is not finite")
    for name, part in zip(("positions", "velocities", "spins"), codec.decode(arrays["p"]), strict=True):
        if not np.isfinite(part).all():
            raise ValueError(f"{name} are not finite in row {int(np.argmin(np.isfinite(part).all(axis=1)))}")
    _check_lists(arrays, scene, n, near, parts)


def _check_lists(arrays: Mapping[str, np.ndarray], scene: Scene, n: int, near: int, parts: int) -> None:
    # Kernels check no bounds: an index of a damaged file would read memory of others.
    count = len(scene.container.walls())
    if len(arrays["wall_spring"]) < (walls := min(count, MOST_CONTACTS // parts) * parts):
        raise ValueError(f"wall_spring is of {len(arrays['wall_spring'])} walls, not of {walls}")
    per_grain = rows_of_grain(scene)
    limits = {"ids": scene.grains.count * per_grain, "gone": 2, "count": near + 1, "nbr": max(n, 1)}
    limits["wall_seat"] = max(count, 1)
    for name, limit in limits.items():
        if name in arrays and arrays[name].size and not (arrays[name].min() >= 0 and arrays[name].max() < limit):
            raise ValueError(f"{name} is not within 0 to {limit - 1}")
    if len(np.unique(arrays["ids"])) != n:
        raise ValueError("two grains have the same id")
    of_grains = arrays["ids"].reshape(-1, per_grain)
    if not (of_grains == of_grains[:, :1] // per_grain * per_grain + np.arange(per_grain)).all():
        raise ValueError("ids are not those of the spheres of clumps, in their order")
    for name, bits in {"held": near, "wall_near": walls, "wall_held": walls}.items():
        if (arrays[name].astype(np.uint64) >> np.uint64(bits)).any():
            raise ValueError(f"{name} has bits beyond {bits}")
    if not 0 <= arrays["step"] < LONGEST or arrays["rebuilds"] < 0:
        raise ValueError(f"it was saved at step {arrays['step']}")
    if "wall_feature" in arrays:
        _check_features(arrays, scene, parts)
    if "body" in arrays and n:
        radius, mass, inertia, kind = arrays["body"].T
        sound = (radius > 0) & (radius <= scene.grains.radius) & (mass > 0) & (inertia > 0)
        if not (sound & np.isin(kind, np.arange(len(scene.grains.species)))).all():
            raise ValueError("body holds grains that the scene does not have")


def _check_features(arrays: Mapping[str, np.ndarray], scene: Scene, parts: int) -> None:
    """Raise ValueError if a spring at a mesh is not of one of its features."""
    features = np.diff(first_features(shapes_of(scene.container.walls()), has_rods(scene)))
    entries = np.arange(len(arrays["wall_feature"]))[:, None]
    wall_of_entry = arrays["wall_seat"] if "wall_seat" in arrays else np.arange(len(entries) // parts)[:, None]
    wall = np.repeat(wall_of_entry, parts, axis=0).clip(max=len(features) - 1)
    valid = arrays["wall_held"] >> entries.astype(np.uint32) & 1 == 1
    feature = arrays["wall_feature"]
    if not ((feature >= 0) & (feature < np.maximum(features[wall], 1)))[valid].all():
        raise ValueError("springs at a mesh are not of its features")
