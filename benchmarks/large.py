"""One large scene from its placing to its saving: seconds of each part, memory, and grain-steps per second.

A box of spheres (linear law, friction). Grains are placed as a rain and as a gas; what is stepped is `labbook bench`'s
stacked bed of as many. Every size has a process of its own, so that peak memory is of it alone. 1e6 grains take some
three minutes on a CPU.

    python benchmarks/large.py --grains 10000,100000,1000000 --out large.json
    python benchmarks/large.py --backend warp --device cuda:0
"""

import argparse
import json
import multiprocessing
import resource
import tempfile
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

import pandas as pd

from labbook.backend import load
from labbook.backend.machine import hardware
from labbook.checks.bench.speed import BOX_STEP, box
from labbook.filling.placing import place
from labbook.lab.tables import read_table, write_table
from labbook.scene.packing import Packing

T = TypeVar("T")
STEPS = 1000
OUTSIDE = ("rain", "gas", "first beat", "to the host", "save", "read")
"""Parts outside the steps, but for those of the first beat."""


class Watch:
    """Seconds of the wall clock by part."""

    def __init__(self) -> None:
        self.spent: dict[str, float] = {}

    def __call__(self, part: str, work: Callable[[], T]) -> T:
        """Do `work`, as `part`."""
        began = time.perf_counter()
        result = work()
        self.spent[part] = time.perf_counter() - began
        return result


def measured(grains: int, name: str, device: str, starts: tuple[str, ...]) -> dict[str, Any]:
    """Seconds by part, peak memory [GB], and rate [1e6 grain-steps/s], of one size."""
    watch, backend = Watch(), load(name)
    scene, bed = box(grains)
    for start in starts:
        watch(start, lambda start=start: place(scene.close(), start, 1))
    spec = backend.specialise(scene, BOX_STEP)
    few, small = box(1000)  # kernels are compiled or loaded before anything is timed
    warm = backend.open(spec, 1, device)
    warm.admit(few, BOX_STEP, small)
    warm.advance(1)
    warm.close()
    ensemble = backend.open(spec, 1, device)
    member = ensemble.admit(scene, BOX_STEP, bed)
    watch("first beat", lambda: ensemble.advance(1))
    beats = STEPS // BOX_STEP.steps_per_beat
    watch("steps", lambda: ensemble.advance(beats))
    packing = watch("to the host", lambda: ensemble.packing(member))
    ensemble.close()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "packing.npz"
        watch("save", lambda: write_table(path, packing.arrays()))
        size = path.stat().st_size
        watch("read", lambda: Packing(**read_table(path)))
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    rate = grains * beats * BOX_STEP.steps_per_beat / watch.spent["steps"] / 1e6
    return {"grains": grains, **watch.spent, "rate": rate, "memory": memory, "file": size / 2**30}


def main() -> None:
    """Measure, print a table, and write the figures."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--grains", default="10000,100000,1000000")
    words.add_argument("--backend", default="numba")
    words.add_argument("--device", default="cpu")
    words.add_argument("--starts", default="rain,gas", help="How grains are placed.")
    words.add_argument("--out", type=Path, help="Also write the figures to this JSON file.")
    said = words.parse_args()
    found: list[dict[str, Any]] = []
    for grains in map(int, said.grains.split(",")):
        with multiprocessing.get_context("spawn").Pool(1) as alone:
            starts = tuple(said.starts.split(","))
            found.append(alone.apply(measured, (grains, said.backend, said.device, starts)))
        print(pd.DataFrame(found).round(3).to_string(index=False), flush=True)
    each = pd.DataFrame(found).set_index("grains")
    parts = [part for part in OUTSIDE if part in each]
    print("\nmicroseconds a grain:")
    print(each[parts].div(each.index, axis=0).mul(1e6).round(2).to_string())
    if said.out:
        told = {"date": f"{datetime.now(UTC):%Y-%m-%d}", "hardware": hardware(), "backend": said.backend}
        told |= {"device": said.device, "steps": STEPS, "sizes": found}
        said.out.write_text(json.dumps(told, indent=2) + "\n")


if __name__ == "__main__":
    main()
