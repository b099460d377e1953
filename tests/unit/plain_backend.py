"""A backend as plain as can be: the physics of `labbook_dem` as Python runs it, contact by contact, for tests only.

It has no neighbour lists, blocks, rows or generated code; all that it shares with the CPU backend are the formulas.
"""

from typing import Any

import numpy as np
from labbook_dem import contact, motion
from labbook_dem.laws import LAWS
from labbook_dem.walls import plane, strip
from labbook_dem.words import cross, dot, sqrt, vec3

from labbook.backend.numerics import Numerics
from labbook.scene import Scene
from labbook.scene.packing import Packing


def touching_walls(scene: Scene, w: int, x: vec3):
    """Distance and normal of wall w at x."""
    shape = scene.container.walls()[w].shape
    if shape.kind == "plane":
        a = plane.parameters(shape)
        return plane.plane_distance(vec3(*a[:3]), vec3(*a[3:]), x)
    assert shape.kind == "strip"
    a = strip.parameters(shape)
    return strip.strip_distance(vec3(a[0], 0.0, a[1]), vec3(a[2], 0.0, a[3]), a[4], x)


# written for one component, and as good for arrays of them
kick: Any = motion.kick
drift: Any = motion.drift
predict: Any = motion.predict


class Plain:
    """One scene with resting walls that keeps all its grains."""

    def __init__(self, scene: Scene, numerics: Numerics, start: Packing):
        self.scene, self.dt = scene, numerics.dt
        self.law, walls = LAWS[scene.contact.law], scene.container.walls()
        self.c = self.law.coefficients(scene.contact, scene.surface_of_grains)
        self.wall_c = [self.law.coefficients(scene.contact, scene.surface(wall)) for wall in walls]
        self.x: np.ndarray = start.x.copy()
        self.v: np.ndarray = start.v.copy()
        self.u: np.ndarray = start.v.copy()
        self.w: np.ndarray = start.omega.copy()
        names = [wall.name for wall in walls]
        self.springs = {(int(i), int(j)): vec3(*s) for (i, j), s in zip(start.pairs, start.pair_spring, strict=True)}
        self.springs |= {
            (int(i), -1 - names.index(str(name))): vec3(*s)
            for i, name, s in zip(start.wall_grain, start.wall_name, start.wall_spring, strict=True)
        }
        self.steps = 0

    def force(self, c, rs, ms, delta, n, i, j, lever_j):
        """Force on i, torques on i and j; keeps the spring. j: a grain, or -1 - wall."""
        u, v, w = (vec3(*a[i]) for a in (self.u, self.v, self.w))
        wj = vec3(0.0, 0.0, 0.0)
        if j >= 0:
            u, v, wj = u - vec3(*self.u[j]), v - vec3(*self.v[j]), vec3(*self.w[j])
        radius = self.scene.grains.radius
        lever = radius - delta if j < 0 else lever_j
        vt = contact.slip(n, v, w * lever + wj * lever_j)
        old = self.springs.get((i, j))
        s = contact.trial(old or vec3(0.0, 0.0, 0.0), n, vt, self.dt if old else 0.5 * self.dt)
        fn, ft, kept = self.law.respond(c, rs, ms, delta, dot(u, n), s, vt)
        rate = contact.rolling_rate(self.scene.grains.inertia, self.dt)
        full = self.scene.contact.rolling == "full"
        roll = contact.rolling(w - wj, n, c[5] * radius * fn, rate, full)
        arm = cross(n, ft)
        return n * fn + ft, roll - arm * lever, -roll - arm * lever_j, kept

    def step(self) -> None:
        """One step."""
        grains, n = self.scene.grains, len(self.x)
        f, t, springs = np.zeros((n, 3)), np.zeros((n, 3)), {}
        f[:, 2] = -grains.mass * self.scene.gravity
        apart = np.linalg.norm(self.x[:, None] - self.x[None], axis=2)
        for i, j in np.argwhere(np.triu(apart < grains.diameter, 1)).tolist():
            away = vec3(*(self.x[i] - self.x[j]))
            r = sqrt(dot(away, away))
            force, on_i, on_j, springs[i, j] = self.force(
                self.c, grains.radius / 2, grains.mass / 2, grains.diameter - r, away * (1 / r), i, j, r / 2
            )
            for array, k, vector in ((f, i, force), (f, j, -force), (t, i, on_i), (t, j, on_j)):
                array[k] += (vector.x, vector.y, vector.z)
        for w, c in enumerate(self.wall_c):
            for i in range(n):
                distance, normal = touching_walls(self.scene, w, vec3(*self.x[i]))
                if distance < grains.radius:
                    force, on_i, _, springs[i, -1 - w] = self.force(
                        c, grains.radius, grains.mass, grains.radius - distance, normal, i, -1 - w, 0.0
                    )
                    f[i] += (force.x, force.y, force.z)
                    t[i] += (on_i.x, on_i.y, on_i.z)
        self.springs = springs
        kick_dt = self.dt if self.steps else 0.5 * self.dt
        a = f / grains.mass
        self.v = kick(self.v, a, kick_dt)
        self.w = kick(self.w, t / grains.inertia, kick_dt)
        self.x = drift(self.x, self.v, self.dt)
        self.u = predict(self.v, a, self.dt)
        self.steps += 1
