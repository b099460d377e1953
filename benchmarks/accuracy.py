"""The figures of docs/accuracy.md, from what `labbook bench accuracy` measured:

labbook bench accuracy --out benchmarks/results/2026-11-23-accuracy-contacts.json
python benchmarks/accuracy.py benchmarks/results/2026-11-23-accuracy-contacts.json docs

and those of flow rates against stiffness, step, precision and cost, from the runs of the calibration:

python benchmarks/accuracy.py --runs benchmarks/results/2026-11-27-calibration docs
"""

import argparse
import csv
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from calibration import STUDIES, scenes

import labbook
from labbook.report.style import COLOURS, DASHES, FAINT, MARKERS, MILLIMETRE, PAGE, for_a_screen, house
from labbook.results.calibrating import are_mixed
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


SETTINGS = {"finest": 0, "long step": 1, "stiffness 0.1": 2, "stiffness 0.01": 3}
"""Numbers of the settings of accuracy-hopper and accuracy-hole that start from the same packings."""
SOFT = {
    "friction": ("accuracy-hopper", {3: "0.2", 4: "0.8"}),
    "restitution": ("accuracy-hopper", {5: "0.6", 6: "0.9"}),
    "rolling friction": ("accuracy-hopper", {7: "0", 8: "0.1"}),
    "slot, D/d": ("accuracy-hopper", {1: "10", 2: "15"}),
    "slot, hertz-printed, D/d": ("accuracy-hopper", {9: "8", 10: "12", 11: "20"}),
    "hole, D/d": ("accuracy-hole", {1: "8", 2: "10", 3: "12"}),
}
"""Panels of the figure of softness: study, and numbers of its scenes with what tells them apart."""
FAN = ("accuracy-hopper", 2)
FAN_STEP = 0.021
"""dt/t_c of Fan et al., 0.1 of the Rayleigh time."""


@dataclass(frozen=True)
class Change:
    """Change of ln W by a setting, bed by bed: mean and half width of its 95 % interval."""

    mean: float
    width: float

    @property
    def percent(self) -> float:
        """Change of W [%]."""
        return 100 * math.expm1(self.mean)

    @property
    def half_width(self) -> float:
        """Half width of the 95 % interval of the change of W [%]."""
        return 100 * self.width * math.exp(self.mean)


@dataclass(frozen=True)
class Scene:
    """Runs of one scene of the calibration. `rates`: ln W by setting and bed; `points`: one a setting."""

    points: Sequence[Any]
    rates: dict[int, dict[str, float]]

    def change(self, setting: int, finest: int = 0) -> Change:
        """Change from the finest setting, in the beds that both have."""
        first, other = self.rates[finest], self.rates[setting]
        change = np.array([other[bed] - first[bed] for bed in other if bed in first])
        error = float(np.std(change, ddof=1)) / math.sqrt(len(change))
        return Change(float(np.mean(change)), student(0.95, len(change) - 1) * error)

    def unpaired(self, setting: int, finest: int = 0) -> Change:
        """Change from the finest setting, whose beds are others."""
        first, other = (np.array(list(self.rates[k].values())) for k in (finest, setting))
        variances = [float(np.var(one, ddof=1)) / len(one) for one in (first, other)]
        return Change(float(np.mean(other) - np.mean(first)), 1.96 * math.sqrt(sum(variances)))

    def scatter(self, setting: int) -> float:
        """Standard deviation of ln W between runs."""
        return float(np.std(list(self.rates[setting].values()), ddof=1))


def scene(folder: Path, study: str, number: int) -> Scene:
    """The runs of a scene that count, by bed or, where each run has its own, by seed."""
    points = scenes(labbook.load(STUDIES / f"{study}.yaml"))[number - 1]
    rates: dict[int, dict[str, float]] = {}
    with (folder / f"{study}-{number}.csv").open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            if row["W_g_per_s"]:
                rates.setdefault(int(row["setting"]), {})[row["bed"]] = math.log(float(row["W_g_per_s"]))
    return Scene(points, rates)


