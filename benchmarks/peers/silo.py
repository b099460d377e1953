"""Flow rates of LIGGGHTS and LAMMPS from labbook's beds, beside those of the laws named after them.

A study gives the hopper (flat-bottomed), grains, laws and beds. Every bed is discharged by the code that the law is of,
with the same parameters, and by labbook (`numba`, double), both at the same step and without friction springs at first,
since data files hold none. Flow rates are those between the same parts of the mass. Needs Debian's packages liggghts
and lammps.

    labbook run benchmarks/peers/silo.yaml --lab LAB          # or as long as it takes to make the packings
    python benchmarks/peers/silo.py run benchmarks/peers/silo.yaml --lab LAB --out FOLDER --jobs 2 --dt 0.625
    python benchmarks/peers/silo.py table FOLDER --out silo.json

`run` may be cut off at any time and be called again: what is finished is not run again.
"""

import argparse
import hashlib
import json
import math
import shutil
import subprocess
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from forces import wall_stiffness
from impact import tsuji
from scipy.optimize import root_scalar

import labbook
from labbook.backend import load
from labbook.backend.machine import hardware
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Crossing
from labbook.export.packing import data_file
from labbook.filling.opening import opened
from labbook.lab.packings import read_packing
from labbook.plan.demand import Demand, PointDemand
from labbook.scene import ContactLaw, HertzLammps, HertzLiggghts, Scene, WedgeHopper
from labbook.scene.packing import Packing
from labbook.stats.equivalence import replicates_needed, tost

MARGIN = 0.02  # within which flow rates count as the same
EVERY = 1e-4  # s between two counts of the grains that are left
LEAST_RESTITUTION = 0.05  # that LIGGGHTS takes
PIECE = 20_000  # steps after which it is looked whether the window has passed

HEAD = """
units si
atom_style {style}
atom_modify map array
boundary f f f
newton off
{velocities}
read_data bed.data
neighbor 0.0006 bin
neigh_modify delay 0
timestep {dt}
"""
LIGGGHTS = """
fix m1 all property/global youngsModulus peratomtype {young}
fix m2 all property/global poissonsRatio peratomtype {nu}
fix m3 all property/global coefficientRestitution peratomtypepair 1 {e}
fix m4 all property/global coefficientFriction peratomtypepair 1 {mu}
{rolling_property}
pair_style gran model hertz tangential history{rolling}{tension}
pair_coeff * *
fix left all wall/gran model hertz tangential history{rolling} primitive type 1 xplane {left}{tension}
fix right all wall/gran model hertz tangential history{rolling} primitive type 1 xplane {right}{tension}
fix front all wall/gran model hertz tangential history{rolling} primitive type 1 yplane {front}{tension}
fix back all wall/gran model hertz tangential history{rolling} primitive type 1 yplane {back}{tension}
fix plates all mesh/surface file plates.stl type 1
fix bottom all wall/gran model hertz tangential history{rolling} mesh n_meshes 1 meshes plates{tension}
fix down all gravity {g} vector 0 0 -1
fix go all nve/sphere
"""
LAMMPS = """
pair_style granular
pair_coeff * * {law}
fix sides all wall/gran granular {wall} xplane {left} {right}
fix faces all wall/gran granular {wall} yplane {front} {back}
region platel block {far_left} {lip_left} {far_front} {far_back} -1e-6 0 side out
region plater block {lip_right} {far_right} {far_front} {far_back} -1e-6 0 side out
fix bottoml all wall/gran/region granular {wall} region platel
fix bottomr all wall/gran/region granular {wall} region plater
fix down all gravity {g} vector 0 0 -1
fix go all nve/sphere
"""
TAIL = """
region above block INF INF INF INF 0 INF units box
variable left equal count(all,above)
variable now equal step*dt
fix told all print {every} "${{now}} ${{left}}" file left.txt screen no title "time left"
thermo 100000
thermo_modify lost ignore
label again
run {piece}
if "${{left}} > {least}" then "jump SELF again"
"""


