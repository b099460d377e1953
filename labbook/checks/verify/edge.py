"""A sphere rolls off the edge of a plate: the edge is a contact like any other.

Rigid bodies are the limit of stiff ones. Where the normal force decreases, a soft contact separates early (Fan's grains
by 2 % of cos t). The error falls with the root of the stiffness. So the grain here is 100 times stiffer than usual.
"""

import math
from collections.abc import Mapping
from functools import partial

import numpy as np

from labbook.backend.probes import Crossing, Sample
from labbook.checks.verify.case import Case, limited
from labbook.checks.verify.materials import D, G, linear, scene, spheres
from labbook.checks.verify.platform import MemberStart, Platform, Trajectory, require
from labbook.checks.verify.rolling import lever
from labbook.scene import CylinderSilo, Scene, SurfaceChange, WedgeHopper
from labbook.scene.packing import Packing

R = D / 2
DT = 2.5e-7
STEPS = 40
STIFF = 2e7 * spheres(1).mass * G / D
MOTION = Sample(fields=("x", "v", "omega"))
PROBES = (MOTION, Crossing(-3 * R))
HALF_OUTLET = 10 * D


def ledge(friction: float, rim: bool = False) -> Scene:
    """One grain in an open, wide and deep hopper; it rolls off the left plate, whose edge is at x = -HALF_OUTLET.

    rim: the edge of a round hole in place of a straight one.
    """
    plate = SurfaceChange(friction=friction, rolling_friction=0.0)
    if rim:
        silo = CylinderSilo(diameter=60 * D, height=40 * D, orifice=2 * HALF_OUTLET)
        return scene(1, linear(normal_stiffness=STIFF), silo, G, bottom=plate)
    hopper = WedgeHopper(width=60 * D, height=40 * D, thickness=40 * D, orifice=2 * HALF_OUTLET)
    return scene(1, linear(normal_stiffness=STIFF), hopper, G, **{"bottom-left": plate})


def at_edge(x: float, z: float, v: tuple[float, float] = (0.0, 0.0), spin: float = 0.0) -> Packing:
    """The grain at (x, z) [m] from the edge, with velocity in x and z [m/s] and spin about y [rad/s]."""
    return Packing(
        x=np.array([[x - HALF_OUTLET, 0.0, z]]),
        v=np.array([[v[0], 0.0, v[1]]]),
        omega=np.array([[0.0, spin, 0.0]]),
    )


