"""Collisions of two grains: restitution, duration, conserved momenta."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from labbook.backend.probes import Ledger, Sample
from labbook.checks.verify.case import Case, Criterion, limited
from labbook.checks.verify.materials import LAWS, D, room, scene
from labbook.checks.verify.platform import MemberStart, Platform, Trajectory, require
from labbook.scene import HertzMindlin, LinearSpringDashpot, Scene
from labbook.scene.packing import Packing

RESTITUTIONS = (0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 0.9, 1.0)
SPEEDS = (0.01, 0.1, 1.0)
PHASES = 10
"""Positions of the first touch within a time step, at each of which every collision is repeated."""
STUDY_STEP = 2.5e-6
"""The time step [s] of Fan's studies."""


def duration(scene: Scene, speed: float) -> float:
    """Duration [s] of an elastic head-on collision of two grains at relative `speed` [m/s].

    Linear: pi sqrt(m*/k_n). Hertz: 2.9432 times largest overlap over speed, where the overlap is
    (15 m* v^2 / (16 E* sqrt(R*)))^{2/5} and the number is the integral of 2 dx / sqrt(1 - x^{5/2}) from 0 to 1
    (Landau & Lifshitz, Theory of Elasticity, section 9).
    """
    law, mass, radius = scene.contact, scene.grains.mass / 2, scene.grains.radius / 2
    if isinstance(law, LinearSpringDashpot):
        return math.pi * math.sqrt(mass / law.normal_stiffness)
    assert isinstance(law, HertzMindlin)
    deepest = (15 * mass * speed**2 / (16 * law.effective_modulus * math.sqrt(radius))) ** 0.4
    return 0.8 * math.sqrt(math.pi) * math.gamma(0.4) / math.gamma(0.9) * deepest / speed


