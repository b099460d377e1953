"""Tables of a member's walls, the walls near a grain, and the motion of their surfaces."""

from __future__ import annotations

from labbook_dem.words import func, wide3

from labbook_warp.kernels.system import System, entry
from labbook_warp.kernels.words import LISTED, WALL_NUMBERS, Wides, load_wide


@func
def wall_number(walls: Wides, w: int, k: int):
    """Number k of wall w (`labbook_dem.dispatch`)."""
    return load_wide(walls, w * WALL_NUMBERS + k)


@func
def wall_at(a: System, s: int, r: int, q: int):
    """Wall of entry q of row r of slot s: wall q itself if a grain has entries for all walls."""
    wall = s * a.walls + q
    if LISTED:
        wall = s * a.walls + a.wall_seat[entry(a, s, a.seats, q, r)]
    return wall


@func
def wall_velocity(a: System, g: int, at: wide3):
    """Velocity [m/s] of the surface of wall g at the point `at` [m]: translation, and rotation about the z axis."""
    b = a.wall_motion[g]
    return wide3(b[0] - b[3] * at[1], b[1] + b[3] * at[0], b[2])
