"""Fan's hopper angles and eccentric outlets by each contact law, held against the numbers of the paper.

What is compared, and how a law is chosen, was written down before: docs/results/fan2023-laws.md.

    python benchmarks/fan_laws.py run --lab LAB --backend warp --device cuda:0
    python benchmarks/fan_laws.py table --lab LAB --backend warp --out fan-laws.json

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


def studies(law: str, rolling: str) -> tuple[labbook.Study, labbook.Study]:
    """Both studies by this law, without recordings; of the eccentric outlets the points of the paper's own hopper."""
    own = {"contact.law": law, "contact.rolling": rolling, "numerics.precision": "mixed"}
    angle = labbook.load(STUDIES / "fan2023-hopper-angle.yaml")
    gaps = labbook.load(STUDIES / "fan2023-eccentricity.yaml")
    narrow = [point for point in gaps.stated["points"] if "100" in str(point["container.width"])]
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
    found = gaps["points"].query("quantity == 'flow_rate'")
    flows = found.assign(outlet=(found["container.orifice"] * 1e3).round())
    for outlet, ratio in AT_WALL.items():
        here = flows[flows["outlet"] == outlet]
        wall, middle = here[here["container.gap"] == 0].iloc[0], here[here["container.gap"].isna()].iloc[0]
        value = wall["value"] / middle["value"]
        error = value * float(np.hypot(wall["error"] / wall["value"], middle["error"] / middle["value"]))
        yield f"W/W0, {outlet} mm", value, error, ratio


def run(said: argparse.Namespace) -> None:
    """Run what is missing of every law."""
    lab, started = labbook.Lab(said.lab, said.backend, said.device), time.time()
    for law, rolling in itertools.product(said.laws, said.rolling):
        for study in studies(law, rolling):
            lab.run(study, progress=said.progress)
            print(f"{law}, {rolling}, {study.name}: {time.time() - started:.0f} s", flush=True)


def table(said: argparse.Namespace) -> None:
    """Compare, print and write."""
    lab, rows = labbook.Lab(said.lab, said.backend), []
    for law, rolling in itertools.product(said.laws, said.rolling):
        for name, ours, error, paper in numbers(law, rolling, lab):
            pull = (ours - paper) / math.hypot(error, PART * paper)
            rows.append({"law": law, "rolling": rolling, "number": name, "ours": ours, "error": error, "paper": paper,
                         "pull": pull})  # fmt: skip
    found = pd.DataFrame(rows)
    wide = found.pivot(index="number", columns=["law", "rolling"], values="ours")
    print(wide.to_string(float_format="%.3f"))
    chi2 = found.assign(chi2=found["pull"] ** 2).groupby(["law", "rolling"], sort=False)["chi2"].sum()
    print(chi2.to_string(float_format="%.1f"))
    if said.out:
        sums = [{"law": law, "rolling": rolling, "chi2": value} for (law, rolling), value in chi2.items()]
        told = {"hardware": hardware(), "chi2": sums, "numbers": rows}
        said.out.write_text(json.dumps(told, indent=1, default=float))


def main() -> None:
    """Do one of the two."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = words.add_subparsers(required=True)
    for name, do in (("run", run), ("table", table)):
        verb = verbs.add_parser(name, help=do.__doc__)
        verb.add_argument("--lab", type=Path, required=True)
        verb.add_argument("--backend", default="numba")
        verb.add_argument("--device", default="cpu")
        verb.add_argument("--laws", nargs="+", default=LAWS, choices=LAWS)
        verb.add_argument("--rolling", nargs="+", default=ROLLING, choices=ROLLING)
        verb.add_argument("--progress", action="store_true")
        verb.add_argument("--out", type=Path)
        verb.set_defaults(do=do)
    said = words.parse_args()
    said.do(said)


if __name__ == "__main__":
    main()
