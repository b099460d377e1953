"""A sphere on a plane: rolling, rest, sliding.

Contacts with walls act at the lever l = R - delta, at the bottom of the overlap. With it the textbook formulas (in
which l = R) become exact, and the cases compare with these: for example the acceleration of a rolling sphere on a
slope, (5/7) g (sin t - mu_r cos t), is (g sin t - mu_r g cos t R/l) / (1 + (2/5) R^2/l^2).
"""

import math
from collections.abc import Mapping

import numpy as np

from labbook.backend.probes import Sample
from labbook.checks.verify.case import Case, Criterion, limited
from labbook.checks.verify.materials import LAWS, D, G, floor, scene
from labbook.checks.verify.platform import MemberStart, Platform, grains_at
from labbook.scene import HertzMindlin, LinearSpringDashpot, Primitives, Scene, SurfaceChange
from labbook.scene.packing import Packing

R = D / 2
DT = 2.5e-6
STEPS = 400
MOTION = Sample(fields=("x", "v", "omega"))


def slope(law: str, angle: float, friction: float, rolling: float) -> Scene:
    """One grain on a plane inclined by `angle` [rad], downwards along x."""
    surface = SurfaceChange(friction=friction, rolling_friction=rolling)
    plane = floor((math.sin(angle), 0.0, math.cos(angle)))
    return scene(1, LAWS[law](), Primitives(parts=(plane,)), G, floor=surface)


def static_overlap(scene: Scene, force: float) -> float:
    """Overlap [m] at which a wall carries a grain with `force` [N]."""
    law = scene.contact
    if isinstance(law, HertzMindlin):
        return (force / (4 / 3 * law.effective_modulus * math.sqrt(scene.grains.radius))) ** (2 / 3)
    assert isinstance(law, LinearSpringDashpot)
    return force / law.normal_stiffness


def lever(scene: Scene, angle: float = 0.0) -> float:
    """Distance [m] from the centre to a slope that a grain rests on."""
    return R - static_overlap(scene, scene.grains.mass * G * math.cos(angle))


def resting_on(scene: Scene, angle: float = 0.0, speed: float = 0.0) -> Packing:
    """The grain in contact with its slope at equilibrium, sliding at `speed` [m/s] downwards."""
    normal = np.array([math.sin(angle), 0.0, math.cos(angle)])
    return grains_at(normal * lever(scene, angle), [speed * math.cos(angle), 0.0, -speed * math.sin(angle)])


def follow(platform: Platform, scene: Scene, start: Packing, angle: float, time: float, dt: float = DT):
    """Times [s], speeds [m/s] downwards, spins [rad/s] about y of one grain."""
    beats = round(time / dt / STEPS)
    trajectory = platform.run(MemberStart(scene, dt, start), beats, STEPS, [MOTION])
    vx, vz, wy = np.moveaxis(trajectory.by_beat(MOTION, ("vx", "vz", "wy"))[:, 0], -1, 0)
    return trajectory.times(MOTION), vx * math.cos(angle) - vz * math.sin(angle), wy


def accelerations(platform: Platform, scene: Scene, angle: float) -> tuple[float, float]:
    """Of the centre downwards [m/s^2] and of the spin [rad/s^2], over the second half of 0.1 s from rest."""
    time, speed, spin = follow(platform, scene, resting_on(scene, angle), angle, 0.1)
    half = len(time) // 2
    span = time[-1] - time[half]
    return (speed[-1] - speed[half]) / span, (spin[-1] - spin[half]) / span


def rolling_down(scene: Scene, angle: float, rolling: float) -> float:
    """Acceleration [m/s^2] of a sphere that rolls down a slope against rolling friction `rolling`."""
    lever_arm = lever(scene, angle) / R
    return G * (math.sin(angle) - rolling * math.cos(angle) / lever_arm) / (1 + 0.4 / lever_arm**2)


def _rolls_down(platform: Platform) -> Mapping[str, float]:
    exact, textbook = [], []
    for law in LAWS:
        for degrees, rolling in ((5.0, 0.0), (10.0, 0.01), (20.0, 0.1)):
            angle = math.radians(degrees)
            rolls = slope(law, angle, 0.5, rolling)
            measured, _ = accelerations(platform, rolls, angle)
            exact.append(measured / rolling_down(rolls, angle, rolling) - 1)
            textbook.append(measured / (5 / 7 * G * (math.sin(angle) - rolling * math.cos(angle))) - 1)
    return {
        "relative error of a": float(np.abs(exact).max()),
        "the same with l = R": float(np.abs(textbook).max()),
    }


ROLLING = 0.1


