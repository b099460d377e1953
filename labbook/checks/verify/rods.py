"""Rods: free tops, impacts off their centres, landing on a plane, sliding off a rim; and rods that are spheres."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from labbook.backend.probes import Ledger, Sample
from labbook.checks.verify.case import Case, Criterion, limited
from labbook.checks.verify.materials import G, floor
from labbook.checks.verify.platform import MemberStart, Platform, require
from labbook.filling.placing import place
from labbook.scene import (
    CylinderSilo,
    Frustum,
    LinearSpringDashpot,
    Primitives,
    Scene,
    Spheres,
    Spherocylinders,
    SurfaceMotion,
    Wall,
)
from labbook.scene.container import Container
from labbook.scene.orientation import axes
from labbook.scene.packing import Packing

ROD = Spherocylinders(diameter=6e-3, length=20e-3, density=620, count=1)
"""Pongo's rod of L/d = 3.3."""
R, HALF = ROD.radius, ROD.half_length
MOTION = Sample(fields=("x", "v", "omega", "q"))


def rods(count: int, container: Container, gravity: float = 0.0, **law) -> Scene:
    """Build a scene of rods with linear springs, without friction unless `law` states it."""
    contact = LinearSpringDashpot.model_validate({"normal_stiffness": 2e4, **law})
    grains = ROD.model_copy(update={"count": count})
    return Scene(grains=grains, contact=contact, container=container, gravity=gravity)


def towards(a) -> np.ndarray:
    """Quaternion of the shortest rotation that takes the z axis to the unit vector a."""
    w = math.sqrt((1 + a[2]) / 2)
    return np.array([w, -a[1] / (2 * w), a[0] / (2 * w), 0.0])


def rods_at(x, q, v=None, omega=None) -> Packing:
    """Build a packing of rods with orientations q [n, 4], at rest unless stated."""
    zero = np.zeros((len(x), 3))
    return Packing(
        x=np.asarray(x, float), v=zero if v is None else np.asarray(v, float),
        omega=zero if omega is None else np.asarray(omega, float), q=np.asarray(q, float),
    )  # fmt: skip


def _free(platform: Platform) -> Mapping[str, float]:
    """100 000 steps; the axis of a free symmetric top goes round its angular momentum at L/I_t."""
    a, omega = np.array([0.6, 0.0, 0.8]), np.array([10.0, 30.0, 50.0])
    momentum = ROD.inertia * omega + (ROD.inertia_axis - ROD.inertia) * (a @ omega) * a
    scene, probes = rods(1, Primitives()), (MOTION, Ledger())
    trajectory = platform.run(
        MemberStart(scene, 1e-5, rods_at([[0, 0, 0]], [towards(a)], omega=[omega])), 20, 5000, probes
    )
    rate, along = np.linalg.norm(momentum) / ROD.inertia, momentum / np.linalg.norm(momentum)
    q = trajectory.by_beat(MOTION, ("qw", "qx", "qy", "qz"))[:, 0]
    angle = rate * trajectory.times(MOTION)[:, None]
    expected = a * np.cos(angle) + np.cross(along, a) * np.sin(angle) + along * (along @ a) * (1 - np.cos(angle))
    table = trajectory.rows(probes[1])
    energy = 0.5 * omega @ momentum
    drift = np.array([table[name] for name in ("lx", "ly", "lz")]).T - momentum
    return {
        "axis": float(np.linalg.norm(axes(q) - expected, axis=1).max()),
        "energy": float(np.abs(table["kinetic"] / energy - 1).max()),
        "angular momentum": float(np.linalg.norm(drift, axis=1).max() / np.linalg.norm(momentum)),
    }


