"""From a scene to the numbers that its kernels take."""

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
"""Overlap [d] whose force sets the quantum of sums: about 2^-48 of it. Sums could overflow at 2^15 times as much;
forces of 2^9 times as much are no longer counted, but fail."""


def material(module: ModuleType, scene: Scene, numerics: Numerics) -> Any:
    """The record of grains, law and clock."""
    grains = scene.grains
    d, r = grains.diameter, grains.radius
    table = features.pair_table(scene, numerics)
    skin = numerics.skin * d
    most = largest_force(scene, numerics)
    made = module.Material()
    made.c = module.coefs(*table[0])
    made.radius, made.mass = r, grains.mass
    made.inertia_rate = rolling_rate(grains.inertia_axis, numerics.dt)
    made.reach, made.reach2, made.listed2, made.half_skin = r, d**2, (d + skin) ** 2, skin / 2
    made.half, made.slender, made.centres2 = grains.half_length, slenderness(grains), farthest(scene, numerics) ** 2
    made.per_mass, made.per_inertia = 1 / grains.mass, 1 / grains.inertia
    made.gravity, made.dt = scene.gravity, numerics.dt
    made.rolling_stiffness, made.rolling_damping = scene.contact.rolling_spring
    made.speed2, made.deepest = numerics.speed_limit**2, numerics.overlap_limit * scene.grains.finest
    made.quantum_f, made.quantum_t = _quantum(most), _quantum(most * (r + grains.half_length))
    made.per_quantum_f, made.per_quantum_t = 1 / made.quantum_f, 1 / made.quantum_t
    return made


def largest_force(scene: Scene, numerics: Numerics) -> float:
    """Force [N] of a contact at an overlap of DEEP d: between grains, or with walls where these are of another
    stiffness."""
    grains, law = scene.grains, LAWS[scene.contact.law]
    r, mass, deep = grains.radius, grains.mass, DEEP * grains.diameter
    found = [law.normal(c, r / 2, mass / 2, deep, 0.0) for c in features.pair_table(scene, numerics)]
    for wall in scene.container.walls() if scene.has_own_stiffness else ():
        for kind in range(len(grains.species)):
            if (own := scene.law(wall, kind)) != scene.law_between(kind, kind):
                c = law.coefficients(own, scene.surface(wall, kind), numerics.stiffness_scale, True)
                found.append(law.normal(c, r, mass, deep, 0.0))
    return max(found)


def _quantum(most: float) -> float:
    """The power of two of which about 2^48 make `most`."""
    return math.ldexp(1.0, math.frexp(most)[1] - 48)


def place(module: ModuleType, scene: Scene, numerics: Numerics, probes: Sequence[Probe], lattice: Sequence[int]) -> Any:
    """The record of outlet, cells and walls. lattice: cells along x, y, z; see there."""
    made = module.Place()
    made.plane, made.drop = features.planes(scene, probes)
    made.cell = cell_size(scene, numerics)
    made.gx, made.gy, made.gz = lattice
    made.walls = len(scene.container.walls())
    return made


def same_material(runs: Iterable[tuple[Scene, Numerics]]) -> bool:
    """Whether all of these have the same grains, law, gravity, clock and quanta."""
    different = {(id(s), id(n)): (s, n) for s, n in runs}.values()  # replicates have a scene in common
    kinds = {
        (s.grains.model_copy(update={"count": 1}), s.contact, s.gravity, n, largest_force(s, n)) for s, n in different
    }
    return len(kinds) == 1


def farthest(scene: Scene, numerics: Numerics) -> float:
    """Distance [m] of their centres up to which grains may be listed as neighbours."""
    return scene.grains.diameter * (1 + numerics.skin) + 2 * scene.grains.half_length


def cell_size(scene: Scene, numerics: Numerics) -> float:
    """Edge of a cell [m]."""
    return farthest(scene, numerics) / SHAPES[scene.grains.shape].reach


def most_cells(grains: int) -> int:
    """Cells that a lattice has at most."""
    return 4 * grains + 64


def lattice(x: np.ndarray, cell: float, reach: int) -> tuple[int, ...]:
    """Cells along each axis that grains at x [n, 3] spread over, at most `most_cells` in all: 1, or enough for those up
    to `reach` away to be different ones."""
    least = 2 * reach + 1
    extent = np.ptp(x, axis=0) if len(x) else np.zeros(3)
    # grains that lie within one cell's thickness may straddle two; both wrap onto one
    wanted = np.where(extent < cell, 1, (np.ceil(extent / cell) + 2).clip(least, 1e6))
    most = most_cells(len(x))
    while wanted.prod() > most:
        k = int(np.argmax(wanted))
        if wanted[k] <= least:
            break
        wanted[k] = max(least, np.floor(wanted[k] * 0.8))
    return tuple(int(n) for n in wanted)
