"""Elastic normal forces of a bed from the places of its grains alone, by the contact law of its scene.

Dashpots and friction need velocities and springs, which a recording does not have.
"""

import numpy as np
from scipy.spatial import KDTree

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Contacts, Table, columns
from labbook.scene import Bodies, Packing, Scene
from labbook.scene.orientation import axes, nearest
from labbook_dem.chosen import choose
from labbook_dem.features import is_oriented
from labbook_dem.plain_walls import GrainState, PlainWalls
from labbook_dem.spheres import effective
from labbook_dem.words import vec3

_AT_REST = vec3(0.0, 0.0, 0.0)


def elastic_forces(
    scene: Scene, numerics: Numerics, packing: Packing, time: float = 0.0, *, walls: bool = True
) -> Table:  # fmt: skip
    """Elastic normal forces of all contacts of a packing.

    Args:
        scene: What is simulated.
        numerics: Its numerics, of which the scale of the stiffness counts.
        packing: The bed; velocities and springs do not count.
        time: Time since the opening [s], at which parts that move are where they are then.
        walls: Contacts with walls too, which take some 75 us each.

    Returns:
        Rows of the probe `Contacts`, with step 0.
    """
    assert packing.ids is not None
    names = ("i", "j", "wall", "fx", "fy", "fz", "bx", "by", "bz")
    rows = [_pairs(scene, numerics, packing)]
    if walls:
        rows.append(np.array([*_walls(scene, numerics, packing, time)], float).reshape(-1, len(names)))
    table = np.concatenate(rows).T
    n, kinds = table.shape[1], columns(Contacts())
    frame = {"member": np.zeros(n, np.int64), "step": np.zeros(n, np.int64), "time": np.full(n, time)}
    return {**frame, **{name: column.astype(kinds[name]) for name, column in zip(names, table, strict=True)}}


def _pairs(scene: Scene, numerics: Numerics, packing: Packing) -> np.ndarray:
    """Rows of contacts between grains, shape [n, 9]: ids and wall, force [N], branch [m]."""
    bodies, half, ids = Bodies.of(scene.grains, packing), scene.grains.half_length, packing.ids
    assert ids is not None
    if len(packing) < 2:
        return np.empty((0, 9))
    close = KDTree(packing.x).query_pairs(2 * (float(bodies.radius.max()) + half), output_type="ndarray")
    # Sorted: the tree gives pairs in an order of its own, and rows of a file must not depend on it.
    i, j = close[np.lexsort((close[:, 1], close[:, 0]))].T
    away = between = packing.x[i] - packing.x[j]
    if is_oriented(scene) and packing.q is not None:
        a = axes(packing.q)
        s, t = nearest(between, a[i], a[j], half)
        away = between + s[:, None] * a[i] - t[:, None] * a[j]
    apart = np.linalg.norm(away, axis=1)
    overlap = bodies.radius[i] + bodies.radius[j] - apart
    # Two grains at one place have no direction of their force.
    touching = (overlap > 0) & (apart > 0)
    i, j, away, between, apart, overlap = (of[touching] for of in (i, j, away, between, apart, overlap))
    with choose(scene.contact.law) as law:
        kinds, scale = range(len(scene.grains.species)), numerics.stiffness_scale
        c = {
            (m, n): law.coefficients(scene.law_between(m, n), scene.surface_between(m, n), scale)
            for m in kinds
            for n in kinds
        }
        pairs = zip(bodies.kind[i].tolist(), bodies.kind[j].tolist(), strict=True)
        radius, mass = (
            map(effective, of[i].tolist(), of[j].tolist()) for of in (bodies.radius, bodies.mass)
        )  # fmt: skip
        size = [  # laws are written for single contacts; all else is arrays
            law.normal(c[pair], *rest, 0.0) for pair, *rest in zip(pairs, radius, mass, overlap.tolist(), strict=True)
        ]
    force = (np.array(size) / apart)[:, None] * away
    return np.column_stack([ids[i], ids[j], np.full(len(i), -1), force, -between])


def _walls(scene: Scene, numerics: Numerics, packing: Packing, time: float):
    """Rows of contacts with walls."""
    plain, bodies, ids = PlainWalls(scene, numerics), Bodies.of(scene.grains, packing), packing.ids
    assert ids is not None
    plain.move_to(round(time / numerics.dt))
    reach = bodies.radius + scene.grains.half_length
    axis = axes(packing.q) if plain.rods and packing.q is not None else np.zeros_like(packing.x)
    with choose(scene.contact.law) as law:
        for w, wall in enumerate(plain.walls):
            x = packing.x
            if wall.is_posed:
                pose = wall.poses(np.array([time]))
                x = (x - pose.shift[0]) @ pose.turn[0]
            # Contacts in plain Python are slow: only grains near the wall are looked at, by the distance of all at
            # once.
            for i in np.flatnonzero(wall.shape.distance(x) < reach).tolist():
                at, a = (vec3(*array[i].tolist()) for array in (packing.x, axis))
                own = float(bodies.radius[i]), float(bodies.mass[i]), 1.0, int(bodies.kind[i])
                grain = GrainState(int(ids[i]), at, a, _AT_REST, _AT_REST, _AT_REST, _AT_REST, *own)
                for contact in plain.contacts(w, grain, {}, {}):
                    size = law.normal(plain.coefficients(w, grain.kind), grain.radius, grain.mass, contact.overlap, 0.0)
                    force = contact.normal * size
                    yield (
                        ids[i],
                        -1,
                        w,
                        *(force.x, force.y, force.z),
                        *(contact.branch.x, contact.branch.y, contact.branch.z),
                    )
