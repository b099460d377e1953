"""Flow rates and profiles of Fan's three studies against the start of the window, by each contact law.

    python benchmarks/fan_window.py run --lab LAB --backend warp --device cuda:0 --out FOLDER

`run` may be interrupted and called again: finished runs stay in the lab, and candidates with a file in FOLDER are
skipped. It writes a file of some 200 kB for each law and rolling. No run is made for a start of the window: each start
is an evaluation of the same runs.
"""

import argparse
import gzip
import itertools
import json
import math
import multiprocessing
import os
import time
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import labbook
from labbook.backend.machine import hardware
from labbook.fit import Context, FitError
from labbook.lab.runs import open_run
from labbook.measure.outlet import DEFINITIONS, ProfileAcross, outlet_profile
from labbook.measure.series import mean_mass
from labbook.measure.steady import outflow
from labbook.papers.fan2023 import profiles
from labbook.results.series import PACKING_FRACTION, context

LAWS = ("hertz-printed", "hertz-mindlin", "hertz-liggghts", "hertz-lammps")
ROLLING = ("full", "rolling")
STARTS = (0.0, 0.02, 0.05, 0.10, 0.15, 0.20)
END = 0.6
STEPS = np.arange(66) / 100
"""Discharged fractions whose times are kept, so that other starts can be evaluated later."""
STUDIES = Path(__file__).parents[1] / "studies"
NAMES = ("fan2023-flat-column", "fan2023-hopper-angle", "fan2023-eccentricity")
DIGITS = 5
DRAWS = 100
"""Draws of the bootstrap of profiles: a fourth of what a report takes, for standard errors only."""
OUTLET = ("v_c", "phi_c", "phi_max", "direct", "centred", "printed", "eccentric")


@dataclass(frozen=True)
class Window:
    """A window by discharged fraction (`labbook.measure.Window`)."""

    start: float
    end: float = END
    timed: bool = False


def studies(
    law: str, rolling: str, replicates: int, count: float = 1.0, names: Sequence[str] = NAMES
) -> Iterable[labbook.Study]:
    """The studies by this law, in mixed precision, without recordings; `count` scales the number of grains."""
    own = {"contact.law": law, "contact.rolling": rolling, "numerics.precision": "mixed", "fill.max_time": "6 s",
           "replicates": replicates, "record": None, "reference": None}  # fmt: skip
    for name in names:
        study = labbook.load(STUDIES / f"{name}.yaml")
        if count != 1.0:
            points = [{**point, "grains.count": round(point["grains.count"] * count)}
                      for point in study.stated.get("points") or []]  # fmt: skip
            study = study.change({"points": points} if points else {"grains.count": round(3000 * count)})
        yield study.change(own)


@dataclass(frozen=True)
class Task:
    """Evaluation of a series from one start of the window: folders of the runs of each point, by seed."""

    start: float
    folders: Sequence[Mapping[int, Path]]
    about: Context