@dataclass(frozen=True)
class Job:
    """One discharge of a bed, by another code and by labbook, at the same step [s]."""

    code: str
    scene: Scene
    closed: Scene
    packing: Path
    seed: int
    dt: float
    window: tuple[float, float]
    point: str

    @property
    def name(self) -> str:
        """Names its folder."""
        what = json.dumps([self.scene.model_dump(mode="json"), self.packing.name, self.dt], sort_keys=True)
        return f"{self.code}-{hashlib.sha256(what.encode()).hexdigest()[:16]}"


def jobs(study: labbook.Study, lab: labbook.Lab, dt: float | None, outlets: Sequence[float]) -> Iterator[Job]:
    """The discharges that a study asks for of beds that are in the lab, in the order of seeds."""
    can = load(lab.backend).capabilities
    for seed in range(1, study.replicates + 1):
        for point in study.points:
            scene, law = point.scene, point.scene.contact
            code = {HertzLiggghts: "liggghts", HertzLammps: "lammps"}.get(type(law))
            if code is None or not isinstance(scene.container, WedgeHopper) or not known(code, law):
                continue
            if outlets and not any(math.isclose(scene.container.orifice, 1e-3 * outlet) for outlet in outlets):
                continue
            shared = PointDemand(study, point)
            packing = lab.place.packing(Demand(shared, seed, False).keys(can).packing)
            if packing.exists():
                window = (study.window.start, study.window.end)
                step = dt or point.numerics.dt
                yield Job(code, scene, shared.closed, packing, seed, step, window, point.label)


def known(code: str, law: ContactLaw) -> bool:
    """Whether the code can do it: its damping is bounded, and LAMMPS' rolling resistance is another one."""
    c_n = law.damping_ratio(law.restitution)
    if code == "lammps":
        return c_n <= tsuji(0) and not law.rolling_friction
    return restitution(c_n) >= LEAST_RESTITUTION


def script(job: Job, grains: int) -> tuple[str, dict[str, str]]:
    """The code's input for a discharge, and other files that it needs by name."""
    text, files = model(job.code, job.scene, job.dt)
    least = math.floor((1 - job.window[1]) * grains) - 10
    tail = TAIL.format(every=round(EVERY / job.dt), piece=PIECE, least=least)
    return text + (tail if job.code == "liggghts" else tail.replace(" units box", "")), files


def model(code: str, scene: Scene, dt: float) -> tuple[str, dict[str, str]]:
    """Input of `code` for a scene whose grains are in bed.data, up to the first step, and other files by name."""
    law, hopper = scene.contact, scene.container
    assert isinstance(hopper, WedgeHopper)
    assert isinstance(law, HertzLiggghts | HertzLammps)
    if not hopper.flat or scene.walls or scene.grains.varied:
        raise SystemExit("this script knows flat bottoms, equal grains and walls like the grains")
    lips, half, deep = hopper.outlet, hopper.width / 2, hopper.thickness / 2
    young = 2 * law.shear_modulus * (1 + law.poisson_ratio)
    words: dict[str, object] = {
        "dt": dt, "young": young, "nu": law.poisson_ratio, "mu": law.friction,
        "left": -half, "right": half, "front": -deep, "back": deep, "lip_left": lips[0], "lip_right": lips[1],
        "far_left": -half - 0.01, "far_right": half + 0.01, "far_front": -0.01, "far_back": 0.01, "g": scene.gravity,
    }  # fmt: skip
    if code == "liggghts":
        if law.tangential_damping != 1:
            raise SystemExit("LIGGGHTS damps alike along normal and tangent: leave contact.tangential_damping out")
        words["e"] = restitution(law.damping_ratio(law.restitution))
        if law.rolling_friction:
            words["rolling_property"] = (
                f"fix m5 all property/global coefficientRollingFriction peratomtypepair 1 {law.rolling_friction}"
            )
        words |= {"style": "granular", "velocities": "communicate single vel yes"}
        words["rolling"] = " rolling_friction cdt" if law.rolling_friction else ""
        words.setdefault("rolling_property", "")
        words["tension"] = "" if law.tension else " limitForce on"
        return (HEAD + LIGGGHTS).format(**words), {"plates.stl": plates(hopper)}
    damping = f"damping tsuji{'' if law.tension else ' limit_damping'}"
    gives, walls = eta(law.damping_ratio(law.restitution)), wall_stiffness(young, law.poisson_ratio)
    slides = f"{law.tangential_damping} {law.friction} {damping}"
    words["law"] = f"hertz/material {young} {gives} {law.poisson_ratio} tangential mindlin NULL {slides}"
    words["wall"] = f"hertz {walls['k_n']} {gives} tangential mindlin {walls['k_t']} {slides}"
    words |= {"style": "sphere", "velocities": "comm_modify vel yes"}
    return (HEAD + LAMMPS).format(**words), {}


