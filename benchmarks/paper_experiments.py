"""One experiment for each disagreement with a paper (Fan 2023, Pongó 2022, Dosta 2024) whose cause is not tested.

    python benchmarks/paper_experiments.py list
    python benchmarks/paper_experiments.py gap bins planar walls --lab LAB --backend warp --device cuda:0 --out FOLDER
    python benchmarks/paper_experiments.py core --lab LAB --backend warp --device cuda:0 --out FOLDER
    python benchmarks/paper_experiments.py fall --lab LAB --backend warp --device cuda:0 --out FOLDER
    python benchmarks/paper_experiments.py stress --lab LAB --backend warp --device cuda:0 --out FOLDER
    python benchmarks/paper_experiments.py dosta --lab LAB --backend warp --device cuda:0 --out FOLDER

In this order they decide most for their cost: some 60, 60, 45 and 45 s on one H100 for the first four, then 190, 240,
170 and 600 s. They were tried with `--small` only.

An experiment runs what is missing in the lab, evaluates it and writes FOLDER/NAME.json. It may be interrupted and
called again. `--small` takes few soft grains: minutes on a CPU, to try the code; its numbers mean nothing.
"""

import argparse
import json
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

import labbook
from labbook import Lab, Study
from labbook.backend.machine import hardware
from labbook.fields import Fields, coarse_grain
from labbook.fit import FitError
from labbook.measure.bed import bed_grid, grains_between, omega_of
from labbook.measure.outlet import DEFINITIONS, ProfileAcross, outlet_profile
from labbook.measure.stress import contact_pressure
from labbook.papers.fan2023.laws import dome, fit_dome, fit_saturation
from labbook.results.points import PointResult, RunResult, by_seed
from labbook.stats import pool
from labbook.stats.ratio import independent_ratio, paired_ratio
from labbook.study import Window

STUDIES = Path(__file__).parents[1] / "studies"
STARTS = (0.0, 0.02, 0.05, 0.15)
"""Starts of the window, by the discharged fraction."""
BINS = (10, 20, 24, 30)
MIDDLE = 0.15
"""|x*| within which bins count as the middle of an outlet."""
ENDS = tuple(0.5 * k for k in range(9))
"""Ends [s] of windows over which N(t) is fitted."""
Row = dict[str, Any]


@dataclass(frozen=True)
class Experiment:
    """What it decides, its studies, what they are evaluated to, and seconds on one NVIDIA H100 (estimated)."""

    about: str
    seconds: int
    studies: Callable[[], Sequence[Study]]
    rows: Callable[[Lab, Sequence[Study]], Iterator[Row]]


# Fan et al. 2023


def _fan(name: str, **changes: Any) -> Study:
    """A study of Fan's hopper in mixed precision, without recordings and reference."""
    return labbook.load(STUDIES / f"{name}.yaml").change(
        {"numerics.precision": "mixed", "record": None, "reference": None, "fit": [], **changes}
    )


def _bins() -> Sequence[Study]:
    angles = {"sweep": {"container.angle": "[15, 90] deg", "container.orifice": "[18, 30, 45, 60] mm"}}
    walls = {"sweep": {"walls.all.friction": [0.01], "container.orifice": "[18, 30, 45, 60] mm"}}
    gap = {"points": [{"container.orifice": f"{d} mm", "container.gap": "6 mm"} for d in (18, 30, 45, 60)]}
    return (
        _fan("fan2023-hopper-angle", **angles),
        _fan("fan2023-all-walls-friction", **walls),
        _fan("fan2023-eccentricity", **gap),
    )


def _of_bins(lab: Lab, studies: Sequence[Study]) -> Iterator[Row]:
    """Exponents a and b by a joint fit and by a fit to the collapsed profiles, tau by both middles, for each number of
    bins and start of the window. A fit for each seed; means with standard errors."""
    for study in studies:
        groups: dict[tuple, list[PointResult]] = {}
        for one in lab.results(study, progress=False).points:
            at = {name: value for name, value in one.at.items() if name != "container.orifice"}
            groups.setdefault(tuple(at.items()), []).append(one)
        for at, points in groups.items():
            for bins in BINS:
                for start in STARTS if bins == 24 else (0.15,):
                    for definition in DEFINITIONS:
                        yield from _shapes(study.name, dict(at), points, bins, start, definition)


