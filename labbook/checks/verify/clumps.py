"""Clumps: free tops of three moments, impacts off their centres, landing on a plane; and clumps of one sphere."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from labbook.backend.probes import Contacts, Ledger, Sample
from labbook.checks.verify.case import Case, limited
from labbook.checks.verify.materials import G, floor
from labbook.checks.verify.platform import MemberStart, Platform, require
from labbook.filling.placing import place
from labbook.scene import Box, Clumps, CylinderSilo, LinearSpringDashpot, Packing, Primitives, Scene, Spheres
from labbook.scene.container import Container
from labbook.scene.orientation import random_turns, rotated

D = 4e-3
SEED = Clumps(
    diameter=D,
    centres=((0.0, 0.0, -0.35 * D), (0.0, 0.0, 0.35 * D), (0.0, 0.3 * D, 0.0)),
    diameters=(D, 0.8 * D, 0.7 * D),
    density=1300,
    count=1,
)
"""A seed with three different moments of inertia."""
PLATE = SEED.model_copy(
    update={
        "centres": ((0.5 * D, 0.0, 0.0), (-0.3 * D, 0.45 * D, 0.0), (-0.3 * D, -0.45 * D, 0.0)),
        "diameters": (),
    }
)  # fmt: skip
"""Three equal spheres in a triangle."""
MOTION = Sample(fields=("x", "v", "omega", "q"))


def clumps(grains: Clumps, count: int, container: Container, gravity: float = 0.0, **law) -> Scene:
    """Build a scene of clumps with linear springs, without friction unless `law` states it."""
    contact = LinearSpringDashpot.model_validate({"normal_stiffness": 2e4, **law})
    return Scene(
        grains=grains.model_copy(update={"count": count}), contact=contact, container=container, gravity=gravity
    )


def clumps_at(x, q, v=None, omega=None) -> Packing:
    """Build a packing of clumps with orientations q [n, 4], at rest unless stated."""
    zero = np.zeros((len(x), 3))
    return Packing(
        x=np.asarray(x, float), v=zero if v is None else np.asarray(v, float),
        omega=zero if omega is None else np.asarray(omega, float), q=np.asarray(q, float),
    )  # fmt: skip


def frame_of(q: np.ndarray) -> np.ndarray:
    """Rotation matrices [n, 3, 3] whose columns are the axes of the body frames at orientations q [n, 4]."""
    return np.stack([rotated(q, axis) for axis in np.eye(3)], axis=2)


def tensors(grains: Clumps, q: np.ndarray) -> np.ndarray:
    """Tensors of inertia [kg m^2] in space at orientations q [n, 4], shape [n, 3, 3]."""
    turn = frame_of(q)
    return turn @ np.diag([grains.largest_inertia, grains.inertia, grains.inertia_axis]) @ turn.transpose(0, 2, 1)


def euler(grains: Clumps, largest: float, least: float, times: np.ndarray) -> np.ndarray:
    """Angular velocities [rad/s] of a free top in its body frame at some times [s], shape [n, 3].

    It begins at (largest, 0, least); Landau & Lifshitz, Mechanics, section 37, whose axes 1, 2, 3 are z, y, x here.
    """
    from scipy.special import ellipj

    i1, i2, i3 = grains.inertia_axis, grains.inertia, grains.largest_inertia
    twice_energy, square = i3 * largest**2 + i1 * least**2, (i3 * largest) ** 2 + (i1 * least) ** 2
    require(square > twice_energy * i2, "the top turns about its axis of the largest moment")
    rate = np.sqrt((i3 - i2) * (square - twice_energy * i1) / (i1 * i2 * i3))
    modulus = (i2 - i1) * (twice_energy * i3 - square) / ((i3 - i2) * (square - twice_energy * i1))
    sn, cn, dn, _ = ellipj(rate * times, modulus)
    middle = -np.sqrt((twice_energy * i3 - square) / (i2 * (i3 - i2)))
    return np.stack([largest * dn, middle * sn, least * cn], axis=1)


def _free(platform: Platform) -> Mapping[str, float]:
    """A top near the separatrix, which flips from one sense of its middle axis to the other and back."""
    grains, least = SEED, 100.0
    bound = least * np.sqrt(
        grains.inertia_axis * (grains.inertia - grains.inertia_axis)
        / (grains.largest_inertia * (grains.largest_inertia - grains.inertia))
    )  # fmt: skip
    largest = 1.002 * bound
    q = random_turns(np.random.default_rng(4), 1)
    body = np.array([largest, 0.0, least])
    omega = frame_of(q)[0] @ body
    scene, probes = clumps(grains, 1, Primitives()), (MOTION, Ledger())
    trajectory = platform.run(MemberStart(scene, 2e-5, clumps_at([[0, 0, 0]], q, omega=[omega])), 20, 1000, probes)
    turns = trajectory.by_beat(MOTION, ("qw", "qx", "qy", "qz"))[:, 0]
    spins = trajectory.by_beat(MOTION, ("wx", "wy", "wz"))[:, 0]
    measured = np.einsum("nji,nj->ni", frame_of(turns), spins)
    expected = euler(grains, largest, least, trajectory.times(MOTION))
    flips = np.sum(np.diff(np.sign(expected[np.abs(expected[:, 1]) > 0.5 * np.abs(expected[:, 1]).max(), 1])) != 0)
    require(bool(flips >= 2), "the top has not flipped")
    momentum = tensors(grains, q)[0] @ omega
    energy, table = 0.5 * omega @ momentum, trajectory.rows(probes[1])
    drift = np.array([table[name] for name in ("lx", "ly", "lz")]).T - momentum
    return {
        "spin": float(np.abs(measured - expected).max() / np.linalg.norm(body)),
        "energy": float(np.abs(table["kinetic"] / energy - 1).max()),
        "angular momentum": float(np.linalg.norm(drift, axis=1).max() / np.linalg.norm(momentum)),
    }


def _impact(platform: Platform) -> Mapping[str, float]:
    """Two turned clumps whose last spheres meet off both centres of mass, while they turn: no friction, e = 1."""
    v, gap, n = 1e-3, 2e-9, np.array([0.36, 0.48, 0.8])
    q, lever_arms, x = _facing(n, gap)
    omega = np.array([[0.02, 0.03, 0.05], [-0.01, 0.02, 0.0]])
    speed = np.array([-v * n + [2e-4, 0.0, 0.0], [0.0, 1e-4, 0.0]])
    scene = clumps(SEED, 2, Primitives(), normal_stiffness=2e5)
    trajectory = platform.run(MemberStart(scene, 2e-7, clumps_at(x, q, speed, omega)), 1, 1500)

    levers = lever_arms - SEED.spheres[TIP].radius * n * np.array([[1.0], [-1.0]])
    across, inertia = np.cross(levers, n), tensors(SEED, q)
    closing = float(n @ (speed[0] - speed[1]) + across[0] @ omega[0] - across[1] @ omega[1])
    reduced = 1 / sum(1 / SEED.mass + r @ np.linalg.solve(i, r) for r, i in zip(across, inertia, strict=True))
    impulse = -2 * reduced * closing * np.array([[1.0], [-1.0]])
    spun = np.array([np.linalg.solve(i, r) for r, i in zip(across, inertia, strict=True)]) * impulse
    require(closing < 0, "the clumps do not meet")
    require(float(np.abs(np.asarray(trajectory.end.q) - q).max()) < 1e-3, "the clumps have turned")
    return {
        "velocities": float(np.abs(trajectory.end.v - speed - impulse / SEED.mass * n).max()) / v,
        "spins": float(np.abs(trajectory.end.omega - omega - spun).max() * D) / v,
    }


TIP = 0
"""The sphere by which seeds meet."""


def _facing(n: np.ndarray, gap: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Orientations [2, 4] of two seeds that are to meet with their tips along n, branches to the tips, and centres [m].

    They are drawn until all other spheres of both are apart, and the tips off the line of centres.
    """
    rng, tip = np.random.default_rng(6), SEED.spheres[TIP]
    while True:
        q = random_turns(rng, 2)
        lever_arms = rotated(q, tip.centre)
        x = np.array([lever_arms[1] - lever_arms[0] + (2 * tip.radius + gap) * n, [0.0, 0.0, 0.0]])
        at = [[x[k] + rotated(q[k : k + 1], sphere.centre)[0] for sphere in SEED.spheres] for k in (0, 1)]
        gaps = [
            float(np.linalg.norm(first - second)) - a.radius - b.radius
            for a, first in zip(SEED.spheres, at[0], strict=True)
            for b, second in zip(SEED.spheres, at[1], strict=True)
        ]
        if np.sort(gaps)[1] > 0.1 * D and np.linalg.norm(np.cross(lever_arms, n), axis=1).min() > 0.15 * D:
            return q, lever_arms, x