def evaluated(task: Task) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Evaluate stored runs, and fit the profiles along their outlets by each definition.

    Returns:
        For each point the W [kg/s] of its seeds (NaN for too few grains), with the first start also the times [s] at
        STEPS; for each definition the parameters of profiles and the numbers of each outlet, with standard errors.
    """
    points, seeds = [], {name: [] for name in DEFINITIONS}
    for folders in task.folders:
        W, times, found = [], [], []
        for folder in folders.values():
            _, run = open_run(folder)
            flow, crossed = outflow(run, Window(task.start))
            W.append(mean_mass(run) * flow.rate if flow is not None else math.nan)
            rows = np.ceil(STEPS * len(run.start)).astype(int)
            times.append([float(crossed[row]) if row < len(crossed) else math.nan for row in rows])
            if run.outcome != "clogged" and (profile := outlet_profile(run, Window(task.start))) is not None:
                found.append(profile.outlets(run.scene.grains.radius))
        points.append({"seeds": list(folders), "W": W} | ({"times": times} if task.start == STARTS[0] else {}))
        for name in DEFINITIONS:
            if seen := [each[name] for each in found if each[name].seen]:
                seeds[name].append(seen)
    return points, [{"definition": name} | of_profiles(each, task.about) for name, each in seeds.items()]


def of_profiles(seeds: Sequence[Sequence[ProfileAcross]], about: Context) -> dict[str, Any]:
    """Parameters of the profiles of a series, and numbers of each outlet, each with its standard error."""
    profiles.DRAWS = DRAWS
    try:
        fit = profiles.fit_profiles(seeds, about)
    except FitError as reason:
        return {"problem": str(reason)}
    outlets = [{"R": one.profile.R} | {name: _pair(getattr(one, name)) for name in OUTLET} for one in fit.outlets]
    return {"parameters": {name: _pair(one) for name, one in fit.parameters.items()}, "outlets": outlets}


def _pair(number: Any) -> list[float]:
    return [number.value, number.error]


@dataclass(frozen=True, eq=False)
class Series:
    """A series of a study: where it is, its points, and its evaluations, one for each start."""

    study: str
    at: Mapping[str, Any]
    points: Sequence[Mapping[str, Any]]
    evaluations: Sequence["Future[tuple[list[dict[str, Any]], list[dict[str, Any]]]]"]

    def numbers(self) -> dict[str, Any]:
        """All of it, once the evaluations are done."""
        found = [evaluation.result() for evaluation in self.evaluations]
        of_points = [points for points, _ in found]
        points = [
            {**point, **of_points[0][place], "W": [each[place]["W"] for each in of_points]}
            for place, point in enumerate(self.points)
        ]
        return {"study": self.study, "at": self.at, "points": points, "profiles": [fits for _, fits in found]}


@dataclass(frozen=True, eq=False)
class Candidate:
    """A law with its rolling resistance: its series, and why runs failed."""

    law: str
    rolling: str
    series: Sequence[Series]
    failed: Sequence[str]

    @property
    def done(self) -> bool:
        """True once every evaluation has ended."""
        return all(evaluation.done() for series in self.series for evaluation in series.evaluations)

    def numbers(self) -> dict[str, Any]:
        """All of it, once the evaluations are done."""
        return {"law": self.law, "rolling": self.rolling, "starts": STARTS, "end": END, "hardware": hardware(),
                "failed": list(self.failed), "series": [one.numbers() for one in self.series]}  # fmt: skip


def made(law: str, rolling: str, said: argparse.Namespace, pool: ProcessPoolExecutor) -> Candidate:
    """Make the missing runs of a law, and start their evaluation in other processes."""
    lab, found, failed = labbook.Lab(said.lab, said.backend, said.device), [], []
    for study in studies(law, rolling, said.replicates, said.count, said.studies):
        started = time.time()
        failed += [f"{study.name}: {one}" for one in lab.run(study, progress=said.progress).failed]
        print(f"{law}, {rolling}, {study.name}: {time.time() - started:.0f} s of runs", flush=True)
        for series in lab.results(study.change({"fit": []}), progress=False).series:
            folders = [{run.seed: run.run.folder for run in one.runs if run.counted} for one in series.points]
            points = [
                {"D": one.orifice, "outcomes": dict(one.outcomes), "phi": phi.value if phi else None}
                for one in series.points
                for phi in [one.pooled.get(PACKING_FRACTION)]
            ]
            about = context(series.points)
            evaluations = [pool.submit(evaluated, Task(start, folders, about)) for start in STARTS]
            found.append(Series(study.name, dict(series.at), points, evaluations))
    return Candidate(law, rolling, found, failed)


def run(said: argparse.Namespace) -> None:
    """Run and evaluate every candidate; evaluations go on beside the runs of the next one."""
    said.out.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(said.processes, multiprocessing.get_context("spawn")) as pool:
        candidates: dict[Path, Candidate] = {}
        for law, rolling in itertools.product(said.laws, said.rolling):
            path = said.out / f"{law}-{rolling}.json.gz"
            if not path.exists():
                candidates[path] = made(law, rolling, said, pool)
            for path in [path for path, one in candidates.items() if one.done]:
                write(path, candidates.pop(path))
        for path, one in candidates.items():
            write(path, one)


def write(path: Path, one: Candidate) -> None:
    """Write all numbers of a candidate, once they are there."""
    with gzip.open(path, "wt") as file:
        json.dump(rounded(one.numbers()), file, separators=(",", ":"))
    print(f"wrote {path}", flush=True)


def rounded(value: Any) -> Any:
    """The same with numbers of DIGITS significant digits; None for NaN and infinities."""
    if isinstance(value, Mapping):
        return {key: rounded(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [rounded(one) for one in value]
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}") if np.isfinite(value) else None
    return value


def main() -> None:
    """Run, or print tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = parser.add_subparsers(required=True)
    verb = verbs.add_parser("run", help="run and evaluate what is missing")
    verb.add_argument("--lab", type=Path, required=True)
    verb.add_argument("--backend", default="numba")
    verb.add_argument("--device", default="cpu")
    verb.add_argument("--laws", nargs="+", default=LAWS, choices=LAWS)
    verb.add_argument("--rolling", nargs="+", default=ROLLING, choices=ROLLING)
    verb.add_argument("--studies", nargs="+", default=NAMES, choices=NAMES)
    verb.add_argument("--replicates", type=int, default=4)
    verb.add_argument("--count", type=float, default=1.0, help="part of the grains, for a trial")
    verb.add_argument("--processes", type=int, default=os.cpu_count())
    verb.add_argument("--progress", action="store_true")
    verb.add_argument("--out", type=Path, required=True, help="folder of the numbers")
    verb.set_defaults(do=run)
    said = parser.parse_args()
    said.do(said)


if __name__ == "__main__":
    main()
