"""Up to which time step do beds come to rest? By contact law, restitution, damping, shape, stiffness and depth.

Grains fall into a cylinder and are followed for a few seconds at steps that are fractions of a collision's duration.
A bed `rests` when its kinetic energy per grain has fallen below 1e-6 m g d, or, of rods, which may roll on where
nothing brakes rolling, when all but one grain in a hundred move more slowly than REST. It is `restless` if neither has
happened by the end, and `failed` if a guard stopped it. labbook/study/timestep.py refuses steps beyond these.

    python benchmarks/step_limit.py --backend warp --device cuda:0 --out step-limit.json
"""

import argparse
import itertools
import json
import math
import time
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from labbook.backend import Backend, Failed, load
from labbook.backend.machine import hardware
from labbook.backend.numerics import Numerics
from labbook.filling import place
from labbook.filling.bed import fastest_points
from labbook.scene import (
    CylinderSilo,
    Grains,
    HertzMindlin,
    LinearSpringDashpot,
    Packing,
    Scene,
    Spheres,
    Spherocylinders,
)
from labbook.scene.timescales import collision

D, DENSITY, G = 3e-3, 2500.0, 9.81
FRACTIONS = (0.005, 0.01, 0.015, 0.02, 0.03, 0.04, 0.05, 0.06, 0.07, 0.08, 0.1, 0.12, 0.15, 0.2)
RESTITUTIONS = (0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 0.9)
DAMPING = {"hertz-mindlin": ("clamped", "textbook"), "linear": ("clamped", "printed")}
STIFFNESS = {"hertz-mindlin": (1e7, 1e8), "linear": (200.0, 5000.0)}
"""Shear moduli [Pa], normal stiffness [N/m]: 10^4 to some 10^5 times m g/d."""
LENGTHS = {"sphere": (1.0,), "spherocylinder": (1.5, 4.0)}
GRAINS = {"sphere": (300, 1500), "spherocylinder": (400,)}
REST = 1e-3
"""Speed of a grain's fastest point [sqrt(g d)]: a kinetic energy of 5e-7 m g d."""
LOOK = 20
"""Beats between two looks at the speeds."""
COLUMNS = (
    *("law", "damping", "restitution", "stiffness", "length", "grains", "seed", "fraction", "dt", "outcome", "guard"),
    *("time", "kinetic", "rest", "quiet"),
)
"""Of the results: the bed, and what became of it: times [s] at the end, when it rested by its energy, and by speeds."""


@dataclass(frozen=True)
class Bed:
    """One bed; length [d], fraction of a collision's duration, stiffness as in STIFFNESS."""

    law: str
    damping: str
    restitution: float
    stiffness: float
    length: float
    grains: int
    fraction: float
    seed: int

    def scene(self) -> Scene:
        """The closed container with its grains."""
        shared: dict[str, Any] = {"friction": 0.5, "restitution": self.restitution, "damping": self.damping}
        if self.law == "hertz-mindlin":
            law = HertzMindlin(shear_modulus=self.stiffness, poisson_ratio=0.25, **shared)
        else:
            law = LinearSpringDashpot(normal_stiffness=self.stiffness, **shared)
        if self.length == 1:
            grains = Spheres(diameter=D, density=DENSITY, count=self.grains)
            wide = 8 * D
        else:
            grains = Spherocylinders(diameter=D, length=self.length * D, density=DENSITY, count=self.grains)
            wide = max(8.0, 3 * self.length) * D
        silo = CylinderSilo(diameter=wide, height=10.0, orifice=wide / 2)
        return Scene(grains=grains, contact=law, container=silo, gravity=G).close()


def beds(law: str, shape: str, seeds: int, fractions: tuple[float, ...]) -> Iterator[Bed]:
    """All beds of a law and a shape."""
    values: Iterable[Any] = itertools.product(
        DAMPING[law], RESTITUTIONS, STIFFNESS[law], LENGTHS[shape], GRAINS[shape], fractions, range(1, seeds + 1)
    )
    for value in values:
        yield Bed(law, *value)


