"""Fan's three studies against the start of the window, by each contact law; and the laws ranked with the window free.

    python benchmarks/fan_window.py run --lab LAB --backend warp --device cuda:0 --out FOLDER
    python benchmarks/fan_window.py tables FOLDER

`run` may be interrupted and called again: finished runs stay in the lab, evaluations beside them, and candidates (a law
with its rolling resistance) with a file in FOLDER are skipped. The file of a candidate is written as soon as it is
evaluated; it has some 200 kB. No run is made for a start of the window: each start is an evaluation of the same runs.

`tables` prints tables in Markdown from these files. The criterion of the ranking was written down before its results:
docs/results/fan2023-laws.md.
"""

import argparse
import gzip
import itertools
import json
import math
import multiprocessing
import os
import resource
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from fan_laws import ANGLES, AT_WALL, CLEAR, GAPS, LAWS, PART, ROLLING, K

import labbook
from labbook.backend.machine import hardware
from labbook.fit import LAWS as FLOW_LAWS
from labbook.fit import Context, FitError
from labbook.fit.profile import minimise
from labbook.lab.evaluations import evaluated
from labbook.lab.runs import open_run
from labbook.measure.outlet import DEFINITIONS
from labbook.measure.series import crossings
from labbook.measure.starts import StartResult, WindowStarts
from labbook.papers.fan2023 import profiles
from labbook.papers.fan2023.laws import Saturation, centred_flow, eccentric_flow
from labbook.results.series import PACKING_FRACTION, context

STEPS = np.arange(66) / 100
"""Discharged fractions whose times are stored, so that other starts can be evaluated later."""
STUDIES = Path(__file__).parents[1] / "studies"
COLUMN, ANGLE, POSITION = NAMES = ("fan2023-flat-column", "fan2023-hopper-angle", "fan2023-eccentricity")
OUTLET = ("v_c", "phi_c", "phi_max", "direct", "centred", "printed", "eccentric")
DIGITS = 5
DRAWS = 100
"""Draws of the bootstrap of profiles: a fourth of what a report takes, for standard errors only."""
READINGS = ("weighted", "line", "origin")
COMMON = (0.0, 0.5, 0.9)
"""Common part of the variance that the paper leaves to the numbers of a group: the second; others are variants."""
DESCRIBED = 22.4
"""95 % of chi2 with 13 degrees of freedom."""
TABLE_2 = {15: (0.20, 2.81, 0.16, 0.79), 30: (0.32, 2.08, 0.19, 0.79), 55: (0.35, 1.61, 0.30, 0.78),
           75: (0.33, 1.64, 0.38, 0.78), 90: (0.39, 1.66, 0.39, 0.78)}  # fmt: skip
"""Of the paper: a, gamma, b, phi_inf by angle [deg]."""
TABLE_3 = {0: (-0.31, 1.46, 0.28, -0.13, 1.0, 0.32), 6: (-0.09, 1.3, 0.32, -0.02, 1.0, 0.44),
           12: (-0.06, 1.3, 0.37, -0.007, 1.0, 0.42), 18: (-0.04, 1.3, 0.40, 0.008, 1.0, 0.40),
           24: (-0.01, 1.3, 0.38, -0.002, 1.0, 0.43), 30: (-0.02, 1.3, 0.38, 0.002, 1.0, 0.41)}  # fmt: skip
"""Of the paper: delta, epsilon, sigma of v and of phi by gap [mm]."""
SATURATION = {0: (3.74, 0.18), 6: (5.34, 0.19), 12: (5.34, 0.19), 18: (5.34, 0.19), 24: (5.34, 0.19), 30: (5.34, 0.19)}
"""Of the paper, Fig. 13: tau_1, tau_2 [1/mm] by gap. It gives no phi_inf there; that of Table 2 at 90 deg is taken."""


# Runs and their evaluation