def _shapes(
    study: str, at: Mapping[str, Any], points: Sequence[PointResult], bins: int, start: float, definition: str
) -> Iterator[Row]:
    of_seeds: dict[int, dict[float, ProfileAcross]] = {}
    for point in points:
        for run in point.runs:
            if (found := _profile(run, bins, start, definition)) is not None and found.has_flow:
                of_seeds.setdefault(run.seed, {})[point.orifice] = found
    complete = [list(one.values()) for one in of_seeds.values() if len(one) == len(points)]
    if not complete:
        return
    numbers = [numbers_of_seed(outlets, points[0].point.scene.grains.diameter) for outlets in complete]
    for name in numbers[0]:
        mean = pool([one[name] for one in numbers])
        row = {"study": study, **at, "bins": bins, "start": start, "definition": definition, "quantity": name}
        yield row | {"value": mean.value, "error": mean.error, "seeds": mean.n}


def _profile(run: RunResult, bins: int, start: float, definition: str) -> ProfileAcross | None:
    window = Window(start=start, end=run.window.end)
    found = outlet_profile(run.run.data(), window, bins)
    return None if found is None else found.outlets(run.run.point.scene.grains.radius)[definition]


def numbers_of_seed(outlets: Sequence[ProfileAcross], d: float) -> dict[str, float]:
    """Of one seed: exponents of v and phi, the middles of phi, and eq 12 through both kinds of middle."""
    speeds, fractions = [one.velocity for one in outlets], [one.area_fraction for one in outlets]
    joint = fit_dome(outlets, fractions)
    measured = [_middle(one, values) for one, values in zip(outlets, fractions, strict=True)]
    numbers = {
        "a": fit_dome(outlets, speeds).exponent,
        "b": joint.exponent,
        "a_collapsed": _collapsed(outlets, speeds),
        "b_collapsed": _collapsed(outlets, fractions),
        "b_collapsed_whole": _collapsed(outlets, fractions, whole=True),
    }
    R = [one.R for one in outlets]
    for half, value in zip(R, measured, strict=True):
        numbers[f"phi_middle_{2e3 * half:g}mm"] = value
    if len(set(R)) >= 4:
        for name, middles in (("dome", joint.amplitude.tolist()), ("measured", measured)):
            law = fit_saturation(R, middles, d)
            numbers |= {f"phi_inf_{name}": law.phi_inf, f"tau1_{name}": law.tau1, f"tau2_per_mm_{name}": law.tau2 / 1e3}
    return numbers


def _middle(outlet: ProfileAcross, values: np.ndarray) -> float:
    """The mean over the bins in the middle: two at least."""
    centres = abs(outlet.edges[1:] + outlet.edges[:-1]) / 2
    return float(np.nanmean(values[centres <= max(MIDDLE, centres.min() * 1.001)]))


def _collapsed(outlets: Sequence[ProfileAcross], values: Sequence[np.ndarray], whole: bool = False) -> float:
    """The exponent p of (1 - x*^2)^p through all bins of all outlets, each profile over its measured middle."""

    def misfit(p: float) -> float:
        total = 0.0
        for outlet, profile in zip(outlets, values, strict=True):
            use = np.isfinite(profile) & (outlet.inside | whole)
            law = dome(outlet.edges, p)
            total += float(np.sum((profile / _middle(outlet, profile) - law / _middle(outlet, law))[use] ** 2))
        return total

    found: Any = minimize_scalar(misfit, bounds=(0.0, 2.0), method="bounded")
    return float(found.x)


def _gap() -> Sequence[Study]:
    """Outlets 6 mm from the wall and in the middle, six beds."""
    sizes = (("100 mm", 3000), ("150 mm", 4500))
    points = [
        {"container.width": width, "grains.count": count, "container.orifice": f"{d} mm", **gap}
        for width, count in sizes
        for d in (18, 30, 45, 60)
        for gap in ({"container.gap": "6 mm"}, {})
    ]
    return (_fan("fan2023-eccentricity", points=points, replicates=6, measure=["flow_rate"]),)


def _walls() -> Sequence[Study]:
    """Friction of front and back walls, and of the others, each 0.01 or 0.5."""
    points = [
        {f"walls.{name}.friction": faces if name in ("front", "back") else sides for name in _SURFACES}
        | {"container.orifice": f"{d} mm"}
        for faces in (0.5, 0.01)
        for sides in (0.5, 0.01)
        for d in (30, 45, 60)
    ]
    return (_fan("fan2023-all-walls-friction", sweep=None, points=points, replicates=6, measure=["flow_rate"]),)


