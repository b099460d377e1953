"""Rods and spheres on the rim of a round hole, at rest or turning: two points at once, and friction that carries.

A rod lies on both points of a rim where nothing else touches it: on the open end of a tube, or on a ring too narrow
for its ends. On a wide plate it is its ends that carry it.
"""

import math
from collections.abc import Mapping

import numpy as np

from labbook.backend.probes import Contacts, Sample
from labbook.checks.verify.case import Case, limited
from labbook.checks.verify.materials import G
from labbook.checks.verify.platform import MemberStart, Platform, grains_at, require
from labbook.checks.verify.rods import HALF, ROD, R, rods, rods_at, towards
from labbook.scene import Frustum, LinearSpringDashpot, Primitives, Scene, Spheres, SurfaceMotion, Wall
from labbook.scene.orientation import axes

RIM = 3.5e-3
"""Radius of the hole [m]; both ends of a rod that lies across it are further from the rim than a radius."""
ENDS = {"tube": (RIM, -20e-3), "ring": (4e-3, 0.0), "plate": (40e-3, 0.0)}
"""Outer ends in radius and z [m]."""
MOTION = Sample(fields=("x", "v", "omega", "q"))


def wall(kind: str, spin: float = 0.0) -> Wall:
    """A wall of this kind with its rim at z = 0, which turns at `spin` [rad/s]."""
    return Wall(name="rim", shape=Frustum(lower=(RIM, 0), upper=ENDS[kind]), motion=SurfaceMotion(spin=spin))


def lying(off: float, at: float, stiffness: float) -> tuple[np.ndarray, float, float]:
    """A rod at rest on two points at -at and +at [m], its middle at `off` [m]: their forces [N] by the lever rule, its
    tilt (slope), and the height [m] of its middle above them. stiffness: of a contact [N/m]."""
    forces = ROD.mass * G * np.array([0.5 - off / (2 * at), 0.5 + off / (2 * at)])
    low, high = R - forces / stiffness
    tilt = (high - low) / (2 * at)
    return forces, tilt, (low + high) / 2 + off * tilt


def _lies(platform: Platform) -> Mapping[str, float]:
    """Rods at rest across the hole, their middles 1 mm off the middle of a chord: the lever rule."""
    stiffness, off, beside, errors = 2e4, 1e-3, 1.5e-3, {}
    contacts = Contacts(every=10)
    for kind in ENDS:
        at = HALF if kind == "plate" else math.sqrt(RIM**2 - beside**2)  # of the two points from the chord's middle
        shift = 0.0 if kind == "plate" else off
        forces, tilt, height = lying(shift, at, stiffness)
        scene = rods(1, Primitives(parts=(wall(kind),)), G, restitution=0.3)
        q = towards(np.array([1.0, 0.0, tilt]) / math.hypot(1, tilt))
        # a little too high: it has to come to rest
        start = rods_at([[shift, beside, height + 0.1 * (R - height)]], [q])
        rows = platform.run(MemberStart(scene, 2e-6, start), 10, 1000, [contacts]).rows(contacts)
        # where its ends carry a rod, it is as far from the rim as a radius: rounding decides whether it touches
        force = np.linalg.norm([rows[name] for name in ("fx", "fy", "fz")], axis=0)
        fz, bx = (rows[name][force > 1e-6 * ROD.mass * G] for name in ("fz", "bx"))
        require(len(fz) == 2, f"{len(fz)} points carry the rod on the {kind}, not two")
        order = np.argsort(bx)
        errors[f"forces, {kind}"] = float(np.abs(fz[order] - forces).max()) / (ROD.mass * G)
        errors[f"places, {kind}"] = float(np.abs(bx[order] + shift - [-at, at]).max()) / HALF
    return errors


