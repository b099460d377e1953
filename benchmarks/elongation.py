"""What long grains cost: the same volume of grain from a sphere to a rod ten times as long as thick.

Beds in Pongo's cylinder over a turning bottom, in discharge, at the step that they are filled with: lists are rebuilt
every few tens of steps, and finding neighbours counts as much as it does in a study. Takes a few minutes on a core,
and less on a large GPU.

    python benchmarks/elongation.py --backend warp --device cuda:0 --out elongation.json
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import members
import pandas as pd

from labbook.backend import Backend, load
from labbook.backend.machine import hardware
from labbook.backend.probes import Crossing
from labbook.checks.bench import speed
from labbook.checks.bench.speed import CYLINDER_STEP, FILLING_STEP, pongo
from labbook.scene import Scene, Spheres, Spherocylinders

ASPECT_RATIOS = (1.0, 2.0, 3.3, 5.0, 10.0)
RODS, OF_A_GPU, MEMBERS = 1000, 10_000, 64
"""Grains of a bed on a core, and on a GPU; beds side by side there."""
BEATS = 5  # of a timing on a GPU


def run(
    name: str, device: str, repeats: int, aspect_ratios: Sequence[float] = ASPECT_RATIOS, grains: int | None = None
) -> dict[str, Any]:
    """Measure the backend called `name` on `device`.

    Of each aspect ratio, length over diameter: `cost` of a grain-step [ns], median of some timings with their range
    (processor time on a core, and on a GPU time of the wall clock), and the `grains` that were left at the end.
    """
    backend = load(name)
    grains = grains or (RODS if device == "cpu" else OF_A_GPU)
    cases = []
    for aspect_ratio in aspect_ratios:
        print(f"L/d = {aspect_ratio:g}", flush=True)
        left, costs = _costs(backend, device, aspect_ratio, grains, repeats)
        told = {"aspect_ratio": aspect_ratio, "members": 1 if device == "cpu" else MEMBERS, "grains": left}
        cases.append({**told, **dict(zip(("cost", "low", "high"), costs, strict=True))})
    return {"backend": name, "device": device, "hardware": hardware(), "cases": cases}


def _costs(
    backend: Backend, device: str, aspect_ratio: float, grains: int, repeats: int
) -> tuple[int, tuple[float, float, float]]:
    """Grains left; median, lowest and highest cost [ns]."""
    scene, how = elongated(aspect_ratio, grains), CYLINDER_STEP.model_copy(update={"dt": FILLING_STEP})
    bed = members.flowing(backend, device, f"L/d = {aspect_ratio:g}", scene, how)
    if device == "cpu":
        one = speed.time_member(backend, bed.name, scene, bed.numerics, bed.start, repeats, [Crossing(0.0)])
        return one.grains, (1e3 / one.median, 1e3 / one.high, 1e3 / one.low)
    timings = [members.timed(backend, device, bed, MEMBERS, BEATS) for _ in range(repeats)]
    costs = sorted(1 / timing["rate"] for timing in timings)
    return timings[0]["grains"], (costs[repeats // 2], costs[0], costs[-1])


def elongated(aspect_ratio: float, grains: int) -> Scene:
    """Pongo's cylinder with grains of the same volume that are so many times as long as thick (spheres where that is
    1), and narrower where they are fewer than 10 000, so that the bed keeps its shape."""
    silo = max(0.08, 0.19 * min(1.0, (grains / 10_000) ** (1 / 3)))  # the orifice stays as wide
    spheres = Spheres(diameter=9.9e-3, density=620, count=grains)
    if aspect_ratio == 1:
        return pongo(spheres, silo)
    thick = Spherocylinders(diameter=9.9e-3, length=aspect_ratio * 9.9e-3, density=620, count=grains)
    d = thick.diameter * (spheres.volume / thick.volume) ** (1 / 3)
    return pongo(thick.model_copy(update={"diameter": d, "length": aspect_ratio * d}), silo)


def main() -> None:
    """Measure, print a table, and write the figures."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--backend", default="numba")
    words.add_argument("--device", default="cpu")
    words.add_argument("--repeats", type=int, default=5)
    words.add_argument("--out", type=Path, help="Also write the figures to this JSON file.")
    said = words.parse_args()
    result = run(said.backend, said.device, said.repeats)
    cases = pd.DataFrame(result["cases"])
    print(cases.assign(times=cases.cost / cases.cost[0], square=cases.aspect_ratio**2).to_string(index=False))
    if said.out:
        said.out.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
