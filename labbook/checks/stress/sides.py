"""Periodic sides as close as they may be: grains exactly at them, a row of two that meets itself, and fast flights."""

from collections.abc import Iterator

import numpy as np

from labbook.checks.stress.case import Ending, StressCase, within
from labbook.checks.stress.impacts import PER_CONTACT, RIGID, SPEED
from labbook.checks.stress.watch import follow, sound
from labbook.checks.verify.case import limited
from labbook.checks.verify.collision import duration
from labbook.checks.verify.materials import LAWS, D, scene
from labbook.checks.verify.platform import MemberStart, Platform, grains_at
from labbook.scene import Box, Scene
from labbook.scene.packing import Packing
from labbook.scene.periodic import nearest_images

NARROW = 2.001 * D
"""Just more than the two grain lengths that sides have to be apart."""
ROUNDS = 8
"""Durations of a contact for which the row is followed."""
FLIGHT = 90.0
"""Speed along y [m/s], below the default limit."""


def _between(law: str) -> Scene:
    smooth = {"friction": 0.0, "rolling_friction": 0.0, "restitution": 1.0}
    return scene(2, LAWS[law](**smooth, **RIGID[law]), Box(width=4.0, depth=NARROW, height=4.0, periodic="y"))


def _ends(platform: Platform, of: Scene, dt: float, start: Packing, beats: int) -> tuple[np.ndarray, np.ndarray]:
    """Places [m] and velocities [m/s] at the end, by id."""
    end = sound(follow(platform, MemberStart(of, dt, start), beats, PER_CONTACT)).end
    order = end.rows(np.arange(len(end)))
    return end.x[order], end.v[order]


def _at_sides(platform: Platform) -> Iterator[Ending]:
    for law in LAWS:
        of = _between(law)
        dt = duration(of, SPEED) / PER_CONTACT
        # one on either side, touching across them: they exchange their velocities
        x = np.array([[0.0, NARROW / 2, 2.0], [0.0, -NARROW / 2 + D, 2.0]])
        _, v = _ends(platform, of, dt, grains_at(x, [[0.0, SPEED / 2, 0.0], [0.0, -SPEED / 2, 0.0]]), 2)
        error = float(np.abs(v[:, 1] - [-SPEED / 2, SPEED / 2]).max()) / SPEED
        yield within(
            platform,
            f"{law}, exactly at the sides",
            "velocity",
            error,
            limited(1e-6, roundings=100, steps=2 * PER_CONTACT),
        )
        # a row of two, of which each meets both sides of the other in turn
        start = grains_at([[0.0, 0.0, 2.0], [0.0, 1.0005 * D, 2.0]], [[0.0, SPEED, 0.0], [0.0, 0.0, 0.0]])
        _, v = _ends(platform, of, dt, start, ROUNDS)
        momentum, energy = v[:, 1].sum() / SPEED - 1, (v**2).sum() / SPEED**2 - 1
        part = f"{law}, a row that meets itself"
        yield within(platform, part, "momentum", abs(float(momentum)), limited(1e-12, steps=ROUNDS * PER_CONTACT))
        # the last contact may hold energy: it is over, or has just begun
        yield within(
            platform,
            part,
            "gain of energy",
            max(0.0, float(energy)),
            limited(1e-5, roundings=4000, steps=2 * ROUNDS * PER_CONTACT),
        )
        yield _flight(platform, law, of)


def _flight(platform: Platform, law: str, of: Scene) -> Ending:
    """Free flight over many periods, several in a beat."""
    dt, beats = 1e-6, 10
    v = np.array([[0.3, FLIGHT, -0.2], [0.3, -FLIGHT, 0.2]])
    start = grains_at([[0.0, 0.3 * D, 1.0], [1.0, 0.2 * D, 3.0]], v)
    x, _ = _ends(platform, of, dt, start, beats)
    error = nearest_images(x - start.x - v * (dt * beats * PER_CONTACT), NARROW)
    limit = limited(1e-13 * FLIGHT / D * beats, "d", steps=FLIGHT * dt * (beats * PER_CONTACT) ** 2 / D)
    return within(platform, f"{law}, flight at {FLIGHT:g} m/s", "position", float(np.abs(error).max()) / D, limit)


CASES = [
    StressCase(
        name="periodic-sides",
        attempt="sides 2.001 d apart: grains exactly at them, a row of two that meets itself, flight at 90 m/s",
        oracle="elastic exchange; momentum, and no gain of energy; free flight",
        run=_at_sides,
    )
]