def rocking(x, axis, stiffness: float, times: np.ndarray) -> np.ndarray:
    """Centre [m] and axis of an elastic rod without friction that rocks on a rim: shape [times, 6].

    A rigid body on the springs of two points of the rim, each sought on the circle, by Newton's method from where the
    level rod has it, as the one nearest to the rod's line.
    """
    from scipy.integrate import solve_ivp

    beside = x[1]
    angles = [math.atan2(beside, sign * math.sqrt(RIM**2 - beside**2)) for sign in (-1, 1)]

    def slope(_, state):
        x, v, a, w = state.reshape(4, 3)
        force, torque = np.array([0.0, 0.0, -ROD.mass * G]), np.zeros(3)
        for angle in angles:
            across = d = np.zeros(3)
            for _step in range(6):
                c, s = math.cos(angle), math.sin(angle)
                q, along = np.array([RIM * c, RIM * s, 0]), np.array([-RIM * s, RIM * c, 0])
                d = q - x
                across = d - (d @ a) * a
                angle -= (along @ across) / (along @ along - (along @ a) ** 2 - q @ across)
            distance = math.sqrt(across @ across)
            push = -max(stiffness * (R - distance), 0.0) / distance * across
            force = force + push
            torque = torque + np.cross((d @ a) * a, push)
        return np.concatenate([v, force / ROD.mass, np.cross(w, a), torque / ROD.inertia])

    start = np.concatenate([x, np.zeros(3), axis, np.zeros(3)])
    how = {"method": "DOP853", "rtol": 1e-9, "atol": 1e-13, "max_step": 5e-5}
    y = solve_ivp(slope, (0, times[-1]), start, t_eval=times, **how).y.T
    return np.column_stack([y[:, :3], y[:, 6:9]])


def _rocks(platform: Platform) -> Mapping[str, float]:
    tilt, beside, stiffness = 0.15, 1.5e-3, 2e3
    at = math.sqrt(RIM**2 - beside**2)
    axis = np.array([math.cos(tilt), 0.0, math.sin(tilt)])
    x = np.array([0.0, beside, R / math.cos(tilt) + at * math.tan(tilt)])  # the lower end is just off the rim
    scene = rods(1, Primitives(parts=(wall("tube"),)), G, normal_stiffness=stiffness, restitution=1.0)
    trajectory = platform.run(MemberStart(scene, 1e-6, rods_at([x], [towards(axis)])), 40, 500, [MOTION])
    expected = rocking(x, axis, stiffness, trajectory.times(MOTION))
    require(float(np.ptp(np.sign(expected[:, 5]))) == 2, "the rod has not rocked to the other side")
    q = trajectory.by_beat(MOTION, ("qw", "qx", "qy", "qz"))[:, 0]
    positions = trajectory.by_beat(MOTION, ("x", "y", "z"))[:, 0]
    return {
        "position": float(np.abs(positions - expected[:, :3]).max()) / R,
        "axis": float(np.abs(axes(q) - expected[:, 3:]).max()),
    }


def _rides(platform: Platform) -> Mapping[str, float]:
    """A rod across the middle of a turning tube's open end, 1 mm off along itself: it cannot roll outwards."""
    spin, off, stiffness = 5.0, 1e-3, 2e4
    scene = rods(1, Primitives(parts=(wall("tube", spin),)), G, friction=0.8, restitution=0.5)
    _, tilt, height = lying(off, RIM, stiffness)
    start = rods_at(
        [[off, 0.0, height]], [towards(np.array([1.0, 0.0, tilt]) / math.hypot(1, tilt))],
        [[0, spin * off, 0]], [[0, 0, spin]],
    )  # fmt: skip
    trajectory = platform.run(MemberStart(scene, 2e-6, start), 100, 2000, [MOTION])
    angle = spin * trajectory.times(MOTION)
    heading = np.column_stack([np.cos(angle), np.sin(angle)])
    q = trajectory.by_beat(MOTION, ("qw", "qx", "qy", "qz"))[:, 0]
    p = trajectory.by_beat(MOTION, ("x", "y"))[:, 0]
    return {
        "position": float(np.abs(p - off * heading).max()) / off,
        "heading": float(np.abs(axes(q)[:, :2] - heading).max()),
    }


