"""Discharge of plastic spheres from a box with a slot, beside the measured curve (studies/plastic-spheres.yaml).

Of the experiment and of every point of the study: the flow rate W between 15 and 80 % of the mass, with its standard
error, and the part of the mass that has left after 7.15 s. The measured curve has 23 points of one discharge, read off
a figure by others. Its W is the slope of a straight line through the points of the window, and the error that of this
slope from the scatter of the points about the line; how two discharges differ is not known.

    python benchmarks/plastic_spheres.py --lab LAB --backend warp --device cuda:0 --out FILE

Runs that the lab has are not made again.
"""

import argparse
import json
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

import labbook
from labbook.backend.machine import hardware
from labbook.results.points import FLOW_RATE

STUDY = Path(__file__).parents[1] / "studies" / "plastic-spheres.yaml"
MASS = 2.344
"""Of all grains [kg]."""
MEASURED = np.array([
    (0.00, 0.00), (0.23, 3.76), (0.53, 8.33), (0.79, 13.43), (1.06, 19.34), (1.34, 25.25), (1.56, 30.98), (1.96, 36.88),
    (2.32, 42.97), (2.60, 48.70), (2.86, 54.07), (3.09, 58.28), (3.29, 62.31), (3.56, 67.41), (3.81, 72.25),
    (4.12, 78.60), (4.46, 83.35), (4.68, 87.65), (5.02, 91.14), (5.28, 92.39), (5.64, 93.46), (6.49, 94.09),
    (7.15, 94.45),
])  # fmt: skip
"""Time [s] and mass discharged [%] (post/GranularFlow/post_Plastic_Sph_Hopper.m of projectchrono/DEM-Engine)."""


def slope(start: float, end: float) -> tuple[float, float]:
    """W [kg/s] of the experiment between two parts of the mass, and its standard error from the scatter of the points
    about a straight line."""
    part = 0.01 * MEASURED[:, 1]
    time, part = MEASURED[(part >= start) & (part <= end), 0], part[(part >= start) & (part <= end)]
    (rate, _), covariance = np.polyfit(time, part, 1, cov=True)
    return MASS * float(rate), MASS * float(np.sqrt(covariance[0, 0]))


def rows(lab: labbook.Lab, study: labbook.Study) -> Iterator[dict[str, Any]]:
    """Of every point: W of all beds [g/s], and the part discharged at the times of the measured points."""
    for point in lab.results(study, progress=False).points:
        rates, curves, outcomes = [], [], []
        for run in point.runs:
            measured, crossing = run.measured.get(FLOW_RATE), run.run.data().tables["crossing"]
            outcomes.append(str(run.outcome))
            if measured is not None and np.isfinite(measured.value):
                rates.append(1e3 * measured.value)
                times = np.sort(np.asarray(crossing["time"]))
                curves.append((np.searchsorted(times, MEASURED[:, 0]) / point.point.scene.grains.count).tolist())
        yield {"point": point.label, "W [g/s]": rates, "discharged": curves, "outcomes": outcomes}


def main() -> None:
    """Run what is missing, print, and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lab", type=Path, required=True)
    parser.add_argument("--beds", type=int, help="Replicates; those of the study if not given.")
    parser.add_argument("--backend", default="numba")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    study = labbook.load(STUDY)
    if options.beds:
        study = study.change(replicates=options.beds)
    lab = labbook.Lab(options.lab, options.backend, options.device)
    lab.run(study, progress=False)
    rate, error = slope(study.window.start, study.window.end)
    print(f"experiment: W = {1e3 * rate:.1f} ± {1e3 * error:.1f} g/s, {MEASURED[-1, 1]:.1f} % after 7.15 s")
    found = list(rows(lab, study))
    for row in found:
        rates, last = np.array(row["W [g/s]"]), 100 * np.array(row["discharged"])[:, -1]
        error = rates.std(ddof=1) / np.sqrt(len(rates)) if len(rates) > 1 else np.nan
        print(f"{row['point']}: W = {rates.mean():.1f} ± {error:.1f} g/s ({len(rates)} beds), {last.mean():.1f} %")
    if options.out:
        result = {"date": f"{datetime.now(UTC):%Y-%m-%d}", "hardware": hardware(), "points": found}
        options.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
