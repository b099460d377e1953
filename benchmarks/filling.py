"""Do beds of a cheaper start flow and stand as beds of a rain, and what do their fillings cost?

Small beds of several scenes are made by both starts and discharged. Of each scene: flow rate W, solid fraction of the
middle of the bed, and coordination number (contacts between grains only), with their difference, its 90 % interval and
the verdict of two one-sided tests within a margin (0.5 %, of rods 3 %); and the grain-steps of fillings and discharges.

    python benchmarks/filling.py --lab LAB --beds 1500 --backend warp --device cuda:0 --out FILE
    python benchmarks/filling.py --lab LAB --beds 1500 --scene flat --start rain   # a part of the runs
    python benchmarks/filling.py --lab LAB --beds 20 --start rain --start dense --start dense:1e-2

Runs that the lab has are not made again: a command that was stopped (Ctrl-C) goes on when it is repeated, and parts may
be made one after another. The figures of a scene are worked out once all of its starts have runs, and added to FILE.
A start is a `fill.kind`, with `fill.settled_below` after a colon; the others are held against the first.
"""

import argparse
import json
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from labbook import Lab, Study, load
from labbook.backend.machine import hardware
from labbook.lab.packings import read_packing
from labbook.lab.records import RunRecord
from labbook.results.points import FLOW_RATE
from labbook.scene import Bodies, Grains, Packing, Scene, Spherocylinders
from labbook.scene.orientation import axes, distances
from labbook.stats.equivalence import tost

STUDY = """
name: filling-{name}
about: Beds of one start, and their discharge
grains: {{{grains}, diameter: 3 mm, density: 2500 kg/m^3}}
contact: {{law: hertz-mindlin, shear_modulus: 2 MPa, poisson_ratio: 0.25, friction: 0.5, rolling_friction: 0.01,
           restitution: 0.3}}
container: {{{container}, height: 100 d}}
fill: {{{fill}}}
numerics: {{precision: mixed}}
replicates: {beds}
measure: [flow_rate]
"""
_SPHERES = "shape: sphere, count: 1500"
SCENES = {
    "flat": (_SPHERES, "kind: wedge-hopper, width: 12 d, thickness: 4 d, angle: 90 deg, orifice: 6 d"),
    "wedge": (_SPHERES, "kind: wedge-hopper, width: 12 d, thickness: 4 d, angle: 60 deg, orifice: 6 d"),
    "cone": (_SPHERES, "kind: conical-silo, diameter: 10 d, angle: 45 deg, orifice: 6 d"),
    "mixture": (
        "shape: sphere, count: 2000, kinds: [{name: large, share: 0.5}, {name: small, share: 0.5, diameter: 2 mm}]",
        "kind: wedge-hopper, width: 12 d, thickness: 4 d, angle: 60 deg, orifice: 6 d",
    ),
    "layer": (
        "shape: sphere, count: 1200",
        "kind: wedge-hopper, width: 24 d, thickness: 1.01 d, angle: 90 deg, orifice: 8 d",
    ),
    "rods": (
        "shape: spherocylinder, length: 9 mm, count: 600",
        "kind: wedge-hopper, width: 15 d, thickness: 6 d, angle: 60 deg, orifice: 9 d",
    ),
}
"""Grains and container of each scene."""
MARGIN, OF_RODS = 0.005, 0.03
"""Differences that count as none, relative."""
MIDDLE = 0.2, 0.7
"""Parts of the mass below the levels between which the solid fraction is taken."""
SAVED = 600.0
"""Seconds between two checkpoints: beds take less."""


def study(scene: str, start: str, beds: int, folder: Path) -> Study:
    """The study of one scene and start, `kind` or `kind:settled_below`, whose file is written to `folder`."""
    grains, container = SCENES[scene]
    kind, _, below = start.partition(":")
    fill = f"kind: {kind}" + (f", settled_below: {below}" if below else "")
    name = f"{scene}-{kind}" + (f"-{below}" if below else "")
    path = folder / f"{name}.yaml"
    path.write_text(STUDY.format(name=name, grains=grains, container=container, fill=fill, beds=beds), encoding="utf-8")
    return load(path)


def coordination(grains: Grains, packing: Packing) -> float:
    """Mean number of grains that a grain touches."""
    from scipy.spatial import KDTree

    radius = Bodies.of(grains, packing).radius
    reach = 2 * (radius.max() + grains.overhang)
    i, j = KDTree(packing.x).query_pairs(reach, output_type="ndarray").T
    branch = packing.x[i] - packing.x[j]
    if isinstance(grains, Spherocylinders):
        assert packing.q is not None
        a = axes(packing.q)
        apart = distances(branch, a[i], a[j], grains.half_length)
    else:
        apart = np.linalg.norm(branch, axis=1)
    return 2 * int(np.sum(apart < radius[i] + radius[j])) / len(packing.x)


