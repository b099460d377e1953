"""Q(D) of holes on logarithmic axes: there a power is a line above, an exponential below (Pongo et al. 2022, Figs 4 and
5)."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from labbook.report.style import FAINT, MILLIMETRE, PAGE, house, look
from labbook.results import display
from labbook.results.rotation import FLOW, ROTATION, shape_of
from labbook.results.series import Series

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_LAWS = ("power", "exponential")


def flow_scaling(series: Sequence[Series]) -> "Figure":
    """Q against D, a column a frequency of rotation: both axes logarithmic above, only Q below; side by side, if there
    is one column.

    Lines: the fitted power and exponential; bars: one standard error; grey: the slope 5/2.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

    turns = list(dict.fromkeys(one.at.get(ROTATION) for one in series))
    names = list(dict.fromkeys(map(_name, series)))
    with house():
        alone = len(turns) == 1
        figure = Figure(figsize=(PAGE, (74 if alone else 116) * MILLIMETRE))
        axes = figure.subplots(*((1, 2) if alone else (2, len(turns))), sharey=True, squeeze=False).reshape(2, -1)
        for column, turn in enumerate(turns):
            if turn is not None:
                axes[0, column].set_title(display.setting(ROTATION, turn))
            for one in (one for one in series if one.at.get(ROTATION) == turn):
                for ax, law in zip(axes[:, column], _LAWS, strict=True):
                    _draw(ax, one, law, names.index(_name(one)))
            _slope(axes[0, column])
            axes[0, column].set_xscale("log")
            axes[0, column].xaxis.set_major_locator(LogLocator(subs=(2, 3, 4, 5, 6, 7, 8)))
            axes[0, column].xaxis.set_major_formatter(ScalarFormatter())
            axes[0, column].xaxis.set_minor_formatter(NullFormatter())
            for ax in axes[:, column] if alone else axes[1:, column]:
                ax.set_xlabel("$D$ [mm]")
        for ax in axes[:, 0]:
            ax.set_ylabel("$Q$ [grains/s]" if ax.get_subplotspec().is_first_col() else "")
            ax.set_yscale("log")
            ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            ax.yaxis.set_major_formatter(ScalarFormatter())
            ax.yaxis.set_minor_formatter(NullFormatter())
        lines = {text: line for ax in axes[0] for line, text in zip(*ax.get_legend_handles_labels(), strict=True)}
        shown = [name for name in (*names, _SLOPE) if name in lines]
        figure.legend([lines[name] for name in shown], shown, loc="outside upper right", ncols=min(4, len(shown)))
    return figure


_SLOPE = "slope 5/2"


def _name(one: Series) -> str:
    rest = display.label({k: v for k, v in one.at.items() if k != ROTATION and not k.startswith("grains.")})
    return ", ".join(filter(None, (shape_of(one.points[0]), rest)))


def _draw(ax: "Axes", one: Series, law: str, index: int) -> None:
    known = [result for result in one.points if FLOW in result.pooled]
    D = np.array([result.orifice for result in known])
    pooled = [result.pooled[FLOW] for result in known]
    errors = [min(np.nan_to_num(p.error), 0.95 * p.value) for p in pooled]
    style = look(index)
    points = {**style, "linestyle": "none", "markersize": 3}
    ax.errorbar(D * 1e3, [p.value for p in pooled], yerr=errors, label=_name(one), **points)
    if law in one.fits:
        fine = np.geomspace(D.min(), D.max(), 60)
        value, _, _ = one.fits[law].predict(fine)
        mass = one.points[0].point.scene.grains.mass
        ax.plot(fine * 1e3, value / mass, color=style["color"], linestyle=style["linestyle"], linewidth=0.8)


def _slope(ax: "Axes") -> None:
    """A line of slope 5/2 through the largest value."""
    D, Q = (np.concatenate([np.asarray(line[0].get_data()[k], float) for line in ax.containers]) for k in (0, 1))
    ends, top = np.array([D.min(), D.max()]), int(Q.argmax())
    ax.plot(ends, Q[top] * (ends / D[top]) ** 2.5, color=FAINT, linewidth=0.9, label=_SLOPE, zorder=0)