def studies(law: str, rolling: str, args: argparse.Namespace) -> Iterator[labbook.Study]:
    """The studies by this law, in mixed precision, without recordings, fits and references."""
    own = {"contact.law": law, "contact.rolling": rolling, "numerics.precision": "mixed", "fill.max_time": "6 s",
           "replicates": args.replicates, "record": None, "reference": None, "fit": []}  # fmt: skip
    for name in args.studies:
        study = labbook.load(STUDIES / f"{name}.yaml")
        points = [point for point in study.definition.get("points") or []
                  if args.wide or "100" in str(point["container.width"])]  # fmt: skip
        if args.count != 1.0:
            points = [{**point, "grains.count": round(point["grains.count"] * args.count)} for point in points]
        scaled = {} if points or args.count == 1.0 else {"grains.count": round(3000 * args.count)}
        yield study.change({**own, **scaled, **({"points": points} if points else {})})


def of_run(task: tuple[Path, Any]) -> tuple[list[StartResult], list[float]]:
    """Evaluate a stored run for all starts; the times [s] at STEPS."""
    folder, window = task
    _, data = open_run(folder)
    found = evaluated(folder, WindowStarts(), window, lambda: data)
    times, _ = crossings(data)
    rows = np.ceil(STEPS * len(data.start)).astype(int)
    starts = list(WindowStarts.of(found.evaluation, window)) if found.evaluation.arrays else []
    return starts, [float(times[row]) if row < len(times) else math.nan for row in rows]


def of_profiles(task: tuple[list, Context]) -> dict[str, Any]:
    """Parameters of the profiles of a series, and numbers of each outlet, each with its standard error."""
    seeds, about = task
    profiles.DRAWS = DRAWS
    try:
        fit = profiles.fit_profiles(seeds, about)
    except FitError as reason:
        return {"problem": str(reason)}
    outlets = [{"R": one.profile.R} | {name: _pair(getattr(one, name)) for name in OUTLET} for one in fit.outlets]
    return {"parameters": {name: _pair(one) for name, one in fit.parameters.items()}, "outlets": outlets}


def _pair(number: Any) -> list[float]:
    return [number.value, number.error]


def mapped(function: Any, tasks: Sequence[Any], processes: int) -> list[Any]:
    """Apply a function to tasks in other processes; what they lose, if they are killed, is made here, one by one."""
    done: dict[int, Any] = {}
    if processes > 1:
        pool = ProcessPoolExecutor(processes, multiprocessing.get_context("spawn"), max_tasks_per_child=50)
        try:
            with pool:
                workers = pool._processes  # their exit codes tell what killed them
                for place, found in enumerate(pool.map(function, tasks)):
                    done[place] = found
        except BrokenProcessPool:
            codes = [process.exitcode for process in list((workers or {}).values())]
            print(f"processes were lost (exit codes {codes}) after {len(done)} of {len(tasks)} tasks", flush=True)
    return [done[place] if place in done else function(task) for place, task in enumerate(tasks)]


def candidate(law: str, rolling: str, args: argparse.Namespace) -> dict[str, Any]:
    """Make the missing runs of a law, then evaluate them."""
    lab, series, failed = labbook.Lab(args.lab, args.backend, args.device), [], []
    for study in studies(law, rolling, args):
        started = time.time()
        failed += [f"{study.name}: {one}" for one in lab.run(study, progress=args.progress).failed]
        ran = time.time() - started
        found = lab.results(study, progress=False).series
        runs = [(point, run) for one in found for point in one.points for run in point.runs if run.counted]
        numbers = dict(zip(((point, run.seed) for point, run in runs),
                           mapped(of_run, [(run.run.folder, study.window) for _, run in runs], args.processes),
                           strict=True))  # fmt: skip
        for one in found:
            series.append(of_series(study.name, one, numbers, args))
        print(f"{law}, {rolling}, {study.name}: {ran:.0f} s of runs, {time.time() - started - ran:.0f} s of evaluation "
              f"of {len(runs)} runs; peak memory {peak()}", flush=True)  # fmt: skip
    return {"law": law, "rolling": rolling, "hardware": hardware(), "failed": failed, "series": series}