def solid_fraction(scene: Scene, packing: Packing) -> float:
    """Volume of grains over that of the container between two levels, below which lie the parts MIDDLE of the mass."""
    z = packing.x[:, 2]
    order = np.argsort(z)
    mass = np.broadcast_to(Bodies.of(scene.grains, packing).mass, len(z))[order]
    below = (np.cumsum(mass) - mass / 2) / mass.sum()
    low, high = (scene.container.volume_below(float(np.interp(part, below, z[order]))) for part in MIDDLE)
    assert low is not None
    assert high is not None
    return (MIDDLE[1] - MIDDLE[0]) * scene.grains.count * scene.grains.volume / (high - low)


def measured(study: Study, lab: Lab) -> dict[str, np.ndarray]:
    """Of every finished run that flowed: W [kg/s], solid fraction, coordination number, and grain-steps of filling and
    discharge."""
    (point,) = lab.results(study, progress=False).points
    rows = []
    for run in point.runs:
        rate = run.measured.get(FLOW_RATE)
        if rate is None or not np.isfinite(rate.value):
            continue
        record, packing = read_packing(lab.lab_folder.packing(run.packing_key))
        steps = [
            sum(session.grain_steps for session in sessions)
            for sessions in (record.sessions, RunRecord.read(lab.lab_folder.run(run.run_key)).sessions)
        ]
        scene = point.point.scene
        rows.append((rate.value, solid_fraction(scene, packing), coordination(scene.grains, packing), *steps))
    names = ("flow_rate", "solid_fraction", "coordination", "filling", "discharge")
    return dict(zip(names, np.array(rows).reshape(-1, len(names)).T, strict=True))


def compared(first: dict[str, np.ndarray], second: dict[str, np.ndarray], margin: float) -> dict[str, Any]:
    """Differences of the second start from the first, relative to the first, and what a filling costs."""
    figures: dict[str, Any] = {"beds": len(second["flow_rate"])}
    for name in ("flow_rate", "solid_fraction", "coordination"):
        mean = float(first[name].mean())
        test = tost(first[name], second[name], margin * mean).relative_to(mean)
        figures[name] = {
            "first": mean,
            "second": float(second[name].mean()),
            "scatter": [float(start[name].std(ddof=1) / start[name].mean()) for start in (first, second)],
            "difference": test.difference,
            "interval_90": [test.low, test.high],
            "margin": margin,
            "finding": test.finding,
        }
    figures["filling_over_discharge"] = [
        float(start["filling"].mean() / start["discharge"].mean()) for start in (first, second)
    ]
    figures["filling_over_that_of_first"] = float(second["filling"].mean() / first["filling"].mean())
    return figures


def main(arguments: Sequence[str] | None = None) -> None:
    """Make the runs, compare the starts, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lab", type=Path, required=True, help="Folder of the runs.")
    parser.add_argument("--beds", type=int, default=8, help="Beds of each scene and start.")
    parser.add_argument("--scene", action="append", choices=tuple(SCENES), help="Only these scenes.")
    parser.add_argument("--start", action="append", help="Only these starts (default: rain and dense).")
    parser.add_argument("--backend", default="numba")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--out", type=Path, help="File to which the figures of each scene are added.")
    args = parser.parse_args(arguments)
    starts, lab = args.start or ["rain", "dense"], Lab(args.lab, args.backend, args.device)
    args.lab.mkdir(parents=True, exist_ok=True)
    for scene in args.scene or SCENES:
        studies = [study(scene, start, args.beds, args.lab) for start in starts]
        for each in studies:
            if lab.run(each, checkpoint_every=SAVED).stopped:
                raise SystemExit("stopped: the same command goes on from here")
        beds = [measured(each, lab) for each in studies]
        margin = OF_RODS if scene == "rods" else MARGIN
        figures = {start: compared(beds[0], bed, margin) for start, bed in zip(starts[1:], beds[1:], strict=True)}
        if not figures:
            continue
        print(json.dumps({scene: figures}, indent=2), flush=True)
        if args.out:
            _add(args.out, scene, {"first": starts[0], "starts": figures, "study": STUDY}, args)


def _add(path: Path, scene: str, figures: dict[str, Any], args: argparse.Namespace) -> None:
    """Add the figures of a scene to the file at `path`."""
    results: dict[str, Any] = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {"scenes": {}}
    results |= {
        "date": f"{datetime.now(UTC):%Y-%m-%d}",
        "hardware": hardware(),
        "backend": args.backend,
        "device": args.device,
    }
    results["scenes"][scene] = figures
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
