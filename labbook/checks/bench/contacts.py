"""Single contacts against SciPy: the error of velocities and spins after an impact, by time step, law and scene.

The scenes are those of Chung & Ooi 2011 (Granular Matter 13:643) for spheres, with Fan's grains; impacts of rods; and a
sphere that slides until it rolls. Every impact is repeated with the first touch at several places within a step.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from labbook.checks.bench.order import Order, fit_order
from labbook.checks.verify.materials import EVERY_LAW, D, G, floor, spheres
from labbook.checks.verify.planar import PlanarBody, PlanarImpact
from labbook.checks.verify.platform import MemberStart, Platform
from labbook.checks.verify.rods import ROD
from labbook.scene import ContactLaw, Kind, Primitives, Scene, Spheres, Spherocylinders, Strip, Wall

STEPS = (10, 20, 40, 80, 160, 320, 640)
"""Steps of a collision."""
PHASES = 8
"""Places of the first touch within a step, evenly spread."""
SPEED = math.sqrt(G * D)
"""Normal velocity [m/s] of impacts: that of a fall of half a diameter."""
AHEAD = 2
"""Whole steps before the one in which bodies touch."""
GOLDEN = (math.sqrt(5) - 1) / 2

Make = Callable[..., ContactLaw]
"""Constructor of a law; keywords replace Fan's values."""


UNSETTLED = {("hertz-liggghts", "rod end at a wall"), ("hertz-liggghts", "rod at an edge")}
"""Laws and situations without a reference. The dashpot of LIGGGHTS' law is there only while a contact sticks. Off the
centre of a rod friction changes the normal force, and with it the limit: whether such a contact sticks or slides then
may depend on what it did before, however short the step is."""


@dataclass(frozen=True)
class Situation:
    """Impacts whose largest error is reported as one number; `make` gives them for a law."""

    name: str
    about: str
    make: Callable[[Make], Sequence[PlanarImpact]]
    rods: bool = False


@dataclass(frozen=True)
class Convergence:
    """Errors of one situation, law and precision at each number of steps a collision, in parts of the normal velocity.

    Args:
        situation: Name of the situation.
        law: Name of the contact law.
        precision: Precision of the runs.
        steps: Steps of a collision, one for each time step.
        error: Error of the worst impact, averaged over phases of the first touch within a step: the largest error of
            velocities, and of spins times the size of the body.
        bias: Mean of the error over phases, with its sign.
        scatter: Standard deviation of the error over phases.
        order: Order of `error` in the time step.
        order_bias: Order of `bias`.
        order_scatter: Order of `scatter`.
    """

    situation: str
    law: str
    precision: str
    steps: tuple[int, ...]
    error: tuple[float, ...]
    bias: tuple[float, ...]
    scatter: tuple[float, ...]
    order: Order
    order_bias: Order
    order_scatter: Order


def converge(
    platform: Platform, situation: Situation, law: str, steps: Sequence[int] = STEPS, phases: int = PHASES
) -> Convergence:
    """Measure one situation on a platform."""
    impacts = situation.make(EVERY_LAW[law])
    return measure(platform, impacts, (situation.name, law), steps, phases)


def measure(
    platform: Platform,
    impacts: Sequence[PlanarImpact],
    names: tuple[str, str],
    steps: Sequence[int],
    phases: int = PHASES,
) -> Convergence:
    """Measure impacts that share a kernel; `names`: of the situation and the law."""
    expected = [impact.parted() for impact in impacts]
    rows: list[tuple[float, float, float]] = []
    for count in steps:
        phase_errors = [
            errors(platform, impact, end, count, phases) for impact, end in zip(impacts, expected, strict=True)
        ]
        statistics = [(np.abs(e).max(1).mean(), np.abs(e.mean(0)).max(), e.std(0).max()) for e in phase_errors]
        rows.append(tuple(np.max(statistics, axis=0).tolist()))
    error, bias, scatter = (tuple(column) for column in zip(*rows, strict=True))
    orders = [fit_order(1 / np.array(steps), column) for column in (error, bias, scatter)]
    return Convergence(*names, platform.precision, tuple(steps), error, bias, scatter, *orders)