def of_series(study: str, one: Any, numbers: Mapping[Any, Any], args: argparse.Namespace) -> dict[str, Any]:
    """Numbers of a series for all starts, of runs that did not clog."""
    runs = {point: [(run, *numbers[point, run.seed]) for run in point.runs
                    if (point, run.seed) in numbers and run.outcome != "clogged" and numbers[point, run.seed][0]]
            for point in one.points}  # fmt: skip
    windows = next(([start.window for start in starts] for each in runs.values() for _, starts, _ in each), [])
    points = []
    for point, each in runs.items():
        fraction = point.pooled.get(PACKING_FRACTION)
        phi = fraction.value if fraction else None
        points.append({"D": point.orifice, "outcomes": dict(point.outcomes), "phi": phi,
                       "seeds": [run.seed for run, _, _ in each], "times": [times for _, _, times in each],
                       "W": [[starts[place].flow_rate for _, starts, _ in each] for place in range(len(windows))],
                       "opens": [[starts[place].fraction for _, starts, _ in each] for place in range(len(windows))],
                       "plateau": [bool(starts[-1].plateau) for _, starts, _ in each]})  # fmt: skip
    radius, tasks = one.points[0].point.scene.grains.radius, []
    for (place, _), definition in itertools.product(enumerate(windows), DEFINITIONS):
        seeds = [[starts[place].profile.outlets(radius)[definition] for _, starts, _ in each if starts[place].profile]
                 for each in runs.values()]  # fmt: skip
        seeds = [[outlet for outlet in outlets if outlet.has_flow] for outlets in seeds]
        tasks.append(([outlets for outlets in seeds if outlets], context(one.points)))
    fits = iter(mapped(of_profiles, tasks, args.processes))
    starts = ["auto" if window.auto else window.start for window in windows]
    fitted = [{name: next(fits) for name in DEFINITIONS} for _ in windows]
    return {"study": study, "at": dict(one.at), "starts": starts, "points": points, "profiles": fitted}