_SURFACES = ("front", "back", "left", "right", "bottom-left", "bottom-right")


def _planar() -> Sequence[Study]:
    """The paper's outlets from a rain and from a bed in one plane."""
    sweep = {"fill.kind": ["rain", "planar"], "container.orifice": "[18, 30, 45, 60] mm"}
    return (_fan("fan2023-flat-column", sweep=sweep, replicates=6, measure=["flow_rate"]),)


def _of_flow(lab: Lab, studies: Sequence[Study]) -> Iterator[Row]:
    """W of every point for each start of the window, C and k of every series, and each W over that of the first point
    with the same outlet (paired where both have the same beds)."""
    for study in studies:
        for start in STARTS:
            other = study.change({"window.start": start})
            results = lab.results(other, progress=False)
            points = [one for one in results.points if one.flow_rate is not None]
            for one in points:
                yield {**one.at, "start": start, "quantity": "W_g_s", **_mean([1e3 * w for w in _rates(one).values()])}
            for one in points:
                plain = _plain(one, points)
                if plain is not None and plain is not one:
                    yield {**one.at, "start": start, "quantity": "W_ratio", **_ratio(one, plain)}
            for series in results.series:
                try:
                    fit = results.fit("beverloo", series.at or None)
                except (FitError, LookupError):
                    continue
                for name in ("C_particle", "k"):
                    number = fit.parameters[name]
                    row = {**series.at, "start": start, "quantity": name}
                    yield {**row, "value": number.value, "error": number.error, "chi2": fit.chi2}


def _plain(one: PointResult, points: Sequence[PointResult]) -> PointResult | None:
    """What W is compared with: the outlet in the middle, else the first point with this outlet."""
    alike = [p for p in points if math.isclose(p.orifice, one.orifice)]
    if "container.width" in one.at:
        alike = [
            p for p in alike if p.at["container.width"] == one.at["container.width"] and "container.gap" not in p.at
        ]
    return alike[0] if alike else None


def _rates(one: PointResult) -> dict[int, float]:
    """W [kg/s] by seed."""
    return by_seed(one, "flow_rate")


def _mean(values: Sequence[float]) -> Row:
    mean = pool(list(values))
    ends = {"low": mean.low, "high": mean.high, "n": mean.n}
    return {"value": mean.value, "error": mean.error, **ends, "each": [float(f"{v:.6g}") for v in values]}


def _ratio(one: PointResult, plain: PointResult) -> Row:
    above, below = _rates(one), _rates(plain)
    beds = [{run.seed: run.packing_key for run in point.runs} for point in (one, plain)]
    seeds = sorted(seed for seed in above.keys() & below.keys() if beds[0][seed] == beds[1][seed])
    paired = len(seeds) > 1
    if paired:
        found = paired_ratio([above[s] for s in seeds], [below[s] for s in seeds])
    else:
        found = independent_ratio(pool(list(above.values())), pool(list(below.values())))
    return {"value": found.value, "error": found.error, "low": found.low, "high": found.high, "paired": paired}


# Pongó et al. 2022


def _pongo(name: str, **changes: Any) -> Study:
    own = {"numerics.dt": "5 us", "numerics.precision": "mixed", "reference": None, "record": None}
    return labbook.load(STUDIES / f"{name}.yaml").change({**own, **changes})


def _core() -> Sequence[Study]:
    """One bed of L/d = 3.3 through 54 mm, until 70 % have left."""
    changes = {
        "sweep": {"container.rotation": "[0.32, 1.28] Hz"},
        "replicates": 1,
        "measure": ["flow_rate"],
        "stop": {"discharged": 0.7, "stall": "5 s", "max_time": "120 s"},
        "window": {"start": 0.1, "end": 0.7, "moment": "1 s"},
        "record": {"every": "250 ms", "replicates": 1},
    }
    return (_pongo("pongo2022-maps", **changes),)


