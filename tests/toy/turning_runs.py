"""Runs over a turning bottom with known answers, made up, and what a paper might state of them."""

import math
from dataclasses import replace

import numpy as np
from toy_results import RunDouble

from labbook.backend.numerics import Numerics
from labbook.measure import RunData
from labbook.scene import CylinderSilo, LinearSpringDashpot, Scene, Spherocylinders
from labbook.scene.packing import Packing
from labbook.study import Point
from labbook.study.schema import Fill, Statement

F = (0.0, 0.16, 0.32, 1.28)
RODS = dict(zip(F, (600.0, 330.0, 300.0, 390.0), strict=True))  # a drop by half at 0.32 Hz, then up by 30 %
SPHERES = dict(zip(F, (800.0, 808.0, 812.0, 824.0), strict=True))  # within 3 %
SINKING = 0.03  # m/s
COMMON, OWN = 0.10, 0.01
"""Scatter of a seed at all frequencies, and of each of its runs."""


class Run(RunDouble):
    """A finished run of 2000 grains that leave at a steady rate."""

    def __init__(self, point: Point, seed: int, outcome: str = "finished", filmed: bool = False, every: float = 0.04):
        packing = f"{seed:04x}" * 8  # a packing serves all frequencies
        super().__init__(point, seed, outcome, packing, every if filmed else None)

    def recording(self):
        """A column of upright grains that sinks at 30 mm/s."""
        every = self.entry.frame_interval
        if every is None:
            return None
        side = np.arange(-0.085, 0.09, 0.017)
        x = np.array([(a, b, c) for a in side for b in side for c in np.arange(0.0075, 0.3, 0.015)])
        x = x[np.hypot(x[:, 0], x[:, 1]) < 0.085]
        times, n, zero = np.arange(0, 6, every), len(x), np.zeros(len(x))
        once = {"id": np.arange(n), "x": x[:, 0], "y": x[:, 1], "vx": zero, "vy": zero, "vz": zero - SINKING}
        once |= {"qw": zero + 1, "qx": zero, "qy": zero, "qz": zero}
        table = {name: np.tile(column, len(times)) for name, column in once.items()}
        z = np.concatenate([x[:, 2] - SINKING * t for t in times])
        table |= {"z": z, "time": np.repeat(times, n), "step": np.repeat(np.arange(len(times)), n)}
        return {name: column[z > 0] for name, column in table.items()}

    def data(self):
        grains, f = self.point.scene.grains, float(self.point.at["container.rotation"])
        rate = (SPHERES if grains.length == grains.diameter else RODS)[f]  # pyright: ignore[reportAttributeAccessIssue]
        rate *= (self.point.scene.container.orifice / 0.06) ** 3  # pyright: ignore[reportAttributeAccessIssue]
        rate *= 1 + COMMON * np.random.default_rng(self.seed).standard_normal()
        rate *= 1 + OWN * np.random.default_rng([self.seed, self.point.index]).standard_normal()
        waits = np.random.default_rng([self.point.index, self.seed, 1]).gamma(25, 1 / 25, 1300) / rate
        times = np.cumsum(waits)
        zero = np.zeros((grains.count, 3))
        left = {"time": times, "id": np.arange(len(times)), "step": np.arange(len(times))}
        start = Packing(x=zero, v=zero, omega=zero)
        tables = {"crossing": left}
        how = (self.point.scene, Numerics(dt=1e-6), self.seed, start, self.entry.outcome, times[-1])
        return RunData(*how, tables, self.recording)


def point(index: int, f: float, size: tuple[float, float] = (6e-3, 20e-3), D: float = 0.06) -> Point:
    grains = Spherocylinders(diameter=size[0], length=size[1], density=620, count=2000)
    law = LinearSpringDashpot(normal_stiffness=1e5, friction=0.5, restitution=0.9)
    silo = CylinderSilo(diameter=0.19, height=0.5, orifice=D, rotation=f)
    at: dict[str, float | str] = {"grains.diameter": size[0], "grains.length": size[1], "container.rotation": f}
    at["container.orifice"] = D
    scene = Scene(grains=grains, contact=law, container=silo, gravity=9.8)
    return Point(index, scene, Fill(), Numerics(dt=1e-6), at, f"rotation {f:g} Hz")


ROD, SPHERE = (6e-3, 20e-3), (9.9e-3, 9.9e-3)
LENGTH, ROUND = {"grains.length": 20e-3}, {"grains.length": 9.9e-3}


def state(quantity, low=-math.inf, high=math.inf, says="so it is", **at):
    unit = "Hz" if quantity.endswith(".minimum") else ""
    return Statement(quantity, at, low, high, says, unit)


STATED = (
    replace(state("rotation.grain_rate.drop", 0, 0.7), at=LENGTH),
    replace(state("rotation.grain_rate.minimum", 0.16, 0.32), at=LENGTH),
    replace(state("rotation.grain_rate.rise", 1), at=LENGTH),
    replace(state("rotation.grain_rate", 0.95, 1.05), at=ROUND),
    replace(state("rotation.grain_rate.drop", 0.6, 0.7), at=LENGTH),
    replace(state("rotation.orifice_O_zz", high=1), at=LENGTH),
)