def restitution(c_n: float) -> float:
    """The restitution of which LIGGGHTS' formula, sqrt(5/6) L/sqrt(pi^2 + L^2) with L = ln(1/e), makes C_n."""
    x = c_n / math.sqrt(5 / 6)
    return math.exp(-math.pi * x / math.sqrt(1 - x * x))


def eta(c_n: float) -> float:
    """The restitution with which LAMMPS' tsuji model damps by C_n."""
    return root_scalar(lambda e: tsuji(e) - c_n, bracket=(0.0, 1.0)).root


def plates(hopper: WedgeHopper) -> str:
    """The bottom left and right of the outlet as STL, two triangles each, wider than the hopper is deep."""
    far, deep = hopper.width / 2 + 0.01, 0.01
    facets = []
    for a, b in ((-far, hopper.outlet[0]), (hopper.outlet[1], far)):
        p = [(a, -deep), (b, -deep), (b, deep), (a, deep)]
        facets += [(p[0], p[1], p[2]), (p[0], p[2], p[3])]
    text = ["solid plates"]
    for facet in facets:
        text += ["facet normal 0 0 1", "outer loop", *(f"vertex {x!r} {y!r} 0.0" for x, y in facet)]
        text += ["endloop", "endfacet"]
    return "\n".join([*text, "endsolid plates", ""])


def flow(counts: pd.DataFrame, mass: float, grains: int, window: tuple[float, float]) -> float:
    """Flow rate [kg/s] between two parts of the mass, from counts of what is left; times are interpolated."""
    gone = grains - counts["left"].to_numpy()
    first = np.maximum.accumulate(gone)
    keep = np.r_[True, np.diff(first) > 0]
    ends = np.interp(np.array(window) * grains, first[keep], counts["time"].to_numpy()[keep])
    return mass * grains * (window[1] - window[0]) / float(ends[1] - ends[0])


def by_labbook(job: Job, packing: Packing) -> pd.DataFrame:
    """The same counts by labbook, from the same bed without its friction springs."""
    bare = {name: np.zeros((0, *shape), kind) for name, (shape, kind) in _SPRINGS.items()}
    backend, numerics = load("numba"), Numerics(dt=job.dt, steps_per_beat=1000, precision="double")
    outlet = Crossing(0.0)  # of every hopper
    ensemble = backend.open(backend.specialise(job.scene, numerics, [outlet]), 1, "cpu")
    ensemble.admit(job.scene, numerics, opened(replace(packing, **bare), job.closed, job.scene))
    times: list[float] = []
    while len(times) < job.window[1] * len(packing) + 10:
        ensemble.advance(10)
        times += [float(time) for time in ensemble.drain()[outlet]["time"]]
    ensemble.close()
    return pd.DataFrame({"time": np.sort(times), "left": len(packing) - np.arange(1, len(times) + 1)})


_SPRINGS = {
    "pairs": ((2,), np.int64), "pair_spring": ((3,), float), "wall_grain": ((), np.int64), "wall_name": ((), "U40"),
    "wall_spring": ((3,), float), "wall_part": ((), np.int64),
}  # fmt: skip


