"""Rows of clumps in the arrays of compiled backends: one for each sphere, those of a clump one after another."""

from typing import NamedTuple

import numpy as np

from labbook.scene import Clumps, Packing, Scene
from labbook.scene.grains import MOST_SPHERES


def rows_of_grain(scene: Scene) -> int:
    """Number of rows of a grain: the number of spheres of a clump, 1 for all other grains."""
    return len(scene.grains.spheres) if isinstance(scene.grains, Clumps) else 1


def row_ids(ids: np.ndarray, per_grain: int) -> np.ndarray:
    """Ids of the rows of grains: id of the grain times per_grain plus the index of the sphere."""
    return (ids[:, None] * per_grain + np.arange(per_grain)).ravel()


def bodies_of_spheres(grains: Clumps) -> np.ndarray:
    """Numbers of the spheres of a clump as grains that differ have them, shape [k, 4]: radius [m], mass of the clump
    [kg], its smallest moment of inertia [kg m^2], which limits rolling resistance, and kind."""
    return np.array([[sphere.radius, grains.mass, grains.inertia_axis, 0.0] for sphere in grains.spheres])


def packing_of_rows(scene: Scene, packing: Packing) -> Packing:
    """Packing whose ids and springs are those of rows; of clumps, positions and velocities are those of each whole.

    Raises:
        ValueError: the springs are not of clumps of these spheres.
    """
    per_grain, parts, at_walls = rows_of_grain(scene), packing.pair_parts, packing.wall_part
    if not isinstance(scene.grains, Clumps):
        return packing
    if parts is None:
        if len(packing.pairs):
            raise ValueError("clumps cannot start from a packing without pair_parts: it is not one of clumps")
        parts = np.zeros((0, 2), np.int64)
    if max(parts.max(initial=0), (at_walls % MOST_SPHERES).max(initial=0)) >= per_grain:
        raise ValueError(f"the packing has springs of spheres that clumps of {per_grain} do not have")
    assert packing.ids is not None
    x, v, omega = (np.repeat(vectors, per_grain, axis=0) for vectors in (packing.x, packing.v, packing.omega))
    return Packing(
        x=x,
        v=v,
        omega=omega,
        ids=row_ids(packing.ids, per_grain),
        pairs=packing.pairs * per_grain + parts,
        pair_spring=packing.pair_spring,
        wall_grain=packing.wall_grain * per_grain + at_walls % MOST_SPHERES,
        wall_name=packing.wall_name,
        wall_spring=packing.wall_spring,
        wall_part=at_walls // MOST_SPHERES,
    )


class GrainContacts(NamedTuple):
    """Contacts as a packing has them; see `labbook.scene.Packing`."""

    pairs: np.ndarray
    pair_parts: np.ndarray | None
    wall_grain: np.ndarray
    wall_part: np.ndarray


def contacts_of_grains(scene: Scene, pairs: np.ndarray, wall_rows: np.ndarray, wall_part: np.ndarray) -> GrainContacts:
    """Contacts of grains from those of rows: pairs [p, 2] and rows at walls [k], with parts of walls [k]."""
    if not isinstance(scene.grains, Clumps):
        return GrainContacts(pairs, None, wall_rows, wall_part)
    per_grain = rows_of_grain(scene)
    grains, place = np.divmod(wall_rows, per_grain)
    return GrainContacts(*np.divmod(pairs, per_grain), grains, MOST_SPHERES * wall_part + place)
