"""Flow rates of LIGGGHTS and LAMMPS from labbook's packings, beside those of the laws named after them.

Takes any study of spheres in any container of planes, strips and frustums, and the packings that its lab holds. Every
packing is discharged by the other code and by labbook (`numba`, double), with the same law, parameters and time step.
Both begin without friction springs, since data files hold none. The flow rate W is that between the same parts of the
mass. The result is the difference code - labbook, paired by packing, with its 90 % interval and the verdict of two
one-sided tests. Needs Debian's packages liggghts and lammps.

    labbook run STUDY --lab LAB                  # makes the packings; may be stopped once they are there
    python benchmarks/peers/silo.py run STUDY --lab LAB --out FOLDER --codes liggghts lammps
    python benchmarks/peers/silo.py table FOLDER --out silo.json

`--codes` discharges every point by the laws of these codes, with the parameters of the study's own law. Without it only
points that name a code's law are run, by that code. `run` may be stopped at any time and be called again: finished runs
are kept. LIGGGHTS refuses Young's moduli below 5 MPa, and gets inclined and round walls as meshes (`decks.py`).
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
from decks import Unsupported, check, deck, law_of

import labbook
from labbook.backend import load
from labbook.backend.machine import hardware
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Crossing
from labbook.filling.opening import start_of_discharge
from labbook.lab.packings import read_packing
from labbook.plan.demand import Demand, PointDemand
from labbook.scene import HertzLammps, HertzLiggghts, Scene
from labbook.scene.bodies import masses
from labbook.scene.packing import Packing
from labbook.stats.equivalence import replicates_needed, tost

MARGIN = 0.02  # within which flow rates count as the same
EVERY = 1e-4  # s between two measurements of the mass that is left
PIECE = 5_000  # steps after which it is checked whether the window has passed
STALL = 0.5  # s without a grain leaving, after which a silo is clogged
LATE = 2.0  # times labbook's duration, after which a code's silo is clogged
PROGRAMS = {"liggghts": "liggghts", "lammps": "lmp"}

TAIL = """
region above block INF INF INF INF {plane} INF{units}
variable left equal mass(all,above)
variable now equal step*dt
fix mass_left all print {every} "${{now}} ${{left}}" file left.txt screen no title "time left"
thermo 100000
thermo_modify lost ignore
label again
run {piece}
if "${{left}} > {least} && ${{now}} < {latest}" then "jump SELF again"
"""


@dataclass(frozen=True)
class Job:
    """One discharge of a packing, by another code and by labbook, at the same step [s]."""

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
        """Name of its folder."""
        text = json.dumps([self.scene.model_dump(mode="json"), self.packing.name, self.dt], sort_keys=True)
        return f"{self.code}-{hashlib.sha256(text.encode()).hexdigest()[:16]}"


def jobs(
    study: labbook.Study,
    lab: labbook.Lab,
    dt: float | None,
    outlets: Sequence[float] = (),
    codes: Sequence[str] = (),
) -> Iterator[Job]:
    """The discharges of a study whose packings are in the lab, in the order of seeds.

    Args:
        dt: time step [s]; None: that of the study.
        outlets: only outlets of these widths [mm]; empty: all.
        codes: codes by whose law every point is discharged; empty: those whose law a point names.

    Raises:
        Unsupported: a code of `codes` cannot represent a scene.
    """
    can = load(lab.backend).capabilities
    for seed in range(1, study.replicates + 1):
        for point in study.points:
            if outlets and not any(_is_outlet(point.scene, 1e-3 * outlet) for outlet in outlets):
                continue
            shared = PointDemand(study, point)
            packing = lab.lab_folder.packing(Demand(shared, seed, False).keys(can).packing)
            if not packing.exists():
                continue
            for code, scene in discharged(point.scene, codes):
                window = (study.window.start, study.window.end)
                yield Job(code, scene, shared.closed, packing, seed, dt or point.numerics.dt, window, point.label)


def discharged(scene: Scene, codes: Sequence[str]) -> Iterator[tuple[str, Scene]]:
    """Codes that discharge a scene, and the scene with the law of each.

    Raises:
        Unsupported: a code of `codes` cannot represent the scene.
    """
    if not codes:
        code = {HertzLiggghts: "liggghts", HertzLammps: "lammps"}.get(type(scene.contact))
        try:
            if code is not None:
                check(code, scene)
                yield code, scene
        except Unsupported as reason:
            print(f"left out: {reason}", flush=True)
    for code in codes:
        changed = scene.model_copy(update={"contact": law_of(code, scene.contact)})
        check(code, changed)
        yield code, changed


def _is_outlet(scene: Scene, width: float) -> bool:
    return any(math.isclose(outlet.width, width) for outlet in scene.container.outlets)


def script(job: Job, packing: Packing, latest: float) -> tuple[str, dict[str, str]]:
    """Input of the code for a discharge that ends at `latest` [s], and other files that it needs by name."""
    text, files = deck(job.code, job.scene, packing, job.dt)
    mass = np.broadcast_to(masses(job.scene.grains, packing), len(packing))
    tail = TAIL.format(
        plane=job.scene.container.outlet_plane,
        units=" units box" if job.code == "liggghts" else "",
        every=max(1, round(EVERY / job.dt)),
        piece=PIECE,
        least=(1 - job.window[1]) * mass.sum() - 10 * mass.mean(),
        latest=latest,
    )
    return text + tail, files


def flow(left: pd.DataFrame, mass: float, window: tuple[float, float]) -> float:
    """Flow rate [kg/s] between two parts of the mass, NaN if the second was not reached.

    Args:
        left: columns `time` [s] and `left` [kg], the mass that has not left; times are interpolated.
        mass: of all grains [kg].
        window: parts of the mass, from 0 to 1.
    """
    gone = np.maximum.accumulate(mass - left["left"].to_numpy())
    if gone[-1] < window[1] * mass:
        return math.nan
    keep = np.r_[True, np.diff(gone) > 0]
    ends = np.interp(np.array(window) * mass, gone[keep], left["time"].to_numpy()[keep])
    return mass * (window[1] - window[0]) / float(ends[1] - ends[0])


def by_labbook(job: Job, packing: Packing) -> pd.DataFrame:
    """The same columns by labbook, from the same packing without its friction springs."""
    bare = {name: np.zeros((0, *shape), kind) for name, (shape, kind) in _SPRINGS.items()}
    backend, numerics = load("numba"), Numerics(dt=job.dt, steps_per_beat=1000, precision="double")
    assert job.scene.container.outlet_plane is not None
    outlet = Crossing(job.scene.container.outlet_plane)
    ensemble = backend.open(backend.specialise(job.scene, numerics, [outlet]), 1, "cpu")
    start = start_of_discharge(replace(packing, **bare), job.closed, job.scene)
    ensemble.admit(job.scene, numerics, start)
    assert start.ids is not None
    mass = dict(zip(start.ids.tolist(), np.broadcast_to(masses(job.scene.grains, start), len(start)), strict=True))
    total = sum(mass.values())
    rows, gone, last, now = [(0.0, total)], 0.0, 0.0, 0.0
    while gone < job.window[1] * total + 10 * total / len(mass) and now < last + STALL:
        ensemble.advance(10)
        now += 10 * numerics.steps_per_beat * job.dt
        crossed = ensemble.drain()[outlet]
        for order in np.argsort(crossed["time"], kind="stable"):
            gone += mass[int(crossed["id"][order])]
            last = float(crossed["time"][order])
            rows.append((last, total - gone))
    ensemble.close()
    return pd.DataFrame(rows, columns=["time", "left"])


_SPRINGS = {
    "pairs": ((2,), np.int64), "pair_spring": ((3,), float), "wall_grain": ((), np.int64), "wall_name": ((), "U40"),
    "wall_spring": ((3,), float), "wall_part": ((), np.int64),
}  # fmt: skip


def discharge(job: Job, folder: Path, deadline: float) -> None:
    """Run a job and leave its result in `folder`; nothing if the deadline comes first."""
    done = folder / f"{job.name}.json"
    if done.exists() or time.time() > deadline:
        return
    here = folder / job.name
    shutil.rmtree(here, ignore_errors=True)
    here.mkdir(parents=True)
    _, packing = read_packing(job.packing)
    mass = float(np.sum(np.broadcast_to(masses(job.scene.grains, packing), len(packing))))
    own = by_labbook(job, packing)
    text, files = script(job, packing, LATE * float(own["time"].iloc[-1]))
    for name, content in {**files, "in.silo": text}.items():
        (here / name).write_text(content)
    program = PROGRAMS[job.code]
    started = time.time()
    try:
        command = [program, "-in", "in.silo", "-log", "none"]
        ended = subprocess.run(
            command, cwd=here, capture_output=True, text=True, errors="replace", timeout=deadline - started
        )
    except subprocess.TimeoutExpired:
        return
    if ended.returncode:
        raise SystemExit(f"{program} in {here}: {(ended.stdout + ended.stderr)[-800:]}")
    left = pd.read_csv(here / "left.txt", sep=" ", skiprows=1, names=["time", "left"])
    seconds = time.time() - started
    theirs, ours = (flow(table, mass, job.window) for table in (left, own))
    result = {
        "code": job.code, "law": job.scene.contact.model_dump(mode="json"), "point": job.point, "seed": job.seed,
        "dt": job.dt, "ours": ours, "theirs": theirs, "seconds": seconds, "packing": job.packing.name,
    }  # fmt: skip
    done.write_text(json.dumps(result))
    shutil.rmtree(here)
    print(f"{job.code}, {job.point}, {job.dt * 1e6:g} us, seed {job.seed}: {theirs * 1e3:.2f} g/s, "
          f"labbook {ours * 1e3:.2f}; {seconds:.0f} s", flush=True)  # fmt: skip


def run(said: argparse.Namespace) -> None:
    """Make what is missing, as many at once as asked for."""
    deadline = time.time() + said.until
    dt = None if said.dt is None else 1e-6 * said.dt
    lab = labbook.Lab(said.lab, said.backend)
    try:
        work = list(jobs(labbook.load(said.study), lab, dt, said.outlets, said.codes))
    except Unsupported as reason:
        raise SystemExit(str(reason)) from None
    if not work:
        raise SystemExit(f"{said.lab} holds no packing of {said.study} for a code: run the study, or name --codes")
    with ThreadPoolExecutor(said.jobs) as pool:
        for _ in pool.map(lambda job: discharge(job, said.out, deadline), work):
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
    90 % interval, and what two one-sided tests say of it. Pairs with a clogged silo are left out and counted."""
    ours, theirs = (group[name].to_numpy(float) * 1e3 for name in ("ours", "theirs"))
    flowing = np.isfinite(ours) & np.isfinite(theirs)
    ours, theirs, n = ours[flowing], theirs[flowing], int(flowing.sum())
    told: dict[str, float | int | str] = {
        "beds": n,
        "clogged": len(group) - n,
        "ours": float(ours.mean()) if n else math.nan,
        "theirs": float(theirs.mean()) if n else math.nan,
    }
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
    one.add_argument("--codes", nargs="*", choices=sorted(PROGRAMS), default=(), help="by whose law every point is run")
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
