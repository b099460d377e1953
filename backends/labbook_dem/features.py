"""What a scene needs and what it does not: features that backends compile in, and the tables of walls they take."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from labbook.backend import Capabilities, Spec, Unsupported
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Contacts, Crossing, Ledger, Probe, Sample, Slab, Zone
from labbook.scene import Scene, SurfaceMotion
from labbook_dem.dispatch import numbers
from labbook_dem.laws import LAWS
from labbook_dem.shapes import SHAPES
from labbook_dem.walls import WALLS, number

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
)
"""Features that are constants of a generated module."""
FALL = 2.0  # lengths below the outlet at which a grain is dropped: nothing that is still to be counted touches it


def features(scene: Scene, numerics: Numerics, probes: Sequence[Probe]) -> dict[str, object]:
    """Features by name: the law, the precision, the shape of grains, kinds of walls; in capitals switches, and the
    number of kinds of grains."""
    walls, surfaces = scene.container.walls(), scene.surfaces
    kinds = {wall.shape.kind for wall in walls}
    rolling, springs = any(s.rolling_friction for s in surfaces), rolling_springs(scene)
    return {
        "law": scene.contact.law,
        "precision": numerics.precision,
        "shape": scene.grains.shape,
        "walls": tuple(kind for kind in WALLS if kind in kinds),
        "FRICTION": rolling or any(s.friction for s in surfaces),
        "ROLLING": rolling and not springs,
        "ROLLING_SPRING": springs,
        "VARIED": scene.grains.varied,
        "KINDS": len(scene.grains.species),
        "TWIST": rolling and scene.contact.rolling == "full",
        "MOVING": any(wall.motion != SurfaceMotion() for wall in walls),
        "ORIENTED": is_oriented(scene),
        "ANY_WALLS": bool(walls),
        "OUTLET": outlet(scene) is not None,
        "CROSSING": any(isinstance(probe, Crossing) for probe in probes),
        "LEDGER": any(isinstance(probe, Ledger) for probe in probes),
    }


ALWAYS = ("FRICTION", "ROLLING", "MOVING", "ANY_WALLS", "OUTLET", "CROSSING", "LEDGER")
"""Switches that may be on for a scene that needs nothing of them: coefficients, velocities and lists are empty then."""


def constants(spec: Spec) -> dict[str, int]:
    """The switches of a generated module, by name."""
    return {name: spec.feature(name) for name in SWITCHES}


def superset(found: Mapping[str, object]) -> dict[str, object]:
    """Features with every switch on that changes no motion, so that scenes of one law and shape share a kernel.

    Twist is resisted only where the scene has it so: with rolling friction of zero it makes no difference. Rolling
    resistance has springs only where the scene has them: they take memory.
    """
    springs = bool(found["ROLLING_SPRING"])
    twist = bool(found["TWIST"] or not (found["ROLLING"] or springs))
    return {**found, **dict.fromkeys(ALWAYS, True), "ROLLING": not springs, "walls": tuple(WALLS), "TWIST": twist}


def covers(spec: Spec, needed: Spec) -> bool:
    """Whether kernels of `spec` can move a member that needs no more than `needed`: all that it needs is compiled in,
    and what is beside that changes no motion."""
    has, wanted = dict(spec.features), dict(needed.features)
    free = {*ALWAYS}
    if wanted["ROLLING_SPRING"]:
        free.remove("ROLLING")
    elif not wanted["ROLLING"]:
        free.add("TWIST")

    def fixed(features: Mapping[str, object]) -> dict[str, object]:
        return {name: value for name, value in features.items() if name not in free and name != "walls"}

    return (
        (spec.backend, spec.probes, spec.steps_per_beat) == (needed.backend, needed.probes, needed.steps_per_beat)
        and fixed(has) == fixed(wanted)
        and all(has[name] or not wanted[name] for name in free)
        and {*needed.feature("walls")} <= {*spec.feature("walls")}
    )


def rolling_springs(scene: Scene) -> bool:
    """Whether rolling resistance acts by springs, which contacts then keep."""
    return scene.contact.rolling_model == "epsd" and any(s.rolling_friction for s in scene.surfaces)


def finest(scene: Scene) -> float:
    """Diameter [m] of the smallest grains, by which overlaps are judged."""
    return min(grains.diameter for grains in scene.grains.smallest())


def is_oriented(scene: Scene) -> bool:
    """Whether grains have an orientation."""
    return SHAPES[scene.grains.shape].oriented


def outlet(scene: Scene) -> float | None:
    """z [m] of the plane that grains leave through, or None if the container is closed or has none."""
    return None if getattr(scene.container, "closed", False) else scene.container.outlet_plane


def planes(scene: Scene, probes: Sequence[Probe]) -> tuple[float, float]:
    """z [m] of the plane whose crossings are recorded, and z below which grains are dropped."""
    crossed = [probe.plane for probe in probes if isinstance(probe, Crossing)]
    bottom, size = outlet(scene), scene.grains.diameter + 2 * scene.grains.half_length
    drop = 0.0 if bottom is None else min([bottom, *crossed]) - FALL * size
    return (crossed[0] if crossed else 0.0), drop


def capabilities(name: str, cache_version: int, precisions: frozenset[str], devices: tuple[str, ...], **more: bool):
    """What a backend can do that computes with the formulas of this package: all laws, shapes and walls there are."""
    laws, shapes, walls = frozenset(LAWS), frozenset(SHAPES), frozenset(WALLS)
    return Capabilities(name, cache_version, shapes, laws, walls, precisions, devices, feeds=True, **more)


def specialise(
    can: Capabilities, scene: Scene, numerics: Numerics, probes: Sequence[Probe], wide: bool = False
) -> Spec:
    """What a backend with these capabilities compiles in; `wide`: the `superset` of it. Raises Unsupported."""
    check(can, scene, numerics, probes)
    found = features(scene, numerics, probes)
    return Spec(
        backend=can.name,
        features=tuple(sorted((superset(found) if wide else found).items())),
        probes=tuple(dict.fromkeys(probes)),
        steps_per_beat=numerics.steps_per_beat,
    )


def check(can: Capabilities, scene: Scene, numerics: Numerics, probes: Sequence[Probe]) -> None:
    """Raises Unsupported if a backend with these capabilities cannot do it."""
    wanted = [
        ("grains.shape", scene.grains.shape, can.shapes),
        ("contact.law", scene.contact.law, can.laws),
        ("numerics.precision", numerics.precision, can.precisions),
        *(("container", wall.shape.kind, can.walls) for wall in scene.container.walls()),
    ]
    for key, value, known in wanted:
        if value not in known:
            raise Unsupported(key, f"the backend {can.name} has no {value}; it has {', '.join(sorted(known))}")
    if sum(isinstance(probe, Crossing) for probe in probes) > 1:
        raise Unsupported("measure", f"the backend {can.name} records crossings of one plane at a time")
    if scene.grains.varied and not can.mixtures:
        raise Unsupported("grains", f"the backend {can.name} takes equal grains only; leave out sizes and kinds")
    for probe in probes:
        if isinstance(probe, Sample) and "q" in probe.fields and not is_oriented(scene):
            raise Unsupported("measure", "only rods have an orientation q; leave q out")
        if isinstance(probe, Sample | Slab | Zone | Contacts | Ledger) and probe.every < 1:
            raise Unsupported("measure", "a probe is read once per beat at most; use every >= 1")
        if isinstance(probe, Zone) and not 0 <= probe.again < probe.every:
            raise Unsupported("measure", "a zone must be read again before its next frame; use 0 <= again < every")


def pair_table(scene: Scene, numerics: Numerics) -> np.ndarray:
    """Coefficients of contacts between kinds a and b in row a K + b of K kinds, shape [K^2, 8]."""
    law, sorts = LAWS[scene.contact.law], range(len(scene.grains.species))
    scale = numerics.stiffness_scale
    rows = [law.coefficients(scene.law_between(a, b), scene.surface_between(a, b), scale) for a in sorts for b in sorts]
    return _table(rows, 8)


class WallTables(NamedTuple):
    """Of each of W walls: coefficients for kind k of K grains in row w K + k [W K, 8]; the numbers that describe it, as
    many as the longest has [W, n]; its kind, as kernels know it [W]; velocity and spin of its surface [W, 4]."""

    c: np.ndarray
    numbers: np.ndarray
    kind: np.ndarray
    motion: np.ndarray


def wall_tables(scene: Scene, numerics: Numerics) -> WallTables:
    """What kernels know of the walls of a scene."""
    law, walls, sorts = LAWS[scene.contact.law], scene.container.walls(), range(len(scene.grains.species))
    scale = numerics.stiffness_scale
    shapes = [numbers(wall.shape) for wall in walls]
    width = max(map(len, shapes), default=0)
    return WallTables(
        _table([law.coefficients(scene.law(w, k), scene.surface(w, k), scale, True) for w in walls for k in sorts], 8),
        _table([(*row, *[0.0] * (width - len(row))) for row in shapes], width),
        np.array([number(w.shape.kind) for w in walls], np.int64),
        _table([(*w.motion.velocity, w.motion.spin) for w in walls], 4),
    )


def _table(rows: list, width: int) -> np.ndarray:
    return np.array(rows, np.float64).reshape(len(rows), width)