SPEED, RESTITUTION = 0.1, 0.8
LANDINGS = {"flat": (PLATE, 0), "on edge": (PLATE, 3), "a seed": (SEED, 5)}
"""Clumps that land, with the seed of the orientation; 0: flat on all three spheres."""


def landed(
    grains: Clumps, q: np.ndarray, height: float, stiffness: float, time: float
) -> tuple[np.ndarray, np.ndarray]:
    """Velocity [m/s] and spin [rad/s] of a clump after it fell on a plane, by SciPy: a spring and a dashpot a sphere.

    Textbook damping of e for the whole mass at one sphere: gamma = 2 sqrt(k m) |ln e|/sqrt(pi^2 + ln^2 e). Forces are
    never attractive. The state is x, v, the rotation matrix and the angular momentum in space.
    """
    from scipy.integrate import solve_ivp

    loss = -np.log(RESTITUTION)
    damping = 2 * np.sqrt(stiffness * grains.mass) * loss / np.hypot(np.pi, loss)
    centres = np.array([sphere.centre for sphere in grains.spheres])
    radii = np.array([sphere.radius for sphere in grains.spheres])
    inverse = 1 / np.array([grains.largest_inertia, grains.inertia, grains.inertia_axis])

    def slope(_, s):
        turn, momentum = s[6:15].reshape(3, 3), s[15:]
        spin = turn @ (inverse * (turn.T @ momentum))
        levers = centres @ turn.T
        depth = radii - (s[2] + levers[:, 2])
        rate = s[5] + np.cross(spin, levers)[:, 2]
        push = np.where(depth > 0, np.maximum(stiffness * depth - damping * rate, 0.0), 0.0)
        force = np.array([0.0, 0.0, push.sum()])
        torque = np.sum(np.cross(levers, np.outer(push, [0.0, 0.0, 1.0])), axis=0)
        return np.concatenate([s[3:6], force / grains.mass, np.cross(spin, turn.T).T.ravel(), torque])

    turn = frame_of(q[None])[0]
    start = np.concatenate([[0.0, 0.0, height], [0.0, 0.0, -SPEED], turn.ravel(), np.zeros(3)])
    end = solve_ivp(slope, (0, time), start, method="RK45", rtol=1e-9, atol=1e-13, max_step=4e-6).y[:, -1]
    turn = end[6:15].reshape(3, 3)
    return end[3:6], turn @ (inverse * (turn.T @ end[15:]))


