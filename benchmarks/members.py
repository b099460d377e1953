"""Speed of many members at once on a GPU, in real discharge: rebuilds, outflow and the visits of the host included.

Scenes: Fan's hopper (3000 spheres, Hertz-Mindlin), a silo in three dimensions (10 000 spheres, linear law), and Pongo's
cylinder over a turning bottom with 10 000 spheres and with 10 000 rods. What is varied from the case that all share:
members, precision, skin, and threads a grain. Takes some three minutes on a large GPU.

    python benchmarks/members.py --backend warp --device cuda:0 --out members.json
"""

import argparse
import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from labbook.backend import Backend, load
from labbook.backend.machine import hardware
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Crossing
from labbook.checks.bench.speed import CYLINDER_STEP, FAN_STEP, FILLING_STEP, GRAVITY, advance_until, cylinder, fan
from labbook.filling.opening import start_of_discharge
from labbook.filling.placing import place
from labbook.scene import LinearSpringDashpot, Plane, Primitives, Scene, Spheres, Strip, Wall
from labbook.scene.packing import Packing

SETTLED = 1e-4  # kinetic energy per grain [m g d] of the beds that are opened
OUTFLOW = 0.1  # s of discharge before it is timed
SILO_STEP = Numerics(dt=2e-6, skin=0.1)
MEMBERS = (1, 2, 4, 8, 16, 64, 256)
SKINS = (0.07, 0.1, 0.15, 0.25)
LANES = (1, 2, 4, 8)


@dataclass(frozen=True)
class Bed:
    """A silo that flows."""

    name: str
    scene: Scene
    numerics: Numerics
    start: Packing


def run(name: str, device: str, members: Sequence[int] = MEMBERS, beats: int = 3) -> dict[str, Any]:
    """Measure the backend called `name` on `device`."""
    backend = load(name)
    maker: Any = type(backend)  # the threads a grain of a backend that has them are an argument of its own
    timings = []
    for bed in beds(backend, device):
        many = max(count for count in members if count <= 64)
        cases: list[tuple[Backend, int, dict[str, Any]]] = [(backend, count, {}) for count in members]
        others = sorted(backend.capabilities.precisions - {"mixed"})
        cases += [(backend, many, {"precision": precision}) for precision in others]
        cases += [(backend, many, {"skin": skin}) for skin in SKINS]
        cases += [(maker(lanes=lanes), 1, {}) for lanes in LANES]
        for which, count, changes in cases:
            print(f"{bed.name}: {count} members", *changes.items(), flush=True)
            timings.append(timed(which, device, bed, count, beats, **changes))
    return {"backend": name, "device": device, "hardware": hardware(), "timings": timings}


def beds(backend: Backend, device: str) -> Iterator[Bed]:
    """The four beds, in discharge."""
    yield flowing(backend, device, "fan", fan(), FAN_STEP)
    yield flowing(backend, device, "silo", *silo())
    yield flowing(backend, device, "cylinder", cylinder(rods=False), CYLINDER_STEP, filling=FILLING_STEP)
    yield flowing(backend, device, "rods", cylinder(rods=True), CYLINDER_STEP, filling=FILLING_STEP)


def flowing(
    backend: Backend,
    device: str,
    name: str,
    scene: Scene,
    numerics: Numerics,
    closed: Scene | None = None,
    start: Packing | None = None,
    filling: float | None = None,
) -> Bed:
    """The bed to which `start` settles (a gas of the first seed), OUTFLOW after it is opened.

    filling: another step [s] to use until then.
    """
    closed = closed or scene.close()
    how = numerics.model_copy(update={"precision": "mixed"})
    coarse = how.model_copy(update={"dt": filling or how.dt})
    bed = advance_until(backend, device, closed, coarse, start or place(closed, "gas", 1), SETTLED)
    flow = advance_until(backend, device, scene, coarse, start_of_discharge(bed, closed, scene), outflow=OUTFLOW)
    return Bed(name, scene, how, flow)


