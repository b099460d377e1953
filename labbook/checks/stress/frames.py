"""The same motion in another setting: far from the origin, in other units, seen from a moving frame, on steep slopes;
and for ten million steps."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from labbook.backend.probes import Sample
from labbook.checks.stress.case import Ending, StressCase, within
from labbook.checks.stress.impacts import ANGLES, PER_CONTACT, RIGID, SPEED, glancing
from labbook.checks.stress.watch import follow, sound
from labbook.checks.verify.case import limited
from labbook.checks.verify.collision import duration
from labbook.checks.verify.materials import LAWS, D, G, room, scene, spheres
from labbook.checks.verify.platform import MemberStart, Platform
from labbook.checks.verify.rolling import DT as ROLLING_DT
from labbook.checks.verify.rolling import lever, resting_on, slope
from labbook.checks.verify.rolling_spring import MILLION, THRESHOLD, pyramid
from labbook.scene import Box, Plane, Primitives, Scene, Wall
from labbook.scene.packing import Packing

SOFT: Mapping[str, Mapping[str, float]] = {"hertz-mindlin": {"shear_modulus": 1e7}, "linear": {"normal_stiffness": 2e3}}
STEP = 2e-6
"""A hundredth of a collision of soft grains or less [s]."""
STEPS = 4000
"""Steps in which falling grains touch the floor and one another, before round-off has grown much."""
SIDE = 8 * D


def _point(at: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (float(c) for c in at)
    return x, y, z


def _walls(at: np.ndarray) -> Primitives:
    """A box of SIDE, open above, whose bottom has its middle at `at` [m]."""
    half = 0.5 * SIDE
    sides = {
        "left": ((-half, 0, 0), (1, 0, 0)),
        "right": ((half, 0, 0), (-1, 0, 0)),
        "front": ((0, -half, 0), (0, 1, 0)),
        "back": ((0, half, 0), (0, -1, 0)),
        "bottom": ((0, 0, 0), (0, 0, 1)),
    }
    parts = [
        Wall(name=name, shape=Plane(point=_point(at + point), normal=normal)) for name, (point, normal) in sides.items()
    ]
    return Primitives(parts=tuple(parts))


def _cluster(quantum: float) -> Packing:
    """Twelve grains close to one another and to the floor, falling; positions are multiples of `quantum` [m]."""
    rng = np.random.default_rng(7)
    sites = np.array([[i, j, k] for i in (-1, 0, 1) for j in (-1, 0) for k in (0, 1)], float)
    x = sites * 1.02 * D + [0, 0.5 * D, 0.52 * D] + rng.uniform(0, 0.01 * D, sites.shape)
    v = rng.normal(0, 0.2, x.shape) - [0, 0, 0.3]
    x = np.round(x / quantum) * quantum if quantum else x
    return Packing(x=x, v=v, omega=rng.normal(0, 50, x.shape))


AWAY = 1000.0
"""Displacement of the scene along every axis [m]."""
ULP = 2.0**-43
"""Spacing of numbers in double precision near AWAY [m]."""


def _far(platform: Platform) -> Iterator[Ending]:
    """Positions far away have a resolution of 2^-43 m: each step rounds each coordinate by up to half of that."""
    for law in LAWS:
        ends = []
        for at in (np.zeros(3), np.full(3, AWAY)):
            here = scene(12, LAWS[law](**SOFT[law]), _walls(at), G)
            start = _cluster(ULP)
            trajectory = sound(follow(platform, MemberStart(here, STEP, replace(start, x=start.x + at)), 4, STEPS // 4))
            order = trajectory.end.rows(np.arange(12))
            ends.append((trajectory.end.x[order] - at, trajectory.end.v[order], len(trajectory.end.pairs)))
        (x, v, pairs), (far_x, far_v, _) = ends
        part = f"{law}, {pairs} contacts between grains"
        # a rounding a step, which the contacts of a cluster may multiply some tenfold
        limit = 20 * STEPS * 0.5 * ULP
        yield within(platform, part, "position", float(np.abs(x - far_x).max()), limited(limit, "m", roundings=D))
        moved = float(np.abs(v - far_v).max())
        yield within(platform, part, "velocity", moved, limited(limit / (STEP * PER_CONTACT), "m/s", roundings=300))


LENGTH, TIME, MASS = 3.7, 1.9, 0.6
"""Factors between the units; none is a power of two, which would leave the digits as they are."""


def _units(platform: Platform) -> Iterator[Ending]:
    """All numbers are rounded again; collisions let that grow, so the motion is short."""
    stiffness = {"shear_modulus": MASS / (LENGTH * TIME**2), "normal_stiffness": MASS / TIME**2}
    for law in LAWS:
        (key, value), *_ = SOFT[law].items()
        original = scene(12, LAWS[law](**SOFT[law]), Box(width=SIDE, depth=SIDE, height=SIDE), G)
        grains = spheres(12).model_copy(update={"diameter": LENGTH * D, "density": 2500 * MASS / LENGTH**3})
        box = Box(width=LENGTH * SIDE, depth=LENGTH * SIDE, height=LENGTH * SIDE)
        contact = LAWS[law](**{key: value * stiffness[key]})
        rescaled = Scene(grains=grains, contact=contact, container=box, gravity=G * LENGTH / TIME**2)
        start = _cluster(0.0)
        scaled = Packing(x=start.x * LENGTH, v=start.v * (LENGTH / TIME), omega=start.omega / TIME)
        a = sound(follow(platform, MemberStart(original, STEP, start), 4, STEPS // 4)).end
        b = sound(follow(platform, MemberStart(rescaled, STEP * TIME, scaled), 4, STEPS // 4)).end
        first, second = (end.rows(np.arange(12)) for end in (a, b))
        off = float(np.abs(a.x[first] - b.x[second] / LENGTH).max()) / D
        yield within(platform, law, "position", off, limited(1e-11, "d", roundings=1000))
        off = float(np.abs(a.v[first] - b.v[second] * (TIME / LENGTH)).max()) / SPEED
        yield within(platform, law, "velocity", off, limited(1e-10, roundings=1e4))


DRIFT = np.array([40.0, -30.0, 20.0])
"""Velocity of the frame [m/s]."""


def _moving(platform: Platform) -> Iterator[Ending]:
    """An impact that the whole scene moves along with; contacts see velocities as differences."""
    fast = float(np.linalg.norm(DRIFT)) / SPEED
    for law in LAWS:
        here = scene(2, LAWS[law](**RIGID[law]), room(4.0))
        for angle in ANGLES:
            dt = duration(here, SPEED * math.cos(angle)) / PER_CONTACT
            ends = []
            for drift in (np.zeros(3), DRIFT):
                start = glancing(angle, dt, drift, np.array([0.0, 0.0, 1.0]))
                trajectory = sound(follow(platform, MemberStart(here, dt, start), 4, PER_CONTACT))
                ends.append((trajectory.end.v - drift, trajectory.end.omega))
            off = float(np.abs(ends[0][0] - ends[1][0]).max()) / SPEED
            spun = float(np.abs(ends[0][1] - ends[1][1]).max()) * D / SPEED
            # overlaps of 1e-8 m are differences of positions of 1 m; velocities are rounded at DRIFT
            measure = limited(1e-7, roundings=16, steps=2 * PER_CONTACT * fast)
            part = f"{law}, {angle:g} rad"
            yield within(platform, part, "velocity", off, measure)
            yield within(platform, part, "spin", spun, measure)


SLOPES = tuple(math.radians(degrees) for degrees in (0.01, 45.0, 80.0, 89.0))
INCLINE_STEPS, INCLINE_BEATS = 1000, 20
MOTION = Sample(fields=("v", "omega"))


def _inclines(platform: Platform) -> Iterator[Ending]:
    """A sphere rolls down at g sin t/(1 + 2/5 (R/l)^2) while tan t < mu (1 + 5/2 (l/R)^2), else slides down at
    g (sin t - mu cos t); l is the lever, R - delta."""
    for law in LAWS:
        for angle in SLOPES:
            for friction in (0.1, 5.0):
                here = slope(law, angle, friction, 0.0)
                start = MemberStart(here, ROLLING_DT, resting_on(here, angle))
                trajectory = sound(follow(platform, start, INCLINE_BEATS, INCLINE_STEPS, [MOTION]))
                vx, vz = np.moveaxis(trajectory.by_beat(MOTION, ("vx", "vz"))[:, 0], -1, 0)
                speed, times = vx * math.cos(angle) - vz * math.sin(angle), trajectory.times(MOTION)
                half = len(times) // 2
                measured = (speed[-1] - speed[half]) / (times[-1] - times[half])
                lever_arm = 2 * lever(here, angle) / D
                rolls = math.tan(angle) < friction * (1 + 2.5 * lever_arm**2)
                expected = math.sin(angle) - (0 if rolls else friction * math.cos(angle))
                expected *= G / (1 + 0.4 / lever_arm**2) if rolls else G
                part = f"{law}, {math.degrees(angle):g} deg, mu = {friction:g}: {'rolls' if rolls else 'slides'}"
                error = abs(measured / expected - 1)
                yield within(platform, part, "acceleration", error, limited(1e-6, roundings=16, steps=4e4))


def _stands(platform: Platform, steps: int) -> Iterator[Ending]:
    """Three spheres that only rolling springs hold, 2 % above the threshold of rolling friction."""
    beats = 1000  # a GPU prepares a beat as a whole: one of a million steps would take it minutes
    sample = Sample(fields=("x",), every=beats // 10)
    bed, start = pyramid(1.02 * THRESHOLD, "epsd")
    trajectory = sound(follow(platform, MemberStart(bed, ROLLING_DT, start), beats, steps // beats, [sample]))
    x = trajectory.by_beat(sample, "xyz") / D
    moved = float(np.abs(x[-1] - x[0]).max())
    # springs, below 6e-4 d, lose up to a rounding a step
    measure = limited(1e-9, "d", roundings=6e-4 * steps)
    yield within(platform, f"{steps:,} steps".replace(",", " "), "moved in the last nine tenths", moved, measure)


CASES = [
    StressCase(
        name="far",
        attempt="a falling cluster 1000 m from the origin along every axis",
        oracle="the same at the origin, to the round-off of positions",
        run=_far,
    ),
    StressCase(
        name="units",
        attempt="lengths x 3.7, times x 1.9, masses x 0.6",
        oracle="dimensional analysis: the same motion, to round-off",
        run=_units,
    ),
    StressCase(
        name="moving-frame",
        attempt="impacts in a frame that moves at 54 m/s, without gravity",
        oracle="Galilean invariance",
        run=_moving,
    ),
    StressCase(
        name="incline",
        attempt="a sphere on slopes from 0.01 to 89 deg, friction 0.1 and 5",
        oracle="exact acceleration: 5/7 g sin t rolling, g (sin t - mu cos t) sliding",
        run=_inclines,
    ),
    StressCase(
        name="pyramid",
        attempt="three spheres that rolling springs hold, for 1e5 steps",
        oracle="moves less than a bound",
        run=partial(_stands, steps=MILLION // 10),
    ),
    StressCase(
        name="pyramid-long",
        attempt="three spheres that rolling springs hold, for 1e7 steps",
        oracle="moves less than a bound",
        run=partial(_stands, steps=10 * MILLION),
        slow=True,
        seconds=3600.0,
    ),
]
