"""A dense bed before chaos: the error of positions and velocities by time step, against a step 32 times as small.

A bed at rest is opened, and followed for so short a time that neighbours of a path in phase space have not yet parted.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from labbook.backend import Backend, Settled
from labbook.checks.bench.order import Order, fit_order
from labbook.checks.bench.speed import pongo
from labbook.checks.verify.materials import EVERY_LAW, G, spheres
from labbook.checks.verify.platform import MemberStart, Platform, require
from labbook.filling.opening import start_of_discharge
from labbook.filling.placing import place
from labbook.scene import CylinderSilo, Scene, Spherocylinders
from labbook.scene.packing import Packing
from labbook.scene.timescales import collision

HALVINGS = 5
"""Halvings of the time step from the coarsest to the reference: a factor of 2^5."""
COARSEST = 40
"""Steps of a collision with the coarsest time step."""
FOLLOWED = 0.1
"""Simulated time [sqrt(d/g)]."""
SETTLED = 1e-6
"""Kinetic energy per grain [m g d] of a bed at rest."""
NUDGE = 1e-9
"""Perturbation of positions [d] by which the divergence of neighbouring trajectories is measured."""


@dataclass(frozen=True)
class BedConvergence:
    """Errors of a bed at each number of steps a collision, against the smallest step in double precision.

    Args:
        bed: Name of the bed.
        law: Name of its contact law.
        precision: Precision of the runs.
        grains: Number of grains.
        steps: Steps of a collision, one for each time step, from the coarsest.
        position: Median error of positions over grains [d], by time step.
        farthest: Largest error of positions [d], by time step.
        velocity: Median error of velocities over grains [sqrt(g d)], by time step.
        fastest: Largest error of velocities [sqrt(g d)], by time step.
        order: Order in the time step of the median error of positions. It is fitted to differences between a step and
            its half, which are of the same order as the error whatever the reference.
        order_velocity: Order of the median error of velocities, fitted in the same way.
        growth: Median factor by which a perturbation of positions by 1e-9 d has grown at the end.
    """

    bed: str
    law: str
    precision: str
    grains: int
    steps: tuple[int, ...]
    position: tuple[float, ...]
    farthest: tuple[float, ...]
    velocity: tuple[float, ...]
    fastest: tuple[float, ...]
    order: Order
    order_velocity: Order
    growth: float


def of_spheres(law: str, count: int = 400) -> Scene:
    """Build Fan's grains in a cylinder of 12 d, over a hole of 6 d."""
    grains = spheres(count)
    silo = CylinderSilo(diameter=12 * grains.diameter, height=1.0, orifice=6 * grains.diameter)
    return Scene(grains=grains, contact=EVERY_LAW[law](rolling_friction=0.0), container=silo, gravity=G)


def of_rods(count: int = 250) -> Scene:
    """Build Pongo's rods in a cylinder of 80 mm that does not turn, over a hole of 54 mm, with the linear law."""
    scene = pongo(Spherocylinders(diameter=6e-3, length=20e-3, density=620, count=count), diameter=0.08)
    return scene.model_copy(update={"container": CylinderSilo(diameter=0.08, height=2.0, orifice=0.054)})


def settle(backend: Backend, scene: Scene, device: str = "cpu") -> Packing:
    """Let grains fall in the closed container until they rest, in double precision."""
    closed = scene.close()
    platform = Platform(backend, "double", device)
    fallen = MemberStart(closed, collision(closed) / 30, place(closed, "gas", 1), settled_below=SETTLED)
    trajectory = platform.run(fallen, 3000, 1000, until_event=True)
    require(any(isinstance(event, Settled) for event in trajectory.events), "the bed has not come to rest")
    return trajectory.end


def converge(platform: Platform, label: str, scene: Scene, bed: Packing, say: Callable[[str], None]) -> BedConvergence:
    """Measure the error of a bed after its outlet opens; `bed` rests in the closed container."""
    start, unit = start_of_discharge(bed, scene.close(), scene), math.sqrt(scene.gravity * scene.grains.diameter)
    coarsest, d = collision(scene) / COARSEST, scene.grains.diameter
    count = round(FOLLOWED * math.sqrt(d / scene.gravity) / coarsest)
    exact = Platform(platform.backend, "double", platform.device)

    def ends(on: Platform, begin: Packing, divisor: int) -> Packing:
        say(f"{label}, {on.precision}, t_c/{COARSEST * divisor}")
        return _follow(on, scene, begin, coarsest / divisor, count * divisor)

    finest = ends(exact, start, 2**HALVINGS)
    nudged = np.random.default_rng(1).normal(size=start.x.shape)
    apart = Packing(**{**start.arrays(), "x": start.x + NUDGE * d * nudged})
    growth = _distances(ends(exact, apart, 4).x, ends(exact, start, 4).x) / (NUDGE * d)
    divisors = [2**k for k in range(HALVINGS)]
    ends_by_step = [ends(platform, start, divisor) for divisor in divisors]
    x, v = (
        [_distances(getattr(end_state, name), getattr(finest, name)) for end_state in ends_by_step]
        for name in ("x", "v")
    )
    orders = [
        fit_order(
            1 / np.array(divisors[:-1]),
            [np.median(_distances(getattr(a, n), getattr(b, n))) for a, b in pairwise(ends_by_step)],
        )
        for n in ("x", "v")
    ]
    return BedConvergence(
        bed=label,
        law=scene.contact.law,
        precision=platform.precision,
        grains=len(start),
        steps=tuple(COARSEST * divisor for divisor in divisors),
        position=tuple(float(np.median(e)) / d for e in x),
        farthest=tuple(float(e.max()) / d for e in x),
        velocity=tuple(float(np.median(e)) / unit for e in v),
        fastest=tuple(float(e.max()) / unit for e in v),
        order=orders[0],
        order_velocity=orders[1],
        growth=float(np.median(growth)) / math.sqrt(3),  # the norm of a normal perturbation is sqrt(3) NUDGE
    )


def _follow(platform: Platform, scene: Scene, start: Packing, dt: float, steps: int) -> Packing:
    beats = next(k for k in range(1, steps + 1) if steps % k == 0 and steps // k <= 1000)
    end = platform.run(MemberStart(scene, dt, start), beats, steps // beats).end
    require(len(end) == len(start), "a grain has left")
    order = np.argsort(end.ids) if end.ids is not None else slice(None)
    return Packing(x=end.x[order], v=end.v[order], omega=end.omega[order])


def _distances(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.linalg.norm(a - b, axis=1)


def beds(rods: bool) -> Sequence[tuple[str, Scene]]:
    """List beds by name, those of rods only if `rods` is set."""
    scenes = [("spheres, Hertz", of_spheres("hertz-mindlin")), ("spheres, linear", of_spheres("linear"))]
    return [*scenes, ("rods, linear", of_rods())] if rods else scenes
