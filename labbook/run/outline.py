"""What a plan says of a point's physics: its time step, steps, the outlet in grains, and the height of the bed."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from labbook.run.demand import PointDemand
from labbook.run.forecast import discharge_time, fill_time
from labbook.run.reach import PACKED
from labbook.scene import Box, ConicalSilo, CylinderSilo, Scene, WedgeHopper


@dataclass(frozen=True)
class Outline:
    """`dt` [s]; `fill_steps` and `steps`: of a filling and a discharge, as foreseen; `extent` [m]: the largest
    dimension of a grain; `ratio`: the orifice over it, None without one; `height` [m]: of the bed above the outlet or
    bottom at a packing fraction of PACKED, None where the container does not tell; `memory` [bytes] of one run."""

    dt: float
    fill_steps: float
    steps: float
    extent: float
    ratio: float | None
    height: float | None
    memory: float


BYTES = {"sphere": 800.0, "spherocylinder": 2200.0}
"""Memory that a grain takes at most on the CPU backend, while it is placed and while it moves with its near neighbours
and contacts. Measured: 435 with 200 000 spheres, 1800 with 50 000 rods; lists and checkpoints grow beyond that."""


def outline(shared: PointDemand) -> Outline:
    """What is foreseen of the runs of a point."""
    scene, dt = shared.scene, shared.numerics.dt
    grains = scene.grains
    extent = grains.diameter + 2 * grains.half_length
    orifice = getattr(scene.container, "orifice", None)
    return Outline(
        dt,
        fill_time(shared.run(1)) / dt,
        discharge_time(shared) / dt,
        extent,
        None if orifice is None else orifice / extent,
        bed_height_ahead(scene),
        grains.count * BYTES[grains.shape],
    )


def bed_height_ahead(scene: Scene) -> float | None:
    """Height [m] above the outlet (or the bottom of a box) that a level bed will have at a packing fraction of PACKED;
    None where the container does not tell."""
    below = _volume_below(scene)
    if below is None:
        return None
    volume = scene.grains.count * scene.grains.volume / PACKED
    high = scene.grains.diameter
    while below(high) < volume:
        high *= 2
    low = 0.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (low, middle) if below(middle) > volume else (middle, high)
    return high


def _volume_below(scene: Scene) -> Callable[[float], float] | None:
    """Volume [m^3] of the container below a height [m], its walls going on upwards."""
    c = scene.container
    if isinstance(c, Box):
        return lambda z: c.width * c.depth * z
    if isinstance(c, CylinderSilo):
        return lambda z: math.pi / 4 * c.diameter**2 * z
    if isinstance(c, ConicalSilo):
        slope, r, R = math.tan(c.angle), c.orifice / 2, c.diameter / 2

        def in_cone(z: float) -> float:
            cone = min(z, c.rise)
            return math.pi * ((r + slope * cone) ** 3 - r**3) / (3 * slope) + math.pi * R**2 * (z - cone)

        return in_cone
    if isinstance(c, WedgeHopper):
        if c.flat:
            return lambda z: c.width * c.thickness * z
        slope, (left, right) = math.tan(c.angle), c.outlet
        sides = (left + c.width / 2, c.width / 2 - right)

        def in_wedge(z: float) -> float:
            area = c.orifice * z
            for side in sides:
                foot = min(z, side / slope)  # up to here the plate recedes
                area += slope * foot**2 / 2 + side * (z - foot)
            return area * c.thickness

        return in_wedge
    return None
