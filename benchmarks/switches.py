"""What each switch of a backend saves, and how long a fresh process takes to its first step, of Fan's hopper.

One settled bed is timed in double with less or more to compute of the same contacts: by processor time, next to the
full scene in the same round. Compiles some ten scenes.

    python benchmarks/switches.py --backend numba --out switches.json
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from labbook.backend import Backend, load
from labbook.backend.machine import hardware
from labbook.backend.probes import Ledger
from labbook.checks.bench.speed import FAN_STEP, GRAVITY, SETTLED, fan, on_one_thread, settle
from labbook.filling.placing import place
from labbook.scene import Kind, LinearSpringDashpot, Primitives, Scene, Uniform
from labbook.scene.packing import Packing

STILL = FAN_STEP.model_copy(update={"dt": 1e-10})
"""While they are timed, grains move by less than 1e-9 m, and overlaps are some 2e-7 m: contacts remain those of the
settled bed, also where nothing holds the grains any more."""
TIMED = 4000  # steps of one timing, about


def run(name: str, repeats: int, grains: int = 3000) -> dict[str, Any]:
    """Measure the backend called `name` on one thread; its start in a cache of its own."""
    whole = load(name)
    backend = on_one_thread(whole) or whole
    closed = fan(grains=grains).close()
    print(f"settling {grains} grains", flush=True)
    bed = settle(backend, closed, FAN_STEP, SETTLED)
    return {
        "backend": name,
        "hardware": hardware(),
        "savings": savings(backend, closed, bed, repeats),
        "starting": starting(name),
    }


def savings(backend: Backend, closed: Scene, bed: Packing, rounds: int) -> list[dict[str, Any]]:
    """How many times as fast the settled `bed` of the scene `closed` is in each variant: median and range over
    rounds."""
    cases = {"as it is": (closed, []), **{what: (scene, []) for what, scene in variants(closed).items()}}
    cases["with a ledger"] = (closed, [Ledger()])
    open_ones = {}
    for what, (scene, probes) in cases.items():
        print(f"preparing the settled bed {what} (compiles)", flush=True)
        ensemble = backend.open(backend.specialise(scene, STILL, probes), 1)
        ensemble.admit(scene, STILL, bed_of(scene, bed))
        ensemble.advance(1)  # kernels are compiled
        open_ones[what] = ensemble
    spent = {what: [] for what in cases}
    for _ in range(rounds):
        for what, ensemble in open_ones.items():
            began = time.process_time()
            ensemble.advance(max(1, TIMED // STILL.steps_per_beat))
            spent[what].append(time.process_time() - began)
            ensemble.drain()
    for ensemble in open_ones.values():
        ensemble.close()
    full = spent.pop("as it is")
    ratios = {what: [a / b for a, b in zip(full, times, strict=True)] for what, times in spent.items()}
    return [{"case": what, "times": statistics.median(r), "low": min(r), "high": max(r)} for what, r in ratios.items()]


def variants(scene: Scene) -> dict[str, Scene]:
    """The scene without one thing after another that a backend need not compute then; and with grains that may differ,
    though those of a packing without sizes are all alike, and those of both kinds of one material."""

    def law(**changes: object) -> Scene:
        return scene.model_copy(update={"contact": scene.contact.model_copy(update=changes)})

    def grains(**changes: object) -> Scene:
        return scene.model_copy(update={"grains": scene.grains.model_copy(update=changes)})

    sides = tuple(wall for wall in scene.container.walls() if wall.name not in ("front", "back"))
    linear = LinearSpringDashpot(
        normal_stiffness=2e5 * scene.grains.mass * GRAVITY / scene.grains.diameter,
        friction=0.5,
        rolling_friction=0.01,
        restitution=0.2,
    )
    return {
        "without rolling resistance": law(rolling_friction=0.0),
        "without friction": law(friction=0.0, rolling_friction=0.0),
        "without front and back": scene.model_copy(update={"container": Primitives(parts=sides)}),
        "with the linear law": scene.model_copy(update={"contact": linear}),
        "with rolling springs": law(rolling_model="epsd"),
        "with several sizes": grains(sizes=Uniform(smallest=scene.grains.diameter / 2)),
        "with two kinds": grains(kinds=tuple(Kind(name=name, share=0.5) for name in ("one", "other"))),
    }


def bed_of(scene: Scene, bed: Packing) -> Packing:
    """The same bed for a variant: where there are kinds, grains are of one after another in turn."""
    kinds = len(scene.grains.kinds)
    return replace(bed, kind=np.arange(len(bed)) % kinds) if kinds else bed


def starting(name: str, repeats: int = 3) -> dict[str, float]:
    """Times [s] of a fresh process with the backend `name` and a cache of its own: its first step, best of `repeats`
    with kernels cached; what opening and that step take of it; and the same when the kernels must be compiled."""
    words = [sys.executable, __file__, "--backend", name, "--first-step"]
    with tempfile.TemporaryDirectory() as folder:
        runs = []
        for _ in range(1 + repeats):
            began = time.perf_counter()
            cache = {**os.environ, "LABBOOK_CACHE": folder}
            done = subprocess.run(words, check=True, capture_output=True, text=True, env=cache)
            runs.append((time.perf_counter() - began, json.loads(done.stdout)))
    best = {"first_step": min(whole for whole, _ in runs[1:]), "cached": min(step for _, step in runs[1:])}
    return {**best, "compiled": runs[0][1]}


def first_step(name: str) -> float:
    """Time [s] that opening the backend and one step of Fan's settling hopper take."""
    closed, step = fan().close(), FAN_STEP.model_copy(update={"steps_per_beat": 1})
    backend = load(name)
    start = place(closed, "gas", 1)
    began = time.perf_counter()
    ensemble = backend.open(backend.specialise(closed, step), 1)
    ensemble.admit(closed, step, start)
    ensemble.advance(1)
    spent = time.perf_counter() - began
    ensemble.close()
    return spent


def main() -> None:
    """Measure, print tables, and write the figures."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--backend", default="numba")
    words.add_argument("--repeats", type=int, default=5)
    words.add_argument("--first-step", action="store_true", help="Only take one step, and print how long it took.")
    words.add_argument("--out", type=Path, help="Also write the figures to this JSON file.")
    said = words.parse_args()
    if said.first_step:
        return print(json.dumps(first_step(said.backend)))
    result = run(said.backend, said.repeats)
    print(pd.DataFrame(result["savings"]).to_string(index=False))
    print(", ".join(f"{what} {seconds:.2f} s" for what, seconds in result["starting"].items()))
    if said.out:
        said.out.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
