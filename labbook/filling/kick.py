"""Kicks: random velocities at the start of a further discharge of a bed, so that it takes another course."""

from dataclasses import dataclass, replace

import numpy as np

from labbook.scene import Scene
from labbook.scene.packing import Packing
from labbook.scene.timescales import gravity_time

SPEED = 1e-3
"""Standard deviation of each component of the velocities, in sqrt(g d*). The kinetic energy is 1.5e-6 m g d* a grain,
about that of a bed at rest (`fill.settled_below`), and the flow forgets it within the first rearrangements."""
VERSION = 1
"""Part of the key of every kicked run; it rises whenever a seed gives other velocities."""


@dataclass(frozen=True)
class Kick:
    """The kick of a discharge after the first of its bed.

    Attributes:
        discharge: Number of the discharge of its bed, from 2 on: the first has no kick.
        version: VERSION of the rules that draw the velocities.
    """

    discharge: int
    version: int = VERSION

    def __post_init__(self):
        if not 2 <= self.discharge < 2**31 or self.version < 1:
            raise ValueError(f"no discharge has this kick: discharge {self.discharge}, version {self.version}")


def kick_grains(start: Packing, scene: Scene, kick: Kick, seed: int) -> Packing:
    """Add random velocities to the start of a discharge; orientations, spins and springs stay.

    Args:
        start: The bed with its outlet open, at rest.
        scene: Scene with the gravity and the grains, whose equivalent diameter is d*.
        kick: Number of the discharge of the bed.
        seed: Seed of the bed.

    Returns:
        The same grains. Each component of their velocities [m/s] is changed by a normal random number of standard
        deviation SPEED sqrt(g d*). A bed that lies and moves in one plane y = const stays in it.
    """
    rng = np.random.default_rng([kick.version, kick.discharge, seed])
    change = rng.normal(scale=SPEED * scene.gravity * gravity_time(scene), size=start.v.shape)
    if not (np.ptp(start.x[:, 1]) or start.v[:, 1].any()):
        change[:, 1] = 0.0
    return replace(start, v=start.v + change)
