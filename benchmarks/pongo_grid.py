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
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.stats import f as fisher
from scipy.stats import linregress

from labbook.report.style import COLOURS, MARKERS, MILLIMETRE, PAGE, for_a_screen, house
from labbook.stats import Pooled, pool
from labbook.stats.linear import slopes
from labbook.stats.pooling import student
from labbook.stats.ratio import independent_ratio

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHAPES = {
    "sphere": "spheres", "rod-2.5": "rods, $L/d$ = 2.5", "rod-3.3": "rods, $L/d$ = 3.3", "rod-4": "rods, $L/d$ = 4"
}  # fmt: skip
FREQUENCIES = (0.0, 0.16, 0.32, 0.64, 0.96, 1.28)
COLUMNS = ("shape", "f_Hz", "D_mm", "seed", "outcome", "Q_per_s")


class Run(NamedTuple):
    """A run: f [Hz], D [mm], how it ended, and Q [1/s], NaN if it clogged, or if too few grains left in the window."""

    shape: str
    f: float
    d: float
    seed: int
    outcome: str
    rate: float

    @property
    def flowed(self) -> bool:
        """Whether grains left until the window ended, or until the time limit if that came first: Q is known then."""
        return self.outcome != "clogged" and not math.isnan(self.rate)


class Mean(NamedTuple):
    """Q [1/s] pooled over the runs that flowed, if any did; of how many runs, how many clogged, and how many were
    stopped by the time limit."""

    rate: Pooled | None
    runs: int
    clogged: int
    stopped: int


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
    rates, ends = [run.rate for run in some if run.flowed], [run.outcome for run in some]
    return Mean(pool(rates) if rates else None, len(some), ends.count("clogged"), ends.count("time-limit"))


def orifices(runs: Sequence[Run], shape: str) -> list[float]:
    """All D [mm] of a shape."""
    return sorted({run.d for run in runs if run.shape == shape})


def slope(runs: Sequence[Run], shape: str, f: float, least: float, most: float, power: bool = False) -> str:
    """Slope of ln Q by D [1/mm], or by ln D for a `power`, over orifices from `least` to `most` [mm], with the half
    width of its interval at 95 %: a straight line through the runs, whose scatter tells the error."""
    some = [run for run in runs if (run.shape, run.f) == (shape, f) and run.flowed and least <= run.d <= most]
    d = np.array([run.d for run in some])
    line: Any = linregress(np.log(d) if power else d, np.log([run.rate for run in some]))
    half = student(0.95, len(some) - 2) * line.stderr
    return f"{shape} {least} to {most} mm {line.slope:.{2 if power else 3}f} +- {half:.{2 if power else 3}f}"


RODS = {"rod-2.5": (2.5, 66.0), "rod-3.3": (10 / 3, 60.0), "rod-4": (4.0, 66.0)}
"""Rods: L/d, and the largest orifice [mm] of the lines through ln Q, which begin at 48 mm."""
_TURNING = FREQUENCIES[1:]


def _on_lines(runs: Sequence[Run], shape: str) -> list[Run]:
    most = RODS[shape][1]
    return [run for run in runs if run.shape == shape and run.f > 0 and run.flowed and 48 <= run.d <= most]


def common_slope(runs: Sequence[Run], shape: str) -> str:
    """kappa [1/mm] of parallel lines through ln Q over turning bottoms, a level for each f, at 95 %; p of parallel
    lines against lines with a slope each (F), and the slope of kappa by f [1/mm/Hz] with its standard error."""
    some = _on_lines(runs, shape)
    y, levels = np.log([run.rate for run in some]), np.array([[run.f == f for f in _TURNING] for run in some], float)
    d, f = np.array([run.d for run in some]), np.array([run.f for run in some])
    columns = (d[:, None], np.column_stack([d, d * f]), levels * d[:, None])
    (one, error, left, _), (two, errors, _, _), (_, _, least, freedom) = (_fit(levels, more, y) for more in columns)
    test = (left - least) / (len(_TURNING) - 1) / (least / freedom)
    p = fisher.sf(test, len(_TURNING) - 1, freedom)
    half = student(0.95, len(y) - len(_TURNING) - 1) * error[0]
    return (
        f"{shape}: kappa {one[0]:.4f} +- {half:.4f}, equal at all f: p = {p:.2g}, by f {two[1]:.4f} +- {errors[1]:.4f}"
    )