def _lands(platform: Platform) -> Mapping[str, float]:
    errors, dt, steps, stiffness = {}, 2e-7, 4000, 2e4
    for name, (grains, seed) in LANDINGS.items():
        q = (
            np.array([0.5**0.5, 0.0, -(0.5**0.5), 0.0])
            if seed == 0
            else random_turns(np.random.default_rng(seed), 1)[0]
        )
        lowest = min(rotated(q[None], sphere.centre)[0, 2] - sphere.radius for sphere in grains.spheres)
        height = 1e-6 - float(lowest)
        scene = clumps(grains, 1, Primitives(parts=(floor(),)), restitution=RESTITUTION, damping="textbook",
                       normal_stiffness=stiffness)  # fmt: skip
        start = MemberStart(scene, dt, clumps_at([[0, 0, height]], [q], [[0, 0, -SPEED]]))
        end = platform.run(start, 1, steps).end
        v, spin = landed(grains, q, height, stiffness, dt * steps)
        require(v[2] > -0.5 * SPEED, f"{name}: the clump has not hit the plane")
        off = float(np.abs(end.v[0] - v).max()), float(np.abs(end.omega[0] - spin).max()) * grains.reach
        errors[name] = max(off) / SPEED
    return errors


def _conserves(platform: Platform) -> Mapping[str, float]:
    """Three clumps that meet with friction: forces are opposite and act at one point of both."""
    rng = np.random.default_rng(8)
    x = np.array([[0.0, 0.0, 0.0], [1.6 * D, 0.3 * D, 0.0], [0.2 * D, 1.7 * D, 0.4 * D]])
    v, omega = -x / D * 0.1, rng.normal(size=(3, 3)) * 20
    scene = clumps(SEED, 3, Primitives(), friction=0.5, rolling_friction=0.05, restitution=0.7)
    probe = Ledger()
    start = MemberStart(scene, 2e-6, clumps_at(x, random_turns(rng, 3), v, omega))
    trajectory = platform.run(start, 20, 500, (probe,))
    table = trajectory.rows(probe)
    require(float(np.min(table["kinetic"])) < 0.9 * table["kinetic"][0], "no energy was lost")
    scale = SEED.mass * 0.1, SEED.mass * 0.1 * D
    drift = [np.ptp([table[f"{kind}{axis}"] for axis in "xyz"], axis=1).max() for kind in "pl"]
    return {"momentum": float(drift[0] / scale[0]), "angular momentum": float(drift[1] / scale[1])}


