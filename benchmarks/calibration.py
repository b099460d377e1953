"""The calibration that ships, in pieces: runs of each scene as a CSV, and the calibration from these CSVs.

    python benchmarks/calibration.py run accuracy-hopper --lab LAB --backend warp --device cuda:0 --out FOLDER
    python benchmarks/calibration.py entries FOLDER --out labbook/accuracy/calibration.json

`run` makes one scene after another, and writes FOLDER/STUDY-SCENE.csv as soon as all runs of a scene are finished: runs
that end first flow fast, so that a part of them is a biased sample. Scenes with a file are skipped: a campaign may go
on another machine, and several may share FOLDER, each with `--scenes` of its own. `labbook pilot` does the same in one
go, with the runs in a lab.

Columns: `setting` is the number of the point within its scene, `bed` what runs from one packing have in common. W is
empty for runs that do not count.
"""  # fmt: skip

import argparse
import csv
import math
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import labbook
from labbook.accuracy import write
from labbook.accuracy.regression import Observation, curved
from labbook.results.calibrating import are_mixed, effects_of_scene, flow_and_filling
from labbook.study import Point, Study

STUDIES = Path(__file__).parents[1] / "studies"
NUMERICS = ("numerics.", "fill.numerics.")
COLUMNS = ("setting", "seed", "bed", "outcome", "W_g_per_s")


def scenes(study: Study) -> list[list[Point]]:
    """Points of a study by what they have beside numerics, in the order of the study."""
    by_scene: dict[str, list[Point]] = defaultdict(list)
    for point in study.points:
        by_scene[repr([pair for pair in point.at.items() if not pair[0].startswith(NUMERICS)])].append(point)
    return list(by_scene.values())


def run(args: argparse.Namespace) -> None:
    """Make the scenes that have no file yet."""
    args.out.mkdir(parents=True, exist_ok=True)
    lab = labbook.Lab(args.lab, args.backend, args.device)
    for name in args.names:
        study = labbook.load(STUDIES / f"{name}.yaml")
        for number, points in enumerate(scenes(study), 1):
            path, begun = args.out / f"{name}-{number}.csv", time.time()
            if path.exists() or (args.scenes and number not in args.scenes):
                continue
            part = replace(study, points=tuple(points))
            if lab.run(part, progress=False).stopped:
                print(f"{name}, scene {number}: stopped; the same command goes on", flush=True)
                return
            rows = list(finished(lab.results(part, progress=False), points))
            unfinished = path.with_suffix(".part")
            with unfinished.open("w", newline="", encoding="utf-8") as file:
                csv.writer(file).writerows([COLUMNS, *rows])
            unfinished.replace(path)
            print(f"{path.name}: {len(rows)} runs, {time.time() - begun:.0f} s", flush=True)


def finished(results: labbook.Results, points: Sequence[Point]) -> Iterator[tuple[object, ...]]:
    """Rows of COLUMNS of every run."""
    settings = {point.index: number for number, point in enumerate(points)}
    for result in results.points:
        for made in result.runs:
            measured = made.measured.get("flow_rate")
            counts = made.counted and measured is not None and math.isfinite(measured.value)
            rate = f"{1e3 * measured.value:.6g}" if counts and measured is not None else ""
            yield settings[result.point.index], made.seed, made.packing_key[:12], made.outcome, rate


def observed(path: Path, points: Sequence[Point]) -> list[Observation]:
    """Runs of a scene that count."""
    numerics = [(flow_and_filling(point), are_mixed(point)) for point in points]
    runs = []
    with path.open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            if row["W_g_per_s"]:
                (flow, filled), mixed = numerics[int(row["setting"])]
                rate = float(row["W_g_per_s"])
                runs.append(Observation(row["bed"], filled.overlap, flow.overlap, flow.step, rate, *mixed))
    return runs


def entries(args: argparse.Namespace) -> None:
    """Write the calibration from the files of a folder. Curvature is tested over all scenes of a study together."""
    effects = []
    for path in sorted(STUDIES.glob("accuracy-*.yaml")):
        files = {number: args.folder / f"{path.stem}-{number}.csv" for number in range(1, 100)}
        files = {number: file for number, file in files.items() if file.exists()}
        if not files:
            continue
        every = scenes(labbook.load(path))
        parts = [
            (observed(file, every[n - 1]), [flow_and_filling(p) for p in every[n - 1]]) for n, file in files.items()
        ]
        source = f"{path.stem}, {sum(len(runs) for runs, _ in parts)} runs, {datetime.now(UTC):%Y-%m-%d}"
        bends = curved([effects_of_scene(runs, numerics, source)[0].curvature_p for runs, numerics in parts])
        for (runs, numerics), bend, number in zip(parts, bends, files, strict=True):
            slopes, entry = effects_of_scene(runs, numerics, source, bend)
            effects.append(entry)
            here = entry.here
            print(
                f"{path.stem}-{number}: {here.law} version {here.version}, D/d {here.ratio:.3g}, friction "
                f"{here.friction:g}, e {here.restitution:g}, rolling {here.rolling:g}: {len(runs)} runs; slopes "
                + ", ".join(f"{v:.2f} ± {math.sqrt(slopes.covariance[k, k]):.2f}" for k, v in enumerate(slopes.values))
                + (f"; in mixed {100 * slopes.mixed[0]:+.2f} %" if slopes.mixed else "")
                + ("; curved" if bend else "")
            )
    write(args.out, effects)


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = parser.add_subparsers(required=True)
    verb = verbs.add_parser("run")
    verb.add_argument("names", nargs="+", help="studies, such as accuracy-hopper")
    verb.add_argument("--lab", type=Path, required=True)
    verb.add_argument("--backend", default="numba")
    verb.add_argument("--device", default="cpu")
    verb.add_argument("--out", type=Path, required=True)
    verb.add_argument("--scenes", type=int, nargs="+", help="numbers of the scenes to make; default: all")
    verb.set_defaults(do=run)
    verb = verbs.add_parser("entries")
    verb.add_argument("folder", type=Path)
    verb.add_argument("--out", type=Path, required=True)
    verb.set_defaults(do=entries)
    args = parser.parse_args()
    args.do(args)


if __name__ == "__main__":
    main()
