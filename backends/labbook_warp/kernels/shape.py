"""What the kernels of a shape of grains must bring, and what goes on where all shapes are alike calls by these names.

Nothing here is compiled: a generated module has the functions of its shape (`labbook_warp.shapes`) in place of these,
under the same names and with the same parameters. That is checked as it is made.
"""

from __future__ import annotations

from typing import Any

from labbook_dem.words import real, vec3, wide, wide3

from labbook_warp.kernels.sums import Contact, Sums
from labbook_warp.kernels.system import Material, System
from labbook_warp.kernels.words import Words, uint32

_OF_SHAPE = "each shape of grains has its own; see labbook_warp.shapes"


class Grain:
    """State of a grain, a record. Shapes with an orientation have also `axis`, a unit vector, and the quaternion q."""

    x: wide3  # [m]
    v: vec3  # [m/s], half a step before
    w: vec3  # [rad/s], reduced angular momentum half a step before: of a sphere, its spin
    u: vec3  # [m/s], v predicted for now
    spin: vec3  # [rad/s], half a step before
    axis: Any
    q: Any


class Own:
    """What a grain does not show to others, a record."""

    rest: real  # what rounding has kept from the vertical velocity [m/s]; see `shown`


# its state, and how it moves


def grain(p: Words, m: Material, i: int) -> Grain:
    """Grain i, as far as it shows."""
    raise NotImplementedError(_OF_SHAPE)


def own(a: System, p: Words, i: int) -> Own:
    """What grain i does not show."""
    raise NotImplementedError(_OF_SHAPE)


def whole(g: Grain, o: Own) -> Grain:
    """The grain with what it does not show."""
    raise NotImplementedError(_OF_SHAPE)


def store(a: System, q: Words, i: int, g: Grain, more: real) -> None:
    """Write grain i; more: what rounding has kept from its vertical velocity [m/s]."""
    raise NotImplementedError(_OF_SHAPE)


def pace2(m: Material, g: Grain) -> real:
    """Square of the largest speed [m^2/s^2] of a grain, of rods of an end."""
    raise NotImplementedError(_OF_SHAPE)


def moved(m: Material, g: Grain, x: wide3, v: vec3, w: wide3, u: vec3, turn_acc: wide3) -> Grain:
    """The grain at its new place, with new velocities, turned; w is not yet rounded. turn_acc: torque over I_t."""
    raise NotImplementedError(_OF_SHAPE)


def at_rest(g: Grain, z: wide) -> Grain:
    """The grain at height z [m], where it stays."""
    raise NotImplementedError(_OF_SHAPE)


def spinning(m: Material, g: Grain, w: wide3) -> Any:
    """Angular velocity [rad/s] of a grain whose reduced angular momentum is w."""
    raise NotImplementedError(_OF_SHAPE)


# what it meets


def with_neighbour(a: System, p: Words, m: Material, at: int, j: int, held: bool, g: Grain) -> Contact:
    """The contact with grain j, whose spring stands at `at` and is valid if `held`."""
    raise NotImplementedError(_OF_SHAPE)


def at_wall(a: System, m: Material, s: int, r: int, k: int, near: uint32, old: uint32, g: Grain) -> Contact:
    """The contact of row r at entry k of its walls, WALL_PARTS a wall. near, old: at which entries it is near, and at
    which springs are held, as bits."""
    raise NotImplementedError(_OF_SHAPE)


def normal_at(a: System, m: Material, s: int, r: int, k: int, wall: int, near: uint32, g: Grain) -> wide3:
    """Unit normal from `wall` to row r at entry k of its walls, where it touches."""
    raise NotImplementedError(_OF_SHAPE)


def at_walls(
    a: System, m: Material, s: int, r: int, lane: int, g: Grain, near: uint32, old: uint32, sums: Sums, keep: bool
) -> Any:  # fmt: skip
    """`sums` with the contacts with all walls that are `near`, and at which springs are held; old: were held.

    Of threads that share the grain, each gives its share. keep: whether springs are advanced in memory.
    """
    raise NotImplementedError(_OF_SHAPE)


# lists


def strayed(a: System, m: Material, i: int, g: Grain) -> Any:
    """How far [m] grain i has moved since its list was built, and its speed [m/s] now: of its farthest point."""
    raise NotImplementedError(_OF_SHAPE)


def mark(a: System, i: int, g: Grain) -> None:
    """Remember where grain i is as its list is built."""
    raise NotImplementedError(_OF_SHAPE)


def apart2(p: Words, m: Material, g: Grain, j: int) -> wide:
    """Square of the distance [m^2] from grain j: of their segments."""
    raise NotImplementedError(_OF_SHAPE)


def parts_near(a: System, m: Material, g: Grain, wall: int) -> uint32:
    """The parts of the grain that may touch a wall before its list is built again, as bits. An end counts wherever the
    plate is near."""
    raise NotImplementedError(_OF_SHAPE)
