"""The figure and the tables of docs/results/pongo2022-grid.md, from Q of each run of studies/pongo2022-grid and
pongo2022-grid-shapes:

labbook export studies/pongo2022-grid.yaml --backend warp --out tables
python benchmarks/pongo_grid.py grid.csv --runs rod-3.3 tables/runs.csv
python benchmarks/pongo_grid.py benchmarks/results/2026-11-26-pongo-grid.csv docs/results/pongo2022-grid.png

The second command keeps of the exports of one shape each what the third reads: how each run ended, and its Q.
"""

import argparse
import csv
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from labbook.report.style import COLOURS, MARKERS, MILLIMETRE, PAGE, for_a_screen, house
from labbook.stats.pooling import student

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHAPES = {
    "sphere": "spheres", "rod-2.5": "rods, $L/d$ = 2.5", "rod-3.3": "rods, $L/d$ = 3.3", "rod-4": "rods, $L/d$ = 4"
}  # fmt: skip
FREQUENCIES = (0.0, 0.16, 0.32, 0.64, 0.96, 1.28)
PLANNED = 3  # runs of a point
COLUMNS = ("shape", "f_Hz", "D_mm", "seed", "outcome", "Q_per_s")


class Run(NamedTuple):
    """A run: f [Hz], D [mm], how it ended, and Q [1/s], NaN where too few grains left in the window."""

    shape: str
    f: float
    d: float
    seed: int
    outcome: str
    rate: float


class Mean(NamedTuple):
    """Q [1/s] over the runs that flowed to their end, with its standard error, NaN of one; how many of all runs these
    are, and how many clogged."""

    rate: float
    error: float
    flowed: int
    clogged: int
    runs: int


def kept(path: Path, shape: str) -> Iterator[Run]:
    """The runs in runs.csv of `labbook export`, which has a row a quantity."""
    found: dict[tuple[str, str, str], Run] = {}
    with path.open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            key = row["container.rotation"], row["container.orifice"], row["seed"]
            f, d, seed = float(key[0]), round(1e3 * float(key[1]), 6), int(key[2])
            if row["quantity"] == "grain_rate":
                found[key] = Run(shape, f, d, seed, row["outcome"], round(float(row["value"] or "nan"), 3))
            else:
                found.setdefault(key, Run(shape, f, d, seed, row["outcome"], math.nan))
    yield from found.values()


def read(path: Path) -> list[Run]:
    """What was kept."""
    with path.open(encoding="utf-8") as file:
        return [
            Run(row["shape"], float(row["f_Hz"]), float(row["D_mm"]), int(row["seed"]), row["outcome"],
                float(row["Q_per_s"] or "nan"))
            for row in csv.DictReader(file)
        ]  # fmt: skip


def mean(runs: Sequence[Run], shape: str, f: float, d: float) -> Mean:
    """Of the runs of one shape, frequency and orifice."""
    some = [run for run in runs if (run.shape, run.f, run.d) == (shape, f, d)]
    rates = np.array([run.rate for run in some if run.outcome == "finished"])
    error = float(rates.std(ddof=1)) / math.sqrt(len(rates)) if len(rates) > 1 else math.nan
    clogged = sum(run.outcome == "clogged" for run in some)
    return Mean(float(rates.mean()) if len(rates) else math.nan, error, len(rates), clogged, len(some))


def orifices(runs: Sequence[Run], shape: str) -> list[float]:
    """All D [mm] of a shape."""
    return sorted({run.d for run in runs if run.shape == shape})


def kappa(runs: Sequence[Run], shape: str, f: float, least: float, most: float) -> tuple[float, float]:
    """Slope of ln Q by D [1/mm] over orifices from `least` to `most` [mm], with the half width of its interval at 95 %:
    a straight line through the runs, whose scatter tells the error."""
    some = [run for run in runs if (run.shape, run.f, run.outcome) == (shape, f, "finished") and least <= run.d <= most]
    x, y = np.array([run.d for run in some]), np.log([run.rate for run in some])
    x, y = x - x.mean(), y - y.mean()
    slope = float(x @ y) / float(x @ x)
    rest = float(np.sum((y - slope * x) ** 2)) / (len(x) - 2)
    return slope, student(0.95, len(x) - 2) * math.sqrt(rest / float(x @ x))


def table(runs: Sequence[Run], shape: str) -> Iterator[str]:
    """Lines of a table of Q: a row a frequency, a column an orifice."""
    columns = orifices(runs, shape)
    yield f"| f [Hz] | {' | '.join(f'{d:g} mm' for d in columns)} |"
    yield "|---" * (len(columns) + 1) + "|"
    for f in FREQUENCIES:
        yield f"| {f:g} | {' | '.join(_cell(mean(runs, shape, f, d)) for d in columns)} |"


def ratios(runs: Sequence[Run], shape: str, d: float) -> tuple[list[float], list[float]]:
    """Q(f)/Q(0) through one orifice by frequency, and its standard errors."""
    some = [mean(runs, shape, f, d) for f in FREQUENCIES]
    found = [one.rate / some[0].rate for one in some]
    parts = [one.error / one.rate for one in some]
    return found, [0.0, *(r * math.hypot(part, parts[0]) for r, part in zip(found[1:], parts[1:], strict=True))]


