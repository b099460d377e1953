"""Functions that the kernels of a shape of grains must define, and that kernels common to all shapes call.

Nothing here is compiled: a generated module contains the functions of its shape (`labbook_numba.shapes`) instead, with
the same names and parameters, which is checked when it is generated.
"""

from typing import Any

from labbook_numba.state import Params, State

_OF_SHAPE = "each shape of grains has its own; see labbook_numba.shapes"


def near_grain(grains, body, i, j, reach, half, skin, period) -> bool:
    """True if the surfaces of grains i and j are closer than a skin [m]; reach: largest diameter plus skin."""
    raise NotImplementedError(_OF_SHAPE)


def near_wall(grains, body, i, walls, kind, w, radius, half, skin) -> bool:
    """True if grain i is closer than a skin [m] to wall w; radius: of all grains, if they are the same."""
    raise NotImplementedError(_OF_SHAPE)


def move(st: State, p: Params, kick_dt, dt) -> None:
    """Kick, drift, turn and predict the domain's grains; replace forces by gravity.

    Writes squares of bounds for the speed of any point of the grain of a row [m^2/s^2], and zero for leavers.
    """
    raise NotImplementedError(_OF_SHAPE)


def contact_work(st: State, p: Params, kick_dt) -> Any:
    """Work [J] of the contact forces in State.loads during the next kick: force times mean velocity of the kick."""
    raise NotImplementedError(_OF_SHAPE)


def pack_pairs(
    grains, body, near, pair_i, pair_j, has_spring, b, block_i, block_j, slot, first, last, half, reach2, period
) -> Any:  # fmt: skip
    """Copy the touching ones of the listed pairs first..last into the block; return their number.

    Branches, overlap2 (square of the contact distance minus square of the branch) and further geometry for the law
    stage go to columns; grains to `block_i` and `block_j`, list entries to `slot`.
    """
    raise NotImplementedError(_OF_SHAPE)


def pair_contact(b, t, c, radius, mass, rate, dt, stiffness, damping) -> Any:
    """Force and torque on i, torque on j, spring and overlap [m] of contact t of the block; see `pairs.pair_law`."""
    raise NotImplementedError(_OF_SHAPE)


def wall_forces(st: State, p: Params) -> None:
    """Add the forces of walls to loads; continues the totals of `pairs.pair_forces`."""
    raise NotImplementedError(_OF_SHAPE)


def pair_now(st: State, p: Params, i, j, k, dt) -> Any:
    """Contact of listed pair k now: True if it touches, force on i [N], and branch from i to j [m]."""
    raise NotImplementedError(_OF_SHAPE)


def walls_now(st: State, p: Params, w, k, dt, out, count) -> Any:
    """Write the contacts of entry k with wall w to `out` from row `count` on; return the new number of rows."""
    raise NotImplementedError(_OF_SHAPE)


def normal_now(st: State, p: Params, w, k, row, rows) -> Any:
    """Unit normal from wall w to the grain of entry k at contact `row` of those that `walls_now` wrote to `rows`."""
    raise NotImplementedError(_OF_SHAPE)


def spin_after(grains, loads, body, i, duration, p: Params) -> Any:
    """Spin [rad/s] of grain i, `duration` [s] later under the torque in `loads`."""
    raise NotImplementedError(_OF_SHAPE)
