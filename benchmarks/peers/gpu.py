"""Speed and outflow of labbook, peclet and DEM-Engine on one GPU and one scene.

Scene: a flat-bottomed box with a slot over its whole depth, in discharge. Spheres of 3 mm, Hertz-Mindlin with friction
history, shear modulus 10 MPa, friction 0.5, restitution 0.3, steps of 5 us. labbook fills the box of 10 000 grains.
All codes start from this bed; larger boxes hold copies of it. A code takes 4000 steps in the closed box. Then the slot
opens, and steps are timed from 0.05 s after the opening. Rates are million grain-steps per second of the wall clock.
All grains of a scene count in all codes, also those that have left. What differs between the codes:

* labbook computes in `mixed` or `double`, the peers in single precision; DEM-Engine has positions in integers.
* labbook and DEM-Engine have exact walls. Those of peclet are grids of distances.
* Friction springs of peclet begin anew at the opening.

    pip install 'deme[cuda12]==3.0.19' peclet-dem-cu13==1.1.0
    python benchmarks/peers/gpu.py --out gpu.json

The peers (DEM-Engine: BSD-3, peclet: MIT) have wheels for Linux on x86-64. DEM-Engine also needs libX11 and libXext
(Debian: libx11-6, libxext6). It reads its kernels from the site-packages of the interpreter, so `pip install --target`
does not serve. The peers may have an interpreter of their own, which `--python` names. A code that is not installed is
an error; `--codes` chooses. Takes about five minutes on a large GPU, of which DEM-Engine compiles for one or two.

For a machine without a network, download the wheels for its Python elsewhere, and unpack them into the site-packages of
an environment there:

    pip download --no-deps --only-binary=:all: --python-version 3.12 --platform manylinux_2_28_x86_64 \\
        --platform manylinux_2_27_x86_64 --platform manylinux_2_17_x86_64 --platform manylinux_2_12_x86_64 -d wheels \\
        deme==3.0.19 peclet-dem-cu13==1.1.0 nvidia-cuda-runtime-cu12==12.8.90 nvidia-cuda-nvrtc-cu12==12.8.93 \\
        nvidia-cuda-nvcc-cu12==12.8.93 nvidia-cuda-cccl-cu12==12.8.90 nvidia-curand-cu12==10.3.9.90 \\
        nvidia-cuda-runtime==13.0.96
    for wheel in wheels/*.whl; do python -m zipfile -e $wheel site; done
    rm -r site/lib64/*.a site/share/DEME/data/mesh site/nvidia/cuda_nvrtc/lib/*.alt.so* \\
        site/nvidia/cuda_nvcc/{bin,nvvm} site/nvidia/curand/lib      # needed only to build programs
    tar -C site -cJf peers.tar.xz .                                  # about 50 MB
    # there:
    python3 -m venv --system-site-packages env
    tar -xJf peers.tar.xz -C env/lib/python3.12/site-packages
    python3 benchmarks/peers/gpu.py --python env/bin/python
"""

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from gpu_peers import (
    CODES,
    DENSITY,
    DIAMETER,
    DT,
    FIRST_BED,
    FRICTION,
    POISSON_RATIO,
    RELAX,
    RESTITUTION,
    SHEAR_MODULUS,
    SIZES,
    STEPS,
    side_by_side,
)

from labbook.backend import Backend, load
from labbook.backend.machine import hardware
from labbook.backend.numerics import Numerics, Precision
from labbook.backend.probes import Crossing
from labbook.checks.bench.speed import advance_until
from labbook.filling.opening import start_of_discharge
from labbook.filling.placing import place
from labbook.scene import HertzMindlin, Scene, Spheres, WedgeHopper
from labbook.scene.packing import Packing

PRECISIONS: tuple[Precision, ...] = ("mixed", "double")
SETTLED = 1e-4
"""Kinetic energy per grain [m g d] of the first bed."""
LIMIT = 150.0
"""Seconds after which a run of a peer is stopped."""


def box(grains: int) -> Scene:
    """The scene of one of SIZES."""
    width, depth, slot = SIZES[grains].metres
    return Scene(
        grains=Spheres(diameter=DIAMETER, density=DENSITY, count=grains),
        contact=HertzMindlin(
            shear_modulus=SHEAR_MODULUS, poisson_ratio=POISSON_RATIO, friction=FRICTION, restitution=RESTITUTION
        ),
        container=WedgeHopper(width=width, height=120 * DIAMETER, thickness=depth, orifice=slot),
    )


def first_bed(backend: Backend, device: str) -> np.ndarray:
    """Centres [m] of the settled grains of the smallest box, shape [FIRST_BED, 3]."""
    closed = box(FIRST_BED).close()
    return advance_until(backend, device, closed, Numerics(dt=DT), place(closed, "rain", 1), SETTLED).x


def ours(
    backend: Backend, device: str, bed: np.ndarray, grains: int, members: int, precision: Precision, timings: int
) -> dict[str, Any]:
    """Row of labbook with `members` equal boxes side by side; `start`: seconds until the bed is relaxed."""
    scene, how = box(grains), Numerics(dt=DT, precision=precision)
    closed, x = scene.close(), side_by_side(bed, SIZES[grains])
    still = Packing(x=x, v=np.zeros_like(x), omega=np.zeros_like(x))
    beats = STEPS // how.steps_per_beat
    began = time.perf_counter()
    relaxed = advance_until(backend, device, closed, how, still, outflow=RELAX * DT)
    spent = time.perf_counter() - began
    start = start_of_discharge(relaxed, closed, scene)
    ensemble = backend.open(backend.specialise(scene, how, [Crossing(0.0)]), members, device)
    handles = [ensemble.admit(scene, how, start) for _ in range(members)]
    ensemble.advance(beats)
    ensemble.drain()
    rates, outflows = [], []
    for _ in range(timings):
        before = ensemble.status(handles[0])
        began = time.perf_counter()
        ensemble.advance(beats)
        ensemble.drain()
        rates.append(members * grains * STEPS / (time.perf_counter() - began) / 1e6)
        after = ensemble.status(handles[0])
        if after.step - before.step != STEPS:
            raise RuntimeError(f"labbook: a member ended before {timings} timings; choose fewer")
        outflows.append((before.grains - after.grains) / (STEPS * DT))
    ensemble.close()
    return {
        "code": "labbook",
        "precision": precision,
        "grains": grains,
        "members": members,
        "start": spent,
        "rates": rates,
        "outflows": outflows,
    }


