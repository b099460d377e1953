"""How finely the fields of a bed are computed, and where."""

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
    """The round outlet of a scene with equal grains. Raises MeasureError for any other."""
    if scene.container.outlet_form != "hole":
        reason = f"{measure} needs a round outlet, and the container is a {scene.container.kind}"
        raise MeasureError(reason, f"take {measure} out of measure, or use a cylinder-silo or conical-silo")
    if scene.grains.varied:
        raise MeasureError(
            f"{measure} needs equal grains", f"take {measure} out of measure, or leave out sizes and kinds"
        )
    return scene.container.outlets[0]


def grains_between(scene: Scene, frames: Mapping[str, np.ndarray], begin: float, end: float) -> GrainRows:
    """Grains of the frames with begin <= time <= end [s], which of unlike ones have `radius` and `kind`; rods without
    length are spheres and have no axes.

    Raises ValueError if there is no frame.
    """
    own = scene.grains
    if not getattr(own, "half_length", 0.0) > 0:
        frames = {name: column for name, column in frames.items() if name not in ("qw", "qx", "qy", "qz")}
    if not own.varied:
        return grains_of(frames, own.mass, own.volume, begin, end)
    radius, x = np.asarray(frames["radius"]), np.column_stack([frames[axis] for axis in "xyz"])
    mass = Bodies.sized(own, 2 * radius, np.asarray(frames["kind"])).mass
    return grains_of(frames, mass, Outlines(x, radius).volumes, begin, end)


def bed_grid(scene: Scene, omega: float, x: np.ndarray, *, coarse: bool = False) -> Grid:
    """From below the outlet to above the highest of the grains at x [m], shape [n, 3]; cells as wide as omega, about an
    axis half of that unless `coarse`. Of a quasi-2D hopper or a silo about the axis.
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
    """How many cells of about this `width` a `length` has."""
    return max(1, round(length / width))