def follow(backend: Backend, device: str, asked: list[Bed], longest: float, budget: float) -> list[dict]:
    """What became of each bed within `longest` s of its own time and `budget` s of ours."""
    began = time.perf_counter()
    scenes = [bed.scene() for bed in asked]
    how = [
        Numerics(dt=bed.fraction * collision(scene), precision="mixed", steps_per_beat=1000)
        for bed, scene in zip(asked, scenes, strict=True)
    ]
    starts = {}
    for bed, scene in zip(asked, scenes, strict=True):
        starts.setdefault((bed.length, bed.grains, bed.seed), None)
        if starts[bed.length, bed.grains, bed.seed] is None:
            starts[bed.length, bed.grains, bed.seed] = place(scene, "gas", bed.seed)
    ensemble = backend.open(backend.specialise(scenes[0], how[0]), len(asked), device)
    found, going = [], {}
    for bed, scene, n in zip(asked, scenes, how, strict=True):
        start = starts[bed.length, bed.grains, bed.seed]
        member = ensemble.admit(scene, n, replace(start))
        row = {**asdict(bed), "dt": n.dt, "outcome": "restless", "time": 0.0}
        going[member] = row
        found.append(row)
    beat, calm = 0, dict.fromkeys(going, 0)
    while going and time.perf_counter() - began < budget:
        beat += 1
        for event in ensemble.advance(1):
            if isinstance(event, Failed) and event.member in going:
                going.pop(event.member).update(outcome="failed", guard=event.guard, step=event.step)
        for member, row in list(going.items()):
            status = ensemble.status(member)
            row["time"], row["kinetic"] = status.time, status.kinetic
            calm[member] = calm[member] + 1 if status.kinetic < 1e-6 else 0
            if calm[member]:
                row.setdefault("rest", status.time)
            if (
                beat % LOOK == 0
                and row["length"] > 1
                and quick(ensemble.packing(member), scenes[member.index].grains) < REST
            ):
                row.setdefault("quiet", status.time)
            rests = calm[member] >= 3
            if rests or status.time >= longest:
                row["outcome"] = "rests" if rests or "quiet" in row else "restless"
                going.pop(member)
                ensemble.retire(member)
    for row in going.values():
        row["outcome"] = "unfinished"
    ensemble.close()
    return found


def quick(packing: Packing, grains: Grains) -> float:
    """Speed [sqrt(g d)] that one grain in a hundred exceeds with its fastest point."""
    return float(np.quantile(fastest_points(grains, packing), 0.99)) / math.sqrt(G * D)


def main() -> None:
    """Follow all beds, and write what became of them."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--backend", default="numba")
    words.add_argument("--device", default="cpu")
    words.add_argument("--laws", default="hertz-mindlin,linear")
    words.add_argument("--shapes", default="sphere,spherocylinder")
    words.add_argument("--seeds", type=int, default=1)
    words.add_argument("--fractions", default=",".join(map(str, FRACTIONS)))
    words.add_argument("--longest", type=float, default=5.0, help="Time [s] that a bed is followed.")
    words.add_argument("--budget", type=float, default=math.inf, help="Time [s] for each law and shape.")
    words.add_argument("--most", type=int, default=None, help="Follow only so many beds of each law and shape.")
    words.add_argument("--out", required=True)
    said = words.parse_args()
    backend = load(said.backend)
    head = {"hardware": hardware(), "backend": said.backend, "device": said.device, "columns": COLUMNS}
    lines: list[str] = []
    for law, shape in itertools.product(said.laws.split(","), said.shapes.split(",")):
        asked = list(beds(law, shape, said.seeds, tuple(map(float, said.fractions.split(",")))))[: said.most]
        began = time.perf_counter()
        for row in follow(backend, said.device, asked, said.longest, said.budget):
            lines.append(json.dumps([short(row.get(name)) for name in COLUMNS], separators=(",", ":")))
        print(f"{law}, {shape}: {len(asked)} beds, {time.perf_counter() - began:.0f} s", flush=True)
        Path(said.out).write_text(json.dumps(head)[:-1] + ', "beds": [\n' + ",\n".join(lines) + "\n]}\n")


def short(value: object) -> object:
    """Three digits of a number are enough here; five of a step."""
    return float(f"{value:.5g}") if isinstance(value, float) else value


if __name__ == "__main__":
    main()
