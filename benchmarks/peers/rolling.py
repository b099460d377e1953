"""A sphere that rolls to rest on a plane in LIGGGHTS, beside labbook's rolling springs (`rolling_model: epsd`).

A grain of Fan's hopper lies on a floor and is given a spin and the velocity of rolling. Its spring is mobilised first,
and then swings it to rest. Velocity and spin are compared at twenty times on the way, in parts of the velocity before.
Both codes take the same steps; the models are the same if differences shrink in proportion to the step. Needs Debian's
package liggghts.

    python benchmarks/peers/rolling.py --out rolling.json
"""

import argparse
import json
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

from labbook.backend import load
from labbook.backend.machine import hardware
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Sample
from labbook.checks.verify.materials import floor, scene
from labbook.scene import HertzLiggghts, Primitives, SurfaceChange
from labbook.scene.packing import Packing

D, DENSITY, G, NU, E, MU, GRAVITY = 3e-3, 2500.0, 1e10, 0.25, 0.2, 0.5, 9.81
SPEED = 5e-4  # m/s
MU_R, ETA_R = (0.05, 0.1), (0.0, 0.3)
STEPS = (4e-7, 2e-7, 1e-7)  # s
_LOOKS, _SPAN = 20, 0.004  # times that are compared; s that are computed

LIGGGHTS = """
atom_style granular
atom_modify map array
boundary f f f
newton off
communicate single vel yes
units si
hard_particles yes
region box block -0.02 0.02 -0.02 0.02 -0.02 0.02 units box
create_box 1 box
neighbor 0.002 bin
neigh_modify delay 0
fix m1 all property/global youngsModulus peratomtype {young}
fix m2 all property/global poissonsRatio peratomtype {nu}
fix m3 all property/global coefficientRestitution peratomtypepair 1 {e}
fix m4 all property/global coefficientFriction peratomtypepair 1 {mu}
fix m5 all property/global coefficientRollingFriction peratomtypepair 1 {mu_r}
fix m6 all property/global coefficientRollingViscousDamping peratomtypepair 1 {eta_r}
pair_style gran model hertz tangential history rolling_friction epsd
pair_coeff * *
timestep {dt}
fix gravity all gravity {gravity} vector 0.0 0.0 -1.0
fix floor all wall/gran model hertz tangential history rolling_friction epsd primitive type 1 zplane 0.0
create_atoms 1 single 0 0 {height} units box
set group all diameter {d} density {density}
set atom 1 vx {speed} omegay {spin}
fix go all nve/sphere
dump out all custom {every} dump.txt id vx omegay
dump_modify out sort id format "%d %20.15g %20.15g"
run {steps}
"""


def law(mu_r: float, eta_r: float) -> HertzLiggghts:
    """The law of both."""
    return HertzLiggghts(
        shear_modulus=G, poisson_ratio=NU, friction=MU, restitution=E, rolling_friction=mu_r, rolling_model="epsd",
        rolling_damping=eta_r, rolling="rolling",
    )  # fmt: skip


def height() -> float:
    """Height [m] at which the floor carries the grain."""
    weight = DENSITY * np.pi / 6 * D**3 * GRAVITY
    return D / 2 - (weight / (4 / 3 * G / (1 - NU) * np.sqrt(D / 2))) ** (2 / 3)


def theirs(mu_r: float, eta_r: float, dt: float) -> np.ndarray:
    """Velocity and spin times radius [m/s] by LIGGGHTS, shape [looks, 2]."""
    steps = round(_SPAN / dt)
    script = LIGGGHTS.format(
        young=2 * G * (1 + NU), nu=NU, e=E, mu=MU, mu_r=mu_r, eta_r=eta_r, dt=dt, gravity=GRAVITY, height=height(), d=D,
        density=DENSITY, speed=SPEED, spin=SPEED / height(), every=steps // _LOOKS, steps=steps,
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "in.rolling").write_text(script)
        done = subprocess.run(["liggghts", "-in", "in.rolling"], cwd=folder, capture_output=True, text=True)
        if done.returncode:
            raise SystemExit(f"liggghts: {(done.stdout + done.stderr)[-800:]}")
        lines = (Path(folder) / "dump.txt").read_text().strip().splitlines()
    rows = [lines[k + 1].split() for k, line in enumerate(lines) if line.startswith("ITEM: ATOMS")]
    return np.array(rows, float)[1:, 1:] * [1.0, D / 2]


def ours(mu_r: float, eta_r: float, dt: float) -> np.ndarray:
    """The same by labbook's CPU backend."""
    every = round(_SPAN / dt) // _LOOKS
    how = Numerics(dt=dt, steps_per_beat=every, precision="double")
    surface = SurfaceChange(friction=MU, rolling_friction=mu_r)
    here = scene(1, law(mu_r, eta_r), Primitives(parts=(floor(),)), GRAVITY, floor=surface)
    backend, look = load("numba"), Sample(fields=("v", "omega"))
    start = Packing(
        x=np.array([[0.0, 0.0, height()]]), v=np.array([[SPEED, 0.0, 0.0]]), omega=np.array([[0, SPEED / height(), 0]])
    )
    ensemble = backend.open(backend.specialise(here, how, [look]), 1, "cpu")
    ensemble.admit(here, how, start)
    ensemble.advance(_LOOKS)
    table = ensemble.drain()[look]
    ensemble.close()
    return np.column_stack([table["vx"], table["wy"] * D / 2])


def main() -> None:
    """Compare, print and write."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--out", type=Path)
    said = words.parse_args()
    found = []
    for mu_r in MU_R:
        for eta_r in ETA_R:
            for dt in STEPS:
                a, b = theirs(mu_r, eta_r, dt), ours(mu_r, eta_r, dt)
                told = {"mu_r": mu_r, "eta_r": eta_r, "dt": dt, "largest": float(np.abs(a - b).max()) / SPEED}
                found.append({**told, "theirs": a.tolist(), "ours": b.tolist()})
    print(pd.DataFrame(found)[["mu_r", "eta_r", "dt", "largest"]].to_string(index=False))
    if said.out:
        said.out.write_text(json.dumps({"hardware": hardware(), "found": found}, indent=2) + "\n")


if __name__ == "__main__":
    main()
