"""An oblique impact of two spheres in LIGGGHTS and in LAMMPS, beside the laws of labbook that are named after them.

Two grains of Fan's hopper meet off centre, at angles from grazing to head-on. What they fly on with is compared:
normal and tangential velocity and spin, in parts of the velocity before. All codes take the same small steps; the laws
are the same if differences shrink in proportion to the step. LAMMPS also reckons with other levers (radii that are not
shortened by the overlap, for velocities) and turns springs without shortening them: what that does falls with the
overlap, hence with the speed. In `liggghts epsd` rolling springs resist the spin that the first grain has. Needs
Debian's packages liggghts and lammps (`liggghts` and `lmp`).

    python benchmarks/peers/impact.py --out impact.json
"""

import argparse
import itertools
import json
import math
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from labbook.backend import load
from labbook.backend.machine import hardware
from labbook.backend.numerics import Numerics
from labbook.checks.verify.materials import room, scene
from labbook.scene import HertzLammps, HertzLiggghts
from labbook.scene.packing import Packing

D, DENSITY, G, NU, E, MU = 3e-3, 2500.0, 1e8, 0.25, 0.2, 0.5
YOUNG = 2 * G * (1 + NU)
SPEEDS = (0.5, 0.05)  # of each grain [m/s]
OFFSETS = (0.2, 0.5, 0.8)  # of the centres across the flight, in parts of d
MU_R, ETA_R = 0.2, 0.3  # where there are rolling springs; and the spin of the first grain times d over its speed
SPIN = 1.0
STEPS = (4e-8, 2e-8, 1e-8)  # s
_GAP, _SPAN = 1e-6, 2e-4  # m between the grains at first; s that are computed
_ETA = 0.6  # damping coefficient of LAMMPS' tsuji model is a polynomial of this restitution

LIGGGHTS = """
atom_style granular
atom_modify map array
boundary f f f
newton off
communicate single vel yes
units si
region box block -0.02 0.02 -0.02 0.02 -0.02 0.02 units box
create_box 1 box
neighbor 0.002 bin
neigh_modify delay 0
fix m1 all property/global youngsModulus peratomtype {young}
fix m2 all property/global poissonsRatio peratomtype {nu}
fix m3 all property/global coefficientRestitution peratomtypepair 1 {e}
fix m4 all property/global coefficientFriction peratomtypepair 1 {mu}
{rolling_fixes}
pair_style gran model hertz tangential history {rolling}
pair_coeff * *
timestep {dt}
create_atoms 1 single {x0} {y0} 0 units box
create_atoms 1 single {x1} {y1} 0 units box
set group all diameter {d} density {density}
set atom 1 vx {speed} omegaz {spin}
set atom 2 vx -{speed}
fix go all nve/sphere
dump out all custom {every} dump.txt id vx vy omegaz
dump_modify out sort id format "%d %20.15g %20.15g %20.15g"
run {steps}
"""
ROLLING_FIXES = """
fix m5 all property/global coefficientRollingFriction peratomtypepair 1 {mu_r}
fix m6 all property/global coefficientRollingViscousDamping peratomtypepair 1 {eta_r}
"""
LAMMPS = """
units si
atom_style sphere
atom_modify map array
boundary f f f
newton off
comm_modify vel yes
region box block -0.02 0.02 -0.02 0.02 -0.02 0.02
create_box 1 box
neighbor 0.002 bin
neigh_modify delay 0
pair_style granular
pair_coeff * * hertz/material {young} {eta} {nu} tangential mindlin NULL 1.0 {mu} damping tsuji
timestep {dt}
create_atoms 1 single {x0} {y0} 0
create_atoms 1 single {x1} {y1} 0
set group all diameter {d}
set group all density {density}
set atom 1 vx {speed}
set atom 2 vx -{speed}
fix go all nve/sphere
dump out all custom {every} dump.txt id vx vy omegaz
dump_modify out sort id format line "%d %20.15g %20.15g %20.15g"
run {steps}
"""


def tsuji(e: float) -> float:
    """C_n of LAMMPS' `damping tsuji` for the restitution e: its polynomial is the dashpot over sqrt(m* K), and C_n is
    that over sqrt(6 m* K)."""
    return float(np.polyval([4.8218, -18.022, 27.467, -22.348, 11.087, -4.2783, 1.2728], e)) / math.sqrt(6)


