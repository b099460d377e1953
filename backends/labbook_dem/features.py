"""What a scene needs and what it does not: features that backends compile in, and the tables of walls they take."""

from collections.abc import Mapping, Sequence

import numpy as np

from labbook.backend import Capabilities, Spec, Unsupported
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Contacts, Crossing, Ledger, Probe, Sample, Slab, Zone
from labbook.scene import Scene, SurfaceMotion
from labbook_dem.laws import LAWS
from labbook_dem.walls import frustum, plane, strip

SWITCHES = (
    "FRICTION",
    "ROLLING",
    "VARIED",
    "KINDS",
    "TWIST",
    "MOVING",
    "PLANES",
    "STRIPS",
    "FRUSTUMS",
    "RODS",
    "OUTLET",
    "CROSSING",
    "LEDGER",
    "ANY_WALLS",
)
"""Features that are constants of a generated module."""
WALL_KINDS = {
    "plane": (0, plane.parameters),
    "strip": (1, strip.parameters),
    "frustum": (2, frustum.parameters),
}
WALL_PARTS = {"plane": 2, "strip": 4, "frustum": 4}
"""Points, its parts, at which a rod may touch one wall (`labbook_dem.rods`)."""
FALL = 2.0  # lengths below the outlet at which a grain is dropped: nothing that is still to be counted touches it


def features(scene: Scene, numerics: Numerics, probes: Sequence[Probe]) -> dict[str, object]:
    """Features by name: the law, the precision, and in capitals switches and the number of kinds of grains."""
    walls, sorts = scene.container.walls(), range(len(scene.grains.species))
    surfaces = [scene.surface_between(a, b) for a in sorts for b in sorts]
    surfaces += [scene.surface(wall, sort) for wall in walls for sort in sorts]
    kinds = {wall.shape.kind for wall in walls}
    rolling = any(s.rolling_friction for s in surfaces)
    return {
        "law": scene.contact.law,
        "precision": numerics.precision,
        "FRICTION": rolling or any(s.friction for s in surfaces),
        "ROLLING": rolling,
        "VARIED": scene.grains.varied,
        "KINDS": len(scene.grains.species),
        "TWIST": rolling and scene.contact.rolling == "full",
        "MOVING": any(wall.motion != SurfaceMotion() for wall in walls),
        "PLANES": "plane" in kinds,
        "STRIPS": "strip" in kinds,
        "FRUSTUMS": "frustum" in kinds,
        "RODS": is_rod(scene),
        "ANY_WALLS": bool(walls),
        "OUTLET": outlet(scene) is not None,
        "CROSSING": any(isinstance(probe, Crossing) for probe in probes),
        "LEDGER": any(isinstance(probe, Ledger) for probe in probes),
    }


ALWAYS = ("FRICTION", "ROLLING", "MOVING", "PLANES", "STRIPS", "FRUSTUMS", "ANY_WALLS", "OUTLET", "CROSSING", "LEDGER")
"""Switches that may be on for a scene that needs nothing of them: coefficients, velocities and lists are empty then."""


def switches(spec: Spec) -> tuple[tuple[str, int], ...]:
    """The constants of a generated module that this Spec needs, by name."""
    return tuple((name, spec.feature(name)) for name in SWITCHES)


def superset(found: Mapping[str, object]) -> dict[str, object]:
    """Features with every switch on that changes no motion, so that scenes of one law and shape share a kernel.

    Twist is resisted only where the scene has it so: with rolling friction of zero it makes no difference.
    """
    return {**found, **dict.fromkeys(ALWAYS, True), "TWIST": bool(found["TWIST"] or not found["ROLLING"])}


def finest(scene: Scene) -> float:
    """Diameter [m] of the smallest grains, by which overlaps are judged."""
    return min(grains.diameter for grains in scene.grains.smallest())


def is_rod(scene: Scene) -> bool:
    """Whether grains have an orientation."""
    return scene.grains.shape == "spherocylinder"


def outlet(scene: Scene) -> float | None:
    """z [m] of the plane that grains leave through, or None if the container is closed or has none."""
    return None if getattr(scene.container, "closed", False) else scene.container.outlet_plane


def planes(scene: Scene, probes: Sequence[Probe]) -> tuple[float, float]:
    """z [m] of the plane whose crossings are recorded, and z below which grains are dropped."""
    crossed = [probe.plane for probe in probes if isinstance(probe, Crossing)]
    bottom, size = outlet(scene), scene.grains.diameter + 2 * scene.grains.half_length
    drop = 0.0 if bottom is None else min([bottom, *crossed]) - FALL * size
    return (crossed[0] if crossed else 0.0), drop


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
        if isinstance(probe, Sample) and "q" in probe.fields and not is_rod(scene):
            raise Unsupported("measure", "only rods have an orientation q")
        if isinstance(probe, Sample | Slab | Zone | Contacts | Ledger) and probe.every < 1:
            raise Unsupported("measure", "a probe is read every beat at most")
        if isinstance(probe, Zone) and not 0 <= probe.again < probe.every:
            raise Unsupported("measure", "a zone is read again before its next frame is due")


def pair_table(scene: Scene, numerics: Numerics) -> np.ndarray:
    """Coefficients of contacts between kinds a and b in row a K + b of K kinds, shape [K^2, 8]."""
    law, sorts = LAWS[scene.contact.law], range(len(scene.grains.species))
    scale = numerics.stiffness_scale
    rows = [law.coefficients(scene.contact, scene.surface_between(a, b), scale) for a in sorts for b in sorts]
    return _table(rows, 8)


def wall_tables(scene: Scene, numerics: Numerics) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of each wall: coefficients for kind k of K in row w K + k [W K, 8], shape [W, 6], kind [W], velocity and spin of
    its surface [W, 4]."""
    law, walls, sorts = LAWS[scene.contact.law], scene.container.walls(), range(len(scene.grains.species))
    scale = numerics.stiffness_scale
    shapes = [(*WALL_KINDS[w.shape.kind][1](w.shape), 0.0)[:6] for w in walls]  # pyright: ignore[reportArgumentType]
    return (
        _table([law.coefficients(scene.contact, scene.surface(w, k), scale, True) for w in walls for k in sorts], 8),
        _table(shapes, 6),
        np.array([WALL_KINDS[w.shape.kind][0] for w in walls], np.int64),
        _table([(*w.motion.velocity, w.motion.spin) for w in walls], 4),
    )


def _table(rows: list, width: int) -> np.ndarray:
    return np.array(rows, np.float64).reshape(len(rows), width)
