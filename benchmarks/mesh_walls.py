"""Cost of walls of triangles: spheres on a plane, on flat meshes of 2 to 10^5 triangles, in a cone and in a cone mesh.

Each grain lies on the wall and touches no other, so a step consists of contacts with the wall and of the motion. Grains
slide and roll over the triangles. All variants take turns; a ratio is the median of those of single rounds. Times are
those of the processor for one thread, or of the wall clock on a GPU. LIGGGHTS and its mesh walls are timed beside the
CPU backend, where Debian's package liggghts is installed.

    python benchmarks/mesh_walls.py --backend numba --out mesh_walls        # a folder with JSON and CSV
    python benchmarks/mesh_walls.py --backend warp --device cuda:0 --precision mixed --members 4 64 --out mesh_walls
"""

import argparse
import json
import math
import shutil
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pandas as pd

from labbook.backend import Backend, Ensemble, Expected, load
from labbook.backend.machine import hardware
from labbook.backend.numerics import Numerics
from labbook.checks.bench.speed import FAN_STEP, on_one_thread
from labbook.checks.verify.mesh import of_triangles, sheet
from labbook.scene import Frustum, HertzMindlin, Plane, Primitives, Scene, Spheres, Wall
from labbook.scene.packing import Packing

sys.path.insert(0, str(Path(__file__).parent / "peers"))

from speed import Bed, theirs

D = 4e-3
R = D / 2
OVERLAP = 1e-5 * D
GRAVITY = 9.81
STEPS = FAN_STEP.model_copy(update={"steps_per_beat": 200})
CELLS = (1, 7, 22, 71, 224)
"""Cells along a side of a flat mesh, of two triangles each."""
SIDES, ROWS = 64, 16
"""Of the cone mesh, around and along."""
STEEP = math.pi / 4
ROUND, LONGEST = 0.4, 20
"""Time [s] of a timing, about, and beats that it takes at most: grains stay on their wall."""


@dataclass(frozen=True)
class Variant:
    """Grains that lie on a wall.

    Attributes:
        name: For tables.
        triangles: Number of triangles; 0 for an exact wall.
        exact: Name of the variant with the exact wall.
        scene: Scene with this wall alone.
        start: Grains that touch it.
    """

    name: str
    triangles: int
    exact: str
    scene: Scene
    start: Packing


def on(wall: Wall, count: int) -> Scene:
    """Grains over a wall."""
    law = HertzMindlin(shear_modulus=1e7, poisson_ratio=0.25, friction=0.5, rolling_friction=0.01, restitution=0.5)
    grains = Spheres(diameter=D, density=2500, count=count)
    return Scene(grains=grains, contact=law, container=Primitives(parts=(wall,)), gravity=GRAVITY)


def flat(grains: int, cells: Sequence[int] = CELLS) -> list[Variant]:
    """A plane, and the same as meshes."""
    side = math.isqrt(grains)
    half = 0.6 * side * D
    place = 1.1 * D * (np.stack(np.divmod(np.arange(side**2), side), axis=1) - (side - 1) / 2)
    x = np.column_stack([place, np.full(side**2, R - OVERLAP)])
    start = Packing(x=x, v=np.tile([0.05, 0.03, 0.0], (side**2, 1)), omega=np.zeros_like(x))
    plane = Wall(name="floor", shape=Plane(point=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0)))
    walls = {0: plane} | {2 * k * k: of_triangles(*sheet(k, half)) for k in cells}
    return [
        Variant(f"{n} triangles" if n else "plane", n, "plane", on(wall, side**2), start) for n, wall in walls.items()
    ]


def conical(grains: int) -> list[Variant]:
    """A cone, and the same with flat sides."""
    pitch, low = 1.2 * D, 10 * D
    place, height = list[tuple[float, float]](), low
    while len(place) < grains:
        around = int(2 * math.pi * height * math.tan(STEEP) / pitch)
        place += [(height, 2 * math.pi * (k + 0.37) / around) for k in range(around)]
        height += pitch
    h, angle = np.array(place[:grains]).T
    radial = np.column_stack([np.cos(angle), np.sin(angle)])
    foot = np.column_stack([radial * (h * math.tan(STEEP))[:, None], h])
    normal = np.column_stack([-radial * math.cos(STEEP), np.full(grains, math.sin(STEEP))])
    bottom, top = 0.5 * low, height + low
    exact = Frustum(lower=(bottom * math.tan(STEEP), bottom), upper=(top * math.tan(STEEP), top))
    heights = np.linspace(bottom, top, ROWS + 1)
    turns = 2 * math.pi * np.arange(SIDES) / SIDES
    ring = np.column_stack([np.cos(turns), np.sin(turns), np.zeros(SIDES)])
    vertices = np.concatenate([ring * z * math.tan(STEEP) + [0, 0, z] for z in heights])
    cells = [(SIDES * row + k, SIDES * row + (k + 1) % SIDES) for row in range(ROWS) for k in range(SIDES)]
    corners = np.array([t for a, b in cells for t in ((a, b, b + SIDES), (a, b + SIDES, a + SIDES))])
    shapes = {0: Wall(name="cone", shape=exact), len(corners): of_triangles(vertices, corners, math.radians(15))}
    found = []
    for n, wall in shapes.items():
        x = foot + normal * R
        for _ in range(4):  # into touch with this wall
            x = x + normal * (R - OVERLAP - np.abs(wall.shape.distance(x)))[:, None]
        start = Packing(x=x, v=np.zeros_like(x), omega=np.zeros_like(x))
        found.append(Variant(f"cone, {n} triangles" if n else "cone", n, "cone", on(wall, grains), start))
    return found


