"""What a grain shows to others: where it is, and how it moves. Loads by threads side by side are scattered, and none is
made twice.

Nothing here is compiled: `labbook_warp.codec` writes these functions for a shape of grains and a precision.
"""

from __future__ import annotations

from typing import Any

from labbook_dem.words import real, wide3

from labbook_warp.kernels.words import Words

_WRITTEN = "written by labbook_warp.codec for a shape and a precision"


class Spot:
    """Where a grain is: vectors in double, and the word that also holds the first of how it moves, if there is one."""

    x: wide3  # [m]
    axis: wide3  # unit vector of a rod


def spot(p: Words, i: int) -> Spot:
    """Where grain i is."""
    raise NotImplementedError(_WRITTEN)


def motion(p: Words, i: int, s: Spot) -> Any:
    """How grain i moves, by vectors: velocity [m/s] and angular velocity [rad/s] half a step before, and the velocity
    predicted for now; of a rod the angular velocity too."""
    raise NotImplementedError(_WRITTEN)


def rest(p: Words, i: int) -> real:
    """What rounding has kept from the vertical velocity [m/s]: gravity's small kicks would be rounded all one way.

    Nothing in double, where it does not matter, and of rods, which keep it elsewhere.
    """
    raise NotImplementedError(_WRITTEN)


def put(p: Words, i: int, *numbers: Any) -> None:
    """Write what grain i shows: the vectors of `spot` and `motion`, and of a sphere what `rest` gives."""
    raise NotImplementedError(_WRITTEN)
