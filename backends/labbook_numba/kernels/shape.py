"""What the kernels of a shape of grains must bring, and what goes on where all shapes are alike calls by these names.

Nothing here is compiled: a generated module has the functions of its shape (`labbook_numba.shapes`) in place of these,
under the same names and with the same parameters. That is checked as it is made.
"""

from typing import Any

from labbook_numba.state import Params, State

_OF_SHAPE = "each shape of grains has its own; see labbook_numba.shapes"


def near_grain(grains, body, i, j, reach, half, skin) -> bool:
    """Whether the surfaces of grains i and j are closer than a skin [m]; `reach`: the largest diameter and a skin."""
    raise NotImplementedError(_OF_SHAPE)


def near_wall(grains, body, i, walls, kind, w, radius, half, skin) -> bool:
    """Whether grain i is closer than a skin [m] to wall w; `radius`: of all, if they are alike."""
    raise NotImplementedError(_OF_SHAPE)


def turn_grain(g, i, turns, v, slender, half, kick_dt, dt) -> Any:
    """Kick grain i by torque over inertia, `turns` [rad/s^2], and turn it; v: its velocity, a row. The square of a
    speed that no point of its segment exceeds [m^2/s^2]."""
    raise NotImplementedError(_OF_SHAPE)


def contact_work(st: State, p: Params, kick_dt) -> Any:
    """Work [J] that the contact forces in State.loads are about to do: force times mean velocity of the kick."""
    raise NotImplementedError(_OF_SHAPE)


def pack_pairs(
    grains, body, near, pair_i, pair_j, held, b, block_i, block_j, slot, first, last, half, reach2
) -> Any:  # fmt: skip
    """Bring those of the listed pairs first..last that touch into the block; how many they are.

    Branches, the square of the distance at which they touch less that of the branch, and what else the law stage needs
    of where they are go to columns; grains to `block_i` and `block_j`, list entries to `slot`.
    """
    raise NotImplementedError(_OF_SHAPE)


def pair_contact(b, t, c, radius, mass, rate, dt, stiffness, damping) -> Any:
    """Force and torque on i, torque on j, spring and overlap [m] of contact t of the block; see `pairs.pair_law`."""
    raise NotImplementedError(_OF_SHAPE)


def wall_forces(st: State, p: Params) -> None:
    """Add the forces of walls to loads; after `pairs.pair_forces`, whose totals it goes on with."""
    raise NotImplementedError(_OF_SHAPE)


def pair_now(st: State, p: Params, i, j, k, dt) -> Any:
    """Of grains i and j, listed pair k: whether they touch, the force on i [N], and the branch from i to j [m]."""
    raise NotImplementedError(_OF_SHAPE)


def walls_now(st: State, p: Params, w, k, dt, out, found) -> Any:
    """Write a row of `out`, from `found` on, for each contact of the grain of entry k with wall w; how many rows there
    are then."""
    raise NotImplementedError(_OF_SHAPE)


def normal_now(st: State, p: Params, w, k, row, rows) -> Any:
    """Unit normal from wall w to the grain of entry k at contact `row` of those that `walls_now` has just written to
    `rows`."""
    raise NotImplementedError(_OF_SHAPE)


def spin_later(grains, loads, body, i, later, p: Params) -> Any:
    """Spin [rad/s] of grain i, `later` [s] later by the torque in `loads`."""
    raise NotImplementedError(_OF_SHAPE)
