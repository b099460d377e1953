"""Elastic normal forces of a bed from the places of its grains alone, by the contact law of its scene.

Dashpots and friction need velocities and springs, which a recording does not have.
"""

import numpy as np
from scipy.spatial import KDTree

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Contacts, Table, columns
from labbook.scene import Bodies, Clumps, Packing, Scene, Spherocylinders
from labbook.scene.orientation import axes, nearest, rotated
from labbook_dem.chosen import choose
from labbook_dem.plain_walls import PlainGrains, PlainWalls
from labbook_dem.spheres import effective


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
    bodies, grains, ids = Bodies.of(scene.grains, packing), scene.grains, packing.ids
    assert ids is not None
    if len(packing) < 2:
        return np.empty((0, 9))
    close = KDTree(packing.x).query_pairs(2 * (float(bodies.radius.max()) + grains.overhang), output_type="ndarray")
    # Sorted: the tree gives pairs in an order of its own, and rows of a file must not depend on it.
    i, j = close[np.lexsort((close[:, 1], close[:, 0]))].T
    away = between = packing.x[i] - packing.x[j]
    own, partner = bodies.radius[i], bodies.radius[j]
    if isinstance(grains, Spherocylinders) and packing.q is not None:
        a = axes(packing.q)
        s, t = nearest(between, a[i], a[j], grains.half_length)
        away = between + s[:, None] * a[i] - t[:, None] * a[j]
    elif isinstance(grains, Clumps) and packing.q is not None:
        levers = np.stack([rotated(packing.q, sphere.centre) for sphere in grains.spheres])
        radii, n = np.array([sphere.radius for sphere in grains.spheres]), len(grains.spheres)
        first, second = np.divmod(np.arange(n * n), n)
        away = (between + levers[first][:, i] - levers[second][:, j]).reshape(-1, 3)
        own, partner = (np.repeat(radii[indices], len(i)) for indices in (first, second))
        i, j, between = np.tile(i, n * n), np.tile(j, n * n), np.tile(between, (n * n, 1))
    apart = np.linalg.norm(away, axis=1)
    overlap = own + partner - apart
    # Two grains at one place have no direction of their force.
    touching = (overlap > 0) & (apart > 0)
    i, j, away, between, apart, overlap, own, partner = (
        of[touching] for of in (i, j, away, between, apart, overlap, own, partner)
    )
    with choose(scene.contact.law) as law:
        kinds, scale = range(len(scene.grains.species)), numerics.stiffness_scale
        c = {
            (m, n): law.coefficients(scene.law_between(m, n), scene.surface_between(m, n), scale)
            for m in kinds
            for n in kinds
        }
        pairs = zip(bodies.kind[i].tolist(), bodies.kind[j].tolist(), strict=True)
        radius = map(effective, own.tolist(), partner.tolist())
        mass = map(effective, bodies.mass[i].tolist(), bodies.mass[j].tolist())
        size = [  # laws are written for single contacts; all else is arrays
            law.normal(c[pair], *rest, 0.0) for pair, *rest in zip(pairs, radius, mass, overlap.tolist(), strict=True)
        ]
    force = (np.array(size) / apart)[:, None] * away
    return np.column_stack([ids[i], ids[j], np.full(len(i), -1), force, -between])


def _walls(scene: Scene, numerics: Numerics, packing: Packing, time: float):
    """Rows of contacts with walls."""
    plain, ids, zero = PlainWalls(scene, numerics), packing.ids, np.zeros_like(packing.x)
    assert ids is not None
    plain.move_to(round(time / numerics.dt))
    grains = PlainGrains.steady(scene.grains, packing, packing.q, zero, zero)
    reach = grains.bodies.radius + scene.grains.overhang
    with choose(scene.contact.law) as law:
        for w, wall in enumerate(plain.walls):
            x = packing.x
            if wall.is_posed:
                pose = wall.poses(np.array([time]))
                x = (x - pose.shift[0]) @ pose.turn[0]
            # Contacts in plain Python are slow: only grains near the wall are looked at, by the distance of all at
            # once.
            for i in np.flatnonzero(wall.shape.distance(x) < reach).tolist():
                grain = grains.state(i)
                for contact in plain.contacts(w, grain, {}, {}):
                    c = plain.coefficients(w, grain.kind)
                    size = law.normal(c, contact.radius, grain.mass, contact.overlap, 0.0)
                    force = contact.normal * size
                    yield (
                        ids[i],
                        -1,
                        w,
                        *(force.x, force.y, force.z),
                        *(contact.branch.x, contact.branch.y, contact.branch.z),
                    )
