"""The dimensionless groups that decide how numerics change a flow rate."""

import math
from dataclasses import dataclass

from labbook.filling.bed import PACKED, bed_height_ahead
from labbook.scene import Scene
from labbook.scene.timescales import collision


@dataclass(frozen=True)
class Groups:
    """What the flow rate of a scene depends on beside its stated physics, in numbers without unit.

    `overlap`: of two grains under the pressure of the bed, in d; `step`: the time step over the duration of a
    collision. The rest says which calibration holds: `shape` of the grains, `outlet` (slot or hole), `law` of contact,
    `friction`, `restitution`, `rolling` (friction), `ratio`, the orifice over d, `angle` of the bottom from the
    vertical [deg], `eccentricity` of the outlet, from 0 in the middle to 1 at a wall, `rotation` of the bottom,
    f sqrt(d/g), and `version` of the law.
    """

    overlap: float
    step: float
    shape: str
    outlet: str
    law: str
    friction: float
    restitution: float
    rolling: float
    ratio: float
    angle: float = 90.0
    eccentricity: float = 0.0
    rotation: float = 0.0
    version: int = 1


def has_groups(scene: Scene) -> bool:
    """Whether a scene can be calibrated."""
    return groups(scene, 1.0, 1.0) is not None


def groups(scene: Scene, dt: float, stiffness_scale: float) -> Groups | None:
    """The groups of a scene with its stiffness times `stiffness_scale`, stepped by dt [s]; None of one without an
    outlet or gravity, with grains or walls of several materials, or whose bed or law does not tell its pressure or
    overlap.

    The pressure is phi rho g h, with h the height of the bed, or the width of the container where that is less: below
    that depth walls carry the weight (Janssen 1895).
    """
    outlet, height = scene.container.outlet_form, bed_height_ahead(scene)
    across = scene.container.across
    if outlet is None or height is None or across is None or scene.gravity == 0:
        return None
    surfaces = scene.surfaces
    if scene.has_own_stiffness or scene.grains.varied or any(one != surfaces[0] for one in surfaces):
        return None
    soft = scene.stiffened(stiffness_scale)
    pressure = PACKED * scene.grains.mean_density * scene.gravity * min(height, across)
    overlap = soft.contact.overlap(pressure, scene.grains.diameter)
    if overlap is None:
        return None
    surface, container, d = surfaces[0], scene.container, scene.grains.diameter
    aside = getattr(container, "width", math.inf) - getattr(container, "orifice", 0.0)
    return Groups(
        overlap=overlap,
        step=dt / collision(soft),
        shape=scene.grains.shape,
        outlet=outlet,
        law=scene.contact.law,
        friction=surface.friction,
        restitution=surface.restitution,
        rolling=surface.rolling_friction,
        ratio=float(getattr(container, "orifice", 0.0)) / d,
        angle=round(math.degrees(getattr(container, "angle", math.pi / 2)), 6),
        eccentricity=2 * abs(getattr(container, "eccentricity", 0.0)) / aside if aside else 0.0,
        rotation=getattr(container, "rotation", 0.0) * math.sqrt(d / scene.gravity),
        version=scene.contact.version,
    )
