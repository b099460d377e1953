"""The shape of profiles against the relative distance of the outlet from the wall (Fan et al. 2023, Figs 11 and 14)."""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from labbook.fit.outlet import TERMS, Approach, approach_at
from labbook.report.style import COLOURS, INK, MILLIMETRE, PAGE, band, house, look, verbatim
from labbook.results import display
from labbook.results.approach import approaches
from labbook.results.ratios import GAP, Ratio
from labbook.results.reference import Comparison

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def shape_against_position(
    ratios: Sequence[Ratio], definition: str, comparisons: Sequence[Comparison] = (), source: str = ""
) -> "Figure":
    """Tilts and exponents of each point's own profiles (eqs 16, 17) against s*, with standard errors over seeds.

    Lines: limit - depth e^{-rate s*} with its 95 % bands, fitted to the points of each panel; dots: the reference's.
    """
    from matplotlib.figure import Figure

    with house():
        figure = Figure(figsize=(PAGE, 122 * MILLIMETRE))
        axes = figure.subplots(2, 2, sharex=True).flatten()
        for ax, (name, found) in zip(axes, approaches(ratios, definition).items(), strict=True):
            groups = [display.label(result.at, {GAP}) for result in found.of]
            order = list(dict.fromkeys(groups))
            for place, parameter, group in zip(found.places, found.parameters, groups, strict=True):
                style = {**look(order.index(group)), "linestyle": "none", "markersize": 3.5}
                error = parameter.error if math.isfinite(parameter.error) else 0.0
                label = group if group not in ax.get_legend_handles_labels()[1] else None
                ax.errorbar(place, parameter.value, yerr=error, label=label, **style)
            if found.approach is not None:
                _approach(ax, found.approach)
            theirs = {c.quantity.rpartition(".")[2]: c.reference for c in comparisons
                      if c.quantity.rpartition(".")[0] == f"{definition}.{name}"}  # fmt: skip
            if theirs.keys() >= set(TERMS):
                _theirs(ax, theirs, source)
            ax.set_ylabel(display.quantity(f"{definition}.{name}").name.partition(" ")[0])
        handles: dict = {}
        for ax in axes:
            handles |= {text: handle for handle, text in zip(*ax.get_legend_handles_labels(), strict=True)}
        for ax in axes[2:]:
            ax.set_xlabel("distance from the wall, $s^* = 2s/(L-D)$")
        figure.legend(list(handles.values()), list(handles), loc="outside upper center", ncols=4)
        figure.align_ylabels()
    return figure


_FINE = np.linspace(0, 1, 400)


def _approach(ax: "Axes", law: Approach) -> None:
    value = law.at(_FINE)
    ax.plot(_FINE, value, color=COLOURS[1], zorder=1)
    if not all(map(math.isfinite, law.errors)):
        ax.set_title("rate of the approach: not determined")
        return
    halves = (law.half_width(_FINE), law.half_width(_FINE, new_point=True))
    law_band, point_band = ((value - half, value + half) for half in halves)
    band(ax, _FINE, law_band, point_band, COLOURS[1])
    limit, depth, rate = (
        display.with_error(value, error)
        for value, error in zip((law.limit, law.depth, law.rate), law.errors, strict=True)
    )
    ax.set_title(f"{limit} − ({depth}) exp(−({rate}) s*)")


def _theirs(ax: "Axes", theirs: Mapping[str, float], source: str) -> None:
    curve = approach_at(_FINE, *(theirs[name] for name in TERMS))
    ax.plot(_FINE, curve, color=INK, linestyle=":", linewidth=1.2, zorder=3, label=verbatim(source))