def _cell(found: Mean) -> str:
    if found.runs == 0:
        return "none ended"
    some = f" ({found.clogged} of {found.runs} clogged)" if found.clogged else ""
    lacking = "" if found.runs == PLANNED else f" ({found.runs} of {PLANNED} ended)"
    if found.flowed == 0:
        return f"clogged{lacking}" if found.clogged == found.runs else f"slower than the time limit{some}{lacking}"
    digits = 1 if found.error < 3 else 0
    alone = f"{found.rate:.0f}"
    said = alone if found.flowed == 1 else f"{found.rate:.{digits}f} ± {found.error:.{digits}f}"
    return said + some + lacking


def drawn(runs: Sequence[Run]) -> "Figure":
    """Q against the orifice by frequency, of each shape; Q(f)/Q(0) by orifice, and by shape."""
    import matplotlib.pyplot as plt

    figure, grid = plt.subplots(2, 3, figsize=(PAGE, 130 * MILLIMETRE))
    flows = dict(zip(("sphere", "rod-3.3", "rod-2.5", "rod-4"), grid[:, :2].flat, strict=True))
    for shape, ax in flows.items():
        for k, f in enumerate(FREQUENCIES):
            some = [mean(runs, shape, f, d) for d in orifices(runs, shape)]
            errors = [0.0 if math.isnan(one.error) else one.error for one in some]
            how = {"color": COLOURS[k], "marker": MARKERS[k], "ms": 3, "lw": 0.8, "label": f"{f:g} Hz"}
            ax.errorbar(orifices(runs, shape), [one.rate for one in some], errors, **how)
            alone = [(d, one.rate) for d, one in zip(orifices(runs, shape), some, strict=True) if one.flowed == 1]
            ax.plot(*np.array(alone).reshape(-1, 2).T, mfc="white", zorder=3, **(how | {"lw": 0, "label": None}))
        ax.set(yscale="log", xlabel="orifice, $D$ [mm]", title=SHAPES[shape], xlim=(40, 74))
    shared = min(ax.get_ylim()[0] for ax in flows.values()), max(ax.get_ylim()[1] for ax in flows.values())
    for ax in flows.values():
        ax.set_ylim(shared)
    by_orifice, by_shape = grid[:, 2]
    for k, d in enumerate((54.0, 60.0, 66.0, 72.0)):
        for shape, filled in (("sphere", "none"), ("rod-3.3", COLOURS[k])):
            label = f"{d:g} mm" if filled != "none" else None
            how = {"color": COLOURS[k], "marker": MARKERS[k], "ms": 3, "mfc": filled, "lw": 0.8, "label": label}
            by_orifice.errorbar(FREQUENCIES, *ratios(runs, shape, d), **how)
    by_orifice.set(title="$L/d$ = 3.3 (open: spheres)")
    for k, shape in enumerate(SHAPES):
        for d, filled in ((66.0, COLOURS[k]), (72.0, "none")):
            label = SHAPES[shape].replace("rods, ", "") if filled != "none" else None
            how = {"color": COLOURS[k], "marker": MARKERS[k], "ms": 3, "mfc": filled, "lw": 0.8, "label": label}
            by_shape.errorbar(FREQUENCIES, *ratios(runs, shape, d), **how)
    by_shape.set(title="66 mm (open: 72 mm)")
    for ax in (by_orifice, by_shape):
        ax.set(ylim=(0, 1.25), xlabel="rotation, $f$ [Hz]", ylabel="$Q(f)/Q(0)$")
    for ax in grid[:, 0]:
        ax.set_ylabel("$Q$ [grains/s]")
    grid[0, 0].legend(title="rotation")
    by_orifice.legend(title="orifice, $D$", ncols=2)
    by_shape.legend(title="shape", ncols=2)
    return figure


def main() -> None:
    """Draw the figure and print the tables; or keep what they need."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", type=Path, help="file with what is kept")
    parser.add_argument("picture", nargs="?", type=Path)
    parser.add_argument("--runs", nargs=2, action="append", metavar=("SHAPE", "RUNS_CSV"), help="exports to keep there")
    given = parser.parse_args()
    if given.runs:
        with given.source.open("w", encoding="utf-8", newline="") as file:
            rows = csv.writer(file, lineterminator="\n")
            rows.writerow(COLUMNS)
            for shape, path in given.runs:
                rows.writerows((*run[:-1], "" if math.isnan(run.rate) else run.rate) for run in kept(Path(path), shape))
        return
    runs = read(given.source)
    for shape in SHAPES:
        print(shape, *table(runs, shape), "", sep="\n")
    spans = (
        ("rod-3.3", 48, 60), ("rod-3.3", 48, 72), ("rod-2.5", 48, 66), ("rod-2.5", 48, 72), ("rod-4", 54, 66),
        ("rod-4", 54, 72), ("sphere", 48, 72),
    )  # fmt: skip
    for f in FREQUENCIES:
        said = [
            f"{shape} {least} to {most} mm {slope:.3f} +- {half:.3f}"
            for shape, least, most in spans
            for slope, half in (kappa(runs, shape, f, least, most),)
        ]
        print(f"f = {f:g} Hz: kappa [1/mm] of {', '.join(said)}")
    for shape in SHAPES:
        for d in orifices(runs, shape):
            found, errors = ratios(runs, shape, d)
            said = [f"{r:.3f} +- {e:.3f}" for r, e in zip(found, errors, strict=True)]
            print(f"Q(f)/Q(0) of {shape} through {d:g} mm: {', '.join(said)}")
    if given.picture:
        with house():
            given.picture.write_bytes(for_a_screen(drawn(runs))[0])


if __name__ == "__main__":
    main()