def silo(grains: int = 10_000) -> tuple[Scene, Numerics, Scene, Packing]:
    """A box, 17 grains wide and deep, with a slot of 5.5 grains across its bottom; its numerics; the box closed; and a
    start of its filling.

    Frictional spheres of 9.9 mm with the linear law, stiffness 2e5 m g/d: as dense a flow in three dimensions as that
    of the cylindrical silo of Pongo et al. 2022.
    """
    d, half, edge = 9.9e-3, 0.085, 0.027
    spheres = Spheres(diameter=d, density=620, count=grains)
    law = LinearSpringDashpot(normal_stiffness=2e5 * spheres.mass * GRAVITY / d, friction=0.5, restitution=0.9)
    sides = {
        "left": Plane(point=(-half, 0, 0), normal=(1, 0, 0)),
        "right": Plane(point=(half, 0, 0), normal=(-1, 0, 0)),
        "front": Plane(point=(0, -half, 0), normal=(0, 1, 0)),
        "back": Plane(point=(0, half, 0), normal=(0, -1, 0)),
        "bottom-left": Strip(start=(-half, 0), end=(-edge, 0)),
        "bottom-right": Strip(start=(edge, 0), end=(half, 0)),
    }
    walls = tuple(Wall(name=name, shape=shape) for name, shape in sides.items())
    lid = Wall(name="lid", shape=Strip(start=(-edge, 0), end=(edge, 0)))
    scene = Scene(grains=spheres, contact=law, container=Primitives(parts=walls, outlet_plane=0.0))
    closed = scene.model_copy(update={"container": Primitives(parts=(*walls, lid))})
    across = int((2 * half - 1.1 * d) // (1.15 * d))
    i = np.arange(grains)
    site = np.column_stack([i % across - (across - 1) / 2, i // across % across - (across - 1) / 2, i // across**2])
    v = np.random.default_rng(1).normal(0, 0.2, (grains, 3))
    return scene, SILO_STEP, closed, Packing(x=site * 1.15 * d + [0, 0, d], v=v, omega=np.zeros_like(v))


def timed(backend: Backend, device: str, bed: Bed, members: int, beats: int, **numerics: object) -> dict[str, Any]:
    """Speed of `members` copies of a bed over `beats` beats: `rate` in 1e9 grain-steps per second of the wall clock,
    `step` in microseconds, `fraction` of the measured copy bandwidth that the bytes which must move come to.

    numerics: what to change in the bed's.
    """
    how = bed.numerics.model_copy(update=numerics)
    ensemble = backend.open(backend.specialise(bed.scene, how, [Crossing(0.0)]), members, device)
    handles = [ensemble.admit(bed.scene, how, bed.start) for _ in range(members)]
    ensemble.advance(1)
    before = [ensemble.status(handle) for handle in handles]
    began = time.perf_counter()
    ensemble.advance(beats)
    ensemble.drain()
    spent = time.perf_counter() - began
    after = [ensemble.status(handle) for handle in handles]
    rate = sum((b.step - a.step) * (a.grains + b.grains) / 2 for a, b in zip(before, after, strict=True)) / spent
    load = ensemble.load()
    ensemble.close()
    return {
        "scene": bed.name,
        "members": members,
        "grains": after[0].grains,
        "precision": how.precision,
        "skin": how.skin,
        "rate": rate / 1e9,
        "step": spent / (beats * how.steps_per_beat) * 1e6,
        "load": vars(load) if load else None,
        "fraction": load.bytes * rate / load.bandwidth if load and load.bandwidth else None,
    }


def main() -> None:
    """Measure, print a table, and write the figures."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--backend", default="warp")
    words.add_argument("--device", default="cuda:0")
    words.add_argument("--out", type=Path, help="Also write the figures to this JSON file.")
    said = words.parse_args()
    result = run(said.backend, said.device)
    print(pd.json_normalize(result["timings"]).to_string(index=False))
    if said.out:
        said.out.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
