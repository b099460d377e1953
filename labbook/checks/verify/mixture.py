"""Spheres that differ in size and material: collisions of unlike pairs, grains at rest on one another, a mixed bed."""

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from labbook.backend.probes import Ledger
from labbook.checks.verify.bed import DT, SOFT, at_rest, borne, in_each
from labbook.checks.verify.case import Case, limited
from labbook.checks.verify.materials import LAWS, D, G, floor, hertz, room
from labbook.checks.verify.platform import MemberStart, Platform, Trajectory, require
from labbook.checks.verify.symmetry import difference
from labbook.filling import place, start_of_discharge
from labbook.scene import (
    Between,
    Bodies,
    HertzMindlin,
    Kind,
    LinearSpringDashpot,
    Packing,
    Primitives,
    Scene,
    Spheres,
    SurfaceChange,
    Uniform,
    WedgeHopper,
)
from labbook.scene.timescales import collision

PAIRS = {("large", "large"): 0.9, ("large", "small"): 0.3, ("small", "small"): 0.6}
"""Restitution between kinds."""
FRICTION = {("large", "large"): 0.5, ("large", "small"): 0.1, ("small", "small"): 0.3}
KINDS = (Kind(name="large", share=0.5), Kind(name="small", share=0.5, diameter=D / 3, density=7800))


def mixed(count: int, law: str, surface: SurfaceChange | None = None, **parameters: Any) -> Scene:
    """Large light and small heavy spheres, each pair of kinds with its own friction and restitution, in a wide room.

    `surface` replaces these for all pairs; `parameters` are those of the law.
    """
    by_pair = {pair: {"restitution": PAIRS[pair], "friction": FRICTION[pair]} for pair in PAIRS}
    surfaces = tuple(
        Between(kinds=pair, **{**own, **(surface or SurfaceChange()).model_dump(exclude_none=True)})
        for pair, own in by_pair.items()
    )
    contact = LAWS[law](**{"rolling_friction": 0.0, "between": surfaces, **parameters})
    grains = Spheres(diameter=D, density=2500, count=count, kinds=KINDS)
    return Scene(grains=grains, contact=contact, container=room(4.0), gravity=0.0)


