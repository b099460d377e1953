"""Write a hopper of many triangles as a CAD program would, with a study of it: a square mouth that turns into a round
outlet, with beads along its seams, dents, bolt heads, a collar, and a conical insert on three struts.

    python benchmarks/large_hopper.py FOLDER --triangles 50000
    labbook plan FOLDER/hopper.yaml && labbook run FOLDER/hopper.yaml && labbook report FOLDER/hopper.yaml
"""

import argparse
import math
from pathlib import Path

import numpy as np

MOUTH, OUTLET, HEIGHT, COLLAR = 75.0, 22.0, 170.0, 15.0
"""Half width of the mouth, radius of the outlet, height of the slope and of the collar below it [mm]."""
SHAFT = 60.0
"""Height of the upright part above the slope [mm]."""
STUDY = """name: large-hopper
about: Beans in a hopper of {count} triangles, with an insert
grains: {{shape: sphere, diameter: 6 mm, density: 1250 kg/m^3, count: {grains}}}
contact:
  {{law: hertz-mindlin, shear_modulus: 2 MPa, poisson_ratio: 0.3, friction: 0.4, rolling_friction: 0.01,
    restitution: 0.4}}
container:
  kind: primitives
  outlet_plane: 0 mm
  parts:
    - {{name: hopper, shape: {{kind: mesh, file: hopper.stl, unit: mm, smooth: 20 deg}}}}
    - {{name: insert, shape: {{kind: mesh, file: insert.stl, unit: mm}}}}
    - {{name: lid, opens: start, shape: {{kind: frustum, lower: [0 mm, 0 mm], upper: [{lid} mm, 0 mm]}}}}
walls: {{hopper: {{friction: 0.3}}, insert: {{friction: 0.3}}}}
window: {{start: 0.15, end: 0.6}}
measure: [flow_rate]
record: {{every: 20 ms}}
"""


def outline(angle: np.ndarray, level: float) -> np.ndarray:
    """Distance from the axis [mm] of a superellipse: a circle at level 0, the outlet, nearly a square at 1."""
    power = 2 + 10 * level**2
    size = OUTLET + (MOUTH - OUTLET) * level
    return size / (np.abs(np.cos(angle)) ** power + np.abs(np.sin(angle)) ** power) ** (1 / power)


def bumps(angle: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Inward height [mm] of weld beads along four seams, dents and bolt heads."""
    seam = np.abs((angle + math.pi / 4) % (math.pi / 2) - math.pi / 4)
    bead = 0.8 * np.exp(-((seam / 0.02) ** 2)) * (1 + 0.3 * np.sin(2 * math.pi * z / 4))
    rng, dents = np.random.default_rng(3), np.zeros_like(angle)
    for _ in range(12):
        at, up, depth = rng.uniform(-math.pi, math.pi), rng.uniform(20, HEIGHT), rng.uniform(-1.5, 0.5)
        away = np.hypot(np.angle(np.exp(1j * (angle - at))) * 60 / 12, (z - up) / 14)
        dents += depth * np.exp(-(away**2))
    row = np.exp(-(((z - HEIGHT - 20) / 3) ** 4))
    bolt = 2.5 * row * np.exp(-((np.abs((angle + math.pi / 16) % (math.pi / 8) - math.pi / 16) / 0.05) ** 4))
    return (bead + dents + bolt) * np.clip(z / 20, 0, 1)


def hopper(triangles: int) -> np.ndarray:
    """Triangles [mm], shape [n, 3, 3], of the collar, the slope and the shaft."""
    around = max(24, round(math.sqrt(triangles / 2 * 1.6)))
    levels = max(12, triangles // (2 * around))
    z = np.linspace(-COLLAR, HEIGHT + SHAFT, levels + 1)
    angle = 2 * math.pi * np.arange(around) / around
    rings = []
    for height in z:
        level = min(max(height / HEIGHT, 0.0), 1.0)
        radius = outline(angle, level) - bumps(angle, np.full(around, height))
        rings.append(np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(around, height)]))
    return grid(np.array(rings), closed=True)


def grid(places: np.ndarray, closed: bool) -> np.ndarray:
    """Triangles between rows of places, shape [rows, columns, 3]; closed: the last column meets the first."""
    after = np.roll(places, -1, axis=1) if closed else places[:, 1:]
    here = places if closed else places[:, :-1]
    a, b, c, d = here[:-1], after[:-1], after[1:], here[1:]
    return np.concatenate([np.stack([a, b, c], 2).reshape(-1, 3, 3), np.stack([a, c, d], 2).reshape(-1, 3, 3)])


def insert(sides: int = 96) -> np.ndarray:
    """Triangles [mm] of a cone with its tip up, above the outlet, and of three struts to the slope."""
    angle = 2 * math.pi * np.arange(sides) / sides
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    profile = [(0.01, 112.0), (24.0, 78.0), (24.0, 74.0), (0.01, 74.0)]
    cone = grid(np.array([np.column_stack([r * circle, np.full(sides, z)]) for r, z in profile]), closed=True)
    struts = []
    for turn in (0.3, 0.3 + 2 * math.pi / 3, 0.3 + 4 * math.pi / 3):
        along, across = (np.array([math.cos(t), math.sin(t), 0.0]) for t in (turn, turn + math.pi / 2))
        ring = 2.0 * np.array([(math.cos(t), math.sin(t)) for t in 2 * math.pi * np.arange(12) / 12])
        rows = [[r * along + u * across + np.array([0, 0, 76.0 + w]) for u, w in ring] for r in (25.0, 40.0, 60.0)]
        struts.append(grid(np.array(rows), closed=True))
    return np.concatenate([cone, *struts])


def write(path: Path, triangles: np.ndarray) -> None:
    """Write a binary STL file."""
    row = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    rows = np.zeros(len(triangles), row)
    rows["corners"] = triangles
    path.write_bytes(b"labbook".ljust(80) + np.uint32(len(rows)).tobytes() + rows.tobytes())


def main() -> None:
    """Write both STL files and the study."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--triangles", type=int, default=50_000)
    parser.add_argument("--grains", type=int, default=2500)
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    shell, inner = hopper(options.triangles), insert()
    write(options.folder / "hopper.stl", shell)
    write(options.folder / "insert.stl", inner)
    text = STUDY.format(count=len(shell) + len(inner), grains=options.grains, lid=OUTLET + 0.5)
    (options.folder / "hopper.yaml").write_text(text, encoding="utf-8")
    print(f"{len(shell)} triangles of the hopper and {len(inner)} of the insert in {options.folder}")


if __name__ == "__main__":
    main()