def theirs(
    python: str, code: str, bed: np.ndarray, grains: int, timings: int, limit: float
) -> Iterator[dict[str, Any]]:
    """Rows of a peer, one for each skin; `ended` says why figures are missing.

    Raises SystemExit if the code fails.
    """
    with tempfile.TemporaryDirectory() as folder:
        stored, script = Path(folder) / "bed.npz", Path(__file__).with_name("gpu_peers.py")
        np.savez(stored, x=bed)
        command = [python, str(script), code, str(stored), str(grains), "--timings", str(timings)]
        output, errors, ended = Path(folder) / "output", Path(folder) / "errors", ""
        with output.open("w") as out, errors.open("w") as err:
            try:
                failed = subprocess.run(command, stdout=out, stderr=err, timeout=limit).returncode
            except subprocess.TimeoutExpired:
                failed, ended = 0, f"not finished in {limit:g} s"
        if failed:
            raise SystemExit(f"{code} with {grains} grains: {' '.join(command)} failed:\n{errors.read_text()[-1500:]}")
        lines = [json.loads(line) for line in output.read_text().splitlines() if line.startswith("{")]
    first: dict[str, Any] = {"version": None, "start": None}
    for line in lines:
        first |= {key: line[key] for key in first if key in line}
    timed = [line for line in lines if "rate" in line]
    for skin in dict.fromkeys(line["skin"] for line in timed) or [None]:
        same = [line for line in timed if line["skin"] == skin]
        yield {
            "code": code,
            "precision": "single",
            "grains": grains,
            "members": 1,
            **first,
            "skin": skin,
            "rates": [line["rate"] for line in same],
            "outflows": [line["outflow"] for line in same if "outflow" in line],
            "ended": ended,
        }


def table(rows: Sequence[dict[str, Any]]) -> pd.DataFrame:
    """One line a row: median of the rates with their range, and the outflow from 0.05 s after the opening on."""
    return pd.DataFrame(
        {
            "code": row["code"],
            "precision": row["precision"],
            "skin": row.get("skin") or "",
            "grains": row["grains"],
            "members": row["members"],
            "M grain-steps/s": _median(row["rates"]) or row.get("ended", ""),
            "outflow [grains/s]": ", ".join(f"{flow:.0f}" for flow in row["outflows"]),
            "start [s]": "" if row["start"] is None else f"{row['start']:.1f}",
        }
        for row in rows
    )


def _median(rates: Sequence[float]) -> str:
    return f"{statistics.median(rates):.0f} ({min(rates):.0f} to {max(rates):.0f})" if rates else ""


def main() -> None:
    """Measure, print a table, and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    codes = ["labbook", *CODES]
    parser.add_argument("--codes", nargs="+", choices=codes, default=codes)
    parser.add_argument("--grains", nargs="+", type=int, choices=sorted(SIZES), default=[FIRST_BED, 100_000])
    parser.add_argument("--members", nargs="+", type=int, default=[1, 64], help="labbook: boxes of 10 000 at once.")
    parser.add_argument("--precisions", nargs="+", choices=PRECISIONS, default=PRECISIONS, help="labbook: of steps.")
    parser.add_argument("--timings", type=int, default=2, help="Timings of 0.05 s of discharge.")
    parser.add_argument("--limit", type=float, default=LIMIT, help="Seconds after which a run of a peer is stopped.")
    parser.add_argument("--python", default=sys.executable, help="Interpreter that has the peers.")
    parser.add_argument("--backend", default="warp")
    parser.add_argument("--device", default="cuda:0", help="Device of labbook; the peers take the first GPU.")
    parser.add_argument("--out", type=Path, help="Also write the figures to this JSON file, after those in it.")
    options = parser.parse_args()
    backend, machine = load(options.backend), hardware()
    rows: list[dict[str, Any]] = []
    if options.out and options.out.exists():
        earlier = json.loads(options.out.read_text())
        if earlier["hardware"] != machine:
            raise SystemExit(f"{options.out} is of another machine or other versions; name another file")
        rows = earlier["rows"]
    print(f"settling {FIRST_BED} grains", flush=True)
    bed = first_bed(backend, options.device)

    def add(row: dict[str, Any]) -> None:
        rows.append(row)
        print(table([row]).to_string(index=False), flush=True)
        if options.out:
            result = {"date": f"{datetime.now(UTC):%Y-%m-%d}", "hardware": machine, "steps": STEPS, "rows": rows}
            options.out.write_text(json.dumps(result, indent=1) + "\n")

    for code in options.codes:
        for grains in options.grains:
            if code != "labbook":
                for row in theirs(options.python, code, bed, grains, options.timings, options.limit):
                    add(row)
                continue
            for members in options.members if grains == FIRST_BED else [1]:
                for precision in options.precisions:
                    add(ours(backend, options.device, bed, grains, members, precision, options.timings))
    print(table(rows).to_string(index=False))


if __name__ == "__main__":
    main()