def _of_core(lab: Lab, studies: Sequence[Study]) -> Iterator[Row]:
    """phi within 20 mm of the axis over that of 65 to 85 mm, less 1, about three instants: by kernels of omega
    and of half of it, and by counting centres without a kernel."""
    for point in (one for study in studies for one in lab.results(study, progress=False).points):
        for run in point.runs:
            data, frames = run.run.data(), run.frames()
            if frames is None:
                continue
            scene, crossed = data.scene, np.sort(np.asarray(data.tables["crossing"]["time"], float))
            for part in (0.15, 0.4, 0.65):
                number = int(part * len(data.start))
                if number >= len(crossed):
                    continue
                when = float(crossed[number])
                row = {**point.at, "seed": run.seed, "discharged": part, "time_s": when}
                for half in (0.5, 2.5):  # the paper's, and longer: there are few grains near the axis
                    yield row | {"half_s": half} | _core_at(scene, frames, (when - half, when + half))


def _core_at(scene: Any, frames: Mapping[str, np.ndarray], span: tuple[float, float]) -> Row:
    time = np.asarray(frames["time"], float)
    there = (time >= span[0]) & (time <= span[1])
    r, z = (np.asarray(a, float)[there] for a in (np.hypot(frames["x"], frames["y"]), frames["z"]))
    R = scene.container.diameter / 2
    surface = float(np.quantile(z[r > 0.65 * R], 0.98))
    low, high = 0.4 * surface, surface - 2.5 * scene.grains.equivalent_diameter
    row: Row = {"frames": len(np.unique(time[there])), "surface_mm": 1e3 * surface, "z_mm": [1e3 * low, 1e3 * high]}
    if high <= low or not there.any():
        return row
    inner, ring = (0.0, 0.21 * R), (0.684 * R, 0.895 * R)  # 20 mm; 65 to 85 mm in the paper's silo
    counts = [np.count_nonzero((r >= a) & (r < b) & (z >= low) & (z < high)) for a, b in (inner, ring)]
    areas = [math.pi * (b**2 - a**2) for a, b in (inner, ring)]
    if min(counts) > 0:
        row["core_by_counting"] = counts[0] / areas[0] / (counts[1] / areas[1]) - 1
        row["centres_in_core"] = int(counts[0])
    grains, omega = grains_between(scene, frames, *span), omega_of(scene)
    for name, width in (("core_omega", omega), ("core_half_omega", omega / 2)):
        fields = coarse_grain(bed_grid(scene, width, grains.x), width, grains)
        row[name] = _mean_phi(fields, inner, (low, high)) / _mean_phi(fields, ring, (low, high)) - 1
    return row


def _where(fields: Fields, r: tuple[float, float], z: tuple[float, float]) -> np.ndarray:
    radii, heights = np.meshgrid(*fields.grid.points, indexing="ij")
    return (radii >= r[0]) & (radii < r[1]) & (heights >= z[0]) & (heights < z[1])


def _mean_phi(fields: Fields, r: tuple[float, float], z: tuple[float, float]) -> float:
    there, volumes = _where(fields, r, z), fields.grid.volumes
    return float((fields.packing_fraction * volumes)[there].sum() / volumes[there].sum())


def _stress() -> Sequence[Study]:
    """Contact stress at the orifice of the paper's maps, L/d = 3.3."""
    sweep = {"container.rotation": "[0, 0.32, 1.28] Hz"}
    changes = {"sweep": sweep, "replicates": 2, "measure": ["flow_rate", "contact_stress"]}
    return (_pongo("pongo2022-maps", **changes),)


def _of_stress(lab: Lab, studies: Sequence[Study]) -> Iterator[Row]:
    """Contact pressure [Pa] above the orifice and in the bed, and on a coarse map: rings of 10 mm, layers of 20 mm."""
    for point in (one for study in studies for one in lab.results(study, progress=False).points):
        for run in point.runs:
            row = {**point.at, "seed": run.seed, "outcome": run.outcome}
            names = ("orifice_contact_pressure", "bed_contact_pressure", "grain_rate")
            row |= {name: run.measured[name].value for name in names if name in run.measured}
            if (fields := run.stress) is not None:
                row["map_Pa"] = [
                    [_pressure(fields, (a, a + 0.01), (b, b + 0.02)) for b in np.arange(0, 0.4, 0.02)]
                    for a in np.arange(0, 0.095, 0.01)
                ]
            yield row


def _pressure(fields: Fields, r: tuple[float, float], z: tuple[float, float]) -> float | None:
    """Mean contact pressure [Pa] between radii and heights [m]; None outside the grid."""
    there, volumes = _where(fields, r, z), fields.grid.volumes
    if not there.any():
        return None
    return float(f"{(contact_pressure(fields) * volumes)[there].sum() / volumes[there].sum():.4g}")


