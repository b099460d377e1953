"""Grains and walls of unlike materials: how long they touch, how deeply, and how an oblique impact turns out."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from labbook.backend.probes import Sample
from labbook.checks.verify.case import Case, limited
from labbook.checks.verify.materials import LAWS, D, room
from labbook.checks.verify.platform import MemberStart, Platform, Trajectory, require
from labbook.scene import Between, Kind, Scene, Spheres, SurfaceChange
from labbook.scene.packing import Packing
from labbook.scene.timescales import collision

R = {"soft": D / 2, "stiff": D / 4}
DENSITY = {"soft": 1500.0, "stiff": 5000.0}
ELASTIC = {"soft": (1e7, 0.45), "stiff": (2e8, 0.1), "wall": (5e7, 0.3)}
"""Young's modulus [Pa] and Poisson's ratio."""
SPRINGS = {("soft", "stiff"): 2e3, ("soft", "wall"): 5e3, ("stiff", "wall"): 3e3}
"""k_n [N/m] of the law linear, whose own is another."""
FRICTION = 0.4
SPEED = 0.1
MOTION = Sample(fields=("x", "v", "omega"))


@dataclass(frozen=True)
class Impact:
    """Two bodies that meet; the second may be the wall. Masses [kg], radii [m]; those of the wall are infinite."""

    bodies: tuple[str, str]
    law: str

    @property
    def radii(self) -> tuple[float, float]:
        """Radii of both [m]."""
        first, second = (R.get(name, math.inf) for name in self.bodies)
        return first, second

    @property
    def masses(self) -> tuple[float, float]:
        """Masses of both [kg]."""
        first, second = (4 / 3 * math.pi * R[n] ** 3 * DENSITY[n] if n in R else math.inf for n in self.bodies)
        return first, second

    @property
    def mass(self) -> float:
        """Effective mass [kg]: 1/m* = 1/m_1 + 1/m_2."""
        return 1 / sum(1 / mass for mass in self.masses)

    @property
    def moduli(self) -> tuple[float, float]:
        """E* and G* [Pa]: 1/E* = sum (1 - nu^2)/E, 1/G* = sum (2 - nu)/G with G = E/(2 (1 + nu))."""
        both = [ELASTIC[name] for name in self.bodies]
        compliance = sum((1 - nu**2) / young for young, nu in both)
        return 1 / compliance, 1 / sum((2 - nu) * 2 * (1 + nu) / young for young, nu in both)

    def normal(self, overlap: float) -> float:
        """Force [N] at an overlap [m]."""
        if self.law == "linear":
            return SPRINGS[self.bodies] * overlap
        radius = 1 / sum(1 / r for r in self.radii)
        return 4 / 3 * self.moduli[0] * math.sqrt(radius) * max(overlap, 0.0) ** 1.5

    @property
    def reach(self) -> float:
        """Spring over overlap at which the contact slides: mu E*/(4 G*), or mu k_n/k_t."""
        return FRICTION * (3.5 if self.law == "linear" else self.moduli[0] / (4 * self.moduli[1]))

    def tangential(self, overlap: float, spring: float) -> float:
        """Force [N] against a spring: mu F_n (1 - (1 - s/s_max)^{3/2}) after Mindlin, or mu F_n s/s_max."""
        if overlap <= 0:
            return 0.0
        fraction = min(abs(spring) / (self.reach * overlap), 1.0)
        share = fraction if self.law == "linear" else 1 - (1 - fraction) ** 1.5
        return -math.copysign(FRICTION * self.normal(overlap) * share, spring)

    @property
    def deepest(self) -> float:
        """Largest overlap [m] of a head-on impact at SPEED."""
        if self.law == "linear":
            return SPEED * math.sqrt(self.mass / SPRINGS[self.bodies])
        return (1.25 * self.mass * SPEED**2 / self.normal(1.0)) ** 0.4

    @property
    def lasts(self) -> float:
        """Duration [s] of that: pi x/v, or 2.943 x/v after Hertz (Landau & Lifshitz, Theory of Elasticity, 9)."""
        factor = math.pi
        if self.law != "linear":
            factor = 0.8 * math.sqrt(math.pi) * math.gamma(0.4) / math.gamma(0.9)
        return factor * self.deepest / SPEED

    def parted(self, slip: float) -> np.ndarray:
        """Relative velocity along x and z [m/s] and the spins [rad/s] with which they part, after an elastic impact.

        The first comes down on the second at SPEED, and along x at `slip` times that. Integrated in the plane: the
        line of centres turns, the contact lies in the plane of the circle in which the surfaces meet, and the spring
        stays at its limit while it slides.
        """
        from scipy.integrate import solve_ivp

        (r1, r2), (m1, m2) = self.radii, self.masses
        wall = math.isinf(r2)
        inertia = 0.4 * m1 * r1**2, math.inf if wall else 0.4 * m2 * r2**2

        def contact(y: np.ndarray) -> tuple[float, np.ndarray, np.ndarray, float, float]:
            """Overlap, normal and tangent, levers of both."""
            if wall:
                return r1 - y[1], np.array([0.0, 1.0]), np.array([1.0, 0.0]), y[1], 0.0
            distance = math.hypot(y[0], y[1])
            n = y[:2] / distance
            lever = (distance**2 + r1**2 - r2**2) / (2 * distance)
            return r1 + r2 - distance, n, np.array([n[1], -n[0]]), lever, distance - lever

        def rates(_: float, y: np.ndarray) -> np.ndarray:
            overlap, n, t, lever, lever_other = contact(y)
            vt, deeper, spring = float(y[2:4] @ t - lever * y[4] - lever_other * y[5]), -float(y[2:4] @ n), float(y[6])
            force = self.tangential(overlap, spring)
            moved, limit = vt, self.reach * deeper
            if abs(spring) >= self.reach * overlap:
                sign = math.copysign(1.0, spring if spring else vt)
                moved = sign * min(sign * vt, limit)
            push = (self.normal(overlap) * n + force * t) / self.mass
            return np.array([*y[2:4], *push, -lever * force / inertia[0], -lever_other * force / inertia[1], moved])

        def apart(_: float, y: np.ndarray) -> float:
            return contact(y)[0]

        apart.terminal, apart.direction = True, -1  # pyright: ignore[reportFunctionMemberAccess]
        distance = r1 if wall else r1 + r2
        start = np.array([0.0, distance * (1 - 1e-12), slip * SPEED, -SPEED, 0.0, 0.0, 0.0])
        span = (0.0, 3 * self.lasts)
        solution = solve_ivp(rates, span, start, events=apart, rtol=1e-9, atol=1e-14, max_step=self.lasts / 1000)
        require(len(solution.t_events[0]) == 1, "the integration did not come to the end of the contact")
        return solution.y[2:6, -1]


def scene_of(law: str) -> Scene:
    """Two kinds of grains and a bottom, each of its own material or stiffness; elastic."""
    hertz = law != "linear"

    def own(name: str) -> dict[str, float]:
        return dict(zip(("youngs_modulus", "poisson_ratio"), ELASTIC[name], strict=True)) if hertz else {}

    kinds = tuple(
        Kind.model_validate({"name": n, "share": 0.5, "diameter": 2 * R[n], "density": DENSITY[n], **own(n)}) for n in R
    )
    between, bottom = (), {"friction": FRICTION, **own("wall")}
    if not hertz:  # at the bottom grains have the stiffness that they have with their kind
        likes = (Between(kinds=(n, n), normal_stiffness=SPRINGS[n, "wall"]) for n in R)
        between = (*likes, Between(kinds=("stiff", "soft"), normal_stiffness=SPRINGS["soft", "stiff"]))
    elastic = {"friction": FRICTION, "rolling_friction": 0, "restitution": 1, "tangential_damping": 0}
    contact = LAWS[law](between=between, **elastic)
    grains = Spheres(diameter=D, density=2500, count=4, kinds=kinds)
    walls = {"bottom": SurfaceChange.model_validate(bottom)}
    return Scene(grains=grains, contact=contact, container=room(4.0), gravity=0.0, walls=walls)


def impacts(law: str) -> tuple[Impact, ...]:
    """The three of `meeting`: one of two grains, and one of each kind with the bottom."""
    return tuple(Impact(bodies, law) for bodies in SPRINGS)


def meeting(slip: float, dt: float) -> Packing:
    """A soft grain above a stiff one, and one of each kind above the bottom: all upper ones come down at SPEED, and
    along x at `slip` times that. They touch in the midst of the third step."""
    soft, stiff = R["soft"], R["stiff"]
    gap = 2.5 * SPEED * dt
    x = [[0, 0, 1 + soft + stiff + gap], [0, 0, 1], [0.1, 0, soft + gap], [-0.1, 0, stiff + gap]]
    v = np.array([[slip * SPEED, 0, -SPEED]] * 4)
    v[1] = 0
    kind = np.array([0, 1, 0, 1])
    diameter = 2 * np.array([soft, stiff])[kind]
    return Packing(x=np.array(x, float), v=v, omega=np.zeros((4, 3)), diameter=diameter, kind=kind)


def _meets(platform: Platform, law: str, slip: float) -> Trajectory:
    scene, three = scene_of(law), impacts(law)
    dt = min(impact.lasts for impact in three) / 400
    require(dt < collision(scene.model_copy(update={"gravity": SPEED**2 / D})), "the stiffest contact sets the step")
    steps = math.ceil(1.5 * max(impact.lasts for impact in three) / dt)
    return platform.run(MemberStart(scene, dt, meeting(slip, dt)), steps, 1, [MOTION])


def _lasts(platform: Platform, law: str) -> Mapping[str, float]:
    trajectory = _meets(platform, law, 0.0)
    z = trajectory.by_beat(MOTION, "z")[:, :, 0]
    distances = (z[:, 0] - z[:, 1], z[:, 2], z[:, 3])
    errors: dict[str, list[float]] = {"duration": [], "deepest": []}
    for impact, distance in zip(impacts(law), distances, strict=True):
        overlap = sum(r for r in impact.radii if math.isfinite(r)) - distance
        crossed = np.flatnonzero(np.diff(np.sign(overlap)))
        require(len(crossed) == 2, "they did not collide once")
        first, last = (k + overlap[k] / (overlap[k] - overlap[k + 1]) for k in crossed)
        errors["duration"].append((last - first) * trajectory.numerics.dt / impact.lasts - 1)
        errors["deepest"].append(float(overlap.max()) / impact.deepest - 1)
    return {name: float(np.abs(values).max()) for name, values in errors.items()}


SLIPS = (0.2, 0.7)
"""Tangential over normal velocity: one that sticks for most of the contact, and one that slides before."""


def _errors(platform: Platform, law: str) -> Mapping[str, float]:
    worst = {"velocities": 0.0, "spins": 0.0}
    for slip in SLIPS:
        end = _meets(platform, law, slip).end
        measured = [(end.v[0] - end.v[1], end.omega[:2, 1]), *((end.v[k], end.omega[[k], 1]) for k in (2, 3))]
        for impact, (v, spins) in zip(impacts(law), measured, strict=True):
            vx, vz, *expected = impact.parted(slip)
            expected = np.array(expected[: len(spins)])
            off = math.hypot(v[0] - vx, v[2] - vz) / SPEED
            worst["velocities"] = max(worst["velocities"], off)
            turned = float(np.abs(spins - expected).max() / np.abs(expected).max())
            worst["spins"] = max(worst["spins"], turned)
    return worst


CASES = [
    *(
        Case(
            name=f"unlike-materials-{law}",
            statement="duration and overlap of elastic impacts of unlike spheres and walls follow from E* or k_n",
            source="Landau & Lifshitz, Theory of Elasticity, 9",
            measures={"duration": limited(1e-3), "deepest": limited(1e-4)},
            run=partial(_lasts, law=law),
        )
        for law in LAWS
    ),
    *(
        Case(
            name=f"unlike-materials-oblique-{law}",
            statement="oblique impacts with sticking and sliding follow from E*/(4 G*) or k_n/k_t",
            source="Mindlin's friction spring, integrated by SciPy",
            measures={
                # a spring begins to grow somewhere within a step, of which a contact has 400 or more; E*/(4 G*) of one
                # of the bodies alone would change velocities by 2e-3 to 3e-2
                "velocities": limited(2e-4, roundings=16, steps=1e3),
                "spins": limited(1e-3, roundings=16, steps=1e3),
            },
            run=partial(_errors, law=law),
        )
        for law in LAWS
    ),
]