@dataclass(frozen=True)
class Timing:
    """Cost of a variant.

    Attributes:
        code: Program and precision.
        variant: Name of the variant.
        triangles: Number of triangles; 0 for an exact wall.
        grains: Grains of all members.
        nanoseconds: Time of a step for a grain [ns], median over rounds.
        ratio: Time over that of the exact wall, median over rounds.
        low: Smallest ratio.
        high: Largest ratio.
    """

    code: str
    variant: str
    triangles: int
    grains: int
    nanoseconds: float
    ratio: float
    low: float
    high: float


def measure(
    backend: Backend, device: str, numerics: Numerics, variants: Sequence[Variant], members: int, rounds: int
) -> list[Timing]:
    """Time steps of all variants, with so many members side by side."""
    clock = time.process_time if device == "cpu" else time.perf_counter
    specs = [backend.specialise(variant.scene, numerics) for variant in variants]
    expected = [Expected(spec, v.scene, numerics, members) for spec, v in zip(specs, variants, strict=True)]
    backend.precompile(expected, device)
    running: list[Ensemble] = []
    for variant, spec in zip(variants, specs, strict=True):
        ensemble = backend.open(spec, members, device)
        for _ in range(members):
            ensemble.admit(variant.scene, numerics, variant.start)
        if events := ensemble.advance(2):
            raise SystemExit(f"{variant.name}: {events[0]}")
        running.append(ensemble)
    began = clock()
    running[-1].advance(2)
    beats = min(LONGEST, max(1, round(2 * ROUND / (clock() - began))))
    spent = np.zeros((rounds, len(running)))
    for row in spent:
        for k, ensemble in enumerate(running):
            began = clock()
            ensemble.advance(beats)
            row[k] = (clock() - began) / beats / numerics.steps_per_beat
    for ensemble in running:
        ensemble.close()
    return summary(f"labbook {backend.capabilities.name} {numerics.precision}", variants, spent, members)


def peer(code: str, variants: Sequence[Variant], rounds: int) -> list[Timing]:
    """The same of another code on one thread."""
    beds = [Bed(variant.name, variant.scene, variant.start) for variant in variants]
    rates = np.array([[theirs(code, bed) for bed in beds] for _ in range(rounds)])
    grains = np.array([len(variant.start) for variant in variants])
    return summary(code, variants, grains / rates / 1e6, 1)


def summary(code: str, variants: Sequence[Variant], spent: np.ndarray, members: int) -> list[Timing]:
    """Timings from the seconds of a step, shape [rounds, variants]."""
    names = [variant.name for variant in variants]
    rows = []
    for k, variant in enumerate(variants):
        grains, ratio = members * len(variant.start), spent[:, k] / spent[:, names.index(variant.exact)]
        spread = float(np.median(ratio)), float(ratio.min()), float(ratio.max())
        rows.append(
            Timing(code, variant.name, variant.triangles, grains, 1e9 * float(np.median(spent[:, k])) / grains, *spread)
        )
    return rows


def main() -> None:
    """Measure, print, write."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--backend", default="numba")
    words.add_argument("--device", default="cpu")
    words.add_argument("--precision", nargs="*", help="precisions; default: all of the backend")
    words.add_argument("--grains", type=int, default=1024, help="grains of a member")
    words.add_argument("--members", type=int, nargs="*", default=[1], help="members side by side")
    words.add_argument("--rounds", type=int, default=5)
    words.add_argument("--no-peer", action="store_true", help="leave out LIGGGHTS")
    words.add_argument("--out", type=Path, default=Path("mesh_walls"), help="folder for JSON and CSV")
    options = words.parse_args()
    backend = load(options.backend)
    backend = (on_one_thread(backend) if options.device == "cpu" else None) or backend
    variants = [*flat(options.grains), *conical(options.grains)]
    timings: list[Timing] = []
    for precision in options.precision or sorted(backend.capabilities.precisions):
        numerics = STEPS.model_copy(update={"precision": precision})
        for members in options.members:
            timings += measure(backend, options.device, numerics, variants, members, options.rounds)
    if options.device == "cpu" and shutil.which("liggghts") and not options.no_peer:
        timings += peer("liggghts", variants, options.rounds)
    table = pd.DataFrame([asdict(timing) for timing in timings])
    print(table.to_string(index=False, float_format=lambda number: f"{number:.3g}"))
    options.out.mkdir(parents=True, exist_ok=True)
    table.to_csv(options.out / "mesh_walls.csv", index=False)
    record = {"date": f"{datetime.now(UTC):%Y-%m-%d}", "hardware": hardware(), "device": options.device}
    record["timings"] = table.to_dict("records")
    (options.out / "mesh_walls.json").write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
