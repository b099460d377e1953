"""Synthetic runs of a quasi-2D hopper, made from Beverloo's law: what reports and recordings are tested on."""

import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toy_results import RunDouble, analyse

from labbook.backend.numerics import Numerics
from labbook.measure import RunData
from labbook.results.study import StudyResults
from labbook.scene import HertzMindlin, Scene, Spheres, WedgeHopper
from labbook.scene.packing import Packing
from labbook.study import Point, Study
from labbook.study.schema import Accuracy, Fill, Reference, ReferenceEntry, Stop, Window

REGULARITY = 0.2  # standard deviation of the times between grains over their mean: more regular than chance
SCATTER = 0.005  # of the flow rate between seeds
C, K = 0.58, 1.55  # Beverloo's, with the grains' own density: what the synthetic flow rates are made from


def scene(orifice: float = 0.03, angle: float = math.pi / 2, count: int = 1200) -> Scene:
    return Scene(
        grains=Spheres(diameter=0.003, density=2500, count=count),
        contact=HertzMindlin(shear_modulus=1e8, poisson_ratio=0.25, friction=0.5, restitution=0.2),
        container=WedgeHopper(width=0.1, height=0.4, thickness=1.01 * 0.003, angle=angle, orifice=orifice),
    )


def hopper(scene: Scene) -> WedgeHopper:
    assert isinstance(scene.container, WedgeHopper)
    return scene.container


def beverloo(scene: Scene, c: float = C, k: float = K) -> float:
    """W [kg/s] of a slot: C rho_p sqrt(g) (D - k d)^{3/2} Z."""
    grains, box = scene.grains, hopper(scene)
    return c * grains.density * math.sqrt(scene.gravity) * (box.orifice - k * grains.diameter) ** 1.5 * box.thickness


