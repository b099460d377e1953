"""Clumps that touch at several spheres at once: face to face, locked into one another, stacked, in one place."""

import math
from collections.abc import Iterator

import numpy as np

from labbook.checks.stress.case import Ending, StressCase, within
from labbook.checks.stress.geometry import rest_at_end
from labbook.checks.stress.watch import follow, guard_error, sound
from labbook.checks.verify.case import limited
from labbook.checks.verify.clumps import PLATE, D, clumps, clumps_at
from labbook.checks.verify.materials import G, floor
from labbook.checks.verify.platform import MemberStart, Platform
from labbook.scene import Box, Clumps, Primitives

SPEED, STIFFNESS = 0.1, 2e3
DT = 5e-6
"""Small enough for the dashpots of six contacts at e = 0.2, which turn one light body [s]."""
TRIPOD = PLATE.model_copy(
    update={
        "centres": tuple(
            (0.55 * D * math.cos(t), 0.55 * D * math.sin(t), 0.0) for t in (0.0, 2 * math.pi / 3, 4 * math.pi / 3)
        )
    }
)
"""Three equal spheres at the corners of a triangle of equal sides, about the centre of mass."""
PAIR = PLATE.model_copy(update={"centres": ((0.0, 0.0, -0.4 * D), (0.0, 0.0, 0.4 * D))})
"""Two equal spheres, with a notch between them."""
JACK = PLATE.model_copy(
    update={
        "centres": tuple(tuple(end) for sign in (0.7 * D, -0.7 * D) for end in (sign * np.eye(3)).tolist()),
        "diameters": (),
    }
)
"""Six equal spheres along three axes: all moments are equal."""
UPRIGHT = (1.0, 0.0, 0.0, 0.0)
FLAT = (0.5**0.5, 0.0, -(0.5**0.5), 0.0)
"""A plate with its face up: the axis of its largest moment is vertical."""
TURNED = (0.5**0.5, 0.0, 0.0, 0.5**0.5)
"""A quarter of a turn about the vertical."""
ACROSS = (0.5**0.5, 0.5**0.5, 0.0, 0.0)
"""A pair that lies along the second horizontal axis."""
ALONG = (0.5**0.5, 0.0, 0.5**0.5, 0.0)
"""A pair that lies along the first horizontal axis."""


def _aligned(platform: Platform) -> Iterator[Ending]:
    """By symmetry nothing turns: the moving clump stops, and the other takes over its velocity, as spheres do."""
    across = 2 * 0.4 * D
    notch = math.sqrt(D**2 - across**2 / 2)
    ways: dict[str, tuple[Clumps, tuple, tuple, float]] = {
        "three spheres on three": (TRIPOD, FLAT, FLAT, D),
        "end to end": (PAIR, UPRIGHT, UPRIGHT, D + across),
        "side by side": (PAIR, ALONG, ALONG, D),
        "crossed, each in the notch of the other": (PAIR, ALONG, ACROSS, notch),
        "tip to tip of two jacks": (JACK, UPRIGHT, TURNED, D + 1.4 * D),
    }
    for name, (grains, first, second, touch) in ways.items():
        dt = math.pi * math.sqrt(grains.mass / 8 / STIFFNESS) / 500
        scene = clumps(grains, 2, Primitives(), normal_stiffness=STIFFNESS, friction=0.5, restitution=1,
                       tangential_damping=0.0)  # fmt: skip
        x = [[0.1, 0.1, 0.1 + touch + 2.5 * SPEED * dt], [0.1, 0.1, 0.1]]
        start = clumps_at(x, [first, second], [[0.0, 0.0, -SPEED], [0.0, 0.0, 0.0]])
        end = sound(follow(platform, MemberStart(scene, dt, start), 8, 250)).end
        wrong = float(np.abs(end.v - [[0.0, 0.0, 0.0], [0.0, 0.0, -SPEED]]).max()) / SPEED
        yield within(platform, name, "velocities exchanged", wrong, limited(1e-5, roundings=100, steps=1000))
        spin = float(np.abs(end.omega).max()) * D / SPEED
        # contacts that begin a rounding apart turn clumps by their levers
        yield within(platform, name, "spin", spin, limited(1e-8, roundings=1000, steps=1000))


def _stacked(platform: Platform) -> Iterator[Ending]:
    """Plates exactly on top of one another, and pairs that lie in the notches of those below."""
    law = {"normal_stiffness": STIFFNESS, "friction": 0.5, "rolling_friction": 0.01, "restitution": 0.2}
    here = clumps(TRIPOD, 4, Primitives(parts=(floor(),)), G, **law)
    x = [[0.0, 0.0, 0.5 * D + k * D] for k in range(4)]
    motion = yield from rest_at_end(
        platform, "4 plates on one another", MemberStart(here, DT, clumps_at(x, [FLAT] * 4))
    )
    aside = float(np.abs(motion.end.x[:, :2]).max()) / D
    yield within(platform, "4 plates on one another", "aside", aside, limited(1e-6, "d", roundings=1000))
    box = Box(width=1.801 * D, depth=1.801 * D, height=1.0)
    here = clumps(PAIR, 6, box, G, **law)
    rise = math.sqrt(D**2 - 2 * (0.4 * D) ** 2)
    x = [[0.0, 0.0, 0.5 * D + k * rise] for k in range(6)]
    start = clumps_at(x, [(ALONG, ACROSS)[k % 2] for k in range(6)])
    yield from rest_at_end(platform, "6 pairs crossed in a box", MemberStart(here, DT, start))


def _coincident(platform: Platform) -> Iterator[Ending]:
    """Two clumps in one place, and a sphere of one within another: forces of 0/0, and overlaps of a diameter."""
    law = {"normal_stiffness": STIFFNESS, "friction": 0.5}
    for name, apart in {"in one place": 0.0, "a tenth of d apart": 0.1 * D}.items():
        start = clumps_at([[0.1, 0.1, 0.1], [0.1 + apart, 0.1, 0.1]], [UPRIGHT, UPRIGHT])
        course = follow(platform, MemberStart(clumps(PAIR, 2, Primitives(), G, **law), 1e-6, start), 2)
        yield guard_error(name, course)


CASES = [
    StressCase(
        name="clumps-aligned",
        attempt="clumps that meet at several spheres at once: faces, ends, notches, tips, exactly",
        oracle="elastic exchange of velocities; no spin, by symmetry",
        run=_aligned,
    ),
    StressCase(
        name="clumps-stacked",
        attempt="plates of three spheres exactly on one another, pairs in the notches of those below",
        oracle="static balance",
        run=_stacked,
    ),
    StressCase(
        name="clumps-coincident",
        attempt="two clumps in one place",
        oracle="a named error",
        run=_coincident,
    ),
]
