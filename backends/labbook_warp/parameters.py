"""Parameters of kernels from a scene."""

import math
from collections.abc import Iterable, Sequence
from types import ModuleType
from typing import Any

import numpy as np
from labbook_dem import features
from labbook_dem.contact import rolling_rate
from labbook_dem.laws import LAWS
from labbook_dem.rotation import slenderness

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Probe
from labbook.scene import Scene
from labbook_warp.shapes import SHAPES

DEEP = 0.25
"""Overlap [d] whose force sets the quantum of sums: about 2^-48 of that force. Sums could overflow at 2^15 times this
force; 2^9 times already counts as a failure."""


def material(module: ModuleType, scene: Scene, numerics: Numerics) -> Any:
    """Record `kernels.system.Material` of a scene."""
    grains = scene.grains
    d, r = grains.diameter, grains.radius
    pair_table = features.pair_table(scene, numerics)
    skin = numerics.skin * d
    force = largest_force(scene, numerics)
    record = module.Material()
    record.c = module.coefs(*pair_table[0])
    record.radius, record.mass = r, grains.mass
    record.inertia_rate = rolling_rate(grains.inertia_axis, numerics.dt)
    record.reach, record.reach2, record.listed2, record.half_skin = r, d**2, (d + skin) ** 2, skin / 2
    record.half, record.slenderness = grains.overhang, slenderness(grains)
    record.centres2 = listing_distance(scene, numerics) ** 2
    record.inverse_mass, record.inverse_inertia = 1 / grains.mass, 1 / grains.inertia
    record.gravity, record.dt = scene.gravity, numerics.dt
    record.rolling_stiffness, record.rolling_damping = scene.contact.rolling_spring
    record.speed_limit2, record.overlap_limit = numerics.speed_limit**2, numerics.overlap_limit * scene.grains.finest
    record.quantum_f, record.quantum_t = _quantum(force), _quantum(force * (r + grains.overhang))
    record.per_quantum_f, record.per_quantum_t = 1 / record.quantum_f, 1 / record.quantum_t
    return record


def largest_force(scene: Scene, numerics: Numerics) -> float:
    """Largest force [N] of a contact at an overlap of DEEP d, of pairs and of walls with a stiffness of their own."""
    grains, law = scene.grains, LAWS[scene.contact.law]
    r, mass, deep = grains.radius, grains.mass, DEEP * grains.diameter
    forces = [law.normal(c, r / 2, mass / 2, deep, 0.0) for c in features.pair_table(scene, numerics)]
    for wall in scene.container.walls() if scene.has_own_stiffness else ():
        for kind in range(len(grains.species)):
            if (own_law := scene.law(wall, kind)) != scene.law_between(kind, kind):
                c = law.coefficients(own_law, scene.surface(wall, kind), numerics.stiffness_scale, True)
                forces.append(law.normal(c, r, mass, deep, 0.0))
    return max(forces)


def _quantum(force: float) -> float:
    """Power of two about 2^-48 of a force."""
    return math.ldexp(1.0, math.frexp(force)[1] - 48)


def member_domain(
    module: ModuleType, scene: Scene, numerics: Numerics, probes: Sequence[Probe], lattice: Sequence[int]
) -> Any:
    """Record `kernels.system.MemberDomain` of a scene; lattice: cells along x, y, z, from `lattice`."""
    record = module.MemberDomain()
    record.plane, record.drop = features.planes(scene, probes)
    record.cell = cell_size(scene, numerics)
    record.gx, record.gy, record.gz = lattice
    record.walls = len(scene.container.walls())
    return record


def same_material(runs: Iterable[tuple[Scene, Numerics]]) -> bool:
    """True if all of these have the same grains, law, gravity, clock and quanta."""
    different = {(id(s), id(n)): (s, n) for s, n in runs}.values()  # replicates share a scene
    kinds = {
        (s.grains.model_copy(update={"count": 1}), s.contact, s.gravity, n, largest_force(s, n)) for s, n in different
    }
    return len(kinds) == 1


def listing_distance(scene: Scene, numerics: Numerics) -> float:
    """Largest distance [m] between the centres of listed neighbours."""
    return scene.grains.diameter * (1 + numerics.skin) + 2 * scene.grains.overhang


def cell_size(scene: Scene, numerics: Numerics) -> float:
    """Edge of a cell [m]."""
    return listing_distance(scene, numerics) / SHAPES[scene.grains.shape].reach


def max_cells(grains: int) -> int:
    """Largest number of cells of a lattice for this many grains."""
    return 4 * grains + 64


def lattice(x: np.ndarray, cell: float, reach: int) -> tuple[int, ...]:
    """Numbers of cells along x, y, z over which grains spread, at most `max_cells` in all.

    Along each axis there is one cell, or enough that a grain's cells of neighbours, up to `reach` away, are distinct.

    Args:
        x: positions [m], shape [n, 3].
        cell: edge of a cell [m].
        reach: cells to a neighbour.
    """
    min_cells = 2 * reach + 1
    extent = np.ptp(x, axis=0) if len(x) else np.zeros(3)
    # grains within the thickness of one cell may lie in two; both wrap onto one
    cells = np.where(extent < cell, 1, (np.ceil(extent / cell) + 2).clip(min_cells, 1e6))
    limit = max_cells(len(x))
    while cells.prod() > limit:
        axis = int(np.argmax(cells))
        if cells[axis] <= min_cells:
            break
        cells[axis] = max(min_cells, np.floor(cells[axis] * 0.8))
    return tuple(int(n) for n in cells)
