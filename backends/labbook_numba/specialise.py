"""From a scene to the features that it needs, and to the numbers that its kernels take as arguments."""

from collections.abc import Sequence

import numpy as np
from labbook_dem.walls import plane, strip

from labbook.backend import Capabilities, Contacts, Crossing, Ledger, Probe, Sample, Spec, Unsupported
from labbook.numerics import Numerics
from labbook.scene import Scene, SurfaceMotion
from labbook_numba.build import LAWS
from labbook_numba.state import Params

WALL_KINDS = {"plane": (0, plane.parameters), "strip": (1, strip.parameters)}
FALL = 2.0  # diameters below the outlet at which a grain is dropped: nothing that is still to be counted touches it


def specialise(capabilities: Capabilities, scene: Scene, numerics: Numerics, probes: Sequence[Probe]) -> Spec:
    """Features compiled in for this scene. Raises Unsupported."""
    _check(capabilities, scene, numerics, probes)
    walls = scene.container.walls()
    surfaces = [scene.surface(wall) for wall in walls]
    kinds = {wall.shape.kind for wall in walls}
    frictions = [scene.contact.friction, *(s.friction or 0.0 for s in surfaces)]
    rolling = any([scene.contact.rolling_friction, *(s.rolling_friction or 0.0 for s in surfaces)])
    features = {
        "law": scene.contact.law,
        "precision": numerics.precision,
        "FRICTION": any(frictions) or rolling,
        "ROLLING": rolling,
        "TWIST": rolling and scene.contact.rolling == "full",
        "MOVING": any(wall.motion != SurfaceMotion() for wall in walls),
        "PLANES": "plane" in kinds,
        "STRIPS": "strip" in kinds,
        "ANY_WALLS": bool(walls),
        "OUTLET": outlet(scene) is not None,
        "CROSSING": any(isinstance(probe, Crossing) for probe in probes),
        "LEDGER": any(isinstance(probe, Ledger) for probe in probes),
    }
    return Spec(
        engine=capabilities.name,
        features=tuple(sorted(features.items())),
        probes=tuple(dict.fromkeys(probes)),
        steps_per_beat=numerics.steps_per_beat,
    )


def outlet(scene: Scene) -> float | None:
    """z [m] of the plane that grains leave through, or None if the container is closed or has none."""
    return None if getattr(scene.container, "closed", False) else scene.container.outlet_plane


def _check(can: Capabilities, scene: Scene, numerics: Numerics, probes: Sequence[Probe]) -> None:
    wanted = [
        ("grains.shape", scene.grains.shape, can.shapes),
        ("contact.law", scene.contact.law, can.laws),
        ("numerics.precision", numerics.precision, can.precisions),
        *(("container", wall.shape.kind, can.walls) for wall in scene.container.walls()),
    ]
    for key, value, known in wanted:
        if value not in known:
            raise Unsupported(key, f"the engine {can.name} has no {value}; it has {', '.join(sorted(known))}")
    if sum(isinstance(probe, Crossing) for probe in probes) > 1:
        raise Unsupported("measure", f"the engine {can.name} records crossings of one plane at a time")
    for probe in probes:
        if isinstance(probe, Sample | Contacts | Ledger) and probe.every < 1:
            raise Unsupported("measure", "a probe is read every beat at most")


def parameters(scene: Scene, numerics: Numerics, probes: Sequence[Probe]) -> Params:
    """Arguments of the kernels for one member."""
    grains, walls = scene.grains, scene.container.walls()
    law = LAWS[scene.contact.law]
    scale = numerics.stiffness_scale
    own = scene.surface_of_grains
    shapes = [(*WALL_KINDS[w.shape.kind][1](w.shape), 0.0)[:6] for w in walls]  # pyright: ignore[reportArgumentType]
    planes = [probe.plane for probe in probes if isinstance(probe, Crossing)]
    bottom = outlet(scene)
    d = grains.diameter
    return Params(
        c=law.coefficients(scene.contact, own, scale),
        radius=grains.radius,
        mass=grains.mass,
        inertia=grains.inertia,
        gravity=scene.gravity,
        dt=numerics.dt,
        skin=numerics.skin * d,
        speed_limit=numerics.speed_limit,
        overlap_limit=numerics.overlap_limit * d,
        plane=planes[0] if planes else 0.0,
        drop=0.0 if bottom is None else min([bottom, *planes]) - FALL * d,
        wall_c=_table([law.coefficients(scene.contact, scene.surface(w), scale) for w in walls], 8),
        wall_shape=_table(shapes, 6),
        wall_kind=np.array([WALL_KINDS[w.shape.kind][0] for w in walls], np.int64),
        wall_motion=_table([(*w.motion.velocity, w.motion.spin) for w in walls], 4),
    )


def _table(rows: list, width: int) -> np.ndarray:
    return np.array(rows, np.float64).reshape(len(rows), width)