def first_spin(law: Any, speed: float) -> float:
    """Spin [rad/s] of the first grain before the impact: without it equal grains spin alike, and nothing rolls."""
    return SPIN * speed / D if law.rolling_model == "epsd" else 0.0


def theirs(program: str, script: str, law: Any, speed: float, offset: float, dt: float) -> np.ndarray:
    """vx, vy [m/s] and spin times radius [m/s] of the first grain after the impact."""
    across = offset * D
    along = math.sqrt(D**2 - across**2) + _GAP
    steps = round(_SPAN / dt)
    words = {
        "young": YOUNG, "nu": NU, "e": E, "mu": MU, "dt": dt, "d": D, "density": DENSITY, "speed": speed,
        "x0": -along / 2, "x1": along / 2, "y0": -across / 2, "y1": across / 2, "steps": steps, "every": steps,
        "eta": _ETA, "spin": first_spin(law, speed), "rolling": "rolling_friction epsd" if law.rolling_friction else "",
        "rolling_fixes": ROLLING_FIXES.format(mu_r=MU_R, eta_r=ETA_R) if law.rolling_friction else "",
    }  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "in.impact").write_text(script.format(**words))
        done = subprocess.run([program, "-in", "in.impact"], cwd=folder, capture_output=True, text=True)
        if done.returncode:
            raise SystemExit(f"{program}: {(done.stdout + done.stderr)[-800:]}")
        last = (Path(folder) / "dump.txt").read_text().strip().splitlines()[-2]
    _, vx, vy, spin = map(float, last.split())
    return np.array([vx, vy, spin * D / 2])


def ours(law: Any, speed: float, offset: float, dt: float) -> np.ndarray:
    """The same by labbook's plain Python."""
    across = offset * D
    along = math.sqrt(D**2 - across**2) + _GAP
    how = Numerics(dt=dt, steps_per_beat=100, precision="double")
    backend, here = load("reference"), scene(2, law, room())
    x = np.array([[-along / 2, -across / 2, 0.5], [along / 2, across / 2, 0.5]])
    omega = np.array([[0, 0, first_spin(law, speed)], [0, 0, 0]])
    start = Packing(x=x, v=np.array([[speed, 0, 0], [-speed, 0, 0]]), omega=omega)
    ensemble = backend.open(backend.specialise(here, how, []), 1, "cpu")
    member = ensemble.admit(here, how, start)
    ensemble.advance(round(_SPAN / dt / 100))
    end = ensemble.packing(member)
    ensemble.close()
    return np.array([end.v[0, 0], end.v[0, 1], end.omega[0, 2] * D / 2])


def main() -> None:
    """Compare, print and write."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--out", type=Path)
    said = words.parse_args()
    shared = {"shear_modulus": G, "poisson_ratio": NU, "friction": MU, "restitution": E}
    sprung = {"rolling_friction": MU_R, "rolling_model": "epsd", "rolling_damping": ETA_R, "rolling": "rolling"}
    codes = {
        "liggghts": ("liggghts", LIGGGHTS, HertzLiggghts.model_validate(shared)),
        "liggghts epsd": ("liggghts", LIGGGHTS, HertzLiggghts.model_validate({**shared, **sprung})),
        "lammps": ("lmp", LAMMPS, HertzLammps.model_validate({**shared, "normal_damping": tsuji(_ETA)})),
    }
    found = []
    for code, (program, script, law) in codes.items():
        for speed, offset, dt in itertools.product(SPEEDS, OFFSETS, STEPS):
            a, b = theirs(program, script, law, speed, offset, dt), ours(law, speed, offset, dt)
            told = {"code": code, "speed": speed, "offset": offset, "dt": dt}
            found.append({**told, "largest": np.abs(a - b).max() / speed, "theirs": a.tolist(), "ours": b.tolist()})
    print(pd.DataFrame(found)[["code", "speed", "offset", "dt", "largest"]].to_string(index=False))
    if said.out:
        said.out.write_text(json.dumps({"hardware": hardware(), "found": found}, indent=2) + "\n")


if __name__ == "__main__":
    main()
