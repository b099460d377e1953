"""A sphere that rolls on a turntable runs in circles of its own."""

import math
from collections.abc import Mapping
from functools import partial

import numpy as np

from labbook.backend.probes import Sample
from labbook.checks.verify.case import Case, Criterion, limited
from labbook.checks.verify.materials import D, G, floor, hertz, scene
from labbook.checks.verify.platform import MemberStart, Platform, grains_at
from labbook.checks.verify.rolling import lever
from labbook.scene import Frustum, Primitives, SurfaceMotion, Wall
from labbook.scene.scene import SurfaceChange

SPIN = 10.0
"""Of the table [rad/s]."""
MOTION = Sample(fields=("x", "v"))


DISC = Wall(name="floor", shape=Frustum(lower=(0, 0), upper=(0.2, 0)))
"""A round plate in place of a plane."""


def _circles(platform: Platform, plate: Wall) -> Mapping[str, float]:
    table = plate.model_copy(update={"motion": SurfaceMotion(spin=SPIN)})
    surface = SurfaceChange(friction=0.5, rolling_friction=0.0)
    turns = scene(1, hertz(), Primitives(parts=(table,)), G, floor=surface)
    lever_arm = lever(turns)
    x, v = np.array([0.05, 0.0]), np.array([0.03, 0.1])
    # rolling: v + omega x (-arm e_z) = SPIN e_z x r
    omega = [(SPIN * x[0] - v[1]) / lever_arm, (v[0] + SPIN * x[1]) / lever_arm, 0.0]
    start = grains_at([x[0], x[1], lever_arm], [v[0], v[1], 0.0], omega)
    rate = SPIN * 0.4 / (0.4 + (lever_arm / (D / 2)) ** 2)
    dt, steps = 1e-6, 5000
    beats = round(2 * math.pi / rate / dt / steps)
    trajectory = platform.run(MemberStart(turns, dt, start), beats, steps, [MOTION])
    p = trajectory.by_beat(MOTION, ("x", "y", "vx", "vy"))[:, 0]
    heading = np.unwrap(np.arctan2(p[:, 3], p[:, 2]))
    times = trajectory.times(MOTION)
    measured = (heading[-1] - heading[0]) / (times[-1] - times[0])
    centre = x + np.array([-v[1], v[0]]) / rate
    radius = np.hypot(*(p[:, :2] - centre).T)
    return {
        "relative error of the rate": abs(measured / rate - 1),
        "|rate/(2/7 of the table's) - 1|": abs(measured / (2 / 7 * SPIN) - 1),
        "radius over v/rate": float(np.abs(radius / (math.hypot(*v) / rate) - 1).max()),
    }


CASES = [
    Case(
        name=name,
        statement=f"a sphere rolling on a {table} circles at 2/7 of its angular velocity",
        source="rigid body, lever R - delta",
        measures={
            "relative error of the rate": limited(1e-6, steps=2e4),
            "|rate/(2/7 of the table's) - 1|": Criterion({}),
            "radius over v/rate": limited(1e-5, steps=2e4),
        },
        run=partial(_circles, plate=plate),
    )
    for name, table, plate in (("turntable", "turntable", floor()), ("turntable-round", "round turntable", DISC))
]
