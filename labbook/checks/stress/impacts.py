"""Impacts at the limits of the parameters: restitution, friction, speed, and grains that overlap at the start."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Ledger
from labbook.checks.stress.case import Ending, StressCase, within
from labbook.checks.stress.watch import follow, guard_error, sound
from labbook.checks.verify.case import limited
from labbook.checks.verify.collision import duration
from labbook.checks.verify.gas import elastic_energy
from labbook.checks.verify.materials import LAWS, D, hertz, linear, room, scene
from labbook.checks.verify.platform import MemberStart, Platform, Trajectory, grains_at
from labbook.checks.verify.rods import rods, rods_at, towards
from labbook.scene import Scene, Spherocylinders
from labbook.scene.packing import Packing

SPEED = 0.5
"""Relative speed [m/s] of impacts."""
ANGLES = (0.0, 0.6, 1.3)
"""Between the relative velocity and the line of centres [rad]: head-on, oblique, grazing."""
PER_CONTACT = 500
"""Steps of an elastic collision."""
MIDDLE = np.array([0.0, 0.0, 0.05])
"""Of a room of 10 cm: far from its walls, and near enough to the origin for angular momenta to keep their digits."""
ROOM = room(0.1)
ALONG, UP = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
HAT = np.array([0.0, 0.6, 0.8])
"""Line of centres, along no axis."""
ACROSS = np.array([0.0, -0.8, 0.6])


def glancing(angle: float, dt: float, drift: np.ndarray | None = None, at: np.ndarray = MIDDLE) -> Packing:
    """Place two spheres that touch in the middle of the third step and meet at SPEED.

    Args:
        angle: Angle between relative velocity and line of centres [rad].
        dt: Time step [s].
        drift: Common velocity [m/s], shape [3].
        at: Their centre [m], shape [3].
    """
    v = SPEED * (math.cos(angle) * HAT + math.sin(angle) * ACROSS)
    half = 0.5 * (D * HAT + 2.5 * dt * v)
    return grains_at([at - half, at + half], np.array([v / 2, -v / 2]) + (0.0 if drift is None else drift))


RIGID = {"hertz-mindlin": {"shear_modulus": 1e13}, "linear": {"normal_stiffness": 1e9}}


def pair(law: str, e: float, friction: float) -> Scene:
    """Two spheres of restitution e and a friction coefficient, without a tangential dashpot if e = 1.

    They are so stiff that the line of centres hardly turns during the contact.
    """
    across = 0.0 if e == 1 else 1.0
    parameters = {"restitution": e, "friction": friction, "rolling_friction": 0, "tangential_damping": across}
    return scene(2, LAWS[law](**parameters, **RIGID[law]), ROOM)


def _relative(end: Packing) -> tuple[float, np.ndarray]:
    """Normal velocity [m/s] of the first towards the second, and relative tangential velocity of their surfaces."""
    v = end.v[0] - end.v[1]
    along = float(v @ HAT)
    return along, v - along * HAT + 0.5 * D * np.cross(end.omega.sum(axis=0), HAT)


def _collides(platform: Platform, here: Scene, angle: float, finer: int = 1) -> tuple[Packing, Trajectory]:
    """Run the impact long enough for e = 0.05, at the time step of the contact over `finer`."""
    dt = duration(here, SPEED * math.cos(angle)) / PER_CONTACT / finer
    start = glancing(angle, dt)
    return start, sound(follow(platform, MemberStart(here, dt, start), 8, PER_CONTACT * finer, [Ledger()]))


_CHANGES: tuple[str, ...] = ("momentum", "angular momentum", "energy gained")


def _changes(here: Scene, start: Packing, trajectory: Trajectory) -> dict[str, float]:
    """Relative changes of momentum, angular momentum and energy; that of energy is positive only if it grew."""
    last, mass = {name: float(column[-1]) for name, column in trajectory.rows(Ledger()).items()}, here.grains.mass
    p, l = (mass * np.sum(vectors, axis=0) for vectors in (start.v, np.cross(start.x, start.v)))
    energy = 0.5 * mass * float(np.sum(start.v**2))
    return {
        "momentum": float(np.linalg.norm([last[k] for k in ("px", "py", "pz")] - p)) / (mass * SPEED),
        "angular momentum": float(np.linalg.norm([last[k] for k in ("lx", "ly", "lz")] - l))
        / (mass * SPEED * float(MIDDLE[2])),
        "energy gained": last["kinetic"] / energy - 1,
    }


def _extremes(platform: Platform) -> Iterator[Ending]:
    double = replace(platform, precision="double")
    # a contact takes some 600 steps, each of which may round velocities kept in single
    exact = limited(5e-14, roundings=16, steps=1500)
    for law in LAWS:
        for e in (0.05, 1.0):
            for friction in (0.0, 5.0):
                here = pair(law, e, friction)
                worst = dict.fromkeys(_CHANGES, 0.0)
                against: dict[str, list[float]] = {}
                for angle in ANGLES:
                    start, trajectory = _collides(platform, here, angle)
                    for name, change in _changes(here, start, trajectory).items():
                        worst[name] = max(worst[name], change)
                    along, slip = _relative(trajectory.end)
                    normal, across = SPEED * math.cos(angle), SPEED * math.sin(angle)
                    if friction == 0:
                        against.setdefault("e", []).append(abs(-along / normal - e))
                        against.setdefault("velocity across", []).append(
                            abs(float(np.linalg.norm(slip)) - across) / SPEED
                        )
                        spin = float(np.abs(trajectory.end.omega).max() * D) / SPEED
                        against.setdefault("spin", []).append(spin)
                    elif e == 1 and law == "linear":
                        # a spring of 2/7 k_n swings across as fast as k_n does along: a superball (Garwin 1969)
                        back = float(np.linalg.norm(slip + across * ACROSS))
                        against.setdefault("superball", []).append(back / SPEED)
                    else:
                        fine = _collides(double, here, angle, 8)[1].end
                        off = np.linalg.norm(trajectory.end.v - fine.v, axis=1).max()
                        off = max(off, np.linalg.norm(trajectory.end.omega - fine.omega, axis=1).max() * D / 2)
                        against.setdefault("dt/8 in double", []).append(float(off) / SPEED)
                part = f"{law}, e = {e:g}, mu = {friction:g}"
                yield within(platform, part, "momentum", worst["momentum"], exact)
                # positions are rounded once a step, the same way again and again
                turned = limited(8 * PER_CONTACT * 2.0**-53, roundings=16, steps=1500)
                yield within(platform, part, "angular momentum", worst["angular momentum"], turned)
                yield within(platform, part, "energy gained", worst["energy gained"], LIMITS["energy gained"])
                for name, errors in against.items():
                    yield within(platform, part, name, max(errors), LIMITS[name])


LIMITS = {
    # leapfrog's energy of an elastic contact of 500 steps is known to (pi/500)^2/8 = 5e-6
    "energy gained": limited(2e-5, roundings=16, steps=1500),
    # the phase of the touch within the step, as in `labbook verify restitution`
    "e": limited(1.5e-3, roundings=16, steps=1500),
    "velocity across": limited(1e-3, roundings=16, steps=1500),
    "spin": limited(0.0),
    "superball": limited(5e-3, roundings=16, steps=1500),
    "dt/8 in double": limited(5e-3, roundings=16, steps=1500),
}


LIMIT = Numerics.model_fields["speed_limit"].default
DEEPEST = Numerics.model_fields["overlap_limit"].default
STIFF = {"hertz-mindlin": {"shear_modulus": 1e10}, "linear": {"normal_stiffness": 1e7}}
"""Stiff enough for grains at LIMIT [m/s] to overlap by less than a tenth of d."""


def _fast(platform: Platform) -> Iterator[Ending]:
    """A grain comes from ten diameters away, beyond every list, and hits one at rest: they exchange velocities."""
    for law in LAWS:
        elastic = {"restitution": 1, "friction": 0, "rolling_friction": 0}
        here = scene(2, LAWS[law](**elastic, **STIFF[law]), room(4.0))
        for speed in (0.99 * LIMIT, 1.01 * LIMIT):
            dt = duration(here, speed) / 100
            x = [MIDDLE - 10 * D * HAT, MIDDLE]
            beats = math.ceil(12 * D / speed / dt / 100)
            outcome = follow(platform, MemberStart(here, dt, grains_at(x, [speed * HAT, [0, 0, 0]])), beats, 100)
            part = f"{law}, {speed:g} m/s"
            if speed > LIMIT:
                yield guard_error(part, outcome, ("speed",))
                continue
            v = sound(outcome).end.v
            off = max(float(np.abs(v[0]).max()), float(np.abs(v[1] - speed * HAT).max())) / speed
            # the phase of the touch, the energy of a contact of 100 steps
            yield within(platform, part, "velocities exchanged", off, limited(1e-4, roundings=16, steps=200))


DEPTHS = (0.05, 0.9 * DEEPEST, 1.1 * DEEPEST, 0.6, 0.999)
"""Overlaps [d] that grains are placed with: up to the guard, and beyond."""


def _deep(platform: Platform) -> Iterator[Ending]:
    """Frictionless and elastic: all the energy that the overlap holds becomes kinetic."""
    for law in LAWS:
        here = scene(2, LAWS[law](restitution=1, friction=0, rolling_friction=0), ROOM)
        dt = duration(here, 1.0) / PER_CONTACT
        for depth in DEPTHS:
            half = 0.5 * D * (1 - depth) * HAT
            outcome = follow(platform, MemberStart(here, dt, grains_at([MIDDLE - half, MIDDLE + half])), 4, PER_CONTACT)
            part = f"two spheres, {law}, {depth:.3g} d"
            if depth > DEEPEST:
                yield guard_error(part, outcome, ("overlap",))
                continue
            stored = float(elastic_energy(here, np.array([depth * D]), np.array([False]))[0])
            kinetic = _kinetic(here, sound(outcome).end)
            # released at rest, the first step is half a kick too long: dt w/2 = pi/1000, to second order
            yield within(
                platform, part, "|kinetic/stored - 1|", abs(kinetic / stored - 1), limited(1e-4, roundings=100)
            )
    here = scene(1, linear(restitution=1, friction=0, rolling_friction=0), ROOM)
    dt = duration(here, 1.0) / PER_CONTACT
    for height in (0.5 - 1.1 * DEEPEST, 0.0, -0.4):
        start = grains_at([[0.0, 0.0, height * D]])
        outcome = follow(platform, MemberStart(here, dt, start), 4, PER_CONTACT)
        yield guard_error(f"a sphere in the floor, centre at {height:g} d", outcome, ("overlap",))
    for name, axis in (("parallel rods", [1.0, 0.0, 0.0]), ("crossed rods", [0.0, 1.0, 0.0])):
        here = rods(2, ROOM)
        d = here.grains.diameter
        for depth in (1.1 * DEEPEST, 0.8):
            x = [MIDDLE, MIDDLE + d * (1 - depth) * UP]
            start = rods_at(x, [towards([1.0, 0.0, 0.0]), towards(axis)])
            yield guard_error(
                f"{name}, {depth:.3g} d", follow(platform, MemberStart(here, 1e-6, start), 4, 100), ("overlap",)
            )


def _kinetic(here: Scene, end: Packing) -> float:
    return 0.5 * here.grains.mass * float(np.sum(end.v**2))


def _coincident(platform: Platform) -> Iterator[Ending]:
    """Centres in one place leave no direction to be pushed in; nor does a rod that crosses another's axis."""
    for law, material in (("hertz-mindlin", hertz), ("linear", linear)):
        here = scene(2, material(), ROOM)
        for name, gap in (("in one place", 0.0), ("1e-300 m apart", 1e-300), ("1e-12 m apart", 1e-12)):
            start = grains_at([MIDDLE + gap * ALONG, MIDDLE])
            yield guard_error(f"spheres {name}, {law}", follow(platform, MemberStart(here, 1e-6, start), 4, 100))
        outcome = follow(platform, MemberStart(here, 1e-6, grains_at([[0.0, 0.0, 0.0], MIDDLE])), 4, 100)
        yield guard_error(f"a sphere's centre in the floor, {law}", outcome)
    for name, axis in (("along one axis", [1.0, 0.0, 0.0]), ("crossed", [0.0, 1.0, 0.0]), ("askew", [0.6, 0.8, 0.0])):
        here = rods(2, ROOM)
        start = rods_at([MIDDLE, MIDDLE], [towards([1.0, 0.0, 0.0]), towards(axis)])
        yield guard_error(f"rods in one place, {name}", follow(platform, MemberStart(here, 1e-6, start), 4, 100))
    here = rods(2, ROOM)
    assert isinstance(here.grains, Spherocylinders)
    shifted = MIDDLE + here.grains.half_length / 2 * ALONG
    start = rods_at([MIDDLE, shifted], [towards([1.0, 0.0, 0.0])] * 2)
    yield guard_error(
        "rods along one axis, shifted by half their half length",
        follow(platform, MemberStart(here, 1e-6, start), 4, 100),
    )


CASES = [
    StressCase(
        name="impact-extremes",
        attempt="e = 0.05 and 1, friction 0 and 5; head-on, oblique and grazing",
        oracle="invariants; exact rebound without friction and of a superball; else dt/8 in double",
        run=_extremes,
    ),
    StressCase(
        name="fast-grain",
        attempt="a grain 1 % below and above the speed limit hits one at rest, from ten diameters away",
        oracle="elastic exchange of velocities; the speed guard",
        run=_fast,
    ),
    StressCase(
        name="deep-overlap",
        attempt="grains placed in one another, up to and beyond the overlap limit; a grain behind a wall",
        oracle="kinetic energy = stored energy; the overlap guard",
        run=_deep,
    ),
    StressCase(
        name="coincident",
        attempt="centres, or axes of rods, in one place; a centre in a wall",
        oracle="a named error",
        run=_coincident,
    ),
]
