"""Motion of a whole part of a container. Its pose is a function of time: nothing drifts, and restarts are exact."""

import math
from collections.abc import Iterator
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from labbook.scene.model import Fault, Model, refuse
from labbook.scene.quantities import Angle, AngularSpeed, Coordinate, Frequency, Length, Ratio, Speed

Direction = tuple[Ratio, Ratio, Ratio]
_SAMPLES = 64
"""Times of a period, or of a run, at which the extent of a part is looked at."""


class PartRotation(Model):
    """Rotation about an axis at a constant rate."""

    axis: Direction
    """Direction of the axis, of any length; counter-clockwise seen from its tip."""
    origin: tuple[Coordinate, Coordinate, Coordinate] = (0.0, 0.0, 0.0)
    """A point of the axis, about which the torque on the part is counted."""
    rate: AngularSpeed
    """Angular velocity."""


class Vibration(Model):
    """Harmonic motion A sin(2 π f t + φ) along a direction, from the place where the part stands."""

    direction: Direction
    """Direction, of any length."""
    amplitude: Length
    """Amplitude A."""
    frequency: Annotated[Frequency, Field(gt=0)]
    """Frequency f."""
    phase: Angle = 0.0
    """Phase φ at the opening."""

    @property
    def speed(self) -> float:
        """Largest speed [m/s], 2 π f A."""
        return 2 * math.pi * self.frequency * self.amplitude

    def strength(self, gravity: float) -> float:
        """Compute the dimensionless acceleration Γ = A (2 π f)²/g for `gravity` g [m/s^2]; infinite without gravity."""
        return self.amplitude * (2 * math.pi * self.frequency) ** 2 / gravity if gravity else math.inf


class Poses(NamedTuple):
    """Places and velocities of a part at n times: a point b of it as it was placed is at turn b + shift, and a point x
    in space moves with it at velocity + spin x x.

    Attributes:
        turn: Rotation matrices, shape [n, 3, 3].
        shift: Displacements [m], shape [n, 3].
        velocity: Velocity of the origin of space as a point of the part [m/s], shape [n, 3].
        spin: Angular velocities [rad/s], shape [n, 3].
        origin: Points about which torques are counted [m], shape [n, 3].
    """

    turn: np.ndarray
    shift: np.ndarray
    velocity: np.ndarray
    spin: np.ndarray
    origin: np.ndarray

    @classmethod
    def at_rest(cls, times: int) -> "Poses":
        """Make the poses of a part that stands where it was placed.

        Args:
            times: Number n of times.

        Returns:
            Poses without rotation and displacement.
        """
        zero = np.zeros((times, 3))
        return cls(np.tile(np.eye(3), (times, 1, 1)), zero, zero, zero, zero)

    def table(self) -> np.ndarray:
        """All but the origins as kernels take them, shape [n, POSE_COLUMNS]."""
        return np.concatenate([self.turn.reshape(-1, 9), self.shift, self.velocity, self.spin], axis=1)

    def positions(self, k: int, x: np.ndarray) -> np.ndarray:
        """Places at time k of points x [m] of the part as it was placed, shape [m, 3]."""
        return x @ self.turn[k].T + self.shift[k]


POSE_COLUMNS = 18
"""Numbers of a pose."""


class PartMotion(Model):
    """Motion of a part from the opening on: it is turned about the axis, then displaced. What is stated adds up."""

    # what is not stated is left out of what is stored
    velocity: Annotated[tuple[Speed, Speed, Speed] | None, Field(exclude_if=lambda velocity: velocity is None)] = None
    """Constant velocity along x, y and z."""
    rotation: Annotated[PartRotation | None, Field(exclude_if=lambda rotation: rotation is None)] = None
    """Rotation about an axis."""
    vibration: Annotated[Vibration | None, Field(exclude_if=lambda vibration: vibration is None)] = None
    """Harmonic motion along a direction."""

    @model_validator(mode="after")
    def _moves(self):
        refuse(self._faults())
        return self

    def _faults(self) -> Iterator[Fault]:
        if self.velocity is None and self.rotation is None and self.vibration is None:
            yield Fault("moves", "it states no motion", "state velocity, rotation or vibration, or leave moves out")
        for key, direction in (
            ("rotation.axis", self.rotation and self.rotation.axis),
            ("vibration.direction", self.vibration and self.vibration.direction),
        ):
            if direction is not None and math.hypot(*direction) < 1e-6:
                yield Fault(key, "a direction has length zero", "for example [0, 0, 1]")

    def poses(self, times: np.ndarray) -> Poses:
        """Compute the poses of the part.

        Sines are those of the C library, one by one: the same to the bit wherever a time stands in an array.

        Args:
            times: Times since the opening [s], shape [n].

        Returns:
            Poses at these times.
        """
        times, n = np.asarray(times, float), len(times)
        turn, spin = np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3))
        pivot, drift, velocity = np.zeros(3), np.zeros((n, 3)), np.zeros((n, 3))
        if self.velocity is not None:
            drift = times[:, None] * np.array(self.velocity)
            velocity = np.tile(np.array(self.velocity), (n, 1))
        if self.vibration is not None:
            v = self.vibration
            unit = np.array(v.direction) / np.linalg.norm(v.direction)
            phase = (2 * math.pi * v.frequency * times + v.phase).tolist()
            drift = drift + np.outer([v.amplitude * (math.sin(at) - math.sin(v.phase)) for at in phase], unit)
            velocity = velocity + np.outer([v.speed * math.cos(at) for at in phase], unit)
        if self.rotation is not None:
            pivot = np.array(self.rotation.origin)
            x, y, z = unit = np.array(self.rotation.axis) / np.linalg.norm(self.rotation.axis)
            angles = (self.rotation.rate * times).tolist()
            cos, sin = (np.array(list(map(f, angles))).reshape(-1, 1, 1) for f in (math.cos, math.sin))
            across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
            turn = cos * np.eye(3) + sin * across + (1 - cos) * np.outer(unit, unit)
            spin = np.tile(self.rotation.rate * unit, (n, 1))
        origin = pivot + drift
        shift = origin - turn @ pivot if self.rotation is not None else drift
        return Poses(turn, shift, velocity - np.cross(spin, origin), spin, origin)

    def speed(self, vertices: np.ndarray, reach: float) -> float:
        """Bound the speed of points near the part.

        Args:
            vertices: Vertices of the part [m], shape [n, 3].
            reach: Distance of the points from the part at most [m].

        Returns:
            Bound [m/s].
        """
        bound = math.hypot(*(self.velocity or (0.0,)))
        bound += self.vibration.speed if self.vibration is not None else 0.0
        if self.rotation is not None:
            unit = np.array(self.rotation.axis) / np.linalg.norm(self.rotation.axis)
            lever_arm = np.linalg.norm(np.cross(vertices - self.rotation.origin, unit), axis=1).max()
            bound += abs(self.rotation.rate) * (float(lever_arm) + reach)
        return bound

    def sampled(self, end: float) -> np.ndarray:
        """Choose times between which the part moves little, of its first period and of the last one.

        Args:
            end: Latest time [s].

        Returns:
            Times from 0 to `end` [s], ascending.
        """
        periods = [2 * math.pi / abs(self.rotation.rate)] if self.rotation is not None and self.rotation.rate else []
        periods += [1 / self.vibration.frequency] if self.vibration is not None else []
        if not periods:
            return np.array([0.0, end])
        first = np.linspace(0.0, min(max(periods), end), _SAMPLES)
        return np.unique(np.concatenate([first, first + end - first[-1]]))
