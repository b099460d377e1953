"""Maps of the bed above a bottom at rest and a turning one, and what they say of the statements of Pongó et al. 2022,
Figs 6 and 7 (docs/results/pongo2022-maps.md).

    python benchmarks/pongo_fields.py keep LAB STUDY.yaml rod-3.3.npz --backend warp
    python benchmarks/pongo_fields.py draw rod-2.5.npz rod-3.3.npz rod-4.npz --out docs/results --numbers numbers.csv

The first command keeps mean fields of all recorded runs of a study. The second draws them, means over the seeds, and
writes the numbers of each run. The shape is the name of its file.
"""

import argparse
import csv
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from labbook import Lab, load
from labbook.fields import Fields
from labbook.fields.pattern import pattern_of
from labbook.measure.recorded import Bed, FlowMoments, FlowPattern
from labbook.report.figures.pattern import even
from labbook.report.style import FAINT, INK, MILLIMETRE, PAGE, for_a_screen, house
from labbook.results.recorded import both
from labbook.stats import pool

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHAPES = {"rod-2.5": "L/d = 2.5", "rod-3.3": "L/d = 3.3", "rod-4": "L/d = 4"}
FREQUENCIES = (0.0, 0.32, 1.28)
ORIFICE, RADIUS = 54.0, 95.0  # mm
_OF_MOMENTS = ("flux", "axes", "number")
"""Fields left out of the means about an instant."""
_SPARSE = 0.8, 0.9  # of the packing fraction of the bed: below it the region at the orifice counts as sparse
_IN_BED = 0.15  # packing fraction below which maps are white
_GRAVITY = 9.8  # m/s^2, of the study
_STEP = 2.5  # mm between heights of the maps


# what is kept


def kept(lab: str, study: str, backend: str, point: int, seed: int) -> dict[str, np.ndarray]:
    """Mean fields of a recorded run, over its window and about three instants; names begin with point and seed."""
    run = next(one for one in Lab(lab, backend).results(load(study), False).points[point].runs if one.seed == seed)
    out = {"outcome": np.array(run.outcome)}
    bed = Bed.of(run.evaluation(FlowPattern()))
    out |= {} if bed is None else bed.arrays("mean")
    for k, moment in enumerate(FlowMoments.beds(run.evaluation(FlowMoments()))):
        arrays = moment.arrays(f"moment{k}")
        out |= {name: a for name, a in arrays.items() if name.partition(".")[2] not in _OF_MOMENTS}
    return {
        f"{point}|{seed}|{name}": a.astype(np.float32) if a.dtype == float and a.size > 50 else a
        for name, a in out.items()
    }


def keep(lab: str, study: str, to: Path, backend: str) -> None:
    """Write what is kept of all recorded runs of a study."""
    points = Lab(lab, backend).results(load(study), False).points
    jobs = [(lab, study, backend, k, run.seed) for k, one in enumerate(points) for run in one.runs if run.recorded]
    found = {"at": np.array([json.dumps(dict(one.point.at)) for one in points])}
    with ProcessPoolExecutor() as pool:
        for one in pool.map(kept, *zip(*jobs, strict=True)):
            found |= one
    np.savez_compressed(to, allow_pickle=False, **found)


# what is read


@dataclass(frozen=True, eq=False)
class Run:
    """A run that flowed to its end: its mean fields, and those about three instants, each with its time [s]."""

    shape: str
    f: float
    seed: int
    mean: Fields
    moments: Sequence[tuple[float, Fields]]


def read(path: Path) -> Iterator[Run]:
    """The runs in a file of `keep` that flowed to their end."""
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    frequencies = [json.loads(str(text))["container.rotation"] for text in arrays.pop("at")]
    by_run: dict[tuple[int, int], dict[str, np.ndarray]] = {}
    for name, array in arrays.items():
        point, seed, rest = name.split("|")
        by_run.setdefault((int(point), int(seed)), {})[rest] = array
    for (point, seed), of in sorted(by_run.items()):
        moments = [
            (float(np.mean(of[f"moment{k}.window"])), found)
            for k in range(3)
            if (found := _fields(of, f"moment{k}")) is not None
        ]
        if (mean := _fields(of, "mean")) is not None and str(of["outcome"]) == "finished":
            yield Run(path.stem, round(frequencies[point], 6), seed, mean, moments)


def _fields(arrays: Mapping[str, np.ndarray], part: str) -> Fields | None:
    own = {name.partition(".")[2]: a for name, a in arrays.items() if name.partition(".")[0] == part}
    own = {name: a.astype(float) if a.dtype == np.float32 else a for name, a in own.items()}
    return Fields.of(own) if "density" in own else None


