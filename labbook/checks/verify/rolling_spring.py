"""Rolling resistance with a spring (`contact.rolling_model: epsd`): oscillation, mobilised torque, and rest."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from labbook.backend.probes import Sample
from labbook.checks.verify.case import Case, Criterion, limited
from labbook.checks.verify.materials import LAWS, D, G, floor, linear, scene
from labbook.checks.verify.platform import MemberStart, Platform, grains_at, require
from labbook.checks.verify.rolling import (
    DT,
    MOTION,
    STEPS,
    accelerations,
    lever,
    rolling_down,
    slope,
    static_overlap,
)
from labbook.scene import LinearSpringDashpot, Plane, Primitives, Scene, SurfaceChange, Wall
from labbook.scene.packing import Packing

R = D / 2
MILLION = 1_000_000
"""Steps for which grains at rest have to stay at rest."""
WEAK, STRONG = 0.01, 0.1
"""Rolling friction in the cases of oscillation and of rest on a slope."""
DAMPED = 0.3


def sprung(law: str, angle: float, rolling: float, damping: float = DAMPED) -> Scene:
    """One grain on a slope, with rolling springs."""
    plain = slope(law, angle, 0.5, rolling)
    contact = plain.contact.model_copy(update={"rolling_model": "epsd", "rolling_damping": damping})
    return plain.model_copy(update={"contact": contact})


def stiffness(here: Scene, rolling: float) -> float:
    """k_r [N m] of the grain on a flat plane: 2.25 k_n mu_r^2 R^2 with k_n = m g/delta."""
    weight = here.grains.mass * G
    return 2.25 * weight / static_overlap(here, weight) * (rolling * R) ** 2


def textbook(here: Scene, rolling: float, damping: float) -> tuple[float, float]:
    """Angular frequency [rad/s] and damping ratio of a sphere that rolls to and fro without slip, about its contact."""
    about = here.grains.inertia + here.grains.mass * lever(here) ** 2
    ratio = damping * math.sqrt(1.4 * here.grains.mass * R**2 / about)
    return math.sqrt(stiffness(here, rolling) / about * (1 - ratio**2)), ratio


def oscillation(here: Scene, rolling: float, damping: float, spin: float, times: np.ndarray) -> np.ndarray:
    """Spin [rad/s] at some times of a sphere that begins to roll on springs of friction and of rolling, linear law.

    s' = v - l w, m v' = -k_t s - g_t s', I w' = l (k_t s + g_t s') + M - C_r w, M' = -k_r w for slip s, torque M.
    """
    from scipy.linalg import expm

    law, grains, l = here.contact, here.grains, lever(here)
    assert isinstance(law, LinearSpringDashpot)
    k_t = law.tangential_stiffness * law.normal_stiffness
    g_t = (
        law.tangential_damping * 2 * law.damping_ratio(law.restitution) * math.sqrt(law.normal_stiffness * grains.mass)
    )
    k_r = stiffness(here, rolling)
    c_r = 2 * damping * math.sqrt(1.4 * grains.mass * R**2 * k_r)
    pull = np.array([k_t, g_t, -g_t * l, 0.0])  # of the friction's spring and dashpot on (s, v, w, M)
    motion = np.array([[0.0, 1.0, -l, 0.0], -pull / grains.mass, l * pull / grains.inertia, [0.0, 0.0, -k_r, 0.0]])
    motion[2] += np.array([0.0, 0.0, -c_r, 1.0]) / grains.inertia
    start = np.array([0.0, spin * l, spin, 0.0])
    step = expm(motion * (times[1] - times[0]))
    states = [expm(motion * times[0]) @ start]
    for _ in times[1:]:
        states.append(step @ states[-1])
    return np.array(states)[:, 2]


def begins_to_roll(here: Scene, rolling: float, spin: float, dt: float) -> Packing:
    """Place the grain on its plane as it begins to roll.

    The backend advances springs before they first act, so the springs start one step behind.
    """
    packing = grains_at([0.0, 0.0, lever(here)], [spin * lever(here), 0.0, 0.0], [0.0, spin, 0.0])
    return replace(
        packing,
        wall_grain=np.zeros(1, np.int64),
        wall_name=np.array(["floor"]),
        wall_spring=np.zeros((1, 3)),
        wall_rolling=np.array([[0.0, stiffness(here, rolling) * spin * dt, 0.0]]),
    )


def _oscillates(platform: Platform) -> Mapping[str, float]:
    errors, periods, ratios = {}, [], []
    for law in LAWS:
        for damping in (0.0, DAMPED):
            here = sprung(law, 0.0, WEAK, damping)
            frequency, ratio = textbook(here, WEAK, damping)
            limit = WEAK * here.grains.mass * G * R
            spin = 0.5 * limit / stiffness(here, WEAK) * frequency  # half of what mobilises the spring
            beats = round(3 * 2 * math.pi / frequency / DT / STEPS)
            begun = begins_to_roll(here, WEAK, spin, DT)
            trajectory = platform.run(MemberStart(here, DT, begun), beats, STEPS, [MOTION])
            times, spins = trajectory.times(MOTION), trajectory.by_beat(MOTION, ("wy",))[:, 0, 0]
            if law == "linear":
                exact = oscillation(here, WEAK, damping, spin, times)
                errors[f"spin, eta = {damping:g}"] = float(np.abs(spins - exact).max()) / spin
            falls = np.flatnonzero(np.diff(np.sign(spins)))
            require(len(falls) >= 4, "the grain does not roll to and fro")
            zeros = times[falls] + spins[falls] / (spins[falls] - spins[falls + 1]) * STEPS * DT
            periods.append(float(np.diff(zeros).mean()) * frequency / math.pi - 1)
            if damping:
                first, last = (np.abs(spins[a:b]).max() for a, b in ((falls[0], falls[1]), (falls[1], falls[2])))
                decrement = math.log(first / last) / math.pi
                ratios.append(decrement / math.hypot(1, decrement) / ratio - 1)
    return {
        **errors,
        "period - textbook": float(np.abs(periods).max()),
        "damping ratio - textbook": float(np.abs(ratios).max()),
    }


def _slows_down(platform: Platform) -> Mapping[str, float]:
    errors = {}
    for law in LAWS:
        here, speed = sprung(law, 0.0, STRONG), 0.1
        begun = begins_to_roll(here, STRONG, speed / lever(here), DT)
        trajectory = platform.run(MemberStart(here, DT, begun), round(0.1 / DT / STEPS), STEPS, [MOTION])
        times, speeds = trajectory.times(MOTION), trajectory.by_beat(MOTION, ("vx",))[:, 0, 0]
        half = len(times) // 2
        slowing = (speeds[-1] - speeds[half]) / (times[-1] - times[half])
        errors[law] = abs(slowing / rolling_down(here, 0.0, STRONG) - 1)
    return errors


def _rests(platform: Platform) -> Mapping[str, float]:
    errors = {}
    for law in LAWS:
        angle = math.atan(0.99 * STRONG)
        below, above = sprung(law, angle, STRONG), sprung(law, math.atan(1.01 * STRONG), STRONG)
        normal = np.array([math.sin(angle), 0.0, math.cos(angle)])
        sample = Sample(fields=("x",), every=MILLION // STEPS // 10)
        start = MemberStart(below, DT, grains_at(normal * lever(below, angle)))
        x = platform.run(start, MILLION // STEPS, STEPS, [sample]).by_beat(sample, "xyz")[:, 0]
        errors[f"{law}: moved in the last 900 000 steps"] = float(np.abs(x[-1] - x[0]).max()) / D
        a, _ = accelerations(platform, above, math.atan(1.01 * STRONG))
        errors[f"{law}, 1 % above: a"] = abs(a / rolling_down(above, math.atan(1.01 * STRONG), STRONG) - 1)
    return errors


THRESHOLD = math.sqrt(1 / 3) / 2 / (1.5 + math.sqrt(1 / 3) / 2)
"""Rolling friction above which two spheres side by side carry a third, smooth against it, on a rough floor.

A top sphere of weight W presses on each with N = W/(2 cos 30). The floor's friction F bears N sin 30 at the lever R,
which turns the sphere unless mu_r R (3 W/2) at the floor and mu_r (R/2) N at the top sphere hold it.
"""


def pyramid(rolling: float, model: str) -> tuple[Scene, Packing]:
    """Three spheres in a row's plane between smooth walls, where nothing but rolling resistance holds them."""
    rough = SurfaceChange(friction=0.5, rolling_friction=rolling)
    smooth = SurfaceChange(friction=0.0, rolling_friction=0.0)
    sides = [
        Wall(name=name, shape=Plane(point=(0.0, -sign * R, 0.0), normal=(0.0, sign, 0.0)))
        for name, sign in (("front", 1.0), ("back", -1.0))
    ]
    law = linear(friction=0.0, rolling_friction=rolling, rolling_model=model)
    bed = scene(3, law, Primitives(parts=(floor(), *sides)), G, floor=rough, front=smooth, back=smooth)
    x = np.array([[-R, 0.0, R], [R, 0.0, R], [0.0, 0.0, R + math.sqrt(3) * R]])
    return bed, grains_at(x)


def _holds(platform: Platform) -> Mapping[str, float]:
    """Compare heights of the top sphere above the centres of the other two: zero when it has come down."""
    sample = Sample(fields=("x",), every=MILLION // 1000 // 10)
    positions = {}
    for model, factor, steps in (("epsd", 1.02, MILLION), ("epsd", 0.98, MILLION // 5), ("cdt", 1.02, MILLION)):
        resting, start = pyramid(factor * THRESHOLD, model)
        trajectory = platform.run(MemberStart(resting, DT, start), steps // 1000, 1000, [sample])
        positions[model, factor] = trajectory.by_beat(sample, "xyz") / D
    resting, low = positions["epsd", 1.02], positions["epsd", 0.98]
    return {
        "2 % above: moved in the last 900 000 steps": float(np.abs(resting[-1] - resting[0]).max()),
        "2 % above: sunk": math.sqrt(3) / 2 - float(resting[-1, 2, 2] - resting[-1, :2, 2].mean()),
        "2 % below: height left": float(low[-1, 2, 2] - low[-1, :2, 2].mean()),
        "2 % above, cdt: height left": float(
            positions["cdt", 1.02][-1, 2, 2] - positions["cdt", 1.02][-1, :2, 2].mean()
        ),
    }


CASES = [
    Case(
        name="rolling-spring",
        statement="a sphere with a rolling spring rolls to and fro at sqrt(k_r/(I + m l^2)), damped by eta_r",
        source="linear equations of motion, solved exactly",
        measures={
            "spin, eta = 0": limited(1e-5, roundings=100),
            # dashpots see velocities half a step old: eta w dt = 2.4e-4
            "spin, eta = 0.3": limited(5e-4, roundings=100),
            # friction's spring, in series, is a thousand times stiffer; the decrement is read off spins every 1 ms
            "period - textbook": limited(1e-3),
            "damping ratio - textbook": limited(1e-2),
        },
        run=_oscillates,
    ),
    Case(
        name="rolling-spring-mobilised",
        statement="a mobilised rolling spring slows a rolling sphere with the torque mu_r R F_n",
        source="rigid body, lever R - delta",
        # the speed is thrice what it loses meanwhile
        measures={law: limited(1e-6, roundings=16, steps=3 * 4e4) for law in LAWS},
        run=_slows_down,
    ),
    Case(
        name="rolling-spring-rests",
        statement="below tan t = mu_r a sphere with a rolling spring rests for a million steps; above, it rolls",
        source="balance of torques",
        measures={
            name: measure
            for law in LAWS
            for name, measure in {
                f"{law}: moved in the last 900 000 steps": limited(1e-9, "d", roundings=600),  # as of resting-pile
                f"{law}, 1 % above: a": limited(1e-6, roundings=100 * 16, steps=4e4),
            }.items()
        },
        run=_rests,
        slow=True,
    ),
    Case(
        name="rolling-spring-pyramid",
        statement="rolling resistance alone holds a sphere on two others if mu_r > 0.1614, for a million steps",
        source="balance of forces and torques",
        measures={
            "2 % above: moved in the last 900 000 steps": limited(1e-9, "d", roundings=600),
            "2 % above: sunk": limited(1e-3, "d"),
            "2 % below: height left": limited(1e-3, "d"),
            "2 % above, cdt: height left": Criterion({}, "d"),
        },
        run=_holds,
        slow=True,
    ),
]
