"""Functions that the kernels of a shape of grains must define, and that kernels common to all shapes call.

Nothing here is compiled: a generated module contains the functions of its shape (`labbook_warp.shapes`) instead, with
the same names and parameters, which is checked when it is generated.
"""

from __future__ import annotations

from typing import Any

from labbook_dem.words import real, vec3, wide, wide3

from labbook_warp.kernels.sums import Contact, Sums
from labbook_warp.kernels.system import Material, System
from labbook_warp.kernels.words import Words, uint32

_OF_SHAPE = "each shape of grains has its own; see labbook_warp.shapes"


class Grain:
    """State of a grain. Shapes with an orientation also have `axis`, a unit vector, and the quaternion q."""

    x: wide3  # [m]
    v: vec3  # [m/s], half a step before
    w: vec3  # [rad/s], reduced angular momentum half a step before: of a sphere, its spin
    u: vec3  # [m/s], v predicted for now
    spin: vec3  # [rad/s], half a step before
    axis: Any
    q: Any


class Private:
    """Per-grain data that only its own thread reads."""

    rounding: real  # rounding error of the vertical velocity [m/s]; see `shown`


# state and motion


def grain(p: Words, m: Material, i: int) -> Grain:
    """Load the shared state of grain i."""
    raise NotImplementedError(_OF_SHAPE)


def private(a: System, p: Words, i: int) -> Private:
    """Load the private data of grain i."""
    raise NotImplementedError(_OF_SHAPE)


def complete(g: Grain, hidden: Private) -> Grain:
    """Grain with its private data."""
    raise NotImplementedError(_OF_SHAPE)


def store(a: System, q: Words, i: int, g: Grain, rounding: real) -> None:
    """Write grain i; rounding: rounding error of its vertical velocity [m/s]."""
    raise NotImplementedError(_OF_SHAPE)


def max_speed2(m: Material, g: Grain) -> real:
    """Square of the largest speed [m^2/s^2] of a grain; of a rod, of its ends."""
    raise NotImplementedError(_OF_SHAPE)


def moved(m: Material, g: Grain, x: wide3, v: vec3, w: wide3, u: vec3, turn_acc: wide3) -> Grain:
    """Grain at its new position x, with new velocities and orientation; w is not yet rounded.

    turn_acc: torque over the transverse moment of inertia [rad/s^2].
    """
    raise NotImplementedError(_OF_SHAPE)


def at_rest(g: Grain, z: wide) -> Grain:
    """Grain at rest at height z [m]."""
    raise NotImplementedError(_OF_SHAPE)


def angular_velocity(m: Material, g: Grain, w: wide3) -> Any:
    """Angular velocity [rad/s] of a grain with reduced angular momentum w [rad/s]."""
    raise NotImplementedError(_OF_SHAPE)


# contacts


def with_neighbour(a: System, p: Words, m: Material, at: int, j: int, has_spring: bool, g: Grain) -> Contact:
    """Contact with grain j, whose spring is entry `at`; has_spring: it is valid."""
    raise NotImplementedError(_OF_SHAPE)


def at_wall(a: System, m: Material, s: int, r: int, k: int, near: uint32, old: uint32, g: Grain) -> Contact:
    """Contact of row r at entry k of its walls, WALL_PARTS entries a wall. near, old: masks of near entries and of
    springs."""
    raise NotImplementedError(_OF_SHAPE)


def normal_at(a: System, m: Material, s: int, r: int, k: int, wall: int, near: uint32, g: Grain) -> wide3:
    """Unit normal of `wall` at the contact of row r with entry k of its walls."""
    raise NotImplementedError(_OF_SHAPE)


def at_walls(
    a: System, m: Material, s: int, r: int, lane: int, g: Grain, near: uint32, old: uint32, sums: Sums, keep: bool
) -> Any:  # fmt: skip
    """Sums with the contacts with all walls of the mask `near` added, and the new mask of springs; old: the old one.

    Each of several threads that share a grain adds its share. keep: store the springs of the next step.
    """
    raise NotImplementedError(_OF_SHAPE)


# lists


def displacement_and_speed(a: System, m: Material, i: int, g: Grain) -> Any:
    """Displacement [m] of grain i since the last rebuild, and its speed [m/s]: bounds for its farthest point."""
    raise NotImplementedError(_OF_SHAPE)


def store_origin(a: System, i: int, g: Grain) -> None:
    """Store the position of grain i at the rebuild of its list."""
    raise NotImplementedError(_OF_SHAPE)


def distance2(p: Words, m: Material, g: Grain, j: int) -> wide:
    """Square of the distance [m^2] from grain j; of rods, of their segments."""
    raise NotImplementedError(_OF_SHAPE)


def parts_near(a: System, m: Material, g: Grain, wall: int) -> uint32:
    """Mask of the parts of the grain that may touch a wall before the next rebuild.

    An end of a rod counts wherever the wall's surface is near.
    """
    raise NotImplementedError(_OF_SHAPE)