def _fall() -> Sequence[Study]:
    """Spheres and rods of three lengths through 60 mm, at rest and at 0.32 Hz."""
    changes = {
        "sweep": {
            "zip": {
                "grains.diameter": "[9.9, 8, 6, 5] mm",
                "grains.length": "[9.9, 20, 20, 20] mm",
                "grains.count": [10000, 10000, 10000, 22500],
                "contact.normal_stiffness": "[62362, 132346, 103077, 87488] N/m",
            },
            "container.rotation": "[0, 0.32] Hz",
        },
        "window.start": 0.1,
        "window.end": 0.2,
        "stop": {"discharged": 0.2, "stall": "5 s", "max_time": "60 s"},
    }
    return (_pongo("pongo2022-aspect-ratio", **changes),)


def _of_fall(lab: Lab, studies: Sequence[Study]) -> Iterator[Row]:
    """a_eff(z)/g of each run, z/D at which it is 1/2, the part of D from 0.8 to 0.2, and the area below it."""
    for point in (one for study in studies for one in lab.results(study, progress=False).points):
        D, g = point.orifice, point.point.scene.gravity
        for run in point.runs:
            row = {**point.at, "seed": run.seed, "outcome": run.outcome}
            names = ("grain_rate", "orifice_v_z", "orifice_kinetic_pressure", "free_fall_height")
            row |= {name: run.measured[name].value for name in names if name in run.measured}
            if (profile := run.acceleration) is not None:
                z, a = (profile.edges[1:] + profile.edges[:-1]) / 2 / D, -profile.acceleration / g
                at = {level: falls_to(z, a, level) for level in (0.8, 0.5, 0.2)}
                row |= {"z_half_over_D": at[0.5], "rise_over_D": at[0.2] - at[0.8]}
                row["a_over_g"] = [None if math.isnan(v) else float(f"{v:.4g}") for v in a]
            yield row


def falls_to(z: np.ndarray, a: np.ndarray, level: float) -> float:
    """The lowest z at which `a` falls below `level`; NaN if it never does."""
    for k in range(1, len(z)):
        if a[k] < level <= a[k - 1]:
            return float(z[k - 1] + (z[k] - z[k - 1]) * (a[k - 1] - level) / (a[k - 1] - a[k]))
    return math.nan


# Dosta et al. 2024


def _dosta() -> Sequence[Study]:
    """Six beds of M1 over the large orifice."""
    study = labbook.load(STUDIES / "dosta2024-silo.yaml")
    m1 = study.definition["points"][0] | {"container.orifice": "60 mm", "container.height": "370 mm"}
    stop = {"discharged": 1, "max_time": "4.05 s"}
    return (study.change({"points": [m1], "sweep": None, "replicates": 6, "stop": stop, "reference": None}),)


def _of_dosta(lab: Lab, studies: Sequence[Study]) -> Iterator[Row]:
    """Grains per second [1/s] by a straight line through N(t) at every 0.1 s, over every window with these ends."""
    for point in (one for study in studies for one in lab.results(study, progress=False).points):
        slopes: dict[tuple[float, float], list[float]] = {}
        for run in point.runs:
            data = run.run.data()
            left, total = np.sort(np.asarray(data.tables["crossing"]["time"], float)), len(data.start)
            inside = {f"{t:g}": total - int(np.searchsorted(left, t)) for t in ENDS[::2]}
            yield {"seed": run.seed, "outcome": run.outcome, "duration_s": data.duration, "inside": inside}
            for window, rate in rates_between(left, total, data.duration).items():
                slopes.setdefault(window, []).append(rate)
        for (begin, end), values in slopes.items():
            yield {"from_s": begin, "to_s": end, "quantity": "rate", **_mean(values)}


def rates_between(left: np.ndarray, total: int, duration: float) -> dict[tuple[float, float], float]:
    """Grains per second of windows between two of ENDS: slopes of lines through the number inside at every 0.1 s.

    left: when each grain left [s], ascending; total: grains at first; duration: of the run [s].
    """
    found = {}
    for begin in ENDS:
        for end in (one for one in ENDS if begin < one <= duration + 1e-6):
            t = np.arange(round(10 * begin), round(10 * end) + 1) / 10
            found[begin, end] = -float(np.polyfit(t, total - np.searchsorted(left, t), 1)[0])
    return found


