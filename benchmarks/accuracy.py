"""The figures of docs/accuracy.md, from what `labbook bench accuracy` measured:

labbook bench accuracy --out benchmarks/results/2026-11-23-accuracy-contacts.json
python benchmarks/accuracy.py benchmarks/results/2026-11-23-accuracy-contacts.json docs

and, of flow rates against numerics, from the runs of studies/accuracy-hopper, accuracy-hole and accuracy-rods:

python benchmarks/accuracy.py --runs benchmarks/results/2026-11-23-accuracy-runs-h200.csv \\
    --rods benchmarks/results/2026-11-23-rods-runs-h200.csv docs
"""

import argparse
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from labbook.report.style import COLOURS, FAINT, MARKERS, MILLIMETRE, PAGE, for_a_screen, house
from labbook.stats.pooling import student

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LAWS = ("hertz-mindlin", "hertz-printed", "hertz-liggghts", "hertz-lammps", "linear")
PANELS = ("head-on, elastic", "head-on, e = 0.5", "oblique, e = 0.5", "rod end at a wall")
TITLES = "spheres, elastic, head-on", "spheres, e = 0.5, head-on", "sphere at a wall, oblique", "end of a rod at a wall"


def contacts(rows: Sequence[dict[str, Any]]) -> "Figure":
    """Errors of four impacts against steps a collision: a line a law, filled in double precision, open in mixed."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 4, figsize=(PAGE, 62 * MILLIMETRE), sharex=True, sharey=True)
    for ax, situation, title in zip(axes, PANELS, TITLES, strict=True):
        for row in (row for row in rows if row["situation"] == situation):
            which, double = LAWS.index(row["law"]), row["precision"] == "double"
            how = {"color": COLOURS[which], "marker": MARKERS[which], "markersize": 3}
            if double:
                ax.loglog(row["steps"], row["error"], label=row["law"], lw=1, **how)
            else:
                ax.loglog(row["steps"], row["error"], lw=0, mfc="none", **{**how, "markersize": 6}, mew=0.6)
        ax.set_title(title)
        ax.set_xlabel("steps a collision, t$_c$/dt")
    for ax, orders in zip(
        axes, ((("5/2", 1e-8), ("2", 2e-4)), (("5/4", 4e-6), ("1", 5e-3)), (("1", 5e-5),), (("1", 2e-5),)), strict=True
    ):
        for order, at in orders:
            _slope(ax, 160, at, order)
    axes[0].set_ylabel("error, parts of the speed")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=5)
    return figure


def beds(rows: Sequence[dict[str, Any]]) -> "Figure":
    """Errors of positions and velocities of beds against steps a collision."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(PAGE, 62 * MILLIMETRE), sharex=True)
    names = list(dict.fromkeys(row["bed"] for row in rows))
    for row in rows:
        which, double = names.index(row["bed"]), row["precision"] == "double"
        how = {"color": COLOURS[which], "marker": MARKERS[which], "markersize": 4 if double else 7}
        how |= {"mfc": None if double else "none", "lw": 1 if double else 0}
        label = row["bed"] if double else None
        for ax, key, most in zip(axes, ("position", "velocity"), ("farthest", "fastest"), strict=True):
            ax.loglog(row["steps"], row[key], label=label, **how)
            if double:
                ax.loglog(row["steps"], row[most], color=COLOURS[which], ls=":", lw=0.8)
    for ax, what in zip(axes, ("position, d", "velocity, √(g d)"), strict=True):
        ax.set_ylabel(f"error of {what}")
        ax.set_xlabel("steps a collision, t$_c$/dt")
    _slope(axes[0], 100, 2e-8, "1")
    for ax in axes:
        ax.set_xticks(rows[0]["steps"], [str(n) for n in rows[0]["steps"]])
        ax.minorticks_off()
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


SCENE = ["outlet", "law", "orifice_mm", "friction", "restitution", "rolling_friction"]
SETTING = ["stiffness_scale", "dt_us", "filled_stiffness_scale", "filled_dt_us"]
FAN = "outlet == 'slot' and law == 'hertz-mindlin' and orifice_mm == 45"
RODS = "study == 'accuracy-rods' and outcome == 'finished'"
FINEST = {"hertz": 0.02, "rods": 0.015}
"""The first and finest setting of the studies, dt/t_c."""
SOFTENED = {"hertz": 2 / 5, "rods": 1 / 2}
"""A collision lasts as one over this power of the stiffness, by Hertz's law and by the linear one."""
PAPERS = {"hertz": 0.021, "rods": 1 / 122.9}
"""dt/t_c of Fan et al. (0.1 of the Rayleigh time) and of Pongo et al. (1 us)."""


@dataclass(frozen=True)
class Setting:
    """One setting of one scene: dt over the t_c of the stated stiffness and over its own, stiffness scales, change of
    ln W against the finest with the half width of its interval at 95 %, and the scatter of ln W between its runs."""

    dt: float
    step: float
    scale: float
    filled: float
    change: float
    width: float
    scatter: float

    def after(self, runs: np.ndarray) -> np.ndarray:
        """|bias| with the half width of its interval, and that of the mean of so many runs."""
        return abs(self.change) + self.width + 1.96 * self.scatter / np.sqrt(runs)