def pairs(scene: Scene, speed: float, angle: float, dt: float) -> Packing:
    """Place three pairs of grains for each pair of kinds, on courses of collision.

    They touch at three positions within the third step. The centre of mass drifts.

    Args:
        scene: The scene of `mixed`.
        speed: Relative speed [m/s].
        angle: Angle between the relative velocity and the line of centres [rad].
        dt: Time step [s].
    """
    kinds = np.repeat([[("large", "small").index(name) for name in pair] for pair in PAIRS], 3, axis=0)
    kind = kinds.T.ravel()
    n = len(kind) // 2
    diameter = np.array([D, D / 3])[kind]
    rng = np.random.default_rng(3)
    normal, across = rng.normal(size=(2, n, 3))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    across -= np.sum(across * normal, axis=1)[:, None] * normal
    across /= np.linalg.norm(across, axis=1)[:, None]
    v = speed * (math.cos(angle) * normal - math.sin(angle) * across)  # of the second, as the first sees it, reversed
    before = (2 + (np.tile(np.arange(3), n // 3) + 0.5) / 3) * dt
    reach = (diameter[:n] + diameter[n:]) / 2
    centres = np.array([[0.05 * k - 0.2, 0.0, 2.0] for k in range(n)])
    drift = rng.normal(size=(n, 3)) * speed
    x = np.concatenate([centres, centres + normal * reach[:, None] + v * before[:, None]])
    return Packing(
        x=x, v=np.concatenate([drift, drift - v]), omega=np.zeros_like(x), diameter=diameter, kind=kind
    )  # fmt: skip


def _normals(start: Packing, end: Packing, v: np.ndarray, dt: float) -> np.ndarray:
    """Unit normals from first to second of each pair when they touched."""
    n = len(start) // 2
    when = (2 + (np.tile(np.arange(3), n // 3) + 0.5) / 3) * dt
    away = (start.x[n:] - start.x[:n]) - v * when[:, None]
    return away / np.linalg.norm(away, axis=1)[:, None]


def _restores(platform: Platform, law: str) -> Mapping[str, float]:
    scene, speed = mixed(18, law, SurfaceChange(friction=0)), 0.1
    dt = collision(scene.model_copy(update={"gravity": speed**2 / D})) / 500
    start = pairs(scene, speed, 0.0, dt)
    end = platform.run(MemberStart(scene, dt, start), 1, 12000).end
    n, mass = len(start) // 2, Bodies.of(scene.grains, start).mass
    normal = _normals(start, end, start.v[:n] - start.v[n:], dt)
    e = np.sum((end.v[n:] - end.v[:n]) * normal, axis=1) / speed
    nominal = np.repeat(list(PAIRS.values()), 3)
    before, after = (mass[:n, None] * p.v[:n] + mass[n:, None] * p.v[n:] for p in (start, end))
    return {
        "largest |e - asked|": float(np.abs(e - nominal).max()),
        "momentum": float(np.abs(after - before).max() / (mass.max() * speed)),
    }


def _glances(platform: Platform, law: str) -> Mapping[str, float]:
    """Collide elastically, so that the force begins at zero, and slide throughout.

    The tangential impulse is mu times the normal one, and spins each grain by its own lever.
    """
    stiff = {"shear_modulus": 1e12} if law == "hertz-mindlin" else {"normal_stiffness": 1e7}
    speed, angle = 0.1, 1.4
    scene = mixed(18, law, SurfaceChange(restitution=1), **stiff, tangential_damping=0.0)
    dt = collision(scene.model_copy(update={"gravity": (speed * math.cos(angle)) ** 2 / D})) / 500
    start = pairs(scene, speed, angle, dt)
    end = platform.run(MemberStart(scene, dt, start), 1, 12000).end
    n, own = len(start) // 2, Bodies.of(scene.grains, start)
    v = start.v[:n] - start.v[n:]
    normal = _normals(start, end, v, dt)
    vn = np.sum(v * normal, axis=1)
    slip = v - vn[:, None] * normal
    slip /= np.linalg.norm(slip, axis=1)[:, None]
    mu = np.repeat(list(FRICTION.values()), 3)
    impulse = 2 * vn / (1 / own.mass[:n] + 1 / own.mass[n:])
    push = -impulse[:, None] * (normal + mu[:, None] * slip)  # on the first
    turn = np.cross(normal, -(mu * impulse)[:, None] * slip)
    errors = []
    for side, sign in ((slice(None, n), 1.0), (slice(n, None), -1.0)):
        dv, dw = (end.v - start.v)[side], (end.omega - start.omega)[side]
        expected = turn * (own.radius[side] / own.inertia[side])[:, None]
        errors.append(np.linalg.norm(dv - sign * push / own.mass[side][:, None], axis=1) / np.linalg.norm(dv, axis=1))
        errors.append(np.linalg.norm(dw - expected, axis=1) / np.linalg.norm(dw, axis=1))
    return {"velocities": float(np.max(errors[::2])), "spins": float(np.max(errors[1::2]))}


def _conserves(platform: Platform, law: str) -> Mapping[str, float]:
    scene = mixed(18, law, rolling_friction=0.02)
    dt = collision(scene) / 100
    start = pairs(scene, 0.2, 0.5, dt)
    start = replace(start, omega=np.random.default_rng(4).normal(size=start.x.shape) * 0.2 / D)
    trajectories = [platform.run(MemberStart(scene, dt, start), 1, steps, [Ledger()]) for steps in (1, 3000)]
    before, after = ({name: float(column[-1]) for name, column in m.rows(Ledger()).items()} for m in trajectories)
    require(abs(after["kinetic"] / before["kinetic"] - 1) > 0.01, "the pairs did not collide")
    own = Bodies.of(scene.grains, start)
    p = float(own.mass @ np.linalg.norm(start.v, axis=1))
    spin = float(own.inertia @ np.linalg.norm(start.omega, axis=1))
    l = float(own.mass @ np.linalg.norm(np.cross(start.x, start.v), axis=1)) + spin
    change = {name: after[name] - before[name] for name in after}
    return {
        "momentum": math.hypot(*(change[k] for k in ("px", "py", "pz"))) / p,
        "angular momentum": math.hypot(*(change[k] for k in ("lx", "ly", "lz"))) / l,
    }


def _overlap(scene: Scene, force: float, radius: float) -> float:
    """Overlap [m] at which a contact of effective `radius` [m] carries `force` [N], whatever its damping."""
    law = scene.contact
    if isinstance(law, HertzMindlin):
        return (force / (4 / 3 * law.effective_modulus * math.sqrt(radius))) ** (2 / 3)
    assert isinstance(law, LinearSpringDashpot)
    return force / law.normal_stiffness


def _stands(platform: Platform, law: str) -> Mapping[str, float]:
    """A small heavy grain on top of a large one on a floor, exactly upright: both sink in until they are carried."""
    soft = {"shear_modulus": 1e7} if law == "hertz-mindlin" else {}
    scene = mixed(2, law, None, **soft).model_copy(update={"container": Primitives(parts=(floor(),)), "gravity": G})
    scene = scene.model_copy(update={"walls": {"floor": SurfaceChange(restitution=0.1)}})
    r, s = D / 2, D / 6
    own = np.array([D, D / 3]), np.array([0, 1])
    weights = (
        Bodies.of(scene.grains, Packing(np.zeros((2, 3)), np.zeros((2, 3)), np.zeros((2, 3)), None, None, *own)).mass
        * G
    )
    below, between = _overlap(scene, weights.sum(), r), _overlap(scene, weights[1], r * s / (r + s))
    x = np.array([[0, 0, r - below / 2], [0, 0, 2 * r + s - below / 2 - between / 2]])
    start = Packing(x=x, v=np.zeros((2, 3)), omega=np.zeros((2, 3)), diameter=own[0], kind=own[1])
    end = platform.run(MemberStart(scene, 0.05 * collision(scene), start), 40).end
    return {
        "below": abs((r - float(end.x[0, 2])) / below - 1),
        "between": abs((r + s - float(end.x[1, 2] - end.x[0, 2])) / between - 1),
    }


def graded_hopper(count: int = 100) -> Scene:
    """A hopper of grains from 0.6 d to d, of two materials."""
    grains = Spheres(
        diameter=D,
        density=2500,
        count=count,
        sizes=Uniform(smallest=0.6 * D),
        kinds=(Kind(name="glass", share=0.7), Kind(name="steel", share=0.3, density=7800)),
    )
    silo = WedgeHopper(width=10 * D, height=60 * D, thickness=1.01 * D, angle=1.0, orifice=6 * D)
    between = (Between(kinds=("steel", "glass"), friction=0.3, restitution=0.6),)
    return Scene(grains=grains, contact=hertz(**SOFT, between=between), container=silo, gravity=G)


def _carries(platform: Platform) -> Mapping[str, float]:
    return in_each({"graded": borne(platform, graded_hopper().close(), DT / 2, 400)})


def _flows(platform: Platform, start: Packing, steps: int) -> Trajectory:
    return platform.run(MemberStart(graded_hopper(), DT / 2, start), 1, steps)


def _renumbers(platform: Platform) -> Mapping[str, float]:
    closed = graded_hopper().close()
    fallen = platform.run(MemberStart(closed, DT / 2, place(closed, "gas", 1)), 30).end
    start = start_of_discharge(fallen, closed, graded_hopper())
    order = np.random.default_rng(4).permutation(len(start))
    ends = [_flows(platform, packing, 1000).end for packing in (start, start.renumbered(order))]
    moved = difference(start, ends[0])
    require(moved > 0.01, "nothing moved")
    return {"after 4 ms": difference(*ends)}


def _of_laws(name: str, statement: str, source: str, run, measures) -> list[Case]:
    return [
        Case(name=f"{name}-{law}", statement=statement, source=source, measures=measures, run=partial(run, law=law))
        for law in LAWS
    ]


CASES = [
    *_of_laws(
        "unlike-restitution",
        "unlike spheres rebound with the e of their kinds; sizes 3:1, densities 1:3",
        "clamped collision, momentum",
        _restores,
        # momenta are added up over the 1000 steps of a collision, each with a rounding
        {"largest |e - asked|": limited(1e-3, roundings=16), "momentum": limited(1e-12, steps=1e3)},
    ),
    *_of_laws(
        "unlike-impact",
        "grazing unlike spheres exchange 2 m* v_n along the normal and mu times that in the tangential direction",
        "impulse of a sliding impact",
        _glances,
        # while they touch the normal turns by up to the overlap over the radius, 1e-3
        {"velocities": limited(1e-3, roundings=16, steps=1e3), "spins": limited(1e-3, roundings=16, steps=1e3)},
    ),
    *_of_laws(
        "unlike-momenta",
        "contacts of unlike spheres conserve momentum and angular momentum",
        "Newton's third law",
        _conserves,
        # The longest of the collisions takes some 200 steps, and rounds unlike velocities each in its own way. Of the
        # angular momentum levers, torques and spins are rounded too, eight times a step: 200 x 8 x 1.1e-16 = 1.8e-13.
        {"momentum": limited(5e-14, steps=200), "angular momentum": limited(1.8e-13, roundings=8, steps=200)},
    ),
    *_of_laws(
        "unlike-stack",
        "a small grain at rest on a large one: each overlap balances the weight above it",
        "contact laws at rest, effective radius",
        _stands,
        {"below": limited(1e-8, roundings=16), "between": limited(1e-8, roundings=16)},
    ),
    Case(
        name="resting-mixture",
        statement="a bed of two materials and all sizes comes to rest, and the walls carry its weight",
        source="equilibrium",
        measures=at_rest("graded"),
        run=_carries,
        slow=True,
    ),
    Case(
        name="renumbering-mixture",
        statement="renumbered grains of a mixture move equally, except for round-off that grows in collisions",
        source="symmetry",
        measures={"after 4 ms": limited(1e-12, "d", roundings=0.5 * 16)},
        run=_renumbers,
    ),
]
