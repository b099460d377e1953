"""Impacts in a plane, integrated by SciPy: equations of motion of a contact law for two bodies, or one at a wall.

An independent integration: it knows of the backends neither formulas nor the leapfrog. Bodies move in the plane of x
and z and turn about y. A contact sticks or slides; both regimes are smooth, and what parts them is found as an event:

* a touch begins and ends where the overlap is zero;
* a contact that sticks begins to slide where what the law limits reaches the limit;
* while it slides its spring follows from the limit, and it sticks again where the slip velocity would shorten it;
* by the law of LIGGGHTS, whose dashpot is there only while a contact sticks, it may go back and forth between both
  without end: it then has the part of the dashpot that keeps it between them (Filippov's solution).

What is limited, and by what, is the law's (docs/contact-laws.md).
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, Self

import numpy as np

from labbook.checks.verify.platform import require
from labbook.scene import ContactLaw, LinearSpringDashpot, Scene, Spheres, Surface
from labbook.scene.contact import Hertz
from labbook.scene.packing import Packing

RTOL = 1e-12
ACROSS = 2e-7
"""Regularisation of the closest points of rods: |branch|^2 + ACROSS (s^2 + t^2) is least (docs/rods.md)."""
BEFORE = 0.02
"""Free flight before the first touch, in durations of a collision."""
Wall = Literal["none", "floor", "edge"]
"""Wall of an impact: none, the plane z = 0, or the edge of a plate that runs along y through the origin."""
Regime = Literal["open", "gone", "sticks", "slides", "grips"]
"""Regime of a contact. `gone`: the bodies still overlap, but part so fast that a force that may not pull is zero.
`grips`: between sticking and sliding, with a part of the dashpot."""


@dataclass(frozen=True)
class PlanarBody:
    """A sphere, a rod in the plane, or a rod across it (half = 0), at the first touch.

    mass [kg], inertia about y [kg m^2], radius and half length of the segment in the plane [m], place (x, z) [m], angle
    from the z axis about y, velocity (x, z) [m/s], spin about y [rad/s].
    """

    mass: float
    inertia: float
    radius: float
    half: float
    position: tuple[float, float]
    velocity: tuple[float, float]
    angle: float = 0.0
    spin: float = 0.0

    @property
    def size(self) -> float:
        """Largest distance of a point of the body from its centre [m]."""
        return self.radius + self.half

    @classmethod
    def sphere(
        cls, grains: Spheres, position: tuple[float, float], velocity: tuple[float, float], spin: float = 0.0
    ) -> Self:
        """Build one sphere of some grains."""
        return cls(grains.mass, grains.inertia, grains.radius, 0.0, position, velocity, spin=spin)

    def after(self, time: float) -> "PlanarBody":
        """Return the body after free flight over `time` [s], which may be negative."""
        (x, z), (vx, vz) = self.position, self.velocity
        return replace(self, position=(x + vx * time, z + vz * time), angle=self.angle + self.spin * time)


class PlanarContact(NamedTuple):
    """Geometry of a possible contact of two bodies, or of a body and a wall.

    `overlap` [m], negative before the touch; `normal`: unit vector towards the first body; `first`, `second`: branch
    vectors from both centres to the contact point [m].
    """

    overlap: float
    normal: np.ndarray
    first: np.ndarray
    second: np.ndarray


@dataclass(frozen=True)
class PlanarLaw:
    """A contact law for a contact of effective `radius` [m] and `mass` [kg].

    Its forces act on the first body, along the normal and the tangent. In its methods vn and vt are relative velocities
    [m/s], and s is the friction spring [m]. The formulas are those of docs/contact-laws.md, written again.
    """

    law: ContactLaw
    surface: Surface
    radius: float
    mass: float

    @property
    def _slope(self) -> float:
        assert isinstance(self.law, Hertz)
        return 4 / 3 * self.law.effective_modulus * math.sqrt(self.radius)

    @property
    def _ratio(self) -> float:
        """E*/(4 G*) = (2 - nu)/(2 (1 - nu)) of two like materials."""
        assert isinstance(self.law, Hertz)
        return (2 - self.law.poisson_ratio) / (2 * (1 - self.law.poisson_ratio))

    @property
    def pulls(self) -> bool:
        """True if the normal force may be attractive."""
        return isinstance(self.law, Hertz) and self.law.pulls

    def pressing(self, overlap: float, vn: float) -> float:
        """Normal force [N] of spring and dashpot, attractive or not."""
        overlap = max(overlap, 0.0)
        ratio = self.law.damping_ratio(self.surface.restitution)
        if isinstance(self.law, LinearSpringDashpot):
            k = self.law.normal_stiffness
            return k * overlap - 2 * ratio * math.sqrt(k * self.mass) * vn
        stiff = self._slope * math.sqrt(overlap)
        return stiff * overlap - ratio * math.sqrt(6 * self.mass * stiff) * vn

    def normal(self, overlap: float, vn: float) -> float:
        """Normal force [N]."""
        force = self.pressing(overlap, vn)
        return force if self.pulls else max(force, 0.0)

    def tangential(self, overlap: float) -> tuple[float, float]:
        """Stiffness [N/m] and dashpot [kg/s] of a linear friction spring."""
        ratio = self.law.damping_ratio(self.surface.restitution)
        if isinstance(self.law, LinearSpringDashpot):
            k = self.law.normal_stiffness
            dashpot = self.law.tangential_damping * 2 * ratio * math.sqrt(k * self.mass)
            return self.law.tangential_stiffness * k, dashpot
        assert isinstance(self.law, Hertz)
        stiff = self._slope * math.sqrt(max(overlap, 0.0))
        k_t = 1.5 * stiff / self._ratio
        ratio *= self.law.tangential_damping
        if self.law.law == "hertz-liggghts":
            return k_t, 2 * ratio * math.sqrt(k_t * self.mass)
        return k_t, ratio * math.sqrt(6 * self.mass * stiff)

    @property
    def stiff_from_touch(self) -> bool:
        """True if stiffness and dashpots have their full size from the first touch."""
        return isinstance(self.law, LinearSpringDashpot)

    @property
    def grips(self) -> bool:
        """True if the dashpot acts only while a contact sticks."""
        return self.law.law == "hertz-liggghts" and self.law.damping_ratio(self.surface.restitution) > 0

    @property
    def _mindlin(self) -> bool:
        return self.law.law in ("hertz-mindlin", "hertz-printed")

    def limit(self, overlap: float, vn: float, pushes: float = 1.0) -> float:
        """Largest value of `limited`: a spring [m] after Mindlin, else a force [N].

        pushes: sign of the normal force. With it the limit has no bend where the force changes its sign.
        """
        mu = self.surface.friction
        if self.law.law == "hertz-printed":
            return math.inf
        if self._mindlin:
            return self._farthest(overlap, vn)
        return mu * pushes * self.normal(overlap, vn)

    def _farthest(self, overlap: float, vn: float) -> float:
        """s_max [m] of the laws after Mindlin: mu kappa F_n/K; of the printed law with F_n^e, so mu kappa delta."""
        overlap = max(overlap, 0.0)
        if self.law.law == "hertz-printed" or overlap == 0:
            return self.surface.friction * self._ratio * overlap
        stiff = self._slope * math.sqrt(overlap)
        return self.surface.friction * self._ratio * self.normal(overlap, vn) / stiff

    def limited(self, overlap: float, s: float, vt: float) -> float:
        """Variable that is limited while the contact sticks: the spring [m] after Mindlin, else a force [N]."""
        if self._mindlin:
            return s
        k, dashpot = self.tangential(overlap)
        return k * s if self.law.law == "hertz-liggghts" else k * s + dashpot * vt

    def spring(self, overlap: float, limited: float, vt: float) -> float:
        """Spring [m] at which `limited` has a given value."""
        if self._mindlin:
            return limited
        k, dashpot = self.tangential(overlap)
        return limited / k if self.law.law == "hertz-liggghts" else (limited - dashpot * vt) / k

    def friction(self, overlap: float, vn: float, s: float, vt: float, damped: float) -> float:
        """Tangential force [N]; damped: acting part of the dashpot, for a law whose dashpot acts only in sticking."""
        if self._mindlin:
            return self._mindlins(overlap, vn, s, vt)
        k, dashpot = self.tangential(overlap)
        return -k * s - (damped if self.grips else 1.0) * dashpot * vt

    def _mindlins(self, overlap: float, vn: float, s: float, vt: float) -> float:
        """mu F_n (1 - u^{3/2}), u = 1 - s/s_max, and a dashpot of C_t sqrt(6 m* K_t sqrt(u)), together at most mu F_n;
        of the printed law F_n^e in place of F_n, and no limit."""
        assert isinstance(self.law, Hertz)
        mu, overlap = self.surface.friction, max(overlap, 0.0)
        farthest = self._farthest(overlap, vn)
        if farthest <= 0:
            return 0.0
        u = 1 - min(abs(s) / farthest, 1.0)
        stiff = self._slope * math.sqrt(overlap)
        c_t = self.law.tangential_damping * self.law.damping_ratio(self.surface.restitution)
        dashpot = c_t * math.sqrt(6 * self.mass * stiff / self._ratio * math.sqrt(u))
        printed = self.law.law == "hertz-printed"
        limit = mu * (stiff * overlap if printed else self.normal(overlap, vn))
        force = -math.copysign(limit * (1 - u**1.5), s) - dashpot * vt
        if printed:
            return force
        return min(max(force, -limit), limit)

    def first(self, vn: float, vt: float, duration: float) -> tuple[Regime, float, float]:
        """Regime of a contact at its beginning, the side to which it slides, and its spring [m].

        By some laws after Hertz a contact slides at first touch, which leaves a spring of any length. So the first
        1e-8 of the duration is integrated in growing steps, with constant velocities and the limit applied.
        """
        s, sign, slides = 0.0, 1.0, False
        times = duration * np.geomspace(1e-13, 1e-8, 600)
        for step, time in zip(np.diff(times, prepend=0.0), times, strict=True):
            overlap = -vn * time
            s += vt * step
            value, limit = self.limited(overlap, s, vt), self.limit(overlap, vn)
            slides = abs(value) > limit
            if slides:
                sign = math.copysign(1.0, value)
                s = self.spring(overlap, sign * limit, vt)
        return ("slides" if slides else "sticks"), sign, s


@dataclass(frozen=True)
class PlanarImpact:
    """Impact of one or two bodies of a scene in the plane, given at the first touch.

    Args:
        scene: The scene.
        bodies: The bodies at the first touch.
        wall: Wall at which a single body strikes.
        speed: Normal speed at the touch [m/s].
        lasts: Duration of a collision [s], the unit of `follow` and of time steps.
        follow: Durations to follow after the first touch; all contacts end before, unless there is gravity.
        turned: Orientations of rods across the plane, in place of those by their angles; empty: all in the plane.
    """

    scene: Scene
    bodies: tuple[PlanarBody, ...]
    wall: Wall
    speed: float
    lasts: float
    follow: float = 1.5
    turned: tuple[tuple[float, float, float, float], ...] = ()

    @classmethod
    def of(cls, scene: Scene, bodies: tuple[PlanarBody, ...], wall: Wall, speed: float, **options: Any) -> Self:
        """Build an impact along the normal at `speed` [m/s], with the duration of its contact by the law."""
        law = cls(scene, bodies, wall, speed, 1.0).law()
        return cls(scene, bodies, wall, speed, law.law.collision_time(law.mass, law.radius, speed), **options)

    def law(self) -> PlanarLaw:
        """Return the law of its contact; rods count as spheres of their radius and mass."""
        first, second = self.bodies[0], self.bodies[-1]
        scene = self.scene
        if self.wall != "none":
            (wall,) = scene.container.walls()
            return PlanarLaw(scene.law(wall, 0), scene.surface(wall, 0), first.radius, first.mass)
        kind = len(scene.grains.species) - 1
        radius = first.radius * second.radius / (first.radius + second.radius)
        mass = first.mass * second.mass / (first.mass + second.mass)
        return PlanarLaw(scene.law_between(0, kind), scene.surface_between(0, kind), radius, mass)

    def packing(self, before: float) -> Packing:
        """Place the bodies as they are `before` [s] the first touch."""
        bodies = [body.after(-before) for body in self.bodies]
        x = np.array([[b.position[0], 0.0, b.position[1]] for b in bodies])
        v = np.array([[b.velocity[0], 0.0, b.velocity[1]] for b in bodies])
        omega = np.array([[0.0, b.spin, 0.0] for b in bodies])
        q = None
        if self.scene.grains.shape == "spherocylinder":
            q = np.array([[math.cos(b.angle / 2), 0.0, math.sin(b.angle / 2), 0.0] for b in bodies])
            for row, turned in enumerate(self.turned):
                q[row] = turned if any(turned) else q[row]
        if self.scene.grains.varied:
            sizes = np.array([2 * b.radius for b in bodies])
            kinds = np.arange(len(bodies)) if len(self.scene.grains.species) > 1 else None
            return Packing(x=x, v=v, omega=omega, q=q, diameter=sizes, kind=kinds)
        return Packing(x=x, v=v, omega=omega, q=q)

    def parted(self, rtol: float = RTOL) -> np.ndarray:
        """Velocities along x and z [m/s] and spins [rad/s] of the bodies at the end, by SciPy: shape [bodies, 3]."""
        return _Flight(self).ends(rtol)

    def error(self, packing: Packing, expected: np.ndarray) -> np.ndarray:
        """Differences of velocities, and of spins times the size of the body, over the speed: shape [bodies, 6]."""
        speeds, spins = np.zeros((len(self.bodies), 3)), np.zeros((len(self.bodies), 3))
        speeds[:, [0, 2]], spins[:, 1] = expected[:, :2], expected[:, 2]
        sizes = np.array([[body.size] for body in self.bodies])
        return np.hstack([packing.v - speeds, (packing.omega - spins) * sizes]) / self.speed


class _Flight:
    """Integration of an impact. State: displacement, turn, velocity and spin of each body, then the springs."""

    def __init__(self, impact: PlanarImpact):
        self.impact, self.law = impact, impact.law()
        self.start = [body.after(-BEFORE * impact.lasts) for body in impact.bodies]
        self.contacts = 2 if impact.wall == "floor" and impact.bodies[0].half else 1
        self.regimes: list[Regime] = ["open"] * self.contacts
        self.signs = [1.0] * self.contacts
        self.shares: dict[int, float] = {}
        self.damped = self.law.law.damping_ratio(self.law.surface.restitution) > 0
        self.pushes = [1.0] * self.contacts
        self.tiny = 1e-5 * impact.lasts

    def _pose(self, y: np.ndarray, k: int) -> tuple[np.ndarray, float]:
        body = self.start[k]
        return np.array(body.position) + y[6 * k : 6 * k + 2], body.angle + y[6 * k + 2]

    def meetings(self, y: np.ndarray) -> list[PlanarContact]:
        """Geometry of all possible contacts, touching or not."""
        impact, first = self.impact, self.start[0]
        x, angle = self._pose(y, 0)
        a = np.array([math.sin(angle), math.cos(angle)])
        nowhere = np.zeros(2)
        if impact.wall == "floor":
            n = np.array([0.0, 1.0])
            ends = (-first.half, first.half) if first.half else (0.0,)
            at = [x + end * a for end in ends]
            return [PlanarContact(first.radius - p[1], n, p - x - n * p[1], nowhere) for p in at]
        if impact.wall == "edge":
            reach = -float(x @ a) / (1 + ACROSS) if first.half else 0.0
            point = x + min(max(reach, -first.half), first.half) * a
            distance = math.hypot(*point)
            return [PlanarContact(first.radius - distance, point / distance, -x, nowhere)]
        second = self.start[1]
        x2, angle2 = self._pose(y, 1)
        b = np.array([math.sin(angle2), math.cos(angle2)])
        s, t = _closest(x - x2, a, b, first.half, second.half)
        away = x + s * a - x2 - t * b
        distance = math.hypot(*away)
        n = away / distance
        lever = (distance**2 + first.radius**2 - second.radius**2) / (2 * distance)
        overlap = first.radius + second.radius - distance
        return [PlanarContact(overlap, n, s * a - lever * n, t * b + (distance - lever) * n)]

    def speeds(self, y: np.ndarray, at: PlanarContact) -> tuple[float, float, np.ndarray]:
        """Relative velocities along the normal and the tangent [m/s], and the tangent."""
        v = _at_point(y[3:6], at.first)
        if len(self.start) > 1:
            v = v - _at_point(y[9:12], at.second)
        t = np.array([at.normal[1], -at.normal[0]])
        return float(v @ at.normal), float(v @ t), t

    def rates(self, y: np.ndarray) -> np.ndarray:
        """Rates of the state. Springs of sliding contacts follow from the other variables, so their rates are zero."""
        out, bodies = np.zeros_like(y), len(self.start)
        for k in range(bodies):
            out[6 * k : 6 * k + 3] = y[6 * k + 3 : 6 * k + 6]
            out[6 * k + 4] = -self.impact.scene.gravity
        for c, at in enumerate(self.meetings(y)):
            if self.regimes[c] in ("open", "gone"):
                continue
            vn, vt, tangent = self.speeds(y, at)
            sticks = self.regimes[c] == "sticks"
            s = float(y[6 * bodies + c]) if sticks else self._sliding(c, y, at)
            friction = self.law.friction(at.overlap, vn, s, vt, self._damped(c, y))
            force = self.law.normal(at.overlap, vn) * at.normal + friction * tangent
            for k, (push, lever_arm) in enumerate(((force, at.first), (-force, at.second))[:bodies]):
                out[6 * k + 3 : 6 * k + 5] += push / self.start[k].mass
                out[6 * k + 5] += (lever_arm[1] * push[0] - lever_arm[0] * push[1]) / self.start[k].inertia
            out[6 * bodies + c] = vt if sticks else 0.0
        return out

    def _damped(self, c: int, y: np.ndarray) -> float:
        """Acting part of the dashpot."""
        if c in self.shares:
            return self.shares[c]
        return self.gripping(c, y) if self.regimes[c] == "grips" else float(self.regimes[c] == "sticks")

    def gripping(self, c: int, y: np.ndarray) -> float:
        """Part of the dashpot that keeps a contact at its limit between sticking and sliding.

        It keeps `slipping` at zero where that depends on the part. Friction of rods changes the normal velocity of
        the contact, and so `slipping`. Elsewhere the part keeps the rate of change of `slipping` at zero.
        """
        without, whole = self._slips(c, y)
        if not self._coupled(without, whole):
            without, whole = (self._turning(c, y, share) for share in (0.0, 1.0))
        return without / (without - whole)

    def _grips(self, c: int, y: np.ndarray) -> bool:
        """True if a contact at its limit would slide with a dashpot, and stick without."""
        without, whole = self._slips(c, y)
        if not self._coupled(without, whole):
            without, whole = (self._turning(c, y, share) for share in (0.0, 1.0))
        return without < 0 < whole

    def _coupled(self, without: float, whole: float) -> bool:
        return abs(without - whole) > 1e-6 * self.impact.speed

    def _slips(self, c: int, y: np.ndarray) -> tuple[float, float]:
        """`slipping` without the dashpot, and with all of it."""
        slips = []
        for share in (0.0, 1.0):
            self.shares[c] = share
            slips.append(self.slipping(c, y))
            del self.shares[c]
        return slips[0], slips[1]

    def _turning(self, c: int, y: np.ndarray, share: float) -> float:
        """Change of `slipping` in time [m/s^2] with this part of the dashpot."""
        self.shares[c] = share
        rate, step = self.rates(y), 30 * self.tiny
        change = (self.slipping(c, y + step * rate) - self.slipping(c, y - step * rate)) / (2 * step)
        del self.shares[c]
        return change

    def _sliding(self, c: int, y: np.ndarray, at: PlanarContact | None = None) -> float:
        """The spring [m] of a contact that slides."""
        at = at or self.meetings(y)[c]
        vn, vt, _ = self.speeds(y, at)
        if at.overlap <= 0 and not self.law.stiff_from_touch:
            return 0.0
        return self.law.spring(at.overlap, self.signs[c] * self.law.limit(at.overlap, vn, self.pushes[c]), vt)

    def _push(self, c: int, y: np.ndarray) -> float:
        at = self.meetings(y)[c]
        return self.law.pressing(at.overlap, self.speeds(y, at)[0])

    def slipping(self, c: int, y: np.ndarray) -> float:
        """Speed at which a sliding contact leaves its spring behind [m/s]; where it is negative the contact sticks."""
        at = self.meetings(y)[c]
        vn, vt, _ = self.speeds(y, at)
        rate, speed = self.rates(y), self.impact.speed
        if self.law.stiff_from_touch:
            step = math.copysign(self.tiny, -vn)  # the limit has a bend where the contact begins, and where it ends
            now, next_slip, later = (self._sliding(c, y + k * step * rate) for k in range(3))
            return self.signs[c] * (vt - (4 * next_slip - 3 * now - later) / (2 * step))
        if at.overlap <= 1e-9 * speed * self.impact.lasts:  # `PlanarLaw.first` has decided
            return abs(vt) + speed
        step = min(self.tiny, 0.01 * at.overlap / (abs(vn) + 1e-9 * speed))
        change = (self._sliding(c, y + step * rate) - self._sliding(c, y - step * rate)) / (2 * step)
        return self.signs[c] * (vt - change)

    def above(self, c: int, y: np.ndarray) -> float:
        """Excess of a contact's limited variable over its limit, a spring [m] or a force [N]; negative while it sticks.
        The limit is raised by a part of 1e-10, so that rounding starts no sliding."""
        at = self.meetings(y)[c]
        vn, vt, _ = self.speeds(y, at)
        limit = self.law.limit(at.overlap, vn, self.pushes[c])
        if math.isinf(limit):
            return -1.0
        return abs(self.law.limited(at.overlap, float(y[6 * len(self.start) + c]), vt)) - limit * (1 + 1e-10)

    def _events(self) -> Iterator[tuple[int, str, object]]:
        for c, regime in enumerate(self.regimes):
            yield (
                c,
                "ends" if regime != "open" else "begins",
                _event(lambda _, y, c=c: self.meetings(y)[c].overlap, -1 if regime != "open" else 1),
            )
            if self.damped and regime not in ("open", "gone"):
                change = "turns" if self.law.pulls else "goes"
                yield c, change, _event(lambda _, y, c=c: self.pushes[c] * self._push(c, y), -1)
            if regime == "gone":
                yield c, "presses", _event(lambda _, y, c=c: self._push(c, y), 1)
            if regime == "sticks" and self.law.surface.friction > 0:
                yield c, "slides", _event(lambda _, y, c=c: self.above(c, y), 1)
            if regime == "slides":
                yield c, "sticks", _event(lambda _, y, c=c: self.slipping(c, y), -1)
            if regime == "grips":
                yield c, "sticks", _event(lambda _, y, c=c: self.gripping(c, y) - 1, 1)
                yield c, "slides", _event(lambda _, y, c=c: self.gripping(c, y), -1)

    def _change(self, c: int, change: str, y: np.ndarray) -> None:
        """Change the regime of contact c after an event, and put the spring of the new regime into the state y."""
        spring, was = 6 * len(self.start) + c, self.regimes[c]
        least = 1e-9 * self.law.mass * self.impact.speed / self.impact.lasts
        turns_at_once = (
            change == "slides" and self.law.pulls and self.damped and self.pushes[c] * self._push(c, y) < least
        )
        if change == "turns" or turns_at_once:
            self._turn(c, y)
            return
        require(change != "presses", "a contact that was gone is pressed again")
        if change == "goes":
            self.regimes[c] = "gone"
        elif change == "ends":
            self.regimes[c], y[spring] = "open", 0.0
        elif change == "begins":
            self._begin(c, y)
        elif change == "slides":
            at = self.meetings(y)[c]
            if was != "grips":
                _, vt, _ = self.speeds(y, at)
                self.signs[c] = math.copysign(1.0, self.law.limited(at.overlap, float(y[spring]), vt))
            between = was == "sticks" and self.law.grips and self._slips(c, y)[0] < 0
            self.regimes[c] = "grips" if between else "slides"
        else:
            y[spring] = self._sliding(c, y)
            between = was == "slides" and self.law.grips and self._grips(c, y)
            self.regimes[c] = "grips" if between else "sticks"

    def _begin(self, c: int, y: np.ndarray) -> None:
        spring, at = 6 * len(self.start) + c, self.meetings(y)[c]
        vn, vt, _ = self.speeds(y, at)
        y[spring], self.pushes[c] = 0.0, 1.0
        if self.law.stiff_from_touch or self.impact.scene.gravity:
            self.regimes[c] = "sticks"
            if self.law.surface.friction > 0 and self.above(c, y) > 0:
                self._change(c, "slides", y)
                if self.slipping(c, y) < 0:
                    self._change(c, "sticks", y)
        else:
            self.regimes[c], self.signs[c], y[spring] = self.law.first(vn, vt, self.impact.lasts)

    def _turn(self, c: int, y: np.ndarray) -> None:
        """Handle a change of sign of the normal force, where the limit passes zero: the contact sticks if it can."""
        if self.meetings(y)[c].overlap <= 0:  # the end of the contact
            return
        if self.regimes[c] != "sticks":
            y[6 * len(self.start) + c] = self._sliding(c, y)
        self.pushes[c], self.regimes[c] = -self.pushes[c], "sticks"
        next_state = y + self.tiny * self.rates(y)
        if self.above(c, next_state) > 0:
            self._change(c, "slides", next_state)

    def ends(self, rtol: float) -> np.ndarray:
        """Integrate to the end, for `PlanarImpact.parted`."""
        from scipy.integrate import solve_ivp

        impact, bodies = self.impact, len(self.start)
        y = np.zeros(6 * bodies + self.contacts)
        for k, body in enumerate(self.start):
            y[6 * k + 3 : 6 * k + 6] = (*body.velocity, body.spin)
        length, speed = impact.speed * impact.lasts, impact.speed
        scales = [[length, length, length / b.size, speed, speed, speed / b.size] for b in self.start]
        atol = 0.1 * rtol * np.array([*np.ravel(scales), *[length] * self.contacts])
        if impact.scene.gravity:  # a resting contact exists from the start
            self.start = list(impact.bodies)
            for c in range(self.contacts):
                self._change(c, "begins", y)
        time, end = 0.0, (impact.follow + (0.0 if impact.scene.gravity else BEFORE)) * impact.lasts
        for _ in range(400):  # more changes of regime than any impact has
            watched = list(self._events())
            solution = solve_ivp(
                lambda _, state: self.rates(state), (time, end), y, method="DOP853", rtol=rtol, atol=atol,
                events=[event for _, _, event in watched], max_step=impact.lasts / 20,
                first_step=1e-6 * impact.lasts,  # not to miss what follows at once
            )  # fmt: skip
            happened = [watched[i] for i, times in enumerate(solution.t_events or ()) if len(times)]
            time, y = float(solution.t[-1]), solution.y[:, -1].copy()
            for c, change, _ in happened:
                self._change(c, change, y)
            if time >= end * (1 - 1e-5):
                break
        require(time >= end * (1 - 1e-5), "the integration did not come to its end")
        separated = impact.scene.gravity > 0 or all(regime == "open" for regime in self.regimes)
        require(separated, "the bodies still touch at the end of the integration")
        return np.array([y[6 * k + 3 : 6 * k + 6] for k in range(bodies)])


def _event(function, direction: int):
    function.terminal, function.direction = True, direction
    return function


def _at_point(motion: Sequence[float] | np.ndarray, lever_arm: np.ndarray) -> np.ndarray:
    """Velocity [m/s] of the point at `lever_arm` from a centre that moves with (vx, vz, spin)."""
    vx, vz, spin = motion
    return np.array([vx + spin * lever_arm[1], vz - spin * lever_arm[0]])


def _closest(c: np.ndarray, a: np.ndarray, b: np.ndarray, half: float, half_other: float) -> tuple[float, float]:
    """s and t with |s| <= half, |t| <= half_other for which |c + s a - t b|^2 + ACROSS (s^2 + t^2) is least [m].

    The free minimum if it is within the limits, else the best of those on the four sides.
    """
    unit, ab, ca, cb = 1 + ACROSS, float(a @ b), float(c @ a), float(c @ b)
    if not half and not half_other:
        return 0.0, 0.0
    det = unit * unit - ab * ab
    s, t = (ab * cb - unit * ca) / det, (unit * cb - ab * ca) / det
    if abs(s) <= half and abs(t) <= half_other:
        return s, t
    sides = [(end, min(max((cb + ab * end) / unit, -half_other), half_other)) for end in (-half, half)]
    sides += [(min(max((ab * end - ca) / unit, -half), half), end) for end in (-half_other, half_other)]
    return min(sides, key=lambda at: _apart(c, a, b, *at))


def _apart(c: np.ndarray, a: np.ndarray, b: np.ndarray, s: float, t: float) -> float:
    return float(np.sum((c + s * a - t * b) ** 2)) + ACROSS * (s * s + t * t)
