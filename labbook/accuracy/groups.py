"""Dimensionless groups that decide the effect of numerics on a flow rate."""

import math
from dataclasses import dataclass

from labbook.filling.bed import PACKED, expected_bed_height
from labbook.scene import Scene
from labbook.scene.timescales import collision


@dataclass(frozen=True)
class Groups:
    """Dimensionless groups of a scene and its numerics.

    The first two decide the size of the effects; the others decide which calibration applies.

    Args:
        overlap: Overlap of two grains under the pressure of the bed, over d.
        step: Time step over the duration of a collision.
        shape: Shape of the grains.
        outlet: `slot` or `hole`.
        law: Contact law.
        friction: Friction coefficient.
        restitution: Restitution.
        rolling: Rolling friction.
        ratio: Orifice over d.
        angle: Angle of the bottom from the vertical [deg].
        eccentricity: Of the outlet, from 0 in the middle to 1 at a wall.
        rotation: Of the bottom, f sqrt(d/g).
        version: Version of the contact law.
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
    """True if a scene can be calibrated."""
    return groups(scene, 1.0, 1.0) is not None


def groups(scene: Scene, dt: float, stiffness_scale: float) -> Groups | None:
    """Compute the groups of a scene.

    The pressure is phi rho g h. h is the height of the bed, or the width of the container if that is less: below that
    depth walls carry the weight (Janssen 1895).

    Args:
        scene: The scene.
        dt: Time step [s].
        stiffness_scale: Factor on the stiffness of the contact law.

    Returns:
        The groups; None without an outlet or gravity, with several materials of grains or walls, or where bed or law do
        not determine pressure or overlap.
    """
    outlet, height = scene.container.outlet_form, expected_bed_height(scene)
    across = scene.container.across
    if outlet is None or height is None or across is None or scene.gravity == 0:
        return None
    surfaces = scene.surfaces
    if scene.has_own_stiffness or scene.grains.varied or any(surface != surfaces[0] for surface in surfaces):
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