EXPERIMENTS: Mapping[str, Experiment] = {
    "walls": Experiment("Fan: friction of front and back walls and of the others apart", 45, _walls, _of_flow),
    "gap": Experiment("Fan: W/W0 at a gap of 6 mm with six beds, and the start of the window", 60, _gap, _of_flow),
    "bins": Experiment("Fan: b, a and tau by bins, collapsed profiles and start of the window", 60, _bins, _of_bins),
    "planar": Experiment("Fan: C and k of a planar bed, 18 mm included", 45, _planar, _of_flow),
    "core": Experiment("Pongó: the sparse core of one bed down to 70 %", 190, _core, _of_core),
    "fall": Experiment("Pongó: a_eff of all lengths at rest and at 0.32 Hz", 240, _fall, _of_fall),
    "stress": Experiment("Pongó: contact stress at 54 mm", 170, _stress, _of_stress),
    "dosta": Experiment("Dosta: N(t) of six beds over every window from 0 to 4 s", 600, _dosta, _of_dosta),
}


def small(study: Study) -> Study:
    """The same with few soft grains, fewer seeds and a longer step: to try the code."""
    swept, stated = {name for point in study.points for name in point.at}, study.definition
    changes: dict[str, Any] = {"replicates": min(2, study.replicates), **_SOFT[study.points[0].scene.contact.law]}
    new = {name: value for name, value in changes.items() if name not in swept}
    if stated.get("points"):
        few = {name: value for name, value in changes.items() if name in swept}
        new["points"] = [point | {name: few[name] for name in point if name in few} for point in stated["points"]]
    elif "grains.count" in swept:  # in a zip
        new["sweep"] = {**stated["sweep"], "zip": {**stated["sweep"]["zip"]}}
        new["sweep"]["zip"]["grains.count"] = [changes["grains.count"]] * len(stated["sweep"]["zip"]["grains.count"])
    return study.change(new)


_SOFT: Mapping[str, Mapping[str, Any]] = {
    "hertz-printed": {
        "grains.count": 600, "contact.shear_modulus": "2 MPa", "numerics.dt": "15 us", "numerics.steps_per_beat": 100,
        "fill.settled_below": 1e-3,
    },
    "hertz-liggghts": {
        "grains.count": 2000, "contact.youngs_modulus": "50 MPa", "numerics.dt": "10 us", "fill.settled_below": 1e-3,
    },
    "linear": {
        "grains.count": 600, "contact.normal_stiffness": "10000 N/m", "numerics.dt": "20 us",
        "container.diameter": "80 mm", "container.orifice": "60 mm",
    },
}  # fmt: skip
"""Keys that make the grains of a law soft."""


def perform(name: str, said: argparse.Namespace) -> None:
    """Run what an experiment needs, evaluate it and write its numbers."""
    experiment, lab, begun = EXPERIMENTS[name], Lab(said.lab, said.backend, said.device), time.perf_counter()
    studies = [small(one) if said.small else one for one in experiment.studies()]
    for study in studies:
        if failed := lab.run(study, progress=said.progress).failed:
            print(f"{name}, {study.name}: {len(failed)} runs failed, the first: {failed[0]}", flush=True)
    rows = list(experiment.rows(lab, studies))
    told = {"experiment": name, "about": experiment.about, "small": said.small, "hardware": hardware(),
            "seconds": round(time.perf_counter() - begun, 1), "numbers": rows}  # fmt: skip
    said.out.mkdir(parents=True, exist_ok=True)
    (said.out / f"{name}.json").write_text(json.dumps(told, indent=1, default=float, allow_nan=True))
    print(f"{name}: {len(rows)} rows, {told['seconds']} s", flush=True)


def main() -> None:
    """From the command line."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("names", nargs="+", choices=["list", *EXPERIMENTS], help="experiments, in this order; or list")
    words.add_argument("--lab", type=Path, default=Path("lab"))
    words.add_argument("--backend", default="numba")
    words.add_argument("--device", default="cpu")
    words.add_argument("--out", type=Path, default=Path("experiments"))
    words.add_argument("--small", action="store_true", help="few soft grains, to try the code")
    words.add_argument("--progress", action="store_true")
    said = words.parse_args()
    for name in said.names:
        if name == "list":
            print(*(f"{key:8} some {one.seconds} s: {one.about}" for key, one in EXPERIMENTS.items()), sep="\n")
        else:
            perform(name, said)


if __name__ == "__main__":
    main()