def _impact(platform: Platform) -> Mapping[str, float]:
    """Two rods that cross and meet off both their centres, while they turn: no friction, e = 1."""
    v, n = 1e-3, np.array([0.0, 0.0, 1.0])
    a = np.array([[1.0, 0.0, 0.0], [0.6, 0.8, 0.0]])
    lever_arms = np.array([5e-3, -3e-3])[:, None] * a
    q = [towards(axis) for axis in a]
    omega = np.array([[0.02, 0.03, 0.05], [-0.01, 0.02, 0.0]])
    speed = np.array([[2e-4, 0.0, -v], [0.0, 1e-4, 0.0]])
    gap = 2e-9
    x = np.array([lever_arms[1] - lever_arms[0] + (2 * R + gap) * n, [0.0, 0.0, 0.0]])
    scene = rods(2, Primitives(), normal_stiffness=2e5)
    trajectory = platform.run(MemberStart(scene, 2e-7, rods_at(x, q, speed, omega)), 1, 2000)

    tensors = [ROD.inertia * np.eye(3) + (ROD.inertia_axis - ROD.inertia) * np.outer(axis, axis) for axis in a]
    lever = np.cross(lever_arms, n)
    closing = float(n @ (speed[0] - speed[1]) + lever[0] @ omega[0] - lever[1] @ omega[1])
    reduced = 1 / sum(1 / ROD.mass + r @ np.linalg.solve(i, r) for r, i in zip(lever, tensors, strict=True))
    impulse = -2 * reduced * closing * np.array([[1.0], [-1.0]])
    spun = np.array([np.linalg.solve(i, r) for r, i in zip(lever, tensors, strict=True)]) * impulse
    after = axes(np.asarray(trajectory.end.q))
    require(float(np.abs(after - a).max()) < 1e-3, "the rods have turned")
    return {
        "velocities": float(np.abs(trajectory.end.v - speed - impulse / ROD.mass * n).max()) / v,
        "spins": float(np.abs(trajectory.end.omega - omega - spun).max() * HALF) / v,
    }


ANGLES = (0.0, 1e-4, 0.1, 0.7)
SPEED, RESTITUTION = 0.1, 0.9


def landed(angle: float, stiffness: float, speed: float) -> tuple[float, float]:
    """v_z [m/s] and spin [rad/s] of a rod after an impact at a plane: springs and dashpots at its ends, by SciPy.

    Textbook damping of e: gamma = 2 sqrt(k m) |ln e|/sqrt(pi^2 + ln^2 e); forces are never attractive. The rod turns
    about a horizontal axis across it: heights of the ends z -+ h sin t.
    """
    from scipy.integrate import solve_ivp

    damping = -2 * math.sqrt(stiffness * ROD.mass) * math.log(RESTITUTION) / math.hypot(math.pi, math.log(RESTITUTION))

    def slope(_, s):
        z, t, vz, w = s
        force = torque = 0.0
        for end in (-HALF, HALF):
            depth, rate = R - (z + end * math.sin(t)), vz + end * math.cos(t) * w
            push = max(stiffness * depth - damping * rate, 0.0) if depth > 0 else 0.0
            force += push
            torque += push * end * math.cos(t)
        return [vz, w, force / ROD.mass, torque / ROD.inertia]

    start = [R + HALF * math.sin(angle) + 1e-6, angle, -speed, 0.0]
    end = solve_ivp(slope, (0, 0.02), start, method="RK45", rtol=1e-8, atol=1e-12, max_step=2e-6)
    return float(end.y[2, -1]), float(end.y[3, -1])


def _lands(platform: Platform) -> Mapping[str, float]:
    errors = {}
    scene = rods(1, Primitives(parts=(floor(),)), restitution=RESTITUTION, damping="textbook")
    starts = []
    for angle in ANGLES:
        a = [math.cos(angle), 0.0, math.sin(angle)]
        height = R + HALF * math.sin(angle) + 1e-6
        starts.append(MemberStart(scene, 1e-7, rods_at([[0, 0, height]], [towards(a)], [[0, 0, -SPEED]])))
    trajectories = platform.run_all(starts, 20, 10_000)
    for angle, trajectory in zip(ANGLES, trajectories, strict=True):
        vz, spin = landed(angle, 2e4, SPEED)
        # about -y, a rod along x with its end at +x lifted turns upwards
        measured = float(trajectory.end.v[0, 2]), -float(trajectory.end.omega[0, 1])
        errors[f"at {angle:g} rad"] = max(abs(measured[0] - vz), abs(measured[1] - spin) * HALF) / SPEED
    errors["kept when flat"] = float(trajectories[0].end.v[0, 2]) / SPEED
    return errors


