"""Does a polygon in place of round walls change the flow rate? The silo of Dosta et al. (2024), 60 mm, material M1.

    python benchmarks/polygons.py --lab LAB [--backend warp --device cuda:0] [--sides 24 64] [--beds 3] [--out FILE]

Cone and cylinder are exact in one study, and triangles with so many sides in the others; grains are softer by a factor
of 50, and the window is the second from 0.3 to 1.1 s after the opening. A polygon has the corners on the circle, so
that its outlet is smaller: by its area, W falls as (D - 1.4 d)^2.5 of the circle of equal area. With three beds, some
minutes of one H100. `--scale 0.36` takes a small silo, to try it.
"""

import argparse
import json
import math
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import labbook
from labbook import Lab, Study
from labbook.backend.machine import hardware
from labbook.export.stl import wall_files
from labbook.scene.geometry import Bounds

D, CYLINDER, HEIGHT, GRAIN = 60.0, 200.0, 370.0, 4.0
"""Diameters of the outlet and of the cylinder, height of the bed's room and diameter of a grain [mm]."""
GRAINS = 100_000
SHIFT = 1.4
"""k of Beverloo's law for the estimate."""


def round_walls(scale: float, beds: int) -> dict[str, Any]:
    """Build the definition of the study with exact walls and all lengths but the grains' times a scale."""
    steel = {"youngs_modulus": "210 GPa", "poisson_ratio": 0.2, "friction": 0.2, "restitution": 0.4}
    glass = {"youngs_modulus": "1 GPa", "poisson_ratio": 0.2, "friction": 0.3, "restitution": 0.5}
    lengths = {"diameter": CYLINDER, "height": HEIGHT, "orifice": D}
    silo = {key: f"{length * scale:g} mm" for key, length in lengths.items()}
    timed = {"window": {"after": "0.3 s", "until": "1.1 s"}, "stop": {"discharged": 1, "max_time": "1.1 s"}}
    return {
        "name": "polygon-none",
        "about": "Silo of Dosta et al. with exact walls",
        "grains": {
            "shape": "sphere",
            "diameter": f"{GRAIN} mm",
            "density": "2500 kg/m^3",
            "count": round(GRAINS * scale**3),
        },
        "contact": {"law": "hertz-liggghts", **glass},
        "walls": {"all": steel},
        "container": {"kind": "conical-silo", "angle": "45 deg", **silo},
        "numerics": {"precision": "mixed", "stiffness_scale": 0.02},
        "fill": {"kind": "dense"},
        "replicates": beds,
        "measure": ["flow_rate"],
        **(timed if scale == 1 else {"window": {"start": 0.15, "end": 0.5}}),
    }


def of_triangles(sides: int, exact: Study, definition: Mapping[str, Any], scale: float, folder: Path) -> Study:
    """Write the walls of the exact study as triangles and load the study that has them in their place."""
    half, top = CYLINDER * scale / 1e3, HEIGHT * scale / 1e3
    walls = wall_files(exact.points[0].scene.container, Bounds((-half, -half, 0.0), (half, half, top)), sides)
    parts: list[dict[str, Any]] = []
    for wall, text in walls.items():
        (folder / f"{wall}-{sides}.stl").write_text(text)
        mesh = {"kind": "mesh", "file": f"{wall}-{sides}.stl", "unit": "m", "smooth": f"{360 / sides + 1:g} deg"}
        parts.append({"name": wall, "shape": mesh})
    lid = {"kind": "frustum", "lower": ["0 mm", "0 mm"], "upper": [f"{D * scale / 2:g} mm", "0 mm"]}
    parts.append({"name": "lid", "opens": "start", "shape": lid})
    changed = {
        "name": f"polygon-{sides}",
        "about": f"Silo of Dosta et al. with polygons of {sides} sides",
        "container": {"kind": "primitives", "outlet_plane": "0 mm", "parts": parts},
    }
    path = folder / f"polygon-{sides}.yaml"
    path.write_text(json.dumps({**definition, **changed}))  # JSON is YAML; the files lie beside the study
    return labbook.load(path)


def by_area(sides: int, outlet: float) -> float:
    """Relative change of W that follows from the area of the outlet by Beverloo's law."""
    equivalent = outlet * math.sqrt(sides / (2 * math.pi) * math.sin(2 * math.pi / sides))
    return ((equivalent - SHIFT * GRAIN) / (outlet - SHIFT * GRAIN)) ** 2.5 - 1


def rates(lab: Lab, study: Study) -> list[float]:
    """Run a study and return the flow rate [kg/s] of each bed."""
    summary = lab.run(study, progress=False)
    if summary.failed or summary.stopped:
        raise SystemExit(f"{study.name}: {summary}")
    (point,) = lab.results(study, progress=False).points
    return [float(run.measured["flow_rate"].value) for run in point.runs if "flow_rate" in run.measured]


def compare(exact: Sequence[float], polygon: Sequence[float]) -> tuple[float, float]:
    """Relative difference of two means of independent beds and its standard error."""
    a, b = np.asarray(exact), np.asarray(polygon)
    error = math.hypot(a.std(ddof=1) / math.sqrt(len(a)), b.std(ddof=1) / math.sqrt(len(b))) / a.mean()
    return float(b.mean() / a.mean() - 1), float(error)


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lab", type=Path, required=True)
    parser.add_argument("--backend", default="numba")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--sides", type=int, nargs="+", default=[24, 64])
    parser.add_argument("--beds", type=int, default=3)
    parser.add_argument("--scale", type=float, default=1.0, help="of all lengths but the grains', to try it")
    parser.add_argument("--out", type=Path, help="JSON file of the results")
    args = parser.parse_args()
    lab = Lab(args.lab, args.backend, args.device)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path, definition = folder / "polygon-none.yaml", round_walls(args.scale, args.beds)
        path.write_text(json.dumps(definition))
        exact = labbook.load(path)
        results = {"none": rates(lab, exact)}
        print(f"exact walls: {np.mean(results['none']):.5g} kg/s", flush=True)
        for sides in args.sides:
            results[str(sides)] = rates(lab, of_triangles(sides, exact, definition, args.scale, folder))
            change, error = (100 * part for part in compare(results["none"], results[str(sides)]))
            expected = 100 * by_area(sides, D * args.scale)
            print(f"{sides} sides: W {change:+.2f} +- {error:.2f} %, by the area {expected:+.2f} %", flush=True)
    if args.out:
        record = {"hardware": hardware(), "scale": args.scale, "flow_rate_kg_per_s": results}
        args.out.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