def path(trajectory: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Times [s], and x, z from the edge [m], v_x, v_z [m/s] and spin about y [rad/s] at these: shape [times, 5]."""
    columns = trajectory.by_beat(MOTION, ("x", "z", "vx", "vz", "wy"))[:, 0].copy()
    columns[:, 0] += HALF_OUTLET
    return trajectory.times(MOTION), columns


def _leaves(platform: Platform, rim: bool = False) -> Mapping[str, float]:
    tilt = 0.2
    rough = ledge(1e4, rim)
    lever_arm = lever(rough, tilt)
    start = at_edge(lever_arm * math.sin(tilt), lever_arm * math.cos(tilt))
    _, p = path(platform.run(MemberStart(rough, DT, start), 3600, STEPS, PROBES))
    distance = np.hypot(p[:, 0], p[:, 1])
    last = np.flatnonzero(distance < R)[-1]
    cosine = p[last : last + 2, 1] / distance[last : last + 2]
    return {"|cos t / (10/17 cos t0) - 1|": abs(float(cosine.mean()) / (10 / 17 * math.cos(tilt)) - 1)}


def rolling_off(speed: float, run_up: float, friction: float, times: np.ndarray) -> np.ndarray:
    """Path of a rigid sphere that rolls to an edge, turns about it, slips on it, and flies: shape [times, 5].

    Integrated in stages, each to its own end: rolling over `run_up` [m]; no slip, t'' = (5/7) (g/R) sin t, while the
    friction needed, (2/7) m g sin t, is below mu N with N = m (g cos t - R t'^2); slip with friction mu N, until
    N = 0; free flight.

    Args:
        speed: Speed of rolling [m/s].
        run_up: Distance to the edge at the start [m].
        friction: Friction coefficient mu.
        times: Times [s], shape [n].

    Returns:
        x and z from the edge [m], v_x, v_z [m/s] and spin about y [rad/s].
    """
    from scipy.integrate import solve_ivp

    def normal(t, rate):
        return G * math.cos(t) - R * rate**2

    def sticks(_, s):
        return friction * normal(s[0], s[1]) - 2 / 7 * G * math.sin(s[0])

    def presses(_, s):
        return normal(s[0], s[1])

    for event in (sticks, presses):
        event.terminal, event.direction = True, -1  # type: ignore[attr-defined]

    def turning(_, s):
        return [s[1], 5 / 7 * G / R * math.sin(s[0])]

    def slipping(_, s):
        drag = friction * normal(s[0], s[1])
        return [s[1], (G * math.sin(s[0]) - drag) / R, 2.5 * drag / R]

    options = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-14, "dense_output": True}
    edge = run_up / speed
    turn = solve_ivp(turning, (0, 1), [0.0, speed / R], events=sticks, **options)
    slid = edge + float(turn.t[-1])
    t, rate = turn.y[:, -1]
    slip = solve_ivp(slipping, (0, 1), [t, rate, rate], events=presses, **options)
    off = slid + float(slip.t[-1])

    def at(time: float) -> list[float]:
        if time < edge:
            return [speed * time - run_up, R, speed, 0.0, speed / R]
        if time < slid:
            t, rate = turn.sol(time - edge)
            return _around(t, rate, rate)
        if time < off:
            return _around(*slip.sol(time - slid))
        x, z, vx, vz, spin = _around(*slip.y[:, -1])
        s = time - off
        return [x + vx * s, z + vz * s - G * s**2 / 2, vx, vz - G * s, spin]

    return np.array([at(float(time)) for time in times])


def _around(t: float, rate: float, spin: float) -> list[float]:
    s, c = math.sin(t), math.cos(t)
    return [R * s, R * c, R * rate * c, -R * rate * s, spin]


def _follows(platform: Platform, rim: bool = False) -> Mapping[str, float]:
    speed, run_up, friction = 0.06, 0.5 * R, 0.5
    plate = ledge(friction, rim)
    lever_arm = lever(plate)
    start = at_edge(-run_up, lever_arm, (speed, 0.0), speed / lever_arm)
    trajectory = platform.run(MemberStart(plate, DT, start), 6000, STEPS, PROBES)
    times, measured = path(trajectory)
    expected = rolling_off(speed, run_up, friction, times)
    flying = np.hypot(measured[:, 0], measured[:, 1]) > R
    require(bool(flying.any()), "the grain is still on the edge")
    off = np.abs(measured - expected)
    return {
        "position": float(off[:, :2].max()) / R,
        "velocity, of sqrt(g R)": float(off[:, 2:4].max()) / math.sqrt(G * R),
        "spin, of the last": float(off[:, 4].max()) / expected[-1, 4],
        "passage time": _passage(trajectory, times, expected),
    }


def _passage(trajectory: Trajectory, times: np.ndarray, expected: np.ndarray) -> float:
    crossing = trajectory.rows(PROBES[1])["time"]
    require(len(crossing) == 1, "the grain did not pass the plane below the edge once")
    passes = float(np.interp(3 * R, -expected[:, 1], times))
    return abs(float(crossing[0]) / passes - 1)


CASES = [
    Case(
        name="edge-without-slip",
        statement="a sphere turning about an edge without slip from rest at t0 leaves it at cos t = (10/17) cos t0",
        source="energy of a rigid body",
        measures={"|cos t / (10/17 cos t0) - 1|": limited(1e-3)},
        run=_leaves,
    ),
    Case(
        name="rim-without-slip",
        statement="a sphere turning about the rim of a round hole without slip leaves it as it does a straight edge",
        source="energy of a rigid body",
        measures={"|cos t / (10/17 cos t0) - 1|": limited(1e-3)},
        run=partial(_leaves, rim=True),
    ),
    *(
        Case(
            name=f"{name}-roll-off",
            statement=f"rolling, turning about {edge}, slipping on it and flying as integrated for a rigid sphere",
            source="SciPy DOP853, rigid body",
            measures={
                "position": limited(1e-5, "R", steps=2.4e5),
                "velocity, of sqrt(g R)": limited(1e-3),
                "spin, of the last": limited(1e-5, steps=2.4e5),
                "passage time": limited(1e-6, steps=2.4e5),
            },
            run=partial(_follows, rim=name == "rim"),
        )
        for name, edge in (("edge", "the edge"), ("rim", "the rim of a round hole"))
    ),
]