def errors(platform: Platform, impact: PlanarImpact, expected: np.ndarray, steps: int, phases: int) -> np.ndarray:
    """Compute errors of every velocity and spin at each phase, in parts of the speed: shape [phases, components].

    If a collision were a whole number of steps, it would end at the phase at which it began, and the errors of its
    beginning and end would cancel. So the steps of a collision differ by up to half a step between phases. A contact
    that exists from the beginning has no phase.
    """
    if impact.scene.gravity:
        starts, count = (
            [MemberStart(impact.scene, impact.lasts / steps, impact.packing(0.0))],
            round(impact.follow * steps),
        )
    else:
        sizes = [impact.lasts / (steps + (k * GOLDEN) % 1 - 0.5) for k in range(phases)]
        before = [(AHEAD + (k + 0.5) / phases) * dt for k, dt in enumerate(sizes)]
        starts = [MemberStart(impact.scene, dt, impact.packing(b)) for dt, b in zip(sizes, before, strict=True)]
        count = math.ceil(impact.follow * (steps + 0.5)) + AHEAD + 1
    trajectories = platform.run_all(starts, 1, count)
    return np.array([np.ravel(impact.error(trajectory.end, expected)) for trajectory in trajectories])


# scenes


ELASTIC: Mapping[str, Any] = {"restitution": 1.0, "tangential_damping": 0.0}
HALVED: Mapping[str, float] = {"restitution": 0.5, "tangential_damping": 1.0}
SMOOTH: Mapping[str, Any] = {"friction": 0.0}
ANGLES = (5, 20, 40, 60, 75)
"""Angles of incidence, from the normal [degrees]."""
SPINS = (0.5, 1.5, 3.0, 6.0)
"""Velocity of the surface by spin over the normal velocity."""
EDGE = Wall(name="plate", shape=Strip(start=(-0.1, 0.0), end=(0.0, 0.0)))


def _scene(grains: Spheres | Spherocylinders, law: ContactLaw, *walls: Wall, gravity: float = 0.0) -> Scene:
    return Scene(grains=grains, contact=law, container=Primitives(parts=walls), gravity=gravity)


def _sphere(x: float, z: float, vx: float, vz: float, spin: float = 0.0) -> PlanarBody:
    return PlanarBody.sphere(spheres(1), (x, z), (vx, vz), spin)


def head_on(make: Make, **parameters: float) -> list[PlanarImpact]:
    """Two spheres that collide head-on, each at half the velocity."""
    law = make(rolling_friction=0, **{**ELASTIC, **SMOOTH, **parameters})
    bodies = _sphere(0, D, 0, -SPEED / 2), _sphere(0, 0, 0, SPEED / 2)
    return [PlanarImpact.of(_scene(spheres(2), law), bodies, "none", SPEED)]


def at_floor(
    make: Make, slips: Sequence[float], spins: Sequence[float] = (0.0,), **parameters: Any
) -> list[PlanarImpact]:
    """A sphere at a plane; slips, spins: tangential velocity, and that of the surface by spin, over the normal one."""
    law = make(rolling_friction=0, **{**HALVED, **parameters})
    scene, r = _scene(spheres(1), law, floor()), D / 2
    return [
        PlanarImpact.of(scene, (_sphere(0, r, slip * SPEED, -SPEED, spin * SPEED / r),), "floor", SPEED, follow=2.5)
        for slip in slips
        for spin in spins
    ]