RIM = 40e-3


def tipping(speed: float, times: np.ndarray) -> np.ndarray:
    """u, t, u', t' of a rigid rod that slides without friction over an edge on which it lies: shape [times, 4].

    u [m]: distance from the rod's centre back to the point at the edge, negative beyond it; t: tilt [rad]. With a along
    the rod and n upwards across it, its centre is r n - u a from the edge. u and t follow from the second derivative of
    that, and from I t'' = -u N with the force N n at the edge.
    """
    from scipy.integrate import solve_ivp

    m, i = ROD.mass, ROD.inertia

    def slope(_, s):
        u, t, du, dt = s
        push = m * (2 * du * dt - R * dt**2 + G * math.cos(t)) / (1 + m * u**2 / i)
        ddt = -u * push / i
        return [du, dt, R * ddt + u * dt**2 - G * math.sin(t), ddt]

    return solve_ivp(slope, (0, times[-1]), [0, 0, -speed, 0], t_eval=times, rtol=1e-10, atol=1e-13).y.T


def _slides_off(platform: Platform) -> Mapping[str, float]:
    """A rod that lies on a plate with its centre above the rim of a round hole, moving towards the middle."""
    speed, stiffness, dt = 0.1, 2e5, 5e-7
    plate = Wall(name="plate", shape=Frustum(lower=(RIM, 0), upper=(0.2, 0)))
    scene = rods(1, Primitives(parts=(plate,)), G, normal_stiffness=stiffness, restitution=0.5)
    inwards = -np.array([math.cos(0.5), math.sin(0.5), 0.0])
    overlap = ROD.mass * G / stiffness  # all of the weight is on the rim: the end on the plate just does not touch
    along = inwards - [0, 0, overlap / HALF]
    start = rods_at([-RIM * inwards + [0, 0, R - overlap]], [towards(along)], [speed * inwards])
    trajectory = platform.run(MemberStart(scene, dt, start), 60, 2000, [MOTION])
    times = trajectory.times(MOTION)
    x = trajectory.by_beat(MOTION, ("x", "y", "z"))[:, 0]
    q = trajectory.by_beat(MOTION, ("qw", "qx", "qy", "qz"))[:, 0]
    measured = np.column_stack([x @ inwards + RIM, x[:, 2]])
    u, t, _, _ = tipping(speed, times).T
    require(float(u.min()) > -HALF, "the rod has slipped off")
    require(float(t.max()) > 0.3, "the rod has not tipped")
    expected = np.column_stack([R * np.sin(t) - u * np.cos(t), R * np.cos(t) + u * np.sin(t)])
    return {
        "position": float(np.abs(measured - expected).max()) / R,
        "tilt": float(np.abs(np.arcsin(-axes(q)[:, 2]) - t).max()),
    }


def _rides(platform: Platform) -> Mapping[str, float]:
    """A rod that lies on a turntable, at rest on it and along a radius, goes round with it: it cannot roll outwards."""
    spin, at = 5.0, np.array([0.05, 0.0])
    disc = Wall(name="disc", shape=Frustum(lower=(0, 0), upper=(0.2, 0)), motion=SurfaceMotion(spin=spin))
    scene = rods(1, Primitives(parts=(disc,)), G, friction=0.8, restitution=0.5)
    height = R - ROD.mass * G / (2 * 2e4)
    start = rods_at([[*at, height]], [towards([1.0, 0.0, 0.0])], [[0, spin * at[0], 0]], [[0, 0, spin]])
    trajectory = platform.run(MemberStart(scene, 2e-6, start), 100, 2000, [MOTION])
    p = trajectory.by_beat(MOTION, ("x", "y"))[:, 0]
    angle = spin * trajectory.times(MOTION)
    expected = np.column_stack([at[0] * np.cos(angle), at[0] * np.sin(angle)])
    a = axes(trajectory.by_beat(MOTION, ("qw", "qx", "qy", "qz"))[:, 0])
    heading = np.unwrap(2 * np.arctan2(a[:, 1], a[:, 0])) / 2
    return {
        "position": float(np.abs(p - expected).max()) / at[0],
        "heading": float(np.abs(heading - heading[0] - (angle - angle[0])).max()),
    }


