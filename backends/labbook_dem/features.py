"""Features that a scene needs, which backends compile in, and the tables of coefficients and walls of kernels."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from labbook.backend import Capabilities, Spec, Unsupported
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Crossing, Dissipation, Film, Ledger, Probe, Sample, Traction, Zone
from labbook.scene import ContactLaw, Grains, Scene, Spherocylinders, Surface, TriangleMesh
from labbook.scene.model import once
from labbook.scene.walls import AT_REST
from labbook_dem.coefficients import COEFFICIENTS
from labbook_dem.dispatch import numbers
from labbook_dem.laws import LAWS
from labbook_dem.shapes import SHAPES
from labbook_dem.walls import MESH, WALLS, number

SWITCHES = (
    "FRICTION",
    "ROLLING",
    "ROLLING_SPRING",
    "VARIED",
    "KINDS",
    "TWIST",
    "MOVING",
    "ORIENTED",
    "OUTLET",
    "CROSSING",
    "LEDGER",
    "ANY_WALLS",
    "MESHES",
    "POSES",
    "PERIODIC",
)
"""Features that are constants of a generated module."""
FALL = 2.0  # grain lengths below outlet or sink at which a grain is dropped: it touches none that is still counted


class Needs(NamedTuple):
    """Parts of a scene that decide its features: all but sizes and positions, so that many scenes have equal ones."""

    grains: Grains
    contact: ContactLaw
    surfaces: tuple[Surface, ...]
    walls: frozenset[str]
    """Kinds of walls."""
    moving: bool
    poses: bool
    """True if parts move as a whole."""
    outlet: bool
    periodic: bool

    @classmethod
    def of(cls, scene: Scene) -> "Needs":
        """Return the needs of `scene`."""
        walls = scene.container.walls()
        kinds = frozenset([wall.shape.kind for wall in walls])
        poses = any([wall.is_posed for wall in walls])
        moving = poses or any([wall.motion is not AT_REST and wall.motion != AT_REST for wall in walls])
        outlet, periodic = scene.outlet is not None, math.isfinite(scene.container.period)
        return cls(scene.grains, scene.contact, scene.surfaces, kinds, moving, poses, outlet, periodic)


def features(scene: Scene, numerics: Numerics, probes: Sequence[Probe]) -> dict[str, object]:
    """Features by name: law, precision, shape of grains, kinds of walls; in capitals the switches, and the number of
    species."""
    return _features(Needs.of(scene), numerics.precision, probes)


def _features(needs: Needs, precision: str, probes: Sequence[Probe]) -> dict[str, object]:
    grains, contact, surfaces = needs.grains, needs.contact, needs.surfaces
    rolling, springs = any(s.rolling_friction for s in surfaces), _rolling_springs(contact, surfaces)
    return {
        "law": contact.law,
        "precision": precision,
        "shape": grains.shape,
        "walls": tuple(kind for kind in WALLS if kind in needs.walls),
        "FRICTION": rolling or any(s.friction for s in surfaces),
        "ROLLING": rolling and not springs,
        "ROLLING_SPRING": springs,
        "VARIED": grains.varied,
        "KINDS": len(grains.species),
        "TWIST": rolling and contact.rolling == "full",
        "MOVING": needs.moving,
        "ORIENTED": SHAPES[grains.shape].oriented,
        "ANY_WALLS": bool(needs.walls),
        "MESHES": MESH in needs.walls,
        "POSES": needs.poses,
        "OUTLET": needs.outlet,
        "PERIODIC": needs.periodic,
        "CROSSING": any(isinstance(probe, Crossing) for probe in probes),
        "LEDGER": any(isinstance(probe, Ledger) for probe in probes),
    }


ALWAYS = ("FRICTION", "ROLLING", "MOVING", "ANY_WALLS", "OUTLET", "CROSSING", "LEDGER", "PERIODIC")
"""Switches that may be on for a scene that does not need them: coefficients, velocities and lists are empty then, and
periodic sides ENDLESS apart."""
ENDLESS = 1e30
"""Distance [m] of periodic sides in kernels where there are none: beyond it no coordinate is brought."""


def constants(spec: Spec) -> dict[str, int]:
    """Switches of a generated module by name."""
    return {name: spec.feature(name) for name in SWITCHES}


def superset(needed: Mapping[str, object]) -> dict[str, object]:
    """Features with every switch on that changes no motion, so that scenes of one law and shape share a kernel.

    Resistance to twist stays off unless the scene has it: with rolling friction of zero it makes no difference. Rolling
    springs stay off, since they take memory. Parts move only if there are meshes.
    """
    springs = bool(needed["ROLLING_SPRING"])
    twist = bool(needed["TWIST"] or not (needed["ROLLING"] or springs))
    on = {"ROLLING": not springs, "TWIST": twist, "POSES": needed["MESHES"], "walls": tuple(WALLS)}
    return {**needed, **dict.fromkeys(ALWAYS, True), **on}


def covers(spec: Spec, needed: Spec) -> bool:
    """True if kernels of `spec` can move a member that needs `needed`.

    All that it needs is compiled in, and all other features of `spec` change no motion.
    """
    has, required = dict(spec.features), dict(needed.features)
    free = {*ALWAYS, "POSES"}
    if required["ROLLING_SPRING"]:
        free.remove("ROLLING")
    elif not required["ROLLING"]:
        free.add("TWIST")

    def fixed(features: Mapping[str, object]) -> dict[str, object]:
        return {name: value for name, value in features.items() if name not in free and name != "walls"}

    return (
        (spec.backend, spec.probes, spec.steps_per_beat) == (needed.backend, needed.probes, needed.steps_per_beat)
        and fixed(has) == fixed(required)
        and all(has[name] or not required[name] for name in free)
        and {*needed.feature("walls")} <= {*spec.feature("walls")}
    )


def rolling_springs(scene: Scene) -> bool:
    """True if rolling resistance acts by springs, which contacts store."""
    return _rolling_springs(scene.contact, scene.surfaces)


def _rolling_springs(contact: ContactLaw, surfaces: Sequence[Surface]) -> bool:
    return contact.rolling_model == "epsd" and any(s.rolling_friction for s in surfaces)


def period(scene: Scene) -> float:
    """Distance [m] of periodic sides along y; ENDLESS without them."""
    return min(scene.container.period, ENDLESS)


def has_meshes(scene: Scene) -> bool:
    """True if a wall consists of triangles."""
    return any(wall.shape.kind == MESH for wall in scene.container.walls())


def has_moving_parts(scene: Scene) -> bool:
    """True if a part of the container moves as a whole, or vanishes at a time."""
    return any(wall.is_posed for wall in scene.container.walls())


def part_speed(scene: Scene, reach: float) -> float:
    """Largest speed [m/s] of parts that move, out to a reach [m] from them."""
    speeds = [0.0]
    for wall in scene.container.walls():
        if wall.moves is not None and isinstance(wall.shape, TriangleMesh):
            speeds.append(wall.moves.speed(wall.shape.surface.vertices, reach))
    return max(speeds)


def mesh_moves(scene: Scene, numerics: Numerics) -> float:
    """Distance [m] by which a grain may move in the frame of a mesh before lists are built again: a grain moves by half
    a skin, and so does a part."""
    skin = numerics.skin * scene.grains.diameter
    return 1.0 * skin if has_moving_parts(scene) else 0.5 * skin


def pose_table(scene: Scene, first: int, last: int, dt: float) -> np.ndarray:
    """Poses of W walls at steps `first` to `last`, shape [steps, W, POSE_COLUMNS]; those that stand still as they were
    placed."""
    times = dt * np.arange(first, last + 1)
    poses = [wall.poses(times).table() for wall in scene.container.walls()]
    return np.ascontiguousarray(np.stack(poses, axis=1))


def is_oriented(scene: Scene) -> bool:
    """True if grains have an orientation."""
    return SHAPES[scene.grains.shape].oriented


def has_rods(scene: Scene) -> bool:
    """True if grains are rods: segments with an axis."""
    return isinstance(scene.grains, Spherocylinders)


def planes(scene: Scene, probes: Sequence[Probe]) -> tuple[float, float]:
    """Height z [m] of the plane whose crossings are recorded, and height below which grains are dropped.

    Without an outlet the latter is minus infinity: kernels that drop grains all the same find none.
    """
    crossed = [probe.plane for probe in probes if isinstance(probe, Crossing)]
    if scene.outlet is None:
        drop = -math.inf
    else:
        bottom = scene.outlet if scene.sink is None else scene.sink
        drop = min([bottom, *crossed]) - FALL * scene.grains.extent
    return (crossed[0] if crossed else 0.0), drop


def capabilities(
    name: str, cache_version: int, precisions: frozenset[str], devices: tuple[str, ...], meshes: bool = False,
    clumps: bool = False, **switches: bool,
):  # fmt: skip
    """Capabilities of a backend with the formulas of this package: all laws and walls, spheres and rods.

    meshes: walls of triangles too; clumps: clumps too; switches: further fields of `Capabilities`.
    """
    walls: list[str] = [*WALLS, *([MESH] if meshes else [])]
    laws, shapes = frozenset(LAWS), frozenset(name for name in SHAPES if clumps or name != "clump")
    return Capabilities(
        name, cache_version, shapes, laws, frozenset(walls), precisions, devices, feeds=True, breaks=True, **switches
    )


def specialise(
    can: Capabilities, scene: Scene, numerics: Numerics, probes: Sequence[Probe], wide: bool = False
) -> Spec:
    """Features that a backend with these capabilities compiles in; wide: their `superset`.

    Raises:
        Unsupported: the backend lacks a feature.
        BrokenPlugin: formulas of a law or a wall are incomplete.
    """
    return _specialised(can, Needs.of(scene), numerics.precision, numerics.steps_per_beat, tuple(probes), wide)


@once(256)
def _specialised(
    can: Capabilities, needs: Needs, precision: str, steps_per_beat: int, probes: tuple[Probe, ...], wide: bool
) -> Spec:
    check(can, needs, precision, probes)
    needed = _features(needs, precision, probes)
    return Spec(
        backend=can.name,
        features=tuple(sorted((superset(needed) if wide else needed).items())),
        probes=tuple(dict.fromkeys(probes)),
        steps_per_beat=steps_per_beat,
    )


def check(can: Capabilities, needs: Needs, precision: str, probes: Sequence[Probe]) -> None:
    """Raise Unsupported if a backend with these capabilities lacks a need, BrokenPlugin for incomplete formulas of a
    law or a wall."""
    requirements = [
        ("grains.shape", needs.grains.shape, can.shapes),
        ("contact.law", needs.contact.law, can.laws),
        ("numerics.precision", precision, can.precisions),
        *(("container", kind, can.walls) for kind in sorted(needs.walls)),
    ]
    for key, value, supported in requirements:
        if value not in supported:
            has = ", ".join(sorted(supported))
            state = f": state numerics: {{precision: {min(supported)}}}" if key == "numerics.precision" else ""
            if value == "clump":
                state = "; use --backend numba, or spherocylinder for long grains"
            raise Unsupported(key, f"the backend {can.name} has no {value}; it has {has}{state}")
    if MESH in needs.walls and SHAPES[needs.grains.shape].oriented and not can.rods_at_meshes:
        reason = f"the backend {can.name} has no contacts of rods with a mesh"
        raise Unsupported("container", f"{reason}; use --backend numba, spheres, or plates in place of the mesh")
    if needs.poses and not can.moving_parts:
        reason = f"the backend {can.name} has no parts that move"
        raise Unsupported("container.parts[].moves", f"{reason}; use --backend numba, or leave moves out")
    if needs.periodic and not can.periodic:
        reason = f"the backend {can.name} has no periodic sides"
        raise Unsupported("container.periodic", f"{reason}; use --backend numba, or leave periodic out")
    for formulas, names in ((LAWS, (needs.contact.law,)), (WALLS, needs.walls - {MESH})):
        for name in names:
            _ = formulas[name]  # raises BrokenPlugin if a definition is missing
    if sum(isinstance(probe, Crossing) for probe in probes) > 1:
        raise Unsupported("measure", f"the backend {can.name} records crossings of one plane at a time")
    if needs.grains.varied and not can.mixtures:
        raise Unsupported("grains", f"the backend {can.name} takes equal grains only; leave out sizes and kinds")
    for probe in probes:
        if isinstance(probe, Sample | Film) and "q" in probe.fields and not SHAPES[needs.grains.shape].oriented:
            raise Unsupported("measure", "spheres have no orientation q; leave q out")
        if not isinstance(probe, Crossing | Film) and probe.every < 1:
            raise Unsupported("measure", "a probe is read once per beat at most; use every >= 1")
        if isinstance(probe, Film) and not 0 < probe.every < math.inf:
            raise Unsupported("measure", "the time between two frames of a film must be positive and finite")
        if isinstance(probe, Dissipation) and not needs.grains.round:
            raise Unsupported("measure", "the power of contacts is measured of spheres only")
        if isinstance(probe, Traction) and not 0 < probe.size < math.inf:
            raise Unsupported("measure", "the width of bins of walls must be positive and finite")
        if isinstance(probe, Zone) and not 0 <= probe.again < probe.every:
            raise Unsupported("measure", "a zone must be read again before its next frame; use 0 <= again < every")


def pair_table(scene: Scene, numerics: Numerics) -> np.ndarray:
    """Coefficients of contacts between species a and b in row a K + b of K species, shape [K^2, 8]."""
    law, sorts = LAWS[scene.contact.law], range(len(scene.grains.species))
    scale = numerics.stiffness_scale
    rows = [law.coefficients(scene.law_between(a, b), scene.surface_between(a, b), scale) for a in sorts for b in sorts]
    return _table(rows, COEFFICIENTS)


class WallTables(NamedTuple):
    """Tables of W walls.

    Attributes:
        c: coefficients for species k of K in row w K + k, shape [W K, 8].
        numbers: numbers of each wall, padded, shape [W, n].
        kind: kinds as kernels number them, shape [W].
        motion: velocity [m/s] and spin [rad/s] of each surface, shape [W, 4].
    """

    c: np.ndarray
    numbers: np.ndarray
    kind: np.ndarray
    motion: np.ndarray


def wall_tables(scene: Scene, numerics: Numerics) -> WallTables:
    """Tables of the walls of a scene."""
    law, walls, sorts = LAWS[scene.contact.law], scene.container.walls(), range(len(scene.grains.species))
    scale = numerics.stiffness_scale
    shapes = [() if wall.shape.kind == MESH else numbers(wall.shape) for wall in walls]
    width = max(map(len, shapes), default=0)
    rows = [law.coefficients(scene.law(w, k), scene.surface(w, k), scale, True) for w in walls for k in sorts]
    return WallTables(
        _table(rows, COEFFICIENTS),
        _table([(*row, *[0.0] * (width - len(row))) for row in shapes], width),
        np.array([number(w.shape.kind) for w in walls], np.int64),
        _table([(*w.motion.velocity, w.motion.spin) for w in walls], 4),
    )


def _table(rows: list, width: int) -> np.ndarray:
    return np.array(rows, np.float64).reshape(len(rows), width)
