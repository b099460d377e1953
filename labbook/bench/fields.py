"""Speed of coarse-graining: many grains in many frames, on the three kinds of grids."""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np

from labbook.bench.hardware import hardware
from labbook.fields import Contacts, Grains, Grid, Layer, Ring, Space, coarse_grain
from labbook.fields.threaded import threads

RADIUS, HEIGHT = 0.095, 0.2
"""Of Pongo's silo, filled evenly [m]."""
OMEGA = 4.95e-3
GRIDS: dict[str, Grid] = {
    "layer, 100 x 200": Layer((-RADIUS, RADIUS), (0.0, HEIGHT), 100, 200, depth=OMEGA),
    "ring, 100 x 200": Ring(RADIUS, (0.0, HEIGHT), 100, 200),
    "box, 40 x 40 x 40": Space((-RADIUS, RADIUS), (-RADIUS, RADIUS), (0.0, HEIGHT), 40, 40, 40),
}


@dataclass(frozen=True)
class FieldsTiming:
    """One grid: seconds of the wall clock, and of all processors, that grains with axes, and contacts, took."""

    grid: str
    grains: int
    frames: int
    wall: float
    process: float
    contacts: int
    contacts_wall: float
    contacts_process: float


@dataclass(frozen=True)
class FieldsBench:
    """What fields cost on this machine."""

    hardware: dict[str, object]
    threads: int
    timings: tuple[FieldsTiming, ...]

    def as_dict(self) -> dict[str, object]:
        """For JSON."""
        return {"hardware": self.hardware, "threads": self.threads, "timings": [asdict(one) for one in self.timings]}


def run(
    grains: int = 10_000, frames: int = 100, contacts: int = 20_000, say: Callable[[str], None] = lambda text: None
) -> FieldsBench:
    """Density, momentum, flux and orientation of `grains` rods in `frames` frames, and the stress of `contacts`."""
    rng = np.random.default_rng(1)
    few = _grains(rng, 100, 1)
    many, lines = _grains(rng, grains * frames, frames), _contacts(rng, contacts)
    timings = []
    for name, grid in GRIDS.items():
        say(name)
        coarse_grain(grid, OMEGA, few, _contacts(rng, 10))  # compiles
        wall, process = _timed(lambda grid=grid: coarse_grain(grid, OMEGA, many))
        slow = _timed(lambda grid=grid: coarse_grain(grid, OMEGA, few, lines))
        timings.append(FieldsTiming(name, grains, frames, wall, process, contacts, *slow))
    return FieldsBench(hardware(), threads(), tuple(timings))


def _timed(work: Callable[[], object]) -> tuple[float, float]:
    wall, process = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - wall, time.process_time() - process


def _grains(rng: np.random.Generator, n: int, frames: int) -> Grains:
    r, turn = RADIUS * np.sqrt(rng.random(n)), 2 * np.pi * rng.random(n)
    x = np.column_stack([r * np.cos(turn), r * np.sin(turn), HEIGHT * rng.random(n)])
    axis = rng.standard_normal((n, 3))
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    return Grains(x, rng.standard_normal((n, 3)), 3e-4, 5e-7, frames, axis)


def _contacts(rng: np.random.Generator, n: int) -> Contacts:
    branch = rng.standard_normal((n, 3))
    branch *= 2 * OMEGA / np.linalg.norm(branch, axis=1)[:, None]
    return Contacts(_grains(rng, n, 1).x, branch, rng.standard_normal((n, 3)), 1)