def _fit(levels: np.ndarray, more: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, float, int]:
    """Coefficients of `more` beside the levels, their standard errors, sum of squares and degrees of freedom."""
    x = np.hstack([levels, more])
    inverse = np.linalg.inv(x.T @ x)
    every = inverse @ x.T @ y
    left, freedom, k = float(np.sum((y - x @ every) ** 2)), len(y) - x.shape[1], levels.shape[1]
    return every[k:], np.sqrt(left / freedom * np.diag(inverse)[k:]), left, freedom


def bent(runs: Sequence[Run], shape: str, f: float) -> float:
    """p of a straight line through ln Q against a mean for each orifice (F)."""
    some = [run for run in _on_lines(runs, shape) if run.f == f]
    d, y = np.array([run.d for run in some]), np.log([run.rate for run in some])
    line: Any = linregress(d, y)
    left = float(np.sum((y - line.intercept - line.slope * d) ** 2))
    within = float(sum(np.sum((y[d == one] - y[d == one].mean()) ** 2) for one in set(d)))
    several, freedom = len(set(d)), len(y) - len(set(d))
    return float(fisher.sf((left - within) / (several - 2) / (within / freedom), several - 2, freedom))


def trends(runs: Sequence[Run], least: float) -> Iterator[str]:
    """Slopes of one plane by L/d and D [mm] at 95 %, through all rods and orifices from `least` [mm] on: of the rise
    ln(Q(1.28 Hz)/Q_min), of the same over the mean of 0.16 and 0.32 Hz, and of the drop ln(Q(0)/Q_min)."""
    rise, drop, fixed = [], [], []
    for shape, (length, _) in RODS.items():
        for d in (one for one in orifices(runs, shape) if one >= least):
            rest, *turning = (one.rate and one.rate.value for one in (mean(runs, shape, f, d) for f in FREQUENCIES))
            known = [one for one in turning if one is not None]
            if len(known) == len(turning):
                rise.append((length, d, math.log(known[-1] / min(known[:-1]))))
                fixed.append((length, d, math.log(known[-1] / (known[0] + known[1]) * 2)))
            if rest is not None and known:
                drop.append((length, d, math.log(rest / min(known))))
    for name, rows in (("rise over the smallest", rise), ("rise over 0.16 and 0.32 Hz", fixed), ("drop", drop)):
        by_length, by_width = slopes([row[:2] for row in rows], [row[2] for row in rows])
        said = (
            f"{one.value:.4f} +- {one.error:.4f} ({one.low:.4f} to {one.high:.4f})" for one in (by_length, by_width)
        )
        yield f"ln {name}, {len(rows)} cells from {least:g} mm: by L/d, by mm: {', '.join(said)}"


def table(runs: Sequence[Run], shape: str) -> Iterator[str]:
    """Lines of a table of Q: a row a frequency, a column an orifice."""
    columns = orifices(runs, shape)
    yield f"| f [Hz] | {' | '.join(f'{d:g} mm' for d in columns)} |"
    yield "|---" * (len(columns) + 1) + "|"
    for f in FREQUENCIES:
        yield f"| {f:g} | {' | '.join(_cell(mean(runs, shape, f, d)) for d in columns)} |"


