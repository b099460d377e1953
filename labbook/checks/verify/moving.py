"""Parts of triangles that move: a plate that vibrates or rises under spheres, a turntable, a drum, and what it all does
to momentum and energy.

Sources: kinematics of rigid bodies, and conservation laws.
"""

import math
from collections.abc import Mapping

import numpy as np

from labbook.backend.probes import Dissipation, Ledger, Traction
from labbook.checks.verify.case import Case, limited
from labbook.checks.verify.materials import D, G, linear, scene
from labbook.checks.verify.mesh import CONTACTS, DT, MOTION, R, of_triangles, sheet
from labbook.checks.verify.platform import MemberStart, Platform, grains_at, require
from labbook.scene import PartMotion, PartRotation, Primitives, Scene, Vibration, Wall

FORCES = Traction(size=100 * D)
LEDGER = Ledger(every=1)
POWER = Dissipation()
TURNS = 100
NAMES = ("x", "y", "z", "vx", "vy", "vz", "wx", "wy", "wz")


def moving(wall: Wall, **motion) -> Wall:
    """The wall with a motion."""
    return wall.model_copy(update={"moves": PartMotion(**motion)})


def plate(cells: int = 2, half: float = 12 * R) -> Wall:
    """A square of triangles in z = 0."""
    return of_triangles(*sheet(cells, half))


def _scene_above(wall: Wall, count: int = 1, gravity: float = 0.0, **surface) -> Scene:
    law = linear(**{"friction": 0.0, "restitution": 1.0, **surface})
    return scene(count, law, Primitives(parts=(wall,)), gravity)


def _rising(platform: Platform) -> Mapping[str, float]:
    """A plate that rises or sinks at v_w throws a sphere back with v' = -v + 2 v_w, and does the work that it gains."""
    errors, work = [], []
    starts, speeds = [], (0.2, -0.1, 0.0)
    for speed in speeds:
        wall = moving(plate(), velocity=(0.05, 0.0, speed))
        starts.append(
            MemberStart(_scene_above(wall), 0.4 * DT, grains_at([0.3 * R, 0.2 * R, 1.05 * R], [0.0, 0.0, -0.3]))
        )
    for speed, trajectory in zip(speeds, platform.run_all(starts, 20, 50, [MOTION, CONTACTS, LEDGER]), strict=True):
        v = trajectory.end.v[0]
        errors.append(abs(v[2] - (0.3 + 2 * speed)) + abs(v[0]))
        mass = starts[0].scene.grains.mass
        table = trajectory.rows(LEDGER)
        work.append(abs(table["contact_work"][-1] - 0.5 * mass * ((0.3 + 2 * speed) ** 2 - 0.09)) / (mass * 0.09))
    return {"v' - (-v + 2 v_w)": float(max(errors)), "work/(m v^2)": float(max(work))}


def _vibrating(platform: Platform) -> Mapping[str, float]:
    """A sphere hits a plate that vibrates slowly against its contact time, at several phases: v' = -v + 2 v_w, with v_w
    that of the plate at the hit."""
    errors = []
    starts, phases, frequency, amplitude = [], (0.0, 1.0, 2.5, 4.0), 20.0, 1e-3
    for phase in phases:
        motion = Vibration(direction=(0.0, 0.0, 2.0), amplitude=amplitude, frequency=frequency, phase=phase)
        starts.append(
            MemberStart(
                _scene_above(moving(plate(), vibration=motion)), 0.2 * DT, grains_at([0, 0, 1.03 * R], [0, 0, -0.5])
            )
        )
    for phase, motion in zip(phases, platform.run_all(starts, 40, 50, [MOTION, CONTACTS]), strict=True):
        touching = motion.rows(CONTACTS)["time"]
        require(len(touching) > 2, "the sphere did not hit the plate")
        middle = (touching[0] + touching[-1]) / 2
        wall = 2 * math.pi * frequency * amplitude * math.cos(2 * math.pi * frequency * middle + phase)
        errors.append(abs(motion.end.v[0, 2] - (0.5 + 2 * wall)))
    return {"v' - (-v + 2 v_w)": float(max(errors))}