def discharge(job: Job, folder: Path, deadline: float) -> None:
    """Run one and leave its result in `folder`; nothing if the deadline comes first."""
    done = folder / f"{job.name}.json"
    if done.exists() or time.time() > deadline:
        return
    here = folder / job.name
    shutil.rmtree(here, ignore_errors=True)
    here.mkdir(parents=True)
    record, packing = read_packing(job.packing)
    text, files = script(job, len(packing))
    files |= {"in.silo": text, "bed.data": data_file(packing, record.scene, job.name)}
    for name, content in files.items():
        (here / name).write_text(content)
    program = "liggghts" if job.code == "liggghts" else "lmp"
    started = time.time()
    try:
        command = [program, "-in", "in.silo", "-log", "none"]
        told = subprocess.run(command, cwd=here, capture_output=True, text=True, timeout=deadline - started)
    except subprocess.TimeoutExpired:
        return
    if told.returncode:
        raise SystemExit(f"{program} in {here}: {(told.stdout + told.stderr)[-800:]}")
    counts = pd.read_csv(here / "left.txt", sep=" ", skiprows=1, names=["time", "left"])
    mass, seconds = job.scene.grains.mass, time.time() - started
    theirs, ours = (flow(one, mass, len(packing), job.window) for one in (counts, by_labbook(job, packing)))
    found = {
        "code": job.code, "law": job.scene.contact.model_dump(mode="json"), "point": job.point, "seed": job.seed,
        "dt": job.dt, "ours": ours, "theirs": theirs, "seconds": seconds, "packing": job.packing.name,
    }  # fmt: skip
    done.write_text(json.dumps(found))
    shutil.rmtree(here)
    print(f"{job.code}, {job.point}, {job.dt * 1e6:g} us, seed {job.seed}: {theirs * 1e3:.2f} g/s, "
          f"labbook {ours * 1e3:.2f}; {seconds:.0f} s", flush=True)  # fmt: skip


def run(said: argparse.Namespace) -> None:
    """Make what is missing, as many at once as asked for."""
    deadline = time.time() + said.until
    dt = None if said.dt is None else 1e-6 * said.dt
    found = list(jobs(labbook.load(said.study), labbook.Lab(said.lab, said.backend), dt, said.outlets))
    with ThreadPoolExecutor(said.jobs) as pool:
        for _ in pool.map(lambda job: discharge(job, said.out, deadline), found):
            pass


def table(said: argparse.Namespace) -> None:
    """Compare, print and write."""
    rows = pd.DataFrame([json.loads(path.read_text()) for path in sorted(said.folder.glob("*.json"))])
    found = []
    keys = ["code", "point", "dt"]
    for _, group in rows.groupby(keys):
        found.append({**{key: group[key].iloc[0] for key in keys}, **compared(group)})
    shown = pd.DataFrame(found)
    print(shown.to_string(index=False))
    if said.out:
        told = {"hardware": hardware(), "points": found, "runs": rows.to_dict("records")}
        said.out.write_text(json.dumps(told, indent=1, default=float))


def compared(group: pd.DataFrame) -> Mapping[str, float | int | str]:
    """Flow rates [g/s] with standard errors, their difference (theirs over ours, paired by bed, by logarithms) with its
    90 % interval, and what two one-sided tests say of it."""
    ours, theirs = group["ours"].to_numpy() * 1e3, group["theirs"].to_numpy() * 1e3
    n = len(group)
    told: dict[str, float | int | str] = {"beds": n, "ours": float(ours.mean()), "theirs": float(theirs.mean())}
    if n < 2:
        return told
    found = tost(np.log(ours), np.log(theirs), MARGIN, paired=True)
    return told | {
        "ours_error": float(ours.std(ddof=1)) / math.sqrt(n),
        "theirs_error": float(theirs.std(ddof=1)) / math.sqrt(n),
        "difference": found.difference,
        "low": found.low,
        "high": found.high,
        "power": found.power,
        "finding": found.finding,
        "needed": replicates_needed(found, n) or 0,
    }


def main() -> None:
    """Do one of the two."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = words.add_subparsers(required=True)
    one = verbs.add_parser("run", help="discharge what is missing")
    one.add_argument("study", type=Path)
    one.add_argument("--lab", type=Path, required=True)
    one.add_argument("--out", type=Path, required=True)
    one.add_argument("--backend", default="numba", help="whose packings")
    one.add_argument("--dt", type=float, help="step [us]; that of the study if not given")
    one.add_argument("--outlets", type=float, nargs="*", default=(), help="only these [mm]")
    one.add_argument("--jobs", type=int, default=1, help="how many at once")
    one.add_argument("--until", type=float, default=1e6, help="seconds after which no more is done")
    one.set_defaults(do=run)
    two = verbs.add_parser("table", help="compare what is there")
    two.add_argument("folder", type=Path)
    two.add_argument("--out", type=Path)
    two.set_defaults(do=table)
    said = words.parse_args()
    said.do(said)


if __name__ == "__main__":
    main()