def head_on(speed: float, dt: float) -> Packing:
    """Pairs far from one another that meet at relative `speed` [m/s] along various directions.

    They touch at PHASES positions within the third step, none of them at a whole one.
    """
    directions = np.random.default_rng(1).normal(size=(PHASES, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    centres = np.array([[0.05 * k - 0.2, 0.0, 0.5] for k in range(PHASES)])
    gaps = (2 + (np.arange(PHASES) + 0.5) / PHASES) * speed * dt
    half = 0.5 * directions * (D + gaps)[:, None]
    v = 0.5 * speed * directions
    x = np.concatenate([centres - half, centres + half])
    return Packing(x=x, v=np.concatenate([v, -v]), omega=np.zeros_like(x))


def rebound(trajectory: Trajectory) -> np.ndarray:
    """Relative speed [m/s] at which each pair of `head_on` parts at the end."""
    x, v = (a[PHASES:] - a[:PHASES] for a in (trajectory.end.x, trajectory.end.v))
    return np.sum(x * v, axis=1) / np.linalg.norm(x, axis=1)


def _bouncing(law: str, e: float) -> Scene:
    material = LAWS[law](friction=0, rolling_friction=0, restitution=e)
    return scene(2 * PHASES, material, room())


def restitution_errors(platform: Platform, law: str, fraction: float) -> np.ndarray:
    """Measured minus stated e at a step of `fraction` of t_c: shape [RESTITUTIONS x SPEEDS, PHASES]."""
    conditions = [(e, speed) for e in RESTITUTIONS for speed in SPEEDS]
    scenes = [_bouncing(law, e) for e, _ in conditions]
    steps = [fraction * duration(s, speed) for s, (_, speed) in zip(scenes, conditions, strict=True)]
    starts = [
        MemberStart(s, dt, head_on(speed, dt)) for s, dt, (_, speed) in zip(scenes, steps, conditions, strict=True)
    ]
    trajectories = platform.run_all(starts, beats=1, steps_per_beat=round(20 / fraction))
    realised = [rebound(trajectory) / speed for trajectory, (_, speed) in zip(trajectories, conditions, strict=True)]
    return np.array([e - target for e, (target, _) in zip(realised, conditions, strict=True)])


def _restitution(law: str):
    def run(platform: Platform) -> Mapping[str, float]:
        coarse, fine = (restitution_errors(platform, law, fraction) for fraction in (1 / 400, 1 / 500))
        return {
            "mean over phases, t_c/400": float(np.abs(coarse.mean(axis=1)).max()),
            "any phase, t_c/400": float(np.abs(coarse).max()),
            "any phase, t_c/500": float(np.abs(fine).max()),
        }

    return run


def _at_the_study_s_step(platform: Platform) -> Mapping[str, float]:
    speed = math.sqrt(9.81 * D)
    with_gravity = _bouncing("hertz-mindlin", 0.2).model_copy(update={"gravity": 9.81})
    described = platform.backend.describe(with_gravity, platform.numerics(STUDY_STEP))
    start = MemberStart(_bouncing("hertz-mindlin", 0.2), STUDY_STEP, head_on(speed, STUDY_STEP))
    e = rebound(platform.run(start, beats=1, steps_per_beat=4000)) / speed
    return {
        "mean e": float(e.mean()),
        "largest e": float(e.max()),
        "smallest e": float(e.min()),
        "|mean e - described|": abs(float(e.mean()) - described["restitution_realised"]),
        "|spread of e - described|": abs(float(e.std()) - described["restitution_spread"]),
    }


def _durations(platform: Platform) -> Mapping[str, float]:
    return {law: max(_duration_error(platform, law, speed) for speed in SPEEDS) for law in LAWS}


def _duration_error(platform: Platform, law: str, speed: float) -> float:
    elastic = _bouncing(law, 1.0)
    expected = duration(elastic, speed)
    dt = expected / 400
    probe = Sample(fields=("x",))
    trajectory = platform.run(MemberStart(elastic, dt, head_on(speed, dt)), 420, 1, [probe])
    x = trajectory.by_beat(probe, "xyz")
    gap = np.linalg.norm(x[:, PHASES:] - x[:, :PHASES], axis=2) - D
    durations = [_time_below(gap[:, pair]) * dt for pair in range(PHASES)]
    return float(np.abs(np.array(durations) / expected - 1).max())


def _time_below(gap: np.ndarray) -> float:
    """Steps between the falling and the rising zero of `gap`, interpolated between steps."""
    crossings = np.flatnonzero(np.diff(np.sign(gap)))
    require(len(crossings) == 2, "a pair did not collide once")
    first, last = (k + gap[k] / (gap[k] - gap[k + 1]) for k in crossings)
    return float(last - first)


def oblique(count: int, speed: float, seed: int) -> Packing:
    """Pairs with random impact parameters, relative velocities near `speed` [m/s], and spins."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    centres = np.array([[0.04 * k - 0.02 * count, 0.01 * k, 0.5] for k in range(count)])
    drift = rng.normal(size=(count, 3)) * speed
    toward = directions * speed + rng.normal(size=(count, 3)) * 0.5 * speed
    half = 0.5 * directions * (D * 1.0001)
    x = np.concatenate([centres - half, centres + half])
    v = np.concatenate([drift + toward, drift - toward])
    return Packing(x=x, v=v, omega=rng.normal(size=x.shape) * speed / D)


def _momenta(platform: Platform) -> Mapping[str, float]:
    errors = {}
    for law, material in LAWS.items():
        rubbing = scene(12, material(), room(4.0))
        start = oblique(6, 0.2, seed=2)
        dt = duration(rubbing, 0.2) / 100
        before, after = (
            _totals(platform.run(MemberStart(rubbing, dt, start), 1, steps, [Ledger()])) for steps in (1, 600)
        )
        touched = np.abs(after["kinetic"] / before["kinetic"] - 1)
        require(touched > 0.01, "the pairs did not collide")
        mass = rubbing.grains.mass
        p = mass * np.linalg.norm(start.v, axis=1).sum()
        spin = rubbing.grains.inertia * np.linalg.norm(start.omega, axis=1).sum()
        l = mass * np.linalg.norm(np.cross(start.x, start.v), axis=1).sum() + spin
        errors[f"momentum, {law}"] = _change(before, after, ("px", "py", "pz")) / p
        errors[f"angular momentum, {law}"] = _change(before, after, ("lx", "ly", "lz")) / l
    return errors


def _totals(trajectory: Trajectory) -> Mapping[str, float]:
    row = next(iter(trajectory.tables.values()))
    return {name: float(column[-1]) for name, column in row.items()}


def _change(before: Mapping[str, float], after: Mapping[str, float], names: Sequence[str]) -> float:
    return math.hypot(*(after[name] - before[name] for name in names))


CASES = [
    *(
        Case(
            name=f"restitution-{law}",
            statement="two grains rebound with the stated e: e from 0.05 to 1, three speeds, ten phases",
            source=source,
            measures={
                "mean over phases, t_c/400": limited(1e-3),
                "any phase, t_c/400": Criterion({}),
                "any phase, t_c/500": limited(1e-3),
            },
            run=_restitution(law),
        )
        for law, source in (
            ("linear", "clamped collision, Schwager & Poschel 2007"),
            ("hertz-mindlin", "clamped collision, integrated"),
        )
    ),
    Case(
        name="restitution-at-study-step",
        statement="e = 0.2, Fan's grains at sqrt(g d), dt = 2.5e-6 s: effect of the step on e, ten phases",
        source="the backend's own description",
        measures={
            "mean e": Criterion({}),
            "smallest e": Criterion({}),
            "largest e": Criterion({}),
            # impulses of (1 + e) v, each force with its 16 roundings
            "|mean e - described|": limited(1e-9, roundings=1.2 * 16),
            "|spread of e - described|": limited(1e-9, roundings=1.2 * 16),
        },
        run=_at_the_study_s_step,
    ),
    Case(
        name="contact-time",
        statement="an elastic collision lasts pi sqrt(m*/k_n), or 2.943 delta_max/v after Hertz",
        source="Landau & Lifshitz, Theory of Elasticity, 9",
        measures={law: limited(1e-3) for law in LAWS},
        run=_durations,
    ),
    Case(
        name="pair-momenta",
        statement="contacts with friction, damping and rolling resistance conserve momentum and angular momentum",
        source="Newton's third law",
        # forces are exactly opposite in any precision; torques are n x f_t, whose 8 operations round
        measures={
            f"{quantity}, {law}": limited(5e-14, roundings=roundings, steps=1)
            for law in LAWS
            for quantity, roundings in (("momentum", 0), ("angular momentum", 8))
        },
        run=_momenta,
    ),
]