# numbers


class Places:
    """Means of a field over parts of a bed, between radii and heights in mm; weighted by mass, or by volume."""

    def __init__(self, fields: Fields):
        self.fields = fields
        r, z = (1e3 * points for points in fields.grid.points)
        self._r, self._z = np.meshgrid(r, z, indexing="ij")
        self._volume = fields.grid.volumes

    def where(self, r: tuple[float, float], z: tuple[float, float]) -> np.ndarray:
        """The points between these radii and heights."""
        return (self._r >= r[0]) & (self._r < r[1]) & (self._z >= z[0]) & (self._z < z[1])

    def phi(self, r: tuple[float, float], z: tuple[float, float]) -> float:
        """Packing fraction."""
        there = self.where(r, z)
        return float(np.sum(self.fields.packing_fraction[there] * self._volume[there]) / np.sum(self._volume[there]))

    def by_mass(self, field: np.ndarray, r: tuple[float, float], z: tuple[float, float]) -> float:
        """Mean of a field weighted by mass."""
        weight = np.where(self.where(r, z), self.fields.density * self._volume, 0.0)
        return float(np.nansum(field * weight) / np.sum(weight))

    def sparse(self, below: float) -> float:
        """Volume [cm^3] above the orifice (r < 60 mm, 10 < z < 150 mm) with a packing fraction less than `below`. Lower
        down the kernel reaches through the bottom."""
        there = self.where((0, 60), (10, 150)) & (self.fields.packing_fraction < below)
        return 1e6 * float(np.sum(self._volume[there]))


def numbers(run: Run) -> dict[str, float]:
    """Quantities of one run that decide the statements. For heights and radii see docs/results/pongo2022-maps.md."""
    at, fields = Places(run.mean), run.mean
    high, all_r = (100.0, 200.0), (0.0, 85.0)
    v, bed = fields.velocity, at.phi(all_r, high)
    shear = shear_rate(fields)
    found = {
        "phi_bed": bed,
        "phi_wide_funnel": 1 - at.phi((0, 60), high) / at.phi((65, 85), high),
        "phi_core": 1 - at.phi((0, 20), high) / at.phi((65, 85), high),
        "phi_near_bottom": at.phi((45, 85), (10, 38)) / bed,
        "sparse_cm3": at.sparse(_SPARSE[0] * bed),
        "sparse_09_cm3": at.sparse(_SPARSE[1] * bed),
        "stagnant": pattern_of(fields, bottom=0.0).fraction,
        "vz_centre_over_ring": at.by_mass(v[2], (0, 30), (150, 200)) / at.by_mass(v[2], (60, 85), (150, 200)),
        "vz_centre_over_ring_low": at.by_mass(v[2], (0, 30), (60, 100)) / at.by_mass(v[2], (60, 85), (60, 100)),
        "curved": abs(at.by_mass(v[0], (10, 85), (60, 150)) / at.by_mass(v[2], (10, 85), (60, 150))),
        "fast_at_orifice": at.by_mass(v[2], (0, ORIFICE / 2), (0, 10)) / at.by_mass(v[2], (0, 95), (60, 200)),
        "outwards_over_g": _outwards(at, fields),
        "O_zz_centre": at.by_mass(fields.orientation[2, 2], (0, 30), (60, 150)),
        "O_zz_bottom": at.by_mass(fields.orientation[2, 2], (40, 85), (0, 15)),
        "v_r_bottom_mm_s": 1e3 * at.by_mass(v[0], (40, 85), (0, 20)),
    }
    order = fields.nematic_order
    there = at.where(all_r, (10, 200)) & np.isfinite(shear) & np.isfinite(order)
    low, top = np.quantile(shear[there], (0.25, 0.75))
    found["S_sheared_less_unsheared"] = float(
        np.mean(order[there & (shear > top)]) - np.mean(order[there & (shear < low)])
    )
    if len(run.moments) == 3:
        found["sinks_mm"] = sinks(run.moments[-1][1])
    return found


def shear_rate(fields: Fields) -> np.ndarray:
    """The rate of strain, sqrt(2 E:E) [1/s], of the mean flow about an axis."""
    r, z = fields.grid.points
    by_r, by_z = zip(*(np.gradient(v, r, z) for v in fields.velocity), strict=True)
    v_r, v_t, _ = fields.velocity
    wide = r[:, None]
    along = by_r[0] ** 2 + (v_r / wide) ** 2 + by_z[2] ** 2
    across = (by_z[0] + by_r[2]) ** 2 + by_z[1] ** 2 + (by_r[1] - v_t / wide) ** 2
    return np.sqrt(2 * along + across)