def _turntable(platform: Platform) -> Mapping[str, float]:
    """A sphere between two plates that turn about an axis aside goes round with them: its springs turn with them, and
    hold it against m w^2 r/2 each."""
    rate, radius, squeezed = 200.0, 2 * R, 2e-3 * R
    vertices, triangles = sheet(3, 6 * R)
    gap = np.array([0.0, 0.0, R - squeezed])
    both = np.concatenate([vertices - gap, vertices + gap]), np.concatenate([triangles, triangles + len(vertices)])
    origin = np.array([R, 0.5 * R, 0.0])
    turned = PartRotation(axis=(0.0, 0.0, 3.0), origin=(R, 0.5 * R, 0.0), rate=rate)
    of = _scene_above(moving(of_triangles(*both), rotation=turned), friction=1.0, restitution=0.2)
    start = grains_at(origin + np.array([radius, 0.0, 0.0]), [0.0, rate * radius, 0.0], [0.0, 0.0, rate])
    beats, dt = 50, 4 * DT
    steps = round(TURNS * 2 * math.pi / rate / dt / beats)
    trajectory = platform.run(MemberStart(of, dt, start), beats, steps, [MOTION, CONTACTS, LEDGER])
    x, y = (trajectory.by_beat(MOTION, ("x", "y"))[:, 0] - origin[:2]).T
    angle = np.arctan2(y, x) - rate * trajectory.times(MOTION)
    angle = np.mod(angle + math.pi, 2 * math.pi) - math.pi
    away, later = np.hypot(x, y), beats // 2
    mass, law = of.grains.mass, of.contact.model_dump()
    bent = mass * rate**2 * radius / (2 * law["normal_stiffness"] * law["tangential_stiffness"])
    return {
        "drift along its path, a turn/R": float(np.abs(angle[later:] - angle[later]).max()) * radius / R / TURNS,
        "drift outwards, a turn/R": float(np.abs(away[later:] - away[later]).max()) / R / TURNS,
        "springs/(m w^2 r/2 k_t) - 1": float(abs((away[-1] - radius) / bent - 1)),
    }


