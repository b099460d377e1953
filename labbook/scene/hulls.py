"""Surfaces of grains in space: the spheres that bound them, and gaps between grains."""

from collections.abc import Iterator

import numpy as np

from labbook.scene.grains import Clumps, Grains, Spherocylinders
from labbook.scene.orientation import axes, distances, rotated


def bounding_spheres(grains: Grains, x: np.ndarray, q: np.ndarray | None) -> Iterator[tuple[np.ndarray, float]]:
    """Find the spheres of which every grain is the hull, or the union.

    A sphere is its own, a rod is the hull of its two ends, a clump the union of all. So a grain is clear of a wall that
    is not concave on the scale of a rod if these spheres are.

    Args:
        grains: Grains of the scene.
        x: Centres of the grains [m], shape [n, 3].
        q: Orientations, shape [n, 4]; None for spheres.

    Yields:
        Centres of a sphere of each grain [m], shape [n, 3], and its radius in units of the grain's `radius`.
    """
    if q is None:
        yield x, 1.0
    elif isinstance(grains, Clumps):
        for sphere in grains.spheres:
            yield x + rotated(q, sphere.centre), sphere.radius / grains.radius
    elif isinstance(grains, Spherocylinders):
        half = grains.half_length * axes(q)
        yield x + half, 1.0
        yield x - half, 1.0
    else:
        yield x, 1.0


def overlapping(
    grains: Grains,
    branch: np.ndarray,
    q: np.ndarray | None,
    second_q: np.ndarray | None,
    clearance: np.ndarray | float,
) -> np.ndarray:
    """Mark pairs of grains whose surfaces are nearer than they should be.

    Args:
        grains: Grains of the scene.
        branch: Branches from the centre of the second grain to that of the first [m], shape [n, 3].
        q: Orientations of the first grains, shape [n, 4]; None for spheres.
        second_q: Those of the second grains.
        clearance: Sum of the radii that both keep free around their centres, segments or largest spheres [m], shape
            [n] or one for all. Smaller spheres of a clump keep as much less as they are smaller.

    Returns:
        Mask, shape [n].
    """
    if q is None or second_q is None:
        return np.linalg.norm(branch, axis=1) < clearance
    if isinstance(grains, Spherocylinders):
        return distances(branch, axes(q), axes(second_q), grains.half_length) < clearance
    meets = np.zeros(len(branch), bool)
    for first, part in bounding_spheres(grains, branch, q):
        for second, second_part in bounding_spheres(grains, np.zeros_like(branch), second_q):
            meets |= np.linalg.norm(first - second, axis=1) < (part + second_part) / 2 * clearance
    return meets


def sphere_centres(grains: Clumps, x: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Find the centres of all spheres of clumps.

    Args:
        grains: Grains of the scene, with k spheres each.
        x: Centres of mass [m], shape [n, 3].
        q: Orientations, shape [n, 4].

    Returns:
        Centres [m], those of a clump one after another, shape [n k, 3].
    """
    return np.stack([x + rotated(q, sphere.centre) for sphere in grains.spheres], axis=1).reshape(-1, 3)


def upper_reach(grains: Grains, radius: np.ndarray | float, q: np.ndarray | None, axis: int = 2) -> np.ndarray | float:
    """Find how far each grain reaches from its centre along a coordinate axis.

    Args:
        grains: Grains of the scene.
        radius: Radii of the grains [m], shape [n] or one for all.
        q: Orientations, shape [n, 4]; None for spheres.
        axis: 0, 1 or 2 for x, y or z.

    Returns:
        Distances [m], shape [n], or one for all spheres.
    """
    if isinstance(grains, Clumps) and q is not None:
        spheres = [rotated(q, sphere.centre)[:, axis] + sphere.radius for sphere in grains.spheres]
        return np.max(spheres, axis=0)
    if isinstance(grains, Spherocylinders) and q is not None:
        return radius + grains.half_length * np.abs(axes(q)[:, axis])
    return radius