def crossings(scene: Scene, seed: int, rate: float | None = None, outcome: str = "emptied") -> dict[str, np.ndarray]:
    """First passages at a steady rate with jitter and scatter between seeds, after 0.05 s without flow."""
    rng = np.random.default_rng([seed, round(hopper(scene).orifice * 1e6)])
    count = scene.grains.count
    rate = (beverloo(scene) if rate is None else rate) / scene.grains.mass * (1 + SCATTER * rng.standard_normal())
    waits = rng.gamma(1 / REGULARITY**2, REGULARITY**2, count) / rate
    time = 0.05 + np.cumsum(waits)
    if outcome == "clogged":
        time = time[: count // 2]
    n = len(time)
    x = rng.uniform(-0.4, 0.4, n) * hopper(scene).orifice
    zero = np.zeros(n)
    columns = {"member": zero.astype(int), "step": (time / 1e-5).astype(int), "time": time, "id": np.arange(n)}
    velocity = {"vx": zero, "vy": zero, "vz": np.full(n, -0.5), "wx": zero, "wy": zero, "wz": zero}
    return {**columns, "x": x, "y": zero, "z": zero, **velocity}


def lattice(scene: Scene) -> Packing:
    """A hexagonal layer that nearly fills the width, from the bottom up."""
    d, box, count = scene.grains.diameter, hopper(scene), scene.grains.count
    columns = int((box.width - d) / d)
    k = np.arange(count)
    row, column = k // columns, k % columns
    x = -box.width / 2 + d / 2 + d * (column + 0.5 * (row % 2))
    z = d / 2 + row * d * math.sqrt(3) / 2
    position = np.stack([x, np.zeros(count), z], axis=1)
    return Packing(x=position, v=np.zeros_like(position), omega=np.zeros_like(position))


def sample(scene: Scene, table: dict[str, np.ndarray], frames: int = 30) -> dict[str, np.ndarray]:
    """Frames in which every grain falls freely, from the lattice, before it leaves."""
    start = lattice(scene).x
    leaves = np.full(len(start), np.inf)
    leaves[table["id"]] = table["time"]
    rows: dict[str, list[np.ndarray]] = {}
    for step, time in enumerate(np.linspace(0, table["time"].max() * 0.95, frames)):
        alive = np.flatnonzero(leaves > time)
        n = len(alive)
        fall = 0.05 * time
        speed = 0.6 * np.exp(-((start[alive, 0] / 0.02) ** 2) - (start[alive, 2] / 0.03))
        part = {
            "member": np.zeros(n, int),
            "step": np.full(n, step),
            "time": np.full(n, time),
            "id": alive,
            "x": start[alive, 0],
            "y": start[alive, 1],
            "z": start[alive, 2] - fall,
            "vx": np.zeros(n),
            "vy": np.zeros(n),
            "vz": -speed,
        }
        for name, column in part.items():
            rows.setdefault(name, []).append(column)
    return {name: np.concatenate(columns) for name, columns in rows.items()}


def observe(here: Scene, seed: int, outcome: str = "emptied", recorded: bool = False) -> RunData:
    """What a discharge of the scene would have shown."""
    table = crossings(here, seed, outcome=outcome)
    tables = {"crossing": table}
    if recorded:
        tables["sample"] = sample(here, table)
    return RunData(
        scene=here,
        numerics=Numerics(dt=1e-5),
        seed=seed,
        start=lattice(here),
        outcome=outcome,
        duration=float(table["time"][-1]) + (2.0 if outcome == "clogged" else 0.0),
        tables=tables,
    )


class FinishedDouble(RunDouble):
    """A finished run whose data are made when asked for."""

    def __init__(
        self, point: Point, seed: int, outcome: str = "emptied", recorded: bool = False, cache_version: int = 1
    ):
        step = round((point.fill.numerics or point.numerics).dt * 1e9)
        super().__init__(
            point,
            seed,
            outcome,
            packing_key=f"{seed:04x}{step:012x}" * 2,
            frame_interval=0.01 if recorded else None,
            cache_version=cache_version,
            ended=f"2026-01-0{seed}T03:04:05+00:00",
        )

    @property
    def provenance(self) -> dict[str, Any]:
        return {
            "backend": "double",
            "versions": {"numpy": np.__version__},
            "wall_time": 1.5 + self.seed,
            "seed": self.seed,
        }

    def recording(self) -> dict[str, np.ndarray] | None:
        if self.entry.frame_interval is None:
            return None
        return sample(self.point.scene, dict(self.data().tables["crossing"]))

    def data(self) -> RunData:
        return replace(observe(self.point.scene, self.seed, self.entry.outcome), recorded=self.recording)


def point(index: int, orifice: float, angle: float | None = None, **kind: Any) -> Point:
    at: dict[str, float | str] = {"container.orifice": orifice}
    label = f"orifice = {orifice * 1e3:g} mm"
    if angle is not None:
        at["container.angle"], label = angle, f"angle = {math.degrees(angle):g} deg, {label}"
        kind["angle"] = angle
    return Point(index, scene(orifice, **kind), Fill(), Numerics(dt=1e-5), at, label)


def study_of(points: list[Point], **changes: Any) -> Study:
    """A study with these points, three replicates, both laws, and Fan's C and k."""
    settings: dict[str, Any] = {
        "path": Path("no-such-study.yaml"),
        "name": "synthetic-hopper",
        "about": "Flow rates made from Beverloo’s law, with scatter between seeds.",
        "points": tuple(points),
        "replicates": 3,
        "accuracy": Accuracy(),
        "fill": Fill(),
        "window": Window(),
        "stop": Stop(),
        "measure": ("flow_rate",),
        "fit": ("beverloo", "janda"),
        "record": None,
        "reference": Reference(
            "Fan et al. 2023",
            (
                ReferenceEntry("beverloo.C_particle", {"container.angle": math.pi / 2}, C),
                ReferenceEntry("beverloo.k", {"container.angle": math.pi / 2}, K),
                ReferenceEntry("flow_rate.flow_rate", {"container.orifice": 0.03}, 0.056, 0.001),
                ReferenceEntry("flow_rate.flow_rate", {"container.orifice": 0.099}, 0.1),
            ),
        ),
    }
    return Study(**{**settings, **changes})


DIAMETERS = (0.018, 0.021, 0.024, 0.03, 0.036, 0.045, 0.0525, 0.06)


@pytest.fixture(scope="session")
def column() -> tuple[Study, list[FinishedDouble]]:
    """One series of eight orifices with three seeds each."""
    points = [point(k, D) for k, D in enumerate(DIAMETERS)]
    study = study_of(points, measure=("flow_rate", "packing"))
    return study, [FinishedDouble(p, seed) for p in points for seed in (1, 2, 3)]


@pytest.fixture(scope="session")
def analysis(column) -> StudyResults:
    """What is found of the column."""
    study, finished = column
    return analyse(study, finished)


@pytest.fixture(scope="session")
def synthetic():
    """The makers of this file, for tests that need other studies."""
    return sys.modules[__name__]
