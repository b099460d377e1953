"""What describes the walls of a member, which of them a grain is near, and how their surfaces move; where they are:
`labbook_dem.chosen`."""

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
    """The wall that entry q of row r of slot s is of: its own number, where all walls of a member have an entry."""
    wall = s * a.walls + q
    if LISTED:
        wall = s * a.walls + a.wall_seat[entry(a, s, a.seats, q, r)]
    return wall


@func
def wall_velocity(a: System, g: int, at: wide3):
    """Velocity [m/s] of the surface of wall g at the point `at`."""
    b = a.wall_motion[g]
    return wide3(b[0] - b[3] * at[1], b[1] + b[3] * at[0], b[2])