def _rests(platform: Platform) -> Mapping[str, float]:
    """Let eight seeds fall into a narrow box: at the end the bottom and the sides carry their weight."""
    n, box = 8, Box(width=2.2 * D, depth=2.2 * D, height=0.2)
    law = {"normal_stiffness": 150, "friction": 0.5, "rolling_friction": 0.1, "restitution": 0.2}
    scene, probe = clumps(SEED, n, box, gravity=G, **law), Contacts(every=20)
    start = place(scene, "gas", 3)
    start = replace(start, v=np.zeros_like(start.v))
    trajectory = platform.run(MemberStart(scene, 5e-5, start), 20, 400, (probe,))
    rows, weight = trajectory.rows(probe), n * SEED.mass * G
    at_wall = rows["wall"] >= 0
    require(int(np.sum(~at_wall)) >= n, "the seeds do not lie on one another")
    forces = np.array([rows[name][at_wall].sum() for name in ("fx", "fy", "fz")])
    return {
        "energy": trajectory.status.kinetic,
        "weight": float(np.abs(forces - [0.0, 0.0, weight]).max()) / weight,
    }


def _spheres_too(platform: Platform) -> Mapping[str, float]:
    """Drop clumps of one sphere and spheres into a silo, for a time in which round-off has not grown yet."""
    d, law = 6e-3, LinearSpringDashpot(normal_stiffness=200, friction=0.5, rolling_friction=0.01, restitution=0.5)
    n, ends = 12, []
    for grains in (
        Spheres(diameter=d, density=620, count=n),
        Clumps(diameter=d, centres=((d, 2 * d, 0.0),), density=620, count=n),
    ):
        silo = CylinderSilo(diameter=3.5 * d, height=1.0, orifice=3 * d)
        bed = Scene(grains=grains, contact=law, container=silo, gravity=G).close()
        start = place(bed.model_copy(update={"grains": Spheres(diameter=d, density=620, count=n)}), "gas", 1)
        if grains.shape == "clump":
            start = replace(start, q=random_turns(np.random.default_rng(2), n))
        ends.append(platform.run(MemberStart(bed, 4e-5, start), 1, 2500).end)
    require(len(ends[0].wall_grain) + len(ends[0].pairs) > 5, "the grains have not met")
    return {
        "position": float(np.abs(ends[0].x - ends[1].x).max()) / d,
        "spin": float(np.abs(ends[0].omega - ends[1].omega).max() / np.abs(ends[0].omega).max()),
    }


CASES = [
    Case(
        name="clump-free-top",
        statement="a free clump of three moments flips about its middle axis for 20 000 steps as Jacobi's functions do",
        source="Landau & Lifshitz, Mechanics, section 37",
        measures={
            "spin": limited(2e-4, steps=100),
            "energy": limited(1e-6, steps=2),
            "angular momentum": limited(1e-8, steps=2),
        },
        run=_free,
    ),
    Case(
        name="clump-impact",
        statement="clumps colliding off their centres exchange the impulse 2 m_red v_n, without friction at e = 1",
        source="rigid bodies, m_red = 1/sum(1/m + (r x n).I^-1 (r x n))",
        measures={"velocities": limited(1e-3), "spins": limited(1e-3)},
        run=_impact,
    ),
    Case(
        name="clump-landing",
        statement="a clump that lands on a plane, on all its spheres at once or on one after the other",
        source="SciPy, a spring and a dashpot at each sphere",
        measures={name: limited(1e-3) for name in LANDINGS},
        run=_lands,
    ),
    Case(
        name="clump-momenta",
        statement="clumps that meet with friction keep the sum of their momenta and angular momenta",
        source="Newton's third law",
        measures={"momentum": limited(1e-10, roundings=100), "angular momentum": limited(1e-10, roundings=100)},
        run=_conserves,
    ),
    Case(
        name="clump-bed-at-rest",
        statement="a bed of clumps comes to rest, and its walls carry its weight",
        source="balance of forces; energy of a grain in m g d",
        measures={"energy": limited(1e-6, roundings=10), "weight": limited(1e-3)},
        run=_rests,
    ),
    Case(
        name="clump-of-one-sphere",
        statement="clumps of one sphere move as spheres do",
        source="geometry",
        measures={"position": limited(1e-12, roundings=100), "spin": limited(1e-12, roundings=1e4)},
        run=_spheres_too,
    ),
]
