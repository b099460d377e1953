"""Fan's hopper angles and eccentric outlets by each contact law, held against the numbers of the paper.

What is compared, and how a law is chosen, was written down before: docs/results/fan2023-laws.md.

    python benchmarks/fan_laws.py run --lab LAB --backend warp --device cuda:0 --out FOLDER
    python benchmarks/fan_laws.py table FOLDER --out fan-laws.json

`run` may be cut off and called again. A seed is a bed: laws fill their own.
"""

import argparse
import itertools
import json
import math
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

import labbook
from labbook.backend.machine import hardware
from labbook.results.frames import frames

LAWS = ("hertz-mindlin", "hertz-printed", "hertz-liggghts", "hertz-lammps")
ROLLING = ("full", "rolling")
PART = 0.05  # of a number of the paper: what it leaves open
STUDIES = Path(__file__).parents[1] / "studies"
ANGLES = {15: (0.72, 2.81), 30: (0.65, 2.08), 55: (0.55, 1.61), 75: (0.55, 1.64), 90: (0.58, 1.66)}
"""Of angles [deg]: C by the density of the grains, gamma."""
GAPS = {0: 0.60, 6: 0.52}
"""C at gaps [mm]."""
AT_WALL = {18: 1.4, 60: 1.2}
"""W at the wall over that in the middle, of outlets [mm]."""
K = 1.55
CLEAR = 6
"""By how much chi2 must be larger for all other laws."""
UNDECIDED = ("hertz-printed", "full")


def studies(law: str, rolling: str) -> tuple[labbook.Study, labbook.Study]:
    """Both studies by this law, without recordings; of the eccentric outlets the points of the paper's own hopper."""
    own = {"contact.law": law, "contact.rolling": rolling, "numerics.precision": "mixed", "fill.max_time": "6 s"}
    angle = labbook.load(STUDIES / "fan2023-hopper-angle.yaml")
    gaps = labbook.load(STUDIES / "fan2023-eccentricity.yaml")
    narrow = [point for point in gaps.definition["points"] if "100" in str(point["container.width"])]
    rest = {"record": None, "reference": None}
    return angle.change({**own, **rest}), gaps.change({**own, **rest, "points": narrow})


def numbers(law: str, rolling: str, lab: labbook.Lab) -> Iterator[tuple[str, float, float, float]]:
    """What it is, ours, its standard error, the paper's."""
    angle, gaps = (frames(lab.results(study, progress=False)) for study in studies(law, rolling))
    found = angle["fits"].assign(at=np.degrees(angle["fits"]["container.angle"]).round())
    fits = found.set_index(["law", "parameter", "at"])[["value", "error"]]
    for at, (c, gamma) in ANGLES.items():
        yield f"C, {at} deg", *fits.loc["beverloo", "C_particle", at], c
        yield f"gamma, {at} deg", *fits.loc["outlet_crossings", "gamma", at], gamma
    yield "k, 90 deg", *fits.loc["beverloo", "k", 90], K
    found = gaps["fits"].assign(at=(gaps["fits"]["container.gap"] * 1e3).round())
    fits = found.set_index(["law", "parameter", "at"])[["value", "error"]]
    for at, c in GAPS.items():
        yield f"C, gap {at} mm", *fits.loc["beverloo", "C_particle", at], c
    points = gaps["points"]
    columns = [points[name].tolist() for name in ("quantity", "container.orifice", "container.gap", "value", "error")]
    flows = {
        (round(1e3 * outlet), "middle" if math.isnan(gap) else gap): (value, error)
        for quantity, outlet, gap, value, error in zip(*columns, strict=True)
        if quantity == "flow_rate"
    }
    for outlet, ratio in AT_WALL.items():
        (wall, its_error), (middle, error) = flows[outlet, 0.0], flows[outlet, "middle"]
        yield f"W/W0, {outlet} mm", wall / middle, wall / middle * math.hypot(its_error / wall, error / middle), ratio


def run(said: argparse.Namespace) -> None:
    """Run what is missing of every law, and write its numbers into the folder `out` as soon as they are there."""
    lab, started = labbook.Lab(said.lab, said.backend, said.device), time.time()
    said.out.mkdir(parents=True, exist_ok=True)
    for law, rolling in itertools.product(said.laws, said.rolling):
        for study in studies(law, rolling):
            if failed := lab.run(study, progress=said.progress).failed:
                raise SystemExit(f"{law}, {rolling} is out: {failed[0]}")
            print(f"{law}, {rolling}, {study.name}: {time.time() - started:.0f} s", flush=True)
        rows = []
        for name, ours, error, paper in numbers(law, rolling, lab):
            pull = (ours - paper) / math.hypot(error, PART * paper)
            rows.append({"law": law, "rolling": rolling, "number": name, "ours": ours, "error": error, "paper": paper,
                         "pull": pull})  # fmt: skip
        told = {"hardware": hardware(), "numbers": rows}
        (said.out / f"{law}-{rolling}.json").write_text(json.dumps(told, indent=1, default=float))


def choice(sums: dict[tuple[str, str], float]) -> tuple[str, str]:
    """Law and rolling that the criterion takes, of the chi2 of every law with every rolling."""
    best = [min((value, key) for key, value in sums.items() if key[0] == law) for law in {law for law, _ in sums}]
    (least, key), (second, _) = sorted(best)[:2]
    return key if second - least >= CLEAR else UNDECIDED


def judged(folder: Path) -> tuple[list[dict], dict[tuple[str, str], float]]:
    """All that `run` wrote, and the chi2 of every law with every rolling."""
    files = [json.loads(path.read_text()) for path in sorted(folder.glob("*.json"))]
    sums = {}
    for file in files:
        rows = file["numbers"]
        sums[rows[0]["law"], rows[0]["rolling"]] = math.fsum(row["pull"] ** 2 for row in rows)
    return files, sums


def table(said: argparse.Namespace) -> None:
    """Compare what `run` wrote, print, and write all of it."""
    files, sums = judged(said.folder)
    rows = [row for file in files for row in file["numbers"]]
    shown = pd.DataFrame(rows).pivot_table("ours", ["number", "paper"], ["law", "rolling"], sort=False)
    print(shown.to_string(float_format="%.3f"))
    for (law, rolling), value in sorted(sums.items(), key=lambda one: one[1]):
        print(f"chi2 of {law}, {rolling}: {value:.1f}")
    print("chosen:", ", ".join(choice(sums)))
    if said.out:
        chi2 = {", ".join(key): value for key, value in sums.items()}
        told = {"hardware": files[0]["hardware"], "chi2": chi2, "chosen": choice(sums), "numbers": rows}
        said.out.write_text(json.dumps(told, indent=1))


def main() -> None:
    """Do one of the two."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = words.add_subparsers(required=True)
    one = verbs.add_parser("run", help="run and evaluate what is missing")
    one.add_argument("--lab", type=Path, required=True)
    one.add_argument("--backend", default="numba")
    one.add_argument("--device", default="cpu")
    one.add_argument("--laws", nargs="+", default=LAWS, choices=LAWS)
    one.add_argument("--rolling", nargs="+", default=ROLLING, choices=ROLLING)
    one.add_argument("--progress", action="store_true")
    one.add_argument("--out", type=Path, required=True, help="folder of the numbers")
    one.set_defaults(do=run)
    two = verbs.add_parser("table", help="compare what is there")
    two.add_argument("folder", type=Path)
    two.add_argument("--out", type=Path)
    two.set_defaults(do=table)
    said = words.parse_args()
    said.do(said)


if __name__ == "__main__":
    main()
