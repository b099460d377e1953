"""The figures of docs/accuracy.md, from what `labbook bench accuracy` measured:

labbook bench accuracy --out benchmarks/results/2026-11-23-accuracy-contacts.json
python benchmarks/accuracy.py benchmarks/results/2026-11-23-accuracy-contacts.json docs
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from labbook.report.style import COLOURS, FAINT, MARKERS, MILLIMETRE, PAGE, for_a_screen, house

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


def _slope(ax: "Axes", at: float, error: float, order: str) -> None:
    """A guide to the eye: an error that falls with this order."""
    power = float(order) if "/" not in order else int(order[0]) / int(order[-1])
    ax.loglog([at / 2, 2 * at], [error * 2**power, error / 2**power], color=FAINT, lw=0.8, ls="--")
    start = at / 2, error * 2**power
    ax.annotate(f"order {order}", start, (2, 2), textcoords="offset points", color=FAINT, fontsize=6, va="bottom")


def main() -> None:
    """Write both figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("figures", type=Path, help="JSON that `labbook bench accuracy --out` wrote")
    parser.add_argument("folder", type=Path, help="where to write the figures")
    given = parser.parse_args()
    measured = json.loads(given.figures.read_text(encoding="utf-8"))
    with house():
        for name, figure in (("contacts", contacts(measured["contacts"])), ("beds", beds(measured["beds"]))):
            path = given.folder / f"accuracy-{name}.png"
            path.write_bytes(for_a_screen(figure)[0])
            print(path, f"{path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
