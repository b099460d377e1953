"""From a study to its report: wall time and memory of `labbook run` and `labbook report` for one silo of many grains.

A round silo of spheres (linear law, friction, mixed precision) is filled by a rain, and a tenth of the grains flows
out. The two commands run in processes of their own, from an empty lab and, for the first size, with nothing compiled.
Times of the beats come from the records of packing and run.

    python benchmarks/whole.py --backend warp --device cuda:0 --out whole.json
    python benchmarks/whole.py --grains 10000
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pandas as pd

from labbook import Lab, load
from labbook.backend.machine import hardware
from labbook.lab.packings import PackingRecord
from labbook.lab.records import RunRecord
from labbook.scene import Spheres

STUDY = """
name: whole-{grains}
about: A silo of {grains} spheres, from its filling to a report
grains: {{shape: sphere, diameter: 4 mm, density: {density} kg/m^3, count: {grains}}}
contact: {{law: linear, normal_stiffness: {stiffness:g} N/m, friction: 0.5, restitution: 0.9}}
container: {{kind: cylinder-silo, diameter: {diameter:g} mm, height: {height:g} mm, orifice: {orifice:g} mm}}
fill: {{kind: rain, settled_below: 1.0e-4}}
window: {{start: 0.02, end: 0.1}}
stop: {{discharged: 0.1}}
numerics: {{dt: 0.05 collision, precision: mixed}}
measure: [flow_rate]
"""
WIDTHS = {10_000: (24, 8), 100_000: (44, 12), 1_000_000: (80, 20)}
"""Diameters of silo and orifice, in diameters of a grain, by the number of grains."""
DIAMETER, DENSITY = 0.004, 2500.0  # m, kg/m^3
DENSE = 0.6  # packing fraction of a bed, about


def study(grains: int) -> str:
    """The study as YAML. A grain that has fallen through all of the silo overlaps by some 10 % with the bed."""
    wide, orifice = WIDTHS[grains]
    high = grains * (2 / 3) / (DENSE * wide**2)  # of the bed, in diameters
    height = 3 * high * DIAMETER
    mass = Spheres(diameter=DIAMETER, density=DENSITY, count=1).mass
    stiffness = mass * 2 * 9.81 * height / (0.1 * DIAMETER) ** 2  # N/m: m v^2 / 2 = k delta^2 / 2
    sizes = {"diameter": wide, "height": 3 * high, "orifice": orifice}
    return STUDY.format(
        grains=grains,
        density=DENSITY,
        stiffness=stiffness,
        **{name: 1e3 * DIAMETER * size for name, size in sizes.items()},
    )


def timed(*command: str) -> tuple[float, float]:
    """Seconds that a command of labbook takes, and the peak memory [GB] of its largest process."""
    begun = time.perf_counter()
    process = subprocess.Popen([sys.executable, "-m", "labbook", *command])
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"labbook {' '.join(command)}: exit status {process.returncode}")
    return time.perf_counter() - begun, usage.ru_maxrss / 2**20


def measured(grains: int, backend: str, device: str) -> dict[str, Any]:
    """Seconds of the whole, of its commands, and of the beats; peak memory [GB]."""
    with tempfile.TemporaryDirectory() as folder:
        path, lab = Path(folder) / "study.yaml", str(Path(folder) / "lab")
        path.write_text(study(grains))
        on = ("--lab", lab, "--backend", backend)
        run, memory = timed("run", str(path), *on, "--device", device)
        report, also = timed("report", str(path), *on)
        made = Lab(lab, backend)
        (done,) = made.results(load(path), False).points[0].runs
        discharged = RunRecord.read(made.lab_folder.run(done.run_key))
        filled = PackingRecord.read(made.lab_folder.packing(discharged.packing_key))
        filling, discharge = filled.wall_time, discharged.wall_time
        steps = sum(one.grain_steps for record in (filled, discharged) for one in record.sessions)
        return {
            "grains": grains,
            "run": run,
            "filling": filling,
            "discharge": discharge,
            "rest": run - filling - discharge,
            "report": report,
            "memory": max(memory, also),
            "rate": steps / (filling + discharge) / 1e6,
        }


def main() -> None:
    """Measure, print a table, and write the figures."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--grains", default=",".join(map(str, WIDTHS)), help="Numbers of grains, of those in WIDTHS.")
    words.add_argument("--backend", default="numba")
    words.add_argument("--device", default="cpu")
    words.add_argument("--out", type=Path, help="Also write the figures to this JSON file.")
    said = words.parse_args()
    found: list[dict[str, Any]] = []
    asked = [int(grains) for grains in said.grains.split(",")]
    if unknown := set(asked) - set(WIDTHS):
        words.error(f"--grains: {unknown.pop()} is not one of {', '.join(map(str, WIDTHS))}")
    for grains in asked:
        found.append(measured(grains, said.backend, said.device))
        print(pd.DataFrame(found).round(2).to_string(index=False), flush=True)
        if said.out:
            told = {"date": f"{datetime.now(UTC):%Y-%m-%d}", "hardware": hardware(), "backend": said.backend}
            said.out.write_text(json.dumps({**told, "device": said.device, "sizes": found}, indent=2) + "\n")


if __name__ == "__main__":
    main()