def _two_spinning(make: Make) -> list[PlanarImpact]:
    law = make(rolling_friction=0, **HALVED)
    scene, r = _scene(spheres(2), law), D / 2
    spins = [spin * SPEED / D / 2 for spin in SPINS]  # both turn alike, each with half of the slip
    return [
        PlanarImpact.of(
            scene,
            (_sphere(0, 2 * r, 0, -SPEED / 2, w), _sphere(0, 0, 0, SPEED / 2, w)),
            "none",
            SPEED,
            follow=2.5,
        )
        for w in spins
    ]


def _unlike(make: Make) -> list[PlanarImpact]:
    law = make(rolling_friction=0, **HALVED)
    kinds = (
        Kind(name="small", share=0.5, diameter=D, density=2500),
        Kind(name="large", share=0.5, diameter=5 * D, density=2500),
    )
    scene = _scene(Spheres(diameter=5 * D, density=2500, count=2, kinds=kinds), law)
    large = Spheres(diameter=5 * D, density=2500, count=1)
    return [
        PlanarImpact.of(
            scene,
            (_sphere(0, 3 * D, 0, -SPEED, 2 * w * SPEED / D), PlanarBody.sphere(large, (0, 0), (0, 0))),
            "none",
            SPEED,
            follow=2.5,
        )
        for w in SPINS
    ]


def _rod(position: tuple[float, float], angle: float, v: tuple[float, float] = (0.0, 0.0)) -> PlanarBody:
    return PlanarBody(ROD.mass, ROD.inertia, ROD.radius, ROD.half_length, position, v, angle)


def _rods(count: int, make: Make, *walls: Wall) -> Scene:
    law = make(rolling_friction=0, **HALVED)
    return _scene(ROD.model_copy(update={"count": count}), law, *walls)


def _between(make: Make, first: PlanarBody, second: PlanarBody, **options: Any) -> PlanarImpact:
    return PlanarImpact.of(_rods(2, make), (first, second), "none", SPEED, follow=4.0, **options)


R, HALF = ROD.radius, ROD.half_length


def _end_to_end(make: Make) -> list[PlanarImpact]:
    aside, tilt = 0.3, 0.2
    end = 2 * R * math.sin(aside), HALF + 2 * R * math.cos(aside)
    upper = end[0] + HALF * math.sin(tilt), end[1] + HALF * math.cos(tilt)
    return [_between(make, _rod(upper, tilt, (0.0, -SPEED)), _rod((0.0, 0.0), 0.0))]


def _crossed(make: Make) -> list[PlanarImpact]:
    across = PlanarBody(ROD.mass, ROD.inertia_axis, R, 0.0, (0.0, 0.0), (0.0, 0.0))
    upper = _rod((-HALF / 2, 2 * R), math.pi / 2, (0.8 * SPEED, -SPEED))
    side = (math.sqrt(0.5), -math.sqrt(0.5), 0.0, 0.0)
    return [_between(make, upper, across, turned=((0.0,) * 4, side))]


def beside(make: Make, tilt: float) -> list[PlanarImpact]:
    """The end of a rod comes down on the side of another, to which it is tilted [rad]."""
    end = 0.4 * HALF if tilt > 0.01 else -0.8 * HALF
    upper = end + HALF * math.cos(tilt), 2 * R + HALF * math.sin(tilt)
    bodies = _rod(upper, math.pi / 2 - tilt, (0.0, -SPEED)), _rod((0.0, 0.0), math.pi / 2)
    return [_between(make, *bodies)]


def _at_floor(make: Make, tilt: float) -> list[PlanarImpact]:
    a = math.sin(tilt), math.cos(tilt)
    position = HALF * a[0], R + HALF * a[1]
    slip = 0.8 * SPEED if tilt < 1 else 0.0
    return [
        PlanarImpact.of(_rods(1, make, floor()), (_rod(position, tilt, (slip, -SPEED)),), "floor", SPEED, follow=4.0)
    ]


