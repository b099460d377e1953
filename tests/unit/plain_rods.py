"""Rods stepped as plainly as can be: the physics of `labbook_dem` in Python, contact by contact, for tests only.

All pairs are looked at in every step; nothing is listed, packed or generated.
"""

from typing import Any

import numpy as np
from labbook_dem import motion, rods, rotation, segments
from labbook_dem.chosen import choose
from labbook_dem.contact import rolling_rate
from labbook_dem.walls import frustum, plane, strip
from labbook_dem.words import vec3

from labbook.backend.numerics import Numerics
from labbook.scene import Scene
from labbook.scene.orientation import axes
from labbook.scene.packing import Packing

NONE = vec3(0.0, 0.0, 0.0)
predict: Any = motion.predict  # written for one component, and as good for arrays of them


def array(v: vec3) -> np.ndarray:
    return np.array([v.x, v.y, v.z])


def part_of_wall(shape, x: vec3, a: vec3, half: float, radius: float, part: int):
    """Distance, normal and place on the segment of a part."""
    if shape.kind == "plane":
        p = plane.parameters(shape)
        return (
            plane.plane_rod(vec3(*p[:3]), vec3(*p[3:]), x, a, half, part) if part < 2 else (1e9, NONE, 0.0)
        )  # fmt: skip
    p = {"strip": strip, "frustum": frustum}[shape.kind].parameters(shape)
    place = vec3(p[0], 0.0, p[1]), vec3(p[2], 0.0, p[3]), p[4], x, a, half
    if shape.kind == "strip":
        return strip.strip_rod(*place, radius, part)
    return frustum.frustum_rod(*place, part, *frustum.frustum_rims(*place, radius))


class PlainRods:
    """One scene of rods that keeps all its grains."""

    def __init__(self, scene: Scene, numerics: Numerics, start: Packing):
        assert start.q is not None
        self.scene, self.dt, self.steps = scene, numerics.dt, 0
        with choose(scene.contact.law) as law:
            self.c = law.coefficients(scene.contact, scene.surface_of_grains)
            self.wall_c = [
                law.coefficients(scene.contact, scene.surface(wall), wall=True) for wall in scene.container.walls()
            ]
        self.x, self.v, self.u, self.q = (a.copy() for a in (start.x, start.v, start.v, start.q))
        self.m = rotation.momenta(scene.grains, start.omega, start.q)
        self.y = self.m.copy()
        self.slender = rotation.slenderness(scene.grains)
        self.springs: dict[tuple, vec3] = {}
        self.rate = rolling_rate(scene.grains.inertia_axis, self.dt)

    def spring(self, key) -> tuple[vec3, float]:
        """A spring and by how much to advance it."""
        return (self.springs[key], self.dt) if key in self.springs else (NONE, 0.5 * self.dt)

    def step(self) -> None:
        """One step."""
        with choose(self.scene.contact.law):
            self._step()

    def _step(self) -> None:
        grains, n = self.scene.grains, len(self.x)
        r, half = grains.radius, grains.half_length
        a = axes(self.q)
        spin, soon = (rotation.spins(grains, m, self.q) for m in (self.m, self.y))
        f, t, kept = np.zeros((n, 3)), np.zeros((n, 3)), {}
        for i in range(n):
            for j in range(i + 1, n):
                s, at, away = segments.closest(vec3(*(self.x[i] - self.x[j])), vec3(*a[i]), vec3(*a[j]), half)
                overlap2 = 4 * r * r - float(array(away) @ array(away))
                if overlap2 > 0:
                    last, advance = self.spring((i, j))
                    force, on_i, on_j, kept[i, j], _ = rods.rod_on_rod(
                        self.c, r, grains.mass, away, overlap2, vec3(*(s * a[i])), vec3(*(at * a[j])),
                        vec3(*(self.u[i] - self.u[j])), vec3(*(self.v[i] - self.v[j])), vec3(*soon[i]), vec3(*soon[j]),
                        vec3(*spin[i]), vec3(*spin[j]), last, advance, self.rate,
                    )  # fmt: skip
                    f[i] += array(force)
                    f[j] -= array(force)
                    t[i] += array(on_i)
                    t[j] += array(on_j)
            for w, wall in enumerate(self.scene.container.walls()):
                self.at_wall(i, w, wall, a[i], spin[i], soon[i], f, t, kept)
        self.springs = kept
        kick_dt = self.dt if self.steps else 0.5 * self.dt
        acc, turn = f / grains.mass - [0, 0, self.scene.gravity], t / grains.inertia
        self.v, self.m = self.v + acc * kick_dt, self.m + turn * kick_dt
        self.x = self.x + self.v * self.dt
        for i in range(n):
            w, x, y, z = self.q[i]
            self.q[i] = rotation.turn(w, x, y, z, vec3(*self.m[i]), self.slender, self.dt)
        self.u, self.y = predict(self.v, acc, self.dt), predict(self.m, turn, self.dt)
        self.steps += 1

    def at_wall(self, i, w, wall, a, spin, soon, f, t, kept) -> None:
        """Add what rod i feels at wall w."""
        grains = self.scene.grains
        found = {}
        for part in range(4):
            distance, normal, s = part_of_wall(
                wall.shape, vec3(*self.x[i]), vec3(*a), grains.half_length, grains.radius, part
            )
            if distance < grains.radius:
                found[part] = distance, normal, s
        was = sum(1 << part for part in range(4) if (i, "wall", w, part) in self.springs)
        now = sum(1 << part for part in found)
        for part, (distance, normal, s) in found.items():
            last, advance = self.spring((i, "wall", w, rods.heir(part, was, now)))
            lever = s * a
            at = self.x[i] + lever - distance * array(normal)
            surface = np.array(wall.motion.velocity) + np.cross([0, 0, wall.motion.spin], at)
            force, torque, kept[i, "wall", w, part] = rods.rod_on_wall(
                self.wall_c[w], grains.radius, grains.mass, grains.radius - distance, normal, vec3(*lever),
                vec3(*(self.u[i] - surface)), vec3(*(self.v[i] - surface)), vec3(*soon), vec3(*spin),
                vec3(0.0, 0.0, wall.motion.spin), last, advance, self.rate,
            )  # fmt: skip
            f[i] += array(force)
            t[i] += array(torque)