def box(half: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a cube around the origin."""
    ends = np.array([(x, y, z) for x in (-half, half) for y in (-half, half) for z in (-half, half)])
    sides = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    return ends, np.array([t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))])


def _balance(platform: Platform) -> Mapping[str, float]:
    """Spheres in a box that turns about an axis aside, sinks and vibrates: forces and torques on the box are what their
    momenta gain, and its power what their energy gains and loses in contacts."""
    motion = {
        "velocity": (0.02, 0.0, -0.05),
        "rotation": PartRotation(axis=(0.2, 1.0, 0.1), origin=(0.0, 0.0, R), rate=15.0),
        "vibration": Vibration(direction=(1.0, 0.0, 0.0), amplitude=0.05 * R, frequency=60.0, phase=0.4),
    }
    wall = moving(of_triangles(*box(2.3 * R)), **motion)
    of = _scene_above(wall, 8, G, friction=0.4, rolling_friction=0.0)
    x = np.array([(a, b, c) for a in (-1.2, 1.2) for b in (-1.2, 1.2) for c in (-1.2, 1.2)]) * R
    v = np.random.default_rng(4).uniform(-0.3, 0.3, (8, 3))
    probes = [MOTION, CONTACTS, LEDGER, FORCES, POWER]
    steps, beats = 1, 800
    run = platform.run(MemberStart(of, DT, grains_at(x, v)), beats, steps, probes)
    require(run.rows(FORCES)["contacts"].sum() > 20, "hardly a sphere touched the box")
    ledger, forces, power = (run.rows(probe) for probe in (LEDGER, FORCES, POWER))
    inside = np.abs(wall_frame(wall, run.end.x, beats * steps * DT)).max()
    times, mass = ledger["time"], 8 * of.grains.mass
    momentum = np.column_stack([ledger[name] for name in ("px", "py", "pz")])
    angular = np.column_stack([ledger[name] for name in ("lx", "ly", "lz")])
    force = _by_step(forces, ("fx", "fy", "fz"), ledger["step"])
    torque = _by_step(forces, ("tx", "ty", "tz"), ledger["step"])
    centre = run.by_beat(MOTION, ("x", "y", "z")).mean(axis=1)
    weight = np.array([0.0, 0.0, -mass * G])

    def gained(rate: np.ndarray) -> np.ndarray:
        return np.cumsum((rate[1:] + rate[:-1]) / 2 * np.diff(times)[:, None], axis=0)

    about = torque + np.cross(centre, weight)
    pushed = gained(force + weight) - (momentum[1:] - momentum[0])
    turned = gained(about) - (angular[1:] - angular[0])
    energy = ledger["kinetic"] + ledger["potential"]
    lost = power["normal_power"] + power["tangential_power"]
    change = gained((power["wall_power"] - lost)[:, None])[:, 0] - (energy[1:] - energy[0])
    pose = wall.moves.poses(times) if wall.moves is not None else None
    assert pose is not None
    of_wall = np.sum(force * pose.velocity + torque * pose.spin, axis=1)
    scale = float(np.linalg.norm(momentum, axis=1).max())
    return {
        "momentum": float(np.abs(pushed).max()) / scale,
        "angular momentum": float(np.abs(turned).max()) / (scale * 3 * R),
        "energy": float(np.abs(change).max() / energy.max()),
        "power of the part": float(np.abs(of_wall - power["wall_power"]).max() / np.abs(power["wall_power"]).max()),
        "farthest place in the box/R": max(float(inside) / R - 1.3, 0.0),
    }


def wall_frame(wall: Wall, x: np.ndarray, time: float) -> np.ndarray:
    """Points x [m], shape [n, 3], in the frame of a part that moves, at a time [s]."""
    if wall.moves is None:
        return x
    pose = wall.moves.poses(np.array([time]))
    return (x - pose.shift[0]) @ pose.turn[0]


def _by_step(rows: Mapping[str, np.ndarray], names: tuple[str, ...], steps: np.ndarray) -> np.ndarray:
    """Sums over bins of columns at each of the steps, shape [steps, columns]."""
    index = np.searchsorted(steps, rows["step"])
    return np.column_stack([np.bincount(index, rows[name], minlength=len(steps)) for name in names])


def _frames(platform: Platform) -> Mapping[str, float]:
    """Without gravity, spheres in a box see the same in a frame that moves with it: box and spheres with a velocity in
    common, or both turned, give the same motion."""
    x = np.array([(a, b, 0.0) for a in (-1.2, 1.2) for b in (-1.2, 1.2)]) * R
    v = np.random.default_rng(4).uniform(-0.5, 0.5, (4, 3))
    still, wind = of_triangles(*box(2.4 * R)), np.array([0.3, -0.2, 0.1])
    results = []
    for wall, push in ((still, 0.0), (moving(still, velocity=tuple(wind.tolist())), wind)):
        of = _scene_above(wall, 4, friction=0.4, restitution=0.8)
        run = platform.run(MemberStart(of, DT, grains_at(x, v + push)), 4, 250, [MOTION, CONTACTS, LEDGER])
        end = run.by_beat(MOTION, NAMES)[-1]
        end[:, :3] -= np.multiply(push, 1000 * DT)
        end[:, 3:6] -= push
        results.append(end)
    require(float(np.abs(results[0][:, :3] - x).max()) > R / 10, "no sphere moved")
    away = np.abs(results[1] - results[0]).max(axis=0)
    return {"x/R": float(away[:3].max()) / R, "v": float(away[3:6].max()), "spin R": float(away[6:].max()) * R}


CASES = [
    Case(
        name="moving-plate",
        statement="a plate that moves at v_w throws a sphere back with v' = -v + 2 v_w and does the work that it gains",
        source="elastic impact in the frame of the plate",
        measures={
            "v' - (-v + 2 v_w)": limited(1e-4, "m/s", roundings=2000, steps=2e4),
            "work/(m v^2)": limited(5e-4, roundings=2000, steps=2e4),
        },
        run=_rising,
    ),
    Case(
        name="moving-vibration",
        statement="a sphere that hits a vibrating plate gains 2 v_w of the plate at the hit",
        source="elastic impact; the contact takes 1/250 of a period",
        measures={"v' - (-v + 2 v_w)": limited(3e-4, "m/s", roundings=2000, steps=2e4)},
        run=_vibrating,
    ),
    Case(
        name="moving-turntable",
        statement="a sphere between turning plates goes round 100 times with them, held by springs that turn too",
        source="a body at rest in a turning frame",
        measures={
            "drift along its path, a turn/R": limited(1e-6, roundings=200, steps=1e4),
            "drift outwards, a turn/R": limited(1e-6, roundings=200, steps=1e4),
            "springs/(m w^2 r/2 k_t) - 1": limited(1e-2, roundings=200, steps=1e4),
        },
        run=_turntable,
    ),
    Case(
        name="moving-balance",
        statement="forces, torques and power of a box that turns, sinks and vibrates are what its grains gain",
        source="balances of momentum, angular momentum and energy",
        measures={
            "momentum": limited(1e-8, roundings=1000, steps=2e4),
            "angular momentum": limited(1e-8, roundings=1000, steps=2e4),
            "energy": limited(2e-3, roundings=1000, steps=2e4),
            "power of the part": limited(1e-5, roundings=1000, steps=2e4),
            "farthest place in the box/R": limited(0.05),
        },
        run=_balance,
    ),
    Case(
        name="moving-frames",
        statement="grains in a box that moves at a constant velocity see what those in a box at rest see",
        source="Galilean invariance",
        measures={
            "x/R": limited(1e-9, roundings=2000, steps=2e4),
            "v": limited(1e-9, "m/s", roundings=2000, steps=2e4),
            "spin R": limited(1e-9, "m/s", roundings=2000, steps=2e4),
        },
        run=_frames,
    ),
]