def _rests(platform: Platform) -> Mapping[str, float]:
    """Below the threshold the limiter, at most I/(12 dt) times the spin, lets a grain creep: I/(12 dt) w = m g sin t l,
    hence v = w l = 30 g sin t dt l^2/R^2. Rolling springs hold it (`rolling-spring-rests`)."""
    angle = math.atan(0.9 * ROLLING)
    incline = slope("hertz-mindlin", angle, 0.5, ROLLING)
    expected = 30 * G * math.sin(angle) * DT * (lever(incline, angle) / R) ** 2
    creeps = []
    for dt in (DT, DT / 2):
        _, speed, _ = follow(platform, incline, resting_on(incline, angle), angle, 0.05, dt)
        creeps.append(speed[-1])
    above = math.atan(1.01 * ROLLING)
    rolls = slope("hertz-mindlin", above, 0.5, ROLLING)
    a, _ = accelerations(platform, rolls, above)
    return {
        "creep/(30 g sin t dt) - 1": abs(creeps[0] / expected - 1),
        "creep at dt/2, over half of it - 1": abs(2 * creeps[1] / creeps[0] - 1),
        "creep in a second": creeps[0] / D,
        "1 % above: |a/expected - 1|": abs(a / rolling_down(rolls, above, ROLLING) - 1),
    }


def _comes_to_roll(platform: Platform) -> Mapping[str, float]:
    exact, textbook, speed = [], [], 0.5
    for law in LAWS:
        flat = slope(law, 0.0, 0.3, 0.0)
        _, v, spin = follow(platform, flat, resting_on(flat, speed=speed), 0.0, 0.1)
        lever_arm = lever(flat)
        exact.append(v[-1] / speed * (1 + 0.4 * (R / lever_arm) ** 2) - 1)
        exact.append(spin[-1] * lever_arm / v[-1] - 1)
        textbook.append(v[-1] / speed - 5 / 7)
    return {
        "relative error of v and of rolling": float(np.abs(exact).max()),
        "|v/v0 - 5/7|": float(np.abs(textbook).max()),
    }


MU = 0.2


def _slips(platform: Platform) -> Mapping[str, float]:
    """Acceleration of the contact point: none below the threshold, (sin t - 3.5 mu cos t) g above."""
    errors = {}
    for law in LAWS:
        for factor in (0.99, 1.01):
            tan = 3.5 * MU * factor
            angle = math.atan(tan)
            slides = slope(law, angle, MU, 0.0)
            a, turn = accelerations(platform, slides, angle)
            lever_arm = lever(slides, angle)
            slip = (a - turn * lever_arm) / G
            shear = MU * math.cos(angle) * (1 + 2.5 * (lever_arm / R) ** 2)  # 3.5 mu cos t, but for the lever
            expected = max(math.sin(angle) - shear, 0.0)
            key = f"{law}, {'below' if factor < 1 else 'above'}"
            errors[key] = abs(slip - expected)
    return errors


CASES = [
    Case(
        name="rolling-incline",
        statement="a sphere rolls down a slope with a = (5/7) g (sin t - mu_r cos t)",
        source="rigid body, lever R - delta",
        measures={"relative error of a": limited(1e-6, steps=4e4), "the same with l = R": Criterion({})},
        run=_rolls_down,
    ),
    Case(
        name="rest-on-incline",
        statement="below tan t = mu_r a sphere held by cdt creeps at 30 g sin t dt, and does not rest; above, it rolls",
        source="balance of torques",
        measures={
            "creep/(30 g sin t dt) - 1": limited(1e-6, roundings=400),
            # a spring of 1.5e-8 m loses up to a rounding a step: slip of up to 400 roundings of the creep at dt/2
            "creep at dt/2, over half of it - 1": limited(1e-6, roundings=400),
            "creep in a second": Criterion({}, "d"),
            # a is 1 % of the two terms that it is the difference of
            "1 % above: |a/expected - 1|": limited(1e-6, roundings=100 * 16, steps=4e4),
        },
        run=_rests,
    ),
    Case(
        name="sliding-to-rolling",
        statement="a sphere that starts to slide at v0 ends up rolling at (5/7) v0",
        source="angular momentum, lever R - delta",
        measures={"relative error of v and of rolling": limited(1e-6, steps=4e4), "|v/v0 - 5/7|": Criterion({})},
        run=_comes_to_roll,
    ),
    Case(
        name="incline-slip",
        statement="a sphere on a slope slips beyond tan t = 3.5 mu: slip of the contact over g, 1 % off the threshold",
        source="rigid body, lever R - delta",
        measures={
            f"{law}, {side}": limited(1e-6, roundings=16, steps=4e4) for law in LAWS for side in ("below", "above")
        },
        run=_slips,
    ),
]