def softness(folder: Path) -> "Figure":
    """Change of W against the stiffness during the discharge, from beds that were filled at the stated one."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 3, figsize=(PAGE, 96 * MILLIMETRE), sharex=True, sharey=True)
    for ax, (title, (study, numbers)) in zip(axes.flat, SOFT.items(), strict=True):
        for k, (number, name) in enumerate(numbers.items()):
            of = scene(folder, study, number)
            stiff = [of.points[setting].numerics.stiffness_scale for setting in (2, 3)]
            changes = [of.change(setting) for setting in (2, 3)]
            x = np.array([1.0, *stiff]) * 1.06 ** (k - (len(numbers) - 1) / 2)
            y = np.array([0.0, *(one.percent for one in changes)])
            bars = [0.0, *(one.half_width for one in changes)]
            ax.errorbar(x, y, bars, color=COLOURS[k], marker=MARKERS[k], linestyle=DASHES[k], label=name)
        ax.axhline(0, color=FAINT, linewidth=0.6, zorder=0)
        ax.set_xscale("log")
        ax.set_title(title)
        ax.legend(*ax.get_legend_handles_labels(), loc="lower left")
    axes[0, 0].set_xlim(1.6, 0.006)
    axes[0, 0].set_xticks([1, 0.1, 0.01], ["1", "0.1", "0.01"])
    for ax in axes[-1]:
        ax.set_xlabel("stiffness, parts of the stated one")
    for ax in axes[:, 0]:
        ax.set_ylabel("change of W [%]")
    return figure


def steps(folder: Path) -> "Figure":
    """Change of W by a long step, and by the precision `mixed`, a row a scene."""
    import matplotlib.pyplot as plt

    rows = [scene(folder, "accuracy-steps", number) for number in range(1, 13)]
    rows = [scene(folder, "accuracy-outlets", number) for number in (1, 2, 3)] + rows
    precise = [scene(folder, "accuracy-precision", number) for number in range(1, 10)]
    figure, (left, right) = plt.subplots(1, 2, figsize=(PAGE, 92 * MILLIMETRE))
    rows, precise = (sorted(some, key=_order) for some in (rows, precise))
    _forest(left, [(_named(one), one.change(1)) for one in rows])
    left.set_title("step of 0.06 instead of 0.02 $t_c$")
    _forest(right, [(_named(one), one.unpaired(*_in_mixed(one))) for one in precise])
    right.set_title("precision mixed instead of double")
    for ax in (left, right):
        ax.set_xlabel("change of W [%]")
        ax.set_xlim(-2.2, 2.2)
    return figure


def _forest(ax: "Axes", rows: Sequence[tuple[str, Change]]) -> None:
    """Changes with 95 % intervals, one below the other; below a line their mean."""
    for place, (_, change) in enumerate(rows):
        ax.errorbar(change.percent, place, xerr=change.half_width, color=COLOURS[0], marker="o", markersize=3)
    weights = np.array([change.width**-2 for _, change in rows])
    mean = float(np.average([change.mean for _, change in rows], weights=weights))
    width = 100 / math.sqrt(float(weights.sum()))
    ax.errorbar(100 * mean, len(rows) + 0.4, xerr=width, color=COLOURS[1], marker="D", markersize=4)
    ax.axhline(len(rows) - 0.3, color=FAINT, linewidth=0.6)
    ax.axvline(0, color=FAINT, linewidth=0.6, zorder=0)
    ax.set_yticks([*range(len(rows)), len(rows) + 0.4], [*(name for name, _ in rows), "weighted mean"])
    ax.tick_params(axis="y", length=0)
    ax.invert_yaxis()


def _named(one: Scene) -> str:
    """The scene by its outlet and what it has other than usual."""
    here = one.points[0].scene
    contact, outlet = here.contact, here.container.orifice / here.grains.diameter
    usual = (("friction", 0.5), ("restitution", 0.2), ("rolling_friction", 0.01))
    other = [f"{name.replace('_', ' ')} {getattr(contact, name):g}" for name, v in usual if getattr(contact, name) != v]
    law = [] if contact.law == "hertz-mindlin" else [contact.law]
    return ", ".join([f"D/d = {outlet:g}", *law, *other])


def _order(one: Scene) -> tuple[str, bool, float]:
    """Scenes of one law together, first those that differ in the outlet only."""
    here = one.points[0].scene
    return here.contact.law, "," in _named(one), here.container.orifice


def _in_mixed(one: Scene) -> tuple[int, int]:
    """Numbers of the settings with flow and filling in `mixed` and in `double`."""
    made = {are_mixed(point): number for number, point in enumerate(one.points)}
    return made[(True, True)], made[(False, False)]


def cost(folder: Path) -> "Figure":
    """Error of W that runs with each setting leave, against their steps, in a hopper of Fan et al."""
    import matplotlib.pyplot as plt

    of = scene(folder, *FAN)
    usual = of.points[0].numerics.dt / 0.02 * FAN_STEP
    price = np.geomspace(0.5, 1000, 400)
    figure, ax = plt.subplots(figsize=(PAGE * 0.75, 78 * MILLIMETRE))
    ends: list[tuple[float, str, str]] = []
    for k, (name, setting) in enumerate(SETTINGS.items()):
        runs = price * of.points[setting].numerics.dt / usual
        change = Change(0.0, 0.0) if setting == 0 else of.change(setting)
        error = 100 * (abs(change.mean) + change.width + 1.96 * of.scatter(setting) / np.sqrt(np.maximum(runs, 2)))
        ax.loglog(price, np.where(runs >= 2, error, np.nan), color=COLOURS[k], linestyle=DASHES[k])
        ends.append((float(error[-1]), name, COLOURS[k]))
    level = 0.0
    for error, name, colour in sorted(ends):
        level = max(error, 1.25 * level)
        ax.annotate(
            name, (price[-1], error), (1.02, level), textcoords=("axes fraction", "data"), color=colour, va="center"
        )
    ax.set_xlim(price[0], price[-1])
    ax.set_xlabel("steps, in runs at the step of Fan et al. (0.021 $t_c$)")
    ax.set_ylabel("error of W at 95 % [%]")
    ax.set_yticks([0.2, 0.5, 1, 2, 5, 10], ["0.2", "0.5", "1", "2", "5", "10"])
    ax.minorticks_off()
    return figure


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
    parser.add_argument("--runs", type=Path, help="folder that `benchmarks/calibration.py run` wrote")
    parser.add_argument("folder", type=Path, help="where to write the figures")
    given = parser.parse_args()
    with house():
        drawn = []
        if given.figures:
            measured = json.loads(given.figures.read_text(encoding="utf-8"))
            drawn += [("contacts", contacts(measured["contacts"])), ("beds", beds(measured["beds"]))]
        if given.runs:
            drawn += [(draw.__name__, draw(given.runs)) for draw in (softness, steps, cost)]
        for name, figure in drawn:
            path = given.folder / f"accuracy-{name}.png"
            path.write_bytes(for_a_screen(figure)[0])
            print(path, f"{path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