def ratios(runs: Sequence[Run], shape: str, d: float) -> tuple[list[float], list[float]]:
    """Q(f)/Q(0) through one orifice by frequency, and its standard errors; empty where no bed flows at rest."""
    rest, *turning = (mean(runs, shape, f, d).rate for f in FREQUENCIES)
    if rest is None:
        return [], []
    found = [None if one is None else independent_ratio(one, rest) for one in turning]
    pairs = [(1.0, 0.0), *((math.nan, math.nan) if one is None else (one.value, one.error) for one in found)]
    return [value for value, _ in pairs], [error for _, error in pairs]


def _cell(found: Mean) -> str:
    if found.runs == 0:
        return "none ended"
    if found.clogged == found.runs:
        return "clogged"
    ends = ((found.clogged, "clogged"), (found.stopped, "stopped"))
    told = ", ".join(f"{count} of {found.runs} {how}" for count, how in ends if count)
    some = f" ({told})" if told else ""
    if found.rate is None:
        return f"slow{some}"
    rate, error = found.rate.value, found.rate.error
    digits = 1 if error < 3 else 0
    return (f"{rate:.0f}" if found.rate.n == 1 else f"{rate:.{digits}f} ± {error:.{digits}f}") + some


def drawn(runs: Sequence[Run]) -> "Figure":
    """Q against the orifice by frequency, of each shape; Q(f)/Q(0) by orifice, and by shape."""
    import matplotlib.pyplot as plt

    figure, grid = plt.subplots(2, 3, figsize=(PAGE, 130 * MILLIMETRE))
    flows = dict(zip(("sphere", "rod-3.3", "rod-2.5", "rod-4"), grid[:, :2].flat, strict=True))
    for shape, ax in flows.items():
        for k, f in enumerate(FREQUENCIES):
            flowed = [(d, q) for d in orifices(runs, shape) if (q := mean(runs, shape, f, d).rate)]
            x, y = [d for d, _ in flowed], [q.value for _, q in flowed]
            errors = [0.0 if q.n == 1 else q.error for _, q in flowed]
            how = {"color": COLOURS[k], "marker": MARKERS[k], "ms": 3}
            ax.errorbar(x, y, errors, lw=0.8, label=f"{f:g} Hz", **how)
            ax.plot(x, y, lw=0, mfc="white", zorder=3, markevery=[q.n == 1 for _, q in flowed], **how)
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
        ("rod-3.3", 48, 60), ("rod-3.3", 48, 72), ("rod-2.5", 48, 66), ("rod-2.5", 48, 72), ("rod-4", 48, 66),
        ("rod-4", 48, 72), ("sphere", 48, 72),
    )  # fmt: skip
    powers = (("rod-3.3", 66, 72), ("rod-2.5", 66, 72), ("rod-4", 66, 72), ("sphere", 48, 72), ("sphere", 66, 72))
    for f in FREQUENCIES:
        said = [slope(runs, shape, f, least, most) for shape, least, most in spans]
        print(f"f = {f:g} Hz: kappa [1/mm] of {', '.join(said)}")
        said = [slope(runs, shape, f, least, most, power=True) for shape, least, most in powers]
        print(f"f = {f:g} Hz: exponent of D of {', '.join(said)}")
    for shape in SHAPES:
        for d in orifices(runs, shape):
            found, errors = ratios(runs, shape, d)
            said = [f"{r:.3f} +- {e:.3f}" for r, e in zip(found, errors, strict=True)]
            print(f"Q(f)/Q(0) of {shape} through {d:g} mm: {', '.join(said)}")
    for shape in RODS:
        print(common_slope(runs, shape))
        print(f"  straight: p = {', '.join(f'{bent(runs, shape, f):.2g}' for f in _TURNING)}")
        print("  at rest, no bed clogged:", slope(runs, shape, 0.0, 54 if shape == "rod-4" else 60, 72))
    for least in (48.0, 54.0, 60.0):
        print(*trends(runs, least), sep="\n")
    if given.picture:
        with house():
            given.picture.write_bytes(for_a_screen(drawn(runs))[0])


if __name__ == "__main__":
    main()
