"""Free places for grains that enter a bed: for those that come back, and for those of a stream."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from labbook.filling.placed import Placed
from labbook.filling.placing import APART, free
from labbook.filling.room import Room
from labbook.scene import Bodies, Grains, Packing, Spherocylinders
from labbook.scene.orientation import axes, random_turns

Draw = Callable[[int, np.ndarray], np.ndarray]
"""Centres [m] that round k tries for grains of which `reach` [m] is kept free, shape [n, 3]."""


@dataclass(frozen=True, eq=False)
class Entering:
    """Places of grains that enter: centres [m], of rods orientations, and which of the grains found one."""

    x: np.ndarray
    q: np.ndarray | None
    rows: np.ndarray

    def packing(self, every: Packing, rows: np.ndarray, v: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Packing:
        """Return those of the grains `rows` of the packing `every` that found a place, with the velocity v [m/s]."""
        assert every.ids is not None
        mine = rows[self.rows]
        q = None if self.q is None else self.q[self.rows]
        diameter, kind = (None if own is None else own[mine] for own in (every.diameter, every.kind))
        rest = np.zeros((len(mine), 3))
        return Packing(
            x=self.x[self.rows], v=rest + v, omega=rest, q=q, ids=every.ids[mine], diameter=diameter, kind=kind
        )


def entering(
    room: Room, grains: Grains, radius: np.ndarray, there: Packing, rng: np.random.Generator, draw: Draw, rounds: int
) -> Entering:
    """Search places for grains, one try each a round, where they touch neither walls nor each other nor those there.

    Args:
        room: Inside of the container.
        grains: Of the scene.
        radius: Radius [m] of each grain that enters, shape [n].
        there: Grains that may be in their way.
        rng: Draws orientations of rods.
        draw: Draws centres.
        rounds: Tries of each grain.
    """
    n, half = len(radius), grains.half_length
    reach = np.concatenate([radius, Bodies.of(grains, there).radius]) * APART
    x = np.concatenate([np.empty((n, 3)), there.x])
    q, a = None, None
    if isinstance(grains, Spherocylinders):
        assert there.q is not None
        q = np.concatenate([np.empty((n, 4)), there.q])
        a = np.concatenate([np.empty((n, 3)), axes(there.q)])
    left, placed, above = np.arange(n), np.arange(n, len(x)), Placed(x[n:])
    for k in range(rounds):
        if not len(left):
            break
        x[left] = draw(k, reach[left])
        inside = room.holds(x[left], reach[left])
        if q is not None and a is not None:
            q[left] = random_turns(rng, len(left))
            a[left] = axes(q[left])
            ends = half * a[left]
            inside = room.holds(x[left] + ends, reach[left]) & room.holds(x[left] - ends, reach[left])
        new = free(x, reach, above, placed, left[inside], a, half)
        above.add(x[new])
        placed, left = np.concatenate([placed, new]), np.setdiff1d(left, new, assume_unique=True)
    return Entering(x, q, np.setdiff1d(np.arange(n), left, assume_unique=True))
