"""Q(D) of holes on logarithmic axes: a power is a line on the left, an exponential on the right (Pongo et al. 2022,
Figs 4 and 5)."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from labbook.report.rotation import FLOW
from labbook.report.style import FAINT, MILLIMETRE, PAGE, house, look

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from labbook.report.series import Series


def flow_scaling(series: Sequence["Series"]) -> "Figure":
    """Q against D of every series, in double and in half logarithmic axes; lines: the fitted power and exponential.

    Bars: 95 % intervals. Grey: the slope 5/2.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullFormatter, ScalarFormatter

    with house():
        figure = Figure(figsize=(PAGE, 84 * MILLIMETRE))
        axes = figure.subplots(1, 2, sharey=True)
        for index, one in enumerate(series):
            known = [result for result in one.points if FLOW in result.pooled]
            pooled = [result.pooled[FLOW] for result in known]
            D, Q = np.array([result.orifice for result in known]) * 1e3, [p.value for p in pooled]
            half = [min(np.nan_to_num(p.half_width, posinf=0.0), 0.95 * p.value) for p in pooled]
            mass = one.points[0].point.scene.grains.mass
            fine = np.geomspace(D.min(), D.max(), 60)
            style = look(index)
            for ax, law in zip(axes, ("power", "exponential"), strict=True):
                points = {**style, "linestyle": "none", "markersize": 3.5}
                ax.errorbar(D, Q, yerr=half, label=one.label or None, **points)
                if law in one.fits:
                    value, _, _ = one.fits[law].predict(fine * 1e-3)
                    ax.plot(fine, value / mass, color=style["color"], linestyle=style["linestyle"], linewidth=0.8)
        low, high = axes[0].get_xlim()
        at = np.array([low, high])
        top = axes[0].get_ylim()[1]
        axes[0].plot(at, 0.8 * top * (at / high) ** 2.5, color=FAINT, linewidth=0.8, label="slope 5/2", zorder=0)
        axes[0].set_xscale("log")
        axes[0].xaxis.set_major_formatter(ScalarFormatter())
        axes[0].xaxis.set_minor_formatter(ScalarFormatter())
        axes[0].tick_params(axis="x", which="minor", labelsize=5.5)
        axes[0].set_yscale("log")
        axes[1].yaxis.set_minor_formatter(NullFormatter())
        for ax in axes:
            ax.set_xlabel("orifice, $D$ [mm]")
        axes[0].set_ylabel("$Q$ [grains/s]")
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right upper")
    return figure
