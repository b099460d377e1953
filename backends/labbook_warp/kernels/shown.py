"""State of grains that other threads read: position and motion. Each scattered load is made once.

Nothing here is compiled: `labbook_warp.codec` writes these functions for a shape and a precision.
"""

from __future__ import annotations

from typing import Any

from labbook_dem.words import real, wide3

from labbook_warp.kernels.words import Words

_GENERATED = "written by labbook_warp.codec for a shape and a precision"


class GrainPosition:
    """Position and axis of a grain, in double precision.

    A word that also contains the first component of its motion is kept here, so that `motion` need not load it again.
    """

    x: wide3  # [m]
    axis: wide3  # unit vector of a rod


def position(p: Words, i: int) -> GrainPosition:
    """Load the position of grain i, and the axis of a rod."""
    raise NotImplementedError(_GENERATED)


def motion(p: Words, i: int, s: GrainPosition) -> Any:
    """Load the motion of grain i: velocity [m/s] and angular velocity [rad/s] half a step before, predicted velocity,
    and of rods the predicted angular velocity."""
    raise NotImplementedError(_GENERATED)


def rounding_error(p: Words, i: int) -> real:
    """Rounding error of the vertical velocity [m/s]: without it, gravity's small kicks would all be rounded the same
    way.

    Zero in double precision, where it does not matter, and for rods, which store it elsewhere.
    """
    raise NotImplementedError(_GENERATED)


def put(p: Words, i: int, *numbers: Any) -> None:
    """Store the shared state of grain i: vectors of `position` and `motion`, and of a sphere also `rounding_error`."""
    raise NotImplementedError(_GENERATED)