def _spheres_too(platform: Platform) -> Mapping[str, float]:
    """Drop rods of L = d and spheres into a silo, for a time in which round-off has not grown yet."""
    d, law = 6e-3, LinearSpringDashpot(normal_stiffness=200, friction=0.5, rolling_friction=0.01, restitution=0.5)
    ends = []
    for grains in (
        Spheres(diameter=d, density=620, count=60),
        Spherocylinders(diameter=d, length=d, density=620, count=60),
    ):
        silo = CylinderSilo(diameter=8 * d, height=1.0, orifice=4 * d)
        bed = Scene(grains=grains, contact=law, container=silo, gravity=G).close()
        start = place(bed.model_copy(update={"grains": Spheres(diameter=d, density=620, count=60)}), "gas", 1)
        if grains.shape == "spherocylinder":
            start = replace(start, q=np.tile([1.0, 0, 0, 0], (60, 1)))
        ends.append(platform.run(MemberStart(bed, 1e-5, start), 1, 5000).end)
    touched = len(ends[0].wall_grain) + len(ends[0].pairs)
    require(touched > 10, "the grains have not met")
    return {
        "position": float(np.abs(ends[0].x - ends[1].x).max()) / d,
        "spin": float(np.abs(ends[0].omega - ends[1].omega).max() / np.abs(ends[0].omega).max()),
    }


CASES = [
    Case(
        name="rod-free-top",
        statement="a free rod turns as a symmetric top for 100 000 steps, and keeps energy and angular momentum",
        source="Landau & Lifshitz, Mechanics, section 33",
        measures={
            "axis": limited(1e-9, steps=100),
            "energy": limited(1e-8, steps=2),
            "angular momentum": limited(1e-8, steps=2),
        },
        run=_free,
    ),
    Case(
        name="rod-impact",
        statement="rods colliding off their centres exchange the impulse 2 m_red v_n, without friction at e = 1",
        source="rigid bodies, m_red = 1/sum(1/m + (r x n).I^-1 (r x n))",
        measures={"velocities": limited(1e-3), "spins": limited(1e-3)},
        run=_impact,
    ),
    Case(
        name="rod-landing",
        statement="a rod that lands on a plane, flat or at an angle, on one end or both, one after the other",
        source="SciPy, springs and dashpots at both ends",
        measures={**{f"at {angle:g} rad": limited(1e-3) for angle in ANGLES}, "kept when flat": Criterion({})},
        run=_lands,
    ),
    Case(
        name="rod-over-rim",
        statement="a rod slides over the rim of a round hole and tips into it",
        source="SciPy, rigid body on an edge",
        measures={"position": limited(2e-3), "tilt": limited(2e-3)},
        run=_slides_off,
    ),
    Case(
        name="rod-on-turntable",
        statement="a rod lying along a radius of a turntable rotates with it",
        source="friction",
        measures={"position": limited(1e-4, steps=2e4), "heading": limited(1e-3, steps=2e4)},
        run=_rides,
    ),
    Case(
        name="rod-without-length",
        statement="rods of L = d move as spheres do",
        source="geometry",
        measures={"position": limited(1e-10, roundings=100), "spin": limited(1e-9, roundings=1e4)},
        run=_spheres_too,
    ),
]
