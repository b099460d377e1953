"""Resolution and grids of the fields of a bed."""

from collections.abc import Mapping

import numpy as np

from labbook.fields import GrainRows, Grid, Layer, Ring, grains_of
from labbook.measure.measure import MeasureError
from labbook.measure.region import Outlines
from labbook.scene import Bodies, Outlet, Scene

OMEGA = 0.5
"""Width of the coarse-graining function in diameters of the grains, or of spheres of their volume."""


def omega_of(scene: Scene) -> float:
    """Width of the coarse-graining function [m] (Pongo et al. 2022: half the equivalent diameter)."""
    return OMEGA * scene.grains.equivalent_diameter


def round_outlet(scene: Scene, measure: str) -> Outlet:
    """Return the round outlet of a scene with equal grains.

    Args:
        scene: The scene.
        measure: Name of the measure, for the message.

    Raises:
        MeasureError: The outlet is not round, or grains differ.
    """
    if scene.container.outlet_form != "hole":
        reason = f"{measure} needs a round outlet, and the container is a {scene.container.kind}"
        raise MeasureError(reason, f"take {measure} out of measure, or use a cylinder-silo or conical-silo")
    if scene.grains.varied:
        raise MeasureError(
            f"{measure} needs equal grains", f"take {measure} out of measure, or leave out sizes and kinds"
        )
    return scene.container.outlets[0]


def grains_between(scene: Scene, frames: Mapping[str, np.ndarray], begin: float, end: float) -> GrainRows:
    """Select the grains of the frames with begin <= time <= end [s]; rods without length are spheres without axes.

    Args:
        scene: The scene.
        frames: Columns of recorded frames; where grains differ with `radius` [m] and `kind`.
        begin: Time of the first frame [s].
        end: Time of the last frame [s].

    Raises:
        ValueError: No frame lies between these times.
    """
    grains = scene.grains
    if not grains.elongated:
        frames = {name: column for name, column in frames.items() if name not in ("qw", "qx", "qy", "qz")}
    if not grains.varied:
        return grains_of(frames, grains.mass, grains.volume, begin, end)
    radius, x = np.asarray(frames["radius"]), np.column_stack([frames[axis] for axis in "xyz"])
    mass = Bodies.sized(grains, 2 * radius, np.asarray(frames["kind"])).mass
    return grains_of(frames, mass, Outlines(x, radius).volumes, begin, end)


def bed_grid(scene: Scene, omega: float, x: np.ndarray, *, coarse: bool = False) -> Grid:
    """Lay the grid of the fields of a bed in a quasi-2D hopper or an axisymmetric silo.

    Args:
        scene: The scene.
        omega: Width of the coarse-graining function [m].
        x: Positions of the grains [m], shape [n, 3].
        coarse: Rings about an axis are as wide as omega, not half of it.

    Returns:
        A grid from below the outlet to above the highest grain, with cells as wide as omega.
    """
    container, wide = scene.container, scene.container.across
    assert wide is not None
    low, high = -4 * omega, float(x[:, 2].max()) + 2 * omega
    if container.symmetry == "planar":
        size = cells(wide, omega), cells(high - low, omega)
        return Layer((-wide / 2, wide / 2), (low, high), *size, container.front_to_back)
    radius, cell = wide / 2, omega if coarse else omega / 2
    return Ring(radius, (low, high), cells(radius, cell), cells(high - low, cell))


def cells(length: float, width: float) -> int:
    """Number of cells of about this `width` in a `length`, at least one."""
    return max(1, round(length / width))