def _at_edge(make: Make) -> list[PlanarImpact]:
    tilt, at = 0.5, -0.3 * HALF
    a, n = (-math.cos(tilt), math.sin(tilt)), (math.sin(tilt), math.cos(tilt))
    position = R * n[0] - at * a[0], R * n[1] - at * a[1]
    v = SPEED * (0.8 * a[0] - n[0]), SPEED * (0.8 * a[1] - n[1])
    return [PlanarImpact.of(_rods(1, make, EDGE), (_rod(position, math.atan2(*a), v),), "edge", SPEED, follow=4.0)]


def slowing(make: Make) -> list[PlanarImpact]:
    """A sphere that begins to slide on a floor, so fast that it rolls after half of the simulated time."""
    law = make(rolling_friction=0, **HALVED)
    scene = _scene(spheres(1), law, floor(), gravity=G)
    still = PlanarImpact.of(scene, (_sphere(0, D / 2, 0, 0),), "floor", SPEED, follow=20.0)
    overlap = _resting(still)
    speed = 3.5 * law.friction * G * 0.5 * still.follow * still.lasts
    return [replace(still, bodies=(_sphere(0, D / 2 - overlap, speed, 0),), speed=speed)]


def _resting(impact: PlanarImpact) -> float:
    """Overlap [m] at which a contact carries the weight of the body."""
    from scipy.optimize import root_scalar

    law, weight = impact.law(), impact.bodies[0].mass * impact.scene.gravity

    def lacking(overlap: float) -> float:
        return law.normal(overlap, 0.0) - weight

    return root_scalar(lacking, bracket=(0.0, 1e-2 * D), xtol=1e-18, rtol=1e-14).root


def _tangents() -> list[float]:
    return [math.tan(math.radians(angle)) for angle in ANGLES]


SITUATIONS: tuple[Situation, ...] = (
    Situation("head-on, elastic", "two smooth spheres, no dashpot", head_on),
    Situation(
        "wall, elastic",
        "a smooth sphere at a plane, no dashpot",
        lambda make: at_floor(make, [0.0], **ELASTIC, **SMOOTH),
    ),
    Situation("head-on, e = 0.5", "two smooth spheres with dashpots", lambda make: head_on(make, restitution=0.5)),
    Situation(
        "head-on, e = 0.2", "two smooth spheres with strong dashpots", lambda make: head_on(make, restitution=0.2)
    ),
    Situation(
        "oblique, elastic",
        "a sphere at a plane at 5 to 75 degrees from the normal, no dashpot",
        lambda make: at_floor(make, _tangents(), **ELASTIC),
    ),
    Situation(
        "oblique, e = 0.5",
        "a sphere at a plane at 5 to 75 degrees from the normal",
        lambda make: at_floor(make, _tangents()),
    ),
    Situation("spin at a wall", "a spinning sphere comes down on a plane", lambda make: at_floor(make, [0.0], SPINS)),
    Situation("two with spin", "two spheres with equal spins meet head-on", _two_spinning),
    Situation("unlike spheres", "a spinning sphere hits one five times as large", _unlike),
    Situation("sliding to rolling", "a sphere on a plane slides until it rolls", slowing),
    Situation("rods, end to end", "end of a rod on the end of another, aside and tilted", _end_to_end, True),
    Situation("rods, crossed", "a rod across another, off the middle, and slipping", _crossed, True),
    Situation("rods, side", "end of a rod on the side of another, tilted by 0.3", lambda make: beside(make, 0.3), True),
    Situation("rods, parallel", "a rod along another, tilted by 0.0001", lambda make: beside(make, 1e-4), True),
    Situation(
        "rod end at a wall", "tilted by 0.7 from the normal, and slipping", lambda make: _at_floor(make, 0.7), True
    ),
    Situation(
        "rod flat at a wall", "both ends, tilted by 0.0001", lambda make: _at_floor(make, math.pi / 2 - 1e-4), True
    ),
    Situation("rod at an edge", "a rod across the edge of a plate, tilted and slipping", _at_edge, True),
)
