"""Chains of spheres beside the spherocylinder of the same envelope: does the flow rate approach that of the rod?

Beds of equal numbers of grains leave a cylindrical silo through its bottom. The grains are rods of L/d = 2, or straight
chains of 2 to 8 spheres between the same ends. Of each: its volume relative to the rod's, the largest depth of its
notches, and grains per second with their standard error, which is that over beds.

    python benchmarks/chains.py --lab LAB --beds 8 --out FILE

Runs that the lab has are not made again.
"""

import argparse
import json
import math
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

import labbook
from labbook.backend.machine import hardware
from labbook.results.points import FLOW_RATE

DIAMETER, LENGTH, COUNT = 4.0, 8.0, 400
"""Diameter and length of the grains [mm], and their number."""
SPHERES = (2, 3, 5, 8)
"""Numbers of spheres of a chain."""


def study(spheres: int, beds: int) -> labbook.Study:
    """The study of chains of so many spheres; 0: of rods."""
    size = {"diameter": f"{DIAMETER} mm", "density": "1300 kg/m^3", "count": COUNT}
    grains: dict[str, Any] = {"shape": "spherocylinder", "length": f"{LENGTH} mm", **size}
    if spheres:
        along = np.linspace(0, LENGTH - DIAMETER, spheres).tolist()
        grains = {"shape": "clump", "centres": [["0 mm", "0 mm", f"{z:.6f} mm"] for z in along], **size}
    return labbook.define(
        name=f"chains-{spheres}",
        grains=grains,
        contact={"law": "linear", "normal_stiffness": "2000 N/m", "friction": 0.5, "restitution": 0.6},
        container={"kind": "cylinder-silo", "diameter": "40 mm", "height": "300 mm", "orifice": "26 mm"},
        fill={"kind": "gas", "settled_below": 1e-4},
        window={"start": 0.2, "end": 0.7},
        stop={"discharged": 0.75, "stall": "1 s", "max_time": "20 s"},
        replicates=beds,
        measure=["flow_rate"],
    )


def rows(lab: labbook.Lab, beds: int) -> Iterator[dict[str, Any]]:
    """One row for the rods, then one for each kind of chains."""
    rod = 0.0
    for spheres in (0, *SPHERES):
        studied = study(spheres, beds)
        lab.run(studied, progress=False, pilot=False)
        (point,) = lab.results(studied, progress=False).points
        grains = point.point.scene.grains
        rates = [run.measured[FLOW_RATE].value / grains.mass for run in point.runs if FLOW_RATE in run.measured]
        rod = rod or grains.volume
        step = (LENGTH - DIAMETER) / (spheres - 1) if spheres else 0.0
        yield {
            "spheres": spheres or None,
            "volume": grains.volume / rod,
            "notch_d": 0.5 - math.sqrt(0.25 - (step / DIAMETER / 2) ** 2),
            "grains_per_second": float(np.mean(rates)),
            "error": float(np.std(rates, ddof=1) / math.sqrt(len(rates))),
            "beds": len(rates),
        }


def main() -> None:
    """Run what is missing, print, and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lab", type=Path, required=True)
    parser.add_argument("--beds", type=int, default=8)
    parser.add_argument("--backend", default="numba")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    lab = labbook.Lab(options.lab, options.backend, options.device)
    table = []
    for row in rows(lab, options.beds):
        table.append(row)
        print(json.dumps(row), flush=True)
    if options.out:
        about = {"date": f"{datetime.now(UTC):%Y-%m-%d}", "hardware": hardware(), "backend": options.backend}
        options.out.write_text(json.dumps({**about, "rows": table}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