def _outwards(at: Places, fields: Fields) -> float:
    """Largest v_t^2/r over g in the bed (10 < r < 90 mm, z < 200 mm, packing fraction above 0.1)."""
    there = at.where((10, 90), (0, 200)) & (fields.packing_fraction > 0.1)
    r = fields.grid.points[0][:, None]
    return float(np.nanmax((fields.velocity[1] ** 2 / r / _GRAVITY)[there]))


def sinks(fields: Fields) -> float:
    """How far [mm] the surface in the middle (r < 30 mm) lies below that of the ring (60 to 85 mm)."""
    r, z = (1e3 * points for points in fields.grid.points)
    half = 0.5 * np.median(fields.packing_fraction[(r < 85)][:, (z > 100) & (z < 200)])
    level = np.array(
        [
            z[np.flatnonzero(column > half)[-1]] if (column > half).any() else math.nan
            for column in fields.packing_fraction
        ]
    )
    inside, ring = (np.average(level[there], weights=r[there]) for there in (r < 30, (r > 60) & (r < 85)))
    return float(ring - inside)


def table(rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Lines of a table: a row a number, a column a frequency of each shape, mean and standard error over seeds."""
    columns = [
        (shape, f) for shape in SHAPES for f in FREQUENCIES if any((r["shape"], r["f_Hz"]) == (shape, f) for r in rows)
    ]
    yield "| | " + " | ".join(f"{SHAPES[shape]}, {f:g} Hz" for shape, f in columns) + " |"
    yield "|---" * (len(columns) + 1) + "|"
    names = [name for name in max(rows, key=len) if name not in ("shape", "f_Hz", "seed")]
    for name in names:
        cells = []
        for shape, f in columns:
            some = [
                r[name] for r in rows if (r["shape"], r["f_Hz"]) == (shape, f) and name in r and not math.isnan(r[name])
            ]
            cells.append(f"{(mean := pool(some)).value:.4g} ± {mean.error:.2g} ({mean.n})" if some else "")
        yield f"| {name} | " + " | ".join(cells) + " |"


# pictures


@dataclass(frozen=True, eq=False)
class Map:
    """A field over r and z [mm], shape [r, z], mean over seeds; NaN outside the bed."""

    r: np.ndarray
    z: np.ndarray
    values: np.ndarray


def over_seeds(fields: Sequence[Fields], of: Callable[[Fields], np.ndarray]) -> Map:
    """Mean over fields of `of(field)`, an array of the shape of the grid, on one grid of heights; only where all are
    in the bed."""
    z = np.arange(0, 1e3 * max(one.grid.points[1][-1] for one in fields), _STEP)
    r = 1e3 * fields[0].grid.points[0]
    some = []
    for one in fields:
        values = np.where(one.packing_fraction > _IN_BED, of(one), np.nan)
        some.append([np.interp(z, 1e3 * one.grid.points[1], column, right=np.nan) for column in values])
    return Map(r, z, np.mean(some, axis=0))


def draw_map(ax: "Axes", field: Map, norm: Any, top: float) -> None:
    """A map on both sides of the axis, with the walls."""
    x = np.concatenate([-field.r[::-1], field.r])
    ax.pcolormesh(x, field.z, both(field.values), cmap="viridis", norm=norm, shading="nearest", rasterized=True)
    for side in (-1, 1):
        ax.plot([side * RADIUS, side * RADIUS], [0, top], color=INK, lw=1.2)
        ax.plot([side * RADIUS, side * ORIFICE / 2], [0, 0], color=INK, lw=1.2)
    ax.set(xlim=(-99, 99), ylim=(-8, top), aspect="equal")
    ax.spines[:].set_visible(False)
    ax.axhline(0, color=FAINT, lw=0.3, zorder=0)


def streams(ax: "Axes", fields: Sequence[Fields]) -> None:
    """Streamlines of the mean velocity in the plane."""
    v_r, v_z = (over_seeds(fields, lambda one, k=k: one.velocity[k]) for k in (0, 2))
    x = even(np.concatenate([-v_r.r[::-1], v_r.r]))
    ax.streamplot(
        x, v_r.z, both(v_r.values, -1.0), both(v_z.values), density=0.6, linewidth=0.5, arrowsize=0.5, color="white"
    )


def panels(
    rows: Sequence[Sequence[tuple[str, Map, Sequence[Fields]]]], norm: Any, label: str, flowing: bool = False
) -> "Figure":
    """Maps with one scale of colours; their titles above them."""
    import matplotlib.pyplot as plt
    from matplotlib.cm import ScalarMappable

    top = 1.03 * max(one.z[np.isfinite(one.values).any(axis=0)][-1] for row in rows for _, one, _ in row)
    high = 8 + 0.84 / len(rows[0]) * PAGE / MILLIMETRE * (top + 8) / 198
    figure, axes = plt.subplots(
        len(rows), len(rows[0]), figsize=(PAGE, len(rows) * high * MILLIMETRE), sharex=True, sharey=True, squeeze=False
    )
    for row, line in zip(axes, rows, strict=True):
        for ax, (title, field, fields) in zip(row, line, strict=True):
            draw_map(ax, field, norm, top)
            if flowing:
                streams(ax, fields)
            ax.set_title(title)
    for ax in axes[-1]:
        ax.set_xlabel("x [mm]")
    for ax in axes[:, 0]:
        ax.set_ylabel("z [mm]")
    figure.colorbar(ScalarMappable(norm, "viridis"), ax=axes, shrink=0.5, aspect=40, label=label)
    return figure


def speed(one: Fields) -> np.ndarray:
    """In the plane [mm/s], without the azimuthal part."""
    return 1e3 * np.hypot(one.velocity[0], one.velocity[2])


def drawn(runs: Sequence[Run]) -> Iterator[tuple[str, "Figure"]]:
    """The pictures, by name."""
    from matplotlib.colors import Normalize, PowerNorm

    of = {(shape, f): [r for r in runs if (r.shape, r.f) == (shape, f)] for shape in SHAPES for f in FREQUENCIES}
    phi = Normalize(0.2, 0.65)
    for name, field, norm, label in (
        ("packing", lambda one: one.packing_fraction, phi, "packing fraction $\\phi$"),
        ("velocity", speed, PowerNorm(0.5, 0, 100), "speed in the plane [mm/s]"),
    ):
        rows = []
        for f in FREQUENCIES:
            line = []
            for k in range(3):
                some = [run.moments[k] for run in of["rod-3.3", f] if len(run.moments) == 3]
                when = np.mean([time for time, _ in some])
                fields = [one for _, one in some]
                line.append((f"{f:g} Hz, t = {when:.1f} s", over_seeds(fields, field), fields))
            rows.append(line)
        yield name, panels(rows, norm, label, flowing=name == "velocity")

    def means(shape: str, title: str, field: Callable[[Fields], np.ndarray]) -> list[tuple[str, Map, list[Fields]]]:
        some = {f: [run.mean for run in of[shape, f]] for f in FREQUENCIES}
        return [(f"{title}, {f:g} Hz", over_seeds(fields, field), fields) for f, fields in some.items()]

    axes = means("rod-3.3", "$O_{zz}$", lambda one: one.orientation[2, 2])
    order = means("rod-3.3", "$S$", lambda one: one.nematic_order)
    yield "order", panels([axes, order], Normalize(0.05, 0.8), "$O_{zz}$ and $S$")
    others = [means(shape, SHAPES[shape], lambda one: one.packing_fraction) for shape in ("rod-2.5", "rod-4")]
    yield "lengths", panels(others, phi, "packing fraction $\\phi$")


def draw(files: Sequence[Path], out: Path, to: Path) -> None:
    """Write pictures and numbers."""
    runs = [run for path in files for run in read(path)]
    rows = [{"shape": run.shape, "f_Hz": run.f, "seed": run.seed, **numbers(run)} for run in runs]
    names = list(max(rows, key=len))
    with to.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, names, lineterminator="\n")
        writer.writeheader()
        writer.writerows({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in row.items()} for row in rows)
    print(*table(rows), sep="\n")
    with house():
        for name, figure in drawn(runs):
            (out / f"pongo2022-maps-{name}.png").write_bytes(for_a_screen(figure)[0])


def main() -> None:
    """From the command line."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = words.add_subparsers(dest="verb", required=True)
    one = verbs.add_parser("keep")
    one.add_argument("lab")
    one.add_argument("study")
    one.add_argument("to", type=Path)
    one.add_argument("--backend", default="warp")
    two = verbs.add_parser("draw")
    two.add_argument("files", type=Path, nargs="+")
    two.add_argument("--out", type=Path, required=True)
    two.add_argument("--numbers", type=Path, required=True)
    said = words.parse_args()
    if said.verb == "keep":
        keep(said.lab, said.study, said.to, said.backend)
    else:
        draw(said.files, said.out, said.numbers)


if __name__ == "__main__":
    main()
