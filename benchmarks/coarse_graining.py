"""Speed of coarse-graining: 10 000 rods in 100 frames, and 20 000 contacts, on the three kinds of grids.

python benchmarks/coarse_graining.py --out fields.json
"""

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from labbook.backend.machine import hardware
from labbook.fields import ContactRows, GrainRows, Grid, Layer, Ring, Space, coarse_grain
from labbook.fields.threaded import threads

RADIUS, HEIGHT = 0.095, 0.2
"""Of Pongo's silo, filled evenly [m]."""
OMEGA = 4.95e-3
GRIDS: dict[str, Grid] = {
    "layer, 100 x 200": Layer((-RADIUS, RADIUS), (0.0, HEIGHT), 100, 200, depth=OMEGA),
    "ring, 100 x 200": Ring(RADIUS, (0.0, HEIGHT), 100, 200),
    "box, 40 x 40 x 40": Space((-RADIUS, RADIUS), (-RADIUS, RADIUS), (0.0, HEIGHT), 40, 40, 40),
}


def run(grains: int = 10_000, frames: int = 100, contacts: int = 20_000) -> dict[str, Any]:
    """Density, momentum, flux and orientation of `grains` rods in `frames` frames, and the stress of `contacts`.

    Of each grid: seconds of the wall clock, and of all processors (`process`), that grains with axes, and contacts,
    took.
    """
    rng = np.random.default_rng(1)
    few = _grains(rng, 100, 1)
    many, lines = _grains(rng, grains * frames, frames), _contacts(rng, contacts)
    timings = []
    for name, grid in GRIDS.items():
        coarse_grain(grid, OMEGA, few, _contacts(rng, 10))  # compiles
        wall, process = _timed(lambda grid=grid: coarse_grain(grid, OMEGA, many))
        told = {"grid": name, "grains": grains, "frames": frames, "wall": wall, "process": process}
        wall, process = _timed(lambda grid=grid: coarse_grain(grid, OMEGA, few, lines))
        timings.append({**told, "contacts": contacts, "contacts_wall": wall, "contacts_process": process})
    return {"hardware": hardware(), "threads": threads(), "timings": timings}


def _timed(work: Callable[[], object]) -> tuple[float, float]:
    wall, process = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - wall, time.process_time() - process


def _grains(rng: np.random.Generator, n: int, frames: int) -> GrainRows:
    r, turn = RADIUS * np.sqrt(rng.random(n)), 2 * np.pi * rng.random(n)
    x = np.column_stack([r * np.cos(turn), r * np.sin(turn), HEIGHT * rng.random(n)])
    axis = rng.standard_normal((n, 3))
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    return GrainRows(x, rng.standard_normal((n, 3)), 3e-4, 5e-7, frames, axis)


def _contacts(rng: np.random.Generator, n: int) -> ContactRows:
    branch = rng.standard_normal((n, 3))
    branch *= 2 * OMEGA / np.linalg.norm(branch, axis=1)[:, None]
    return ContactRows(_grains(rng, n, 1).x, branch, rng.standard_normal((n, 3)), 1)


def main() -> None:
    """Measure, print a table, and write the figures."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--out", type=Path, help="Also write the figures to this JSON file.")
    out = words.parse_args().out
    result = run()
    print(pd.DataFrame(result["timings"]).to_string(index=False))
    if out:
        out.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