def peak() -> str:
    """Peak memory of this process and of the largest of those that have ended."""
    own, others = (
        resource.getrusage(who).ru_maxrss / 2**20 for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    return f"{own:.1f} GB here, {others:.1f} GB in the largest other process"


def run(args: argparse.Namespace) -> None:
    """Run and evaluate every candidate, and write its numbers as soon as they are there."""
    args.out.mkdir(parents=True, exist_ok=True)
    for law, rolling in itertools.product(args.laws, args.rolling):
        path = args.out / f"{law}-{rolling}.json.gz"
        if path.exists():
            continue
        numbers = candidate(law, rolling, args)
        with gzip.open(path, "wt") as file:
            json.dump(rounded(numbers), file, separators=(",", ":"))
        print(f"wrote {path}", flush=True)


def rounded(value: Any) -> Any:
    """The same with numbers of DIGITS significant digits; None for NaN and infinities."""
    if isinstance(value, Mapping):
        return {key: rounded(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [rounded(one) for one in value]
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None
    return value


# Tables and ranking

ABOUT = Context(d=3e-3, rho_p=2500.0, rho_b=None, Z=1.01 * 3e-3, g=9.81)
NUMBERS = (*(f"C, {at} deg" for at in ANGLES), *(f"gamma, {at} deg" for at in ANGLES), "k, 90 deg",
           *(f"C, gap {gap} mm" for gap in GAPS), *(f"W/W0, {D} mm" for D in AT_WALL))  # fmt: skip
PAPER = np.array([*(c for c, _ in ANGLES.values()), *(gamma for _, gamma in ANGLES.values()), K, *GAPS.values(),
                  *AT_WALL.values()])  # fmt: skip
GROUPS = (range(5), range(5, 10), (10,), (11, 12), (13,), (14,))
"""Numbers whose uncertainty in the paper has a common part."""


@dataclass(frozen=True, eq=False)
class Line:
    """W [kg/s] of outlets D [m] of one series for one start: mean over seeds and its standard error."""

    D: np.ndarray
    W: np.ndarray
    error: np.ndarray


def weighted(line: Line, W: np.ndarray) -> tuple[float, float]:
    """C by the density of the grains and k, by equal relative weights."""
    law = FLOW_LAWS["beverloo"]

    def residuals(free: np.ndarray) -> np.ndarray:
        return np.log(W) - law.log_flow(line.D, free, ABOUT)

    free = minimise(residuals, law.start(line.D, W, ABOUT)).best
    return math.exp(free[0]), float(free[1])


def straight(line: Line, W: np.ndarray) -> tuple[float, float]:
    """C and k by an unweighted straight line through W^(2/3), as in the paper's Fig. 2b."""
    slope, shift = np.polyfit(line.D, W ** (2 / 3), 1)
    return _of_slope(slope), float(-shift / slope / ABOUT.d)


def origin(line: Line, W: np.ndarray) -> tuple[float, float]:
    """C by a straight line through W^(2/3) and the origin, as eqs 14 and 18 have it; k = 0."""
    return _of_slope(line.D @ W ** (2 / 3) / (line.D @ line.D)), 0.0


def _of_slope(slope: Any) -> float:
    return float(slope**1.5 / (ABOUT.rho_p * math.sqrt(ABOUT.g) * ABOUT.Z))


def lines(file: Mapping[str, Any], start: float | str) -> dict[tuple[str, float | None], Line]:
    """Series by study and angle [deg] or gap [mm] (None: the middle), in the hopper that is 100 mm wide.

    Errors are from the relative scatter between seeds, pooled over the points of a study.
    """
    found: dict[tuple[str, float | None], list] = {}
    scatter: dict[str, list[float]] = {}
    for series in file["series"]:
        at = series["at"]
        if round(1e3 * at.get("container.width", 0.1)) != 100 or start not in series["starts"]:
            continue
        place = series["starts"].index(start)
        where = round(math.degrees(at["container.angle"])) if "container.angle" in at else None
        where = round(1e3 * at["container.gap"]) if "container.gap" in at else where
        for point in series["points"]:
            rates = np.array([rate for rate in point["W"][place] if rate is not None])
            if len(rates) < 2:
                continue
            scatter.setdefault(series["study"], []).append(float(rates.var(ddof=1) / rates.mean() ** 2))
            found.setdefault((series["study"], where), []).append((point["D"], rates.mean(), len(rates)))
    pooled = {study: math.sqrt(float(np.mean(values))) for study, values in scatter.items()}
    return {key: Line(*np.array([(D, W, W * pooled[key[0]] / math.sqrt(n)) for D, W, n in rows]).T)
            for key, rows in found.items()}  # fmt: skip


def of_profile(file: Mapping[str, Any], study: str, start: float | str, name: str) -> dict[float | None, list[float]]:
    """A parameter of the profiles of crossing grains, with its error, by angle [deg]."""
    found = {}
    for series in file["series"]:
        if series["study"] == study and start in series["starts"]:
            fit = series["profiles"][series["starts"].index(start)]["outlet_crossings"]
            angle = series["at"].get("container.angle")
            pair = [math.nan if number is None else number for number in fit["parameters"][name]]
            found[None if angle is None else round(math.degrees(angle))] = pair
    return found


def numbers(file: Mapping[str, Any], start: float | str, reading: str) -> tuple[np.ndarray, np.ndarray]:
    """The fifteen numbers in the order of NUMBERS, and their covariance from our errors."""
    every = lines(file, start)
    keys = [(ANGLE, angle) for angle in ANGLES] + [(POSITION, gap) for gap in GAPS]
    split = np.cumsum([len(every[key].W) for key in keys])[:-1]
    gammas = of_profile(file, ANGLE, start, "gamma")

    def of_rates(W: np.ndarray) -> np.ndarray:
        rates = dict(zip(keys, np.split(W, split), strict=True))
        free = {key: (weighted if reading == "weighted" else straight)(every[key], rates[key]) for key in keys}
        through = {key: origin(every[key], rates[key]) for key in keys}
        C = {key: (through if reading == "origin" and key != (ANGLE, 90) else free)[key][0] for key in keys}
        middle = dict(zip(np.round(1e3 * every[ANGLE, 90].D), rates[ANGLE, 90], strict=True))
        wall = dict(zip(np.round(1e3 * every[POSITION, 0].D), rates[POSITION, 0], strict=True))
        return np.array([*(C[ANGLE, angle] for angle in ANGLES), *(gammas[angle][0] for angle in ANGLES),
                         free[ANGLE, 90][1], *(C[POSITION, gap] for gap in GAPS),
                         *(wall[D] / middle[D] for D in AT_WALL)])  # fmt: skip

    W = np.concatenate([every[key].W for key in keys])
    errors = np.concatenate([every[key].error for key in keys])
    slopes = np.stack([(of_rates(W + step) - of_rates(W - step)) / 2 for step in np.diag(errors)], axis=1)
    own = slopes @ slopes.T  # each step is one standard error
    own[5:10, 5:10] += np.diag([gammas[angle][1] ** 2 for angle in ANGLES])
    return of_rates(W), own


def chi2(ours: np.ndarray, own: np.ndarray, common: float, numbers_used: Sequence[int]) -> float:
    """Squared deviations from the paper's numbers, by both covariances."""
    theirs = np.diag((1 - common) * (PART * PAPER) ** 2)
    for group in GROUPS:
        part = np.zeros(len(PAPER))
        part[list(group)] = PART * PAPER[list(group)]
        theirs += common * np.outer(part, part)
    used = np.ix_(numbers_used, numbers_used)
    apart = (ours - PAPER)[list(numbers_used)]
    return float(apart @ np.linalg.solve((own + theirs)[used], apart))


Scores = dict[tuple[str, str, float | str, str], float]
"""chi2 by law, rolling, start and reading."""


def scores(files: Iterable[Mapping[str, Any]], common: float, numbers_used: Sequence[int]) -> Scores:
    """chi2 of every candidate for every start (but that of auto) and reading."""
    found: Scores = {}
    for file in files:
        starts = next(series["starts"] for series in file["series"] if series["study"] == ANGLE)
        for start, reading in itertools.product((start for start in starts if start != "auto"), READINGS):
            ours, own = numbers(file, start, reading)
            found[file["law"], file["rolling"], start, reading] = chi2(ours, own, common, numbers_used)
    return found


def least(values: Scores, *places: int) -> dict[tuple, float]:
    """Least chi2 by some of law (0), rolling (1), start (2) and reading (3)."""
    found: dict[tuple, float] = {}
    for key, value in values.items():
        short = tuple(key[place] for place in places)
        found[short] = min(value, found.get(short, math.inf))
    return found


def open_choices(variants: Sequence[Scores], *places: int) -> list[tuple]:
    """Choices that are less than CLEAR behind the best in at least one variant."""
    found = dict.fromkeys(
        choice
        for values in variants
        for choice, value in least(values, *places).items()
        if value < min(values.values()) + CLEAR
    )
    return sorted(found, key=str)


def tables(args: argparse.Namespace) -> None:
    """Print all tables."""
    files = []
    for path in sorted(args.folder.glob("*.json.gz")):
        with gzip.open(path, "rt") as file:
            files.append(json.load(file))
    if not files:
        sys.exit(f"there are no files *.json.gz in {args.folder}; make them with `run`")
    for file in files:
        print(f"\n## {file['law']}, {file['rolling']}\n")
        of_candidate(file)
    every, without = range(len(PAPER)), [place for place in range(len(PAPER)) if place not in (11, 12)]
    variants = {(common, used is every): scores(files, common, used) for common in COMMON for used in (every, without)}
    main = variants[COMMON[1], True]
    starts = sorted({start for _, _, start, _ in main}, key=str)
    print("\n## chi2, best reading, by start\n")
    print(row("candidate", *starts, "describes the numbers"))
    print(row(*["---"] * (len(starts) + 2)))
    by_start, best = least(main, 0, 1, 2), least(main, 0, 1)
    for (law, rolling), value in sorted(best.items(), key=lambda pair: pair[1]):
        cells = (f"{by_start[law, rolling, start]:.1f}" for start in starts)
        print(row(f"{law}, {rolling}", *cells, "yes" if value <= DESCRIBED else "no"))
    print(
        "\nchi2 by variant (common part, all numbers or without C of the gaps): best candidate and distance of others"
    )
    for (common, whole), values in variants.items():
        ranked = sorted(least(values, 0, 1).items(), key=lambda pair: pair[1])
        listed = ", ".join(f"{' '.join(key)} {value:.1f}" for key, value in ranked)
        print(f"* {common}, {'all' if whole else 'without'}: {listed}")
    for places, what in (((0, 1), "candidates"), ((2,), "starts"), ((3,), "readings")):
        print(
            f"\nnot out, {what}:",
            "; ".join(" ".join(map(str, key)) for key in open_choices([*variants.values()], *places)),
        )


def of_candidate(file: Mapping[str, Any]) -> None:
    """Print C and k of all series by start and reading, W beside eqs 14 and 18, gamma, a and b."""
    starts = next(iter(file["series"]))["starts"]
    every = {start: lines(file, start) for start in starts}
    print(row("series", "number", *starts, "paper"))
    print(row(*["---"] * (len(starts) + 3)))
    for study, where in every[starts[0]]:
        label = f"{study.removeprefix('fan2023-')} {'' if where is None else where}".strip()
        theirs = ANGLES.get(int(where), (None, None))[0] if study == ANGLE and where is not None else None
        theirs = GAPS.get(int(where)) if study == POSITION and where is not None else theirs
        for name, fit in (("weighted", weighted), ("line", straight), ("origin", origin)):
            fits = [fit(line, line.W) for start in starts if (line := every[start].get((study, where))) is not None]
            print(row(label, f"C, {name}", *(f"{C:.3f}" for C, _ in fits), theirs or "–"))
            if fit is not origin:
                print(row(label, f"k, {name}", *(f"{k:.2f}" for _, k in fits), K if where in (None, 90) else "–"))
        for place, D in enumerate(every[starts[0]][study, where].D):
            cells = (f"{1e3 * line.W[place]:.2f} ± {1e3 * line.error[place]:.2f}" for start in starts
                     if (line := every[start].get((study, where))) is not None)  # fmt: skip
            print(row(label, f"W [g/s], {1e3 * D:g} mm", *cells, printed(study, where, D / 2)))
    for study, name in itertools.product((COLUMN, ANGLE), ("gamma", "a", "b")):
        found = {start: of_profile(file, study, start, name) for start in starts}
        for where in found[starts[0]]:
            theirs = TABLE_2[int(where or 90)][("a", "gamma", "b").index(name)]
            cells = ("{:.3f} ± {:.3f}".format(*found[start][where]) for start in starts)
            print(row(f"{study.removeprefix('fan2023-')} {where or ''}", name, *cells, theirs))


def printed(study: str, where: float | None, R: float) -> str:
    """W of eq 14 or eq 18 with the paper's own parameters [g/s], eq 14 as printed, with phi_inf."""
    if study == POSITION and where is not None:
        d1, e1, s1, d2, e2, s2 = TABLE_3[int(where)]
        tau1, tau2 = SATURATION[int(where)]
        phi = float(Saturation(TABLE_2[90][3], tau1, 1e3 * tau2).at(R))
        W = eccentric_flow(ABOUT.d, ABOUT.rho_p, ABOUT.g, R, phi, (d1, e1, s1), (d2, e2, s2))
        return f"{1e3 * W:.1f} (eq 18)"
    a, gamma, b, phi = TABLE_2[int(where or 90)]
    return f"{1e3 * centred_flow(ABOUT.d, ABOUT.rho_p, phi, math.sqrt(2 * ABOUT.g * gamma * R), R, a, b):.1f} (eq 14)"


def row(*cells: Any) -> str:
    """A row of a table in Markdown."""
    return f"| {' | '.join(map(str, cells))} |"


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
    verb.add_argument("--wide", action="store_true", help="also the hopper that is 150 mm wide")
    verb.add_argument("--replicates", type=int, default=4)
    verb.add_argument("--count", type=float, default=1.0, help="part of the grains, for a trial")
    verb.add_argument("--processes", type=int, default=min(8, os.cpu_count() or 1))
    verb.add_argument("--progress", action="store_true")
    verb.add_argument("--out", type=Path, required=True, help="folder of the numbers")
    verb.set_defaults(do=run)
    verb = verbs.add_parser("tables", help="print tables and the ranking")
    verb.add_argument("folder", type=Path)
    verb.set_defaults(do=tables)
    args = parser.parse_args()
    args.do(args)


if __name__ == "__main__":
    main()