def settings(runs: Any, kind: str) -> list[Setting]:
    """Those of one scene, the finest first, from a row a run. Seed by seed, since those that fill alike share beds."""
    import pandas as pd

    finest, power = FINEST[kind], SOFTENED[kind]

    by = {key: pd.Series(np.log(some.W_g_per_s.to_numpy()), some.seed) for key, some in runs.groupby(SETTING)}
    first = min((key for key in by if key[0] == 1), key=lambda key: key[1])
    t_c = first[1] / finest
    found = []
    for key, one in by.items():
        change = (one - by[first]).dropna()
        width = student(0.95, len(change) - 1) * float(np.std(change, ddof=1)) / math.sqrt(len(change))
        dt, scale = key[1] / t_c, key[0]
        found.append(
            Setting(dt, dt * scale**power, scale, key[2], float(np.mean(change)), width, float(np.std(one, ddof=1)))
        )
    return sorted(found, key=lambda one: (-one.scale, one.step, -one.filled))


def _scenes(runs: Any) -> Iterator[tuple[str, Any]]:
    for (outlet, law, orifice, friction, restitution, rolling), some in runs.groupby(SCENE):
        usual = {"µ": (friction, 0.5), "e": (restitution, 0.2), "µ$_r$": (rolling, 0.01)}
        other = [f"{name} = {value:g}" for name, (value, common) in usual.items() if value != common]
        yield ", ".join([outlet, law.removeprefix("hertz-"), f"{orifice / 3:.0f} d", *other]), some


def flow(runs: Any, rods: Any) -> "Figure":
    """What settings do to W, and what error a number of runs with each leaves at what cost; from a row a run."""
    import matplotlib.pyplot as plt

    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(PAGE, 78 * MILLIMETRE))
    for index, (name, some) in enumerate([*_scenes(runs), ("rods, hole, 3 L", rods)]):
        of = settings(some, "rods" if some is rods else "hertz")
        alike = sorted((one for one in of if one.filled == 1 and one.scale < 1), key=lambda one: (one.scale, one.step))
        at = [one.scale * 1.04 ** (index - 6) for one in alike]
        values, widths = ([100 * getattr(one, key) for one in alike] for key in ("change", "width"))
        colour, shape = COLOURS[index % len(COLOURS)], MARKERS[index % len(MARKERS)]
        filled = colour if index < len(COLOURS) else "none"
        left.errorbar(at, values, widths, fmt=shape, color=colour, ms=3, lw=0.7, mfc=filled, label=name)
    left.set_xscale("log")
    left.axhline(0, color=FAINT, lw=0.6, zorder=0)
    left.set_xlabel("stiffness, parts of the stated one")
    left.set_ylabel("change of W [%]")
    _front(middle, settings(runs.query(FAN), "hertz"), PAPERS["hertz"], "Fan et al., D/d = 15")
    _front(right, settings(rods, "rods"), PAPERS["rods"], "rods, D = 3 L")
    middle.set_ylabel("error of W at 95 % [%]")
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower left", ncols=4, fontsize=5)
    return figure


def _front(ax: "Axes", found: Sequence[Setting], paper: float, title: str) -> None:
    """Error against cost, in steps of one run at the paper's step; what no other setting undercuts is drawn wide."""
    cost = np.geomspace(0.3, 1000, 400)
    errors = []
    for index, one in enumerate(found):
        runs = cost * one.dt / paper
        errors.append(np.where(runs >= 2, 100 * one.after(np.maximum(runs, 2)), np.nan))
        name = f"{one.scale:g}{'' if one.filled == 1 else ' filled'}, {one.step:.2g} t$_c$"
        dashes = "-" if index < len(COLOURS) else "--"
        ax.loglog(cost, errors[-1], color=COLOURS[index % len(COLOURS)], lw=0.8, label=name, ls=dashes)
    unbiased = 196 * found[0].scatter / np.sqrt(cost)
    ax.loglog(cost, np.where(cost >= 2, unbiased, np.nan), color="k", lw=0.8, ls=":", label="the paper's, if unbiased")
    ax.loglog(cost, np.nanmin(errors, axis=0), color=FAINT, lw=4, alpha=0.35, zorder=0)
    ax.set_xlabel("steps, in runs at the paper's step")
    ax.set_title(title)
    ax.legend(fontsize=4.5, frameon=False, handlelength=1.2, labelspacing=0.2)


def _slope(ax: "Axes", at: float, error: float, order: str) -> None:
    """A guide to the eye: an error that falls with this order."""
    power = float(order) if "/" not in order else int(order[0]) / int(order[-1])
    ax.loglog([at / 2, 2 * at], [error * 2**power, error / 2**power], color=FAINT, lw=0.8, ls="--")
    start = at / 2, error * 2**power
    ax.annotate(f"order {order}", start, (2, 2), textcoords="offset points", color=FAINT, fontsize=6, va="bottom")


def main() -> None:
    """Write the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("figures", type=Path, nargs="?", help="JSON that `labbook bench accuracy --out` wrote")
    parser.add_argument("--runs", type=Path, help="CSV of W of each run of spheres")
    parser.add_argument("--rods", type=Path, help="CSV of W of each run of rods")
    parser.add_argument("folder", type=Path, help="where to write the figures")
    given = parser.parse_args()
    with house():
        drawn = []
        if given.figures:
            measured = json.loads(given.figures.read_text(encoding="utf-8"))
            drawn += [("contacts", contacts(measured["contacts"])), ("beds", beds(measured["beds"]))]
        if given.runs and given.rods:
            import pandas as pd

            drawn.append(("flow", flow(pd.read_csv(given.runs), pd.read_csv(given.rods).query(RODS))))
        for name, figure in drawn:
            path = given.folder / f"accuracy-{name}.png"
            path.write_bytes(for_a_screen(figure)[0])
            print(path, f"{path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