FRICTION, SPEED = 0.2, 0.01
"""Of the turning rim; of the impact on it [m/s]."""


def _strikes(platform: Platform) -> Mapping[str, float]:
    """Grains fly straight at a rim that turns 10 times faster than they come: it slips under them all the time.

    The impulse along the normal is then 2 m v at e = 1, that of friction mu times it along the motion of the rim, and
    the spin its lever over the inertia: the radius, but for an overlap of 2e-4 of it. A rod comes along its own axis.
    """
    radius, law = 40e-3, {"normal_stiffness": 2e4, "friction": FRICTION, "restitution": 1.0}
    disc = Wall(
        name="rim", shape=Frustum(lower=(radius, 0), upper=(0.1, 0)), motion=SurfaceMotion(spin=10 * SPEED / radius)
    )
    container, errors = Primitives(parts=(disc,)), {}
    sphere = Spheres(diameter=2 * R, density=620, count=1)
    contact = LinearSpringDashpot.model_validate(law)
    # what strikes it, whether the rim or the plate behind it, at this angle from the vertical
    for tilt in (0.0, 0.3, 0.8):
        n, azimuth = np.array([-math.sin(tilt), 0.0, math.cos(tilt)]), np.array([0.0, 1.0, 0.0])
        foot = np.array([radius + (0.0 if tilt else R), 0.0, 0.0])
        speed = SPEED * (1 if tilt else foot[0] / radius)  # the plate is faster further out
        for name, grains, reach in (("sphere", sphere, 0.0), ("rod", ROD, HALF)):
            x = foot + n * (R + reach + 1e-9)
            start = grains_at(x, -speed * n) if name == "sphere" else rods_at([x], [towards(n)], [-speed * n])
            scene = Scene(grains=grains, contact=contact, container=container, gravity=0.0)
            trajectory = platform.run(MemberStart(scene, 2e-7, start), 1, 5000)
            v = speed * (n + 2 * FRICTION * azimuth)
            spin = np.cross(-(R + reach) * n, 2 * FRICTION * speed * azimuth) * grains.mass / grains.inertia
            label = f"{name} at {tilt:g} rad"
            errors[f"velocity, {label}"] = float(np.linalg.norm(trajectory.end.v[0] - v)) / speed
            errors[f"spin, {label}"] = float(np.linalg.norm(trajectory.end.omega[0] - spin) / np.linalg.norm(spin))
    return errors


CASES = [
    Case(
        name="rod-on-two-rim-points",
        statement="a rod at rest across a round hole is carried by two points of the rim, on a wide plate by its ends",
        source="lever rule",
        measures={f"{what}, {kind}": limited(1e-5, roundings=16) for kind in ENDS for what in ("forces", "places")},
        run=_lies,
    ),
    Case(
        name="rod-rocks-on-rim",
        statement="a rod across a round hole, off its middle, rocks from one point of the rim to the other",
        source="SciPy DOP853, rigid body on two springs",
        measures={"position": limited(1e-6, roundings=16, steps=1e3), "axis": limited(1e-6, roundings=16, steps=1e3)},
        run=_rocks,
    ),
    Case(
        name="rod-on-turning-rim",
        statement="a rod lying across the rotating open end of a tube rotates with it",
        source="friction",
        measures={"position": limited(1e-4, steps=2e4), "heading": limited(1e-6, roundings=16, steps=2e4)},
        run=_rides,
    ),
    Case(
        name="turning-rim-impact",
        statement="grains hitting a rotating plate or its rim get mu times the normal impulse along its motion",
        source="rigid body, Coulomb friction in full slip",
        measures={
            f"{quantity}, {name} at {tilt:g} rad": limited(3e-4, roundings=16)
            for tilt in (0.0, 0.3, 0.8)
            for name in ("sphere", "rod")
            for quantity in ("velocity", "spin")
        },
        run=_strikes,
    ),
]
