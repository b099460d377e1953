"""Parameters of kernels from a scene."""

from collections.abc import Sequence
from math import inf

import numpy as np
from labbook_dem import features
from labbook_dem.mesh_grid import MeshGrids, mesh_reach, shapes_of
from labbook_dem.rotation import flatness, slenderness

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Crossing, Probe
from labbook.scene import Clumps, Scene
from labbook_numba.state import Params


def parameters(scene: Scene, numerics: Numerics, probes: Sequence[Probe], wall_numbers: int) -> Params:
    """Arguments of the kernels for one member.

    Args:
        scene: scene.
        numerics: numerics.
        probes: probes of the run.
        wall_numbers: length of a row of a wall's numbers in the kernels.
    """
    grains = scene.grains
    d = grains.diameter
    plane, drop = features.planes(scene, probes)
    # at minus infinity, kernels that record crossings all the same find none
    plane = plane if any(isinstance(probe, Crossing) for probe in probes) else -inf
    pair_c = features.pair_table(scene, numerics)
    walls = features.wall_tables(scene, numerics)
    rolling_stiffness, rolling_damping = scene.contact.rolling_spring
    skin = numerics.skin * d
    moves = features.mesh_moves(scene, numerics)
    # rows of clumps are spheres, which touch walls by themselves
    spheres = [sphere.centre for sphere in grains.spheres] if isinstance(grains, Clumps) else []
    half = 0.0 if spheres else grains.overhang
    shapes, reach = shapes_of(scene.container.walls()), mesh_reach(grains.radius + half, moves)
    meshes = MeshGrids.of(shapes, [reach] * len(shapes), features.has_rods(scene))
    spare = wall_numbers - walls.numbers.shape[1]
    return Params(
        c=tuple(pair_c[0].tolist()),
        pair_c=pair_c,
        radius=grains.radius,
        half=half,
        slender=slenderness(grains),
        flat=flatness(grains),
        spheres=np.array(spheres, float).reshape(-1, 3),
        mass=grains.mass,
        inertia=grains.inertia,
        gravity=scene.gravity,
        dt=numerics.dt,
        skin=skin,
        speed_limit=numerics.speed_limit,
        overlap_limit=numerics.overlap_limit * scene.grains.finest,
        plane=plane,
        drop=drop,
        wall_c=walls.c,
        walls=np.pad(walls.numbers, ((0, 0), (0, spare))),
        wall_kind=walls.kind,
        wall_motion=walls.motion,
        rolling_stiffness=rolling_stiffness,
        rolling_damping=rolling_damping,
        mesh_features=meshes.features,
        mesh_conditions=meshes.conditions,
        mesh_frame=meshes.frame,
        mesh_cell=meshes.first,
        mesh_listed=meshes.listed,
        mesh_moves=moves,
        part_speed=features.part_speed(scene, reach),
        period=features.period(scene),
    )
